"""A closed-loop run from numbers: the scenario, the run, and warnings about it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from hydrojax.control.loop import Loop, Scenario, run, signal_names
from hydrojax.jax_setup import bucket
from hydrojax.plant.load import EnvironmentMotion

PARTS = 4
"""Parts of a control period in which the plant acts; a test shows what they cost."""

Trajectory = Callable[[Float[np.ndarray, "*times"], int], Float[np.ndarray, "*times"]]
"""A motion: `trajectory(t, nu)` is its nu-th derivative at times t, m, m/s, m/s^2."""

_run = eqx.filter_jit(run)


@dataclass(frozen=True)
class Run:
    """A closed-loop run: `signals` by name, each [N], at times `t` [N]; SI.

    `leaves` is, for each chamber, the number of samples with its pressure outside
    (P_r, P_s), where (20)(21) and all that rests on them no longer hold; `ends` in how
    many the piston was beyond a chamber's end.
    """

    t: Float[np.ndarray, "N"]
    F_d: Float[np.ndarray, "N"]
    signals: dict[str, Float[np.ndarray, "N"]]
    leaves: tuple[int, int]
    ends: int = 0

    def __getitem__(self, name: str) -> Float[np.ndarray, "N"]:
        return self.signals[name]

    @property
    def diverged(self) -> bool:
        """Whether the run left all sense: not a number, or a hundred supplies high."""
        most = 100 * np.max(self.signals["P_s"])
        P = np.abs([self.signals["true_P_a1"], self.signals["true_P_a2"]])
        finite = np.isfinite(self.signals["true_F"]).all()
        return not bool(finite and np.all(most > P))

    def warning(self) -> str:
        """What limits the validity of this run, or an empty text."""
        if self.diverged:
            return "the closed loop diverges; lower the gains, or correct the rig file"
        if self.ends:
            return (
                f"the piston was beyond a chamber's end in {self.ends} of "
                f"{self.t.size} samples; ask for less travel"
            )
        left = [
            f"P_a{i} in {n} of {self.t.size} samples"
            for i, n in enumerate(self.leaves, 1)
            if n
        ]
        if not left:
            return ""
        return (
            f"a pressure left (P_r, P_s): {', '.join(left)}; raise P_s, or ask for "
            "less force or speed"
        )


def simulate_loop(loop: Loop, scenario: Scenario) -> Run:
    """Run the closed loop once.

    Warns (`RuntimeWarning`) if a pressure leaves (P_r, P_s) or the run diverges.
    """
    n = len(scenario.t)
    longer = np.minimum(np.arange(bucket(n)), n - 1)
    held = jax.tree.map(lambda a: np.asarray(a)[longer], scenario)
    names = signal_names(loop, held)
    table = np.asarray(_run(loop, held, names))[:n]
    signals: dict[str, np.ndarray] = dict(zip(names, table.T, strict=True))
    supply, back = np.asarray(scenario.P_s[:, 0]), np.asarray(scenario.P_r[:, 0])
    open_1 = not float(loop.rig.force_area_1)  # an open chamber holds no pressure
    leaves = tuple(
        int(np.sum(~((signals[p] > back) & (signals[p] < supply))))
        for p in ("true_P_a1", "true_P_a2")
    )
    out = Run(
        np.asarray(scenario.t),
        np.asarray(scenario.F_d),
        signals,
        (0 if open_1 else leaves[0], leaves[1]),
        _beyond(loop, signals["true_x"], open_1),
    )
    if out.warning():
        warnings.warn(out.warning(), RuntimeWarning, stacklevel=2)
    return out


def _beyond(loop: Loop, x: np.ndarray, open_1: bool) -> int:
    """How many of the positions [n] (m) leave a chamber no length."""
    x_1, x_2 = (np.asarray(c) for c in loop.rig.chambers.lengths(jnp.asarray(x)))
    return int(np.sum((x_2 <= 0) | ((x_1 <= 0) & (not open_1))))


def make_scenario(
    F_d: ArrayLike,
    path: Trajectory,
    h: float,
    P_s: float | Float[np.ndarray, "edges"],
    P_r: float | Float[np.ndarray, "edges"],
    seed: int | None = None,
    parts: int = PARTS,
) -> Scenario:
    """A scenario of as many samples as `F_d` [N] has, every `h` seconds; SI.

    Args:
        F_d: desired force, N.
        path: motion of the piston, or of the environment that its load is held by.
        h: control period, s.
        P_s: supply pressure, constant or [N + 1], Pa.
        P_r: return pressure, likewise.
        seed: of the sensors' noise; None for none.
        parts: parts of a period in which the plant acts.
    """
    F_d = np.asarray(F_d, float)
    n = F_d.size
    t = np.arange(n) * h
    halves = t[:, None, None] + h / parts * (
        np.arange(parts)[:, None] + np.array([0.0, 0.5, 1.0])
    )
    after = halves[..., 2]

    def ends(p: float | np.ndarray) -> Array:
        p = np.broadcast_to(np.asarray(p, float), (n + 1,))
        return jnp.asarray(np.stack([p[:-1], p[1:]], axis=1))

    noise = np.zeros((n, 4))
    if seed is not None:
        noise = np.random.default_rng(seed).normal(size=(n, 4))
    environment = EnvironmentMotion(
        *(jnp.asarray(a) for a in (path(halves, 0), path(after, 1), path(after, 2)))
    )
    return Scenario(
        jnp.asarray(t),
        jnp.asarray(F_d),
        jnp.asarray(noise),
        ends(P_s),
        ends(P_r),
        environment,
    )


def hold(x: float = 0.0) -> Trajectory:
    """The piston, or its environment, locked at `x`, m."""
    return lambda t, nu: np.zeros_like(t) + (x if nu == 0 else 0.0)
