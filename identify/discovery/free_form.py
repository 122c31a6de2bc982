"""Effects of free form: a curve over one signal at each place of the signal path.

Each is linear in its coefficients and absent at zero, so that replay, fit and scores
take it as any other effect. Which signal a curve is over, what multiplies it, and its
knots are arrays: one compiled program serves every signal of a place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hydrojax.effects.splines import bspline
from hydrojax.parameters import param, specs
from hydrojax.plant.chambers import Point
from hydrojax.plant.effect import (
    CommandChannel,
    ComplianceEffect,
    Effect,
    FlowEffect,
    ForceEffect,
    FrictionForce,
    HysteresisForce,
    LevelEffect,
)
from hydrojax.plant.turned import AGES

COUNT = 14
"""Coefficients of a curve."""

SIGNALS = 15
"""How many signals a place has at most."""

ROUNDED = 1e8
"""Square of the drop (Pa^2) below which a root of it is rounded."""


def _coefficient() -> Any:
    return param("1", 0.0, -1e4, 1e4, "coefficient", strength=True, size=1.0)


def _array(default: Any) -> Any:
    def default_array() -> Array:
        return jnp.asarray(default, float)

    return eqx.field(default_factory=default_array)


class FreeForm(Effect):
    """`size factor(.) curve(signal(.))`, with what both are as arrays.

    `signal` weighs the signals of the place, `factor` 1 and these signals; `knots` are
    the curve's, in the unit of the signal, `size` the unit of its coefficients, SI.
    """

    residual_axis = "v"
    knots: Float[Array, "n+4"] = _array(
        np.r_[[0.0] * 3, np.linspace(0, 1, 12), [1] * 3]
    )
    signal: Float[Array, "signals"] = _array([1.0] + [0.0] * (SIGNALS - 1))
    factor: Float[Array, "signals+1"] = _array([1.0] + [0.0] * SIGNALS)
    size: Float[Array, ""] = _array(1.0)
    c_0: Float[Array, ""] = _coefficient()
    c_1: Float[Array, ""] = _coefficient()
    c_2: Float[Array, ""] = _coefficient()
    c_3: Float[Array, ""] = _coefficient()
    c_4: Float[Array, ""] = _coefficient()
    c_5: Float[Array, ""] = _coefficient()
    c_6: Float[Array, ""] = _coefficient()
    c_7: Float[Array, ""] = _coefficient()
    c_8: Float[Array, ""] = _coefficient()
    c_9: Float[Array, ""] = _coefficient()
    c_10: Float[Array, ""] = _coefficient()
    c_11: Float[Array, ""] = _coefficient()
    c_12: Float[Array, ""] = _coefficient()
    c_13: Float[Array, ""] = _coefficient()

    def along(
        self, signals: Sequence[Float[Array, "*batch"] | float]
    ) -> Float[Array, "*batch"]:
        """The term where the signals of its place are `signals`."""
        s = sum(w * y for w, y in zip(self.signal, signals, strict=False))
        every = (1.0, *signals)
        times = sum(w * y for w, y in zip(self.factor, every, strict=False))
        c = jnp.stack([getattr(self, name) for name in specs(self)])
        # Not a product of matrices: see `in_one_kernel`.
        curve = jnp.sum(bspline(jnp.asarray(s), self.knots) * c, axis=-1)
        return self.size * times * curve


class _OnPiston(FreeForm):
    """A curve over what friction sees."""

    of_turns = False

    def at(self, at: Any, *more: Array | float) -> Array:
        difference = at.P_a2 - at.P_a1
        mean = (at.P_a1 + at.P_a2) / 2
        pressures = (mean, difference, at.P_a1, at.P_a2)
        seen = (at.v, at.x, at.a, *pressures, at.t, at.z)
        past = (at.since, at.way, *at.ages) if self.of_turns else ()
        return self.along((*seen, *past, *more))


class FreeLevel(_OnPiston, LevelEffect):
    """A curve added to the Coulomb level, or times the level as it is without."""

    name = "free_level"
    of_turns = True

    def level(self, at, base):
        """The curve as a level, N."""
        return self.at(at, base)


class FreeFriction(_OnPiston, FrictionForce):
    """A curve added to the friction force."""

    name = "free_friction"

    def force(self, at):
        """The curve as a force, N."""
        return self.at(at)


class FreeHysteresis(FreeForm, HysteresisForce):
    """A curve over the way since the piston turned, up to `slip` (m) to either side of
    where it slides: a spring of any law behind a friction.
    """

    name = "free_hysteresis"
    remembered = ()
    slip: Float[Array, ""] = _array(1e-3)

    def reach(self):
        """The deflection at which it slides, m."""
        return self.slip

    def force(self, w):
        """The curve as a force at a deflection (m), N."""
        return self.along((w,))


class FreeForce(_OnPiston, ForceEffect):
    """A curve added to the force at the load cell, over that force too."""

    name = "free_force"

    def force(self, at):
        """The curve as a force, N."""
        return self.at(at, at.F)


class FreeFlow(FreeForm, FlowEffect):
    """A curve of flow into the chambers, `share` of it into each. Over `edges`, the
    valve's c_p1, c_n1, c_p2 and c_n2, it is a curve of what the valve does.
    """

    name = "free_flow"
    share: Float[Array, "2"] = _array([1.0, 1.0])
    edges: Float[Array, "4"] = _array([1.0] * 4)

    def flow(self, at):
        """Its flows into chambers 1 and 2, m^3/s."""
        way = at.opening
        spool = way[0] if len(way) == 1 else way[0] - way[1]
        out, into = jnp.maximum(-spool, 0.0), jnp.maximum(spool, 0.0)
        both = (at.P_a2 - at.P_a1, at.v, at.x, spool)
        own = ((at.P_a1, into, out), (at.P_a2, out, into))
        flows = []
        for share, head, (P, *ways) in zip(
            self.share, heads(at, spool, self.edges), own, strict=True
        ):
            signals = (P, *both, *ways, at.P_s, at.t, head, spool * head)
            flows.append(share * self.along(signals))
        return tuple(flows)


def heads(
    at: Point, spool: Float[Array, "*batch"], edges: Float[Array, "4"]
) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
    """By how much the flows into chambers 1 and 2 rise with the command, m^3/(s {u}):
    coefficients times roots of the drops over the edges that are open.
    """
    c_p1, c_n1, c_p2, c_n2 = edges

    def root(c, drop):
        return c * drop * (drop * drop + ROUNDED) ** -0.25

    up = spool > 0
    first = jnp.where(up, root(c_p1, at.P_s - at.P_a1), root(c_n1, at.P_a1 - at.P_r))
    second = jnp.where(up, root(c_n2, at.P_a2 - at.P_r), root(c_p2, at.P_s - at.P_a2))
    return first, -second


class FreeCompliance(FreeForm, ComplianceEffect):
    """A curve of compliance over the chamber's pressure."""

    name = "free_compliance"

    def compliance(self, P):
        """The curve at gauge pressure `P` (Pa), 1/Pa."""
        return self.along((P,))


