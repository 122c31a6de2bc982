"""What moves the piston in a closed loop: a given motion, or an inertia.

A load says where the piston goes over a part of a tick, and then takes the force that
the cylinder puts out there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from hydrojax.parameters import param


class EnvironmentMotion(NamedTuple):
    """The environment's motion over one part of a tick, SI.

    `x` [..., 3] at its start, middle and end; `v`, `a` at its end.
    """

    x: Array
    v: Array
    a: Array


class Motion(NamedTuple):
    """Where the piston stands: m, m/s, m/s^2."""

    x: Array
    v: Array
    a: Array


Force = Callable[[Array, Array], Array]
"""The output force (N) at a part's end, of velocity and acceleration there."""


def _speed(environment: EnvironmentMotion, h: Array) -> Array:
    """The environment's speed about the start of a part, m/s."""
    return (environment.x[..., 1] - environment.x[..., 0]) / (h / 2)


class Driven(eqx.Module):
    """The environment leads the piston; at rest it is locked."""

    def begin(self, environment: EnvironmentMotion, h: Array, force: Force) -> Motion:
        """Motion at the start of the first part, of length `h`."""
        return Motion(environment.x[..., 0], _speed(environment, h), jnp.zeros_like(h))

    def move(self, at: Motion, environment: EnvironmentMotion, h: Array) -> Array:
        """The piston's place at start, middle and end of the part, [..., 3], m."""
        return environment.x

    def advance(
        self,
        at: Motion,
        x: Array,
        environment: EnvironmentMotion,
        h: Array,
        force: Force,
    ) -> tuple[Motion, Array]:
        """Motion at the part's end, and the force there, N."""
        return Motion(x[..., 2], environment.v, environment.a), force(
            environment.v, environment.a
        )


class Inertia(eqx.Module):
    """A mass on the output, held by a spring and a damper to the environment.

    `mass a = F - damping (v - v_e) - stiffness (x - x_e)`, by the leapfrog rule: of
    second order, stable up to 2/h rad/s, and without damping of its own.
    """

    mass: Array = param("kg", 150.0, 1e-3, 1e6, "load's mass")
    stiffness: Array = param("N/m", 2e6, 0.0, 1e10, "its spring to the environment")
    damping: Array = param("N*s/m", 2e3, 0.0, 1e8, "its damper to the environment")

    def begin(self, environment: EnvironmentMotion, h: Array, force: Force) -> Motion:
        """At rest where the spring is slack, and the acceleration that follows."""
        rest = jnp.zeros_like(h)
        start = force(rest, rest)
        slope = force(rest, rest + 1) - start
        pull = -self.damping * _speed(environment, h)
        return Motion(environment.x[..., 0], rest, (start - pull) / (self.mass - slope))

    def move(self, at: Motion, environment: EnvironmentMotion, h: Array) -> Array:
        """The piston's place at start, middle and end of the part, [..., 3], m."""
        step = h * (at.v + h / 2 * at.a)
        return jnp.stack([at.x, at.x + step / 2, at.x + step], axis=-1)

    def advance(
        self,
        at: Motion,
        x: Array,
        environment: EnvironmentMotion,
        h: Array,
        force: Force,
    ) -> tuple[Motion, Array]:
        """Motion at the part's end, and the force there, N.

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
        a = (rest - pull) / (self.mass + self.damping * h / 2 - slope)
        return Motion(x[..., 2], half + h / 2 * a, a), rest + slope * a


Load = Driven | Inertia
