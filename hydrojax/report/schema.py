"""report.json: one schema, of what `identify.results.report_json` writes.

Whatever reads it checks it by this, since a report may come from another version,
another hand, or half a disk; docs/reference publishes it as a JSON schema.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import ConfigDict, Field

from hydrojax.report.curve import CurveRecord
from hydrojax.report.parts import (
    CandidateRecord,
    ChannelRecord,
    CovarianceRecord,
    EffectRecord,
    FileRecord,
    InputRecord,
    LogsRecord,
    LongRunsRecord,
    LoopRecord,
    MadeRecord,
    MotionRecord,
    Name,
    ParameterRecord,
    Part,
    RestRecord,
    Share,
    Size,
)

FORMAT = "hydrojax-report/1"


class Report(Part):
    """report.json: its keys, what they hold, and what they mean. SI; None (null) is no
    finite number.
    """

    model_config = ConfigDict(title="hydrojax report")

    format: Literal["hydrojax-report/1"] = Field(description="version of this format")
    command: Literal["identify", "trace"] = Field(
        "identify", description="what made it"
    )
    rig: str = Field("", description="name in the rig file")
    logs: LogsRecord = Field(
        LogsRecord(),
        description="names of the files by what they were for",
    )
    verdict: Literal["", "nothing missing", "explained", "unknown"] = Field(
        "",
        description="every channel at its noise without an effect, with effects, or "
        "not",
    )
    sentence: str = Field("", description="the verdict in words")
    explained_share: Share | None = Field(
        None,
        description="part of the squared error above the noise that the effects take, "
        "0 to 1",
    )
    parameters: dict[Name, ParameterRecord] = Field(
        description="of the rig, by name; `held`: not fitted"
    )
    channels: dict[Name, ChannelRecord] = Field(
        {},
        description="errors by channel, RMS of measured - replayed; `held`, `skill`: "
        "against the value held from a window's start; `horizons`: runs of 1 s, 5 s "
        "and the whole log; `x`: motion that was predicted, which no verdict counts; "
        "`validate`: of the validation logs, where test logs were given",
    )
    effects: list[EffectRecord] = Field(description="effects that were named")
    curves: list[CurveRecord] = Field(
        [],
        description="curves for what no known effect explains, where they were asked "
        "for (`trace --discover`)",
    )
    beside: dict[Name, ParameterRecord] = Field(
        {},
        description="the fitted parameters with the curves in place; their intervals "
        "count what a curve may leave to them, or take from them",
    )
    candidates: list[CandidateRecord] = Field(
        [], description="every effect that was tried, and what became of it"
    )
    unexplained: list[RestRecord] = Field(
        [], description="channels that stay above their noise"
    )
    motion: MotionRecord | None = Field(
        None,
        description="how the position was predicted, where [load] has `predicts`; its "
        "errors are those of channel `x`",
    )
    long_runs: LongRunsRecord | None = Field(
        None,
        description="values for longer runs, where the model found has no skill "
        "through whole logs and other values have more",
    )
    closed_loop: list[LoopRecord] = Field(
        [], description="measured loops, run again in simulation"
    )
    covariance: CovarianceRecord | None = Field(
        None, description="of the fitted parameters: `names`, `matrix`"
    )
    inputs: list[InputRecord] = Field(
        [], description="inputs that look wrong, as `check` finds them"
    )
    limits: list[str] = Field(
        [], description="what is at a range's end or not identified, in words"
    )
    notes: list[str] = Field([], description="how the logs were read")
    seconds: dict[str, Size | None] = Field(
        {}, description="time spent compiling and running"
    )
    criteria: dict[str, float | None] = Field(
        {}, description="the thresholds that decided"
    )
    files: list[FileRecord] = Field(
        [], description="the logs, their lengths and hashes"
    )
    made: MadeRecord = Field(MadeRecord(), description="version, date and command")
    rig_toml_sha256: str = Field(
        "", description="of the rig.toml beside it, where there is one"
    )

    @property
    def every_parameter(self) -> dict[str, ParameterRecord]:
        """Those of the rig, and those of the effects as `valve_lag.tau`."""
        found = dict(self.parameters)
        for effect in self.effects:
            own = effect.parameters.items()
            found |= {f"{effect.name}.{name}": p for name, p in own}
        return found


def report_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12); readers ignore keys that they do not know."""
    draft = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return draft | Report.model_json_schema()
