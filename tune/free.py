"""Which quantities of a controller are tuned."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from hydrojax.control.adaptive import Law
from hydrojax.control.base import RATES
from hydrojax.errors import InputError
from hydrojax.plant.load import Inertia
from hydrojax.rigfile.quantities import Quantity, Setting, declared_gains, find

FREE = ("k_p", "k_f", "k_1")
"""What is tuned by default: both gains, and how much of the desired
force's rate is fed forward."""


def default_free(setting: Setting) -> tuple[str, ...]:
    """What is tuned where nothing is named.

    Of the paper's law `FREE`, `A_a` where a load moves, and the rates of adaptation
    that are above 0; of another controller all that it declares but the saturation.
    """
    if not isinstance(setting.loop.law, Law):
        known = declared_gains(setting)
        return tuple(name for name, field in known.items() if field != "u_max")
    moves = isinstance(setting.loop.load, Inertia)
    rates = [
        name
        for name, rate in zip(RATES, setting.loop.law.rate, strict=True)
        if float(rate) > 0
    ]
    return (*FREE, *(("A_a",) if moves else ()), *rates)


def find_gain(known: Mapping[str, Quantity], name: str) -> Quantity:
    """A quantity of the controller, by its name.

    Raises:
        InputError: there is none of that name, or it is no gain.
    """
    quantity = find(known, name, f"gain {name}")
    if not quantity.gain:
        gains = ", ".join(q.name for q in known.values() if q.gain)
        raise InputError(f"invalid gain {name!r}: expected one of {gains}")
    return quantity


def check_starts(setting: Setting, free: Iterable[Quantity]) -> None:
    """Refuse gains that would not be searched where they are: below 0.

    Raises:
        InputError: one starts below 0.
    """
    for quantity in free:
        start = float(quantity.get(setting))
        if start < 0:
            raise InputError(
                f"gain {quantity.name}: starts at {start:g} {quantity.unit}, and only "
                "gains above 0 are searched; leave it out of what is tuned (--free)"
            )
