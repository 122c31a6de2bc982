"""A rig file's [controller], in the paper's units, and the law that it makes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hydrojax import units
from hydrojax.control.adaptive import (
    VALVE_GAIN,
    VOLT_SECONDS_PER_KILONEWTON,
    Law,
    Safeguards,
)
from hydrojax.control.base import ESTIMATES, RATES, AbstractController, Estimates, Gain
from hydrojax.control.inverting import mean_area
from hydrojax.control.loop import Loop, Sensors
from hydrojax.errors import InputError, check_known
from hydrojax.parameters import Spec, specs
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.schema import RigFile

Kept = TypeVar("Kept", bound=AbstractController)

ENCODER = 2 * np.pi / 2**23
"""The paper's absolute encoder of 23 bits: one step, rad."""


def _keyed(*declared: Mapping[str, Spec]) -> dict[str, Gain]:
    """Declarations by the keys of [controller]."""
    return {
        spec.key or field: spec
        for own in declared
        for field, spec in own.items()
        if isinstance(spec, Gain)
    }


_GAINS = specs(Law)

KEYS: Mapping[str, Gain] = _keyed(
    specs(Loop),
    {"kappa": VALVE_GAIN},
    {name: _GAINS[name] for name in ("k_p", "k_f")},  # ahead, as they are shown first
    RATES,
    ESTIMATES,
    _GAINS,
    specs(Safeguards),
    specs(Sensors),
)
"""What a rig file may say of its controller, by the paper's names: what loop, law and
sensors declare beside their fields."""

LOOP_KEYS = set(_keyed(specs(Loop), specs(Sensors)))
"""Keys that belong to the loop and its sensors, whatever controls it."""

PAPER: Mapping[str, float] = {
    "rate": 1000.0, "k_p": 1.2, "k_f": 2.4,
    "rho_1": 0.0, "rho_a": 700.0,
    "c_1": 100.0, "c_2": 100.0, "c_3": 20.0,
    "c_4": 1e3, "c_5": 1e3, "c_6": 20.0, "c_7": 20.0,
    "tau_d": 0.0, "tau_v": 0.0,
}  # fmt: skip
"""Defaults in the paper's units: what it prints, and of what it does not print
(c_4 to c_7, the two filters) values that do about as much."""

KIND = "kind"
"""The key of [controller] that says which controller it is."""

ADAPTIVE, FIXED = "adaptive", "fixed"

KINDS: Mapping[str, str] = {
    ADAPTIVE: "the paper's law",
    FIXED: "the paper's law without adaptation: its rates are 0",
    "pi": "PI with velocity feedforward",
    "linearizing": "P through the inverse of the valve",
    "backstepping": "backstepping over the spool",
}
"""The controllers that a rig file can name."""

LAWS = (ADAPTIVE, FIXED)
"""Those that are the paper's law."""

Values = dict[str, tuple[float, float]]
"""Keys in SI but for volts, which stay the law's; one value is a pair of equals."""


def read_keys(where: str, table: Mapping[str, object], spec: RigFile) -> Values:
    """Keys of [controller]: both ends, SI but for volts, which stay the law's.

    Args:
        where: opens an error's line.
        table: the keys as written.
        spec: the rig, for its units.

    Raises:
        InputError: an invalid key, unit or value.
    """
    out: Values = {}
    for name, given in table.items():
        check_known(where, [name], KEYS, "key")
        key = KEYS[name]
        both = list(given) if isinstance(given, (list, tuple)) else [given, given]
        if len(both) != 2 or (both[0] is not both[1] and not key.pair):
            shape = "one value, or two bounds" if key.pair else "one value"
            raise InputError(
                f"{where} {name}: invalid value {given!r}: expected {shape}"
            )
        lower, upper = (_number(f"{where} {name}", name, v, spec) for v in both)
        if lower > upper:
            raise InputError(f"{where} {name}: {given!r} is upside down; exchange them")
        if (not key.pair and lower < 0) or (key.positive and lower <= 0):
            lowest = "above 0" if key.positive else "0 or more"
            raise InputError(f"{where} {name}: {given!r} must be {lowest}")
        out[name] = (lower, upper)
    return out


def file_keys(spec: RigFile) -> Values:
    """The keys that the file's [controller] gives: both ends, SI but for volts.

    Raises:
        InputError: an invalid key, unit or value.
    """
    of_law = kind_of(spec) in LAWS
    table = {
        key: value
        for key, value in spec.controller.items()
        if key != KIND and (of_law or key in LOOP_KEYS)
    }
    keys = read_keys(f"{spec.path}: [controller]", table, spec)
    if kind_of(spec) == FIXED:
        keys |= dict.fromkeys(RATES, (0.0, 0.0))
    return keys


def kind_of(spec: RigFile) -> str:
    """Which of `KINDS` a rig file's controller is.

    Raises:
        InputError: none of them.
    """
    kind = spec.controller.get(KIND, ADAPTIVE)
    check_known(f"{spec.path}: [controller] {KIND}:", [str(kind)], KINDS, "controller")
    return str(kind)


def full_command(spec: RigFile) -> float:
    """The command at full opening, where nothing else is said: V or 1."""
    return 1.0 if spec.command_unit == "1" else 10.0


