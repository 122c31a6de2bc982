"""What a loop is tuned for: bandwidth over an ensemble, and what it must keep.

Bandwidth, peak, robustness, noise and command come from the linearised loop; tracking
from a simulated run with the joint moving and the adaptation at work. All of it is
differentiable in the gains, through the Jacobian of the step and through the run.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.control.loop import Scenario, run
from hydrojax.control.simulation import make_scenario
from hydrojax.control.waveforms import sinusoidal_path
from hydrojax.parameters import put
from hydrojax.rigfile.quantities import Quantity, Setting
from hydrojax.tune import linearize, metrics, operating_point
from hydrojax.tune.ensemble import Plants
from hydrojax.tune.program import program

SPEED, PERIOD = 0.03, 3.0
"""The joint's motion while tracking is judged: peak m/s, s; the paper's."""

FORCE, FORCE_HZ = 300.0, 0.5
"""The desired force meanwhile: N, Hz; the paper's."""

SECONDS, SKIP = 4.0, 1.0
"""Length of that run, and what of it is not counted, s."""

LOW_HZ = 2.0
"""Where the loop must reject what disturbs it as well as before."""

WIDTH = 0.15
"""Over how many dB "within 1 dB" fades in the smooth bandwidth."""


@dataclass(frozen=True)
class Limits:
    """What the tuned loop must keep, for every plant of the ensemble.

    Attributes:
        within_dB: |F/F_d| up to the bandwidth, dB.
        peak_dB: largest |F/F_d|, dB.
        sensitivity_dB: largest |1 / (1 + L)| of the loop opened at the command: 6 dB
            ensure a gain margin of 6 dB and a phase margin of 29 degrees.
        noise: RMS of the command by sensor noise, share of u_max.
        push: command at the setting's amplitude up to the bandwidth, share of u_max.
        tracking: RMS of F_d - F in the moving run, relative to the rig's own before.
        rejection: of disturbances at LOW_HZ, relative to before.
    """

    within_dB: float = 1.0
    peak_dB: float = 3.0
    sensitivity_dB: float = 6.0
    noise: float = 0.01
    push: float = 0.9
    tracking: float = 3.0
    rejection: float = 0.7


CONSTRAINTS = ("peak", "sensitivity", "noise", "push", "tracking", "rejection")
"""The constraints, in the order in which `Objective` gives them."""


def moving(setting: Setting) -> Scenario:
    """The run in which tracking is judged."""
    h = float(setting.loop.h)
    t = np.arange(round(SECONDS / h)) * h
    F_d = FORCE * np.sin(2 * np.pi * FORCE_HZ * t)
    P_s, P_r = float(setting.P_s), float(setting.P_r)
    return make_scenario(F_d, sinusoidal_path(SPEED, PERIOD), h, P_s, P_r, seed=0)


def softmax(values: Float[Array, "n"], sharp: float) -> Float[Array, ""]:
    """The largest of `values`, smoothly: `sharp` is 1 over what is seen as equal."""
    return jax.scipy.special.logsumexp(sharp * values) / sharp


class _Given(NamedTuple):
    """What the compiled functions are given: numbers, so that none compiles anew."""

    setting: Setting
    plants: Array  # [m, parameters]
    limits: Array  # [5]: within, peak, sensitivity, noise, push
    low: Array  # dB


