"""Rig files and logs that lie: what is told of a case, and what `check` says of it.

`python -m benchmarks.trace.lies FOLDER` takes cases that were recorded before (the
folders of `python -m benchmarks.trace --out`), tells lies of those in which nothing is
hidden, and prints how many are called by their name; and of every case as it is, how
often an input is blamed that is right. With `--traced N` it traces N of these lies
instead, and prints what the trace made of each; with `--every` too, of cases in which
something is hidden, and prints whether it was named beside the lie.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

Told = tuple[str, list[Any]]
"""The text of a rig file, and logs."""


@dataclass(frozen=True)
class Lie:
    """One lie.

    Attributes:
        name: its kind.
        told: a rig file's text and logs with the lie in them.
        inputs: one of these has to be blamed.
        findings: for one of these reasons.
    """

    name: str
    told: Callable[[str, list[Any]], Told]
    inputs: tuple[str, ...]
    findings: tuple[str, ...]


def _signals(change: Callable[[dict[str, Any]], dict[str, Any]]):
    """A lie of the logs' signals."""

    def told(text: str, logs: list[Any]) -> Told:
        return text, [
            replace(log, signals=log.signals | change(log.signals)) for log in logs
        ]

    return told


def _times(factor: float, *names: str):
    return _signals(lambda s: {n: factor * s[n] for n in names})


def _late(name: str, seconds: float):
    """A signal that shows what was some time ago."""

    def told(text: str, logs: list[Any]) -> Told:
        def late(log: Any) -> dict[str, Any]:
            t = np.asarray(log.time)
            return {name: np.interp(t - seconds, t, log.signals[name])}

        return text, [replace(g, signals=g.signals | late(g)) for g in logs]

    return told


def _exchanged(one: str, other: str):
    return _signals(lambda s: {one: s[other], other: s[one]})


def _value(key: str, factor: float):
    """A lie of a plain quantity of the rig file."""

    def told(text: str, logs: list[Any]) -> Told:
        def changed(m: re.Match[str]) -> str:
            return f'{m[1]}"{float(m[2]) * factor:.6g} '

        new, count = re.subn(rf'(?m)^({key} = )"([^ "]+) ', changed, text)
        assert count == 1, key
        return new, logs

    return told


def _without(*keys: str):
    """A rig file that leaves constants out."""

    def told(text: str, logs: list[Any]) -> Told:
        kept = [
            line
            for line in text.splitlines()
            if not line.startswith(tuple(f"{k} = " for k in keys))
        ]
        return "\n".join(kept) + "\n", logs

    return told


def lies_of(layout: str, motion: str) -> list[Lie]:
    """Every lie that can be told of a rig of this layout, logged with this motion."""
    areas = ("area",) if layout == "pull-pull" else ("area_1", "area_2")
    P, every = ("P_a1", "P_a2"), ("P_a1", "P_a2", "P_s")
    valve = ("c_p1", "c_n1", "c_p2", "c_n2")
    coulomb = ("k_cp", "k_cn")
    friction = (*coulomb, "k_0", "k_vp", "k_vn", "k_fp", "k_fn", "z_ss", "delta")
    out = []
    for area in areas:
        for f in (1.02, 0.98):
            out.append(
                Lie(f"{area} {f - 1:+.0%}", _value(area, f), (*areas, "F"), ("factor",))
            )
    for f in (1.1, 0.9):
        out.append(Lie(f"P_s {f - 1:+.0%}", _times(f, "P_s"), ("P_s",), ("factor",)))
    for name in ("u", "F", motion, *P):
        out.append(Lie(f"{name} turned round", _times(-1.0, name), (name,), ("sign",)))
    out.append(Lie("pressures turned round", _times(-1.0, *P), P, ("sign",)))
    out.append(Lie("pressures exchanged", _exchanged(*P), P, ("exchanged",)))
    if motion == "psi":
        for what, f in (
            ("degrees for radians", 180 / np.pi),
            ("radians for degrees", np.pi / 180),
        ):
            out.append(Lie(what, _times(f, motion), (motion,), ("unit",)))
    for what, names, f in (
        ("MPa for bar", every, 10.0),
        ("bar for MPa", every, 0.1),
        ("MPa for bar, chambers", P, 10.0),
        ("bar for MPa, chambers", P, 0.1),
        ("bar for Pa", every, 1e5),
    ):
        out.append(Lie(what, _times(f, *names), names, ("unit",)))
    for what, f in (("kN for N", 1e3), ("N for kN", 1e-3)):
        out.append(Lie(what, _times(f, "F"), ("F",), ("unit",)))
    for ms in (1, 5, 20):
        lie = _late(motion, 1e-3 * ms)
        out.append(Lie(f"{motion} {ms} ms late", lie, (motion,), ("delay",)))
    for name in (*P, "F"):
        for f in (10.0, 0.1):
            out.append(
                Lie(f"noise of {name} x{f:g}", _value(name, f), (name,), ("noise",))
            )
    out.append(Lie("valve left out", _without(*valve), valve, ("left out",)))
    out.append(Lie("friction left out", _without(*friction), friction, ("left out",)))
    out.append(Lie("k_cp, k_cn left out", _without(*coulomb), coulomb, ("left out",)))
    return out


