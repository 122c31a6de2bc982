"""Damaged logs and rig files: does every one of them get a right answer, or one line?

Run as `python -m benchmarks.damage --cases 1000`. A sound rig and log are recorded by
the tracing benchmark's plant, each case damages one of them in one to three ways drawn
by its own seed, and `hydrojax identify` runs on it. A case passes if the command

- refuses it: exit 2, one line, nothing written; or
- fits it: exit 0, a whole report that is strict JSON, nothing written elsewhere, and
  what it says is right: each parameter is within 10 % of the truth, or its interval
  holds it, or it is said not to be identified; or the verdict is `unknown`.

Anything else is printed with its seed, and so are fits that are wrong without a word.
`--only SEED` runs one case again and keeps its files.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import random
import shutil
import signal
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from .mutations import damaged_log, damaged_rig

FREE = ("beta", "c_p1", "k_cp")
"""What is fitted; the rest of the rig is known."""
SECONDS = 3.0
PATIENCE = 180
"""Seconds after which a run hangs: its programs may have to be compiled first, on a
machine that does other work."""


@dataclass(frozen=True)
class Found:
    """What a case came to: `fault` is "" where it passed."""

    seed: int
    damages: str
    how: str
    fault: str
    said: str


def sound(folder: Path) -> dict[str, float]:
    """A rig file with `FREE` to fit, and its log, in a folder; returns their truth."""
    from benchmarks.trace import cases

    spec = cases.CaseSpec("damage", "nothing")
    if not (folder / "damage" / "truth.json").exists():
        cases.write_cases([spec], folder, seconds=SECONDS)
    truth = json.loads((folder / "damage" / "truth.json").read_text())
    known = {n: v for n, v in truth["rig"].items() if n not in FREE}
    text = cases.rig_file("damage", truth | {"held": truth["held"] | known})
    (folder / "rig.toml").write_text(text)
    shutil.copy(folder / "damage" / "fit_1.csv", folder / "log.csv")
    return truth["rig"]


class Hangs(BaseException):
    """A run has had its time."""


def _stop(*_: object) -> None:
    raise Hangs


def run(*words: object) -> tuple[int | None, str]:
    """The command line in this process: exit status (None: a traceback), and stderr."""
    from hydrojax import cli

    out, err = io.StringIO(), io.StringIO()
    before, sys.argv = sys.argv, ["hydrojax", *map(str, words)]
    signal.signal(signal.SIGALRM, _stop)
    signal.alarm(PATIENCE)
    code: int | None = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.main()
    except SystemExit as end:
        code = int(end.code or 0)
    except Hangs:
        return None, f"hangs: more than {PATIENCE} s"
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)
        sys.argv = before
    return code, err.getvalue()


def judge(
    place: Path, before: set[Path], code: int | None, err: str, truth: dict[str, float]
) -> tuple[str, str]:
    """How a case ended, and its fault."""
    out = place / "out"
    after = {p for p in place.parent.rglob("*") if out not in (p, *p.parents)}
    if stray := after - before:
        return "wrote elsewhere", f"wrote {min(stray)}"
    if code == 2:
        lines = err.strip().splitlines()
        if len(lines) != 1:
            return "refused", f"{len(lines)} lines on stderr"
        if out.exists():
            return "refused", "wrote something all the same"
        return "refused", ""
    if code != 0:
        return "failed", f"exit {code}"
    try:
        text = (out / "report.json").read_text()
        report = json.loads(text, parse_constant=_no_number)
    except (OSError, ValueError) as error:
        return "fitted", f"report.json: {error}"
    if "<script>alert(1)" in (out / "report.html").read_text():
        return "fitted", "what the input says is markup in report.html"
    fitted = {n: v for n, v in report["parameters"].items() if n in truth}
    wrong = [n for n, v in fitted.items() if not _right(v, truth[n])]
    if not wrong:
        return "fitted, right", ""
    if report["verdict"] == "unknown":
        return "fitted, said not to fit", ""
    return "fitted, wrong", f"says nothing, but {', '.join(wrong)} are wrong"


def _no_number(word: str) -> float:
    raise ValueError(f"{word} is no JSON")


def _right(parameter: dict, truth: float) -> bool:
    value, interval = parameter["value"], parameter.get("interval")
    if abs(value - truth) <= 0.1 * abs(truth):
        return True
    if not parameter["identified"]:
        return True
    return bool(interval) and interval[0] <= truth <= interval[1]


def one(seed: int, folder: Path, truth: dict[str, float], keep: bool = False) -> Found:
    """Damage the log or the rig file by this seed, run, judge."""
    r = random.Random(seed)
    place = folder / f"case_{seed}"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    rig, log = (folder / "rig.toml").read_bytes(), (folder / "log.csv").read_bytes()
    if r.random() < 0.5:
        log, said = damaged_log(log, r)
        which = "log"
    else:
        rig, said = damaged_rig(rig, r)
        which = "rig"
    (place / "rig.toml").write_bytes(rig)
    (place / "log.csv").write_bytes(log)
    before = set(folder.rglob("*"))
    given = (place / "rig.toml", place / "log.csv", "--out", place / "out")
    code, err = run("identify", *given, "--starts", 1)
    how, fault = judge(place, before, code, err, truth)
    if not keep and not fault:
        shutil.rmtree(place)
    last = err.strip().splitlines()[-1:] or [""]
    return Found(seed, f"{which}: {', '.join(said)}", how, fault, last[0])


def main() -> None:
    """Run the cases; exit 1 where one has a fault."""
    parser = argparse.ArgumentParser(description="Run hydrojax on damaged input.")
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first case")
    parser.add_argument("--only", type=int, help="run the case of this seed, keep it")
    parser.add_argument("--out", type=Path, default=Path("damage-benchmark"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    truth = sound(given.out)
    seeds = range(given.first, given.first + given.cases)
    if given.only is not None:
        seeds = [given.only]
    counts: Counter[str] = Counter()
    faults, slowest = 0, 0.0
    for i, seed in enumerate(seeds):
        began = time.perf_counter()
        found = one(seed, given.out, truth, given.only is not None)
        took = time.perf_counter() - began
        slowest = max(slowest, took)
        counts[found.how] += 1
        if found.fault or given.only is not None:
            faults += bool(found.fault)
            print(f"{seed} {found.damages} | {found.how}: {found.fault} | {found.said}")
        if sys.stderr.isatty() or i % 100 == 99:
            print(
                f"\r{i + 1}/{len(seeds)}, {faults} at fault ", end="", file=sys.stderr
            )
    for how, count in counts.most_common():
        print(f"{how}: {count}")
    print(f"{faults} at fault of {len(seeds)}; slowest {slowest:.1f} s")
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
