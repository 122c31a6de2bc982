"""Setting JAX up: the one place that touches global configuration, on request."""

from __future__ import annotations

import os
import sys
from pathlib import Path

FUSION = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion=true"
"""Keeps XLA's CPU compiler from computing a scan's body once per output: the Jacobian
of a replay took six times as long without it. It is not documented by XLA, and
ignored by versions that do not know it."""


def set_up_jax(cache: Path | None = None) -> bool:
    """Double precision, the CPU setting that replays want, and a cache of programs.

    Call it before anything else uses JAX. The command line does.

    Args:
        cache: folder for compiled programs; None keeps none.

    Returns:
        False if JAX was running already: then the CPU setting came too late, and all
        else holds.
    """
    early = "jax" not in sys.modules or not _running()
    flags = os.environ.get("XLA_FLAGS", "")
    if early and "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {FUSION}".strip()
    import jax

    jax.config.update("jax_enable_x64", True)
    if cache is not None:
        jax.config.update("jax_compilation_cache_dir", str(cache))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
    return early


def _running() -> bool:
    from jax._src import xla_bridge

    return xla_bridge.backends_are_initialized()


def user_cache() -> Path:
    """Where this user's compiled programs are kept between runs."""
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "hydrojax"
