"""What `import hydrojax` offers; `__init__.py` loads each name when it is used."""

from . import effects as effects
from . import export as export
from . import paper as paper
from .api import check as check
from .api import discover as discover
from .api import fit as fit
from .api import trace as trace
from .control.base import AbstractController as AbstractController
from .control.baselines import PIController as PIController
from .control.inputs import AbstractMotion as AbstractMotion
from .control.inputs import AbstractReference as AbstractReference
from .control.inputs import locked as locked
from .control.inputs import noise as noise
from .control.inputs import sine as sine
from .control.inputs import sines as sines
from .control.inputs import to_and_fro as to_and_fro
from .control.inputs import wander as wander
from .effects import effect as effect
from .effects import load_effects as load_effects
from .errors import InputError as InputError
from .identify.checking.check import Checked as Checked
from .identify.result import Result as Result
from .identify.tracing.criteria import Criteria as Criteria
from .jax_setup import set_up_jax as set_up_jax
from .logs.log import Log as Log
from .parameters import param as param
from .plant.rig import Rig as Rig
from .plant.valve import AbstractValve as AbstractValve
from .rigfile.schema import RigFile as RigFile
from .tune.aims import Limits as Limits
from .tune.api import sweep as sweep
from .tune.api import tune_gains as tune_gains
from .workflows.simulation import Simulation as Simulation
from .workflows.simulation import simulate as simulate

__version__: str
__all__: list[str]
