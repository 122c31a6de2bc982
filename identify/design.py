"""The next experiment: a reference and a motion that tell what the logs did not.

What a log tells of the parameters is known before it is recorded, from the model: the
information of the replay that `identify` would run on it. So amplitudes of sines in the
desired force and in the motion are moved, by the gradient of that information through
the closed loop and the replay, within the limits of the rig.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from scipy import optimize

from hydrojax.control.loop import Loop, Scenario, run
from hydrojax.control.simulation import PARTS
from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError
from hydrojax.identify.estimation.columns import Batch, Model, basis, slot_names
from hydrojax.identify.estimation.misfit import sums
from hydrojax.identify.estimation.problem import Free, free_parameters
from hydrojax.identify.preparation.windows import LEAD, PRE, QUARTERS
from hydrojax.parameters import parameter_specs, specs
from hydrojax.plant.load import EnvironmentMotion
from hydrojax.plant.replay import Motion, Windows
from hydrojax.rigfile.build import build_loop, build_rig, over_travel
from hydrojax.rigfile.schema import RigFile
from hydrojax.units import with_command

FORCE_HZ = (0.1, 0.23, 0.5, 1.1, 2.3, 4.7, 9.0, 16.0, 27.0, 45.0)
MOTION_HZ = (0.07, 0.13, 0.23, 0.41, 0.73, 1.3, 2.3)
"""Frequencies of the sines whose amplitudes are found."""

WINDOW = 250
"""Ticks of a replay window."""

SLACK = 0.05
"""Share of the supply's range, and of the command's, that is to stay unused."""

ENOUGH = 0.005
"""Relative standard deviation below which a better one is worth little."""

STERN = 1e4
"""Weight of what leaves the rig's limits, mean square, against the log of a spread."""

RIDGE = 1e-3
"""Information that is taken for granted of each parameter, per scale squared: what no
course can tell stays finite."""


@dataclass(frozen=True)
class Limits:
    """What the rig may be asked for: N, m/s, m from its middle, s."""

    force: float = 800.0
    speed: float = 0.025
    travel: float = 0.02
    seconds: float = 8.0


class Waves(NamedTuple):
    """Amplitudes [n] of the sines in force (N) and motion (m)."""

    force: Array
    motion: Array


@dataclass(frozen=True)
class Design:
    """A course, and what it tells beside what an undesigned one does.

    `t` [n] s, `F_d` [n] N, `x` [n] m; `before` and `after` are standard deviations by
    parameter (SI), or for two effects the least strength that the course would show at
    three standard deviations, the other effect and all parameters left free.
    """

    t: np.ndarray
    F_d: np.ndarray
    x: np.ndarray
    before: dict[str, float]
    after: dict[str, float]
    units: dict[str, str]


class _Question(NamedTuple):
    """What is asked: the model, its values, columns, and those that matter."""

    model: Model
    values: Array
    names: tuple[str, ...]
    wanted: tuple[str, ...]
    h: float
    P_r: float
    P_s: float


def _share(logits: Array) -> Array:
    """Positive shares that sum to less than one."""
    return jax.nn.softmax(jnp.append(logits, -2.0))[:-1]


def waves(design: Array, limits: Limits) -> Waves:
    """Amplitudes from logits: at any phases they keep force, speed and travel."""
    n = len(FORCE_HZ)
    w = 2 * jnp.pi * jnp.array(MOTION_HZ)
    speed = _share(design[n:])
    reach = jnp.maximum(
        jnp.sum(speed) / limits.speed, jnp.sum(speed / w) / limits.travel
    )
    return Waves(limits.force * _share(design[:n]), speed / w / reach)


def _scenario(
    at: Waves, phases: tuple[np.ndarray, np.ndarray], n: int, q: _Question
) -> tuple[Scenario, Callable[[Array, int], Array]]:
    """The course of some amplitudes, without noise, and its motion."""
    w_F = 2 * np.pi * np.array(FORCE_HZ)
    w_x = 2 * np.pi * np.array(MOTION_HZ)

    def path(t, nu):
        angle = jnp.multiply(t[..., None], w_x) + phases[1] + nu * np.pi / 2
        return jnp.sum(at.motion * w_x**nu * jnp.sin(angle), axis=-1)

    t = jnp.arange(n) * q.h
    F_d = jnp.sum(at.force * jnp.sin(t[:, None] * w_F + phases[0]), axis=-1)
    part = np.arange(PARTS)[:, None] + np.array([0.0, 0.5, 1.0])
    halves = t[:, None, None] + q.h / PARTS * part
    environment = EnvironmentMotion(
        path(halves, 0), path(halves[..., 2], 1), path(halves[..., 2], 2)
    )
    flat = jnp.ones((n, 2))
    return Scenario(
        t, F_d, jnp.zeros((n, 4)), q.P_s * flat, q.P_r * flat, environment
    ), path


