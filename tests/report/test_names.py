"""Names that pictures and the terminal would take for more than names."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

from hydrojax.cli.options import console
from hydrojax.errors import InputError, one_line
from hydrojax.report.page import as_png
from hydrojax.report.text import in_picture

HARM = [r"$\frac{$", "$", "$$", r"a $\foo$ b", r"\$", "a_b^{c", "[/x]", "[bold]", ":x:"]


@pytest.mark.parametrize("name", HARM)
def test_a_picture_takes_any_name(name):
    figure = Figure(figsize=(1, 1))
    figure.suptitle(in_picture(name))
    assert as_png(figure, 20).startswith(b"\x89PNG")


def test_pictures_escape_the_names_of_rigs_and_logs():
    """Where a figure shows a name, by its source: `tests/tune` draws such a rig."""
    import inspect

    from hydrojax.identify.report import residuals
    from hydrojax.tune import display, maps, plots

    for module, shown in (
        (residuals, "in_picture(s.log)"), (residuals, "in_picture(loop.log)"),
        (display, "in_picture(t.name)"), (maps, "in_picture(data.attrs['rig'])"),
        (plots, "in_picture(data.attrs['rig'])"),
    ):  # fmt: skip
        assert shown in inspect.getsource(module)


@pytest.mark.parametrize("name", HARM)
def test_the_terminal_shows_any_name(capsys, name):
    console.print(f"report in {name}", soft_wrap=True)
    assert capsys.readouterr().out == f"report in {name}\n"


@pytest.mark.parametrize(
    "text", ["a\nb", "a\x1b[2Jb", "a\u202eb", "a\ud800b", "\x00", "a\u2028b"]
)
def test_an_error_is_one_line_that_can_be_printed(text):
    said = str(InputError(f"{text}: no such file"))
    assert said.isprintable() and said.encode() and len(said.splitlines()) == 1


def test_an_error_is_not_a_megabyte():
    said = one_line("a" * 10**6 + "; mend it")
    assert len(said) < 1300 and said.endswith("; mend it")
    assert one_line("plain µ · ±") == "plain µ · ±"
    assert np.char.isalpha(one_line("äöü"))


OUT = r"""
import sys
from hydrojax import cli
from hydrojax.cli.options import console

@cli.app.command()
def show(name: str):
    console.print(f"report in {name}", soft_wrap=True)

cli.main()
"""


def test_a_folder_whose_name_is_no_text_is_shown():
    done = subprocess.run(
        [sys.executable, "-c", OUT, "show", b"a\xff[/x]b"], capture_output=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == b"report in a\\udcff[/x]b\n"
