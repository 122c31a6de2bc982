"""Values that no rig has, and words for what was likely meant."""

from __future__ import annotations

import numpy as np
import pytest

import hydrojax as hj
from hydrojax.control.inputs import noise, sine
from hydrojax.errors import InputError

RIG = """
name = "rig"
layout = "pull-pull"
[geometry]
area = "{area}"
chamber_length = "0.2 m"
[parameters]
{line}
{more}
"""


def rig(line="", more="", area="1.18e-3 m^2"):
    return hj.RigFile.from_text(RIG.format(line=line, more=more, area=area))


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ('beta = "-1e8 Pa"', "'-1e8 Pa' is not above 0"),
        ('z_ss = "-60 um"', "'-60 um' is not above 0"),
        ('z_ss = "0 um"', "'0 um' is not above 0"),
        (
            'beta = "1 Pa"',
            "'1 Pa' is far from what rigs have (usually 1e+07 to 1e+10 Pa)",
        ),
        ('beta = { start = "8e8 Pa", range = ["-1e8 Pa", "3e9 Pa"] }', "goes below 0"),
    ],
)
def test_a_value_that_no_rig_has_is_refused(line, says):
    with pytest.raises(InputError) as error:
        rig(line)
    assert says in str(error.value)


@pytest.mark.parametrize("text", ["-1 ms", "1 h"])
def test_so_is_that_of_an_effect(text):
    with pytest.raises(InputError, match="not above 0|far from what rigs have"):
        rig(more=f'[effects.valve_delay]\ntau_u = "{text}"')


@pytest.mark.parametrize(
    ("share", "says"),
    [
        ('"2"', "'2' is above 1, which is all there can be of a share"),
        ('{ start = "0.5", range = ["0", "3"] }', r"goes above 1"),
        ('"1"', None),
    ],
)
def test_a_share_above_all_there_can_be_is_refused(share, says):
    more = f'[effects.viscous_friction]\nb = "300 N*s/m"\ns = {share}'
    if says is None:
        assert rig(more=more).effects["viscous_friction"]["s"].start == 1.0
    else:
        with pytest.raises(InputError, match=says):
            rig(more=more)


@pytest.mark.parametrize(
    "line",
    ['c_p1 = "1.2e-5 m^3/(s*V*Pa^0.5)"', 'z_ss = "0.03 m"', 'k_vn = "-2e3 N*s/m"'],
)
def test_a_machine_of_another_size_is_taken(line):
    """Beyond what is declared, and below 0 where that is declared."""
    assert rig(line).parameters


def test_a_number_with_a_comma_or_beyond_all_measure():
    with pytest.raises(InputError, match="has a comma in its number; write a point"):
        rig(area="1,18e-3 m^2")
    with pytest.raises(InputError, match="larger than anything measured"):
        rig(area="1e300 m^2")


def test_a_key_that_was_meant_for_the_column():
    with pytest.raises(InputError, match="unknown key 'colum'; did you mean 'column'"):
        rig(more='[channels]\nu = { colum = "x" }')


def test_gains_of_another_kind_of_controller():
    spec = rig(more='[controller]\nkind = "pi"\nkappa = "0.1 V"')
    with pytest.raises(InputError, match="kappa is of another kind of controller"):
        hj.check(spec, [{"time [s]": np.arange(100.0)}])


@pytest.mark.parametrize("given", [sine("300 N", "900 Hz"), noise("200 N", "500 Hz")])
def test_what_no_samples_can_show(given):
    with pytest.raises(InputError, match="less than half the sampling rate, 500 Hz"):
        given.force(100, 1e-3, np.random.default_rng(0))


# -- from Python --


def test_what_is_no_rig_and_no_log():
    with pytest.raises(InputError, match="3 is no dict of sections"):
        hj.RigFile.from_dict(3)
    with pytest.raises(InputError, match="named by its path, not by None"):
        hj.RigFile.load(None)
    with pytest.raises(InputError, match="a ndarray is not one; give a path"):
        hj.check(rig(), [np.zeros(3)])
    with pytest.raises(InputError, match="log: All arrays must be of the same length"):
        hj.check(rig(), [{"time [s]": [1.0], "u [V]": [1.0, 2.0]}])


def test_a_fit_begins_somewhere():
    with pytest.raises(InputError, match="starts 0"):
        hj.fit(rig(), [], starts=0)


def test_a_dict_of_columns_is_a_log():
    t = np.arange(1000) * 1e-3
    columns = {"time [s]": t, "u [V]": np.sin(t), "x [mm]": np.cos(t)}
    columns |= {f"{p} [bar]": 60 + np.sin(3 * t) for p in ("P_a1", "P_a2")}
    shown = hj.check(rig(), [columns]).logs_shown
    assert len(shown) == 1
