"""Cases: rigs with a known truth, their rig files, and their logs on disk.

A case's name says what it is, and seeds it: the same name is the same case. Kinds:
`nothing` (the declared model is whole), `parameters` (whole, but the rig file starts
far off), `effect` (one hidden effect at 0.3, 1 or 3 times a size that matters), `pair`
(two), `outside` (one that no vocabulary names), `noise` (nothing but unusual sensor
noise), `shift` (another load mass and supply pressure on the validation log). Not in
the mix: `large` (one effect as large as the field's literature has it), `differential`
(a cylinder with its rod on one side) and `coarse` (an encoder of 17 bits in place of
23), each with one effect or nothing by turns; `several` (three to six effects, each of
any size from one that matters to the largest of the literature); `unnamed` (more laws
outside the vocabulary, first all at three times the size that shows, then at once).
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations, count
from pathlib import Path

import numpy as np

from .catalogue import ALL, LARGEST, LATER, NAMED, OUTSIDE, SIZES, UNNAMED, largest
from .excitation import NOISE, STYLES
from .plant import MASS, Lane
from .record import Log, record

MIXED = ("nothing", "parameters", "effect", "pair", "outside", "noise", "shift")
KINDS = (*MIXED, "large", "differential", "coarse", "several", "later", "unnamed")
LOGS = tuple(f"{style}.csv" for style in STYLES)

RANGES = {  # name: (unit, lower end, upper end)
    "beta": ("Pa", 1e8, 3e9),
    **{c: ("m^3/(s*V*Pa^0.5)", 2e-10, 2e-8) for c in ("c_p1", "c_n1", "c_p2", "c_n2")},
    **{d: ("m", 0.0, 0.05) for d in ("delta_1", "delta_2")},
    **{k: ("N", 0.0, 4000.0) for k in ("k_cp", "k_cn")},
    "k_0": ("N", -800.0, 800.0),
    **{k: ("N*s/m", -3e4, 3e4) for k in ("k_vp", "k_vn")},
    **{k: ("1", 0.0, 3.0) for k in ("k_fp", "k_fn")},
    "z_ss": ("m", 2e-6, 5e-4),
    "delta": ("1/N", 1e-4, 1e-2),
}
COLUMNS = {  # signal: (unit, SI value of it, format)
    "time": ("s", 1.0, "%.3f"),
    "u": ("V", 1.0, "%.6f"),
    "psi": ("rad", 1.0, "%.9f"),
    "x": ("mm", 1e-3, "%.7f"),
    **{p: ("bar", 1e5, "%.5f") for p in ("P_a1", "P_a2", "P_s")},
    **{f: ("N", 1.0, "%.4f") for f in ("F", "F_d")},
}


@dataclass(frozen=True)
class CaseSpec:
    """What a case is before anything is simulated.

    Attributes:
        name: unique; it seeds the case.
        effects: hidden effects by name, each with its size.
        noise: the sensors' kind of noise.
        shifted: another load mass and supply pressure on the validation log.
        error: how far the rig file's starts may be off, relative.
        layout: of the cylinder, as the rig file has it.
        bits: of the encoder, on a turn.
    """

    name: str
    kind: str
    effects: Mapping[str, float] = field(default_factory=dict)
    noise: str = "white"
    shifted: bool = False
    error: float = 0.1
    layout: str = "pull-pull"
    bits: int = 23

    @property
    def seed(self) -> int:
        """Seed of all that is drawn for this case."""
        return zlib.crc32(self.name.encode())


def plan(
    number: int, more: Mapping[str, int] | None = None, named: Sequence[str] = ()
) -> list[CaseSpec]:
    """The first `number` cases of the benchmark, kinds mixed, and more of some kinds.

    Args:
        number: how many.
        more: how many of a kind there are to be, those of the mix counted.
        named: effects to hide in `effect` and `pair` cases; all of the vocabulary's
            if empty. Effects that the tested library does not know belong left out.

    Raises:
        KeyError: no such kind.
    """
    names = list(named) or list(NAMED)
    makers: dict[str, Iterator[CaseSpec]] = {
        "nothing": (CaseSpec(f"nothing-{i}", "nothing") for i in count()),
        "parameters": (
            CaseSpec(f"parameters-{i}", "parameters", error=(0.25, 0.4)[i % 2])
            for i in count()
        ),
        "effect": _effects(names),
        "pair": _pairs(names),
        "outside": _outside(),
        "noise": _noises(),
        "shift": _shifts(names),
        "large": _large(names),
        "differential": _by_turns(
            # Without an angle in the log no weight can turn with it.
            "differential",
            [n for n in names if n != "gravity_load"],
            layout="differential",
        ),
        "coarse": _by_turns("coarse", names, bits=17),
        "several": _several(names),
        "later": _later(),
        "unnamed": _unnamed(),
    }
    more = dict(more or {})
    if unknown := sorted(set(more) - set(makers)):
        raise KeyError(f"no such kind of case: {unknown[0]!r}; known: {list(makers)}")
    # Of every 12: what is rare in one pass comes round in the next.
    turn = (
        "effect", "nothing", "effect", "outside", "effect", "parameters",
        "effect", "pair", "effect", "nothing", "noise", "shift",
    )  # fmt: skip
    kinds = [turn[i % len(turn)] for i in range(number)]
    for kind, count_of in more.items():
        kinds += [kind] * (count_of - kinds.count(kind))
    return [next(makers[kind]) for kind in kinds]


def _effects(names: Sequence[str]) -> Iterator[CaseSpec]:
    """Every effect, at a size of its own each time round: three rounds are all."""
    for i in count():
        for j, name in enumerate(names):
            size = SIZES[(i + j + 1) % len(SIZES)]
            case = f"effect-{name}-{size:g}-{i // len(SIZES)}"
            yield CaseSpec(case, "effect", {name: size})


def _large(names: Sequence[str]) -> Iterator[CaseSpec]:
    for i in count():
        for name in names:
            yield CaseSpec(f"large-{name}-{i}", "large", {name: LARGEST})


def _later() -> Iterator[CaseSpec]:
    for i in count():
        size = (*SIZES, LARGEST)[i % (len(SIZES) + 1)]
        for name in LATER:
            yield CaseSpec(f"later-{name}-{size:g}-{i}", "later", {name: size})


def _by_turns(
    kind: str, names: Sequence[str], bits: int = 23, layout: str = "pull-pull"
) -> Iterator[CaseSpec]:
    """Nothing missing and one effect by turns."""
    for i in count():
        for j, name in enumerate(names):
            number = i * len(names) + j
            for case, effects in (
                (f"{kind}-nothing-{number}", {}),
                (f"{kind}-{name}-{i}", {name: 1.0}),
            ):
                yield CaseSpec(case, kind, effects, layout=layout, bits=bits)


def _pairs(names: Sequence[str]) -> Iterator[CaseSpec]:
    both = [
        p for p in combinations(names, 2) if not (ALL[p[0]].known or ALL[p[1]].known)
    ]
    for i in count():
        order = np.random.default_rng(i).permutation(len(both))
        for a, b in (both[j] for j in order):
            yield CaseSpec(f"pair-{a}+{b}-{i}", "pair", {a: 1.0, b: 1.0})


def _several(names: Sequence[str]) -> Iterator[CaseSpec]:
    """Sets of three, five, four and six effects by turns."""
    plain = [n for n in names if not ALL[n].known]
    for i in count():
        rng = np.random.default_rng([i, *b"several"])
        chosen = rng.choice(plain, (3, 5, 4, 6)[i % 4], replace=False)
        tops = {str(n): max(largest(str(n))[0], 1.0) for n in chosen}
        drawn = {n: np.exp(rng.uniform(0.0, np.log(top))) for n, top in tops.items()}
        sizes = {n: float(f"{size:.3g}") for n, size in drawn.items()}
        yield CaseSpec(f"several-{len(chosen)}-{i}", "several", sizes)


def _outside() -> Iterator[CaseSpec]:
    for i in count():
        for name in OUTSIDE:
            yield CaseSpec(f"outside-{name}-{i}", "outside", {name: 1.0})


def _unnamed() -> Iterator[CaseSpec]:
    """As `benchmarks.trace.discover` has them, of which each is of kind `outside`."""
    for i in count():
        for size in SIZES[::-1]:
            for name in UNNAMED:
                case = f"outside-{name}-{size:g}" + (f"-{i}" if i else "")
                yield CaseSpec(case, "outside", {name: size})


def _noises() -> Iterator[CaseSpec]:
    for i in count():
        for noise in ("coloured", "quantised", "heavy-tailed"):
            yield CaseSpec(f"noise-{noise}-{i}", "noise", noise=noise)


def _shifts(names: Sequence[str]) -> Iterator[CaseSpec]:
    """Nothing missing and one effect by turns, under other load and supply."""
    for i in count():
        yield CaseSpec(f"shift-nothing-{i}", "shift", shifted=True)
        name = names[i % len(names)]
        yield CaseSpec(f"shift-{name}-{i}", "shift", {name: 1.0}, shifted=True)


# -- from a case to files --


def draw_rig(seed: int, layout: str = "pull-pull") -> dict[str, float]:
    """True values, SI, of a random rig near the paper's."""
    rng = np.random.default_rng([seed, 0])
    spans = {
        "beta": (6.5e8, 1.1e9),
        **dict.fromkeys(("delta_1", "delta_2"), (8e-3, 25e-3)),
        **dict.fromkeys(("k_cp", "k_cn"), (700.0, 1400.0)),
        "k_0": (-100.0, 100.0),
        **dict.fromkeys(("k_vp", "k_vn"), (2000.0, 5000.0)),
        **dict.fromkeys(("k_fp", "k_fn"), (0.5, 1.0)),
        "z_ss": (45e-6, 80e-6),
        "delta": (1 / 1100, 1 / 700),
    }
    lands = 2.2e-9 * rng.uniform(0.85, 1.2) * np.exp(rng.uniform(-0.12, 0.12, 4))
    area = 1.18e-3
    fixed = {"area_1": area, "area_2": area}
    if layout == "differential":
        fixed["area_1"] = area * float(rng.uniform(0.55, 0.85))
    fixed |= {"chamber_length": 0.2, "radius": 0.085, "P_r": 2.5e5}
    edges = dict(zip(("c_p1", "c_n1", "c_p2", "c_n2"), lands.tolist(), strict=True))
    return fixed | edges | {n: float(rng.uniform(*s)) for n, s in spans.items()}


