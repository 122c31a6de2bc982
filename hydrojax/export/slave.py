"""The plant behind the FMI: what an importing tool reads, and what it may do.

It runs inside an FMU, in the Python of the importing tool, and reads the rig from the
FMU's own resources. `hydrojax.export.fmu` mixes it with the slave of PythonFMU.
"""

from __future__ import annotations

import json
import uuid
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from hydrojax import effects
from hydrojax.errors import InputError
from hydrojax.export.model import SteppedRig
from hydrojax.jax_setup import set_up_jax
from hydrojax.rigfile.schema import RigFile

RIG, EFFECTS = "rig.toml", "effects.json"
"""Names of the resources: the rig file, and which of its effects are in which file."""

HELD: list[dict[str, Any]] = []
"""The script's globals, once for each time it was run. PythonFMU 0.7 runs it for every
instance, and each time gives up a reference to them that it never took: without these
the second instance finds nothing there, or the interpreter crashes."""


Slave: Any = object
"""In the place of PythonFMU's slave, which the FMU's script adds (`fmu.SCRIPT`)."""


class Plant(Slave):
    """A rig as an FMI 2.0 slave; to be mixed with `pythonfmu.Fmi2Slave`."""

    def __init__(self, **kwargs: Any) -> None:
        """Read the rig from the resources and declare its variables."""
        super().__init__(**kwargs)
        set_up_jax()
        folder = Path(self.resources)
        self.model = load(folder)
        self.modelName = self.model.identifier
        self.description = f"hydraulic cylinder: {self.model.spec.name}"
        # Not the default: that would hold the exporting machine's network address.
        content = (folder / RIG).read_text(encoding="utf-8")
        self.guid = uuid.uuid5(uuid.NAMESPACE_OID, content)
        self._declare()

    def _declare(self) -> None:
        from pythonfmu.default_experiment import DefaultExperiment
        from pythonfmu.enums import Fmi2Causality, Fmi2Variability
        from pythonfmu.variables import Real

        m = self.model
        self.default_experiment = DefaultExperiment(
            start_time=0.0, stop_time=10.0, step_size=m.period
        )
        kinds = (
            ("input", "continuous", m.inputs, m.drive),
            ("parameter", "tunable", m.parameters, m.values),
            ("parameter", "fixed", m.starts, m.rest),
            ("output", "continuous", m.outputs, m.read),
        )
        for causality, variability, names, store in kinds:
            for name, (unit, description) in names.items():
                variable = Real(
                    name,
                    causality=Fmi2Causality[causality],
                    variability=Fmi2Variability[variability],
                    description=f"{description} [{unit}]",
                    getter=lambda store=store, name=name: store[name],
                    setter=lambda v, store=store, name=name: store.update({name: v}),
                )
                self.register_variable(variable, nested=False)

    def to_xml(self, *args: Any) -> Element:
        """The model description, with what this rig cannot do in it."""
        root = super().to_xml(*args)
        if self.model.queue:
            simulation = root.find("CoSimulation")
            simulation.set("canHandleVariableCommunicationStepSize", "false")
        structure = root.find("ModelStructure")
        unknowns = SubElement(structure, "InitialUnknowns")
        for unknown in structure.findall("Outputs/Unknown"):
            SubElement(unknowns, "Unknown", dict(unknown.attrib))
        return root

    def exit_initialization_mode(self) -> None:
        """At rest at the position and pressures that were set."""
        self.model.begin()

    def do_step(self, current_time: float, step_size: float) -> bool:
        """One communication step; False, and a line in the log, where it cannot be."""
        from pythonfmu.enums import Fmi2Status

        try:
            self.model.step(current_time, step_size)
        except InputError as error:
            self.log(str(error), Fmi2Status.error)
            return False
        return True


def load(folder: Path) -> SteppedRig:
    """The model whose rig lies in `folder`, with the effects that came along."""
    files = json.loads((folder / EFFECTS).read_text(encoding="utf-8"))
    for file, names in files.items():
        if not set(names) <= set(effects.EFFECTS):
            effects.load_effects(folder / file)
    return SteppedRig(RigFile.load(folder / RIG))
