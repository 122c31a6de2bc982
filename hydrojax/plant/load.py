"""What moves the piston: a logged motion, the environment, or an inertia.

A load says where the piston goes over a part of a tick, and then takes the force that
the cylinder puts out there. `hydrojax.plant.step` asks it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.parameters import param
from hydrojax.plant.state import StepInput


class EnvironmentMotion(NamedTuple):
    """The environment's motion over one part of a tick, SI.

    `x` [..., 3] at its start, middle and end; `v`, `a` at its end.
    """

    x: Float[Array, "*batch 3"]
    v: Float[Array, "*batch"]
    a: Float[Array, "*batch"]


class PistonMotion(NamedTuple):
    """Where the piston stands: m, m/s, m/s^2."""

    x: Float[Array, "*batch"]
    v: Float[Array, "*batch"]
    a: Float[Array, "*batch"]


class TwoMassMotion(NamedTuple):
    """Where the piston stands (m, m/s, m/s^2), the deflection of the joint behind it
    (m, compressed), and how the second mass moves (m/s, m/s^2).
    """

    x: Float[Array, "*batch"]
    v: Float[Array, "*batch"]
    a: Float[Array, "*batch"]
    deflection: Float[Array, "*batch"]
    second_v: Float[Array, "*batch"]
    second_a: Float[Array, "*batch"]


Force = Callable[[Array, Array], Array]
"""The output force (N) at a part's end, of velocity and acceleration there."""


def _speed(
    environment: EnvironmentMotion, h: Float[Array, "*batch"]
) -> Float[Array, "*batch"]:
    """The environment's speed about the start of a part, m/s."""
    return (environment.x[..., 1] - environment.x[..., 0]) / (h / 2)


def _parts(inputs: StepInput) -> tuple[StepInput, ...]:
    """A tick cut at the parts of the environment's motion; the supply runs straight."""
    n = inputs.v.shape[-1]
    h = inputs.h / n

    def ends(p: Float[Array, "*batch 2"], i: int) -> Float[Array, "*batch 2"]:
        share = jnp.array([i, i + 1]) / n
        return p[..., :1] + share * (p[..., 1:] - p[..., :1])

    return tuple(
        inputs._replace(
            h=h,
            P_s=ends(inputs.P_s, i),
            P_r=ends(inputs.P_r, i),
            x=inputs.x[..., i, :],
            v=inputs.v[..., i],
            a=inputs.a[..., i],
            t=inputs.t - (n - 1 - i) * h,
        )
        for i in range(n)
    )


def _moved(part: StepInput, x: Float[Array, "*batch 3"]) -> StepInput:
    """A part in which the piston goes through `x` [..., 3], m."""
    v = (x[..., 0] - 4 * x[..., 1] + 3 * x[..., 2]) / part.h  # at the end
    return part._replace(x=x, dx=x[..., 2:] - x[..., :1], v=v)


def environment_of(part: StepInput) -> EnvironmentMotion:
    """The environment's motion over one part of a tick."""
    return EnvironmentMotion(part.x, part.v, part.a)


class AbstractLoad(eqx.Module):
    """What is behind the load cell, and how it moves the piston."""

    meets_stops: ClassVar[bool] = False
    """Whether the force moves the piston, so that the stroke's ends must hold it."""

    @abstractmethod
    def parts(self, inputs: StepInput) -> tuple[StepInput, ...]:
        """The parts of a tick after each of which the load takes the force."""

    @abstractmethod
    def begin(
        self, environment: EnvironmentMotion, h: Float[Array, "*batch"], force: Force
    ) -> Any:
        """What it remembers at the start of the first part, of length `h` (s)."""

    @abstractmethod
    def piston(self, at: Any, part: StepInput) -> StepInput:
        """The part with the piston's own motion in `x`, `dx` and `v`."""

    @abstractmethod
    def advance(
        self,
        at: Any,
        x: Float[Array, "*batch 3"],
        environment: EnvironmentMotion,
        h: Float[Array, "*batch"],
        force: Force,
    ) -> tuple[Any, Float[Array, "*batch"]]:
        """What it remembers at the part's end, and the output force there, N."""


