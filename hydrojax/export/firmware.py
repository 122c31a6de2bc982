"""The control law as C99: one header, one source, the rig's numbers baked in.

The texts are `law.h.jinja` and `law.c.jinja`; here are the numbers. It is the law of
`hydrojax.control.adaptive`, sample for sample.
"""

from __future__ import annotations

from collections.abc import Iterable

import jax.numpy as jnp
import numpy as np

from hydrojax import __version__
from hydrojax.control.adaptive import Law
from hydrojax.control.base import Estimates
from hydrojax.control.inverting import LEAST_DROP
from hydrojax.errors import InputError
from hydrojax.export.template import fill
from hydrojax.export.tree import defaults_taken, rig_tree
from hydrojax.parameters import specs
from hydrojax.plant.valve import metering_edges
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.controller import ADAPTIVE, KIND, si, written_unit
from hydrojax.rigfile.schema import RigFile

UNITS = ("1/Pa", "m^2", *(si(written_unit(name)) for name in Estimates._fields[2:]))
"""Of the nine estimates, as `Law` holds them."""


def firmware_of(spec: RigFile) -> dict[str, str]:
    """`law.h` and `law.c` for a rig, by name.

    Raises:
        InputError: the rig has no valve, an invalid entry in [controller], or another
            controller than the paper's law.
    """
    loop = build_loop(spec)
    if not isinstance(loop.law, Law):
        raise InputError(
            f"{spec.path}: c: only the paper's law is written as C, not "
            f"{type(loop.law).__name__}; set {KIND} = {ADAPTIVE!r} under [controller]"
        )
    volts = spec.command_unit == "V"
    known = {
        "rig": spec.name,
        "version": __version__,
        "command": "V" if volts else "as a fraction of full opening",
        "per": "s V " if volts else "s ",
        "estimates": Estimates._fields,
        "units": UNITS,
        "guarded": loop.law.safeguards is not None,
        "law": {"h": float(loop.h)} | law_numbers(loop.law),
    }
    return {name: fill(f"{name}.jinja", **known) for name in ("law.h", "law.c")}


def law_numbers(law: Law) -> dict[str, float | list[float]]:
    """What the C law's parameters are, by the names of `law_parameters`; SI."""
    nominal = law.nominal
    chambers, friction = nominal.chambers, nominal.mechanics
    lands = metering_edges(nominal.valve)
    length_1, length_2 = chambers.lengths(jnp.zeros(()))
    each = {
        "k_p": law.k_p, "k_f": law.k_f,
        "rate": law.rate, "lower": law.lower, "upper": law.upper,
        "P_r": law.P_r, "u_max": law.u_max, "tau_d": law.tau_d, "tau_v": law.tau_v,
        "least_drop": LEAST_DROP,
        "area_1": chambers.area_1, "area_2": chambers.area_2,
        "push_1": nominal.force_area_1 / chambers.area_1,
        "push_2": nominal.force_area_2 / chambers.area_2,
        "length_1": length_1, "length_2": length_2,
        "c_p1": lands.c_p1, "c_n1": lands.c_n1,
        "c_p2": lands.c_p2, "c_n2": lands.c_n2,
        "z_ss": friction.z_ss, "delta": friction.delta,
        "L_slope": friction.L_slope, "L_rate": friction.L_rate,
    }  # fmt: skip
    guard = law.safeguards
    if guard is not None:
        each |= {name: getattr(guard, name) for name in specs(guard)}
    return {name: np.asarray(value).tolist() for name, value in each.items()}


def not_given(spec: RigFile) -> Iterable[str]:
    """Keys of [controller] for which the law takes a default.

    The sensor's step is none of the law's.
    """
    keys = defaults_taken(rig_tree(spec)["controller"])
    return (name for name in keys if name != "resolution")
