"""Piston friction with presliding, and the output force: (1)-(7), (22)."""

from __future__ import annotations

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.parameters import param
from hydrojax.plant.scan import scan_in_blocks


class Sliding(NamedTuple):
    """What friction sees at one instant; SI, every field of one shape.

    `v` is the piston's velocity, `z` the bristle's deflection (m), `z_rate` its rate,
    `speed` the filtered speed of L(t) (m/s), `t` the time since the log began. `lag` is
    the speed of an oil film that comes late, less `abs(v)` (m/s). `P_seal` is the mean
    of the pressures (Pa) that push on the piston, which `Rig.output_force` fills in.
    `slips` are the deflections (m) of what gives friction its hysteresis, `since` and
    `way` the time (s) and the way (m) since friction turned, and `ages` the ages (s) of
    the contact for the ways in `plant.turned.AGES`, where an effect asks for them.
    `F` is the output force (N) without what adds to it, which `Rig.output_force` fills
    in for effects at the load cell. Of the film's lag, friction that goes with the
    velocity itself has `lag_z` along the bristle's deflection, and `lag_v` along v.
    """

    t: Float[Array, "*batch"]
    x: Float[Array, "*batch"]
    v: Float[Array, "*batch"]
    a: Float[Array, "*batch"]
    z: Float[Array, "*batch"]
    z_rate: Float[Array, "*batch"]
    speed: Float[Array, "*batch"]
    P_a1: Float[Array, "*batch"]
    P_a2: Float[Array, "*batch"]
    P_s: Float[Array, "*batch"]
    lag: Float[Array, "*batch"] | float = 0.0
    P_seal: Float[Array, "*batch"] | float = 0.0
    slips: tuple[Float[Array, "*batch"], ...] = ()
    since: Float[Array, "*batch"] | float = 0.0
    way: Float[Array, "*batch"] | float = 0.0
    ages: tuple[Float[Array, "*batch"] | float, ...] = ()
    F: Float[Array, "*batch"] | float = 0.0
    lag_z: Float[Array, "*batch"] | float = 0.0
    lag_v: Float[Array, "*batch"] | float = 0.0


class Theta(NamedTuple):
    """One value for each of theta_f (27), in the paper's order."""

    k_cp: Float[Array, "*batch"]
    k_cn: Float[Array, "*batch"]
    k_0: Float[Array, "*batch"]
    k_vp: Float[Array, "*batch"]
    k_vn: Float[Array, "*batch"]
    k_fp: Float[Array, "*batch"]
    k_fn: Float[Array, "*batch"]


