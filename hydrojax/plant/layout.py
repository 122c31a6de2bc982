"""Layouts of the actuator: which chambers it has, and what can be measured on it.

Everything that differs between layouts is a field here. Code that needs to know asks
the value; only the rig file and messages use its name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import jax.numpy as jnp
from jaxtyping import Array, Float


@dataclass(frozen=True)
class Layout:
    """An arrangement of chambers around one piston.

    Attributes:
        name: in rig files and messages.
        geometry: keys of [geometry] that the layout needs.
        chamber_areas: for chambers 1 and 2, the key of [geometry] that holds the area,
            or the area itself, m^2; they relate flows, volumes and motion, (10)-(15).
        force_areas: the same for the areas on which the pressures push, (16).
        pressures: the chamber pressures that exist, and so can be logged.
        has_valve: whether a valve drives the chambers. Without one the net drive force
            P is an input.
        driven: whether anything drives the piston. Nothing does where it is moved from
            outside, and the force that it takes is measured.
    """

    name: str
    geometry: tuple[str, ...]
    chamber_areas: tuple[str | float, str | float]
    force_areas: tuple[str | float, str | float]
    pressures: tuple[str, ...] = ("P_a1", "P_a2")
    has_valve: bool = True
    driven: bool = True

    def areas(
        self, geometry: Mapping[str, float]
    ) -> tuple[Float[Array, 2], Float[Array, 2]]:
        """Areas of chambers 1 and 2, and those on which the pressures push, m^2.

        Args:
            geometry: quantities in SI by the keys of [geometry].

        Raises:
            KeyError: an area that the layout needs is missing.
        """

        def resolve(sources: tuple[str | float, str | float]) -> Float[Array, 2]:
            return jnp.asarray(
                [geometry[s] if isinstance(s, str) else s for s in sources], float
            )

        return resolve(self.chamber_areas), resolve(self.force_areas)

    @property
    def unmeasured(self) -> tuple[str, ...]:
        """The chamber pressures that do not exist in this layout."""
        return tuple(p for p in ("P_a1", "P_a2") if p not in self.pressures)


LAYOUTS: Mapping[str, Layout] = MappingProxyType(
    {
        layout.name: layout
        for layout in (
            Layout(
                "pull-pull",
                ("area", "chamber_length"),
                ("area", "area"),
                ("area", "area"),
            ),
            Layout(
                "differential",
                ("area_1", "area_2", "chamber_length"),
                ("area_1", "area_2"),
                ("area_1", "area_2"),
            ),
            # Chamber 1 is open: it holds fluid at no pressure and pushes nothing.
            Layout("single", ("area",), ("area", "area"), (0.0, "area"), ("P_a2",)),
            # P_a2 stands for the drive force: P/(1 m^2) on one square metre.
            Layout("driven-axis", (), (1.0, 1.0), (0.0, 1.0), (), has_valve=False),
            Layout("tester", (), (1.0, 1.0), (0.0, 1.0), (), False, driven=False),
        )
    }
)
"""The layouts by name."""