def _batch(
    table: Array, path: Callable, noise: np.ndarray, supply: float, q: _Question
) -> Batch:
    """What `identify` would make of a run's log; `table` [n, 4]: u, P_a1, P_a2, F."""
    n = table.shape[0]
    t = jnp.arange(n) * q.h
    first = np.arange(PRE, n - LEAD - WINDOW, WINDOW)
    index = first[:, None] + np.arange(LEAD + WINDOW)
    quarters = t[:-1, None] + q.h * np.arange(QUARTERS + 1) / QUARTERS
    fine = t[index[:, :-1]][..., None] + q.h * np.array([0.0, 0.5, 1.0])
    like = jnp.ones(index.shape)
    windows = Windows(
        seg=jnp.zeros(len(first), int),
        first=jnp.asarray(first),
        before=table[first[:, None] - PRE + np.arange(PRE), 0],
        before_h=q.h * jnp.ones((len(first), PRE)),
        u=table[index, 0],
        h=q.h * like,
        P_s=q.P_s * like,
        P_r=q.P_r * like,
        t=t[index],
        x=path(t[index], 0),
        v=path(t[index], 1),
        a=path(t[index], 2),
        F=table[index, 3],
        x_fine=path(fine, 0),
        P_a1=table[index, 1],
        P_a2=table[index, 2],
        measured=jnp.zeros((len(first), WINDOW, 3)),
    )
    dx = jnp.diff(path(quarters, 0), axis=1)[None]
    v = path(t, 1)[None]
    ticks = q.h * jnp.ones((1, n - 1))
    motion = Motion(dx, ticks, jnp.abs(v[:, 0]), v, table[None, :, 3])
    return Batch(
        motion,
        windows,
        table[first, 1:3],
        jnp.asarray(noise),
        jnp.asarray(supply),
        jnp.ones(len(first)),
    )


def _information(q: _Question, batch: Batch) -> tuple[Array, list[str]]:
    """Information matrix of the columns, per scale, and their names in its order."""
    first = sum(q.model.names.index(n) < q.model.hydraulic for n in q.names)
    slots = (first, len(q.names) - first)
    directions = basis(q.model, q.names, slots)
    gram = sums(q.model, q.values, directions, batch, True).gram
    order = [n for n in slot_names(q.model, q.names, slots) if n is not None]
    total = jnp.sum(gram, axis=0)[:-1, :-1]
    return total + RIDGE * jnp.eye(len(order)), order


def _spreads(information: Array, order: list[str], wanted: Sequence[str]) -> Array:
    """Variance of each wanted parameter, all others free, in scales."""
    variance = jnp.diag(jnp.linalg.inv(information))
    return variance[np.array([order.index(n) for n in wanted])]


def _outside(table: Array, loop: Loop, q: _Question, force: float) -> Array:
    """How far pressures, command and force leave what they may use; 0 inside."""
    room = SLACK * (q.P_s - q.P_r)
    low, high = q.P_r + room - table[:, 1:3], table[:, 1:3] - (q.P_s - room)
    full = jnp.abs(table[:, :1]) / loop.law.u_max - (1 - SLACK)
    # Beyond the loop's resonance the force is larger than what was asked for.
    strong = jnp.abs(table[:, 3:]) / force - 1
    over = jnp.concatenate([low / q.P_s, high / q.P_s, full, strong], axis=1)
    return jnp.mean(jnp.maximum(over, 0.0) ** 2)


def design(
    spec: RigFile,
    limits: Limits = Limits(),
    separate: Sequence[str] = (),
    seed: int = 0,
    steps: int = 15,
    progress: Callable[[str], None] = lambda _: None,
) -> Design:
    """Find the course that best identifies a rig, or best tells two effects apart.

    Args:
        spec: a fitted rig; what has a range is what is to be identified.
        limits: what it may be asked for.
        separate: two effects to be told apart, if that is the question.
        seed: of the phases.
        steps: of the gradient descent, at most.
        progress: called with a line of text as the design proceeds.

    Raises:
        InputError: nothing is to be found, an unknown effect, or no noise given.
    """
    for name in separate:
        if name not in EFFECTS:
            raise InputError(
                f"--separate {name!r}: known effects: {', '.join(EFFECTS)}"
            )
    asked = ask(spec, limits, separate, seed)
    # Forward mode: fewer directions than a run has samples, and nothing to store.
    both = jax.jit(lambda at: (asked.cost(at), jax.jacfwd(asked.cost)(at)))
    start = np.zeros(len(FORCE_HZ) + len(MOTION_HZ))
    last = [0]

    def evaluate(at):
        value, slope = both(jnp.asarray(at))
        last[0] += 1
        progress(
            f"try {last[0]}: mean relative spread {100 * np.exp(float(value)):.3g} %"
        )
        return float(value), np.asarray(slope)

    found = optimize.minimize(
        evaluate, start, jac=True, method="L-BFGS-B",
        bounds=[(-8.0, 8.0)] * start.size,
        options={"maxiter": steps, "maxfun": 2 * steps, "ftol": 1e-4},
    )  # fmt: skip
    seen = jax.jit(asked.spreads)
    times = 3.0 if separate else 1.0

    def sizes(at):
        each = times * np.asarray(seen(jnp.asarray(at))) * asked.scale
        return dict(zip(asked.q.wanted, each.tolist(), strict=True))

    scenario, path = asked.scenario(jnp.asarray(found.x))
    known = parameter_specs(asked.q.model.rig)
    return Design(
        t=np.asarray(scenario.t),
        F_d=np.asarray(scenario.F_d),
        x=np.asarray(path(scenario.t, 0)),
        before=sizes(start),
        after=sizes(found.x),
        units={
            name: with_command(known[name].unit, spec.command_unit)
            for name in asked.q.wanted
        },
    )


