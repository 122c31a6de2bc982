"""Everything that reads a file or a word, on damaged ones: an answer, or one line.

Run as `python -m benchmarks.damage.readers --inputs 10000`. No fit is run, so thousands
of inputs take minutes. Each seed takes one of the sound samples (logs of every kind,
bags, rig files, reports, tables of jobs, results of fleets, chunks of sweeps, words of
the command line), damages it by bytes or by text, and reads it in a process of its own
with others. An input passes if it is read, or refused by an `InputError` of one line
that can be printed. At fault are other exceptions, a process that dies, more than
`SECONDS` of processor time, and more than `MEMORY`.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .mutations import BYTES, HARM, damaged_log, damaged_rig
from .samples import samples, write_bag_folder

SECONDS = 5.0
MEMORY = 2**30
BATCH = 500
"""Inputs that one process reads; one that dies costs the rest of its batch a start."""

NASTY = (
    b"\0", b"\xff" * 8, b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", b"[" * 3000,
    b"{" * 3000, b"9" * 3000, b"\n", b"\x1b[2J", b"NaN", b"-1", b"1e999", b"null",
    b"[]", b"{}", b'""',
    b"$\\frac{$", b"9^9^9^9", "²".encode(), *(text.encode() for text in HARM),
)  # fmt: skip


def damaged(content: bytes, r: random.Random) -> bytes:
    """Bytes with one to four damages."""
    for _ in range(r.choice((1, 1, 2, 4))):
        if len(content) < 2:
            return content
        if r.random() < 0.4:
            at = r.randrange(len(content))
            over = r.choice((0, 4, 8))
            content = content[:at] + r.choice(NASTY) + content[at + over :]
        else:
            content = r.choice(BYTES)(content, r)
    return content


# -- what reads them --


def read_log(path: Path) -> None:
    """A log; of a bag, the two fields of its messages."""
    from hydrojax.logs.log import Log
    from hydrojax.logs.tables import Channel

    places = {"u": ("/rig.u", "V"), "x": ("/rig.x", "mm")}
    bag = {n: Channel(column=c, unit=u) for n, (c, u) in places.items()}
    log = Log.load(path, bag if path.suffix == ".mcap" else None)
    assert np.all(np.diff(log.time) > 0) and log.name.isprintable()
    for start, stop in log.segments:
        for name, values in log.signals.items():
            assert name == "F_d" or np.isfinite(values[start:stop]).all()


def read_rig(path: Path) -> None:
    """A rig file, which can then be built and written again."""
    from hydrojax.rigfile.build import build_rig
    from hydrojax.rigfile.edit import rewrite
    from hydrojax.rigfile.schema import RigFile

    spec = RigFile.load(path)
    build_rig(spec)
    values = {n: 1.01 * e.start for n, e in spec.parameters.items()}
    RigFile.from_text(rewrite(spec, values))


def read_report(path: Path) -> None:
    """A report, as `--from` and `compare` read it."""
    from hydrojax.report import record

    record.read_report(path)


def read_table(path: Path) -> None:
    """A table of jobs, and the jobs' keys."""
    from hydrojax.workflows.fleet.jobs import read_jobs
    from hydrojax.workflows.fleet.work import Options, keys_of

    keys_of(read_jobs(path), Options())


def read_result(path: Path) -> None:
    """A result of a fleet: as it was stored, or none."""
    from hydrojax.workflows.fleet.store import Store

    folder = path.parent / "fleet"
    (folder / "jobs" / "ab").mkdir(parents=True, exist_ok=True)
    path.replace(folder / "jobs" / "ab" / "ab12.json")
    found = Store(folder).load("ab12")
    assert found is None or found["seconds"] == {"all": 1.0}


def read_chunk(path: Path) -> None:
    """A chunk of a sweep: as it was stored, or none."""
    from hydrojax.tune.chunks import Chunks

    chunks = Chunks(path.parent / "sweep", "question", "key")
    chunks.claim()
    place = path.parent / "sweep" / "parts" / "linear-4-key-00000.npz"
    place.parent.mkdir(exist_ok=True)
    path.replace(place)
    found = chunks.read("linear-4", 0)
    assert found is None or found["peak"].tolist() == [0.0, 1.0, 2.0, 3.0]


