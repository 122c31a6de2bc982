"""What `hydrojax.paper` offers; `__init__.py` loads each name when it is used."""

from .experiments import FIGURES as FIGURES
from .experiments import response as response
from .experiments import tracking as tracking
from .experiments import within as within
from .figures import response_figure as response_figure
from .figures import tracking_figure as tracking_figure
from .records import Response as Response
from .records import Track as Track
from .records import reference_rig as reference_rig

__all__: list[str]
