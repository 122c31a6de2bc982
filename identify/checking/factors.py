"""Factors of inputs that are nearly right, and constants that a rig file leaves out.

Each is tried on the balances beside what effects do there: an input is blamed only
where it explains much, and more than any effect.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from hydrojax.identify.checking.balances import (
    EDGES,
    FLOW,
    FORCE_RIVALS,
    FRICTION,
    OFFSETS,
    PUSHES,
    Shape,
)
from hydrojax.identify.checking.inputs import Inputs
from hydrojax.identify.checking.path import DEAD, along_path, least, shifts
from hydrojax.identify.checking.regression import Fitted, Table, solved

NEARLY = 0.4
"""Relative change beyond which an input is not nearly right."""
CLEARLY = 0.8
"""Share of a balance's error that a mend may leave."""
BEYOND_EFFECTS = 0.9
"""Share of the error left by the best effect that a mend may leave."""
AREA = 0.007
"""Least relative change of an area, or a gain of the load cell, that is called."""
SHOWS = 0.9
"""Share of the error beside all effects that a mend of the supply may leave: nearly all
logs whose supply is off by a tenth stay below it, and all that are right above
(`benchmarks.trace.lies`, with `--every`)."""
SUPPLY = 0.03
"""The same of the supply pressure."""
SUPPLIES = (0.6, 1.6)
"""Factors of the supply pressure that are tried."""
AT_FLOOR = 1.5
"""Error over what the sensors' noise makes of it up to which a balance closes."""
HELD = 1.25
"""Ratio of errors from which a constant that is left out is called."""
ZERO_SHARE = 0.9
"""Share of what two free volumes take off the flow's squared error that the zero of the
position must take: it makes one of them larger by as much as the other smaller."""
ZERO_SURE = 5.0
"""Standard errors by which the position's zero must be off."""
LATEST = 0.05
"""Seconds that a position is looked for to be late, at most."""
LATE = 0.8
"""Share of the error beside all effects that bringing the position forward may leave;
twice as far it leaves more than that."""
EARLY = 1.1
"""Error with the position brought back over that with it brought forward, up to which a
late position is not told from late pressures (`benchmarks.machines`, seed 42)."""
SEEN = 3.0
"""Standard errors by which the oil must give for its modulus to be named."""
OFF = 0.01
"""Relative difference from the default from which it is named."""


@dataclass(frozen=True)
class Factor:
    """An input that is off by a factor: the error as given, and mended.

    Errors are of the balance, m^3 of a window or N.
    """

    input: str
    factor: float
    given: float
    mended: float


@dataclass(frozen=True)
class Zero:
    """A position whose zero lies `off` m too high: the error of the flow as given, and
    mended, m^3.
    """

    off: float
    given: float
    mended: float


@dataclass(frozen=True)
class LeftOut:
    """Constants that the rig file leaves out, at what the balance says of each, SI."""

    values: dict[str, float]
    given: float
    mended: float


GAUGE_LATE = 0.5
"""Share of the error beside all effects that bringing one gauge forward may leave."""
ALIKE = 1.25
"""Ratio of errors up to which one late gauge is not told from two, or from an early
position."""


@dataclass(frozen=True)
class Delay:
    """An input that is late, s, or early (below 0): the error of the flow as given, and
    mended, m^3.
    """

    input: str
    seconds: float
    given: float
    mended: float


# -- the flow --


def position_delay(of: Inputs) -> Delay | None:
    """How late the position is beside the pressures; None where it is not.

    Beside all that effects do to the flow, as `supply_factor`, and a dead time of the
    valve. No effect makes a position late, but a sensor's lag does so to both
    pressures: a position that is early is not called.

    Dead times of a few steps call every late position, and some that are not: those
    make up for what the steps leave of the dead time. So a call is tried again with
    dead times that are found to half a tick.
    """
    return _position_delay(of, np.inf) and _position_delay(of, of.h / 2)


