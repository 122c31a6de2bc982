"""The reference pages of the documentation, from the declarations in the code.

`python -m benchmarks.reference` writes them; a test says when they are stale.
"""

from __future__ import annotations

import json
from pathlib import Path

from benchmarks.reference.api import api_page
from benchmarks.reference.effects import effects_page
from benchmarks.reference.files import commands_page, report_page, rig_file_page
from benchmarks.reference.parameters import parameters_page
from hydrojax.report.schema import report_schema
from hydrojax.rigfile.json_schema import rig_schema

FOLDER = Path(__file__).parents[2] / "docs/reference"


def pages() -> dict[str, str]:
    """The reference pages and schemas by file name."""
    return {
        "parameters.md": parameters_page(),
        "effects.md": effects_page(),
        "rig_file.md": rig_file_page(),
        "commands.md": commands_page(),
        "report.md": report_page(),
        "api.md": api_page(),
        "rig.schema.json": json.dumps(rig_schema(), indent=1) + "\n",
        "report.schema.json": json.dumps(report_schema(), indent=1) + "\n",
    }
