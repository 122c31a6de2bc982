"""A differentiable simulator of force-controlled hydraulic cylinders."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("hydrojax")
except PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0"