class FreeCommand(FreeForm, CommandChannel):
    """A curve added to the command: over the command itself, over how far it has gone
    back since it turned, up to `slip` ({u}) to either side, or over how far a lag of
    `tau` (s) is behind it.
    """

    name = "free_command"
    slip: Float[Array, ""] = _array(0.1)
    tau: Float[Array, ""] = _array(1e-2)

    def init(self, u):
        """The command before, its way back, and the lag's output."""
        return u, 0 * u, u

    def step(self, memory, u, h):
        """The command and the curve of it, at its mean over the step."""
        before, w, y = memory
        w = w + u - before
        # Not a clip, which halves derivatives where the command stands still.
        w = jnp.where(
            w > self.slip, self.slip, jnp.where(w < -self.slip, -self.slip, w)
        )
        fade = -jnp.expm1(-h / self.tau)
        behind = (y - u) * fade * self.tau / h
        return (u, w, y + (u - y) * fade), u + self.along((u, w, behind))


FORMS: tuple[type[FreeForm], ...] = (
    FreeCommand,
    FreeFlow,
    FreeCompliance,
    FreeLevel,
    FreeFriction,
    FreeHysteresis,
    FreeForce,
)
"""In the order of the signal path."""


@dataclass(frozen=True)
class Term:
    """A place, the signal that its curve is over, and what multiplies the curve.

    Attributes:
        form: the effect of free form at that place.
        signal: its name; `factor` that of what multiplies the curve, or "".
        unit: of the signal, and `of` that of the curve, SI; `{u}` is the command's.
        which: index of the signal among those of the place.
        times: index of the factor among 1 and the signals of the place.
        size: a typical value of the curve, SI.
        share: of a flow, by chamber.
        edges: the valve's c_p1, c_n1, c_p2 and c_n2, where the curve is what that does.
        slip: of what has hysteresis, the deflection at which it slides, m or {u}.
        tau: of what comes late, its time constant, s.
    """

    form: type[FreeForm]
    signal: str
    which: int
    unit: str
    of: str
    size: float
    factor: str = ""
    times: int = 0
    share: tuple[float, float] = (1.0, 1.0)
    edges: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    slip: float = 0.0
    tau: float = 0.0

    @property
    def sampled(self) -> str:
        """What `samples_of` calls the signal."""
        if self.form is FreeCommand and self.slip:
            return f"{self.signal}_{1e3 * self.slip:.0f}m"
        if self.tau:
            return f"{self.signal}_{1e3 * self.tau:.0f}ms"
        return deflection_name(self.slip) if self.slip else self.signal

    @property
    def means(self) -> str:
        """What its signal is, where that has a memory; or ""."""
        if self.signal.startswith("age_"):
            return f"age of a contact that {self.signal[4:]} of way renew"
        return {
            "since": "time since friction turned",
            "way": "way since friction turned",
            "w": f"way since the piston turned, up to {self.slip:g} m either way",
            "back": f"how far the command went back, up to {self.slip:g} either way",
            "behind": f"how far a lag of {1e3 * self.tau:g} ms is behind the command",
        }.get(self.signal, "")

    @property
    def place(self) -> str:
        """Where it acts."""
        return self.form.place

    @property
    def name(self) -> str:
        """What files and reports call it: `free_level_v`, `free_flow_1_P_a1`."""
        chamber = {(1.0, 0.0): "_1", (0.0, 1.0): "_2", (1.0, -1.0): "_across"}
        place = f"{self.place}{chamber.get(self.share, '')}"
        by = f"_per_{self.factor}" if self.factor else ""
        return f"free_{place}{by}_{self.sampled}"

    def laid(self, knots: Float[np.ndarray, "n+4"]) -> FreeForm:
        """The effect, absent, over these knots."""
        own: dict[str, Array] = {}
        if self.form is FreeFlow:
            own = {"share": jnp.asarray(self.share), "edges": jnp.asarray(self.edges)}
        if self.slip:
            own = {"slip": jnp.asarray(self.slip)}
        if self.tau:
            own = {"tau": jnp.asarray(self.tau)}
        return self.form(
            knots=jnp.asarray(knots, float),
            signal=jnp.asarray(np.eye(SIGNALS)[self.which]),
            factor=jnp.asarray(np.eye(SIGNALS + 1)[self.times]),
            size=jnp.asarray(self.size, float),
            **own,
        )


