"""Shapes of arrays in signatures, checked while a closed loop runs.

jaxtyping's import hook checks every annotated call of the named rooms, and every field
of their classes, against values of the product's own making (most tests pass NumPy
numbers where JAX arrays are declared, so that the hook cannot be on for them).
"""

import subprocess
import sys
import textwrap

import pytest

pytest.importorskip("beartype", reason="beartype is not installed: [test]")

ROOMS = (
    "hydrojax.control",
    "hydrojax.effects",
    "hydrojax.logs",
    "hydrojax.parameters",
    "hydrojax.plant",
    "hydrojax.rigfile",
    "hydrojax.workflows.simulation",
)


def checked(code: str, *rooms: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter that runs `code` with the hook on."""
    head = f"""
from jaxtyping import install_import_hook
install_import_hook({list(rooms)!r}, "beartype.beartype")
"""
    return subprocess.run(
        [sys.executable, "-c", head + textwrap.dedent(code)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_a_closed_loop_keeps_the_shapes_of_its_signatures():
    code = """
    import hydrojax as hj

    run = hj.simulate(
        hj.paper.reference_rig(), seconds=0.6, reference=hj.sine("100 N", "5 Hz"),
        motion=hj.to_and_fro("10 mm/s", "1 s"),
    )
    print(len(run.to_log().time))
    """
    done = checked(code, *ROOMS)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() == "600"


def test_the_hook_sees_a_wrong_shape():
    code = """
    import jax.numpy as jnp
    from hydrojax.plant.layout import LAYOUTS
    from hydrojax.plant.rig import bare_rig

    rig = bare_rig(LAYOUTS["pull-pull"], {"area": 1e-3, "chamber_length": 0.2})
    rig.drive_force(jnp.ones(3), jnp.ones(4))
    """
    done = checked(code, "hydrojax.plant")
    assert done.returncode == 1 and "TypeCheckError" in done.stderr
