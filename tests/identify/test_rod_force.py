"""What says how far rod and play give where no force is logged."""

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from hydrojax.identify.api import applicable
from hydrojax.identify.case import Case, open_case, read
from hydrojax.rigfile.schema import RigFile

GIVES = {"rod_compliance", "backlash"}


def opened(spec: RigFile, *left_out: str) -> tuple[Case, np.ndarray, np.ndarray]:
    """The demo's case without some signals, its rod force, and the one it logged, N."""
    log = read(resources.files("hydrojax") / "demo" / "fit_1.csv.gz", spec)
    signals = {n: y for n, y in log.signals.items() if n not in left_out}
    case = open_case(spec, [replace(log, signals=signals)])
    used = np.asarray(case.fit.motion.F)[0]
    return case, used, log.signals["F"][: used.size]


@pytest.fixture(scope="module")
def spec() -> RigFile:
    return RigFile.load(resources.files("hydrojax") / "demo" / "rig.toml")


def test_the_pressures_push_with_the_force_but_for_friction(spec):
    case, used, logged = opened(spec, "F")
    assert set(applicable(case)) >= GIVES
    P_1, P_2 = (case.fit_logs[0].signals[n][: used.size] for n in ("P_a1", "P_a2"))
    pushed = spec.geometry["area"] * (P_2 - P_1)
    assert np.sqrt(np.mean((used - pushed) ** 2)) < 0.02 * np.std(pushed)
    # Friction holds against the motion: what pushes is more where the piston goes on.
    way = np.sign(np.asarray(case.fit.motion.v)[0])
    assert (
        np.mean((used - logged)[way > 0])
        > 100
        > -100
        > np.mean((used - logged)[way < 0])
    )


def test_a_logged_force_is_taken_as_it_is(spec):
    case, used, logged = opened(spec)
    assert set(applicable(case)) >= GIVES
    assert np.sqrt(np.mean((used - logged) ** 2)) < 0.05 * np.std(logged)


def test_without_a_pressure_nothing_says_it(spec):
    case, used, _ = opened(spec, "F", "P_a2")
    assert not GIVES & set(applicable(case))
    assert not used.any()