def _position_delay(of: Inputs, within: float) -> Delay | None:
    """That with dead times found to `within` s, or to one of the steps."""

    def late(seconds: float) -> float:
        return _error(of.brought_forward("x", seconds))

    steps = shifts(of.h, LATEST)
    if not _first_dip(late, steps[:2])[0]:
        return None
    given = _error(_with_dead_time(of, 0.0, within))
    seconds, mended, beside = _brought_forward(of, within)
    if not seconds or mended > LATE * given:
        return None
    if _error(beside.brought_forward("x", 2 * seconds)) < LATE * given:
        return None
    # Pressures that a filter makes late want the position later still, and come near
    # as well where it is brought forward: what moves to and fro fits again.
    if any(
        _error(_with_dead_time(of, -s, within).brought_forward("x", -s))
        < EARLY * mended
        for s in steps
    ):
        return None
    return Delay("x", seconds, given, mended)


def gauge_delay(of: Inputs) -> Delay | None:
    """How late one gauge is beside all else, or how early (below 0); None where neither
    is.

    Beside all that effects do to the flow: none moves one gauge and not the other.
    """
    given, steps = _error(of), shifts(of.h, LATEST)
    found = []
    for name, way in product(("P_a1", "P_a2"), (1.0, -1.0)):

        def error(seconds: float, name: str = name, way: float = way) -> float:
            return _forward(of, name, way * seconds)

        near, around = _first_dip(error, steps)
        if near:
            seconds, left = least(error, around, 0.02 * of.h)
            found.append((left, way * seconds, name))
    if not found:
        return None
    mended, seconds, name = min(found)
    if mended > GAUGE_LATE * given:
        return None
    both = of.brought_forward("P_a1", seconds).brought_forward("P_a2", seconds)
    others = (_error(both), *(_forward(of, "x", s) for s in (-seconds, -seconds / 2)))
    return Delay(name, seconds, given, mended) if ALIKE * mended < min(others) else None


def _forward(of: Inputs, name: str, seconds: float) -> float:
    """The error with an input brought forward."""
    return _error(of.brought_forward(name, seconds))


def _brought_forward(of: Inputs, within: float) -> tuple[float, float, Inputs]:
    """By how much (s) the position is best brought forward, the error then, and the
    inputs with the dead time that goes with it.

    Of a late position a dead time takes a part, and the other way round: by turns.
    """
    steps, beside = shifts(of.h, LATEST), of

    def error(seconds: float) -> float:
        return _error(beside.brought_forward("x", seconds))

    for _ in range(3):
        beside = _with_dead_time(of, _first_dip(error, steps)[0], within)
    seconds, around = _first_dip(error, steps)
    if not seconds:
        return 0.0, error(0.0), beside
    return (*least(error, around, 0.02 * of.h), beside)


def _with_dead_time(of: Inputs, seconds: float, within: float) -> Inputs:
    """The inputs with the command as late as suits a position brought forward."""
    near = of.brought_forward("x", seconds)

    def behind(seconds: float) -> float:
        return _error(near.brought_forward("u", -seconds))

    dead, around = _first_dip(behind, shifts(of.h, DEAD))
    if dead and np.isfinite(within):
        dead, _ = least(behind, around, within)
    return of.brought_forward("u", -dead)


def _first_dip(
    error: Callable[[float], float], steps: Sequence[float]
) -> tuple[float, tuple[float, float]]:
    """The step at an error's first minimum, and those around it: what moves to and fro
    fits again a period later.
    """
    least, lowest = 0, error(steps[0])
    for i, step in enumerate(steps[1:], 1):
        if (tried := error(step)) >= lowest:
            break
        least, lowest = i, tried
    ends = (steps[max(least - 1, 0)], steps[min(least + 1, len(steps) - 1)])
    return steps[least], ends


def _error(of: Inputs) -> float:
    return of.flow_error_beside_effects


def supply_factor(of: Inputs) -> Factor | None:
    """A supply pressure that is off by a factor; None where none is called.

    It is tried beside all that effects do to the flow at once, as they may be there
    too: of logs with a right supply, whatever they lack, it then takes next to nothing.
    What a slow valve leaves wants another supply at times, so a call is tried again
    with the command behind the valve's dead time and dead band.
    """
    return _supply_factor(of) and _supply_factor(along_path(of, _error))


