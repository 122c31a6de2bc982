"""The pressures of windows, and how each direction moves them.

The spool's opening is had once for all windows. From there on a substep of the
pressures depends on much and gives two numbers, more where something stands in the
lines. So its derivatives are taken backward, by all that moves it at once, and carried
on from substep to substep. They are combined along the directions at the end, so that
the cost of a fit hardly grows with its columns.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.identify.estimation.columns import (
    NUISANCE,
    READINGS,
    SUPPLY_BLOCKS,
    Basis,
    Batch,
    ParametricRig,
)
from hydrojax.parameters import get, put
from hydrojax.plant.chambers import refilled
from hydrojax.plant.hydraulics import pressure_step
from hydrojax.plant.places import flow_names, gauge_names, opening_names
from hydrojax.plant.replay import (
    Cut,
    Motion,
    Opened,
    at_start,
    before_filters,
    line_start,
    opened_in,
    openings,
    tick_inputs,
)
from hydrojax.plant.rig import Rig
from hydrojax.plant.scan import in_one_kernel, scan_in_blocks
from hydrojax.plant.state import StepInput


class SpoolPath(NamedTuple):
    """The spool's opening over whole segments, and how it moves.

    Attributes:
        now: the opening, as `openings` has it, [S, N-1] each.
        by: its derivatives by some of `opening_names`, on a first axis.
        along: how the directions move those, [moved, k_1].
    """

    now: Opened
    by: Opened
    along: Float[Array | np.ndarray, "moved columns"]


def openings_by(
    model: ParametricRig,
    values: Float[Array | np.ndarray, "n"],
    moves: Float[Array | np.ndarray, "moved names"],
    motion: Motion,
    cut: Cut | None = None,
) -> tuple[Opened, Opened]:
    """The spool's opening over whole segments, or over a cut of them, and its
    derivatives along each of some moves of `opening_names`, on a first axis.
    """
    here = put(model.rig, model.names, values)
    names = opening_names(here)
    if not names:
        now = openings(here, motion, cut)
        return now, tuple(jnp.zeros((0, *o.shape)) for o in now)
    at = get(here, names)

    def along(move):
        return jax.jvp(
            lambda of: openings(put(here, names, of), motion, cut), (at,), (move,)
        )

    return jax.vmap(along, out_axes=(None, 0))(jnp.asarray(moves))


def rows_of(
    model: ParametricRig, hydraulic: Float[Array | np.ndarray, "n_1 k"]
) -> Float[Array | np.ndarray, "names k"]:
    """How the directions move `opening_names`."""
    names = opening_names(model.rig)
    return hydraulic[np.array([model.names.index(n) for n in names], int)]


class Pressures(NamedTuple):
    """Both pressures (Pa), and their derivatives along k_1 hydraulic directions and
    each of the windows' own unknowns (`NUISANCE`).
    """

    P: tuple[Float[Array, "windows ticks"], Float[Array, "windows ticks"]]
    by: tuple[Float[Array, "k windows ticks"], Float[Array, "k windows ticks"]]


def driven_pressures(
    model: ParametricRig,
    values: Float[Array, "n"],
    directions: Basis,
    batch: Batch,
    spool: SpoolPath | None,
) -> Pressures:
    """The pressures along the hydraulic directions, the two initial pressures (per
    Pa), and the supply's error in each block (per standard deviation of its mean); what
    the sensors read at first moves none.

    Without a `spool` they are the log's, and nothing moves them.
    """
    w, k = batch.windows, directions.hydraulic.shape[1]
    if spool is None:
        still = jnp.zeros((k + NUISANCE, *w.P_a1.shape))
        return Pressures((w.P_a1, w.P_a2), (still, still))
    n = model.hydraulic
    rig = put(model.rig, model.names[:n], values[:n])
    sources = _Sources.of(model, rig, directions, spool)
    P, by = _run(rig, batch, sources, spool)
    still = ((0, READINGS), (0, 0), (0, 0))
    return Pressures((P[0], P[1]), (jnp.pad(by[0], still), jnp.pad(by[1], still)))


OWN = 2 + SUPPLY_BLOCKS
"""What each window has of its own that moves its pressures."""


class _Sources(NamedTuple):
    """What pressures are moved by, in this order: the spool's moves, what each window
    has of its own, parameters of the logger, and those of the flows.

    Attributes:
        spool: how many moves the spool has.
        logger: names.
        flow: names.
        along: how the directions move all but the windows' own.
    """

    spool: int
    logger: tuple[str, ...]
    flow: tuple[str, ...]
    along: Float[Array, "sources k"]

    @classmethod
    def of(
        cls, model: ParametricRig, rig: Rig, directions: Basis, spool: SpoolPath
    ) -> _Sources:
        """Nothing but the windows' own where there are no directions."""
        moves, names = len(spool.along), model.names[: model.hydraulic]
        if not directions.hydraulic.shape[1]:
            return cls(moves, (), (), jnp.zeros((moves, 0)))
        gauges = gauge_names(rig)
        logger = tuple(name for name in names if name in gauges)
        flow = flow_names(rig)
        rows = np.array([names.index(name) for name in (*logger, *flow)], int)
        along = [jnp.asarray(spool.along), directions.hydraulic[rows]]
        return cls(moves, logger, flow, jnp.concatenate(along))

    @property
    def total(self) -> int:
        """How many there are."""
        return self.spool + OWN + len(self.logger) + len(self.flow)

    @property
    def of_supply(self) -> slice:
        """Those that move the supply's pressure."""
        return slice(self.spool, self.total - len(self.flow))

    def columns(
        self, by: Float[Array, "ticks 2 sources windows"]
    ) -> Float[Array, "ticks 2 columns windows"]:
        """Derivatives by the sources as those along the directions and by what each
        window has of its own.
        """
        end = self.spool + OWN
        rest = jnp.concatenate([by[:, :, : self.spool], by[:, :, end:]], axis=2)
        combined = jnp.einsum("sk,tpsw->tpkw", self.along, rest)
        return jnp.concatenate([combined, by[:, :, self.spool : end]], axis=2)