class Prescribed(AbstractLoad):
    """The piston's motion is known beforehand: from a log, or another simulator."""

    def parts(self, inputs):
        """The whole tick."""
        return (inputs,)

    def begin(self, environment, h, force):
        """Nothing to remember."""
        return ()

    def piston(self, at, part):
        """As it was given."""
        return part

    def advance(self, at, x, environment, h, force):
        """The force under the motion that was given, N."""
        return at, force(environment.v, environment.a)


class _Moving(AbstractLoad):
    """A load that moves the piston itself, part by part of a tick."""

    def parts(self, inputs):
        """Those of the environment's motion."""
        return _parts(inputs)

    def piston(self, at, part):
        """The motion that `move` gives."""
        return _moved(part, self.move(at, environment_of(part), part.h))

    @abstractmethod
    def move(
        self,
        at: PistonMotion,
        environment: EnvironmentMotion,
        h: Float[Array, "*batch"],
    ) -> Float[Array, "*batch 3"]:
        """The piston's place at start, middle and end of the part, [..., 3], m."""


class Driven(_Moving):
    """The environment leads the piston; at rest it is locked."""

    def begin(
        self, environment: EnvironmentMotion, h: Float[Array, "*batch"], force: Force
    ) -> PistonMotion:
        """Motion at the start of the first part, of length `h`."""
        return PistonMotion(
            environment.x[..., 0], _speed(environment, h), jnp.zeros_like(h)
        )

    def move(
        self,
        at: PistonMotion,
        environment: EnvironmentMotion,
        h: Float[Array, "*batch"],
    ) -> Float[Array, "*batch 3"]:
        """The piston's place at start, middle and end of the part, [..., 3], m."""
        return environment.x

    def advance(
        self,
        at: PistonMotion,
        x: Float[Array, "*batch 3"],
        environment: EnvironmentMotion,
        h: Float[Array, "*batch"],
        force: Force,
    ) -> tuple[PistonMotion, Float[Array, "*batch"]]:
        """Motion at the part's end, and the force there, N."""
        return PistonMotion(x[..., 2], environment.v, environment.a), force(
            environment.v, environment.a
        )


class Inertia(_Moving):
    """A mass on the output, held by a spring and a damper to the environment.

    `mass a = F - damping (v - v_e) - stiffness (x - x_e)`, by the leapfrog rule: of
    second order, stable up to 2/h rad/s, and without damping of its own.
    """

    name: ClassVar[str] = "load"
    meets_stops = True

    mass: Float[Array, ""] = param("kg", 150.0, 1e-3, 1e6, "load's mass")
    stiffness: Float[Array, ""] = param(
        "N/m", 2e6, 0.0, 1e10, "its spring to the environment"
    )
    damping: Float[Array, ""] = param(
        "N*s/m", 2e3, 0.0, 1e8, "its damper to the environment"
    )

    def begin(
        self, environment: EnvironmentMotion, h: Float[Array, "*batch"], force: Force
    ) -> Any:
        """At rest where the spring is slack, and the acceleration that follows."""
        rest = jnp.zeros_like(h)
        start = force(rest, rest)
        slope = force(rest, rest + 1) - start
        pull = -self.damping * _speed(environment, h)
        return PistonMotion(
            environment.x[..., 0], rest, (start - pull) / (self.mass - slope)
        )

    def move(
        self,
        at: PistonMotion,
        environment: EnvironmentMotion,
        h: Float[Array, "*batch"],
    ) -> Float[Array, "*batch 3"]:
        """The piston's place at start, middle and end of the part, [..., 3], m."""
        step = h * (at.v + h / 2 * at.a)
        return jnp.stack([at.x, at.x + step / 2, at.x + step], axis=-1)

    def advance(
        self,
        at: Any,
        x: Float[Array, "*batch 3"],
        environment: EnvironmentMotion,
        h: Float[Array, "*batch"],
        force: Force,
    ) -> tuple[Any, Float[Array, "*batch"]]:
        """Motion at the part's end, and the force there, N."""
        return self._answer(at, x, environment, h, force, 0.0, 0.0)

    def natural_frequencies(
        self, stiffness: float = 0.0, mass: float = 0.0
    ) -> Float[np.ndarray, "modes"]:
        """Its undamped natural frequencies, rad/s, ascending.

        Args:
            stiffness: of what holds the piston besides its spring, N/m.
            mass: that moves with the piston besides its own, kg.
        """
        held = stiffness + float(self.stiffness)
        return np.sqrt([held / (mass + float(self.mass))])

    def _answer(self, at, x, environment, h, force, held, heavier):
        """As `advance`, under `held` (N) more of a pull, and `heavier` (kg) by that.

        A mass before the load cell makes the force depend on the acceleration, along
        a line: two points of it and the load's own line meet in the answer.
        """
        half = at.v + h / 2 * at.a
        foreseen = half + h / 2 * at.a
        rest = force(foreseen, jnp.zeros_like(half))
        slope = force(foreseen, jnp.ones_like(half)) - rest
        pull = self.damping * (half - environment.v) + self.stiffness * (
            x[..., 2] - environment.x[..., 2]
        )
        own = self.mass + self.damping * h / 2 + heavier
        a = (rest - pull - held) / (own - slope)
        return PistonMotion(x[..., 2], half + h / 2 * a, a), rest + slope * a


