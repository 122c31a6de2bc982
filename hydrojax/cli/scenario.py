"""References and motions as the command line writes them: `sine:300 N,0.5 Hz`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from typing import TypeVar

from hydrojax import units
from hydrojax.control import inputs
from hydrojax.control.inputs import AbstractMotion, AbstractReference
from hydrojax.errors import InputError
from hydrojax.logs.log import Log
from hydrojax.logs.tables import TABLES
from hydrojax.rigfile.scenarios import LoggedForce, LoggedMotion
from hydrojax.rigfile.schema import RigFile

Made = TypeVar("Made")
_Defaults = tuple[tuple[str, float], ...]
_Kinds = Mapping[str, tuple[Callable[..., Made], _Defaults]]

REFERENCES: _Kinds[AbstractReference] = {
    "sines": (inputs.sines, (("N", 400.0),)),
    "sine": (inputs.sine, (("N", 300.0), ("Hz", 0.5))),
    "noise": (inputs.noise, (("N", 200.0), ("Hz", 50.0))),
}
"""Desired forces by kind: what makes them, and its arguments' units and defaults."""

MOTIONS: _Kinds[AbstractMotion] = {
    "wander": (inputs.wander, (("m/s", 0.025),)),
    "to-and-fro": (inputs.to_and_fro, (("m/s", 0.03), ("s", 3.0))),
    "locked": (inputs.locked, (("m", 0.0),)),
}
"""Motions by kind: what makes them, and its arguments' units and defaults."""


def read_inputs(
    spec: RigFile, reference: str = "sines", motion: str = "wander"
) -> tuple[AbstractReference, AbstractMotion]:
    """Reference and motion: `kind`, `kind:quantity,quantity`, or a log's path.

    Args:
        spec: the rig, for its logs' channels.
        reference: one of `REFERENCES`, such as `sine:300 N,0.5 Hz`; or a log with F_d.
        motion: one of `MOTIONS`, such as `to-and-fro:3 cm/s,3 s`; or a log.

    Raises:
        InputError: an unknown kind, an invalid quantity, or an invalid log.
    """
    force_log = _log(reference, REFERENCES, spec)
    path_log = force_log if motion == reference else _log(motion, MOTIONS, spec)
    if force_log is not None:
        force: AbstractReference = LoggedForce(force_log)
    else:
        force = _made(reference, REFERENCES, "--reference")
    if path_log is not None:
        return force, LoggedMotion(path_log, spec)
    return force, _made(motion, MOTIONS, "--motion")


def _log(word: str, kinds: Mapping[str, object], spec: RigFile) -> Log | None:
    """The log that a word names, if it names one."""
    if word.partition(":")[0] in kinds:
        return None
    if word.lower().endswith((*TABLES, ".mcap")) or os.path.exists(word):
        return Log.load(word, spec.channels)
    near = get_close_matches(word.partition(":")[0], kinds, n=1, cutoff=0.5)
    mend = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(kinds)}"
    raise InputError(f"{word!r} is neither a log's path nor a kind; {mend}")


def _made(text: str, kinds: _Kinds[Made], option: str) -> Made:
    """What `kind:quantity,…` says."""
    kind, _, rest = text.partition(":")
    given = [part for part in rest.split(",") if part.strip()]
    make, wants = kinds[kind]
    if len(given) > len(wants):
        example = ",".join(f"{value:g} {unit}" for unit, value in wants)
        raise InputError(f"{option} {text!r}: too many values; write {kind}:{example}")
    values = [value for _, value in wants]
    for i, (word, (unit, _)) in enumerate(zip(given, wants, strict=False)):
        values[i] = units.quantity(word, unit, f"{option} {kind}")
        if make is not inputs.locked and values[i] <= 0:
            raise InputError(f"{option} {kind}: {word!r} must be above 0")
    return make(*values)
