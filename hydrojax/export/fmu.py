"""The plant as a functional mock-up unit for co-simulation: C, and no Python in it.

The plant's step and its derivative along a direction become C as for `--to c`; the
interfaces of FMI 2.0 and 3.0 over it are `fmi/*.jinja`.
"""

from __future__ import annotations

import io
import platform
import sys
import uuid
import zipfile
from collections.abc import Mapping
from typing import Any, NamedTuple

from hydrojax import __version__
from hydrojax.effects.valve import ValveDelay
from hydrojax.export.codegen.compiler import shared_library
from hydrojax.export.codegen.emit import literal
from hydrojax.export.codegen.machine import Code, code_of, identifiers
from hydrojax.export.firmware import text_of_code
from hydrojax.export.machines import ALONG, plant_machine, tangent_machine
from hydrojax.export.model import DrivenRig, driven_rig
from hydrojax.export.template import fill
from hydrojax.export.tree import identifier
from hydrojax.rigfile.schema import RigFile

STARTS = {"P_a1": "P_a1_start", "P_a2": "P_a2_start"}
"""What the plant's inputs at the start are called as parameters."""

MADE = (1980, 1, 1, 0, 0, 0)
"""The time of every file in the archive: the same rig gives the same bytes."""


class Variable(NamedTuple):
    """A variable of the unit.

    `at` is its place in C, `along` and `follows` its place in what the derivative is
    given and gives, empty where it has none; `number` what its reference is.
    """

    name: str
    number: int
    kind: str
    changes: str
    says: str
    at: str
    along: str
    follows: str
    start: str


class _Interface(NamedTuple):
    """What one version of the FMI differs in."""

    template: str
    platform: str
    functions: tuple[str, ...]
    """Those that the unit has no use for."""


def _each(prefix: str, kinds: str) -> tuple[str, ...]:
    names = (f"{way}{kind}" for kind in kinds.split() for way in ("Get", "Set"))
    return tuple(prefix + name for name in names)


_SYSTEM = {"linux": "linux", "darwin": "darwin", "win32": "win"}.get(
    sys.platform, sys.platform
)
_MACHINE = {"amd64": "x86_64", "arm64": "aarch64"}.get(
    platform.machine().lower(), platform.machine().lower()
)
_SUFFIX = {"darwin": ".dylib", "win": ".dll"}.get(_SYSTEM, ".so")

_FMI2 = _Interface(
    "fmi2",
    f"{_SYSTEM}64",
    _each("fmi2", "Integer Boolean String")
    + (
        "fmi2SetRealInputDerivatives", "fmi2GetRealOutputDerivatives",
        "fmi2CancelStep", "fmi2GetStatus", "fmi2GetRealStatus",
        "fmi2GetIntegerStatus", "fmi2GetBooleanStatus", "fmi2GetStringStatus",
    ),
)  # fmt: skip
_FMI3 = _Interface(
    "fmi3",
    f"{_MACHINE}-{ {'win': 'windows'}.get(_SYSTEM, _SYSTEM) }".replace(" ", ""),
    _each(
        "fmi3",
        "Float32 Int8 UInt8 Int16 UInt16 Int32 UInt32 Int64 UInt64 Boolean String "
        "Binary Clock IntervalDecimal IntervalFraction ShiftDecimal ShiftFraction "
        "ContinuousStates",
    )
    + (
        "fmi3EnterEventMode", "fmi3EnterStepMode", "fmi3EnterConfigurationMode",
        "fmi3ExitConfigurationMode", "fmi3GetNumberOfVariableDependencies",
        "fmi3GetVariableDependencies", "fmi3GetAdjointDerivative",
        "fmi3EvaluateDiscreteStates", "fmi3UpdateDiscreteStates",
        "fmi3EnterContinuousTimeMode", "fmi3CompletedIntegratorStep", "fmi3SetTime",
        "fmi3GetContinuousStateDerivatives", "fmi3GetEventIndicators",
        "fmi3GetNominalsOfContinuousStates", "fmi3GetNumberOfEventIndicators",
        "fmi3GetNumberOfContinuousStates", "fmi3GetOutputDerivatives",
        "fmi3ActivateModelPartition",
    ),
)  # fmt: skip


