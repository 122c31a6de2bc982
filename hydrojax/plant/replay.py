"""A log drives the plant: the pieces of the one step, run in windows.

Motion is known in a replay and the piston is massless, so nothing feeds back from
force to pressure. The step's pieces are therefore run one after the other: bristle and
filtered speed once over each whole segment (in parallel, they are linear in their
state), and so the command; the pressures in windows, each from its own initial
pressures; force and sensors last. `hydrojax.plant.step` scanned over the same
log gives the same signals.
"""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hydrojax.plant import stretch
from hydrojax.plant.chambers import Lines, Point, refilled
from hydrojax.plant.effect import CommandDelay, LastingChannel, Spool, SpoolLimit
from hydrojax.plant.friction import Sliding, run_linear, run_stop
from hydrojax.plant.hydraulics import follow_drops, pressure_step, settled_drops
from hydrojax.plant.rig import PARTS, Rig, mean_opening
from hydrojax.plant.scan import in_one_kernel, scan_in_blocks
from hydrojax.plant.state import StepInput
from hydrojax.plant.turned import Turned, run_turned


class Motion(NamedTuple):
    """Motion and command of S segments of N ticks, padded with standstill; SI.

    `u` [S, N] the command at the ticks; ahead of the first it stood where it begins.
    Over a tick it goes the share `runs_on` [S] of the way to the next tick's: 0 held, 1
    in a straight line. `dx` [S, N-1, 4] displacement over each quarter of a tick; `h`
    [S, N-1] a tick's length;
    `speed0` [S] the filtered speed to start from; `v` [S, N] the velocity at the ticks;
    `F` [S, N] the output force there, smoothed if it was measured, for what it
    stretches; `P_0` the pressures at the first tick, [S] each.
    """

    u: Float[Array, "segments n"]
    runs_on: Float[Array, "segments"]
    dx: Float[Array, "segments n-1 4"]
    h: Float[Array, "segments n-1"]
    speed0: Float[Array, "segments"]
    v: Float[Array, "segments n"]
    F: Float[Array, "segments n"]
    P_0: tuple[Float[Array, "segments"], Float[Array, "segments"]]


class Windows(NamedTuple):
    """W windows of `lead + T` ticks, cut from S segments; SI.

    The first `lead` ticks let memories settle and are not compared. `before_h` [W, pre]
    are the lengths of the ticks that precede, `P_before` [W, pre, 2] the pressures
    then. `u`, `h`, `P_s`, `P_r`,
    `t`, `x`, `v`, `a`, `F`, `P_a1`, `P_a2` are [W, lead+T], at the ticks; `h` is the
    tick that follows, `F` that of `Motion`. `dP` [W, lead+T, 3, 2] are the first and
    second derivative of P_a1, P_a2 and P_s as they were logged, smoothed. `x_fine` is
    [W, lead+T-1, 2n+1], `measured` [W, T, 3] (P_a1, P_a2, F), `seg` and `first` say
    where each window lies in its segment. `filtered` is 1 where a filter of the logger
    is on the window's log, if there is one, and 0 where that is of other logs.
    """

    seg: Int[Array, "windows"]
    first: Int[Array, "windows"]
    before_h: Float[Array, "windows pre"]
    P_before: Float[Array, "windows pre 2"]
    u: Float[Array, "windows n"]
    h: Float[Array, "windows n"]
    P_s: Float[Array, "windows n"]
    P_r: Float[Array, "windows n"]
    t: Float[Array, "windows n"]
    x: Float[Array, "windows n"]
    v: Float[Array, "windows n"]
    a: Float[Array, "windows n"]
    F: Float[Array, "windows n"]
    x_fine: Float[Array, "windows n-1 fine"]
    P_a1: Float[Array, "windows n"]
    P_a2: Float[Array, "windows n"]
    dP: Float[Array, "windows n 3 2"]
    measured: Float[Array, "windows scored 3"]
    filtered: Float[Array, "windows"]

    @property
    def scored(self) -> int:
        """Ticks of each window that are compared."""
        return self.measured.shape[1]


class Past(NamedTuple):
    """What friction sees of the motion up to every tick, [S, N] each; SI.

    `z` the bristle's deflection, `v` the piston's velocity; `speed`, `slips` and
    `turned` as in `State`.
    """

    z: Float[Array, "segments n"]
    speed: Float[Array, "segments n"] | Float[Array, "segments n films"]
    v: Float[Array, "segments n"]
    slips: tuple[Float[Array, "segments n"], ...] = ()
    turned: Turned | None = None

    def within(self, w: Windows) -> Past:
        """The same at the windows' ticks, [W, lead+T] each."""
        index = w.first[:, None] + jnp.arange(w.x.shape[1])
        return jax.tree.map(lambda a: a[w.seg[:, None], index], self)


