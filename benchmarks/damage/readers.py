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
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from .doors import READERS, WORDS, fault_of, held
from .mutations import BYTES, HARM, damaged_log, damaged_rig
from .samples import samples

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
        first, last = given.child
        child(first, last, given.out)
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