def with_gains(
    law: Kept, gains: Mapping[str, object], spec: RigFile, where: str
) -> Kept:
    """A controller with other gains.

    Args:
        law: declares the gains.
        gains: by name; a quantity, or a number in the declared unit.
        spec: the rig file, for the unit of the command.
        where: opens an error's line.

    Raises:
        InputError: an unknown gain, or an invalid quantity.
    """
    declared = specs(law)
    for name in gains:
        if name in KEYS and name not in declared:
            raise InputError(
                f"{where} {name} is of another kind of controller; delete it, and give "
                f"gains of this one: {', '.join(declared)}"
            )
    check_known(where, gains, declared, "gain")
    for name, value in gains.items():
        unit = units.with_command(declared[name].unit, spec.command_unit)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            value = f"{value} {unit}"
        new = _array(units.quantity(value, unit, f"{where} {name}"))
        law = eqx.tree_at(lambda c, name=name: getattr(c, name), law, new)
    return law


def key_unit(name: str, spec: RigFile) -> str:
    """The paper's unit of a key, as this rig has it."""
    if name == "resolution" and "radius" not in spec.geometry:
        return "m"
    return units.with_command(written_unit(name), spec.command_unit)


def written_unit(name: str) -> str:
    """The paper's unit of a key, in which a bare number is taken."""
    key = KEYS[name]
    return key.written or (key.outside[1] if key.outside else key.unit)


def _number(where: str, name: str, value: object, spec: RigFile) -> float:
    """One value in SI; a bare number is in the paper's unit."""
    unit = key_unit(name, spec)
    want = si(unit)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        value = f"{value} {unit}"
    if isinstance(value, bool):
        raise InputError(f"{where}: invalid {value!r}: expected a number in {unit}")
    number, written = units.split(value, where)
    if "rad" in want and not written:
        written = unit
    if not written:
        return units.to_si(number, unit, want, where)
    return units.to_si(number, written, want, where)


def _array(value: float) -> jax.Array:
    """A number as a parameter: not weakly typed, or a change of it would recompile."""
    return jnp.asarray(value, float)


def si(unit: str) -> str:
    """The SI unit of a unit of the paper's."""
    return unit.replace("kN", "N")


def control_period(keys: Values) -> float:
    """The control period, s."""
    return 1 / _one(keys, "rate")


def _one(keys: Values, name: str) -> float:
    if name in keys:
        return keys[name][0]
    return units.to_si(PAPER[name], written_unit(name), si(written_unit(name)), name)


def valve_gain(keys: Values, nominal: Rig) -> float:
    """kappa, m^2/s per volt of the law."""
    if "kappa" in keys:
        return keys["kappa"][0]
    return 1 / float(nominal.chambers.beta) / (VOLT_SECONDS_PER_KILONEWTON * 1e-3)


def make_law(keys: Values, nominal: Rig, spec: RigFile, P_r: float) -> Law:
    """The paper's law with these keys, and defaults for those that are not there.

    Args:
        keys: as `read_keys` gives them.
        nominal: the rig without effects, which the law takes for the plant.
        spec: the rig file.
        P_r: return pressure, Pa.
    """
    kappa = valve_gain(keys, nominal)

    def scale(name: str) -> float:
        return kappa if KEYS[name].volts else 1.0

    def value(name: str) -> jax.Array:
        return _array(_one(keys, name) * scale(name))

    bounds = default_bounds(nominal)
    for name in Estimates._fields:
        if name in keys:
            lower, upper = keys[name]
            bounds[name] = (lower * scale(name), upper * scale(name))
    given = [name for name in specs(Safeguards) if name in keys]
    guards = Safeguards(**{name: _array(keys[name][0]) for name in given})
    return Law(
        nominal=nominal,
        k_p=value("k_p"),
        k_f=value("k_f"),
        rate=Estimates(*(value(name) for name in RATES)),
        lower=Estimates(*(_array(bounds[n][0]) for n in Estimates._fields)),
        upper=Estimates(*(_array(bounds[n][1]) for n in Estimates._fields)),
        P_r=_array(P_r),
        u_max=_array(keys["u_max"][0] if "u_max" in keys else full_command(spec)),
        tau_d=value("tau_d"),
        tau_v=value("tau_v"),
        safeguards=guards if given else None,
    )


def default_bounds(nominal: Rig) -> dict[str, tuple[float, float]]:
    """The paper's bounds, or wider ones where the rig's own values ask for it.

    Of presliding the paper prints none. They keep off zero and well below infinity:
    white noise beyond the loop's resonance would drive these two estimates to either
    end, and the low-frequency gain with them.
    """
    f, beta = nominal.mechanics, float(nominal.chambers.beta)
    area = float(mean_area(nominal))
    bounds = {"k_1": (1 / beta, 1 / beta), "A_a": (0.6 * area, 1.5 * area)}
    reach = {"k_cp": 2e3, "k_cn": 2e3, "k_0": 500.0, "k_vp": 1e4, "k_vn": 1e4}
    for name, most in reach.items():
        most = max(most, 2 * abs(float(getattr(f, name))))
        bounds[name] = (0.0 if name in ("k_cp", "k_cn") else -most, most)
    for name in ("k_fp", "k_fn"):
        own = float(getattr(f, name))
        bounds[name] = (min(0.3, own / 2), max(1.1, 2 * own))
    return bounds
