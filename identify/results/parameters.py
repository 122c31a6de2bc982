"""Parameters and effects of a run as reports show them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from hydrojax.effects import EFFECTS
from hydrojax.identify.inference.uncertainty import Uncertainty
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.results.outcome import FoundEffect, Parameter
from hydrojax.identify.tracing.state import Tracing
from hydrojax.parameters import Spec, parameter_specs
from hydrojax.units import with_command

if TYPE_CHECKING:
    from hydrojax.identify.case import Case


def parameter_of(
    name: str, case: Case, state: Tracing, uncertainty: Uncertainty, spec: Spec
) -> tuple[str, Parameter]:
    """A parameter as reports show it: by its outside name where it has one."""
    value = float(state.point.values[state.problem.model.names.index(name)])
    free = name in state.free
    known = state.problem.free.get(name)
    start = known.start if known else value
    std = uncertainty.std.get(name)
    interval = None if std is None else (value - 1.96 * std, value + 1.96 * std)
    at_bound = free and name in uncertainty.ends
    unit = with_command(spec.unit, case.spec.command_unit)
    shown = name.rsplit(".", 1)[-1]
    if spec.outside:
        shown, unit = (
            spec.outside[0],
            with_command(spec.outside[1], case.spec.command_unit),
        )
        if std is not None and interval is not None and value > 0:
            ends = [1 / max(e, 1e-12) for e in interval]
            std, interval = std / value**2, (min(ends), max(ends))
        value = 1 / value if value else float("inf")
        start = 1 / start if start else float("inf")
    profile = uncertainty.profiles.get(name)
    if profile and spec.outside:
        profile = (1 / profile[1] if profile[1] else None,
                   1 / profile[0] if profile[0] else None)  # fmt: skip
    if interval and known and not spec.outside:
        interval = (max(interval[0], known.lower), min(interval[1], known.upper))
    return shown, Parameter(
        value, unit, spec.description, start, free, std, interval, at_bound,
        free and not at_bound and name not in uncertainty.unidentifiable, profile,
    )  # fmt: skip


def parameters_of(
    case: Case, state: Tracing, uncertainty: Uncertainty
) -> dict[str, Parameter]:
    """Base parameters and those of effects that the rig file declares."""
    out = {}
    for name, spec in parameter_specs(state.problem.model.rig).items():
        effect = name.split(".")[0] if "." in name else None
        if effect is None or effect in case.spec.effects:
            shown, p = parameter_of(name, case, state, uncertainty, spec)
            out[f"{effect}.{shown}" if effect else shown] = p
    return out


def named_effects(
    case: Case,
    state: Tracing,
    uncertainty: Uncertainty,
    errors: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]],
) -> tuple[FoundEffect, ...]:
    """The effects that were added, and what each did to the validation error.

    `errors` [3] are those before all of them and after, RMS, SI.
    """
    spec = parameter_specs(state.problem.model.rig)
    seen = [c for c in range(3) if np.isfinite(state.noise[c])]
    out = []
    # An effect counts up to where the next one came in, the last to the end:
    # the force is fitted only after the pressures have theirs.
    ends = [errors[0], *(a.before for a in state.added[1:]), errors[1]]
    for i, added in enumerate(state.added):
        own = [n for n in spec if n.startswith(f"{added.name}.")]
        out.append(
            FoundEffect(
                name=added.name,
                parameters=dict(
                    parameter_of(n, case, state, uncertainty, spec[n]) for n in own
                ),
                p_value=added.p_value,
                before={CHANNELS[c]: float(ends[i][c]) for c in seen},
                after={CHANNELS[c]: float(ends[i + 1][c]) for c in seen},
                cannot_tell_from=added.cannot_tell_from,
                residual_axis=EFFECTS[added.name].residual_axis,
            )
        )
    return tuple(out)