def _supply_factor(of: Inputs) -> Factor | None:
    def error(factor: float) -> float:
        return _error(of.scaled("P_s", factor))

    given = error(1.0)
    near = min(0.8, 0.9, 0.95, 1.05, 1.1, 1.2, key=error)
    if error(near) > SHOWS**0.5 * given:
        return None
    factor, mended = least(error, SUPPLIES, 2e-3)
    if abs(factor - 1) < SUPPLY or mended > SHOWS * given:
        return None
    return Factor("P_s", factor, given, mended)


def position_zero(of: Inputs) -> Zero | None:
    """By how much the position's zero is off, where the rig file holds both volumes at
    the ends of the stroke; None where it is not.

    It makes one chamber longer by as much as the other shorter, beside all that effects
    do to the flow. No dead volume does that: it makes neither smaller.
    """
    own = [of.spec.parameters.get(n) for n in OFFSETS]
    known = [p.start for p in own if p is not None and p.range is None]
    if len(known) < len(OFFSETS):
        return None
    table = of.flow_beside_effects
    first, second = (table.columns[n] for n in OFFSETS)
    held = table.columns["beta"] + known[0] * first + known[1] * second
    table = table.with_columns(Table(table.y, {"beta": held, "zero": first - second}))
    base = [n for n in table.columns if n not in (*OFFSETS, "zero")]
    given, free = (solved(table, (*base, *more)) for more in ((), OFFSETS))
    moved = solved(table, (*base, "zero"))
    takes = given.error**2 - moved.error**2
    if moved.error > CLEARLY * given.error or moved.values["beta"] <= 0:
        return None
    if takes < ZERO_SHARE * (given.error**2 - free.error**2):
        return None
    if abs(moved.values["zero"]) < ZERO_SURE * moved.std["zero"]:
        return None
    if free.values[OFFSETS[0]] * free.values[OFFSETS[1]] >= 0:
        return None
    off = moved.values["zero"] / moved.values["beta"]
    return Zero(off, given.error, moved.error)


def flow_left_out(of: Inputs) -> LeftOut | None:
    """Constants of valve and oil that are left out and not at their defaults."""
    held = {n: of.defaults[n] for n in FLOW if n not in of.spec.parameters}
    if not held:
        return None
    free = solved(of.flow, FLOW)
    soft = free.values["beta"]
    found = {n: free.values[n] for n in EDGES} | {"beta": 1 / soft}
    found |= {n: free.values[n] / soft for n in OFFSETS}
    known = {n: v for n, v in held.items() if n in EDGES}
    if "beta" in held:
        soft = known["beta"] = 1 / held["beta"]
    known |= {n: v * soft for n, v in held.items() if n in OFFSETS}
    table, open_ = of.flow.holding(known), [n for n in FLOW if n not in known]
    given = solved(table, open_).error if open_ else float(np.sqrt(np.mean(table.y**2)))
    if given < HELD * free.error:
        return None
    # Of oil too stiff to be seen nothing is said, nor of the volumes that it fills.
    seen = free.values["beta"] > SEEN * free.std["beta"]
    unseen = () if seen else ("beta", *OFFSETS)
    off = {n: found[n] for n, v in held.items() if _differs(found[n], v)}
    off = {n: v for n, v in off.items() if n not in unseen}
    return LeftOut(off, given, free.error) if off else None


# -- the force --


@dataclass(frozen=True)
class Force:
    """The force balance at the shape of friction that closes it best.

    `own` leaves the push at 1, `gained` has one gain of it.
    """

    table: Table
    shape: Shape
    own: Fitted
    gained: Fitted


def _gained(table: Table) -> Table:
    push = table.columns["push_1"] + table.columns["push_2"]
    return Table(table.y, {**table.columns, "push": push})