def read_plan(path: Path) -> None:
    """The mark of a sweep's folder."""
    from hydrojax.tune.chunks import Chunks

    folder = path.parent / "marked"
    folder.mkdir(exist_ok=True)
    path.replace(folder / "plan.json")
    Chunks(folder, "question", "key").claim()


@cache
def _of_words() -> list[Callable[[str], object]]:
    """What reads a word of the command line."""
    from hydrojax import units
    from hydrojax.cli import scenario, words
    from hydrojax.paper.records import reference
    from hydrojax.rigfile.controller import read_keys

    spec = reference()[0]
    return [
        lambda word: words.read_axes([word]),
        lambda word: words.read_point([word]),
        lambda word: words.read_columns([word]),
        lambda word: read_keys("--gains", words.read_gains([word]), spec),
        lambda word: scenario.read_inputs(spec, reference=word),
        lambda word: scenario.read_inputs(spec, motion=word),
        lambda word: units.split(word, "word"),
        lambda word: units.quantity(word, "Pa", "word"),
    ]


def read_words(path: Path) -> None:
    """Words of the command line, as many lines as there are."""
    from hydrojax.errors import InputError

    for line in path.read_text(errors="replace").splitlines():
        for read in _of_words():
            try:
                read(line)
            except InputError as error:
                if fault := _printable(error):
                    raise ValueError(fault) from error


@cache
def _setting() -> Any:
    from hydrojax.paper.records import reference
    from hydrojax.rigfile.quantities import open_setting

    return open_setting(reference()[0])


def read_findings(path: Path) -> None:
    """A folder of a report, as `--from` takes it: the plant that it found."""
    from hydrojax.tune.findings import Findings

    folder = path.parent / "trace"
    folder.mkdir(exist_ok=True)
    path.replace(folder / "report.json")
    Findings.load(folder).apply(_setting())


def read_bag_folder(path: Path) -> None:
    """A ROS 2 bag of which one file is damaged."""
    sound, folder = path.parent / "sound", path.parent / "ros2bag"
    if not sound.exists():
        write_bag_folder(sound)
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(sound, folder)
    path.replace(folder / path.name)
    from hydrojax.logs.log import Log
    from hydrojax.logs.tables import Channel

    bag = {"x": Channel(column="/rig.data", unit="mm")}
    Log.load(folder, bag)


WORDS = (
    b"k_p=0.2:4:48\nbeta=5e8:1e9:9:log\nload.mass=50 kg:300 kg:16\nv=0,0.01\n5 bar\n"
    b"sine:300 N,0.5 Hz\nto-and-fro:3 cm/s,3 s\nA_a=6 V*s,15 V*s\nu=MainU\n"
)

READERS: dict[str, tuple[str, Callable[[Path], None]]] = {
    **{name: (name, read_log) for name in (
        "log.csv", "log.csv.gz", "log.parquet", "log.mat", "zipped.mat", "log73.mat",
        "log.xlsx", "log.mcap")},
    "rig.toml": ("rig.toml", read_rig),
    "report.json": ("report.json", read_report),
    "from": ("report.json", read_findings),
    "metadata.yaml": ("bag/metadata.yaml", read_bag_folder),
    "bag.db3": ("bag/bag.db3", read_bag_folder),
    "jobs.csv": ("jobs.csv", read_table),
    "result": ("fleet/jobs/ab/ab12.json", read_result),
    "chunk": ("sweep/parts/linear-4-key-00000.npz", read_chunk),
    "plan.json": ("sweep/plan.json", read_plan),
    "words": ("", read_words),
}  # fmt: skip
"""Where the sound sample is, and what reads it, by the name of the damaged file."""