def named(found: Sequence[Any], lie: Lie) -> bool:
    """Whether one of the findings is the lie."""
    return any(
        set(f.input.split(", ")) & set(lie.inputs) and f.finding in lie.findings
        for f in found
    )


# -- the table --


def _case(folder: Path, style: str = "fit*") -> Told:
    """A recorded case's rig file, and its logs to fit or of another style."""
    from hydrojax.logs.log import Log
    from hydrojax.rigfile.schema import RigFile

    rig = RigFile.load(folder / "rig.toml")
    logs = [Log.load(p, rig.channels) for p in sorted(folder.glob(f"{style}.csv*"))]
    return rig.text, logs


def _checked(text: str, logs: list[Any]) -> Any:
    from hydrojax import api
    from hydrojax.rigfile.schema import RigFile

    return api.check(RigFile.from_text(text), logs)


def _hides(folder: Path) -> tuple[str, ...] | None:
    """What a case hides; None where it is nothing that has a name, or is not known."""
    if not (folder / "truth.json").exists():
        return None
    truth = json.loads((folder / "truth.json").read_text())
    return None if truth["kind"] == "outside" else tuple(truth["effects"])


def _aliases(folder: Path) -> set[str]:
    """Inputs that a hidden effect of the case is an exact alias of."""
    if not (folder / "truth.json").exists():
        return set()
    effects = json.loads((folder / "truth.json").read_text())["effects"]
    return set().union(*(ALIASES.get(name, ()) for name in effects))


def honest(folders: Sequence[Path]) -> list[tuple[str, str, float]]:
    """Of each case as it is: its name, what is blamed wrongly, and seconds."""
    rows = []
    for folder in folders:
        text, logs = _case(folder)
        began = time.perf_counter()
        found = _checked(text, logs).found
        spent = time.perf_counter() - began
        wrong = [
            f"{f.input}: {f.finding}" for f in found if f.input not in _aliases(folder)
        ]
        rows.append((folder.name, "; ".join(wrong), spent))
    return rows


def _lies(text: str, logs: Sequence[Any]) -> list[Lie]:
    """Every lie of a case."""
    motion = "x" if "x" in logs[0].signals else "psi"
    layout = "pull-pull" if 'layout = "pull-pull"' in text else "differential"
    return lies_of(layout, motion)


ALIASES = {"loadcell_gain": {"area", "area_1", "area_2", "F"}}
"""Inputs that an effect looks just like; the report says so wherever it is named."""


def told(folder: Path) -> Iterator[tuple[Lie, Any]]:
    """Every lie of a case, and what `check` found."""
    text, logs = _case(folder)
    for lie in _lies(text, logs):
        yield lie, _checked(*lie.told(text, logs))


@dataclass(frozen=True)
class Traced:
    """What the trace made of a lie.

    Attributes:
        case: the folder's name.
        lie: its name.
        named: whether an input is blamed that lies, for the right reason.
        verdict: of the trace, or the line that refused it.
        effects: the names it gave.
        aliased: whether one of them looks just like an input that lies.
        hidden: what the case hides beside it.
    """

    case: str
    lie: str
    named: bool
    verdict: str
    effects: tuple[str, ...] = ()
    aliased: bool = False
    hidden: tuple[str, ...] = ()

    @property
    def fooled(self) -> bool:
        """Whether it ends well by an effect that is not there, without a word of it."""
        alone = not (self.named or self.aliased)
        false = {*self.effects} - {*self.hidden}
        return self.verdict == "explained" and bool(false) and alone


