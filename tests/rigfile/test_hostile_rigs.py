"""Rig files that say what no rig can have, or are made to do harm."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from hydrojax.effects import load_effects
from hydrojax.errors import InputError
from hydrojax.paper.records import reference
from hydrojax.rigfile.schema import RigFile

TEXT = reference()[0].text


def refusal(path: Path, *words: str) -> str:
    began = time.process_time()
    with pytest.raises(InputError) as caught:
        RigFile.load(path)
    line = str(caught.value)
    assert time.process_time() - began < 2
    assert line.isprintable() and len(line) < 1300 and path.name in line
    assert all(word in line for word in words)
    return line


RANGED = '{ start = "5 kg", range = ["1 kg", "9 kg"] }'


@pytest.mark.parametrize(
    "lines, words",
    [
        ('[load]\nmass = "-5 kg"\n', ("[load] mass", "above 0")),
        ('[load]\nmass = "5 kg"\ndamping = "-1 N*s/m"\n', ("[load] damping",)),
        ('[load]\nmass = "5 kg"\nstiffness = "-1 N/m"\n', ("[load] stiffness",)),
        ('[load]\nmass = "5 kg"\nsecond_mass = "1 kg"\n', ("needs second_stiffness",)),
        ('[load]\nsecond_stiffness = "1 N/m"\n', ("needs second_mass",)),
        (f"[load]\nmass = {RANGED}\n", ("mass has a range", 'add predicts = "x"')),
        (f"[load]\nF = {RANGED}\n", ("[load] F is known",)),
        (
            f'[load]\npredicts = "x"\nmass = {RANGED.replace("1 kg", "0 kg")}\n',
            ("mass range must be above 0",),
        ),
        ('[supply]\nP_r = "-1 Pa"\n', ("[supply] P_r", "at least 0")),
        ('[supply]\nP_s = "-5 Pa"\nP_r = "-9 Pa"\n', ("[supply] P_s",)),
    ],
)
def test_what_no_rig_has(tmp_path, lines, words):
    kept = [p for p in TEXT.split("\n\n") if not p.startswith(("[load]", "[supply]"))]
    path = tmp_path / "rig.toml"
    path.write_text("\n\n".join([*kept, lines]))
    refusal(path, *words)


HARM = {
    "deep lists": "x = " + "[" * 50_000,
    "deep tables": "x = " + "{a = " * 50_000,
    "digits": TEXT + f"[controller]\nk_p = {'9' * 5000}\n",
    "fewer digits": TEXT + f"[controller]\nk_p = {'9' * 4000}\n",
    "a unit to compute": TEXT + '[load]\nmass = "5 kg*9^(9*9*9*9*9*9*9*9)"\n',
    "endless blanks": TEXT + f'[load]\nmass = "5 {" " * 90_000}x"\n',
    "a key with a line break": TEXT + '[load]\n"ma\\nss\\u001b[2J" = "5 kg"\n',
    "a long key": TEXT + f'[load]\n{"m" * 500_000} = "5 kg"\n',
    "a long value": TEXT + f'[load]\nmass = "{"m" * 500_000}"\n',
    "an escape in the name": TEXT.replace("name =", 'name = "a\\u001b[2J" #', 1),
    "a long name": TEXT.replace("name =", f'name = "{"a" * 500}" #', 1),
    "megabytes": TEXT + "#" * 2**20,
}


@pytest.mark.parametrize("what", HARM)
def test_a_rig_file_made_to_do_harm(tmp_path, what):
    path = tmp_path / "rig.toml"
    path.write_text(HARM[what])
    refusal(path)


def test_what_is_no_regular_file(tmp_path):
    os.mkfifo(tmp_path / "rig.toml")
    refusal(tmp_path / "rig.toml", "regular file")
    refusal(Path("/dev/zero"), "regular file")
    with pytest.raises(InputError, match="cannot be read"):
        RigFile.load("a\0b.toml")
    with pytest.raises(InputError, match="regular file"):
        load_effects("/dev/zero")


@pytest.mark.parametrize("ends", ["import sys\nsys.exit(0)", "raise SystemExit"])
def test_an_effect_file_that_ends_the_program_is_refused(tmp_path, ends):
    (tmp_path / "own.py").write_text(ends)
    with pytest.raises(InputError, match=r"own\.py: line \d: SystemExit"):
        load_effects(tmp_path / "own.py")
