"""What one step of a plant is given, and what the plant remembers."""

from __future__ import annotations

from typing import NamedTuple

from jaxtyping import Array


class StepInput(NamedTuple):
    """What drives the plant over one tick of length `h`; SI.

    `u` is held. `P_s` and `P_r` are [..., 2], at the tick's ends. `x` [..., 2n + 1] is
    the position at the ends and middles of n substeps, `dx` [..., 4] the displacement
    over each quarter, for the bristle; `v`, `a` and `t` hold at the tick's end. Where
    it was logged, `F` [..., 2] is the output force at the tick's ends and `F_rate` its
    rate at the end, for what it stretches.
    """

    h: Array
    u: Array
    P_s: Array
    P_r: Array
    x: Array
    dx: Array
    v: Array
    a: Array
    t: Array
    F: Array | None = None
    F_rate: Array | None = None


class State(NamedTuple):
    """What the plant remembers: independent quantities only.

    `speed` is the filtered speed; where an oil film comes late, `abs(v)` and each
    film's speed stand behind it on a last axis. `rod` holds the force that stretches,
    where one does.
    """

    command: tuple
    P: tuple[Array, Array]
    z: Array
    speed: Array
    sensor_P: tuple  # of chamber 1, of chamber 2
    sensor_F: tuple
    rod: tuple = ()