def traced(folders: Sequence[Path], number: int) -> Iterator[Traced]:
    """Traces of so many lies, each of the next case by turns."""
    import hydrojax as hj
    from hydrojax.errors import InputError
    from hydrojax.rigfile.schema import RigFile

    for i in range(number):
        folder = folders[i % len(folders)]
        text, logs = _case(folder)
        lies = _lies(text, logs)
        lie = lies[i % len(lies)]
        own, fit = lie.told(text, logs)
        _, check = lie.told(text, _case(folder, "validate")[1])
        try:
            out = hj.trace(RigFile.from_text(own), fit, validate=check)
        except InputError as error:
            words = set(re.findall(r"\w+", str(error)))
            blamed = bool(words & set(lie.inputs))
            yield Traced(folder.name, lie.name, blamed, f"refused: {error}")
            continue
        outcome = out.outcome
        names = tuple(e.name for e in outcome.effects)
        hidden = _hides(folder) or ()
        yield Traced(
            folder.name,
            lie.name,
            named(outcome.inputs, lie),
            outcome.verdict,
            names,
            any(ALIASES.get(n, set()) & set(lie.inputs) for n in {*names} - {*hidden}),
            hidden,
        )


def _print_traced(rows: Iterator[Traced]) -> None:
    done = []
    for row in rows:
        effects = ", ".join(row.effects) or "-"
        effects += f" of {', '.join(row.hidden)}" if row.hidden else ""
        blamed = "blamed" if row.named else "not blamed"
        print(
            f"{row.case}, {row.lie}: {blamed}, {row.verdict}, named {effects}",
            flush=True,
        )
        done.append(row)
    blamed, fooled = (sum(r.named for r in done), sum(r.fooled for r in done))
    print(f"Of {len(done)} lies traced {blamed} are blamed; {fooled} end `explained`")
    print("by an effect that is not there, without a word of the input that lies.")
    exact = sum({*r.effects} == {*r.hidden} for r in done)
    print(f"In {exact} the effects named are those that the case hides, or none.")


def main(
    folder: Annotated[list[Path], typer.Argument(help="folders of recorded cases")],
    every: Annotated[
        bool, typer.Option(help="lies of cases that hide something, too")
    ] = False,
    most: Annotated[int, typer.Option(help="cases of which lies are told")] = 12,
    to_trace: Annotated[
        int, typer.Option("--traced", help="lies to trace, and nothing else")
    ] = 0,
) -> None:
    """Print how many lies are called by name, and what is blamed wrongly."""
    from hydrojax.jax_setup import ensure_jax

    ensure_jax()
    places = sorted(p.parent for root in folder for p in root.rglob("rig.toml"))
    if to_trace:
        kept = [p for p in places if (_hides(p) if every else _hides(p) == ())]
        _print_traced(traced(kept, to_trace))
        return
    rows = honest(places)
    blamed = [(name, wrong) for name, wrong, _ in rows if wrong]
    slow = sorted(spent for *_, spent in rows)
    print(f"Honest cases: {len(rows)}; an input is blamed wrongly in {len(blamed)}.\n")
    for name, wrong in blamed:
        print(f"- {name}: {wrong}")
    print(f"\nSeconds a check: median {np.median(slow):.2f}, worst {slow[-1]:.2f}.\n")
    bare = [p for p in places if every or _hides(p) == ()]
    score: dict[str, list[bool]] = {}
    missed: dict[str, list[str]] = {}
    for place in bare[:: max(len(bare) // most, 1)][:most]:
        for lie, found in told(place):
            hit = named(found.found, lie)
            score.setdefault(lie.name, []).append(hit)
            if not hit:
                missed.setdefault(lie.name, []).append(place.name)
    hits, of = (sum(f(v) for v in score.values()) for f in (sum, len))
    print(f"Lies: {hits} of {of} called by name ({hits / max(of, 1):.1%}).\n")
    print("| lie | called | missed in |\n|---|---|---|")
    for name, own in sorted(score.items(), key=lambda item: np.mean(item[1])):
        print(f"| {name} | {sum(own)}/{len(own)} | {', '.join(missed.get(name, ()))} |")


if __name__ == "__main__":
    typer.run(main)
