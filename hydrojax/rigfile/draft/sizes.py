"""What a user knows of a cylinder, and the parameters that are usual for its size."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hydrojax import units
from hydrojax.errors import InputError
from hydrojax.logs.tables import File
from hydrojax.plant.layout import LAYOUTS
from hydrojax.rigfile.draft.columns import Guess
from hydrojax.rigfile.sections import LANDS, SUPPLY
from hydrojax.units import QuantityLike

RATED_DROP = 3.5e6
"""Pressure drop over each edge at which a valve's flow is rated, Pa (ISO 10770-1)."""
FULL = {"V": 10.0, "1": 1.0}
"""The command of a valve that is open, by its unit."""


@dataclass(frozen=True)
class Sizes:
    """What a user knows of the cylinder, SI; None where it is not known.

    Attributes:
        bore, rod: diameters, m; a rod of 0, or none on either side: equal areas.
        stroke: m.
        radius: of the joint, m, where an angle is logged.
        rated_flow: of the valve when open, m^3/s, at `RATED_DROP` over each edge.
        supply: pressure, Pa, where the log has none.
    """

    bore: float | None = None
    rod: float | None = None
    stroke: float | None = None
    radius: float | None = None
    rated_flow: float | None = None
    supply: float | None = None


WANTS = {
    "bore": "m", "rod": "m", "stroke": "m", "radius": "m", "rated_flow": "m^3/s",
    "supply": "Pa",
}  # fmt: skip
"""Units of `Sizes`."""


def read_sizes(**given: QuantityLike | None) -> Sizes:
    """Sizes from quantities as a user writes them.

    Raises:
        InputError: no quantity, a wrong unit, or one that is not above 0.
    """
    out: dict[str, float] = {}
    for name, value in given.items():
        if value is None:
            continue
        option = f"--{name.replace('_', '-')}"
        out[name] = units.in_si(value, WANTS[name], option)
        if out[name] < 0 or (out[name] == 0 and name != "rod"):
            raise InputError(f"{option}: {value!r} must be above 0")
    if out.get("rod", 0.0) >= out.get("bore", math.inf):
        raise InputError("--rod: must be thinner than the bore; exchange them")
    return Sizes(**out)


@dataclass(frozen=True)
class Read:
    """A log as it was understood, and what is known of its rig.

    Attributes:
        file: the log.
        signals: its columns by signal.
        layout: one of `LAYOUTS`.
        sizes: of the cylinder.
    """

    file: File
    signals: Mapping[str, Guess]
    layout: str
    sizes: Sizes


def missing(log: Read) -> list[str]:
    """The fields of `Sizes` without which no rig file can be drafted."""
    needs = ["bore", "stroke"] if LAYOUTS[log.layout].has_valve else []
    needs += ["rod"] if log.layout == "differential" else []
    needs += ["radius"] if "psi" in log.signals else []
    return [name for name in needs if getattr(log.sizes, name) is None]


def rates_valve(log: Read) -> bool:
    """Whether the valve's constants are drafted: the log has its command."""
    return "u" in log.signals and LAYOUTS[log.layout].has_valve


def areas(log: Read) -> tuple[float, float]:
    """Areas of chambers 1 and 2, m^2."""
    if not LAYOUTS[log.layout].has_valve:
        return 1.0, 1.0
    bore, rod = log.sizes.bore or 0.0, log.sizes.rod or 0.0
    full, ring = math.pi / 4 * bore**2, math.pi / 4 * (bore**2 - rod**2)
    kinds = {"differential": (ring, full), "single": (full, full)}
    return kinds.get(log.layout, (ring, ring))


def ranges(log: Read) -> dict[str, tuple[float, float, float]]:
    """Start and range of each parameter, SI, as is usual for a cylinder so large."""
    stall = _supply_pressure(log) * float(np.mean(areas(log)))
    layout = LAYOUTS[log.layout]
    most = log.signals.get("P" if layout.driven else "F")
    if not layout.has_valve and most is not None:
        stall = float(np.nanmax(np.abs(most.values)))
    stroke = log.sizes.stroke or 0.2
    c = _valve_constant(log)
    # Friction is a small part of what a drive gives, and most of what a tester feels.
    slide, per_speed = (0.05 if layout.driven else 0.5) * stall, 2.0 * stall
    out = {name: (c, c / 10, c * 10) for name in LANDS}
    out["beta"] = (9e8, 1e8, 3e9)
    for name in ("delta_1", "delta_2"):
        out[name] = (0.05 * stroke, 0.0, 0.25 * stroke)
    for name in ("k_cp", "k_cn"):
        out[name] = (slide, 0.0, 5 * slide)
    out["k_0"] = (0.0, -slide, slide)
    for name in ("k_vp", "k_vn"):
        out[name] = (0.0, -per_speed, per_speed)
    for name in ("k_fp", "k_fn"):
        out[name] = (0.7, 0.0, 3.0)
    out["z_ss"] = (6e-5, 2e-6, 5e-4)
    out["delta"] = (1 / slide, 0.1 / slide, 10 / slide)
    return out


def command_unit(log: Read) -> str:
    """V or 1; 1 where the log has no command."""
    u = log.signals.get("u")
    return "V" if u is not None and units.fits(u.unit, "V") else "1"


def _supply_pressure(log: Read) -> float:
    """P_s, Pa: the log's, the user's, or the default."""
    if "P_s" in log.signals:
        return float(np.nanmedian(log.signals["P_s"].values))
    return log.sizes.supply or SUPPLY["P_s"]


def _valve_constant(log: Read) -> float:
    """Of each edge, SI: from the rated flow, else from speed and command."""
    signals, sizes = log.signals, log.sizes
    if sizes.rated_flow is not None:
        return sizes.rated_flow / FULL[command_unit(log)] / math.sqrt(RATED_DROP)
    motion, u = signals.get("x") or signals.get("psi"), signals.get("u")
    if motion is None or u is None:
        return 2.2e-9
    arm = 1.0 if "x" in signals else sizes.radius or 0.1
    speed = np.abs(np.gradient(motion.values * arm, signals["time"].values))
    opened = np.abs(u.values)
    moving = (speed > 0.5 * np.nanstd(speed)) & (opened > 0.5 * np.nanstd(opened))
    if not moving.any():
        return 2.2e-9
    flow = float(np.mean(areas(log))) * speed[moving]
    drop = math.sqrt(_supply_pressure(log) / 2)
    return float(f"{np.nanmedian(flow / opened[moving]) / drop:.3g}")
