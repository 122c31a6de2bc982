"""The nine estimates of the adaptive law, and their rates of adaptation."""

from __future__ import annotations

import math
from typing import NamedTuple

from jaxtyping import Array, Float

from hydrojax.control.base import Gain
from hydrojax.plant.friction import Theta


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
) -> dict[str, Gain]:
    """Declarations of values that are kept in an `Estimates`."""
    return {
        name: Gain(unit, 0.0, -math.inf, math.inf, text, written=written, volts=volts)
        for name, unit, written, text, volts in rows
    }


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
)
"""The estimates, by the paper's names, in the order of `Estimates`."""