def friction_memory(rig: Rig, motion: Motion) -> Past:
    """What friction remembers over whole segments: once for all windows."""
    dx, v, quarters = motion.dx, motion.v, motion.dx.shape[-1]
    if rig.stretch:
        F = jnp.stack([motion.F[:, :-1], motion.F[:, 1:]], axis=-1)
        dx = dx + jnp.diff(
            stretch.ahead(rig.stretch, stretch.along(F, quarters)), axis=-1
        )
        F_rate = stretch.rate(motion.F, motion.h)
        v = v + stretch.ahead_rate(rig.stretch, motion.F, F_rate)

    def at_ticks(start, keep, add):
        # Nothing is asked of what lies between ticks: the steps there become one.
        whole, total = keep[..., 0], add[..., 0]
        for i in range(1, keep.shape[-1]):
            whole, total = whole * keep[..., i], total * keep[..., i] + add[..., i]
        states = run_linear(whole, total, start)
        return jnp.concatenate([start[:, None], states], axis=1)

    z = at_ticks(jnp.zeros_like(motion.speed0), *rig.mechanics.bristle_map(dx))
    h = jnp.broadcast_to(motion.h[..., None] / quarters, dx.shape)
    speed = at_ticks(motion.speed0, *rig.mechanics.speed_map(dx, h))
    if rig.velocity:
        now = jnp.abs(v)
        films = (
            at_ticks(
                now[:, 0],
                *(a[..., None] for a in e.follow(now[:, :-1], now[:, 1:], motion.h)),
            )
            for e in rig.velocity
        )
        speed = jnp.stack([speed, now, *films], axis=-1)
    held = rig.drive_force(*motion.P_0) - motion.F[:, 0]
    slips = []
    for e in rig.hysteresis:
        begun = jnp.clip(e.deflection(held), -e.reach(), e.reach())
        then = run_stop(jnp.moveaxis(dx, -1, 0), e.reach(), begun)
        slips.append(jnp.concatenate([begun[:, None], then], axis=1))
    turned = None
    if rig.asks_of_turns:
        turned = run_turned(z, jnp.sum(dx, axis=-1), motion.h)
    return Past(z, speed, v, tuple(slips), turned)


STRETCH, STRETCHES = 256, 64
"""Ticks of a segment over which the command's path is run in one go, at least, and how
many such stretches are run side by side, about: of shorter ones what is run ahead of
each is most of the work."""

STEPS, SLOW_STEPS = ((60, 1), (260, 5)), ((60, 1), (260, 2), (960, 7))
"""How many ticks ahead of a stretch the command's path is run in steps of how many:
what a spool remembers need be known tick by tick for a while only, but one whose rate
is limited forgets nothing while it is late. Longer steps would be off by more than
0.5 % of the spool's stroke."""

SETTLED = 260
"""Ticks ahead of a window over which a line settles at the measured pressures."""

IN_LINES = 25
"""Ticks right ahead of a window over which the lines are followed: a line takes some
ten to fill or empty."""

Opened = tuple[Float[Array, "..."], ...]
"""The spool's opening over ticks, as `Point` has it."""


class Cut(NamedTuple):
    """Stretches of the same length: their segments, first ticks, and how long."""

    seg: Int[Array | np.ndarray, "stretches"]
    first: Int[Array | np.ndarray, "stretches"]
    size: int


Held = tuple[Float[Array, "_ stretches parts"], Float[Array, "_ stretches"]]
"""The command's mean over the parts of each step, and the steps' lengths, s."""


