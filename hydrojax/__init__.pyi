"""What `import hydrojax` offers; `__init__.py` loads each name when it is used."""

from .api import fit as fit
from .api import trace as trace
from .control.simulation import simulate as simulate
from .effects import effect as effect
from .errors import InputError as InputError
from .identify.result import Result as Result
from .identify.tracing.criteria import Criteria as Criteria
from .jax_setup import set_up_jax as set_up_jax
from .logs.log import Log as Log
from .plant.valve import AbstractValve as AbstractValve
from .rigfile.schema import RigFile as RigFile
from .tune.api import sweep as sweep
from .tune.api import tune_gains as tune_gains
from .tune.objective import Limits as Limits

__version__: str