PISTON = {
    "v": "m/s",
    "x": "m",
    "a": "m/s^2",
    "P_mean": "Pa",
    "P_net": "Pa",
    "P_a1": "Pa",
    "P_a2": "Pa",
    "t": "s",
    "z": "m",
    "since": "s",
    "way": "m",
    **{f"age_{1e6 * D:.0f}um": "s" for D in AGES},
}
"""Signals of the piston, in the order of `_OnPiston.at`, with their units: `P_mean` is
(P_a1 + P_a2) / 2, `P_net` is P_a2 - P_a1; `since` and `way` are time and way since
friction turned, the ages those of a contact that so much way renews."""


def _piston(
    form: type[FreeForm],
    names: Sequence[str],
    of: str = "N",
    size: float = 100.0,
    factor: str = "",
) -> list[Term]:
    order = list(PISTON)
    times = order.index(factor) + 1 if factor else 0
    return [
        Term(form, n, order.index(n), PISTON[n], of, size, factor, times) for n in names
    ]


FACTORS = {
    "head": "by how much the flow rises with the command",
    "through": "the flow through the valve",
}
"""What multiplies a curve, where its name does not say it."""


def share_of_level(term: Term) -> Term:
    """The term of a level as a share of the Coulomb level, of either direction."""
    times = len(PISTON) + 1
    return replace(term, of="1", size=0.1, factor="level", times=times)