def one(seed: int, folder: Path, place: Path) -> tuple[str, str]:
    """Read the input of a seed: which it was, and its fault."""
    r = random.Random(seed)
    known = [n for n, (p, _) in READERS.items() if not p or (folder / p).exists()]
    name = r.choice(known)
    where, read = READERS[name]
    content = (folder / where).read_bytes() if where else WORDS
    if name == "log.csv" and r.random() < 0.5:
        content = damaged_log(content, r)[0]
    elif name == "rig.toml" and r.random() < 0.7:
        content = damaged_rig(content, r)[0]
    else:
        content = damaged(content, r)
    path = place / name
    path.write_bytes(content)
    return name, fault_of(read, path)


def fault_of(read: Callable[[Path], None], path: Path) -> str:
    """Why a file is neither read nor refused in one line; "" where it is."""
    from hydrojax.errors import InputError

    try:
        read(path)
    except InputError as error:
        return _printable(error)
    except MemoryError:
        return "MemoryError"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:100]}"
    return ""


def _printable(error: Exception) -> str:
    said = str(error)
    return "" if said.isprintable() and len(said) < 1500 else f"not one line: {said!r}"


def held() -> int:
    """Bytes that this process holds at the most, since this was last called."""
    lines = Path("/proc/self/status").read_text().splitlines()
    peak = next(1024 * int(s.split()[1]) for s in lines if s.startswith("VmHWM"))
    Path("/proc/self/clear_refs").write_text("5")  # start over
    return peak


def child(first: int, last: int, folder: Path) -> None:
    """Read the inputs of some seeds; a line of JSON for each as it ends."""
    import warnings

    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as place:
        for seed in range(first, last):
            print(json.dumps({"seed": seed}), flush=True)
            held()
            began = time.process_time()
            name, fault = one(seed, folder, Path(place))
            took, size = time.process_time() - began, held()
            if took > SECONDS and not fault:
                fault = f"{took:.1f} s"
            if size > MEMORY and not fault:
                fault = f"{size >> 20} MiB"
            done = {"seed": seed, "name": name, "fault": fault, "s": took, "b": size}
            print(json.dumps(done), flush=True)


def batch(first: int, last: int, folder: Path) -> list[dict]:
    """Have seeds read by a process, and by another where that one dies."""
    found: list[dict] = []
    while first < last:
        command = [sys.executable, "-P", "-m", __spec__.name, "--child", str(first),
                   str(last), "--out", str(folder)]  # fmt: skip
        limit = 60 + 2 * SECONDS * (last - first)
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=limit
            )
            said, why = done.stdout, f"exit {done.returncode}: {done.stderr[-200:]}"
        except subprocess.TimeoutExpired as late:
            said = late.stdout.decode() if isinstance(late.stdout, bytes) else ""
            why = "hangs"
        lines = [json.loads(line) for line in said.splitlines()]
        found += [line for line in lines if "name" in line]
        begun = max((line["seed"] for line in lines), default=first)
        if begun == last - 1 and lines[-1].get("name"):
            break
        found.append({"seed": begun, "name": "?", "fault": why, "s": 0.0, "b": 0})
        first = begun + 1
    return found


def main() -> None:
    """Read the inputs; exit 1 where one is at fault."""
    parser = argparse.ArgumentParser(description="Read damaged files and words.")
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="seed of the first input")
    parser.add_argument("--child", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=Path("damage-readers"))
    given = parser.parse_args()
    if given.child:
        child(*given.child, given.out)
        return
    given.out.mkdir(parents=True, exist_ok=True)
    samples(given.out)
    last, found = given.first + given.inputs, []
    for first in range(given.first, last, BATCH):
        part = batch(first, min(first + BATCH, last), given.out)
        for line in part:
            if line["fault"]:
                print(f"{line['seed']} {line['name']}: {line['fault']}", flush=True)
        found += part
    faults = [line for line in found if line["fault"]]
    for name, count in sorted(Counter(line["name"] for line in found).items()):
        print(f"{name}: {count}")
    slowest, largest = (max(line[key] for line in found) for key in ("s", "b"))
    print(
        f"{len(faults)} at fault of {len(found)}; slowest {slowest:.2f} s, largest "
        f"process {largest >> 20} MiB"
    )
    sys.exit(bool(faults))


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    main()