def nominal_rig(rig: Mapping[str, float], seed: int, error: float) -> dict[str, float]:
    """What a rig file would say: values off by up to `error`, offsets not known."""
    rng = np.random.default_rng([seed, 1])
    off = {n: float(1 + rng.uniform(-error, error)) for n in RANGES}
    guess = {n: float(f"{v * off.get(n, 1.0):.4g}") for n, v in rig.items()}
    return guess | {"delta_1": 0.015, "delta_2": 0.015, "k_0": 0.0}


def lanes_of(spec: CaseSpec) -> tuple[list[Lane], dict]:
    """The case's three lanes, and the truth that goes to truth.json."""
    rig = draw_rig(spec.seed, spec.layout)
    nominal = nominal_rig(rig, spec.seed, spec.error)
    effects = {n: ALL[n].scaled(size) for n, size in spec.effects.items()}
    held = {}
    for name in spec.effects:
        for parameter, value in ALL[name].known.items():
            held[parameter] = rig[parameter] if value is None else value
    rig |= held
    # The controller is tuned to a rig some 10 % off, whatever the rig file says.
    tuned = nominal_rig(rig, spec.seed, 0.1)
    lanes = []
    for style in STYLES:
        moved = spec.shifted and style == "validate"
        lanes.append(
            Lane(
                rig,
                tuned,
                effects,
                spec.seed,
                style,
                spec.noise,
                mass=2.0 * MASS if moved else MASS,
                supply=11e6 if moved else 14e6,
                bits=spec.bits,
            )
        )
    truth = {
        "case": spec.name,
        "kind": spec.kind,
        "sizes": dict(spec.effects),
        "noise": spec.noise,
        "shifted": spec.shifted,
        "layout": spec.layout,
        "bits": spec.bits,
        "rig": {n: v for n, v in rig.items() if n in RANGES},
        "effects": effects,
        "held": held,
        "start": nominal,
    }
    return lanes, truth