class Objective:
    """Bandwidth and constraints of a setting as functions of some of its quantities.

    Args:
        setting: the loop at its operating point.
        free: the quantities that may change.
        plants: the ensemble.
        limits: what must be kept.
    """

    def __init__(
        self, setting: Setting, free: list[Quantity], plants: Plants, limits: Limits
    ):
        self.setting, self.free, self.limits = setting, free, limits
        self.names, self.values = plants.names, np.asarray(plants.values)
        self.hertz = jnp.asarray(metrics.grid(float(1 / setting.loop.h)))
        self.scenario = moving(setting)
        stack = jax.vmap(lambda v: self._at(setting, None, v))
        still = operating_point.still(stack(jnp.asarray(self.values)))
        self.settle = (
            0 if still else round(operating_point.SETTLE / float(setting.loop.h))
        )
        # Nowhere 0, so that what a gain of 0 would leave out is among the states.
        gains = jnp.asarray(np.maximum(1.01 * self.initial(), 1e-4))
        full = program(
            jax.vmap(lambda v: self._system(self._at(setting, gains, v), None))
        )
        self.states = linearize.find_states(full(jnp.asarray(self.values)))
        self._linear = program(self._all)
        self._slope = program(jax.jacfwd(self._scores, has_aux=True))
        self._run = jax.jit(self._tracking)
        self._run_slope = jax.jit(jax.jacfwd(self._tracking))
        self.before: dict[str, np.ndarray] = {}
        self.before = self.evaluate(None)

    def relaxed(
        self,
        setting: Setting | None = None,
        values: Float[np.ndarray, "plants parameters"] | None = None,
        limits: Limits | None = None,
    ) -> Objective:
        """The same objective with other numbers; nothing is compiled anew.

        What it must keep relative to before, it keeps relative to the same before.
        """
        out = copy.copy(self)
        out.setting = self.setting if setting is None else setting
        out.values = self.values if values is None else values
        out.limits = self.limits if limits is None else limits
        return out

    def initial(self) -> Float[np.ndarray, "gains"]:
        """The setting's own values of what is free, in their units."""
        return np.array([float(q.get(self.setting)) for q in self.free])

    def at(self, gains: Any, plant: int = 0) -> Setting:
        """The setting of one plant with these gains."""
        values = jnp.asarray(self.values[plant])
        given = None if gains is None else jnp.asarray(gains)
        return self._at(self.setting, given, values)

    def evaluate(
        self, gains: Float[np.ndarray, "gains"] | None
    ) -> dict[str, Float[np.ndarray, "plants *rest"]]:
        """Metrics of all plants, and `rms` (N); None: with the gains as set."""
        given, g = self._given(), None if gains is None else jnp.asarray(gains)
        found = self._linear(g, given)
        rms = self._run(g, given)
        return {n: np.asarray(v) for n, v in found.items()} | {"rms": np.asarray(rms)}

    def over(self, free: list[Quantity], setting: Setting) -> Objective:
        """The objective of other quantities of a setting, for its run alone."""
        out = self.relaxed(setting=setting)
        out.free = free
        return out

    def compiled_run(
        self,
    ) -> tuple[
        Callable[[Float[Array, "gains"]], Float[Array, "plants"]],
        Callable[[Float[Array, "gains"]], Float[Array, "plants gains"]],
    ]:
        """`run` as a compiled function, and its derivative by each gain."""
        given = self._given()
        run, slope = jax.jit(self._tracking), jax.jit(jax.jacfwd(self._tracking))
        return lambda gains: run(gains, given), lambda gains: slope(gains, given)

    def run(self, gains: Float[np.ndarray, "gains"]) -> Float[np.ndarray, "plants"]:
        """RMS of F_d - F of each plant with the joint moving, N."""
        return np.asarray(jax.jit(self._tracking)(jnp.asarray(gains), self._given()))

    def scores(
        self, gains: Float[np.ndarray, "gains"]
    ) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "7 gains"], bool]:
        """Log bandwidth and `CONSTRAINTS` (kept where >= 0), slopes, whether stable.

        Slopes are per unit of each gain.
        """
        given, g = self._given(), jnp.asarray(gains)
        slope, (value, radius) = self._slope(g, given)
        rms, steep = (np.asarray(f(g, given)) for f in (self._run, self._run_slope))
        worst = int(np.argmax(rms))
        kept = self.limits.tracking * float(self.before["rms"][0])
        value = np.insert(np.asarray(value), 5, np.log(kept / rms[worst]))
        slope = np.insert(np.asarray(slope), 5, -steep[worst] / rms[worst], axis=0)
        finite = np.all(np.isfinite(value)) and np.all(np.isfinite(slope))
        return value, slope, bool(radius < 1) and bool(finite)

    def _given(self) -> _Given:
        keep = self.limits
        low = 0.0
        if self.before:
            low = float(np.max(self.before["low"])) - 20 * np.log10(keep.rejection)
        shape = (keep.within_dB, keep.peak_dB, keep.sensitivity_dB)
        limits = (*shape, keep.noise, keep.push)
        return _Given(
            self.setting, jnp.asarray(self.values), jnp.array(limits), jnp.asarray(low)
        )

    def _at(self, setting: Setting, gains: Array | None, plant: Array) -> Setting:
        rig = put(setting.loop.rig, self.names, plant)
        s = eqx.tree_at(lambda q: q.loop.rig, setting, rig)
        if gains is not None:
            for i, quantity in enumerate(self.free):
                s = quantity.put(s, gains[i])
        return s

    def _system(self, s: Setting, states: linearize.States | None) -> linearize.System:
        return linearize.system(
            s, operating_point.initial_state(s, settle=self.settle), states
        )

    def _answer(self, s: Setting) -> tuple[Array, linearize.System]:
        system = self._system(s, self.states)
        return linearize.frequency_response(system, self.hertz), system

    def _all(self, gains: Array | None, given: _Given) -> dict[str, Array]:
        def one(plant):
            H, system = self._answer(self._at(given.setting, gains, plant))
            low = jnp.interp(LOW_HZ, self.hertz, metrics.dB(H[:, 1, 1]))
            found = metrics.loop_metrics(self.hertz, H, linearize.radius(system))
            return found | {"response": H[:, 0, 0], "low": low}

        return jax.vmap(one)(given.plants)

    def _scores(self, gains: Array, given: _Given) -> tuple[Array, tuple[Array, Array]]:
        """Log bandwidth, all constraints but tracking; the same, and the radius."""
        most, peak, sensitivity, noise, push = given.limits
        u_max = given.setting.loop.law.u_max

        def one(plant):
            H, system = self._answer(self._at(given.setting, gains, plant))
            track, sense = metrics.dB(H[:, 0, 0]), metrics.dB(H[:, 1, 1])
            kept = metrics.soft_inside(H[:, 0, 0], most, WIDTH)
            heard = sum(metrics.rms(self.hertz, H[:, 1, i]) ** 2 for i in (2, 3, 4))
            pushed = given.setting.amplitude * kept * jnp.abs(H[:, 1, 0]) / u_max
            row = jnp.stack([
                self.hertz[0] + jnp.sum(kept[1:] * jnp.diff(self.hertz)),
                softmax(track, 20.0), softmax(sense, 20.0),
                jnp.sqrt(heard + 1e-20) / u_max, softmax(pushed, 200.0),
                jnp.interp(LOW_HZ, self.hertz, sense),
            ])  # fmt: skip
            return row, linearize.radius(jax.lax.stop_gradient(system))

        rows, radius = jax.vmap(one)(given.plants)
        band, top, sense, heard, pushed, low = rows.T
        least = -softmax(-band, 2.0) + jnp.log(band.size) / 2.0
        scores = jnp.stack([
            jnp.log(jnp.maximum(least, 1e-3)),
            (peak - jnp.max(top)) / 3,
            (sensitivity - jnp.max(sense)) / 3,
            jnp.log(noise / jnp.max(heard)),
            jnp.log(push / jnp.max(pushed)),
            (given.low - jnp.max(low)) / 3,
        ])  # fmt: skip
        return scores, (scores, jnp.max(radius))

    def _tracking(self, gains: Array | None, given: _Given) -> Array:
        """RMS of F_d - F of each plant with the joint moving, [m], N."""
        scenario = self.scenario._replace(
            P_s=jnp.full_like(self.scenario.P_s, given.setting.P_s)
        )
        skip = round(SKIP * scenario.F_d.size / SECONDS)

        def one(plant):
            s = self._at(given.setting, gains, plant)
            off = scenario.F_d - run(s.loop, scenario, ("true_F",))[:, 0]
            return jnp.sqrt(jnp.mean(off[skip:] ** 2))

        return jax.vmap(one)(given.plants)
