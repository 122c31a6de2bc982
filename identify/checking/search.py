"""The search for inputs that are turned round, exchanged or in another unit.

Every mend of one input is tried on the balances, and every second one beside the best;
what makes both balances close with constants that a rig can have is taken for true.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import constants

from hydrojax.identify.checking.balances import (
    EDGES,
    FLOW,
    FRICTION,
    NOT_NEGATIVE,
    PUSHES,
)
from hydrojax.identify.checking.inputs import Inputs
from hydrojax.identify.checking.path import along_path
from hydrojax.identify.checking.regression import Fitted, Table, solved

CLEAR = 0.3
"""Decades by which a mend must lower the implausibility: half of it. A fault costs one
or more, and less behind a slow valve."""
OPEN = 0.03
"""Share of the flow that is left from which the valve's path is looked for."""
EQUAL, SAME = 0.08, 0.02
"""Decades within which two mends do equally well, and two units: the first of the list
is taken."""
TRIAL_TICKS = 12_000
"""Ticks on which mends are tried."""
CLOSED = (0.005, 0.03)
"""Shares of the flow and of the force that may be left in a balance that closes."""
BETA = (2e8, 3e9)
"""Bulk moduli that oil in a cylinder has, Pa."""
SUPPLIES = (1e5, 1e8)
"""Supply pressures of hydraulic and pneumatic rigs, Pa."""
SLIP = 3.0
"""Ratio of force and push from which another unit is tried; units differ by 9.8 on."""
FARTHEST = 4.0
"""Decades beyond which it does not matter by how many a value is odd."""
PSI, INCH, POUND = constants.psi, 1e3 * constants.inch, constants.lbf
"""A psi in Pa, an inch in mm, a pound-force in N."""
WIDE = 0.4
"""Share of the largest command from which a chamber is taken to be filled."""
SWINGS, FOLLOWS = 0.05, 0.5
"""Share of its mean by which a supply varies, and its correlation with the load, from
which it is taken to follow the load."""
STEEPEST = 3.0
"""Slope of a supply over the load from which it is odd: one that follows it has 1, and
units differ by 6.9 on."""
DECLARED = (0.2, 1.3)
"""Shares of the declared pressure that a pump which follows the load comes to."""
HIGHEST = 2.0
"""Times the declared pressure from which any supply is odd."""
SURER = 5.0
"""What a decade of its slope over the load counts, in decades of the flow that is left:
a compensated flow is closed better by a supply that is too high."""
VACUUM = -1.5e5
"""Pa: a gauge that reads less, by more than its offset, is turned round."""


@dataclass(frozen=True)
class Mend:
    """What is done to inputs: each is multiplied by `factor`, or, where `finding` says
    so, two are exchanged.
    """

    inputs: tuple[str, ...]
    finding: str
    factor: float

    def applied(self, to: Inputs) -> Inputs:
        """The inputs mended."""
        if self.finding == "exchanged":
            return to.exchanged()
        for name in self.inputs:
            to = to.scaled(name, self.factor)
        return to


@dataclass(frozen=True)
class Trial:
    """How a rig file and its logs agree, in decades; less is better.

    Attributes:
        flow: log10 of the share of the flow that is left.
        force: log10 of the share of the force that is left.
        odd: by how many decades values lie outside what a rig can have, by value.
        gain: of the force over what the pressures push; 1 where it is not known.
        flow_error: RMS left of the flow, m^3 in a window's tick.
        force_error: RMS left of the force, N.
        stiffness: pressure that a volume makes in a chamber at mid-stroke, Pa/m^3.
    """

    flow: float
    force: float
    odd: dict[str, float]
    gain: float = 1.0
    flow_error: float = 0.0
    force_error: float = 0.0
    stiffness: float = 0.0

    @property
    def cost(self) -> float:
        """All of it."""
        return self.flow + self.force + 2 * sum(self.odd.values())

    @property
    def suspicious(self) -> bool:
        """Whether other units are worth a try: a slip leaves a value that no rig has,
        or a force that the pressures do not push with.
        """
        return bool(self.odd) or not 1 / SLIP < abs(self.gain) < SLIP


def mends(of: Inputs) -> Iterator[Mend]:
    """Signs and an exchange: tried on every log; the likeliest first."""
    for name in ("u", of.motion, "F", "P_a1", "P_a2"):
        if name in of.logged:
            yield Mend((name,), "sign", -1.0)
    if {"P_a1", "P_a2"} <= of.logged:
        yield Mend(("P_a1", "P_a2"), "exchanged", 1.0)
        yield Mend(("P_a1", "P_a2"), "sign", -1.0)


