"""report.json read again, and checked by its schema."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import ValidationError
from pydantic_core import from_json

from hydrojax.errors import REPORT, InputError, file_text
from hydrojax.report.files import settle
from hydrojax.report.schema import Report


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
        if os.path.isdir(folder):
            settle(folder)
        if not os.path.exists(path):
            raise InputError(
                f"{path}: no report.json there: expected a folder that identify or "
                "trace has written (--out)"
            )
    text = file_text(path, REPORT, "expected the report.json of identify or trace")
    try:
        report = Report.model_validate_json(text)
        from_json(text, allow_inf_nan=False)  # keys that nobody reads, too
        return report
    except ValidationError as err:
        first = err.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"])) or "JSON"
        said, cause = f"{where}: {first['msg'].removeprefix('Value error, ')}", err
    except ValueError as err:
        said, cause = f"JSON: {err}", err
    raise InputError(
        f"{path}: not a report of identify or trace: {said}; run it again"
    ) from cause
