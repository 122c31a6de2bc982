"""report.json: one schema, of what `identify.results.report_json` writes.

Whatever reads it checks it by this, since a report may come from another version,
another hand, or half a disk; docs/reference publishes it as a JSON schema.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic import model_validator as checked

from hydrojax import units
from hydrojax.errors import COUNT, WORD, one_line

FORMAT = "hydrojax-report/1"

NOT_NEGATIVE = -1e-6
"""Least eigenvalue of a correlation matrix that rounding may give."""


def _name(name: str) -> str:
    if not name or len(name) > WORD or not name.isprintable():
        raise ValueError("expected a name that can be printed")
    return name


def _unit(unit: str) -> str:
    if not units.fits(unit, unit):
        raise ValueError(f"unknown unit {one_line(unit, 40)!r}")
    return unit


Name = Annotated[str, AfterValidator(_name)]
Unit = Annotated[str, AfterValidator(_unit)]
Size = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class Part(BaseModel):
    """What all parts of a report have in common: finite numbers, no conversions."""

    model_config = ConfigDict(
        frozen=True, strict=True, allow_inf_nan=False, extra="ignore"
    )


class ParameterRecord(Part):
    """A parameter; SI. `value` is None where it is infinite, `std` where not fitted."""

    value: float | None
    std: Size | None = None
    unit: Unit
    interval: tuple[float | None, float | None] | None = None
    start: float | None = None
    at_bound: bool = False
    identified: bool = True
    held: bool = False
    says: str = ""
    profile: tuple[float | None, float | None] | None = None


class HorizonRecord(Part):
    """Errors of a channel over runs of one length, RMS, SI; None where none is finite:
    of the declared and the final model, of the value held, and of an ARX model.
    """

    before: Size | None = None
    after: Size | None = None
    held: Size | None = None
    arx: Size | None = None


class ErrorsRecord(Part):
    """Errors of a channel with the declared and the final model, and that of its value
    held; RMS, SI.
    """

    before: Size | None = None
    after: Size | None
    held: Size | None = None


class ChannelRecord(ErrorsRecord):
    """The error of a channel; where there are test logs, that on the others besides."""

    unit: Unit
    noise: Size | None = None
    skill: float | None = Field(default=None, le=1)
    horizons: dict[str, HorizonRecord] = {}
    validate_: ErrorsRecord | None = Field(default=None, alias="validate")


class CandidateRecord(Part):
    """What became of a candidate."""

    name: Name
    status: Literal["added", "absent", "cannot tell", "rejected"]
    p_value: Share | None = None
    power: Share | None = None
    share: float | None = None
    why: str = ""


class EffectRecord(Part):
    """An effect that was found; errors by channel, SI."""

    name: Name
    parameters: dict[Name, ParameterRecord]
    p_value: Share | None = None
    before: dict[str, Size | None] = {}
    after: dict[str, Size | None] = {}
    cannot_tell_from: list[str] = []
    betrayed_by: str = ""
    share: float | None = None


class CurveRecord(Part):
    """A curve that stands for what no known effect explains; SI. `y` and `std` (of the
    curve as a whole) at the values `s` of `signal`, less what the rig's own parameters
    can follow; `seen` the range that it rests on, `rug` samples there, `law` a formula
    that does as well, with the values `law_y`; errors by channel on the validation
    logs, and on the `test` logs, RMS; `share` of the squared error above the noise.
    """

    name: Name
    place: Name
    signal: Name
    signal_unit: Unit
    factor: str = ""
    unit: Unit
    s: list[float] = Field(max_length=COUNT)
    y: list[float] = Field(max_length=COUNT)
    std: list[Size] = Field(max_length=COUNT)
    extrapolated: list[bool] = Field([], max_length=COUNT)
    seen: tuple[float, float]
    rug: list[float] = Field([], max_length=COUNT)
    p_value: Share | None = None
    before: dict[str, Size | None] = {}
    after: dict[str, Size | None] = {}
    share: Share | None = None
    test: dict[str, ErrorsRecord] = {}
    alike: list[str] = []
    law: str = ""
    law_y: list[float] | None = None


class RestRecord(Part):
    """What stays above the noise of a channel, and what it follows; SI."""

    channel: Name
    excess: Size | None
    unit: Unit
    follows: str = ""
    says: str = ""


class LoopRecord(Part):
    """A measured loop run again: RMS of the differences of its forces."""

    log: str
    unit: Unit
    rms: Size | None
    tracking_measured: Size | None
    tracking_simulated: Size | None
    warning: str = ""


class InputRecord(Part):
    """An input that looks wrong."""

    input: str
    finding: str
    factor: float | None = None
    error: Size | None = None
    error_if_mended: Size | None = None
    unit: str = ""
    says: str = ""


class FileRecord(Part):
    """A log: what it was for, its length in s, and its hash."""

    name: str
    use: Literal["fit", "validate", "test"]
    rows: int = Field(ge=0)
    seconds: Size | None = None
    sha256: str = ""


class MadeRecord(Part):
    """What made a report, and when."""

    version: str = ""
    date: str = ""
    command_line: str = ""


class CovarianceRecord(Part):
    """Covariance of the fitted parameters; SI."""

    names: list[Name] = Field(max_length=COUNT)
    matrix: list[list[float]]

    @checked(mode="after")
    def _is_one(self) -> CovarianceRecord:
        count = len(self.names)
        rows = [len(row) for row in self.matrix]
        if len(set(self.names)) < count or rows != [count] * count:
            raise ValueError("expected one row and one column for each name")
        whole = np.array(self.matrix).reshape(count, count)
        each = np.sqrt(np.abs(np.diag(whole)))
        with np.errstate(divide="ignore", invalid="ignore"):
            related = np.nan_to_num(whole / np.outer(each, each))
        if np.any(np.diag(whole) < 0) or not np.allclose(related, related.T, atol=1e-6):
            raise ValueError("expected a symmetric matrix with variances of 0 or more")
        if count and np.linalg.eigvalsh(related).min() < NOT_NEGATIVE * count:
            raise ValueError("expected a matrix without negative eigenvalues")
        return self


class LogsRecord(Part):
    """Names of the logs."""

    fit: list[str] = []
    validate_: list[str] = Field(default=[], alias="validate")
    test: list[str] = []


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
        LogsRecord(), description="names of the files by what they were for"
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
        "and the whole log; `validate`: of the validation logs, where test logs were "
        "given",
    )
    effects: list[EffectRecord] = Field(description="effects that were named")
    curves: list[CurveRecord] = Field(
        [],
        description="curves for what no known effect explains, where they were asked "
        "for (`trace --discover`)",
    )
    candidates: list[CandidateRecord] = Field(
        [], description="every effect that was tried, and what became of it"
    )
    unexplained: list[RestRecord] = Field(
        [], description="channels that stay above their noise"
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
