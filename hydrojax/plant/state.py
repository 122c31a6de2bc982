"""What one step of a plant is given, and what the plant remembers."""

from __future__ import annotations

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from hydrojax.plant.chambers import Lines
from hydrojax.plant.turned import Turned


class StepInput(NamedTuple):
    """What drives the plant over one tick of length `h`; SI.

    Any leading axes `...`, the same for all. `u` is held. `P_s` and `P_r` are [..., 2],
    at the tick's ends. `x`, `dx`, `v`, `a` are the motion that the load is given. For
    `Prescribed`, `x` [..., 2n + 1] is the position at the ends and middles of n
    substeps, `dx` [..., m] the displacement over each of m equal parts, for the
    bristle, and `v`, `a` [...] hold at the tick's end. The other loads take the
    environment's motion in parts: `x` [..., parts, 3], `v`, `a` [..., parts], and no
    `dx`. `t` is the time at the tick's end.

    Where it was logged, `F` [..., 2] is the output force at the tick's ends and
    `F_rate` [...] its rate at the end, for what it stretches. Where no valve drives the
    chambers, `P` [...] is the net drive force (N), held.
    """

    h: Float[Array, "*batch"]
    u: Float[Array, "*batch"]
    P_s: Float[Array, "*batch 2"]
    P_r: Float[Array, "*batch 2"]
    x: Float[Array, "*batch n"] | Float[Array, "*batch parts 3"]
    dx: Float[Array, "*batch m"] | None
    v: Float[Array, "*batch"] | Float[Array, "*batch parts"]
    a: Float[Array, "*batch"] | Float[Array, "*batch parts"]
    t: Float[Array, "*batch"]
    F: Float[Array, "*batch 2"] | None = None
    F_rate: Float[Array, "*batch"] | None = None
    P: Float[Array, "*batch"] | None = None


class State(NamedTuple):
    """What the plant remembers: independent quantities only.

    `speed` is the filtered speed; where an oil film comes late, `abs(v)` and each
    film's speed stand behind it on a last axis. `lacking` says by how much, in Pa and
    <= 0, each chamber is short of being full; its pressure is then `P_VAPOUR`. `rod`
    holds the force that stretches, where one does; `motion` what the load remembers of
    where the piston stands, `line` what stands in the chambers' lines, `slips` the
    deflections (m) of what gives friction its hysteresis, `turned` what an effect asks
    of the piston's last turn.
    """

    command: tuple
    P: tuple[Float[Array, "*batch"], Float[Array, "*batch"]]
    z: Float[Array, "*batch"]
    speed: Float[Array, "*batch"] | Float[Array, "*batch films"]
    sensor_P: tuple  # of chamber 1, of chamber 2
    sensor_F: tuple
    rod: tuple = ()
    motion: Any = ()
    lacking: tuple = (0.0, 0.0)
    line: Lines | None = None
    slips: tuple[Float[Array, "*batch"], ...] = ()
    turned: Turned | None = None