def _commands(rig: Rig, motion: Motion, cut: Cut) -> tuple[Rig, Held, Held]:
    """The command ahead of the stretches and in them, as late as it comes.

    With it the rig without what makes it late: what stands after a delay does not care
    when. One part stands for all of a step where nothing is late or limited.
    """
    late = [c for c in rig.command if isinstance(c, CommandDelay)]
    rest = tuple(c for c in rig.command if not isinstance(c, CommandDelay))
    rig = eqx.tree_at(lambda r: r.command, rig, rest, is_leaf=_is_tuple)
    slow, steps = _steps(rig) is SLOW_STEPS, _steps(rig)
    pre, ticks = steps[-1][0], steps[-1][0] + cut.size
    index = cut.first[:, None] + np.arange(-pre, cut.size)
    own = jnp.clip(index, 0, motion.h.shape[1] - 1)
    seg = cut.seg[:, None]
    u, h = (a[seg, own] for a in (motion.u, motion.h))
    rise = motion.runs_on[seg] * (motion.u[seg, own + 1] - u)
    rise = jnp.where(index == own, rise, 0.0)
    mean = u + rise / 2
    edges, near = _edges(pre, ticks, steps), pre - steps[0][0]
    t, area = (jnp.pad(jnp.cumsum(a, axis=1), ((0, 0), (1, 0))) for a in (h, mean * h))
    step = jnp.diff(t[:, edges], axis=1)
    if late or slow:
        part = jnp.arange(PARTS + 1) / PARTS
        at = (
            t[:, edges[:-1], None] + step[..., None] * part - sum(c.lag() for c in late)
        )
        gone = jax.vmap(_along_steps)(u, rise, t, area, at.reshape(len(u), -1))
        goal = jnp.diff(gone.reshape(at.shape), axis=-1) / step[..., None] * PARTS
    else:
        goal = jnp.diff(area[:, edges], axis=1) / step
        coarse = len(edges) - 1 - (ticks - near)
        goal = jnp.concatenate([goal[:, :coarse], mean[:, near:]], axis=1)[..., None]
    goal, step = jnp.moveaxis(goal, 1, 0), step.T
    ahead = len(edges) - 1 - (ticks - pre)
    return rig, (goal[:ahead], step[:ahead]), (goal[ahead:], step[ahead:])


def _edges(
    pre: int, ticks: int, steps: tuple[tuple[int, int], ...]
) -> Int[np.ndarray, "edges"]:
    """Ticks at which such steps begin, and the last one's end."""
    near = 0
    edges: list[np.ndarray] = [np.arange(pre, ticks + 1)]
    for reach, size in steps:
        back = np.arange(near, min(reach, pre) + 1, size)
        edges.insert(0, pre - back[:0:-1])
        near = back[-1]
    return np.concatenate(edges)


def _is_tuple(x: object) -> bool:
    return isinstance(x, tuple)


def _along_steps(
    u: Float[Array, "n"],
    rise: Float[Array, "n"],
    t: Float[Array, "n+1"],
    area: Float[Array, "n+1"],
    at: Float[Array, "m"],
) -> Float[Array, "m"]:
    """The integral of a command that goes from `u` by `rise` over each tick, at times
    `at`; it is `area` where ticks end, at `t`, and ahead of the first it stood there.
    """
    i = jnp.clip(jnp.searchsorted(t, at, side="left") - 1, 0, u.size - 1)
    gone = at - t[i]
    share = jnp.maximum(gone, 0.0) / (t[i + 1] - t[i])
    return area[i] + (u[i] + rise[i] * share / 2) * gone


def _parted(rig: Rig) -> tuple[Rig, Rig]:
    """The rig with what of the command's path has a memory, and what stands ahead of
    that; and with what stands behind: there no tick asks for the one before it.
    """
    memory = rig.command_init(jnp.zeros(()))
    last = [
        bool(jax.tree.leaves(m)) or isinstance(c, Spool | SpoolLimit)
        for c, m in zip(rig.command, memory, strict=True)
    ]
    count = len(last) - [*last[::-1], True].index(True)
    of_edges = any(c.of_the_edges for c in rig.command[:count])
    if rig.returns and of_edges:  # it has another way for each edge
        return rig, _with_path(rig, (), ())
    ahead, behind = rig.command[:count], rig.command[count:]
    return _with_path(rig, ahead, ()), _with_path(rig, behind, rig.returns)


def _with_path(rig: Rig, command: tuple, returns: tuple) -> Rig:
    """The rig with another path of the command."""
    new = [command, returns]
    return eqx.tree_at(lambda r: [r.command, r.returns], rig, new, is_leaf=_is_tuple)


def _through(
    rig: Rig, memory: tuple, goal: Float[Array, "stretches parts"], h: Array
) -> tuple[tuple, tuple[Float[Array, "parts stretches"], ...]]:
    """The command's path over one step: its memories, and where the spool stands in
    each part, for each edge that has it elsewhere.
    """
    us = [goal[..., i] for i in range(goal.shape[-1])]
    if rig.command and len(us) == 1:
        us = us * PARTS
    memory, ways = rig.command_through(memory, us, h / len(us))
    return memory, tuple(jnp.stack(way) for way in zip(*ways, strict=True))


