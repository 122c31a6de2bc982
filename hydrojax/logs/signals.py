"""What a log may hold, and how a rig file says where it is."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

SIGNALS = {
    "time": "s", "u": "{u}", "psi": "rad", "x": "m", "v": "m/s", "P_a1": "Pa",
    "P_a2": "Pa", "P_s": "Pa", "P_r": "Pa", "P": "N", "F": "N", "F_d": "N",
}  # fmt: skip
"""What a log may hold, and the SI unit; `{u}` is V or 1."""


class Channel(BaseModel):
    """One line of the rig file's [channels]: where a signal is in the logs."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    column: str
    unit: str | None = None
    invert: bool = False