class Friction(eqx.Module):
    """Coulomb, Stribeck, offset and presliding friction of one piston."""

    k_cp: Float[Array, ""] = param(
        "N", 0.0, 0.0, 1e5, "Coulomb level, v > 0", size=500.0
    )
    k_cn: Float[Array, ""] = param(
        "N", 0.0, 0.0, 1e5, "Coulomb level, v < 0", size=500.0
    )
    k_0: Float[Array, ""] = param("N", 0.0, -1e4, 1e4, "constant offset", size=100.0)
    k_vp: Float[Array, ""] = param(
        "N*s/m", 0.0, -1e6, 1e6, "fall with speed, v > 0", size=2e3
    )
    k_vn: Float[Array, ""] = param(
        "N*s/m", 0.0, -1e6, 1e6, "fall with speed, v < 0", size=2e3
    )
    k_fp: Float[Array, ""] = param("1", 0.0, 0.0, 10.0, "presliding, F > 0", size=0.5)
    k_fn: Float[Array, ""] = param("1", 0.0, 0.0, 10.0, "presliding, F < 0", size=0.5)
    z_ss: Float[Array, ""] = param(
        "m", 60e-6, 1e-7, 5e-3, "bristle deflection when sliding"
    )
    delta: Float[Array, ""] = param(
        "1/N", 1 / 900, 1e-6, 10.0, "saturation of presliding in F"
    )
    L_slope: Float[Array, ""] = param(
        "s/m", 300.0, 1.0, 1e6, "slope of the switch L(t)"
    )
    L_rate: Float[Array, ""] = param(
        "1/s", 10.0, 0.1, 1e3, "rate of the filtered speed"
    )

    def bristle_map(
        self, dx: Float[Array, "*batch"]
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """The bristle's step (4) over a displacement `dx` as `z -> keep z + add`.

        Exact while v keeps its sign: the bristle depends on displacement, not time.
        """
        way = jnp.abs(dx) / self.z_ss
        # At rest the bristle follows the piston: a slope of 1, which a sign would lose.
        rest = way == 0
        share = jnp.where(rest, 1.0, -jnp.expm1(-way) / jnp.where(rest, 1.0, way))
        return jnp.exp(-way), dx * share

    def speed_map(
        self, dx: Float[Array, "*batch"], h: Float[Array, "*batch"]
    ) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """The filtered speed's step over `h` seconds as `w -> keep w + add`."""
        keep = jnp.exp(-self.L_rate * h)
        return keep, (1 - keep) * jnp.abs(dx) / h

    def z_rate(
        self, z: Float[Array, "*batch"], v: Float[Array, "*batch"]
    ) -> Float[Array, "*batch"]:
        """Rate of the bristle's deflection (4), m/s."""
        return v - jnp.abs(v) / self.z_ss * z

    def switch(self, speed: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
        """L(t): 1 in presliding, 0 in sliding; `speed` is the filtered |v|."""
        return 1 / (1 + (self.L_slope * speed) ** 3)

    def sliding_force(
        self, at: Sliding, levels: tuple = (), adds: tuple = ()
    ) -> Float[Array, "*batch"]:
        """f_c of (3) with phi = -1, N.

        `levels` are effects that add to the Coulomb level, `adds` effects that add
        a friction force. Where an oil film comes late, levels see its speed, and what
        goes with the velocity one that is late by `at.lag_z` and `at.lag_v`.
        """
        up = at.z > 0
        # In sliding z is z_ss to the last place: a clip just there would cut the
        # derivative by rounding.
        turn = jnp.clip(at.z / self.z_ss, -1 - 1e-13, 1 + 1e-13)
        film = at._replace(v=at.v + jnp.where(at.v < 0, -1.0, 1.0) * at.lag)
        level = jnp.where(up, self.k_cp, self.k_cn)
        level = level + sum(e.level(film, level) for e in levels)
        # At rest a logged speed is noise of either sign: rounded over 0.1 mm/s.
        late = turn * at.lag_z + at.v / jnp.sqrt(at.v * at.v + 1e-8) * at.lag_v
        film = at._replace(v=at.v + late)
        fall = jnp.where(film.v > 0, self.k_vp, self.k_vn) * film.v
        return turn * level + self.k_0 - fall + sum(e.force(film) for e in adds)

    def regressor(
        self,
        z: Float[Array, "*batch"],
        v: Float[Array, "*batch"],
        L: Float[Array, "*batch"],
        F: Float[Array, "*batch"],
    ) -> Theta:
        """The row of (26): what each of theta_f is multiplied with in f_f, at L(t).

        With the output force itself as `F`, `f_f` of (7) is this times theta_f; the
        adaptive law puts the desired force in its place.
        """
        slide = 1 - L
        g = jnp.clip(z / self.z_ss, -1.0, 1.0)
        stick = L * F / (1 + self.delta * jnp.abs(F))
        return Theta(
            k_cp=slide * jnp.where(z > 0, g, 0.0),
            k_cn=slide * jnp.where(z > 0, 0.0, g),
            k_0=slide,
            k_vp=-slide * jnp.where(v > 0, v, 0.0),
            k_vn=-slide * jnp.where(v > 0, 0.0, v),
            k_fp=jnp.where(F > 0, stick, 0.0),
            k_fn=jnp.where(F > 0, 0.0, stick),
        )

    def output_force(
        self,
        P: Float[Array, "*batch"],
        f_c: Float[Array, "*batch"],
        L: Float[Array, "*batch"],
        rest: Float[Array, "*batch"] | float = 0.0,
    ) -> Float[Array, "*batch"]:
        """F of (22) with (5)-(7): the admissible root of a quadratic, N.

        `F + L k_f F / (1 + delta |F|) = P - (1 - L) f_c - L rest`, and F has the sign
        of the right-hand side; `rest` (N) is what acts in presliding beside f_s.
        """
        drive = P - (1 - L) * f_c - L * rest
        size = jnp.abs(drive)
        k = L * jnp.where(drive > 0, self.k_fp, self.k_fn)
        b = 1 + k - self.delta * size
        disc = jnp.sqrt(b * b + 4 * self.delta * size)
        # The two forms of one root: each is free of cancellation where it is used.
        root = jnp.where(b > 0, 2 * size / (b + disc), (disc - b) / (2 * self.delta))
        return jnp.where(drive < 0, -root, root)


def run_stop(
    moves: Float[Array, "parts *batch n"],
    reach: Float[Array, ""],
    start: Float[Array, "*batch"],
) -> Float[Array, "*batch n"]:
    """All states of the stop operator `w -> clip(w + move, -reach, reach)` after each
    of n steps; every step is of the moves of its parts, one behind the other.

    Blocks as in `run_linear`: of several moves one behind the other, too, there remain
    one shift and one clip.
    """
    n = moves.shape[-1]
    size = max(1, int(n**0.5))
    blocks = -(-n // size)

    def held(w):
        return jnp.clip(w, -reach, reach)

    shift, low, high = moves[0], -reach, reach
    for move in moves[1:]:
        shift, low, high = shift + move, held(low + move), held(high + move)

    def cut(a, fill):
        a = jnp.broadcast_to(a, shift.shape)
        none = jnp.broadcast_to(fill, (*a.shape[:-1], blocks * size - n))
        a = jnp.concatenate([a, none], axis=-1)
        return jnp.moveaxis(a.reshape(*a.shape[:-1], blocks, size), -1, 0)

    def within(state, step):
        (shift, low, high), (move, least, most) = state, step
        low, high = (jnp.clip(w + move, least, most) for w in (low, high))
        state = shift + move, low, high
        return state, state

    def across(state, block):
        shift, low, high = block
        return jnp.clip(state + shift, low, high), state

    over = (cut(shift, 0.0), cut(low, -reach), cut(high, reach))
    none = jnp.zeros_like(over[0][0])
    steps = scan_in_blocks(within, (none, none - reach, none + reach), over)
    ends = jax.tree.map(lambda a: jnp.moveaxis(a[-1], -1, 0), steps)
    _, entry = jax.lax.scan(across, held(start), ends)
    shift, low, high = steps
    states = jnp.clip(shift + jnp.moveaxis(entry, 0, -1), low, high)
    states = jnp.moveaxis(states, 0, -1).reshape(*none.shape[:-1], blocks * size)
    return states[..., :n]


def run_linear(
    keep: Float[Array, "*batch n"],
    add: Float[Array, "*batch n"],
    start: Float[Array, "*batch"],
) -> Float[Array, "*batch n"]:
    """All states of `s -> keep s + add` along the last axis, from `start`.

    Shapes: `keep`, `add` [..., n], `start` [...]; returns [..., n], the state after
    each step. The steps are cut into about sqrt(n) blocks that run side by side: each
    block is itself a map `s -> keep s + add`, and the blocks are chained last.
    """
    n = keep.shape[-1]
    size = max(1, int(n**0.5))
    blocks = -(-n // size)
    pad = [(0, 0)] * (keep.ndim - 1) + [(0, blocks * size - n)]

    def cut(a, fill):
        a = jnp.pad(a, pad, constant_values=fill)
        return jnp.moveaxis(a.reshape(*a.shape[:-1], blocks, size), -1, 0)

    def within(state, step):
        product, total = state
        product, total = product * step[0], total * step[0] + step[1]
        return (product, total), (product, total)

    def across(state, block):
        return block[0] * state + block[1], state

    steps = (cut(keep, 1.0), cut(add, 0.0))
    one = jnp.ones_like(steps[0][0])
    product, total = scan_in_blocks(within, (one, one * 0), steps)
    ends = (product[-1], total[-1])
    ends = jax.tree.map(lambda a: jnp.moveaxis(a, -1, 0), ends)
    _, entry = jax.lax.scan(across, start, ends)
    states = product * jnp.moveaxis(entry, 0, -1) + total
    states = jnp.moveaxis(states, 0, -1).reshape(*keep.shape[:-1], blocks * size)
    return states[..., :n]
