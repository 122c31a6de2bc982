"""What a rig file and its logs say, and what a mend would make of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from hydrojax.errors import InputError
from hydrojax.identify.checking.balances import (
    EDGES,
    FRICTION,
    OFFSETS,
    SETTLE,
    EvenTicks,
    Geometry,
    Shape,
    flow_rivals,
    flow_table,
    force_rivals,
    force_table,
)
from hydrojax.identify.checking.regression import Table, solved
from hydrojax.identify.preparation.segments import over_ticks, runs_on
from hydrojax.logs.log import Log
from hydrojax.parameters import get, parameter_specs
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.recording import position
from hydrojax.rigfile.schema import RigFile

FLOW_WINDOW = 0.05
"""Seconds of a window of the flow balance: many of a chamber's time constants."""
FORCE_WINDOW = 0.02
"""Seconds of a window of the force balance: friction turns within some 0.1 s."""
FEWEST = (8, 4)
"""Ticks that such a window has at least."""
ENOUGH = 40
"""Windows below which a balance is not drawn up."""
MOVES = 0.05
"""Share of the ticks in which a command must differ from its median."""
MOST = 30_000
"""Ticks that are looked at: more only cost time."""


@dataclass(frozen=True)
class Inputs:
    """A rig file and its logs as the balances take them, SI.

    Attributes:
        stretches: of all logs.
        geometry: areas and length.
        shape: of friction, as the rig file has it.
        logged: the signals of the logs.
        defaults: what the model takes where the rig file is silent, by name.
        spec: the rig file.
        x_mid: the position that the sensor reads at mid-stroke, m.
    """

    stretches: tuple[EvenTicks, ...]
    geometry: Geometry
    shape: Shape
    logged: frozenset[str]
    defaults: Mapping[str, float]
    spec: RigFile
    x_mid: float = 0.0

    @property
    def motion(self) -> str:
        """The signal that the position is taken from."""
        return "x" if "x" in self.logged else "psi"

    @cached_property
    def has_flow(self) -> bool:
        """Whether the balance of flow can be drawn up."""
        return (
            {"u", "P_a1", "P_a2"} <= self.logged
            and self.spec.layout.has_valve
            and len(self.spec.layout.pressures) == 2
            and self.spec.valve is None
            and self._windows(self.ticks[0], 0.0) >= ENOUGH
            and float(np.mean([np.mean(s.u != np.median(s.u)) for s in self.stretches]))
            > MOVES
        )

    @cached_property
    def has_force(self) -> bool:
        """Whether the balance of force can be drawn up."""
        layout = self.spec.layout
        needs = set(layout.pressures) or ({"P"} if layout.driven else set())
        enough = self._windows(self.ticks[1], SETTLE) >= ENOUGH
        return {"F", *needs} <= self.logged and enough

    def _windows(self, ticks: int, settle: float) -> int:
        """Windows of all stretches, without those of the first `settle` seconds."""
        each = [
            (len(s.x) - settle / s.h) / max(ticks // 2, 1) - 2 for s in self.stretches
        ]
        return int(sum(max(n, 0.0) for n in each))

    @cached_property
    def h(self) -> float:
        """Step of the logs, s."""
        return self.stretches[0].h

    @property
    def ticks(self) -> tuple[int, int]:
        """Of a window of the flow balance, and of the force's."""
        flow, force = (round(t / self.h) for t in (FLOW_WINDOW, FORCE_WINDOW))
        return max(flow, FEWEST[0]), max(force, FEWEST[1])

    @cached_property
    def flow(self) -> Table:
        """The balance of flow; see `flow_table`."""
        own = (flow_table(s, self.geometry, self.ticks[0]) for s in self.stretches)
        return Table.stacked(list(own))

    def force(self, shape: Shape) -> Table:
        """The balance of force; see `force_table`."""
        ticks = self.ticks[1]
        own = (force_table(s, self.geometry, shape, ticks) for s in self.stretches)
        return Table.stacked(list(own))

    @cached_property
    def flow_beside_effects(self) -> Table:
        """The balance of flow with the columns of all rival effects beside its own."""
        own = [flow_rivals(s, self.geometry, self.ticks[0]) for s in self.stretches]
        return self.flow.with_columns(Table.stacked(own))

    @cached_property
    def flow_error_beside_effects(self) -> float:
        """RMS left of the flow balance with all rival effects in it, m^3."""
        table = self.flow_beside_effects
        return solved(table, table.columns).error

    def force_rivals(self, shape: Shape) -> Table:
        """Columns of effects beside those of `force`; see `force_rivals`."""
        ticks = self.ticks[1]
        own = (force_rivals(s, self.geometry, shape, ticks) for s in self.stretches)
        return Table.stacked(list(own))

    def scaled(self, name: str, factor: float) -> Inputs:
        """With a signal, an area or the chamber length multiplied."""
        by = {
            "area": (factor, factor),
            "area_1": (factor, 1.0),
            "area_2": (1.0, factor),
        }.get(name)
        if by is not None:
            g = self.geometry
            chambers, force = (
                (by[0] * own[0], by[1] * own[1]) for own in (g.chambers, g.force)
            )
            return replace(self, geometry=Geometry(chambers, force, g.length))
        new = tuple(_scaled(s, name, factor, self.x_mid) for s in self.stretches)
        return replace(self, stretches=new)

    def brought_forward(self, name: str, seconds: float) -> Inputs:
        """With "x", "u" or a gauge as it is so much later; its end stays as it is."""
        gauge = {"P_a1": 0, "P_a2": 1}.get(name)

        def moved(s: EvenTicks) -> EvenTicks:
            t = s.h * np.arange(len(s.x))
            if gauge is None:
                return replace(s, **{name: np.interp(t + seconds, t, getattr(s, name))})
            P = s.P.copy()
            P[:, gauge] = np.interp(t + seconds, t, P[:, gauge])
            return replace(s, P=P)

        return replace(self, stretches=tuple(map(moved, self.stretches)))

    def behind(self, dead: float, band: float) -> Inputs:
        """With a command that acts `dead` seconds later, beyond a dead band of so much
        of its largest value.
        """
        most = max(float(np.quantile(np.abs(s.u), 0.99)) for s in self.stretches)

        def acts(s: EvenTicks) -> EvenTicks:
            beyond = np.maximum(np.abs(s.u) - band * most, 0.0)
            return replace(s, u=np.copysign(beyond, s.u))

        late = self.brought_forward("u", -dead) if dead else self
        return replace(late, stretches=tuple(map(acts, late.stretches)))

    def exchanged(self) -> Inputs:
        """With the two chamber pressures in each other's place."""
        new = tuple(replace(s, P=s.P[:, ::-1]) for s in self.stretches)
        return replace(self, stretches=new)

    def shortened(self, ticks: int) -> Inputs:
        """The first of all ticks, for a search that tries much."""
        share = ticks // len(self.stretches)
        return replace(self, stretches=tuple(_part(s, share) for s in self.stretches))


def _part(s: EvenTicks, ticks: int) -> EvenTicks:
    own = {n: getattr(s, n)[:ticks] for n in ("u", "x", "P", "P_s", "P_r", "F")}
    return replace(s, **own)


def _scaled(s: EvenTicks, name: str, factor: float, x_mid: float) -> EvenTicks:
    if name in ("x", "psi", "radius"):
        # A sensor that runs the other way is read from the same mid-stroke.
        mid = 0.0 if factor < 0 else x_mid
        return replace(s, x=factor * (s.x + mid) - mid)
    if name in ("P_a1", "P_a2"):
        return replace(s, P=s.P * np.where([name == "P_a1", name == "P_a2"], factor, 1))
    return replace(s, **{name: factor * getattr(s, name)})


def inputs_of(spec: RigFile, logs: Sequence[Log]) -> Inputs:
    """Logs of one rig as the balances take them.

    Of long logs the liveliest part of each stretch is taken.

    Raises:
        InputError: logs without motion, or an angle and no radius; or with other
            signals than the first.
    """
    has = set(logs[0].signals) - {"F_d", "v"}
    for log in logs[1:]:
        if odd := (set(log.signals) - {"F_d", "v"}) ^ has:
            raise InputError(
                f"{log.name}: columns differ from {logs[0].name} "
                f"({', '.join(sorted(odd))}): check logs together only with the same"
            )
    rows = [(log, own) for log in logs for own in log.segments]
    lasting = [
        (log, own)
        for log, own in rows
        if log.time[own[1] - 1] - log.time[own[0]] > 2 * SETTLE
    ]
    chosen = lasting or rows
    stretches = tuple(
        _stretch(log, slice(*own), spec, MOST // len(chosen)) for log, own in chosen
    )
    rig = build_rig(spec)
    names = tuple(parameter_specs(rig))
    values = dict(zip(names, np.asarray(get(rig, names)).tolist(), strict=True))
    chambers, force = spec.layout.areas(spec.geometry)
    return Inputs(
        stretches,
        Geometry(
            (float(chambers[0]), float(chambers[1])),
            (float(force[0]), float(force[1])),
            spec.geometry.get("chamber_length", 1.0),
        ),
        Shape(*(values[n] for n in ("z_ss", "delta", "L_slope", "L_rate"))),
        frozenset(has),
        {n: values[n] for n in (*EDGES, "beta", *OFFSETS, *FRICTION) if n in values},
        spec,
        spec.geometry.get("x_mid", 0.0),
    )


def _stretch(log: Log, rows: slice, spec: RigFile, most: int) -> EvenTicks:
    """A stretch's signals at even ticks; of a long one the part that moves most."""
    t, x = log.time[rows], position(log, spec)[rows]
    if len(t) > most:
        travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)))])
        starts = np.arange(0, len(t) - most, max(most // 4, 1))
        first = int(starts[np.argmax(travel[starts + most] - travel[starts])])
        own = slice(first, first + most)
        rows = slice(rows.start + first, rows.start + first + most)
        t, x = t[own], x[own]
    h = float(np.median(np.diff(t)))
    even = t[0] + h * np.arange(int(round((t[-1] - t[0]) / h)) + 1)
    uneven = len(even) != len(t) or np.max(np.abs(even - t)) > 0.02 * h

    def at(y: np.ndarray) -> np.ndarray:
        return np.interp(even, t, y) if uneven else np.asarray(y)

    def signal(name: str, otherwise: float = np.nan) -> Float[np.ndarray, "ticks"]:
        if name in log.signals:
            return at(log.signals[name][rows])
        return np.full(len(even), otherwise)

    P = np.stack([signal("P_a1", 0.0), signal("P_a2", 0.0)], axis=1)
    if "P" in log.signals and not {"P_a1", "P_a2"} & set(log.signals):
        P = np.stack([np.zeros(len(even)), signal("P")], axis=1)
    u = over_ticks(signal("u"), runs_on(spec))
    return EvenTicks(
        h, u, at(x), P, signal("P_s", spec.line["P_s"]),
        signal("P_r", spec.line["P_r"]), signal("F"),
    )  # fmt: skip