def rig_file(name: str, truth: Mapping, extra: str = "") -> str:
    """The rig file of a case, TOML; `extra` is appended (declared effects)."""
    nominal = truth["start"]
    geometry = {
        "pull-pull": {"area": "area_1", "radius": "radius"},
        "differential": {"area_1": "area_1", "area_2": "area_2"},
    }[truth["layout"]]
    geometry |= {"chamber_length": "chamber_length"}
    lines = [
        f'name = "{name}"\nlayout = "{truth["layout"]}"\n\n[geometry]',
        *(
            f'{key} = "{nominal[n]} {"m^2" if "area" in key else "m"}"'
            for key, n in geometry.items()
        ),
        f'\n[supply]\nP_s = "1.4e+07 Pa"\nP_r = "{nominal["P_r"]:g} Pa"',
        "\n[sensors]",
        *(f'{c} = "{NOISE[c]:g} {"N" if c == "F" else "Pa"}"' for c in NOISE),
        "\n[parameters]",
    ]
    for parameter, (unit, *ends) in RANGES.items():
        if parameter in truth["held"]:
            lines.append(f'{parameter} = "{truth["held"][parameter]!r} {unit}"')
            continue
        start, *span = (f"{v:g} {unit}" for v in (nominal[parameter], *ends))
        bounds = json.dumps(span)
        lines.append(f'{parameter} = {{ start = "{start}", range = {bounds} }}')
    return "\n".join(lines) + "\n" + extra