def openings(rig: Rig, motion: Motion, cut: Cut | None = None) -> Opened:
    """The spool's opening over each tick of the segments, [S, N-1], as `Point` has it;
    or over those of a cut alone, [stretches, size].
    """
    segments, ticks = motion.h.shape
    own = _whole(segments, ticks) if cut is None else cut
    late = sum(c.lag() for c in rig.command if isinstance(c, CommandDelay))
    rig, ahead, held = _commands(rig, motion, own)
    bare = not (rig.command or rig.returns) and held[0].shape[-1] == 1
    rig, behind = _parted(rig)

    def warm(memory, held):
        return _through(rig, memory, *held)[0], None

    def follow(memory, held):
        memory, ways = _through(rig, memory, *held)
        return memory, (ways, held[1])

    def opened(followed):
        # All ticks of a block at once.
        ways, h = followed
        spools = list(zip(*(jnp.moveaxis(way, 1, 0) for way in ways), strict=True))
        if behind.command or behind.returns:
            none = behind.command_init(jnp.zeros(()))
            us = [own for own, *_ in spools]
            _, spools = behind.command_through(none, us, h / len(us))
        return spools[0] if bare else mean_opening(spools)

    # Steps of several ticks are too coarse for what forgets nothing: it begins twice.
    begin = own.first - _steps(rig)[-1][0]
    memory = rig.command_init(ahead[0][0][..., 0])
    memory = _resumed(rig, memory, motion, own.seg, begin, late)
    memory, _ = jax.lax.scan(in_one_kernel(warm), memory, ahead)
    memory = _resumed(rig, memory, motion, own.seg, own.first, late)
    found = scan_in_blocks(in_one_kernel(follow), memory, held, opened)
    found = tuple(o.T for o in found)
    if cut is not None:
        return found
    return tuple(o.reshape(segments, -1)[:, :ticks] for o in found)


def _resumed(
    rig: Rig,
    memory: tuple,
    motion: Motion,
    seg: Int[Array | np.ndarray, "stretches"],
    tick: Int[Array | np.ndarray, "stretches"],
    late: Float[Array, ""] | float,
) -> tuple:
    """The memories ahead of ticks of segments, of what forgets nothing as it is after
    all that the command did before them; it comes `late` s late.
    """
    tick = jnp.clip(tick - 1, 0)
    at = jnp.clip(tick - jnp.ceil(late / motion.h[seg, tick]).astype(int), 0)
    return tuple(
        c.resume(m, c.follow(motion.u)[seg, at]) if isinstance(c, LastingChannel) else m
        for c, m in zip(rig.command, memory, strict=True)
    )


def _steps(rig: Rig) -> tuple[tuple[int, int], ...]:
    """The steps in which the path is run ahead of a stretch."""
    slow = any(isinstance(c, SpoolLimit) for c in rig.command)
    return SLOW_STEPS if slow else STEPS