def _run(
    rig: Rig, batch: Batch, sources: _Sources, spool: SpoolPath
) -> tuple[Float[Array, "2 windows ticks"], Float[Array, "2 columns windows ticks"]]:
    """Both pressures, and their derivatives along the directions and by what each
    window has of its own.
    """
    w = batch.windows
    opened = opened_in(rig, spool.now, w)
    opened_by = opened_in(rig, spool.by, w)
    (P_s, begun), (P_s_by, begun_by) = _begin(rig, batch, sources, opened, opened_by)

    inputs = tick_inputs(rig, w, P_s)
    ticks = len(inputs.h)
    own = tuple(o[-ticks:] for o in opened)
    own_by = tuple(jnp.moveaxis(o[:, -ticks:], 1, 0) for o in opened_by)
    P_s_by = jnp.moveaxis(P_s_by, -1, 0)
    parts = (inputs.x.shape[-1] - 1) // 2
    leaves, tree = jax.tree.flatten(begun)
    slopes = jnp.stack(jax.tree.leaves(begun_by))  # [state, sources, W]
    theta = tuple(get(rig, sources.flow)) if sources.flow else ()
    derived = in_one_kernel(partial(_derived, rig, sources.flow, tree))

    def substep(carry, given):
        state, slopes = carry
        opening, opening_by, supply_by, part = given
        state, derivatives = derived(state, theta, opening, part)
        return (state, _carried(derivatives, slopes, opening_by, supply_by)), None

    def tick(carry, given):
        opening, opening_by, supply_by, inputs = given
        cut = _cut(inputs, parts)
        ends = jnp.arange(parts + 1) / parts
        along = supply_by[0] + ends[:, None, None] * (supply_by[1] - supply_by[0])
        if parts == 1:
            part = jax.tree.map(lambda a: a[0], cut)
            carry, _ = substep(carry, (opening, opening_by, along, part))
        else:
            carry, _ = jax.lax.scan(
                lambda c, g: substep(c, (opening, opening_by, *g)),
                carry,
                (jnp.stack([along[:-1], along[1:]], axis=1), cut),
            )
        (P_1, P_2, *_), slopes = carry
        full = [jax.jvp(refilled, (P,), (jnp.ones_like(P),)) for P in (P_1, P_2)]
        P, rise = (jnp.stack(a) for a in zip(*full, strict=True))
        return carry, (P, slopes[:2] * rise[:, None])

    given = (own, own_by, jnp.stack([P_s_by[:-1], P_s_by[1:]], axis=1), inputs)
    # Combined block by block: the whole would not stay in the processor's cache.
    P, by = scan_in_blocks(
        tick,
        (tuple(leaves), slopes),
        given,
        lambda out: (out[0], sources.columns(out[1])),
    )
    P = jnp.concatenate([jnp.stack(leaves[:2])[None], P])
    by = jnp.concatenate([sources.columns(slopes[None, :2]), by])
    return jnp.moveaxis(P, 0, -1), jnp.moveaxis(by, 0, -1)


def _carried(
    derivatives: tuple,
    slopes: Float[Array, "state sources windows"],
    opening_by: tuple[Float[Array, "moves windows"], ...],
    supply_by: Float[Array, "2 supply windows"],
) -> Float[Array, "state sources windows"]:
    """How the sources move a state after a substep, by its derivatives (see `_derived`)
    and by how they moved what it came from.
    """
    by_state, by_theta, by_opening, by_supply = derivatives

    def through(by, moves):
        return sum(b[:, None] * m for b, m in zip(by, moves, strict=True))

    theta = [jnp.stack(by_theta, axis=1)] if by_theta else []
    more = (through(by_opening, opening_by), through(by_supply, supply_by), *theta)
    return through(by_state, slopes) + jnp.concatenate(more, axis=1)


