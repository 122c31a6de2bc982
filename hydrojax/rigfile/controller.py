"""The door of the law: a rig file's [controller], in the paper's units, to SI."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches

import jax
import jax.numpy as jnp
import numpy as np

from hydrojax import units
from hydrojax.control.adaptive import Estimates, Law, mean_area
from hydrojax.control.loop import Loop, Sensors
from hydrojax.effects.valve import QUEUE, ValveDelay
from hydrojax.errors import InputError
from hydrojax.plant.load import Driven, Inertia
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.build import make_effects, make_rig
from hydrojax.rigfile.schema import RigFile

ENCODER = 2 * np.pi / 2**23
"""The paper's absolute encoder of 23 bits: one step, rad."""


@dataclass(frozen=True)
class Key:
    """One key of [controller].

    Attributes:
        unit: the paper's, in which a bare number is taken.
        says: one phrase.
        volts: whether the law's volts are in it, so that the nominal valve gain turns
            it into SI.
        pair: whether it is an estimate, given as one value (both bounds) or as two.
    """

    unit: str
    description: str
    volts: bool = False
    pair: bool = False


KEYS: Mapping[str, Key] = {
    "rate": Key("Hz", "sampling rate"),
    "kappa": Key("m^2/(s*V)", "nominal valve gain: virtual input per volt of the law"),
    "k_p": Key("V/kN", "gain on the pressure error", volts=True),
    "k_f": Key("V/kN", "gain on the force error", volts=True),
    "rho_1": Key("V*s/kN^3", "rate of adapting k_1", volts=True),
    "rho_a": Key("V*s/kN", "rate of adapting A_a", volts=True),
    "c_1": Key("1/s", "rate of adapting k_cp"),
    "c_2": Key("1/s", "rate of adapting k_cn"),
    "c_3": Key("1/s", "rate of adapting k_0"),
    "c_4": Key("s/m^2", "rate of adapting k_vp"),
    "c_5": Key("s/m^2", "rate of adapting k_vn"),
    "c_6": Key("1/(s*kN^2)", "rate of adapting k_fp"),
    "c_7": Key("1/(s*kN^2)", "rate of adapting k_fn"),
    "k_1": Key("V*s/kN", "1/beta as the law has it", volts=True, pair=True),
    "A_a": Key("V*s", "area as the law has it", volts=True, pair=True),
    "k_cp": Key("kN", "Coulomb level, v > 0", pair=True),
    "k_cn": Key("kN", "Coulomb level, v < 0", pair=True),
    "k_0": Key("kN", "constant offset", pair=True),
    "k_vp": Key("kN*s/m", "fall with speed, v > 0", pair=True),
    "k_vn": Key("kN*s/m", "fall with speed, v < 0", pair=True),
    "k_fp": Key("1", "presliding, F > 0", pair=True),
    "k_fn": Key("1", "presliding, F < 0", pair=True),
    "u_max": Key("{u}", "where the command saturates"),
    "tau_d": Key("s", "time constant of the rate of P_d"),
    "tau_v": Key("s", "time constant of the velocity from the position"),
    "resolution": Key("rad", "step of the position sensor"),
}
"""What a rig file may say of its controller, by the paper's names."""

PAPER: Mapping[str, float] = {
    "rate": 1000.0, "k_p": 1.2, "k_f": 2.4,
    "rho_1": 0.0, "rho_a": 700.0,
    "c_1": 100.0, "c_2": 100.0, "c_3": 20.0,
    "c_4": 1e3, "c_5": 1e3, "c_6": 20.0, "c_7": 20.0,
    "tau_d": 0.0, "tau_v": 0.0,
}  # fmt: skip
"""Defaults in the paper's units: what it prints, and of what it does not print
(c_4 to c_7, the two filters) values that do about as much."""

VOLT_SECONDS_PER_KILONEWTON = 0.01
"""The paper's k_1. A rig's nominal valve gain is by default such that this is 1/beta:
the paper's gains then make a loop of 360 rad/s on any rig."""

_RATES = ("rho_1", "rho_a", "c_1", "c_2", "c_3", "c_4", "c_5", "c_6", "c_7")


def make_loop(
    spec: RigFile,
    rig: Rig | None = None,
    gains: Mapping[str, object] | None = None,
    where: str = "--gains",
) -> Loop:
    """The closed loop of a rig file.

    Args:
        spec: as `load_rig` gives it.
        rig: the plant, if it is another than the file's with the effects it declares;
            the law knows the file's without them.
        gains: keys of [controller] that replace the file's.
        where: what opens an error line about `gains`.

    Raises:
        InputError: a key, unit or value that will not do, or a rig without a valve.
    """
    if not spec.layout.has_valve:
        raise InputError(
            f"{spec.path}: layout {spec.layout.name!r} has no valve to close a "
            "loop with; give the rig's areas and another layout"
        )
    nominal = make_rig(replace(spec, effects={}), {})
    keys = file_keys(spec) | _read(where, gains or {}, spec)
    if rig is None:
        reach = spec.geometry.get("chamber_length", 1.0) / 2
        rig = make_rig(spec, make_effects(spec.effects, spec, (-reach, reach)))
    _check_delay(spec, rig, 1 / _one(keys, "rate"))
    return Loop(
        rig=rig,
        law=_law(keys, nominal, spec, spec.line["P_r"]),
        load=_load(spec),
        sensors=_sensors(keys, spec),
        h=_array(1 / _one(keys, "rate")),
        P_start=_array(_start(nominal, sum(spec.line.values()) / 2)),
    )


