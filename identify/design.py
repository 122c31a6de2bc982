"""The next experiment: a reference and a motion that identify what the logs did not.

The amplitudes of sines in the desired force and in the motion are moved along the
gradient of the information in the log that they would give (`experiment`), within the
limits of the rig.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import optimize

from hydrojax.control.loop import Loop, Scenario, run
from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError, check_known
from hydrojax.identify.estimation.columns import ParametricRig
from hydrojax.identify.estimation.known import Free, free_parameters
from hydrojax.identify.experiment import (
    ENOUGH,
    FORCE_HZ,
    MOTION_HZ,
    PENALTY,
    ExcitationLimits,
    Phases,
    Setup,
    Trajectory,
    excess,
    excitation,
    information,
    log_batch,
    variances,
    waves,
)
from hydrojax.parameters import parameter_specs, specs
from hydrojax.rigfile.build import build_loop, build_rig, over_travel
from hydrojax.rigfile.schema import RigFile
from hydrojax.units import with_command


@dataclass(frozen=True)
class Design:
    """A designed experiment, beside the one with all amplitudes as they start.

    Attributes:
        t: time, s.
        F_d: desired force, N.
        x: position of the piston, m.
        before: standard deviation of each parameter in the undesigned experiment, SI;
            for two effects the smallest strength that it would show at three standard
            deviations, the other effect and all parameters free.
        after: the same in the designed one.
        units: of each parameter.
    """

    t: Float[np.ndarray, "ticks"]
    F_d: Float[np.ndarray, "ticks"]
    x: Float[np.ndarray, "ticks"]
    before: dict[str, float]
    after: dict[str, float]
    units: dict[str, str]


def design(
    spec: RigFile,
    limits: ExcitationLimits = ExcitationLimits(),
    separate: Sequence[str] = (),
    seed: int = 0,
    steps: int = 15,
    progress: Callable[[str], None] = lambda _: None,
) -> Design:
    """Find the experiment that best identifies a rig, or best separates two effects.

    Args:
        spec: a fitted rig; its parameters with a range are those to be identified.
        limits: what the excitation keeps.
        separate: two effects to be distinguished, in place of the parameters.
        seed: of the phases.
        steps: of the gradient descent, at most.
        progress: called with a line of text as the design proceeds.

    Raises:
        InputError: no parameter has a range, an unknown effect, or no noise given.
    """
    check_known("--separate:", separate, EFFECTS, "effect")
    if len(separate) != len(set(separate)):
        raise InputError(f"--separate {' '.join(separate)}: name two different effects")
    problem = design_problem(spec, limits, separate, seed)
    start = np.zeros(len(FORCE_HZ) + len(MOTION_HZ))
    best = _minimised(problem, start, steps, progress)
    spreads = jax.jit(problem.spreads)
    times = 3.0 if separate else 1.0
    wanted = problem.setup.wanted

    def sizes(at):
        each = times * np.asarray(spreads(jnp.asarray(at))) * problem.scale
        return dict(zip(wanted, each.tolist(), strict=True))

    scenario, path = problem.scenario(jnp.asarray(best))
    known = parameter_specs(problem.setup.model.rig)
    return Design(
        t=np.asarray(scenario.t),
        F_d=np.asarray(scenario.F_d),
        x=np.asarray(path(scenario.t, 0)),
        before=sizes(start),
        after=sizes(best),
        units={n: with_command(known[n].unit, spec.command_unit) for n in wanted},
    )


def _minimised(
    problem: DesignProblem,
    start: np.ndarray,
    steps: int,
    progress: Callable[[str], None],
) -> np.ndarray:
    """The logits of the lowest cost that a gradient descent from `start` finds."""
    # Forward mode: fewer directions than a run has samples, and nothing to store.
    both = jax.jit(lambda at: (problem.cost(at), jax.jacfwd(problem.cost)(at)))
    done = [0]

    def evaluate(at):
        value, slope = both(jnp.asarray(at))
        done[0] += 1
        percent = 100 * np.exp(float(value))
        progress(f"try {done[0]}: mean relative standard deviation {percent:.3g} %")
        return float(value), np.asarray(slope)

    return optimize.minimize(
        evaluate, start, jac=True, method="L-BFGS-B",
        bounds=[(-8.0, 8.0)] * start.size,
        options={"maxiter": steps, "maxfun": 2 * steps, "ftol": 1e-4},
    ).x  # fmt: skip


@dataclass(frozen=True)
class DesignProblem:
    """The information of an experiment, as functions of its logits (see `waves`).

    Attributes:
        setup: the model and the parameters of interest.
        loop: the rig in closed loop.
        limits: what the excitation keeps.
        phases: of the sines in force and in motion, rad.
        noise: standard deviations of P_a1, P_a2 (Pa) and F (N).
        supply: standard deviation of the measured supply pressure, Pa.
    """

    setup: Setup
    loop: Loop
    limits: ExcitationLimits
    phases: Phases
    noise: Float[np.ndarray, "3"]
    supply: float

    @property
    def scale(self) -> Float[np.ndarray, "wanted"]:
        """The scale of each parameter of interest, SI: the unit of `spreads`."""
        every = dict(zip(self.setup.model.names, self.setup.model.scale, strict=True))
        return np.array([every[n] for n in self.setup.wanted])

    def scenario(self, at: Float[Array, "logits"]) -> tuple[Scenario, Trajectory]:
        """The scenario at these logits, without noise, and its motion."""
        n = round(self.limits.seconds / self.setup.h)
        return excitation(waves(at, self.limits), self.phases, n, self.setup)

    def evaluate(
        self, at: Float[Array, "logits"]
    ) -> tuple[Float[Array, "wanted"], Float[Array, ""]]:
        """Standard deviations in units of `scale`, and the excess over the limits."""
        scenario, path = self.scenario(at)
        table = run(self.loop, scenario, ("u", "true_P_a1", "true_P_a2", "true_F"))
        batch = log_batch(table, path, self.noise, self.supply, self.setup)
        gram, order = information(self.setup, batch)
        over = excess(table, self.loop, self.setup, self.limits.force)
        return jnp.sqrt(variances(gram, order, self.setup.wanted)), over

    def spreads(self, at: Float[Array, "logits"]) -> Float[Array, "wanted"]:
        """Standard deviations of the parameters of interest, in units of `scale`."""
        return self.evaluate(at)[0]

    def cost(self, at: Float[Array, "logits"]) -> Float[Array, ""]:
        """Mean log of the relative standard deviations, with the limits' penalty."""
        names = self.setup.model.names
        values = [abs(self.setup.values[names.index(n)]) for n in self.setup.wanted]
        # A strength that is zero counts as a tenth of its scale.
        size = jnp.maximum(jnp.stack(values) / self.scale, 0.1)
        spread, over = self.evaluate(at)
        return jnp.mean(jnp.log(spread / size + ENOUGH)) + PENALTY * over