def unit_mends(of: Inputs) -> Iterator[Mend]:
    """Other units: tried where something is odd."""
    sizes = (10.0, 1e2, 1e3, 1e5, 1e6, PSI / 1e5, PSI / 1e3, PSI / 1e6, PSI)
    both = tuple(p for p in ("P_a1", "P_a2") if p in of.logged)
    every = tuple(p for p in (*both, "P_s") if p in of.logged or p == "P_s")
    groups = [both, every, ("P_s",), *((p,) for p in both)]
    for group in dict.fromkeys(g for g in groups if g):
        for f in sizes:
            yield Mend(group, "unit", f)
            yield Mend(group, "unit", 1 / f)
    factors = {
        of.motion: (180 / np.pi,) if of.motion == "psi" else (1e3, 1e2, 10.0, INCH),
        "u": (1e2, 1e3),
        "F": (10.0, 9.80665, 1e2, 1e3, 1e6, POUND),
    }
    areas = ("area",) if "area" in of.spec.geometry else ("area_1", "area_2")
    for name, own in factors.items():
        if name in of.logged:
            for f in own:
                yield Mend((name,), "unit", f)
                yield Mend((name,), "unit", 1 / f)
    if "radius" in of.spec.geometry and of.motion == "psi":
        yield from (Mend(("radius",), "unit", f) for f in (10.0, 1e3, 0.1, 1e-3))
    for f in (1e2, 1e4, 1e6):
        yield Mend(areas, "unit", f)
        yield Mend(areas, "unit", 1 / f)


def tried(of: Inputs) -> Trial:
    """How well the balances close with constants that a rig can have."""
    trial = Trial(0.0, 0.0, _odd_signals(of))
    if of.has_flow:
        trial = _with_flow(trial, of)
    if of.has_force:
        trial = _with_force(trial, of)
    return trial


def _share(error: float, y: np.ndarray, least: float, most: float) -> float:
    """Log10 of an error as a share of what should be explained."""
    whole = max(float(np.sqrt(np.mean(y**2))), 1e-300)
    return float(np.log10(np.clip(error / whole, least, most)))


def _with_flow(trial: Trial, of: Inputs) -> Trial:
    fit = solved(of.flow, FLOW, NOT_NEGATIVE)
    volume = float(np.mean(of.geometry.chambers)) * of.geometry.length / 2
    soft = max(fit.values["beta"], 1e-10)
    return replace(
        trial,
        flow=_share(fit.error, of.flow.y, CLOSED[0], 1.0),
        odd=trial.odd | _odd_constants(of, fit),
        flow_error=fit.error,
        stiffness=1 / soft / volume,
    )


def _with_force(trial: Trial, of: Inputs) -> Trial:
    table = of.force(of.shape)
    held = table.holding(PUSHES)
    fit = solved(held, FRICTION, NOT_NEGATIVE)
    push = table.columns["push_1"] + table.columns["push_2"]
    wide = Table(table.y, {**table.columns, "push": push})
    return replace(
        trial,
        force=_share(fit.error, table.y, CLOSED[1], 1e2),
        gain=solved(wide, ("push", *FRICTION)).values["push"],
        force_error=fit.error,
    )


def _beyond(value: float, low: float, high: float) -> float:
    """Decades by which a positive value lies outside a range."""
    return float(np.clip(np.log10(max(low / value, value / high)), 0.0, FARTHEST))


def _odd_signals(of: Inputs) -> dict[str, float]:
    """Motion and pressures that the rig cannot have."""
    out: dict[str, float] = {}
    if of.spec.layout.has_valve and "chamber_length" in of.spec.geometry:
        far = max(float(np.max(np.abs(s.x))) for s in of.stretches)
        ends = of.spec.parameters.get("delta_1")
        more = ends.range[1] if ends and ends.range else 0.1 * of.geometry.length
        out["travel"] = _beyond(far, 0.0 + 1e-30, of.geometry.length / 2 + more)
    P_s = _highest_supply(of)
    if of.has_flow:
        most = min(SUPPLIES[1], HIGHEST * of.spec.supply.get("P_s", np.inf))
        out["P_s"] = _beyond(max(P_s, 1.0), SUPPLIES[0], most)
        out["P_s"] += _beyond(_load_slope(of) or 1.0, 1e-30, STEEPEST)
    for i, name in enumerate(("P_a1", "P_a2")):
        if name in of.logged:
            own = np.concatenate([s.P[:, i] for s in of.stretches])
            if of.has_flow:
                top = float(np.quantile(own, 0.99))
                out[name] = _beyond(max(top, 1.0), 1.0, 1.3 * max(P_s, 1.0) + 5e5)
            if np.quantile(own, 0.05) < VACUUM:
                out[name] = out.get(name, 0.0) + 1.0
    return {n: v for n, v in out.items() if v > 0}


def _highest_supply(of: Inputs) -> float:
    """Supply pressure that 99 in 100 ticks stay below, Pa: a load-sensing pump stands
    by far below a load that a check valve holds.
    """
    return float(np.quantile(np.concatenate([s.P_s for s in of.stretches]), 0.99))


