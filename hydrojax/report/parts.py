"""Parts of report.json, and what each of their keys means."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic import model_validator as checked

from hydrojax import units
from hydrojax.errors import COUNT, WORD, one_line

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
Ends = tuple[float | None, float | None]


class Part(BaseModel):
    """What all parts of a report have in common: finite numbers, no conversions."""

    model_config = ConfigDict(
        frozen=True, strict=True, allow_inf_nan=False, extra="ignore"
    )


class ParameterRecord(Part):
    """A parameter, in SI."""

    value: float | None = Field(description="null where it is infinite")
    std: Size | None = Field(
        None, description="standard deviation; null where it was not fitted"
    )
    unit: Unit = Field(description="of `value`, `std` and the intervals")
    interval: Ends | None = Field(None, description="95 % confidence interval")
    start: float | None = Field(
        None, description="where the fit began; the value, where it was not fitted"
    )
    at_bound: bool = Field(False, description="whether it is at an end of its range")
    identified: bool = Field(
        True,
        description="whether it lies inside its range, with a standard deviation of at "
        "most half its size",
    )
    held: bool = Field(False, description="whether it was held, not fitted")
    says: str = Field("", description="what it is")
    profile: Ends | None = Field(
        None,
        description="95 % interval by profile likelihood (`--profile`); an end is null "
        "where the range ends first",
    )


class HorizonRecord(Part):
    """Errors of a channel over runs of one length: RMS, SI, null where a run does not
    stay finite.
    """

    before: Size | None = Field(None, description="of the declared model")
    after: Size | None = Field(None, description="of the final model")
    held: Size | None = Field(
        None, description="of the value measured as each run began, held"
    )
    arx: Size | None = Field(
        None, description="of a linear ARX model of order 4 with the same inputs"
    )


class ErrorsRecord(Part):
    """Errors of a channel: RMS of measured - replayed, SI."""

    before: Size | None = Field(
        None,
        description="of the declared model: fitted (`trace`), or at its starts "
        "(`identify`)",
    )
    after: Size | None = Field(description="of the final model")
    held: Size | None = Field(
        None, description="of the value measured as each window began, held"
    )


class ChannelRecord(ErrorsRecord):
    """Errors of a channel: RMS of measured - replayed, SI; on the test logs, else on
    the validation logs, else on the fitted ones.
    """

    unit: Unit = Field(description="of all errors")
    noise: Size | None = Field(
        None, description="standard deviation of the sensor's noise"
    )
    skill: float | None = Field(
        None, le=1, description="1 - (`after` / `held`)^2: 1 is perfect, 0 no better"
    )
    horizons: dict[str, HorizonRecord] = Field(
        {}, description='by length of the run: "0.25", "1", "5" (s), and "free"'
    )
    validate_: ErrorsRecord | None = Field(
        None,
        alias="validate",
        description="those on the validation logs, where test logs were given",
    )


class MotionValueRecord(Part):
    """A parameter that predicts the motion best; SI."""

    value: float | None = Field(description="that predicts the motion best")
    windows: float | None = Field(
        None, description="as found from pressures and force in windows"
    )
    unit: Unit = Field(description="of both")


class MotionRecord(Part):
    """How a position was predicted; its errors are those of channel `x`."""

    fitted_to: Literal["runs", "windows"] = Field(
        description="what `values` are best for: whole logs, or pressures and force in "
        "windows, as `parameters`, where these predict the validation logs as well"
    )
    windows: Size | None = Field(
        None, description="RMS error over whole logs with `parameters`, m"
    )
    values: dict[Name, MotionValueRecord] = Field(
        description="of what was free, by name"
    )


class LongRunsRecord(Part):
    """Values for longer runs than a window, which rig_long.toml has."""

    seconds: float = Field(description="length of the runs that they are fitted to")
    channels: dict[Name, HorizonRecord] = Field(
        description="errors through whole logs: `before` with `parameters`, `after` "
        "with those of rig_long.toml"
    )


class CandidateRecord(Part):
    """What became of an effect that was tried."""

    name: Name = Field(description="of the effect")
    status: Literal["added", "absent", "cannot tell", "rejected"] = Field(
        description="in the final model; tested and not there; these logs could not "
        "show it; did not lower the validation error"
    )
    p_value: Share | None = Field(
        None,
        description="family-wise chance of such a score, or a higher one, if it "
        "were not there",
    )
    power: Share | None = Field(
        None,
        description="chance that these logs show it at a size that matters, 0 to 1",
    )
    share: float | None = Field(
        None, description="part of the fit's chi-square that a step along it removes"
    )
    why: str = Field("", description="the reason in words")


class EffectCurve(Part):
    """The curve that an effect was found as; SI. More of it stands in `curves`."""

    signal: Name = Field(description="what it is over")
    unit: Unit = Field(description="of the curve")
    at: list[float] = Field(max_length=COUNT, description="values of the signal")
    value: list[float] = Field(max_length=COUNT, description="of the curve there")
    std: list[Size] = Field(max_length=COUNT, description="its standard deviation")


class EffectRecord(Part):
    """An effect that was found."""

    name: Name = Field(description="of the effect")
    parameters: dict[Name, ParameterRecord] = Field(
        description="by name, as those of the rig"
    )
    p_value: Share | None = Field(
        None,
        description="family-wise chance of such a score, or a higher one, if it "
        "were not there",
    )
    before: dict[str, Size | None] = Field(
        {}, description="error of each channel without it: RMS on the validation logs"
    )
    after: dict[str, Size | None] = Field(
        {}, description="the same with it, and with those found before it"
    )
    cannot_tell_from: list[str] = Field(
        [], description="effects and constants that would explain these logs as well"
    )
    betrayed_by: str = Field(
        "", description="signal against which its residual stands out"
    )
    share: float | None = Field(
        None,
        description="part of the squared error above the noise that it takes, of all "
        "channels",
    )
    curve: EffectCurve | None = Field(
        None, description="the curve that it was found as, if `--discover` found it"
    )
    formula: str | None = Field(None, description="what stands for that curve")


class StretchRecord(Part):
    """A stretch of a log in which much of a residual lies."""

    log: str = Field(description="the log")
    start: float = Field(description="s")
    end: float = Field(description="s")
    share: float = Field(description="of the excess in squares")


class RestRecord(Part):
    """What stays above the noise of a channel."""

    channel: Name = Field(description="the channel")
    excess: Size | None = Field(description="RMS above the noise")
    unit: Unit = Field(description="of `excess`")
    follows: str = Field(
        "", description="signal that it correlates with most, if any does"
    )
    says: str = Field("", description="the same in words")
    where: list[StretchRecord] = Field(
        [], description="the windows that hold over half of it, where a few do"
    )


class LoopRecord(Part):
    """A measured closed loop, run again in simulation."""

    log: str = Field(description="the log")
    unit: Unit = Field(description="of the errors")
    rms: Size | None = Field(description="RMS of measured - simulated force")
    tracking_measured: Size | None = Field(description="RMS of desired - measured")
    tracking_simulated: Size | None = Field(description="RMS of desired - simulated")
    warning: str = Field(
        "", description="why the simulation is not valid, if it is not"
    )


class InputRecord(Part):
    """An input that looks wrong."""

    input: str = Field(
        description="signal or key of the rig file; several, joined by commas"
    )
    finding: str = Field(
        description="`sign`, `exchanged`, `unit`, `delay`, `held`, `zero`, "
        "`factor`, `left out`, `noise`, `stray`, `stuck`, `clipped` or `vacuum`"
    )
    factor: float | None = Field(
        None, description="by which to multiply it; null where that mends nothing"
    )
    error: Size | None = Field(
        None, description="RMS of the balance that shows it, as given"
    )
    error_if_mended: Size | None = Field(
        None, description="the same with the input mended"
    )
    unit: str = Field("", description="of both errors")
    says: str = Field("", description="what looks wrong, and the line to write")
    lines: dict[str, dict[str, Any]] = Field(
        {}, description="that line, by section and key of the rig file"
    )
    mended: bool = Field(
        False, description="whether all else in the report is of the mended input"
    )
    effects: list[str] = Field([], description="effects that do the same to the logs")


class FileRecord(Part):
    """A log."""

    name: str = Field(description="of the file")
    use: Literal["fit", "validate", "test"] = Field(description="what it was for")
    rows: int = Field(ge=0, description="number of rows")
    seconds: Size | None = Field(None, description="length, s")
    sha256: str = Field("", description="of the file; empty where it was no file")


class MadeRecord(Part):
    """What made a report, and when."""

    version: str = Field(default="", description="of hydrojax")
    date: str = Field(default="", description="ISO 8601, with the offset from UTC")
    command_line: str = Field(
        default="", description="as given; after #, the defaults left in force"
    )


class CovarianceRecord(Part):
    """Covariance of the fitted parameters inside their ranges, in SI."""

    names: list[Name] = Field(
        max_length=COUNT, description="of rows and columns, as stored"
    )
    matrix: list[list[float]] = Field(description="row by row")

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

    fit: list[str] = Field(default=[], description="fitted")
    validate_: list[str] = Field(
        default=[], alias="validate", description="that decided which effects stay"
    )
    test: list[str] = Field(default=[], description="that took part in no decision")
