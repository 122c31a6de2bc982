"""The section [valve]: what each kind is of the plant, refused and rewritten."""

import json

import jax.numpy as jnp
import numpy as np
import pytest
from jsonschema import Draft202012Validator

from hydrojax.errors import InputError
from hydrojax.plant.chambers import Point
from hydrojax.plant.valve import MeteringEdges
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.edit import rewrite
from hydrojax.rigfile.json_schema import rig_schema
from hydrojax.rigfile.schema import RigFile

RIG = """
layout = "differential"

[geometry]
area_1 = "50 cm^2"
area_2 = "34 cm^2"
chamber_length = "0.59 m"

[parameters]
c_p1 = "2e-7 m^3/(s*Pa^0.5)"
"""
TABLE = 'kind = "table"\ncommand = [-1, -0.1, 0.2, 0.5, 1]\n'
OPENING = "opening = [-0.9, 0, 0, 0.25, 1]\n"


def rig_of(valve, text=RIG):
    return RigFile.from_text(f"{text}\n[valve]\n{valve}")


def flow(rig, u, P_1=4e6):
    """Into chamber 1, m^3/s."""
    at = Point(*map(jnp.asarray, (P_1, 5e6, 14e6, 2e5)), (jnp.asarray(u),), 0.0, 0.0)
    return float(rig.flows(at)[0][0])


def opened(rig, u):
    """The spool's opening after a tick under a command."""
    memory = rig.command_init(jnp.asarray(u))
    out = rig.command_step(memory, jnp.asarray(u), jnp.asarray(1e-3))[1]
    return sum(np.array(out) * np.array([1, -1][: len(out)]))


def test_orifices_are_what_there_is_without_the_section():
    assert build_rig(rig_of('kind = "orifice"\n')).command == ()
    one, other = map(build_rig, (rig_of('kind = "orifice"'), RigFile.from_text(RIG)))
    assert flow(one, 0.3) == flow(other, 0.3) == pytest.approx(0.3 * 2e-7 * 1e7**0.5)


def test_behind_a_compensator_the_flow_does_not_know_the_load():
    rig = build_rig(rig_of('kind = "compensated"\nmargin = "9 bar"\n'))
    want = 0.3 * 2e-7 * 9e5**0.5
    assert [flow(rig, 0.3, P) for P in (1e6, 8e6)] == pytest.approx(
        [want] * 2, rel=1e-5
    )
    assert flow(rig, 0.3, 13.7e6) == pytest.approx(0.3 * 2e-7 * 3e5**0.5, rel=1e-4)


def test_a_table_opens_as_interpolation_does():
    rig = build_rig(rig_of(TABLE + OPENING))
    for u in (-1.5, -1, -0.6, -0.1, -0.03, 0, 0.2, 0.21, 0.4, 0.5, 0.77, 1, 2):
        want = np.interp(u, [-1, -0.1, 0.2, 0.5, 1], [-0.9, 0, 0, 0.25, 1])
        assert opened(rig, u) == pytest.approx(want, abs=1e-12), u


def test_a_table_stands_behind_the_spool():
    text = RIG + '[effects.valve_lag]\nomega = "30 rad/s"\nzeta = "0.8"\n'
    rig = build_rig(rig_of(TABLE + OPENING, text))
    assert [c.name for c in rig.command] == ["valve_lag", "flow_table"]


def test_commands_in_volts():
    table = (
        'kind = "table"\ncommand = ["-10 V", "10 V"]\nopening = ["-8 V", "8000 mV"]\n'
    )
    file = rig_of(table, RIG.replace("m^3/(s*Pa^0.5)", "m^3/(s*Pa^0.5*V)"))
    assert file.command_unit == "V" and file.table == ((-10, 10), (-8, 8))
    assert opened(build_rig(file), 5.0) == pytest.approx(4.0)