@dataclass(frozen=True)
class DesignProblem:
    """What a course tells, as functions of its logits (`waves`)."""

    q: _Question
    loop: Loop
    limits: Limits
    phases: tuple[np.ndarray, np.ndarray]
    noise: np.ndarray
    supply: float

    @property
    def scale(self) -> np.ndarray:
        """What one unit of a spread is for each wanted parameter, SI."""
        every = dict(zip(self.q.model.names, self.q.model.scale, strict=True))
        return np.array([every[n] for n in self.q.wanted])

    def scenario(self, at: Array) -> tuple[Scenario, Callable[[Array, int], Array]]:
        """The course of some logits, without noise, and its motion."""
        n = round(self.limits.seconds / self.q.h)
        return _scenario(waves(at, self.limits), self.phases, n, self.q)

    def look(self, at: Array) -> tuple[Array, Array]:
        """Standard deviations of what is wanted, in scales, and what is overstepped."""
        scenario, path = self.scenario(at)
        table = run(self.loop, scenario, ("u", "true_P_a1", "true_P_a2", "true_F"))
        batch = _batch(table, path, self.noise, self.supply, self.q)
        information, order = _information(self.q, batch)
        over = _outside(table, self.loop, self.q, self.limits.force)
        return jnp.sqrt(_spreads(information, order, self.q.wanted)), over

    def spreads(self, at: Array) -> Array:
        """The first of `look`."""
        return self.look(at)[0]

    def cost(self, at: Array) -> Array:
        """Mean log of the relative spreads, with what is overstepped."""
        values = [
            abs(self.q.values[self.q.model.names.index(n)]) for n in self.q.wanted
        ]
        # A strength that is zero counts as a tenth of its scale.
        size = jnp.maximum(jnp.stack(values) / self.scale, 0.1)
        spread, over = self.look(at)
        return jnp.mean(jnp.log(spread / size + ENOUGH)) + STERN * over


def ask(
    spec: RigFile, limits: Limits, separate: Sequence[str] = (), seed: int = 0
) -> DesignProblem:
    """What `design` improves; see there."""
    rng = np.random.default_rng(seed)
    phases = (
        rng.uniform(0, 2 * np.pi, len(FORCE_HZ)),
        rng.uniform(0, 2 * np.pi, len(MOTION_HZ)),
    )
    q, loop, noise, supply = _question(spec, free_parameters(spec), separate, limits)
    return DesignProblem(q, loop, limits, phases, noise, supply)


def _question(
    spec: RigFile, free: dict[str, Free], separate: Sequence[str], limits: Limits
) -> tuple[_Question, Loop, np.ndarray, float]:
    if not free and not separate:
        raise InputError(
            f"{spec.path}: nothing to identify: give at least one parameter a range"
        )
    lacking = {"P_a1", "P_a2", "F"} - set(spec.sensors)
    if lacking:
        raise InputError(
            f"{spec.path}: [sensors] lacks the noise of {', '.join(sorted(lacking))}: "
            "what a log would tell depends on it"
        )
    spec = over_travel(spec, (-limits.travel, limits.travel))
    rig = build_rig(spec, separate)
    model = Model.of(rig)
    wanted = tuple(free)
    if separate:
        wanted = tuple(
            f"{name}.{field}"
            for name in separate
            for field, s in specs(EFFECTS[name]).items()
            if s.strength
        )
    loop = build_loop(spec, build_rig(spec))
    names = tuple(dict.fromkeys((*free, *wanted)))
    q = _Question(
        model,
        model.values,
        names,
        wanted,
        float(loop.h),
        spec.line["P_r"],
        spec.line["P_s"],
    )
    noise = np.array([spec.sensors[c] for c in ("P_a1", "P_a2", "F")])
    step = eqx.tree_at(lambda lo: lo.sensors.step, loop, jnp.zeros(()))
    return q, step, noise, spec.sensors.get("P_s", 0.0)
