"""What reads a file or a word, and what is wrong with how it does."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from .samples import write_bag_folder


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