def test_a_dict_has_numbers():
    tree = {
        "layout": "differential",
        "geometry": {"area_1": 5e-3, "area_2": 3.4e-3, "chamber_length": 0.59},
        "valve": {"kind": "compensated", "margin": 9e5},
    }
    own = RigFile.from_dict(tree).effects["pressure_compensation"]
    assert own["dP_0"].start == 9e5 and own["s"].start == 1.0


COMPENSATED, ROWS = 'kind = "compensated"\n', 'kind = "table"\ncommand = '


@pytest.mark.parametrize(
    ("valve", "says"),
    [
        ('kind = "spool"', "[valve] kind 'spool' is unknown; write one of ('orifice'"),
        ('margin = "9 bar"', "[valve] kind is missing"),
        ('kind = "orifice"\nmargin = "9 bar"', "[valve] unknown key 'margin'"),
        (COMPENSATED + 'margin = "9 m"', "[valve] margin: unit 'm' does not fit"),
        (COMPENSATED + 'margin = {start = "9 bar"}', "[valve] margin needs a start"),
        (TABLE, "[valve] opening is missing"),
        (TABLE + "opening = [0, 1]", "command has 5 rows and opening 2"),
        (TABLE + "opening = 3", "opening: invalid 3: expected a list of 2 to 64"),
        (
            TABLE + "opening = [-1, 0, 0, 1, 0.5]",
            "row 5 is not at least the one before",
        ),
        (TABLE + "opening = [-1, 0.1, 0.2, 0.3, 1]", "row 2: 0.1 at a command of -0.1"),
        (TABLE + "opening = [-1, 0, 0, 1, nan]", "[valve] opening row 5"),
        (ROWS + "[0, 0]\nopening = [0, 1]", "command row 2 is not above"),
        (ROWS + '["0 V"]\nopening = [0]', "expected a list of 2 to 64"),
        (ROWS + '["0 V", "1 V"]\nopening = [0, 1]', "unit 'V' does not fit"),
    ],
)
def test_what_is_refused(valve, says):
    with pytest.raises(InputError) as error:
        rig_of(valve)
    assert says in str(error.value) and "\n" not in str(error.value)


def test_what_is_said_twice_is_refused():
    text = RIG + '[effects.pressure_compensation]\ns = "1"\n'
    with pytest.raises(InputError, match="say the same twice"):
        rig_of('kind = "compensated"\n', text)
    with pytest.raises(InputError, match="layout 'tester' has no valve"):
        rig_of('kind = "orifice"\n', 'layout = "tester"\n')


def test_a_valve_of_ones_own_has_no_such_section():
    with pytest.raises(InputError, match=r"\[valve\] is of metering edges, not of Met"):
        RigFile.from_text(
            RIG + '[valve]\nkind = "compensated"\n', valve=MeteringEdges()
        )


@pytest.mark.parametrize(
    ("margin", "written"),
    [
        ('margin = { start = "9 bar", range = ["2 bar", "20 bar"] }\n', 8.5e5),
        ("", 8.5e5),
    ],
)
def test_a_margin_that_was_found_is_written_where_it_stood(margin, written):
    file = rig_of('# the data sheet says 9 bar\nkind = "compensated"\n' + margin)
    text = rewrite(file, {"pressure_compensation.dP_0": written})
    again = RigFile.from_text(text)
    assert again.effects["pressure_compensation"]["dP_0"].start == written
    assert "# the data sheet" in text and "[effects" not in text
    assert rewrite(file, {}) == file.text


def test_the_schema_knows_the_section():
    check = Draft202012Validator(json.loads(json.dumps(rig_schema())))
    tree = {"layout": "differential", "valve": {"kind": "table", "command": [0, 1]}}
    assert check.is_valid(tree)
    assert not check.is_valid(tree | {"valve": {"kind": "spool"}})
    assert not check.is_valid(tree | {"valve": {"kind": "table", "rows": [0, 1]}})
    assert not check.is_valid(tree | {"valve": {"command": ["0 V"]}})