def _start(rig: Rig, middle: float) -> float:
    """Pressure of chamber 1 at rest: both about midway, and no force, Pa."""
    a_1, a_2 = float(rig.force_area_1), float(rig.force_area_2)
    return 2 * middle * a_2 / (a_1 + a_2)


def _check_delay(spec: RigFile, rig: Rig, h: float) -> None:
    """Refuse a delay that its queue would cut short."""
    reach = (QUEUE - 1) * h
    for channel in rig.command:
        if isinstance(channel, ValveDelay) and float(channel.tau_u) > reach:
            raise InputError(
                f"{spec.path}: [effects.valve_delay] tau_u: {float(channel.tau_u):g} s "
                f"is more than {reach:.3g} s, as far as a delay reaches at this "
                "[controller] rate; lower either"
            )


Values = dict[str, tuple[float, float]]
"""Keys in SI but for volts, which stay the law's; one value is a pair of equals."""


def _read(where: str, table: Mapping[str, object], spec: RigFile) -> Values:
    out: Values = {}
    for name, given in table.items():
        if name not in KEYS:
            near = get_close_matches(name, KEYS, n=1, cutoff=0.5)
            mend = f"did you mean {near[0]!r}?" if near else f"known: {list(KEYS)}"
            raise InputError(f"{where} unknown key {name!r}; {mend}")
        key = KEYS[name]
        both = list(given) if isinstance(given, (list, tuple)) else [given, given]
        if len(both) != 2 or (both[0] is not both[1] and not key.pair):
            shape = "one value, or two bounds" if key.pair else "one value"
            raise InputError(f"{where} {name}: {given!r} will not do; give {shape}")
        lower, upper = (_number(f"{where} {name}", name, v, spec) for v in both)
        if lower > upper:
            raise InputError(f"{where} {name}: {given!r} is upside down; exchange them")
        positive = name in ("rate", "kappa", "u_max")
        if (not key.pair and lower < 0) or (positive and lower <= 0):
            least = "above 0" if positive else "0 or more"
            raise InputError(f"{where} {name}: {given!r} must be {least}; mend it")
        out[name] = (lower, upper)
    return out


def file_keys(spec: RigFile) -> Values:
    """The keys that the file's [controller] gives: both ends, SI but for volts.

    Raises:
        InputError: a key, unit or value that will not do.
    """
    return _read(f"{spec.path}: [controller]", spec.controller, spec)


def key_unit(name: str, spec: RigFile) -> str:
    """The paper's unit of a key, as this rig has it."""
    if name == "resolution" and "radius" not in spec.geometry:
        return "m"
    return units.with_command(KEYS[name].unit, spec.command_unit)


def _number(where: str, name: str, value: object, spec: RigFile) -> float:
    """One value in SI; a bare number is in the paper's unit."""
    unit = key_unit(name, spec)
    want = si(unit)
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        value = f"{value} {unit}"
    if isinstance(value, bool):
        raise InputError(f"{where}: {value!r} is no quantity; give a number in {unit}")
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


def _one(keys: Values, name: str) -> float:
    if name in keys:
        return keys[name][0]
    return units.to_si(PAPER[name], KEYS[name].unit, si(KEYS[name].unit), name)


def valve_gain(keys: Values, nominal: Rig) -> float:
    """kappa, m^2/s per volt of the law."""
    if "kappa" in keys:
        return keys["kappa"][0]
    return 1 / float(nominal.chambers.beta) / (VOLT_SECONDS_PER_KILONEWTON * 1e-3)


def _law(keys: Values, nominal: Rig, spec: RigFile, P_r: float) -> Law:
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
    full = 1.0 if spec.command_unit == "1" else 10.0
    return Law(
        nominal=nominal,
        k_p=value("k_p"),
        k_f=value("k_f"),
        rate=Estimates(*(value(name) for name in _RATES)),
        lower=Estimates(*(_array(bounds[n][0]) for n in Estimates._fields)),
        upper=Estimates(*(_array(bounds[n][1]) for n in Estimates._fields)),
        P_r=_array(P_r),
        u_max=_array(keys["u_max"][0] if "u_max" in keys else full),
        tau_d=value("tau_d"),
        tau_v=value("tau_v"),
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


def _sensors(keys: Values, spec: RigFile) -> Sensors:
    radius = spec.geometry.get("radius")
    step = keys["resolution"][0] if "resolution" in keys else ENCODER * bool(radius)
    noise = {name: spec.sensors.get(name, 0.0) for name in ("P_a1", "P_a2", "P_s", "F")}
    sizes = {name: _array(size) for name, size in noise.items()}
    return Sensors(**sizes, step=_array(step * (radius or 1.0)))


def _load(spec: RigFile) -> Driven | Inertia:
    given = {k: v for k, v in spec.load.items() if k != "F"}
    if not given:
        return Driven()
    if "mass" not in given:
        raise InputError(
            f'{spec.path}: [load] mass is missing; add mass = "150 kg", or take '
            "stiffness and damping out: the environment then leads the piston"
        )
    rest = {"stiffness": 0.0, "damping": 0.0} | given
    for name, value in rest.items():
        if value < 0 or (name == "mass" and value == 0):
            raise InputError(
                f"{spec.path}: [load] {name} must be "
                f"{'above' if name == 'mass' else 'at least'} 0, not {value:g}; mend it"
            )
    return Inertia(**{name: _array(v) for name, v in rest.items()})