def _odd_constants(of: Inputs, fit: Fitted) -> dict[str, float]:
    """Constants of valve and oil outside the rig file's range, or a decade off."""
    out: dict[str, float] = {}
    # What the balance leaves open of it is no fault of the inputs.
    soft, open_ = fit.values["beta"], 3 * fit.std["beta"]
    declared = of.spec.parameters.get("beta")
    low, high = BETA
    if declared is not None and declared.range is None:
        low, high = min(low, declared.start / 2), max(high, declared.start * 2)
    stiff, yielding = (1 / max(s, 1e-30) for s in (soft + open_, soft - open_))
    out["beta"] = max(_beyond(stiff, 1e-30, high * 2), _beyond(yielding, low / 2, 1e40))
    decades = []
    for name in EDGES:
        entry = of.spec.parameters.get(name)
        if entry is None or fit.values[name] <= 0:
            continue
        low, high = entry.range or (entry.start / 10, entry.start * 10)
        decades.append(_beyond(fit.values[name], low / 1.5, high * 1.5))
    if decades:
        out["valve"] = float(np.median(decades))
    return {n: v for n, v in out.items() if v > 0}


def _on_path(of: Inputs) -> Inputs:
    """With the command behind the dead time and dead band that close the flow best: a
    slow valve hides all else that is wrong.
    """
    return along_path(of, lambda own: solved(own.flow, FLOW, NOT_NEGATIVE).error)


def _beside_effects(given: Inputs, mended: Inputs) -> float:
    """Decades by which a mend lowers what is left of the flow beside all that effects
    do to it: next to a pressure compensator's flow that of an orifice is nearly right
    under a supply that is much too high.
    """
    before, after = (
        _share(of.flow_error_beside_effects, of.flow.y, 1e-10, 1.0)
        for of in (given, mended)
    )
    return before - after


def _likeliest(
    trials: list[tuple[Mend, Trial]],
    equal: float = EQUAL,
    beside: Callable[[Mend], float] = lambda _: 0.0,
) -> tuple[Mend, Trial]:
    """The first that does as well as the best, by its cost and what is `beside` it."""
    costs = [t.cost + beside(m) for m, t in trials]
    return next(
        one for one, c in zip(trials, costs, strict=True) if c <= min(costs) + equal
    )


def _load_slope(of: Inputs) -> float | None:
    """How many Pa the supply rises by for each that the filled chamber does, where the
    command is large; None where it does not follow the load.

    The geometric mean of the least-squares slope, which noise and delay flatten, and of
    the ratio of standard deviations, which they steepen.
    """
    if not {"u", "P_s", "P_a1", "P_a2"} <= of.logged:
        return None
    u, P, P_s = (
        np.concatenate([getattr(s, n) for s in of.stretches]) for n in ("u", "P", "P_s")
    )
    far = np.abs(u) > WIDE * np.quantile(np.abs(u), 0.99)
    u, P, supply = u[far], P[far], P_s[far]
    # The one that is filled, or the other where a sign or an exchange is still wrong.
    loads = (np.where(u > 0, *P.T), np.where(u > 0, *P[:, ::-1].T))
    steady = np.std(supply) <= SWINGS * np.mean(np.abs(supply))
    if steady or not np.std(loads, axis=1).all():
        return None
    r = [float(np.corrcoef(load, supply)[0, 1]) for load in loads]
    best = int(np.argmax(r))
    steep = float(np.std(supply) / np.std(loads[best]))
    return float(np.sqrt(r[best])) * steep if r[best] > FOLLOWS else None


def _off_supply(of: Inputs, mend: Mend) -> float:
    """Decades by which a mended supply pressure is off what else is known of it, which
    tells units apart where the flow does not; 0 where nothing is.

    A pump that follows the load rises as much as the load does, to no more than the rig
    file declares; any other is as high. It blames no input: a run at a low pressure is
    below that.
    """
    if "P_s" not in of.logged:
        return 0.0
    # One gauge by itself says nothing of the load.
    one = len({"P_a1", "P_a2"} & set(mend.inputs)) == 1
    there, declared = of if one else mend.applied(of), of.spec.supply.get("P_s")
    highest, slope = max(_highest_supply(there), 1.0), _load_slope(there)
    if slope is None:
        return abs(float(np.log10(highest / declared))) if declared else 0.0
    ends = (share * (declared or highest) for share in DECLARED)
    far = _beyond(highest, *ends)
    return SURER * abs(float(np.log10(slope))) + far


def mends_wanted(of: Inputs) -> list[tuple[Mend, Trial, Trial]]:
    """The mends that the logs ask for, each with the trial before and after it."""
    now = of.shortened(TRIAL_TICKS)
    before, found = tried(now), []
    slow = now.has_flow and before.flow > np.log10(OPEN)

    def judged(given: Inputs) -> Trial:
        return tried(_on_path(given) if slow else given)

    if slow:
        before = judged(now)
    for _ in range(2):
        trials = [(m, judged(m.applied(now))) for m in mends(now)]
        if before.suspicious or slow:
            # They are many: the valve's path is looked for anew behind the best only.
            near = _on_path(now) if slow else now
            units = [(m, tried(m.applied(near))) for m in unit_mends(now)]
            unit = _likeliest(units, SAME, partial(_off_supply, now))[0]
            there = unit.applied(now)
            if before.suspicious or _beside_effects(near, _on_path(there)) > CLEAR:
                trials.append((unit, judged(there)))
        mend, after = _likeliest(trials)
        if before.cost - after.cost < CLEAR:
            break
        found.append((mend, before, after))
        now, before = mend.applied(now), after
    return found
