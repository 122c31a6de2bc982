"""Commands that are stopped at random moments: is what they leave whole, old or none?

Run as `python -m benchmarks.damage.kills`. Each of nine commands runs once unbroken,
into a folder of its own, with its programs compiled. Then it is begun again and again
over an earlier result and stopped by SIGINT or SIGTERM at a moment drawn by the seed,
anywhere in the time that it takes. At fault are

- an end later than `PATIENCE` after the signal, another exit status than 130 or 143 (or
  the signal's own, before the command has begun; or 0, after it is done), a traceback;
- files of two runs beside each other, a file that cannot be read, or one that is not
  the earlier result's nor the new one's, after what any later command does with the
  folder (`files.settle`);
- a last run, unbroken, that does not end in the same result as the first, or leaves
  drafts and locks behind.

`--kills` and `--commands` do less; what is printed is one row for each command.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PATIENCE = 5.0
"""Seconds from a signal to the end: `hydrojax.cli.GRACE`, and what writing may take."""

LOGS = ("damage/fit_1.csv", "damage/fit_2.csv", "--validate", "damage/validate.csv")
COMMANDS: Mapping[str, Sequence[str]] = {
    "export": ("reference.toml", "--to", "toml", "json", "mat", "modelica", "c"),
    "simulate": ("reference.toml", "--seconds", "2"),
    "excite": ("rig.toml", "--seconds", "2"),
    "identify": ("rig.toml", "log.csv", "--starts", "1"),
    "batch": ("jobs.csv", "--command", "identify", "--workers", "1", "--starts", "1"),
    "sweep": ("reference.toml", "--over", "k_p=0.5:2:3", "--over", "k_f=0.5:4:3"),
    "bounds": ("rig.toml", *LOGS[:2]),
    "tune": ("reference.toml", "--ensemble", "2", "--starts", "1"),
    "trace": ("rig.toml", *LOGS),
}
"""Words of each command, without `--out`; the quickest first."""

VARIES = {"made", "seconds", "date", "command_line"}
"""Keys of a result that two runs of one command do not share."""

Content = dict[str, bytes]


@dataclass
class Row:
    """What a command came to: seconds unbroken, how each kill ended, what is wrong."""

    seconds: float
    ends: Counter[str]
    left: Counter[str]
    slowest: float
    faults: list[str]


def inputs(folder: Path) -> None:
    """Rig files, logs and a table of jobs for all of the commands."""
    from hydrojax.paper.records import reference

    from .__main__ import sound

    folder.mkdir(parents=True, exist_ok=True)
    sound(folder)
    (folder / "reference.toml").write_text(reference()[0].text)
    rows = [f"{name},rig.toml,damage/{name}.csv," for name in ("fit_1", "fit_2")]
    (folder / "jobs.csv").write_text("\n".join(["job,rig,fit,validate", *rows]) + "\n")


def place_of(command: str, folder: Path) -> Path:
    """Where a command writes: a folder, or a file of its own folder."""
    out = folder / "out" / command
    return out / "log.csv" if command in ("simulate", "excite") else out


def begin(command: str, folder: Path) -> subprocess.Popen[str]:
    """The command, begun in a process of its own."""
    out = place_of(command, folder).relative_to(folder)
    words = [sys.executable, "-P", "-m", "hydrojax.cli", command, *COMMANDS[command]]
    return subprocess.Popen(
        [*words, "--out", str(out)], cwd=folder, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


def contents(command: str, folder: Path) -> Content:
    """A result's files as a later command finds them; parts of it are kept apart."""
    from hydrojax.report.files import settle

    out = folder / "out" / command
    if not out.is_dir():
        return {}
    settle(out)
    found = {p.name: p.read_bytes() for p in out.iterdir() if p.is_file()}
    unfinished = ("plan.json", "workers.log")  # marks and parts that runs go on from
    return {n: b for n, b in found.items() if n[0] != "." and n not in unfinished}


def said(name: str, content: bytes) -> Any:
    """What of a file two runs must share; raises where it cannot be read."""
    suffix = Path(name).suffix
    if suffix == ".json":
        return _bare(json.loads(content))
    if suffix == ".html":
        assert content.rstrip().endswith(b"</html>"), "cut"
    if suffix == ".png":
        assert content[-8:-4] == b"IEND", "cut"
    if suffix in (".html", ".png", ".mat", ".nc", ".parquet"):
        assert len(content) > 100, "empty"
        return None  # their dates and seconds differ
    return content


def _bare(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _bare(v) for k, v in value.items() if k not in VARIES}
    return [_bare(v) for v in value] if isinstance(value, list) else value


