"""`python -m benchmarks.speed`: time all groups, and print what was found."""

from __future__ import annotations

import datetime
import hashlib
import importlib
import json
import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from . import build_c, table
from .cold import fresh
from .measured import Section

GROUPS = ("loop", "sweep", "replay", "identify", "trace", "scaling")
ROOT = Path(__file__).parent.parent.parent
PACKAGES = (
    "jax", "jaxlib", "numpy", "scipy", "numba", "diffrax", "optimistix", "casadi",
)  # fmt: skip
SOURCES = ("hydrojax", "identify", "tune", "benchmarks/speed", "benchmarks/trace")


def machine() -> dict[str, Any]:
    """What the figures depend on besides the code."""
    versions = {"Python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    cc = build_c.compiler()
    if cc is not None:
        versions["C"] = build_c.version(cc)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {
        "processor": _processor(),
        "device": fresh("cold:device", {})["device"],
        "cores": os.cpu_count() or 1,
        "memory_gib": round(memory, 1),
        "system": platform.platform(),
        "versions": versions,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    model = next((x for x in lines if x.startswith("model name")), ": ?")
    wide = " with AVX-512" if any("avx512f" in x for x in lines) else ""
    return model.partition(":")[2].strip() + wide


def code() -> str:
    """The program's sources in a few letters."""
    seen = hashlib.sha256()
    for folder in SOURCES:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.suffix in (".py", ".c", ".h", ".toml"):
                seen.update(path.read_bytes())
    return seen.hexdigest()[:12]


def read(path: Path) -> dict[str, Any]:
    """What is known; nothing, if the file is not there or was torn."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {"groups": {}}


def write(out: Path, data: dict[str, Any], section: Section) -> None:
    """`speed.json`, `speed.md` and a section's plots, whole or not at all."""
    from hydrojax.report.files import write_all

    order = {g: data["groups"][g] for g in GROUPS if g in data["groups"]}
    data["groups"] = order
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    files = {"speed.json": text.encode(), "speed.md": table.report(data).encode()}
    write_all(out, files | section.plots)


def keep(data: dict[str, Any], group: str, section: Section, key: dict) -> None:
    """Put a section among the groups, with when and on what it was measured."""
    data["groups"][group] = {
        **key,
        "when": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "rows": section.rows,
        "figures": section.figures,
        "notes": section.notes,
        "points": section.points,
        "plots": list(section.plots),
    }


def main(
    quick: Annotated[bool, typer.Option(help="small sizes, a few minutes")] = False,
    only: Annotated[
        list[str] | None, typer.Option(help=f"a group: {', '.join(GROUPS)}")
    ] = None,
    out: Annotated[Path, typer.Option(help="folder of results")] = Path(
        "speed-benchmark"
    ),
    again: Annotated[bool, typer.Option(help="run groups that are done too")] = False,
) -> None:
    """Time hydrojax beside its peers; write speed.json, speed.md and plots.

    A group that is done, on this machine, with this code and in this mode, is not run
    again.
    """
    for name in only or ():
        if name not in GROUPS:
            raise typer.BadParameter(f"{name!r} is none of {', '.join(GROUPS)}")
    console = Console(stderr=True)
    data = read(out / "speed.json")
    key = {"quick": quick, "code": code(), "machine": machine()}
    for group in only or GROUPS:
        known = data["groups"].get(group, {})
        if not again and all(known.get(k) == v for k, v in key.items()):
            console.print(f"{group}: done on {known['when']}")
            continue
        with console.status(group) as status:

            def progress(what: str, group: str = group, status: Any = status) -> None:
                status.update(f"{group}: {what}")

            work = importlib.import_module(f"{__package__}.{group}")
            section = work.run(quick, progress)
        keep(data, group, section, key)
        write(out, data, section)
        console.print(f"{group}: written to {out / 'speed.json'}")
    print(table.report(data))


if __name__ == "__main__":
    typer.run(main)
