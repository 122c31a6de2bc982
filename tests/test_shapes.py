"""Shapes of arrays in signatures, checked while a run, a fit and a sweep are made.

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
    "hydrojax.api",
    "hydrojax.control",
    "hydrojax.effects",
    "hydrojax.identify",
    "hydrojax.logs",
    "hydrojax.parameters",
    "hydrojax.plant",
    "hydrojax.rigfile",
    "hydrojax.tune",
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


@pytest.mark.slow
def test_a_run_a_fit_and_a_sweep_keep_the_shapes_of_their_signatures(cache_home):
    """One process does all three; its programs are kept between runs of the suite."""
    code = f"""
    import numpy as np
    import hydrojax as hj

    hj.set_up_jax({str(cache_home / "hydrojax")!r})
    rig = hj.paper.reference_rig()
    run = hj.simulate(
        rig, seconds=3.0, reference=hj.sine("200 N", "5 Hz"),
        motion=hj.to_and_fro("10 mm/s", "1 s"),
    )
    log = run.to_log()
    free = "[parameters]\\nbeta = {{ start = '8e8 Pa', range = ['4e8 Pa', '2e9 Pa'] }}"
    held = rig.text.replace('beta = "8.5e8 Pa"', "")
    found = hj.fit(
        hj.RigFile.from_text(held.replace("[parameters]", free)), [log], starts=1
    )
    swept = hj.sweep(rig, {{"k_p": np.array([1.0, 2.0])}})
    print(len(log.time), list(found.channels.index), swept["linear_within_1dB"].shape)
    """
    done = checked(code, *ROOMS)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() == "3000 ['P_a1', 'P_a2', 'F'] (2,)"


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