def fault_of(found: Content, old: Content, new: Content, resumes: bool) -> str:
    """Why what was left is neither nothing, nor the old result, nor the new; or ""."""
    if found == old or not found:
        return ""
    if set(found) != set(new) and not (resumes and set(found) < set(new)):
        return f"files {sorted(set(found) ^ set(new))} of another run"
    for name, content in found.items():
        if content == old.get(name) and said(name, content) != said(name, new[name]):
            return f"{name} is the old one beside new ones"
        try:
            if said(name, content) != said(name, new[name]):
                return f"{name} is not the new one"
        except (ValueError, AssertionError) as error:
            return f"{name} cannot be read: {error}"
    return ""


def stop(process: subprocess.Popen[str], after: float, number: int) -> tuple[str, str]:
    """Send a signal after some seconds: how the command ended, and its fault."""
    try:
        _, text = process.communicate(timeout=after)
    except subprocess.TimeoutExpired:
        process.send_signal(number)
    else:
        return "done", "" if process.returncode == 0 else f"fails: {text[-200:]}"
    sent = time.monotonic()
    try:
        _, text = process.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return "hangs", "does not end in 60 s"
    took, code = time.monotonic() - sent, process.returncode
    if code == -number:
        return "before it began", ""
    if code not in (0, 128 + number):
        return "stopped", f"exit {code}: {text[-200:]}"
    if "Traceback" in text:
        return "stopped", f"traceback: {text}"
    if took > PATIENCE:
        return "stopped", f"ends after {took:.1f} s"
    return "stopped" if code else "done", ""


def study(command: str, folder: Path, kills: int, seed: int) -> Row:
    """Run a command unbroken, kill it again and again, run it to its end."""
    r = random.Random(seed + zlib.crc32(command.encode()))
    out, kept = folder / "out" / command, folder / "old" / command
    seconds, text = 0.0, ""
    for _ in range(2):  # the first compiles
        shutil.rmtree(out, ignore_errors=True)
        began = time.monotonic()
        _, text = begin(command, folder).communicate()
        seconds = time.monotonic() - began
    new = contents(command, folder)
    row = Row(seconds, Counter(), Counter(), 0.0, [])
    if not new:
        row.faults.append(f"writes nothing: {text[-300:]}")
        return row
    shutil.rmtree(kept, ignore_errors=True)
    shutil.copytree(out, kept)
    resumes = command in ("sweep", "batch")
    for i in range(kills):
        if i % 2 == 0 or resumes:  # over nothing, or over an earlier result
            old: Content = {}
            if not resumes or i == 0:
                shutil.rmtree(out, ignore_errors=True)
        else:
            shutil.rmtree(out, ignore_errors=True)
            shutil.copytree(kept, out)
            old = contents(command, folder)
        number = (signal.SIGINT, signal.SIGTERM)[i // 2 % 2]
        after = r.uniform(0.0, 1.02) * seconds
        began = time.monotonic()
        end, fault = stop(begin(command, folder), after, number)
        row.slowest = max(row.slowest, time.monotonic() - began - after)
        row.ends[end] += 1
        found = contents(command, folder)
        row.left["nothing" if not found else "old" if found == old else "new"] += 1
        fault = fault or fault_of(found, old, new, resumes)
        if fault:
            row.faults.append(f"kill {i}, {number.name} at {after:.2f} s: {fault}")
    process = begin(command, folder)
    _, text = process.communicate()
    if process.returncode:
        row.faults.append(f"the last run fails: {text[-300:]}")
    fault = fault_of(contents(command, folder), {}, new, False)
    hidden = [p.name for p in out.rglob("*") if p.name.startswith(".")]
    row.faults += [f"the last run: {fault}"] if fault else []
    row.faults += [f"the last run leaves {hidden}"] if hidden else []
    return row


def main() -> None:
    """Stop the commands; exit 1 where one is at fault."""
    parser = argparse.ArgumentParser(description="Stop commands at random moments.")
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--commands", nargs="*", default=list(COMMANDS))
    parser.add_argument("--out", type=Path, default=Path("damage-kills"))
    given = parser.parse_args()
    inputs(given.out)
    print("| command | unbroken, s | ended | left | slowest end, s | at fault |")
    print("|---|---|---|---|---|---|")
    faults: list[str] = []
    for command in given.commands:
        row = study(command, given.out, given.kills, given.seed)
        ends, left = (
            ", ".join(f"{n} {what}" for what, n in sorted(c.items()))
            for c in (row.ends, row.left)
        )
        print(
            f"| {command} | {row.seconds:.1f} | {ends} | {left} | "
            f"{max(row.slowest, 0.0):.1f} | {len(row.faults)} |",
            flush=True,
        )
        for fault in row.faults:
            print(f"{command}: {fault}", file=sys.stderr, flush=True)
        faults += row.faults
    sys.exit(bool(faults))


if __name__ == "__main__":
    main()