def fmu_of(spec: RigFile) -> dict[str, bytes]:
    """A rig as FMUs of FMI 2.0 and 3.0, by file name.

    Each holds a binary for this machine and the sources for any other.

    Raises:
        InputError: there is no C compiler, the rig cannot be run, or an effect uses an
            operation that has no form in C.
    """
    model = driven_rig(spec)
    machine = plant_machine(model)
    code, along = code_of(machine), code_of(tangent_machine(machine))
    sources = text_of_code("plant", "The plant", "", spec.name, code)
    sources |= text_of_code(
        "tangent", "The plant along a direction", "", spec.name, along
    )
    token = uuid.uuid5(uuid.NAMESPACE_OID, "".join(sources.values()))
    names = list(machine.parameters)
    called = dict(zip(identifiers(names), names, strict=True))
    delays = [c for c in model.rig.command if isinstance(c, ValveDelay)]
    fields = {n: field for field, n in called.items()}
    known = {
        "name": identifier(spec.name),
        "rig": spec.name,
        "version": __version__,
        "token": f"{{{token}}}",
        "period": literal(model.period),
        "counts_ticks": model.counts_ticks,
        "delay": fields["valve_delay.tau_u"] if delays else "",
        "held_ticks": delays[0].queue - 1 if delays else 0,
        "variables": _variables(model, code, along, called),
        "tangent_parameters": [f.name for f in along.parameters],
        "primal": [f.name for f in code.inputs],
    }
    name = identifier(spec.name)
    return {
        f"{name}.fmu": _archive(_FMI2, known, sources),
        f"{name}_fmi3.fmu": _archive(_FMI3, known, sources),
    }


def _archive(
    interface: _Interface, known: Mapping[str, Any], sources: dict[str, str]
) -> bytes:
    folder, name = f"fmi/{interface.template}", known["name"]
    texts = sources | {
        "unit.h": fill("fmi/unit.h.jinja", **known),
        f"{interface.template}.c": fill(
            f"{folder}.c.jinja", **known, without=interface.functions
        ),
    }
    files = [file for file in texts if file.endswith(".c")]
    binary = shared_library(texts, wanted_by="--to fmu")
    content: dict[str, str | bytes] = {
        "modelDescription.xml": fill(f"{folder}.xml.jinja", **known, sources=files),
        f"binaries/{interface.platform}/{name}{_SUFFIX}": binary,
        "sources/buildDescription.xml": fill(
            "fmi/build.xml.jinja", **known, sources=files
        ),
        **{f"sources/{file}": text for file, text in texts.items()},
    }
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in content.items():
            info = zipfile.ZipInfo(path, MADE)
            info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
            archive.writestr(info, data)
    return out.getvalue()


def _variables(
    model: DrivenRig, code: Code, along: Code, called: Mapping[str, str]
) -> list[Variable]:
    """In the order of the description: inputs, parameters, starts, outputs."""
    directions = {f.name for f in along.inputs}
    ends = {f.name for f in along.outputs}
    rows: list[tuple[str, str, str, str, str, float]] = [
        (f.name, "input", "continuous", "input", f.says, float(f.start))
        for f in code.inputs
        if f.name in model.inputs
    ]
    rows += [
        (called[f.name], "parameter", "tunable", "parameters", f.says, float(f.start))
        for f in code.parameters
        if called[f.name] in model.parameters
    ]
    rows += [
        (
            STARTS[f.name],
            "parameter",
            "fixed",
            "input",
            f.says,
            model.rest[STARTS[f.name]],
        )
        for f in code.inputs
        if STARTS.get(f.name) in model.starts
    ]
    rows += [
        (f.name, "output", "continuous", "output", f.says, 0.0) for f in code.outputs
    ]
    plain = {v: k for k, v in (STARTS | {c: n for c, n in called.items()}).items()}
    out = []
    for i, (name, kind, changes, where, says, start) in enumerate(rows, 1):
        field = plain.get(name, name) if kind == "parameter" else name
        direction = ALONG + field
        out.append(
            Variable(
                name, i, kind, changes, says, f"{where}.{field}",
                direction if kind != "output" and direction in directions else "",
                direction if kind == "output" and direction in ends else "",
                literal(start).strip("()"),
            )
        )  # fmt: skip
    return out
