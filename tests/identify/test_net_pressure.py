"""A net pressure in place of two gauges and a load cell: it stands for the force."""

from __future__ import annotations

import json
import re

import pandas as pd
import pytest

import hydrojax as hj

FRICTION = r"(?m)^(k_c[pn]|k_0|k_v[pn]|k_f[pn]|z_ss|delta) = .*\n"


@pytest.mark.slow
def test_an_effect_is_found_from_a_net_pressure(recorded, tmp_path):
    """As docs/logs.md has it: a column in bar times the area, and no friction."""
    folder = recorded(1, {"internal_leakage": {}})
    text = re.sub(FRICTION, "", (folder / "rig.toml").read_text())
    text = re.sub(r"(?m)^P_a[12] = .*\n", "", text)
    text = re.sub(r'(?m)^F = ".*"\n', 'F = "15 N"\n', text)
    area = hj.RigFile.load(folder / "rig.toml").geometry["area"]
    net = (
        f'\n[channels]\nF = {{ column = "p_load", unit = "N", scale = {1e5 * area} }}\n'
    )
    (tmp_path / "rig.toml").write_text(text + net)
    logs = []
    for name in ("fit_1", "fit_2", "validate"):
        log = pd.read_csv(folder / f"{name}.csv")
        gauges = {n.partition(" ")[0]: n for n in log if n.startswith(("P_a", "F"))}
        assert gauges["P_a1"].endswith("[bar]")
        log["p_load"] = log[gauges["P_a2"]] - log[gauges["P_a1"]]
        log = log.drop(columns=[n for n in log if n in gauges.values()])
        log.to_csv(tmp_path / f"{name}.csv", index=False)
        logs.append(tmp_path / f"{name}.csv")
    found = hj.trace(tmp_path / "rig.toml", logs[:2], validate=logs[2:])
    truth = json.loads((folder / "truth.json").read_text())["effects"]
    assert [e.name for e in found.effects] == ["internal_leakage"]
    assert found.verdict == "explained" and list(found.channels.index) == ["F"]
    value = found.effects[0].parameters["c_il"].value
    assert value == pytest.approx(truth["internal_leakage"]["c_il"], rel=0.05)
