"""Damaged files and words that are led by what they reach: fuzzing with coverage.

Run as `python -m benchmarks.damage.fuzz --inputs 10000`. It reads what
`benchmarks.damage.readers` reads, and holds it to the same: an answer, or one line, in
5 s of a processor and 1 GiB. There every input is a damaged sound sample; here one
that reaches lines of hydrojax in an order not seen before is kept, damaged again, and
spliced with others, and the words of the code that was reached are put into it. Each
kind of file has a process of its own, a seed, and as many inputs as the others; a
process that dies or hangs is a fault of the input that it had, and another goes on.

What is found goes to `--out`, by kind. `corpus.json` beside this file is the small part
of it that is kept: a run begins with it, and `--keep` writes it anew.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import hydrojax

from .doors import READERS, WORDS, fault_of, held
from .mutations import damaged_log, damaged_rig
from .readers import MEMORY, NASTY, SECONDS, damaged
from .samples import samples

CORPUS = Path(__file__).parent / "corpus.json"
HANG = 30
"""Seconds of a processor after which an input's process is ended, by SIGPROF."""
LARGEST = 1500
"""Bytes of an input that is kept in the repository."""
MOST = 12
"""Inputs of a kind that are kept there."""
HOUSE = str(Path(hydrojax.__file__).parent)


class Coverage:
    """Pairs of lines of hydrojax that ran one after the other, and words there."""

    def __init__(self) -> None:
        self.seen: set[int] = set()
        self.now: set[int] = set()
        self.codes: set[CodeType] = set()

    def __enter__(self) -> Coverage:
        self.now = set()
        sys.settrace(self._call)
        return self

    def __exit__(self, *_: object) -> None:
        sys.settrace(None)

    def _call(self, frame: FrameType, event: str, arg: object) -> Any:
        code = frame.f_code
        name = code.co_filename
        if not name.startswith(HOUSE):
            return None
        self.codes.add(code)
        at, before, now = hash((name, code.co_firstlineno)), 0, self.now

        def line(frame: FrameType, event: str, arg: object) -> Any:
            nonlocal before
            now.add(hash((at, before, frame.f_lineno)))
            before = frame.f_lineno
            return line

        return line

    def news(self) -> int:
        """How much of what was just reached had not been."""
        fresh = self.now - self.seen
        self.seen |= fresh
        return len(fresh)

    def words(self) -> list[bytes]:
        """Short texts in the code that was reached."""
        texts = (c for code in self.codes for c in code.co_consts)
        found = {t for t in texts if isinstance(t, str) and 0 < len(t) < 30}
        return sorted(t.encode("utf-8", "replace") for t in found)


def mutated(
    kind: str, pool: list[bytes], words: list[bytes], r: random.Random
) -> bytes:
    """Another input, from those that reached something new; the latest more often."""
    content = pool[max(r.randrange(len(pool)), r.randrange(len(pool)))]
    draw = r.random()
    if draw < 0.15:
        other = r.choice(pool)
        content = content[: r.randrange(len(content) + 1)]
        content += other[r.randrange(len(other) + 1) :]
    elif draw < 0.4 and words:
        for _ in range(r.choice((1, 1, 3))):
            at, over = r.randrange(len(content) + 1), r.choice((0, 0, 1, 4, 12))
            word = r.choice(words) if r.random() < 0.8 else r.choice(NASTY)
            content = content[:at] + word + content[at + over :]
    elif kind == "log.csv" and draw < 0.7:
        return damaged_log(content or b"\n", r)[0]
    elif kind == "rig.toml" and draw < 0.8:
        return damaged_rig(content or b"\n", r)[0]
    else:
        content = damaged(content or b"\n", r)
    return content[: 2**22]


def kept(path: Path = CORPUS) -> dict[str, list[bytes]]:
    """The corpus in the repository, by kind."""
    if not path.exists():
        return {}
    table = json.loads(path.read_text())
    return {k: [base64.b64decode(text) for text in own] for k, own in table.items()}


