"""A differentiable simulator of force-controlled hydraulic cylinders.

The names below are what a notebook needs; each is loaded when it is first used. In an
editor, or with `help(hydrojax.fit)`, every one of them says what it takes and gives.
"""

from importlib.metadata import PackageNotFoundError, version

import lazy_loader

try:
    __version__ = version("hydrojax")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
