"""The loop of exported C: it is the closed loop, and its times are read rightly."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hardware.__main__ import RATES, Latency, build, lines, measure
from tests.export.c_code import compiler


def test_the_loop_follows_at_both_rates(tmp_path):
    """The paper's rig at 250 N and 26 mm/s; without control it would miss by all."""
    compiler()
    reference = resources.files("hydrojax") / "paper" / "reference.toml"
    program = build(Path(str(reference)), tmp_path)
    for rate in RATES:
        found = measure(program, rate, round(3 * rate), paced=False)
        assert found.periods.shape == (round(3 * rate), 3)
        assert 100 < found.asked < 180
        assert found.error < 0.2 * found.asked
        assert np.all(found.periods[:, 0] >= found.periods[:, 1:].sum(axis=1) - 1)
    paced = measure(program, 1e4, 100, paced=True)
    assert np.all(paced.periods[:, 0] >= paced.periods[:, 1:].sum(axis=1) - 1)


def test_percentiles_and_late_periods_are_those_of_the_times():
    times = np.tile(np.array([[3e3, 1e3, 2e3]]), (10_000, 1))
    times[:2, 0] = 2e6
    said = lines(Latency(times, 12.3, 100.0), 1000.0, False)
    assert "12.3 N RMS, 2 periods too long" in said[0]
    assert said[2].split() == ["period", "3.00", "3.00", "2000.00", "2000.00"]
    assert float(said[3].split()[1]) == pytest.approx(1.0)
    counts = [int(line.split(" us ")[1].split()[0]) for line in said[5:]]
    assert counts == [0, 9998, 0, 0, 2, 0]