def _begin(
    rig: Rig, batch: Batch, sources: _Sources, opened: Opened, opened_by: Opened
) -> tuple[tuple, tuple]:
    """The supply's pressure [W, ticks] and the state where the windows begin; and their
    derivatives, of the supply's by `sources.of_supply`, of the state by each of the
    sources, on a first axis.
    """
    w, names = batch.windows, (*sources.logger, *sources.flow)
    ticks = w.P_s.shape[1]
    block = jnp.arange(ticks) * SUPPLY_BLOCKS // ticks
    of_mean = batch.supply_noise / np.sqrt(ticks / SUPPLY_BLOCKS)
    at = get(rig, names) if names else jnp.zeros(0)

    def shown(supply):
        return w._replace(P_s=w.P_s + of_mean * supply[block])

    def drive(of, supply):
        here = put(rig, sources.logger, of)
        return before_filters(here, shown(supply)).P_s

    def begin(of, P_shift, supply, opened):
        here, logged = put(rig, names, of), shown(supply)
        P_0 = at_start(here, logged, batch.P_0 + P_shift)
        return (P_0[:, 0], P_0[:, 1]), line_start(here, logged, opened)

    def along(e, opened_by):
        own = e[sources.spool :]
        moves = (own[OWN:], own[:2], own[2:OWN], opened_by)
        return jax.jvp(
            begin, (at, jnp.zeros(2), jnp.zeros(SUPPLY_BLOCKS), opened), moves
        )

    def along_supply(e):
        moves = (e[OWN:], e[2:OWN])
        return jax.jvp(
            drive, (at[: len(sources.logger)], jnp.zeros(SUPPLY_BLOCKS)), moves
        )

    rest = sources.total - sources.spool
    opened_by = jax.tree.map(
        lambda a: jnp.pad(a, ((0, rest), *[(0, 0)] * (a.ndim - 1))), opened_by
    )
    each = jax.vmap(along, out_axes=(None, 0))
    state, state_by = each(jnp.eye(sources.total), opened_by)
    of_supply = jax.vmap(along_supply, out_axes=(None, 0))
    P_s, P_s_by = of_supply(jnp.eye(OWN + len(sources.logger)))
    return (P_s, state), (P_s_by, state_by)


def _cut(inputs: StepInput, parts: int) -> StepInput:
    """A tick's inputs cut into those of its substeps, on a first axis."""
    ends = jnp.arange(parts + 1) / parts

    def between(line):
        along = line[..., :1] + ends * (line[..., 1:] - line[..., :1])
        return jnp.stack([jnp.moveaxis(along, -1, 0)[i:][:parts] for i in (0, 1)], -1)

    x = jnp.moveaxis(inputs.x, -1, 0)
    same = {
        name: jnp.broadcast_to(a, (parts, *a.shape))
        for name, a in (
            ("u", inputs.u),
            ("v", inputs.v),
            ("a", inputs.a),
            ("t", inputs.t),
        )
    }
    return StepInput(
        h=jnp.broadcast_to(inputs.h / parts, (parts, *inputs.h.shape)),
        P_s=between(inputs.P_s),
        P_r=between(inputs.P_r),
        x=jnp.stack([x[i : i + 2 * parts : 2] for i in range(3)], axis=-1),
        dx=None,
        F=None if inputs.F is None else between(inputs.F),
        **same,
    )


def _derived(
    rig: Rig,
    names: tuple[str, ...],
    tree: Any,
    state: tuple[Float[Array, "windows"], ...],
    theta: tuple[Float[Array, ""], ...],
    opening: tuple[Float[Array, "windows"], ...],
    inputs: StepInput,
) -> tuple[tuple, tuple]:
    """A state after a substep, and its derivatives, [state, W] each, by the state
    before, by the parameters of these names, by the opening, and by the supply's
    pressure at both ends.

    Window by window, and every number by itself: arrays of a few numbers a window would
    be turned over and over.
    """

    def apart(a):
        return () if a is None else tuple(jnp.moveaxis(a, -1, 0))

    lines = tuple(map(apart, (inputs.P_r, inputs.x, inputs.F)))
    rest = (inputs.h, inputs.u, inputs.v, inputs.a, inputs.t)

    def one(state, theta, opening, P_s, lines, rest):
        h, u, v, a, t = rest
        P_r, x, F = lines
        F = jnp.stack(F) if F else None

        def after(state, theta, opening, P_s):
            P, line = jax.tree.unflatten(tree, state)
            ends = (jnp.stack(P_s), jnp.stack(P_r), jnp.stack(x))
            given = StepInput(h, u, *ends, None, v, a, t, F)
            here = put(rig, names, theta)
            P, line = pressure_step(here, P, opening, given, line)
            return tuple(jax.tree.leaves((P, line)))

        out, pull = jax.vjp(after, state, theta, opening, P_s)
        return out, jax.vmap(pull)(tuple(jnp.eye(len(out))))

    given = (opening, apart(inputs.P_s), lines, rest)
    return jax.vmap(one, in_axes=(0, None, 0, 0, 0, 0), out_axes=(0, -1))(
        state, theta, *given
    )
