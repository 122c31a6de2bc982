"""report.json as it is read again: one schema for all who do.

`identify.results.report_json` writes more than is read; what is read is checked here,
since a report may come from another version, another hand, or half a disk.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic import model_validator as checked

from hydrojax import units
from hydrojax.errors import COUNT, REPORT, WORD, InputError, file_text, one_line
from hydrojax.report.files import settle

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


class Part(BaseModel):
    """What all parts of a report have in common: finite numbers, no conversions."""

    model_config = ConfigDict(
        frozen=True, strict=True, allow_inf_nan=False, extra="ignore"
    )


class ParameterRecord(Part):
    """A parameter; SI. `value` is None where it is infinite, `std` where not fitted."""

    value: float | None
    std: float | None = Field(default=None, ge=0)
    unit: Unit


class ErrorsRecord(Part):
    """An error of a channel, and that of its value held; SI."""

    after: float | None = Field(ge=0)
    held: float | None = Field(default=None, ge=0)


class ChannelRecord(ErrorsRecord):
    """The error of a channel; where there are test logs, that on the others besides."""

    unit: Unit
    validate_: ErrorsRecord | None = Field(default=None, alias="validate")


class CandidateRecord(Part):
    """What became of a candidate."""

    name: Name
    status: str


class EffectRecord(Part):
    """An effect that was found."""

    name: Name
    parameters: dict[Name, ParameterRecord]


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
    """What is read of a report.json."""

    format: Literal["hydrojax-report/1"]
    rig: str = ""
    logs: LogsRecord = LogsRecord()
    verdict: str = ""
    sentence: str = ""
    parameters: dict[Name, ParameterRecord]
    channels: dict[Name, ChannelRecord] = {}
    effects: list[EffectRecord]
    candidates: list[CandidateRecord] = []
    covariance: CovarianceRecord | None = None

    @property
    def every_parameter(self) -> dict[str, ParameterRecord]:
        """Those of the rig, and those of the effects as `valve_lag.tau`."""
        found = dict(self.parameters)
        for effect in self.effects:
            own = effect.parameters.items()
            found |= {f"{effect.name}.{name}": p for name, p in own}
        return found


def read_report(folder: str | Path) -> Report:
    """The report in a folder that `identify` or `trace` has written, checked.

    Args:
        folder: the folder, or its report.json.

    Raises:
        InputError: there is no report, or it is damaged, or not one of hydrojax.
    """
    folder = Path(folder)
    path = folder
    if folder.suffix != ".json":
        path = folder / "report.json"
        if not path.is_file() and not (folder.is_dir() and path.exists()):
            raise InputError(
                f"{path}: no report.json there: expected a folder that identify or "
                "trace has written (--out)"
            )
        settle(folder)
    text = file_text(path, REPORT, "expected the report.json of identify or trace")
    try:
        return Report.model_validate_json(text)
    except ValidationError as err:
        first = err.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "JSON"
        said = first["msg"].removeprefix("Value error, ")
        raise InputError(
            f"{path}: not a report of identify or trace: {where}: {said}; run it again"
        ) from err