class TwoMassLoad(Inertia):
    """An inertia that carries a second mass through an elastic joint (a two-mass
    system): a boom that bends, a load on a long rod.

    `second_mass a_2 = f` with `f = second_stiffness (x - x_2) + second_damping
    (v - v_2)`, which the first mass carries as well; by the same rule.
    """

    second_mass: Float[Array, ""] = param("kg", 100.0, 1e-3, 1e6, "mass on the joint")
    second_stiffness: Float[Array, ""] = param(
        "N/m", 1e5, 0.0, 1e10, "the joint's spring"
    )
    second_damping: Float[Array, ""] = param(
        "N*s/m", 1e2, 0.0, 1e8, "the joint's damper"
    )

    def begin(self, environment, h, force):
        """As an inertia, the joint slack and the second mass at rest."""
        rest = jnp.zeros_like(h)
        x, v, a = super().begin(environment, h, force)
        return TwoMassMotion(x, v, a, rest, rest, rest)

    def advance(self, at, x, environment, h, force):
        """Motion at the part's end, and the force there, N."""
        half, second = at.v + h / 2 * at.a, at.second_v + h / 2 * at.second_a
        deflection = at.deflection + h * (half - second)
        lag = self.second_damping * h / 2
        # What the joint holds if nothing accelerates, and how that grows with a.
        still = self.second_stiffness * deflection + self.second_damping * (
            half - second
        )
        share = self.second_mass / (self.second_mass + lag)
        (x, v, a), F = self._answer(
            at, x, environment, h, force, share * still, share * lag
        )
        second_a = (still + lag * a) / (self.second_mass + lag)
        second = second + h / 2 * second_a
        return TwoMassMotion(x, v, a, deflection, second, second_a), F

    def natural_frequencies(self, stiffness=0.0, mass=0.0):
        """Its undamped natural frequencies, rad/s, ascending; see `Inertia`."""
        k, k_2 = stiffness + float(self.stiffness), float(self.second_stiffness)
        m, m_2 = mass + float(self.mass), float(self.second_mass)
        # Scaled by the masses: SciPy's solver for two matrices is slow to import.
        scale = 1.0 / np.sqrt([m, m_2])
        shaped = np.outer(scale, scale) * [[k + k_2, -k_2], [-k_2, k_2]]
        squares = np.linalg.eigvalsh(shaped)
        return np.sqrt(np.maximum(squares, 0.0))
