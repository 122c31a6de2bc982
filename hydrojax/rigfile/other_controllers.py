"""Controllers that a rig file names in place of the paper's law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import tomlkit

from hydrojax.control.baselines import (
    BacksteppingController,
    LinearizingController,
    PIController,
)
from hydrojax.errors import check_known
from hydrojax.plant.rig import Rig
from hydrojax.rigfile.controller import (
    KIND,
    KINDS,
    LAWS,
    LOOP_KEYS,
    full_command,
    kind_of,
    with_gains,
)
from hydrojax.rigfile.schema import RigFile

OTHERS: Mapping[
    str, type[PIController | LinearizingController | BacksteppingController]
] = {
    "pi": PIController,
    "linearizing": LinearizingController,
    "backstepping": BacksteppingController,
}
"""Those that declare their own gains."""


def named_controller(
    spec: RigFile, nominal: Rig
) -> PIController | LinearizingController | BacksteppingController | None:
    """The controller that a rig file names, with its gains; None for the paper's law.

    Raises:
        InputError: an unknown controller or gain, or an invalid quantity.
    """
    kind = kind_of(spec)
    if kind in LAWS:
        return None
    law = OTHERS[kind].for_rig(nominal, spec.line, full_command(spec))
    own = {k: v for k, v in spec.controller.items() if k not in (KIND, *LOOP_KEYS)}
    return with_gains(law, own, spec, f"{spec.path}: [controller]")


def with_controller(spec: RigFile, kind: str) -> RigFile:
    """The rig file with a controller of this kind, at its first gains.

    What it says of the loop, its rate and the resolution, stays. A file that names this
    kind already is given back as it was, as is any file where `kind` is empty.

    Raises:
        InputError: an unknown controller.
    """
    if not kind:
        return spec
    check_known("controller:", [kind], KINDS, "controller")
    if spec.law is None and kind_of(spec) == kind:
        return spec
    document = tomlkit.parse(spec.text)
    table = document.setdefault("controller", tomlkit.table())
    same_gains = {kind, kind_of(spec)} <= set(LAWS)
    for key in list(table):
        if not same_gains and key not in LOOP_KEYS:
            del table[key]
    table[KIND] = kind
    return replace(spec.with_text(tomlkit.dumps(document)), law=None)