def _whole(segments: int, ticks: int) -> Cut:
    """Stretches that make up all segments, those of each behind each other."""
    size = min(max(STRETCH, -(-segments * ticks // STRETCHES)), ticks)
    first = np.arange(0, ticks, size)
    seg = np.repeat(np.arange(segments), len(first))
    return Cut(seg, np.tile(first, segments), size)


def cut_of(rig: Rig, motion: Motion, w: Windows) -> tuple[Cut | None, Windows]:
    """A cut of the ticks that some windows are run over, where these are few, and the
    windows as they lie in it; else None, and the windows as they are.

    As `opened_in` reads them, and nothing else: friction follows whole segments.
    """
    ahead, ticks = _ahead(rig, w), w.x_fine.shape[1]
    if len(w.first) * (ticks + SETTLED) > motion.h.size:
        return None, w
    cut = Cut(w.seg, w.first - ahead, ticks + ahead)
    return cut, w._replace(seg=np.arange(len(w.seg)), first=0 * w.first + ahead)


def _ahead(rig: Rig, w: Windows) -> int:
    """Ticks ahead of windows that the lines are followed over, where there are any."""
    return min(IN_LINES, w.P_before.shape[1]) if rig.line else 0


def opened_in(rig: Rig, opened: Opened, w: Windows) -> Opened:
    """`openings` over the ticks of the windows, [..., ticks, W]; any leading axes.

    Where something stands in the lines, over `IN_LINES` ticks ahead of them too.
    """
    at = w.first[:, None] + jnp.arange(-_ahead(rig, w), w.x_fine.shape[1])
    at = jnp.clip(at, 0).T
    return tuple(o[..., w.seg, at] for o in opened)


def before_filters(rig: Rig, w: Windows) -> Windows:
    """The windows with P_a1, P_a2 and P_s as they stood ahead of what filtered them,
    and without `dP`, which says no more then.
    """
    # Signal by signal, so that a caller pays for those alone that it asks for.
    logged = [w.P_a1, w.P_a2, w.P_s]
    for channel in rig.sensor_P:
        for i, passed in enumerate((1.0, 1.0, channel.of_supply())):
            ahead = channel.ahead(logged[i], w.dP[:, :, i, 0], w.dP[:, :, i, 1])
            more = passed * (ahead - logged[i])
            logged[i] = logged[i] + w.filtered[:, None] * more
    P_a1, P_a2, P_s = logged
    return w._replace(P_a1=P_a1, P_a2=P_a2, P_s=P_s, dP=jnp.zeros_like(w.dP))


def at_start(
    rig: Rig, w: Windows, P_0: Float[Array, "windows 2"]
) -> Float[Array, "windows 2"]:
    """The pressures where the windows begin, Pa: `P_0`, which is as the log shows it,
    ahead of what filtered the log.
    """
    ahead = before_filters(rig, w)
    behind = (ahead.P_a1 - w.P_a1)[:, 0], (ahead.P_a2 - w.P_a2)[:, 0]
    return P_0 + jnp.stack(behind, axis=-1)


def pressures(
    rig: Rig, motion: Motion, w: Windows, P_0: Float[Array, "windows 2"]
) -> tuple[Float[Array, "windows n"], Float[Array, "windows n"]]:
    """Both chamber pressures at every tick, [W, lead+T] each, from `P_0` [W, 2]; Pa.

    The windows are cut from the segments of `motion`.
    """
    return pressures_behind(rig, w, P_0, opened_in(rig, openings(rig, motion), w))


def pressures_behind(
    rig: Rig, w: Windows, P_0: Float[Array, "windows 2"], opened: Opened
) -> tuple[Float[Array, "windows n"], Float[Array, "windows n"]]:
    """The same with the spool where `opened_in` has it."""

    def advance(carry, at):
        (line, P), (opening, inputs) = carry, at
        P, line = pressure_step(rig, P, opening, inputs, line)
        return (line, P), (refilled(P[0]), refilled(P[1]))

    inputs = tick_inputs(rig, w, before_filters(rig, w).P_s)
    P = (P_0[:, 0], P_0[:, 1])
    start = (line_start(rig, w, opened), P)
    own = tuple(o[-len(inputs.u) :] for o in opened)
    P_a1, P_a2 = scan_in_blocks(in_one_kernel(advance), start, (own, inputs))
    return (
        jnp.concatenate([P_0[:, :1], P_a1.T], axis=1),
        jnp.concatenate([P_0[:, 1:], P_a2.T], axis=1),
    )


def tick_inputs(rig: Rig, w: Windows, P_s: Float[Array, "windows n"]) -> StepInput:
    """What drives the pressures over each tick, [ticks, W, ...], at a supply `P_s`."""

    def ends(p):
        return jnp.stack([p[:, :-1], p[:, 1:]], axis=-1)

    inputs = StepInput(
        h=w.h[:, :-1],
        u=w.u[:, :-1],
        P_s=ends(P_s),
        P_r=ends(w.P_r),
        x=w.x_fine,
        dx=w.x_fine[..., :0],
        v=w.v[:, 1:],
        a=w.a[:, 1:],
        t=w.t[:, 1:],
        F=ends(w.F) if rig.stretch else None,
    )
    return jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), inputs)


def follow_line(
    rig: Rig, line: Lines, at: Point, h: Float[Array, "windows"], moved: tuple
) -> Lines:
    """What stands in the lines after a tick from `at`, over which the chambers'
    pressures rise by `moved`, Pa.
    """
    middle = (at.P_a1 + moved[0] / 2, at.P_a2 + moved[1] / 2)
    return follow_drops(rig, at, rig.line_step(line, *middle, h), h, moved)


def line_start(rig: Rig, w: Windows, opened: Opened) -> Lines | None:
    """What stands in the lines where the windows begin, by the measured pressures
    ahead of them.
    """
    P_1, P_2 = (
        jnp.concatenate([before.T, own[:, :1].T])
        for before, own in zip(
            jnp.moveaxis(w.P_before[:, -SETTLED:], 2, 0),
            (w.P_a1, w.P_a2),
            strict=True,
        )
    )
    line, h = rig.line_init(P_1[0], P_2[0]), w.before_h[:, -SETTLED:].T
    if line is None:
        return None

    def settle(line, tick):
        return rig.line_step(line, *tick), None

    w = before_filters(rig, w)
    near = len(opened[0]) - w.x_fine.shape[1]
    far = len(h) - near
    early = (P_1[:far], P_2[:far], h[:far])
    line = jax.lax.scan(in_one_kernel(settle), line, early)[0]

    P_1, P_2 = P_1[far:], P_2[far:]
    P_s, P_r, x, v, t = (
        jnp.broadcast_to(a[:, 0], P_1.shape) for a in (w.P_s, w.P_r, w.x, w.v, w.t)
    )
    at = Point(P_1, P_2, P_s, P_r, tuple(o[: near + 1] for o in opened), x, v, t=t)
    line = settled_drops(rig, jax.tree.map(lambda a: a[0], at), line)
    moved = (jnp.diff(P_1, axis=0), jnp.diff(P_2, axis=0))
    ticks = (jax.tree.map(lambda a: a[:near], at), h[far:], moved)

    def follow(line, tick):
        return follow_line(rig, line, *tick), None

    return jax.lax.scan(in_one_kernel(follow), line, ticks)[0]


def _sense(
    channels: tuple,
    y: Float[Array, "windows n"],
    w: Windows,
    read: tuple[Float[Array, "windows"], Float[Array, "windows"]] | None = None,
) -> Float[Array, "windows n"]:
    """A sensor's reading of `y` [W, n] along its second axis.

    `read` is the first tick's where it is known, and its slope: what the last channel
    has kept of what came before stands in them.
    """
    slope = (y[:, 1] - y[:, 0]) / w.h[:, 0]
    for i, channel in enumerate(channels, 1):
        known = read if i == len(channels) else None
        ahead = y, slope
        y, slope = channel.run(y, slope, w.h[:, :-1], known)
        if channel.of_the_logger:
            y, slope = (
                jnp.where((w.filtered > 0).reshape(-1, *[1] * (a.ndim - 1)), a, b)
                for a, b in zip((y, slope), ahead, strict=True)
            )
    return y


def forces(
    rig: Rig,
    w: Windows,
    P_a1: Float[Array, "windows n"],
    P_a2: Float[Array, "windows n"],
    past: Past,
) -> Float[Array, "windows n"]:
    """The output force at every tick, before the load cell, [W, lead+T], N.

    Each tick's is its own affair: `P_a1`, `P_a2` [W, lead+T] from `pressures` or the
    log, `past` at the windows.
    """
    z, speed, v, slips, turned = past
    rate = rig.mechanics.z_rate(z, v)
    speed, late = rig.films(speed)
    at = Sliding(
        w.t, w.x, v, w.a, z, rate, speed, P_a1, P_a2, w.P_s, slips=slips, **late
    )
    return rig.output_force(at._replace(**(turned.seen() if turned else {})))


def sensed(
    rig: Rig,
    w: Windows,
    P_a1: Float[Array, "windows n"],
    P_a2: Float[Array, "windows n"],
    F: Float[Array, "windows n"],
) -> Float[Array, "windows scored 3"]:
    """What the sensors read of signals [W, lead+T], [W, T, 3]; linear in them."""
    lead = w.x.shape[1] - w.scored
    y = [
        _sense(rig.gauge(0), P_a1, w, (w.P_a1[:, 0], w.dP[:, 0, 0, 0])),
        _sense(rig.gauge(1), P_a2, w, (w.P_a2[:, 0], w.dP[:, 0, 1, 0])),
        _sense(rig.sensor_F, F, w),
    ]
    return jnp.stack([c[:, lead:] for c in y], axis=-1)


def readings(
    rig: Rig,
    w: Windows,
    P_a1: Float[Array, "windows n"],
    P_a2: Float[Array, "windows n"],
    past: Past,
) -> Float[Array, "windows scored 3"]:
    """What the sensors read, [W, T, 3] (P_a1, P_a2 in Pa, F in N); see `forces`."""
    return sensed(rig, w, P_a1, P_a2, forces(rig, w, P_a1, P_a2, past))