def force_balance(of: Inputs) -> Force:
    """The force balance, with the shape that suits it best where the push is open."""

    def at(p: np.ndarray) -> tuple[Fitted, Table, Shape]:
        z, d = np.exp(p)
        shape = replace(of.shape, z_ss=of.shape.z_ss * z, delta=of.shape.delta * d)
        table = _gained(of.force(shape))
        return solved(table, ("push", *FRICTION)), table, shape

    p, step = np.zeros(2), 0.05
    now = at(p)
    for _ in range(4):
        rest = now[0].left
        J = np.stack([(at(p + d)[0].left - rest) / step for d in step * np.eye(2)], 1)
        move = -np.linalg.lstsq(J, rest, rcond=1e-6)[0]
        new = at(p + np.clip(move, -0.5, 0.5))
        if new[0].error > now[0].error:
            break
        done = new[0].error > 0.997 * now[0].error
        p, now = p + np.clip(move, -0.5, 0.5), new
        if done:
            break
    gained, table, shape = now
    own = solved(table.holding(PUSHES), FRICTION)
    return Force(table, shape, own, gained)


def force_factor(of: Inputs, force: Force, floor: float) -> Factor | None:
    """An area, a gauge or a load cell off by a factor; None where none is called.

    One gauge is blamed only where it does clearly better than the gain of all.

    Args:
        of: the inputs.
        force: their balance.
        floor: error that the sensors' noise makes, N.
    """
    wide = force.table.with_columns(of.force_rivals(force.shape))
    given, common = force.own.error, force.gained
    gain = common.values["push"]
    found = [Factor(_common(of), gain, given, common.error)]
    if {"P_a1", "P_a2"} <= of.logged:
        found += _one_sided(of, force, 0.97 * common.error)
    found = [f for f in found if AREA < abs(f.factor - 1) < NEARLY]
    best = min(found, key=_mended, default=None)
    if best is None:
        return None
    if best.mended <= CLEARLY * given:
        rival = min(
            solved(wide.holding(PUSHES), (*FRICTION, *more)).error
            for more in FORCE_RIVALS.values()
        )
        return best if best.mended < BEYOND_EFFECTS * rival else None
    return _beside_effects(of, wide, floor)


def _mended(f: Factor) -> float:
    return f.mended


def _common(of: Inputs) -> str:
    """What has the gain of the whole push: the area, or the load cell's own."""
    return "area" if "area" in of.spec.geometry else "F"


def _one_sided(of: Inputs, force: Force, below: float) -> list[Factor]:
    """One side's gain, where the error falls below that of a common one."""
    names = ("P_a1", "P_a2") if "area" in of.spec.geometry else ("area_1", "area_2")
    out = []
    for name, own, other in zip(
        names, ("push_1", "push_2"), ("push_2", "push_1"), strict=True
    ):
        one = solved(force.table.holding({other: 1.0}), (own, *FRICTION))
        if one.error < below:
            out.append(Factor(name, one.values[own], force.own.error, one.error))
    return out


def _beside_effects(of: Inputs, wide: Table, floor: float) -> Factor | None:
    """A gain that shows only once all effects are allowed for, and closes it."""
    effects = tuple(dict.fromkeys(n for more in FORCE_RIVALS.values() for n in more))
    with_gain = solved(wide, ("push", *FRICTION, *effects))
    without = solved(wide.holding(PUSHES), (*FRICTION, *effects))
    gain = with_gain.values["push"]
    closes = with_gain.error < min(AT_FLOOR * floor, CLEARLY * without.error)
    if not closes or not AREA < abs(gain - 1) < NEARLY:
        return None
    return Factor(_common(of), gain, without.error, with_gain.error)


def force_left_out(of: Inputs, force: Force) -> LeftOut | None:
    """Constants of friction that are left out and not at their defaults."""
    held = {n: of.defaults[n] for n in FRICTION if n not in of.spec.parameters}
    at = {n: getattr(of.shape, n) for n in ("z_ss", "delta")}
    at = {n: v for n, v in at.items() if n not in of.spec.parameters}
    if not held and not at:
        return None
    shape = replace(force.shape, **at)
    table = of.force(shape).holding({**PUSHES, **held})
    free = [n for n in FRICTION if n not in held]
    given = solved(table, free).error if free else float(np.sqrt(np.mean(table.y**2)))
    if given < HELD * force.own.error:
        return None
    found = force.own.values | {n: getattr(force.shape, n) for n in at}
    off = {n: found[n] for n, v in (held | at).items() if _differs(found[n], v)}
    return LeftOut(off, given, force.own.error) if off else None


def _differs(one: float, other: float) -> bool:
    return abs(one - other) > OFF * max(abs(one), abs(other))
