"""Findings on inputs in words: what looks wrong, and the line to write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from hydrojax import units
from hydrojax.identify.checking.balances import FLOW, NOT_NEGATIVE, OFFSETS
from hydrojax.identify.checking.factors import Delay, Factor, LeftOut, Zero
from hydrojax.identify.checking.inputs import Inputs
from hydrojax.identify.checking.lines import (
    Lines,
    columns,
    exchanged,
    known,
    resized,
    scaled,
    turned,
    written,
)
from hydrojax.identify.checking.regression import solved
from hydrojax.identify.checking.search import INCH, POUND, PSI, Mend, Trial
from hydrojax.identify.checking.sensors import (
    CLIPPED,
    DEAD,
    READINGS,
    SENSORS,
    STUCK,
    VACUUM,
)
from hydrojax.identify.preparation.strays import MAY_STRAY
from hydrojax.logs.tables import SIGNALS
from hydrojax.parameters import Spec
from hydrojax.rigfile.edit import text
from hydrojax.rigfile.schema import RigFile

NOISE = (1 / 6, 7.0)
"""Ratios of a channel's noise to the stated one beyond which that is called: a slip of
ten, less what colour takes from the differences and a lively force adds to them."""

NO_SUPPLY = 20.0
"""Times its noise up to which a supply's readings are 0: the noise, and a zero that is
off by some per cent of a range."""

SLOWEST = 5e-3
"""Seconds of a step beyond which differences are of the signal and not of its noise."""

SLIPS: Mapping[str, Sequence[tuple[float, str, str]]] = {
    "Pa": (
        (0.1, "MPa", "bar"), (10.0, "bar", "MPa"), (1e-2, "bar", "kPa"),
        (1e2, "kPa", "bar"), (1e-3, "kPa", "Pa"), (1e3, "Pa", "kPa"),
        (1e-5, "bar", "Pa"), (1e5, "Pa", "bar"), (1e-6, "MPa", "Pa"),
        (1e6, "Pa", "MPa"), (PSI / 1e5, "bar", "psi"), (1e5 / PSI, "psi", "bar"),
        (PSI / 1e3, "kPa", "psi"), (PSI / 1e6, "MPa", "psi"), (PSI, "Pa", "psi"),
    ),
    "N": (
        (1e-3, "kN", "N"), (1e3, "N", "kN"), (9.80665, "N", "kgf"),
        (POUND, "N", "lbf"), (1 / POUND, "lbf", "N"),
    ),
    "rad": ((np.pi / 180, "rad", "deg"), (180 / np.pi, "deg", "rad")),
    "m": ((1e-3, "m", "mm"), (1e3, "mm", "m"), (1e-2, "m", "cm"), (0.1, "cm", "mm"),
          (INCH, "mm", "in"), (1 / INCH, "in", "mm")),
    "{u}": ((1e-3, "V", "mV"), (1e-2, "1", "percent")),
    "m^2": ((1e-6, "m^2", "mm^2"), (1e-4, "m^2", "cm^2"), (1e-2, "cm^2", "mm^2")),
}  # fmt: skip
"""Units that are read for another: the factor that mends it, the unit that was read,
and the unit that it is."""


@dataclass(frozen=True)
class Finding:
    """An input that looks wrong.

    Attributes:
        input: a signal, or a key of the rig file; several are joined by commas.
        finding: `sign`, `exchanged`, `unit`, `delay`, `held`, `zero`, `factor`,
            `left out`, `noise`, `stray`, `stuck`, `clipped` or `vacuum`.
        factor: what the input is to be multiplied by; None where that mends nothing.
        error: RMS of the balance that shows it, as given; None where none does.
        error_if_mended: the same with the input mended.
        unit: of both: Pa for the flow's balance, N for the force's.
        says: what looks wrong, and the line to write.
        lines: that line, by section and key of the rig file; empty where none mends it.
        mended: whether what the report says is of the mended input.
        effects: that do the same to the logs, by name.
    """

    input: str
    finding: str
    factor: float | None
    error: float | None
    error_if_mended: float | None
    unit: str
    says: str
    lines: Lines = field(default_factory=dict)
    mended: bool = False
    effects: tuple[str, ...] = ()


def stiffness(of: Inputs) -> float:
    """Pressure that a volume of oil makes in a chamber at mid-stroke, Pa/m^3."""
    soft = solved(of.flow, FLOW, NOT_NEGATIVE).values["beta"]
    volume = float(np.mean(of.geometry.chambers)) * of.geometry.length / 2
    return 1 / max(soft, 1e-10) / volume


def of_mend(mend: Mend, before: Trial, after: Trial, of: Inputs) -> Finding:
    """An input turned round, exchanged or in another unit."""
    by_force = mend.inputs == ("F",) or not of.has_flow
    errors = (before.force_error, after.force_error)
    if not by_force:
        errors = (
            before.flow_error * after.stiffness,
            after.flow_error * after.stiffness,
        )
    known = of.has_force or of.has_flow
    says, lines = _SAYS[mend.finding](mend, of)
    return Finding(
        ", ".join(mend.inputs),
        mend.finding,
        mend.factor,
        # In another unit what is left has another size: it would not compare.
        errors[0] if known and mend.finding != "unit" else None,
        errors[1] if known else None,
        "N" if by_force else "Pa",
        says,
        lines,
    )


Said = tuple[str, Lines]
"""What looks wrong, and the lines that mend it."""


def _says_sign(mend: Mend, of: Inputs) -> Said:
    names = " and ".join(mend.inputs)
    also = {
        "u": ", or the valve's ports are exchanged, which is the same",
        "psi": ", or all else is", "x": ", or all else is",
    }.get(mend.inputs[0], "")  # fmt: skip
    run = "runs" if len(mend.inputs) == 1 else "run"
    lines = turned(of.spec, mend.inputs)
    return f"{names} {run} against the rig's sign{also}: write {written(lines)}", lines


def _says_exchanged(mend: Mend, of: Inputs) -> Said:
    one, other = mend.inputs
    lines = exchanged(of.spec, one, other)
    return f"{one} and {other} are exchanged: write {written(lines)}", lines


def _says_unit(mend: Mend, of: Inputs) -> Said:
    names, f = " and ".join(mend.inputs), mend.factor
    start, spec = f"{names}: values are {_size(f)}", of.spec
    logged = [n for n in mend.inputs if n in of.logged]
    lines = resized(spec, [n for n in mend.inputs if n not in logged], f)
    if not logged:
        return f"{start}: write {written(lines)}", lines
    slips = [p for p in SLIPS[SIGNALS[logged[0]]] if np.isclose(p[0], f, rtol=1e-3)]
    if not slips:
        lines = {**scaled(spec, logged, f), **lines}
        return f"{start}: write {written(lines)}", lines
    # Which unit a column without one here was read in is not known: a factor is true.
    own = {spec.channels[n].unit if n in spec.channels else None for n in logged}
    _, read, is_ = next((p for p in slips if own == {p[1]}), slips[0])
    again = own == {read}
    own_lines = columns(spec, logged, unit=is_) if again else scaled(spec, logged, f)
    lines = {**own_lines, **lines}
    return f"{start}, as {is_} read for {read} is: write {written(lines)}", lines


def _size(factor: float) -> str:
    """How far off a value is that is to be multiplied by a factor."""
    if factor < 1:
        return f"{1 / factor:.3g} times too large"
    return f"{factor:.3g} times too small"


_SAYS = {"sign": _says_sign, "exchanged": _says_exchanged, "unit": _says_unit}


def _percent(factor: float, more: str, less: str) -> str:
    off = 100 * (1 / factor - 1)
    return f"{abs(off):.2g} % {more if off > 0 else less}"


def of_supply(found: Factor, of: Inputs) -> Finding:
    """A supply pressure off by a factor."""
    found = replace(found, factor=float(f"{found.factor:.4g}"))
    off = _percent(found.factor, "too high", "too low")
    if "P_s" in of.logged:
        lines = scaled(of.spec, ["P_s"], found.factor)
        why = " (the gauge's span, or a gauge elsewhere than at the valve)"
    else:
        lines, why = resized(of.spec, ["P_s"], found.factor), ""
    size = stiffness(of.scaled("P_s", found.factor))
    return Finding(
        "P_s", "factor", found.factor, size * found.given, size * found.mended, "Pa",
        f"P_s is {off}: write {written(lines)}{why}", lines,
    )  # fmt: skip


def supply_like_gains(
    spec: RigFile, logged: bool, factor: float, force: bool
) -> Finding:
    """A supply pressure off by a factor, where what was found says that of all sensors.

    Args:
        spec: the rig file.
        logged: whether the logs have the supply pressure.
        factor: that brings it right.
        force: whether the load cell is among the sensors.
    """
    factor = float(f"{factor:.4g}")
    lines = (scaled if logged else resized)(spec, ["P_s"], factor)
    all_read, effects = "P_a1 and P_a2 both read", ("pressure_sensor_gain",)
    if force:
        all_read = "P_a1, P_a2 and F all read"
        effects = (*effects, "loadcell_gain")
    says = (
        f"P_s is {_percent(factor, 'too high', 'too low')}: write {written(lines)}; "
        f"or, as these logs cannot tell, {all_read} "
        f"{_percent(1 / factor, 'too much', 'too little')} ({', '.join(effects)})"
    )
    return Finding(
        "P_s", "factor", factor, None, None, "", says, lines, effects=effects
    )


def of_zero(found: Zero, of: Inputs) -> Finding:
    """A position whose zero is off."""
    name, spec = of.motion, of.spec
    if name == "x":
        mid = float(f"{spec.geometry.get('x_mid', 0.0) + found.off:.5g}")
        tolerance = spec.tolerances.get("x_mid", 0.0)
        lines: Lines = {"geometry": {"x_mid": known(mid, "m", tolerance)}}
    else:
        own = {}
        for n, way in zip(OFFSETS, (1.0, -1.0), strict=True):
            old = spec.parameters[n]
            moved = float(f"{old.start + way * found.off:.4g}")
            own[n] = known(moved, "m", old.tolerance)
        lines = {"parameters": own}
    way = "beyond" if found.off > 0 else "short of"
    says = (
        f"the zero of {name} lies {1e3 * abs(found.off):.3g} mm {way} mid-stroke, "
        f"as delta_1 and delta_2 are declared: write {written(lines)}"
    )
    size = stiffness(of)
    errors = (size * found.given, size * found.mended)
    return Finding(name, "zero", None, *errors, "Pa", says, lines)


def of_delay(found: Delay, of: Inputs) -> Finding:
    """A position, or one of the gauges, that is late."""
    size = stiffness(of.brought_forward(found.input, found.seconds))
    errors = (size * found.given, size * found.mended)
    name = of.motion if found.input == "x" else found.input
    late = Finding(name, "delay", None, *errors, "Pa", "")
    return with_delay(late, of.spec, of.spec, found.seconds)


def late_position(spec: RigFile, name: str, seconds: float) -> Finding:
    """A position that is late by so many seconds, where no balance shows it."""
    late = Finding(name, "delay", None, None, None, "", "")
    return with_delay(late, spec, spec, seconds)


def command_between(spec: RigFile) -> Finding:
    """A command that runs on between rows."""
    lines = columns(spec, ["u"], held=False)
    says = (
        "u runs on from row to row, and is not held until the next one: write "
        f"{written(lines)}"
    )
    return Finding("u", "held", None, None, None, "", says, lines)


def with_delay(late: Finding, given: RigFile, spec: RigFile, more: float) -> Finding:
    """The finding of a late position or gauge, with how late it is.

    Args:
        late: the finding.
        given: the rig file in which nothing is mended.
        spec: the rig file, in which other delays may stand already.
        more: later than in `spec`, s.
    """
    name = late.input
    was, now = (
        s.channels[name].late if name in s.channels else 0.0 for s in (given, spec)
    )
    ms = float(f"{1e3 * (now + more):.3g}")
    lines = columns(spec, [name], delay=text(ms, "ms"))
    beside = {"P_a1": "P_a2", "P_a2": "P_a1"}.get(name, "the pressures")
    by = ms - 1e3 * was
    how = "late" if by > 0 else "early"
    why = "a slow bus, or a filter" if by > 0 else "all else comes by a slower bus"
    says = (
        f"{name} is {abs(by):.2g} ms {how} beside {beside} ({why}): write "
        f"{written(lines)}"
    )
    return replace(late, lines=lines, says=says)


def of_force(found: Factor, of: Inputs) -> Finding:
    """An area, a gauge or the load cell off by a factor."""
    name, f = found.input, found.factor
    geometry = of.spec.geometry
    same: tuple[str, ...] = ("pressure_sensor_gain",)
    if name in geometry:
        same = ("loadcell_gain", *same)
        lines = resized(of.spec, [name], f)
        gauge = {"area": "both pressures", "area_1": "P_a1", "area_2": "P_a2"}[name]
        says = (
            f"{name} is {_percent(f, 'too large', 'too small')}: write "
            f"{written(lines)}; or, as these "
            f"logs cannot tell, F is {_percent(1 / f, 'too large', 'too small')} "
            f"(effect loadcell_gain), or {gauge} {_percent(f, 'too high', 'too low')} "
            "(effect pressure_sensor_gain)"
        )
    elif name == "F":
        same = ("loadcell_gain",)
        lines = scaled(of.spec, [name], float(f"{1 / f:.4g}"))
        says = (
            f"F is {_percent(1 / f, 'too large', 'too small')} (effect loadcell_gain): "
            f"write {written(lines)}; or, as these logs cannot tell, both areas "
            f"are {_percent(f, 'too large', 'too small')}"
        )
        f = 1 / f
    else:
        lines = scaled(of.spec, [name], float(f"{f:.4g}"))
        says = (
            f"{name} is {_percent(f, 'too high', 'too low')}: write "
            f"{written(lines)} (the gauge's span; effect pressure_sensor_gain)"
        )
    errors = (found.given, found.mended)
    return Finding(name, "factor", f, *errors, "N", says, lines, effects=same)


def of_left_out(
    out: LeftOut, unit: str, scale: float, known: Mapping[str, Spec], of: Inputs
) -> Finding:
    """Constants that the rig file leaves out."""
    unit_of = of.spec.command_unit
    entries = {n: _entry(v, known[n], unit_of) for n, v in out.values.items()}
    lines, names = {"parameters": entries}, ", ".join(out.values)
    return Finding(
        names, "left out", None, scale * out.given, scale * out.mended, unit,
        f"{names} stand at defaults that these logs contradict, as the rig file leaves "
        f"them out: write {written(lines)}", lines,
    )  # fmt: skip


def _entry(value: float, spec: Spec, command: str) -> dict[str, Any]:
    """A parameter with a range about a value."""
    unit = units.with_command(spec.unit, command)
    ends = (-4 * abs(value), 4 * abs(value))
    if spec.lower >= 0:
        ends = (value / 10 if spec.lower > 0 else 0.0, 10 * abs(value))
    low, high = (min(max(e, spec.lower), spec.upper) for e in ends)
    start = min(max(value, spec.lower), spec.upper)
    own = [text(float(f"{v:.3g}"), unit) for v in (start, low, high)]
    return {"start": own[0], "range": own[1:]}


def of_noise(of: Inputs, noise: Mapping[str, float]) -> list[Finding]:
    """Stated noise that the logs contradict; `noise` is theirs, by channel, SI."""
    out = []
    for name, stated in of.spec.sensors.items():
        ratio = noise.get(name, stated) / stated
        if of.h > SLOWEST or not ratio or NOISE[0] < ratio < NOISE[1]:
            continue
        unit = units.with_command(SIGNALS[name], of.spec.command_unit)
        lines = {"sensors": {name: text(float(f"{noise[name]:.3g}"), unit)}}
        size = (
            f"{1 / ratio:.3g} times too large"
            if ratio < 1
            else f"{ratio:.3g} times too small"
        )
        filtered = ", unless the channel was smoothed" if ratio < 1 else ""
        says = (
            f"the noise stated for {name} is {size}{filtered}: write {written(lines)}"
        )
        out.append(Finding(name, "noise", ratio, None, None, unit, says, lines))
    return out


def of_strays(with_them: pd.DataFrame, without: pd.DataFrame) -> list[Finding]:
    """Readings that jump away and back, mended where the logs as they are fitted have
    none; by the channels' tables of both.
    """
    out = []
    at = with_them.strays
    for name in (n for n in MAY_STRAY if n in at.index and at[n] > 0):
        mended = bool(without.strays[name] == 0)
        do = "these rows are left out" if mended else "leave these cells empty"
        says = (
            f"{name} jumps away and back at once in {100 * at[name]:.2g} % of its "
            f"readings, as with a loose plug or a bad cell: {do}"
        )
        out.append(Finding(name, "stray", None, None, None, "", says, mended=mended))
    return out


def is_no_supply(own: pd.Series) -> bool:
    """Whether the supply's readings, a row of the channels' table, are 0 but for noise.

    A sound one in another unit is as many times its noise as before.
    """
    return bool(max(-own.low, own.high) <= NO_SUPPLY * own.noise)


def of_sensors(channels: pd.DataFrame, h: float) -> list[Finding]:
    """Readings that no sound sensor gives; `h` is the logs' step, s."""
    out = []

    def add(name: str, what: str, says: str) -> None:
        out.append(Finding(name, what, None, None, None, "", says))

    for name in (n for n in SENSORS if n in channels.index):
        own = channels.loc[name]
        if name == "P_s" and is_no_supply(own):
            add(name, "stuck", "P_s is 0 all the time, no supply: take the column out "
                "and give [supply] P_s")  # fmt: skip
            continue
        if (
            own.high > own.low
            and own.stuck > max(STUCK, READINGS * h)
            and not 0.5 < own.repeated < DEAD
        ):
            add(name, "stuck", f"{name} stands at one reading for {own.stuck:.2g} s: "
                "leave these cells empty, or take the column out")  # fmt: skip
        if own.at_ends > CLIPPED and own.repeated < 0.5:
            add(name, "clipped", f"{name} stands at the end of its range for "
                f"{100 * own.at_ends:.2g} % of the time: leave these cells empty, or "
                "use a sensor of a wider range")  # fmt: skip
        if own.below_vacuum > CLIPPED:
            add(name, "vacuum", f"{name} is below {VACUUM / 1e3:.0f} kPa for "
                f"{100 * own.below_vacuum:.2g} % of the time, as no oil can be: "
                "check its zero and its sign")  # fmt: skip
    return out