def write_log(path: Path, log: Log) -> None:
    """The log as CSV, in the units of COLUMNS."""
    columns = {n: column for n, column in COLUMNS.items() if n in log}
    header = ",".join(f"{name} [{unit}]" for name, (unit, *_) in columns.items())
    table = np.column_stack([log[n] / size for n, (_, size, _) in columns.items()])
    formats = [form for *_, form in columns.values()]
    np.savetxt(path, table, formats, ",", header=header, comments="")


LOST = 0.1
"""Share of the ticks with the command at its end from which nobody would take a log of
several effects: what it then shows is a limit cycle."""


def _full(log: Log) -> float:
    most = np.max(np.abs(log["u"]))
    return float(np.mean(np.abs(log["u"]) >= most)) if most > 0 else 0.0


def write_cases(
    specs: Sequence[CaseSpec],
    folder: Path,
    declare: Callable[[Sequence[str]], str] | None = None,
    seconds: float = 12.0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, str]:
    """Record cases side by side, a folder each: rig files, logs and truth.json.

    Args:
        specs: the cases.
        folder: where their folders go.
        declare: the TOML that declares effects, by name, with ranges; without it no
            oracle.toml is written. Effects outside the vocabulary have none anyway.
        seconds: length of each log.
        progress: called with the ticks done and their total number.

    Returns:
        Reasons by name of the cases that could not be recorded.
    """
    made = [lanes_of(spec) for spec in specs]
    logs = record(
        [lane for lanes, _ in made for lane in lanes], seconds, progress=progress
    )
    bad = {}
    for i, (spec, (_, truth)) in enumerate(zip(specs, made, strict=True)):
        own = logs[3 * i : 3 * i + 3]
        if not all(np.isfinite(y).all() for log in own for y in log.values()):
            bad[spec.name] = "the rig ran away while it was recorded"
            continue
        if spec.kind == "several" and any(_full(log) > LOST for log in own):
            bad[spec.name] = "the loop lost the rig: its command stands at its end"
            continue
        place = folder / spec.name
        place.mkdir(parents=True, exist_ok=True)
        (place / "rig.toml").write_text(rig_file(spec.name, truth))
        if declare and spec.effects and not set(spec.effects) & {*OUTSIDE, *UNNAMED}:
            text = rig_file(spec.name, truth, declare(list(spec.effects)))
            (place / "oracle.toml").write_text(text)
        for file, log in zip(LOGS, own, strict=True):
            if spec.layout == "differential":  # its sensor is along the stroke
                log = log | {"x": truth["start"]["radius"] * log["psi"]}
                del log["psi"]
            write_log(place / file, log)
        # Last: a folder with its truth is a whole one.
        (place / "truth.json").write_text(json.dumps(truth, indent=2) + "\n")
    return bad
