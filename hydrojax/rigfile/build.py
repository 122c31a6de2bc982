"""From a rig file to a rig and its closed loop: the only place that makes either."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hydrojax.control.loop import Loop, Sensors
from hydrojax.effects import EFFECTS, offered
from hydrojax.effects.valve import LONGEST, FlowTable, ValveDelay
from hydrojax.errors import InputError
from hydrojax.parameters import get, put, specs
from hydrojax.plant.effect import CommandChannel, Effect
from hydrojax.plant.load import Driven, Inertia, TwoMassLoad
from hydrojax.plant.rig import Rig, add, bare_rig
from hydrojax.plant.valve import MeteringEdges
from hydrojax.rigfile.controller import (
    ENCODER,
    LOOP_KEYS,
    Values,
    control_period,
    file_keys,
    make_law,
    read_keys,
    with_gains,
)
from hydrojax.rigfile.other_controllers import named_controller
from hydrojax.rigfile.schema import RigFile
from hydrojax.rigfile.sections import LANDS


def effects_of(names: Iterable[str], file: RigFile) -> dict[str, Effect]:
    """The named effects, absent, in the order of the vocabulary.

    Profiles along the stroke are laid over `file.stroke`.

    Args:
        names: of effects; see `hydrojax.effects.EFFECTS`.
        file: the rig.

    Raises:
        KeyError: a name that the vocabulary lacks.
    """
    offered()
    wanted = set(names)
    if unknown := wanted - set(EFFECTS):
        raise KeyError(f"unknown effects {sorted(unknown)}; known: {list(EFFECTS)}")
    x_from, x_to = file.stroke
    radius = file.geometry.get("radius", 1.0)
    known = {"x_from": x_from, "x_to": x_to, "radius": radius}
    known["u_full"] = 10.0 if file.command_unit == "V" else 1.0
    out = {}
    for name, effect in EFFECTS.items():
        if name in wanted:
            own = {
                f: jnp.asarray(v, float)
                for f, v in known.items()
                if f in effect.__dataclass_fields__
            }
            out[name] = effect(**own)
    return out


def over_travel(file: RigFile, travel: tuple[float, float]) -> RigFile:
    """The file with the candidates' profiles laid over the travel of the logs.

    What the file itself says of its plant stays: a stretch in [geometry], or a profile
    among its effects, which then is laid over `RigFile.stroke`.

    Args:
        file: the rig.
        travel: lowest and highest position in the logs, m; 0 is mid-stroke.
    """
    if "x_from" in file.geometry or lays(file.effects) or travel[0] >= travel[1]:
        return file
    ends = {"x_from": float(travel[0]), "x_to": float(travel[1])}
    return replace(file, geometry=file.geometry | ends)


def lays(names: Iterable[str]) -> bool:
    """Whether one of the named effects is laid over a stretch of the stroke."""
    return any("x_from" in EFFECTS[name].__dataclass_fields__ for name in names)


def build_rig(
    file: RigFile, effects: Iterable[str] = (), added: Iterable[Effect] = ()
) -> Rig:
    """The rig of a file at its start values.

    Args:
        file: the rig; the effects it declares are in the result.
        effects: names of further effects, which are added absent: all their strengths
            are zero.
        added: further effects as they are, also of classes that are not registered;
            those are put behind the vocabulary's.

    Raises:
        KeyError: an effect that the vocabulary lacks.
        InputError: no effect among `added`, or one that the rig has already.
    """
    modules = effects_of((*file.effects, *effects), file)
    modules |= _own(added, modules)
    order = {name: i for i, name in enumerate(EFFECTS)}
    names = sorted(modules, key=lambda name: order.get(name, len(order)))
    found = [modules[n] for n in names]
    if file.table is not None:
        found.append(FlowTable(*file.table))
    rig = add(bare_rig(file.layout, file.geometry), found)
    if rig.returns and not inverts(file):
        raise InputError(
            f"{file.path}: {rig.returns[0].name} is of a valve with four metering "
            f"edges, not of {type(file.valve).__name__}; delete the effect"
        )
    if file.valve is not None:
        rig = eqx.tree_at(lambda r: r.valve, rig, file.valve)
    elif file.command_unit == "1" and file.layout.has_valve:
        # The default valve constants are per volt of a +-10 V command.
        rig = put(rig, LANDS, 10 * get(rig, LANDS))
    given = {name: e.start for name, e in file.parameters.items()}
    for effect, entries in file.effects.items():
        given |= {f"{effect}.{name}": e.start for name, e in entries.items()}
    return put(rig, tuple(given), jnp.array(list(given.values()))) if given else rig


def _own(added: Iterable[Effect], there: Iterable[str]) -> dict[str, Effect]:
    """Effects given as instances, by name."""
    out: dict[str, Effect] = {}
    for effect in added:
        if not isinstance(effect, Effect) or not getattr(effect, "place", ""):
            raise InputError(
                f"effects: invalid {effect!r}: expected an instance of an effect, "
                "such as ValveLag(omega=...)"
            )
        name = getattr(effect, "name", "") or type(effect).__name__
        if name in out or name in there:
            raise InputError(f"effects: the rig has {name!r} already; give it once")
        out[name] = effect
    return out


def build_loop(
    file: RigFile,
    rig: Rig | None = None,
    gains: Mapping[str, object] | None = None,
    where: str = "gains:",
) -> Loop:
    """The closed loop of a rig file.

    A filter that the logger had on in some logs is not in it: no loop reads by that.

    Args:
        file: the rig.
        rig: the plant, if it is another than `build_rig(file)`; the paper's law knows
            the file's without effects, but for those of the switch L(t).
        gains: keys of [controller] that replace the file's; for a controller in
            `file.law`, names of its gains.
        where: what opens an error line about `gains`.

    Raises:
        InputError: an invalid key, unit or value; a rig without a valve; or one whose
            valve the paper's law cannot invert, and no other law.
    """
    if not file.layout.has_valve:
        raise InputError(
            f"{file.path}: layout {file.layout.name!r} has no valve to close a "
            "loop with; give the rig's areas and another layout"
        )
    switch = {n: e for n, e in file.effects.items() if EFFECTS[n].place == "switch"}
    nominal = build_rig(replace(file, effects=switch))
    keys = file_keys(file)
    gains = dict(gains or {})
    law = file.law
    if law is None:
        _check_invertible(file)
        law = named_controller(file, nominal)
    if law is None:
        keys |= read_keys(where, gains, file)
        law = make_law(keys, nominal, file, file.line["P_r"])
    else:
        keys |= read_keys(
            where, {k: gains.pop(k) for k in LOOP_KEYS & set(gains)}, file
        )
        law = with_gains(law, gains, file, where)
    rig = build_rig(file) if rig is None else rig
    if file.filtered:
        own = tuple(c for c in rig.sensor_P if not c.of_the_logger)
        rig = replace(rig, sensor_P=own)
    h = control_period(keys)
    rig = with_queues(rig, h)
    return Loop(
        rig=rig,
        law=law,
        load=_load(file),
        sensors=_sensors(keys, file),
        h=_array(h),
        P_start=_array(_start(nominal, sum(file.line.values()) / 2)),
    )


def inverts(file: RigFile) -> bool:
    """Whether the paper's law can invert the rig's valve: it needs metering edges."""
    return file.valve is None or isinstance(file.valve, MeteringEdges)


def _check_invertible(file: RigFile) -> None:
    if not inverts(file):
        raise InputError(
            f"{file.path}: the paper's law inverts four metering edges, not the valve "
            f"{type(file.valve).__name__}; give a controller of your own as the law"
        )


def _start(rig: Rig, middle: float) -> float:
    """Pressure of chamber 1 at rest: both about midway, and no force, Pa."""
    a_1, a_2 = float(rig.force_area_1), float(rig.force_area_2)
    return 2 * middle * a_2 / (a_1 + a_2)


def with_queues(rig: Rig, h: float, longest: float = 0.0) -> Rig:
    """The rig with delays that hold enough ticks to be stepped.

    One of two sizes is taken, so that few programs serve every delay.

    Args:
        rig: the rig.
        h: length of a tick, s.
        longest: that a delay may become, s; twice its own at least.
    """

    def long(channel: CommandChannel) -> CommandChannel:
        if not isinstance(channel, ValveDelay):
            return channel
        tau_u = max(2 * float(channel.tau_u), longest)
        if tau_u <= (channel.queue - 1) * h:
            return channel
        return replace(channel, queue=math.ceil(max(LONGEST, tau_u) / h) + 2)

    command = tuple(map(long, rig.command))
    return eqx.tree_at(
        lambda r: r.command, rig, command, is_leaf=lambda x: isinstance(x, tuple)
    )


def _array(value: float) -> Float[Array, ""]:
    """A number as a parameter: not weakly typed, or a change of it would recompile."""
    return jnp.asarray(value, float)


def _sensors(keys: Values, file: RigFile) -> Sensors:
    radius = file.geometry.get("radius")
    step = keys["resolution"][0] if "resolution" in keys else ENCODER * bool(radius)
    noise = {name: file.sensors.get(name, 0.0) for name in ("P_a1", "P_a2", "P_s", "F")}
    sizes = {name: _array(size) for name, size in noise.items()}
    return Sensors(**sizes, step=_array(step * (radius or 1.0)))


def free_load(file: RigFile) -> Inertia:
    """The load of a rig file as one that moves by itself, held to mid-stroke by its
    spring and to the ground by its damper; without a mass where the file gives none.
    """
    given = {name: v for name, v in file.output_load.items() if name != "F"}
    kind = TwoMassLoad if "second_mass" in given else Inertia
    return kind(**{name: _array(given.get(name, 0.0)) for name in specs(kind)})


def _load(file: RigFile) -> Driven | Inertia:
    given = {k: v for k, v in file.output_load.items() if k != "F"}
    if not given:
        return Driven()
    if "mass" not in given:
        raise InputError(
            f'{file.path}: [load] mass is missing; add mass = "150 kg", or take '
            "stiffness and damping out: the environment then leads the piston"
        )
    return free_load(file)
