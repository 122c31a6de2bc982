"""What every controller is: a sampled law with declared gains. And what one adapts."""

# No postponed annotations here: Equinox must see that `u_max` is abstract.
import abc
import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.parameters import Spec
from hydrojax.plant.friction import Theta


class Measured(NamedTuple):
    """What a controller reads at one sample: Pa, N, m."""

    P_a1: Float[Array, "*batch"]
    P_a2: Float[Array, "*batch"]
    P_s: Float[Array, "*batch"]
    F: Float[Array, "*batch"]
    x: Float[Array, "*batch"]


@dataclass(frozen=True)
class Gain(Spec):
    """What is known of a controller's parameter; see `Spec`.

    Attributes:
        written: unit in which a rig file's [controller] takes a bare number; `unit` if
            it is empty.
        volts: whether `written` is per volt of the law, so that the nominal valve gain
            turns it into `unit`.
        key: what [controller] calls it; the field's name if it is empty.
        positive: whether it must be above 0.
        pair: whether it is an estimate, given as one value (both bounds) or as two.
    """

    written: str = ""
    volts: bool = False
    key: str = ""
    positive: bool = False
    pair: bool = False


def gain(
    unit: str, default: float, lower: float, upper: float, description: str, **more: Any
) -> Any:
    """Declare an array field of a controller as a parameter; see `Gain`.

    `hydrojax.parameters.param` does for a controller that no rig file describes.
    """
    return eqx.field(
        default=default,
        converter=lambda x: jnp.asarray(x, dtype=float),
        metadata={"spec": Gain(unit, default, lower, upper, description, **more)},
    )


class AbstractController(eqx.Module):
    """A force controller: it reads the sensors and sets the valve command.

    A subclass declares its gains as fields with `param` (unit, default, range, meaning)
    and is otherwise stateless: what it remembers from sample to sample is the pytree
    `memory`. Simulation, sweeps and tuning know the gains by the names of the fields.
    Positive commands fill chamber 1, which lowers the output force.

    Attributes:
        u_max: where the command saturates, V or 1; declare it with `param`.
    """

    u_max: eqx.AbstractVar[Float[Array, ""]]

    @abc.abstractmethod
    def init(self, measured: Measured, F_d: Float[Array, ""]) -> Any:
        """The memory at rest at the first sample.

        Args:
            measured: the first readings.
            F_d: the desired force, N.
        """

    @abc.abstractmethod
    def step(
        self,
        memory: Any,
        measured: Measured,
        F_d: Float[Array, ""],
        h: Float[Array, ""],
    ) -> tuple[Any, Float[Array, ""], dict[str, Float[Array, ""]]]:
        """One sample.

        Args:
            memory: of the sample before, or of `init`.
            measured: the readings.
            F_d: the desired force, N.
            h: the control period, s.

        Returns:
            The new memory, of the same structure; the command (V or 1), held until the
            next sample; and scalars by name to be recorded, which may be none.
        """


def clamp(
    value: Float[Array, "*batch"],
    lower: Float[Array, "*batch"],
    upper: Float[Array, "*batch"],
) -> Float[Array, "*batch"]:
    """`value` held in [lower, upper], with the whole derivative of the end it is at.

    A clip would share the derivative in two where value and end are equal, which is
    where an estimate on its bound stands.
    """
    value = jnp.where(value >= upper, upper, value)
    return jnp.where(value <= lower, lower, value)


class Estimates(NamedTuple):
    """One value for each estimate: 1/beta of (28), A_a of (29), theta_f of (30)."""

    k_1: Float[Array, "*batch"]
    A_a: Float[Array, "*batch"]
    k_cp: Float[Array, "*batch"]
    k_cn: Float[Array, "*batch"]
    k_0: Float[Array, "*batch"]
    k_vp: Float[Array, "*batch"]
    k_vn: Float[Array, "*batch"]
    k_fp: Float[Array, "*batch"]
    k_fn: Float[Array, "*batch"]

    @property
    def theta_f(self) -> Theta:
        """The last seven: friction's."""
        return Theta(*self[2:])


def _table(
    *rows: tuple[str, str, str, str, bool],
    pair: bool = False,
) -> dict[str, Gain]:
    """Declarations of values that are kept in an `Estimates`."""
    return {
        name: Gain(
            unit, 0.0, -math.inf, math.inf, text, written=written, volts=volts,
            pair=pair,
        )
        for name, unit, written, text, volts in rows
    }  # fmt: skip


RATES = _table(
    ("rho_1", "m^2/N^3", "V*s/kN^3", "rate of adapting k_1", True),
    ("rho_a", "m^2/N", "V*s/kN", "rate of adapting A_a", True),
    ("c_1", "1/s", "1/s", "rate of adapting k_cp", False),
    ("c_2", "1/s", "1/s", "rate of adapting k_cn", False),
    ("c_3", "1/s", "1/s", "rate of adapting k_0", False),
    ("c_4", "s/m^2", "s/m^2", "rate of adapting k_vp", False),
    ("c_5", "s/m^2", "s/m^2", "rate of adapting k_vn", False),
    ("c_6", "1/(s*N^2)", "1/(s*kN^2)", "rate of adapting k_fp", False),
    ("c_7", "1/(s*N^2)", "1/(s*kN^2)", "rate of adapting k_fn", False),
)
"""The rates of adaptation, by the paper's names, in the order of `Estimates`."""

ESTIMATES = _table(
    ("k_1", "1/Pa", "V*s/kN", "1/beta as the law has it", True),
    ("A_a", "m^2", "V*s", "area as the law has it", True),
    ("k_cp", "N", "kN", "Coulomb level, v > 0", False),
    ("k_cn", "N", "kN", "Coulomb level, v < 0", False),
    ("k_0", "N", "kN", "constant offset", False),
    ("k_vp", "N*s/m", "kN*s/m", "fall with speed, v > 0", False),
    ("k_vn", "N*s/m", "kN*s/m", "fall with speed, v < 0", False),
    ("k_fp", "1", "1", "presliding, F > 0", False),
    ("k_fn", "1", "1", "presliding, F < 0", False),
    pair=True,
)
"""The estimates, by the paper's names, in the order of `Estimates`."""
