"""Any quantity of a closed loop by name: read, set and swept, with units.

The controller's names and units are the paper's (`k_p` in V/kN, `rho_a`, `tau_d`), an
estimate's bounds are `k_cp_lower` and `k_cp_upper`, and `k_cp_hat` sets both; `k_1`
and `A_a`, which no plant parameter is called, need no `_hat`. A bare `beta` or `k_cp`
is the plant's: the law keeps its own value. Effects are
`valve_lag.omega`, the load `load.mass`, the noise `noise.F`. The operating point is
`x`, `v`, `F_0`, `P_0`, `P_s`, `P_r`, and `amplitude` the size of the force that is
asked for about it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax import units
from hydrojax.control.adaptive import Law
from hydrojax.control.base import RATES, Estimates
from hydrojax.control.loop import Loop
from hydrojax.effects import EFFECTS
from hydrojax.errors import InputError
from hydrojax.parameters import get, parameter_specs, put, specs
from hydrojax.plant.load import Inertia
from hydrojax.rigfile.build import build_loop, build_rig
from hydrojax.rigfile.controller import KEYS, file_keys, si, valve_gain, written_unit
from hydrojax.rigfile.schema import RigFile

AMPLITUDE = 100.0
"""Of the force that is asked for, N, where nothing else is said."""


class Setting(eqx.Module):
    """A closed loop at an operating point; SI.

    Attributes:
        loop: rig, law, load, sensors.
        x, v: of the piston where the environment leads it, otherwise of the
            environment that the load hangs on, m, m/s.
        F_0: desired force about which the amplitude swings, N.
        P_s, P_r: supply and return pressure, Pa.
        amplitude: of a sine whose RMS the desired force has about F_0, N.
    """

    loop: Loop
    x: Float[Array, ""]
    v: Float[Array, ""]
    F_0: Float[Array, ""]
    P_s: Float[Array, ""]
    P_r: Float[Array, ""]
    amplitude: Float[Array, ""]


Reach = Callable[[Setting], list[Any]]


@dataclass(frozen=True)
class Quantity:
    """One quantity of a `Setting`.

    Attributes:
        name: as users write it.
        unit: as a bare number is taken and a value is shown.
        description: one phrase.
        factor: SI as it is stored, per `unit`.
        reciprocal: whether the reciprocal is stored.
        positive: whether a value must be above 0.
        reach: where it is stored, in one place or more of the same value.
        parameter: its name among the plant's parameters, if it is one.
        gain: whether it is a gain of the controller, which can be tuned.
    """

    name: str
    unit: str
    description: str
    factor: float = 1.0
    reciprocal: bool = False
    positive: bool = False
    reach: Reach | None = None
    parameter: str = ""
    gain: bool = False

    def get(self, setting: Setting) -> Float[Array, ""]:
        """Its value in `unit`: of two bounds, their middle."""
        if self.reach is None:
            stored = get(setting.loop.rig, (self.parameter,))[0]
        else:
            places = self.reach(setting)
            stored = jnp.mean(jnp.stack(places), axis=0)
        return (1 / stored if self.reciprocal else stored) / self.factor

    def put(self, setting: Setting, value: Float[Array, ""] | float) -> Setting:
        """The setting with the value given in `unit`."""
        new = jnp.asarray(value, float) * self.factor
        new = 1 / new if self.reciprocal else new
        if self.reach is None:
            rig = put(setting.loop.rig, (self.parameter,), new[None])
            return eqx.tree_at(lambda s: s.loop.rig, setting, rig)
        return eqx.tree_at(self.reach, setting, [new] * len(self.reach(setting)))

    def number(self, text: object, where: str) -> float:
        """A value as written, in `unit`; a bare number is in it already.

        Raises:
            InputError: no number, another dimension, or below what it may be.
        """
        number, written = units.split(text, where)
        if written and written != self.unit:
            want = si(self.unit)
            per = units.to_si(1.0, self.unit, want, where)
            number = units.to_si(number, written, want, where) / per
        if self.positive and number <= 0:
            raise InputError(f"{where}: {text!r} must be above 0")
        return number


def open_setting(
    spec: RigFile,
    gains: Mapping[str, object] | None = None,
    extra: Iterable[str] = (),
) -> Setting:
    """The closed loop of a rig file, at rest in mid-stroke.

    Args:
        spec: as `RigFile.load` gives it.
        gains: keys of [controller] that replace the file's.
        extra: names of quantities; effects that they need are put in, absent.
    """
    needed = {name.partition(".")[0] for name in extra} & set(EFFECTS)
    loop = build_loop(spec, build_rig(spec, needed - set(spec.effects)), gains)
    zero, number = jnp.asarray(0.0, float), jnp.asarray
    return Setting(
        loop, zero, zero, zero, *(number(spec.line[n], float) for n in ("P_s", "P_r")),
        amplitude=number(AMPLITUDE, float),
    )  # fmt: skip


def quantities(spec: RigFile, setting: Setting) -> dict[str, Quantity]:
    """Everything that can be named in a setting."""
    return {
        q.name: q
        for group in (_point(), _plant, _controller, _load, _noise)
        for q in (group(spec, setting) if callable(group) else group)
    }


def find(known: Mapping[str, Quantity], name: str, where: str) -> Quantity:
    """A quantity by its name.

    Raises:
        InputError: there is none of that name.
    """
    if name in known:
        return known[name]
    if name.startswith("load."):
        raise InputError(
            f'{where}: the rig has no {name!r}; add mass = "150 kg" under [load], '
            "so that the joint can move"
        )
    near = get_close_matches(name, known, n=1, cutoff=0.5)
    mend = f"did you mean {near[0]!r}?" if near else "k_p, k_f, beta, load.mass, x …"
    raise InputError(f"{where}: unknown quantity {name!r}; {mend}")


def _point() -> list[Quantity]:
    said = {
        "x": ("m", "place of the piston", "x"),
        "v": ("m/s", "speed of the piston", "v"),
        "F_0": ("N", "desired force about which it swings", "F_0"),
        "P_s": ("Pa", "supply pressure", "P_s"),
        "P_r": ("Pa", "return pressure", "P_r"),
        "amplitude": (
            "N",
            "of a sine with the RMS of the force asked for",
            "amplitude",
        ),
    }
    out = [
        Quantity(
            name, unit, description, reach=_field(field), positive=name == "amplitude"
        )
        for name, (unit, description, field) in said.items()
    ]
    return [
        *out,
        Quantity("P_0", "Pa", "pressure of chamber 1 at rest",
                 reach=lambda s: [s.loop.P_start]),
    ]  # fmt: skip


def _field(name: str) -> Reach:
    return lambda s: [getattr(s, name)]


def _plant(spec: RigFile, setting: Setting) -> list[Quantity]:
    out = []
    for name, p in parameter_specs(setting.loop.rig).items():
        unit = units.with_command(p.unit, spec.command_unit)
        out.append(Quantity(name, unit, p.description, parameter=name))
        if p.outside:
            own, unit = p.outside
            unit = units.with_command(unit, spec.command_unit)
            shown = name.rpartition(".")[0] + f".{own}"
            out.append(
                Quantity(shown, unit, p.description, reciprocal=True, positive=True,
                         parameter=name)
            )  # fmt: skip
    return out


def _controller(spec: RigFile, setting: Setting) -> list[Quantity]:
    """The gains of the setting's controller, and the sampling rate.

    A controller of a user's own has those that it declares, under the names of its
    fields; `controller.NAME` where the plant has a parameter of that name.
    """
    law = setting.loop.law
    own = _adaptive(spec, law) if isinstance(law, Law) else _declared(spec, setting)
    rate = Quantity(
        "rate", "Hz", KEYS["rate"].description, reciprocal=True, positive=True,
        reach=lambda s: [s.loop.h],
    )  # fmt: skip
    return [*own, rate]


def declared_gains(setting: Setting) -> dict[str, str]:
    """The fields that the controller declares, by the names they have in a setting."""
    taken = {q.name for q in _point()} | set(parameter_specs(setting.loop.rig))
    taken.add("rate")
    return {
        f"controller.{field}" if field in taken else field: field
        for field in specs(setting.loop.law)
    }


def _declared(spec: RigFile, setting: Setting) -> list[Quantity]:
    known = specs(setting.loop.law)
    return [
        Quantity(
            name,
            units.with_command(known[field].unit, spec.command_unit),
            known[field].description,
            reach=lambda s, field=field: [getattr(s.loop.law, field)],
            gain=True,
        )
        for name, field in declared_gains(setting).items()
    ]


def _adaptive(spec: RigFile, law: Law) -> list[Quantity]:
    """The gains, rates and bounds of the paper's law."""
    volts = valve_gain(file_keys(spec), build_rig(replace(spec, effects={})))
    out = []

    def add(name: str, key: str, reach: Reach) -> None:
        k = KEYS[key]
        unit = units.with_command(written_unit(key), spec.command_unit)
        factor = units.to_si(1.0, unit, si(unit), name) * (volts if k.volts else 1.0)
        q = Quantity(name, unit, k.description, factor, reach=reach, gain=True)
        out.append(q)

    for name in specs(Law):
        add(name, name, lambda s, name=name: [getattr(s.loop.law, name)])
    for name in specs(law.safeguards) if law.safeguards is not None else ():
        add(name, name, lambda s, name=name: [getattr(s.loop.law.safeguards, name)])
    for name, estimate in zip(RATES, Estimates._fields, strict=True):
        add(name, name, lambda s, e=estimate: [getattr(s.loop.law.rate, e)])
    for name in Estimates._fields:
        ends = {
            "_lower": lambda s, name=name: [getattr(s.loop.law.lower, name)],
            "_upper": lambda s, name=name: [getattr(s.loop.law.upper, name)],
            "_hat": lambda s, name=name: [
                getattr(s.loop.law.lower, name),
                getattr(s.loop.law.upper, name),
            ],
        }
        for end, reach in ends.items():
            add(name + end, name, reach)
        if name in ("k_1", "A_a"):
            add(name, name, ends["_hat"])
    return out


def _load(spec: RigFile, setting: Setting) -> list[Quantity]:
    if not isinstance(setting.loop.load, Inertia):
        return []
    return [
        Quantity(f"load.{name}", p.unit, p.description, positive=name.endswith("mass"),
                 reach=lambda s, name=name: [getattr(s.loop.load, name)])
        for name, p in specs(setting.loop.load).items()
    ]  # fmt: skip


def _noise(spec: RigFile, setting: Setting) -> list[Quantity]:
    wants = {"P_a1": "Pa", "P_a2": "Pa", "F": "N"}
    return [
        Quantity(f"noise.{name}", unit, f"standard deviation of {name}'s noise",
                 reach=lambda s, name=name: [getattr(s.loop.sensors, name)])
        for name, unit in wants.items()
    ]  # fmt: skip
