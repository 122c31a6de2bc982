"""Which quantities of a controller are tuned."""

from __future__ import annotations

from collections.abc import Mapping

from hydrojax.errors import InputError
from hydrojax.plant.load import Inertia
from hydrojax.rigfile.controller import KEYS
from hydrojax.rigfile.quantities import Quantity, Setting, find

FREE = ("k_p", "k_f", "k_1")
"""What is tuned by default: both gains, and how much of the desired
force's rate is fed forward."""

ADAPTATION = ("rho_a", "c_1", "c_2", "c_3", "A_a_lower", "A_a_upper")
"""What is tuned beside them with `--adaptation`, as far as the rig adapts it."""


def default_free(setting: Setting) -> tuple[str, ...]:
    """What is tuned where nothing is named: `FREE`, and `A_a` where a load moves."""
    moves = isinstance(setting.loop.load, Inertia)
    return (*FREE, "A_a") if moves else FREE


def gain(known: Mapping[str, Quantity], name: str) -> Quantity:
    """A quantity of the controller, by its name.

    Raises:
        InputError: there is none of that name, or it is no gain.
    """
    quantity = find(known, name, f"gain {name}")
    key = name
    for end in ("_hat", "_lower", "_upper"):
        key = key.removesuffix(end)
    if key not in KEYS or (quantity.reach is None) or name == "rate":
        raise InputError(f"invalid gain {name!r}: expected k_p, k_f, k_1, tau_d, A_a …")
    return quantity


def adaptable(known: Mapping[str, Quantity], setting: Setting) -> list[Quantity]:
    """The quantities of the adaptation that are above 0."""
    chosen = [known[n] for n in ADAPTATION]
    return [q for q in chosen if float(q.get(setting)) > 0]