def child(kind: str, first: int, last: int, folder: Path) -> None:
    """Read the inputs of some numbers; a line of JSON as each begins and ends."""
    import resource
    import warnings

    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_DATA, (4 * MEMORY, 4 * MEMORY))
    where, read = READERS[kind]
    found = folder / "found" / kind
    found.mkdir(parents=True, exist_ok=True)
    pool = [(folder / where).read_bytes() if where else WORDS, *kept().get(kind, [])]
    pool += [p.read_bytes() for p in sorted(found.iterdir())]
    coverage, r = Coverage(), random.Random(f"{kind} {first}")
    begun = list(pool)
    with tempfile.TemporaryDirectory() as place:
        for number in range(first - len(begun), last):
            warm = number < first  # what the corpus reaches is known
            words = coverage.words()
            content = begun.pop() if warm else mutated(kind, pool, words, r)
            path = Path(place) / kind
            path.write_bytes(content)
            (folder / f"now-{kind}").write_bytes(content)
            print(json.dumps({"number": number}), flush=True)
            held()
            began = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, 0 if warm else HANG)
            with coverage:
                fault = fault_of(read, path)
            signal.setitimer(signal.ITIMER_PROF, 0)
            took, size = time.process_time() - began, held()
            if not warm and took > SECONDS and not fault:
                fault = f"{took:.1f} s"
            if not warm and size > MEMORY and not fault:
                fault = f"{size >> 20} MiB"
            news = coverage.news()
            if news and not warm:
                pool.append(content)
                (found / f"{number:06d}-{news}").write_bytes(content)
            if fault:
                (folder / f"fault-{kind}-{number}").write_bytes(content)
            line = {
                "number": number,
                "fault": fault,
                "news": news,
                "s": took,
                "b": size,
            }
            print(json.dumps(line), flush=True)


def fuzz(kind: str, count: int, folder: Path) -> list[dict[str, Any]]:
    """Have so many inputs of a kind read, by process after process."""
    done: list[dict[str, Any]] = []
    first = 0
    while first < count:
        command = [sys.executable, "-P", "-m", __spec__.name, "--child", kind,
                   str(first), str(count), "--out", str(folder)]  # fmt: skip
        with (folder / f"log-{kind}").open("wb") as log:
            ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=log)
        lines = [json.loads(line) for line in _whole(ran.stdout)]
        done += [line for line in lines if "fault" in line and line["number"] >= 0]
        begun = lines[-1]["number"] if lines else first
        if lines and begun == count - 1 and "fault" in lines[-1]:
            break
        fault = {"number": begun, "fault": f"exit {ran.returncode}", "news": 0}
        done.append({**fault, "s": 0.0, "b": 0})
        source = folder / f"now-{kind}"
        if source.exists():
            source.rename(folder / f"fault-{kind}-{begun}")
        first = max(begun, first) + 1
    return done


def _whole(text: bytes) -> Iterator[str]:
    for line in text.decode().splitlines():
        if line.endswith("}"):
            yield line


def keep(folder: Path) -> None:
    """Write `corpus.json`: of each kind the small inputs that reached most."""
    table = {}
    for kind in READERS:
        own = [p for p in (folder / "found" / kind).glob("*")]
        own = [p for p in own if 0 < p.stat().st_size <= LARGEST]
        own.sort(key=lambda p: -int(p.name.partition("-")[2]))
        best = [p.read_bytes() for p in own[:MOST]]
        if best:
            table[kind] = [base64.b64encode(c).decode() for c in best]
    CORPUS.write_text(json.dumps(table, indent=0) + "\n")


def main() -> None:
    """Read the inputs; exit 1 where one is at fault."""
    parser = argparse.ArgumentParser(description="Fuzz what reads files and words.")
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--kinds", nargs="*", default=list(READERS))
    parser.add_argument("--keep", action="store_true", help="write corpus.json anew")
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=Path("damage-fuzz"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.child:
        kind, first, last = given.child
        child(kind, int(first), int(last), given.out)
        return
    samples(given.out)
    kinds = [k for k in given.kinds if not READERS[k][0]
             or (given.out / READERS[k][0]).exists()]  # fmt: skip
    each, found = -(-given.inputs // len(kinds)), []
    print(
        "| read | inputs | reached something new | slowest, s | largest, MiB | faults |"
    )
    print("|---|---|---|---|---|---|")
    for kind in kinds:
        own = fuzz(kind, each, given.out)
        found += own
        faults = [line for line in own if line["fault"]]
        print(
            f"| {kind} | {len(own)} | {sum(1 for x in own if x['news'])} | "
            f"{max(x['s'] for x in own):.2f} | {max(x['b'] for x in own) >> 20} | "
            f"{len(faults)} |",
            flush=True,
        )
        for line in faults:
            print(f"{kind} {line['number']}: {line['fault']}", flush=True)
    faults = sum(1 for line in found if line["fault"])
    print(f"{faults} at fault of {len(found)}")
    if given.keep:
        keep(given.out)
    sys.exit(bool(faults))


if __name__ == "__main__":
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    os.environ["PYTHONHASHSEED"] = "0"
    main()
