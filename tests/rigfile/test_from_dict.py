"""Rig files from dicts: the same values as from TOML, however they are written."""

import pint
import pytest

from hydrojax.errors import InputError
from hydrojax.rigfile.schema import RigFile

PLAIN = {
    "name": "a rig",
    "layout": "pull-pull",
    "geometry": {"area": "11.8 cm^2", "chamber_length": 0.2, "radius": "85 mm"},
    "supply": {"P_s": 14e6},
    "sensors": {"F": 2.5, "u": "1 mV"},
    "load": {"mass": 150, "stiffness": "1 kN/mm"},
    "channels": {"u": {"column": "MainU", "invert": True}},
    "parameters": {
        "beta": {"start": 8e8, "range": ["1e8 Pa", 3e9]},
        "c_p1": 2e-9,
        "k_fp": 0.5,
    },
    "effects": {"valve_lag": {"omega": 900.0, "zeta": 0.7}},
    "controller": {"k_p": 1.5, "k_cp": ["200 N", 1.5]},
}


def test_numbers_are_in_the_declared_unit():
    file = RigFile.from_dict(PLAIN)
    assert file.name == "a rig" and file.command_unit == "V"
    assert file.geometry["area"] == pytest.approx(1.18e-3)
    assert file.geometry["chamber_length"] == 0.2
    assert file.parameters["beta"].range == (1e8, 3e9)
    assert file.parameters["c_p1"].start == 2e-9
    assert file.parameters["k_fp"].start == 0.5
    assert file.effects["valve_lag"]["tau"].start == pytest.approx(1 / 900)
    assert file.output_load == {"mass": 150.0, "stiffness": 1e6}
    assert file.channels["u"].invert and file.sensors["u"] == 1e-3
    assert file.controller == {"k_p": 1.5, "k_cp": ["200 N", 1.5]}


def test_pint_quantities(tmp_path):
    u = pint.UnitRegistry()
    tree = PLAIN | {
        "geometry": {"area": 11.8 * u.cm**2, "chamber_length": 200 * u.mm},
        "parameters": {"beta": 0.8 * u.GPa, "z_ss": 60 * u.um},
    }
    file = RigFile.from_dict(tree)
    assert file.geometry["area"] == pytest.approx(1.18e-3)
    assert file.parameters["beta"].start == pytest.approx(8e8)
    assert file.parameters["z_ss"].start == pytest.approx(60e-6)
    file.save(tmp_path / "rig.toml")
    again = RigFile.load(tmp_path / "rig.toml")
    assert (again.geometry, again.parameters) == (file.geometry, file.parameters)


def test_errors_name_the_key():
    wrong = {"betta": 8e8}
    with pytest.raises(InputError, match=r"\[parameters\] unknown parameter 'betta'"):
        RigFile.from_dict(PLAIN | {"parameters": wrong})
    with pytest.raises(InputError, match=r"mine: \[geometry\] area: unit 'kg'"):
        RigFile.from_dict(PLAIN | {"geometry": {"area": "1 kg"}}, "mine")
    with pytest.raises(InputError, match=r"\[geometri\]|'geometri'"):
        RigFile.from_dict(PLAIN | {"geometri": {}})
