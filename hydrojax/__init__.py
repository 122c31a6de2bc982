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

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_OF_ARRAYS = frozenset(
    (
        "AbstractController",
        "AbstractValve",
        "PIController",
        "Rig",
        "effect",
        "effects",
        "param",
    )
)
"""Names whose objects hold arrays as soon as they are made."""


def __getattr__(name: str) -> object:
    if name in _OF_ARRAYS:
        from hydrojax.jax_setup import set_up_unless_running

        set_up_unless_running()  # or their arrays would be of single precision
    return _load(name)