SLIPS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
"""Deflections at which what has hysteresis is taken to slide, m."""


def deflection_name(slip: float) -> str:
    """What samples and names call the deflection of what slides there: `w_300um`."""
    return f"w_{1e6 * slip:.0f}um"


PLAYS = (3e-3, 1e-2, 3e-2, 0.1, 0.3)
"""Half-widths of a play of the command that are tried, {u}."""

LAGS = (3e-3, 1e-2, 3e-2, 0.1)
"""Time constants of a lag of the command that are tried, s."""

_BOTH, _FIRST, _SECOND, _ACROSS = (1.0, 1.0), (1.0, 0.0), (0.0, 1.0), (1.0, -1.0)

TERMS: tuple[Term, ...] = (
    Term(FreeCommand, "u", 0, "{u}", "{u}", 0.1),
    *(Term(FreeCommand, "back", 1, "{u}", "{u}", 0.1, slip=slip) for slip in PLAYS),
    *(Term(FreeCommand, "behind", 2, "{u}", "{u}", 0.1, tau=tau) for tau in LAGS),
    *(
        Term(FreeFlow, *signal, "m^3/s", 1e-6, share=share)
        for signal, share in (
            (("P_a1", 0, "Pa"), _FIRST),
            (("P_a2", 0, "Pa"), _SECOND),
            (("P", 0, "Pa"), _BOTH),
            (("P_net", 1, "Pa"), _ACROSS),
            (("v", 2, "m/s"), _ACROSS),
            (("v", 2, "m/s"), _BOTH),
            (("u", 4, "{u}"), _ACROSS),
        )
    ),
    *(
        Term(FreeFlow, "P", 0, "Pa", "m^3/(s*{u})", 1e-6, factor, times)
        for factor, times in (("filling", 6), ("emptying", 7))
    ),
    Term(FreeFlow, "x", 3, "m", "m^3/(s*Pa)", 1e-13, "P_net", 2, _ACROSS),
    Term(FreeFlow, "t", 8, "s", "m^3/(s*Pa)", 1e-13, "P_net", 2, _ACROSS),
    *(
        Term(FreeFlow, signal, which, unit, of, size, factor, times)
        for signal, which, unit in (("t", 8, "s"), ("P_s", 7, "Pa"))
        for of, size, factor, times in (
            ("{u}", 1e-2, "head", 10),
            ("1", 0.1, "through", 11),
        )
    ),
    Term(FreeCompliance, "P", 0, "Pa", "1/Pa", 1e-10),
    *_piston(FreeLevel, ("v", "x", "P_mean", "P_net", "P_a1", "P_a2")),
    *_piston(FreeLevel, ("t", "since", "way")),
    *_piston(FreeLevel, [name for name in PISTON if name.startswith("age")]),
    *_piston(FreeLevel, ("P_mean",), "N*s/m", 1e3, "v"),
    *_piston(FreeLevel, ("x",), "N/Pa", 1e-5, "P_mean"),
    *_piston(FreeFriction, ("v", "z", "a", "P_net")),
    *_piston(FreeFriction, ("P_mean", "x", "t"), "N*s/m", 1e3, "v"),
    *(Term(FreeHysteresis, "w", 0, "m", "N", 100.0, slip=slip) for slip in SLIPS),
    *_piston(FreeForce, ("x", "v", "a", "P_net", "t")),
    Term(FreeForce, "F", 9, "N", "N", 100.0),
)
"""What is searched, all of it counted in the family-wise p-values."""


def coefficients(form: type[FreeForm] | FreeForm) -> list[str]:
    """Names of a free form's coefficients, as a model has them."""
    return [f"{form.name}.{field}" for field in specs(form)]