def design_problem(
    spec: RigFile, limits: ExcitationLimits, separate: Sequence[str] = (), seed: int = 0
) -> DesignProblem:
    """The problem that `design` solves; see there for the arguments.

    Raises:
        InputError: no parameter has a range, or a sensor's noise is not given.
    """
    rng = np.random.default_rng(seed)
    phases = (
        rng.uniform(0, 2 * np.pi, len(FORCE_HZ)),
        rng.uniform(0, 2 * np.pi, len(MOTION_HZ)),
    )
    setup, loop, noise, supply = _setup_of(
        spec, free_parameters(spec), separate, limits
    )
    return DesignProblem(setup, loop, limits, phases, noise, supply)


def _setup_of(
    spec: RigFile,
    free: Mapping[str, Free],
    separate: Sequence[str],
    limits: ExcitationLimits,
) -> tuple[Setup, Loop, np.ndarray, float]:
    if not free and not separate:
        raise InputError(
            f"{spec.path}: nothing to identify: give at least one parameter a range"
        )
    lacking = {"P_a1", "P_a2", "F"} - set(spec.sensors)
    if lacking:
        raise InputError(
            f"{spec.path}: [sensors] lacks the noise of {', '.join(sorted(lacking))}: "
            "what a log would identify depends on it"
        )
    spec = over_travel(spec, (-limits.travel, limits.travel))
    rig = build_rig(spec, separate)
    model = ParametricRig.of(rig)
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
    setup = Setup(
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
    return setup, step, noise, spec.sensors.get("P_s", 0.0)
