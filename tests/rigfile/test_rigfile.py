"""Rig files: what is read, and every kind of bad input."""

from __future__ import annotations

from pathlib import Path

import pytest

from hydrojax.errors import InputError
from hydrojax.parameters import Spec, parameter_specs, specs
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.edit import rewrite
from hydrojax.rigfile.schema import RigFile, read_rig
from hydrojax.rigfile.sections import Entry


def spec(unit: str, **more) -> Spec:
    return Spec(unit, 1.0, -1e12, 1e12, "for the test", **more)


FLOW = "m^3/(s*{u}*Pa^0.5)"
PARAMETERS = {
    "beta": spec("Pa"),
    "c_p1": spec(FLOW),
    "c_n1": spec(FLOW),
    "k_cp": spec("N"),
    "k_fp": spec("1"),
    "z_ss": spec("m"),
    "delta": spec("1/N"),
}
EFFECTS = {
    "valve_lag": {"tau": spec("s", outside=("omega", "rad/s")), "zeta": spec("1")},
    "null_bias": {"u_0": spec("{u}")},
    "viscous_friction": {"b": spec("N*s/m")},
}

SOUND = """
name = "test rig"
layout = "pull-pull"

[geometry]
area = "11.8 cm^2"
chamber_length = "200 mm"
radius = "0.085 m"
x_mid = "-25 mm"

[supply]
P_s = "140 bar"
P_r = "0.25 MPa"

[sensors]
P_a1 = "9 kPa"
psi = "0.01 deg"
u = "2 mV"

[load]
F = "0 N"

[channels]
u = { column = "MainU", unit = "V", invert = true }
F = { column = "Load" }

[parameters]
beta = { start = "8e8 Pa", range = ["1e8 Pa", "3 GPa"] }
c_p1 = { start = "2e-9 m^3/(s*V*Pa^0.5)", range = ["0 m^3/(s*V*Pa^0.5)", "1e-8 m^3/(s*V*Pa^0.5)"] }
z_ss = "60 um"
k_fp = "0"
delta = "0.01 1/N"

[effects.valve_lag]
omega = { start = "1000 rad/s", range = ["500 rad/s", "2000 rad/s"] }
zeta = 0.7

[effects.viscous_friction]

[controller]
omega_F = "40 rad/s"
k = 3
"""  # noqa: E501


def read(tmp_path: Path, text: str) -> RigFile:
    path = tmp_path / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return read_rig(path.read_text(), str(path), PARAMETERS, EFFECTS)


def swapped(old: str, new: str) -> str:
    assert SOUND.count(old) == 1
    return SOUND.replace(old, new)


def refusal(tmp_path: Path, text: str, *words: str) -> None:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    line = str(caught.value)
    assert line.startswith(f"{tmp_path / 'rig.toml'}:")
    assert "\n" not in line
    for word in words:
        assert word in line


@pytest.mark.parametrize("delay", ['"5"', '"5 mm"', '"-1.1 s"', '"2 s"', "5", '""'])
def test_a_delay_that_is_none(tmp_path: Path, delay: str) -> None:
    text = swapped("invert = true", f"delay = {delay}")
    refusal(tmp_path, text, "[channels] u.delay", "expected")


@pytest.mark.parametrize("scale", ["0", "-2", '"2"', "inf", "nan", "true"])
def test_a_scale_that_is_none(tmp_path: Path, scale: str) -> None:
    text = swapped("invert = true", f"scale = {scale}")
    refusal(tmp_path, text, "[channels] u.scale", "expected a positive number")


def test_whether_u_is_held_is_said_of_u_alone(tmp_path: Path) -> None:
    assert read(tmp_path, SOUND).channels["u"].held
    runs_on = swapped("invert = true", "held = false")
    assert not read(tmp_path, runs_on).channels["u"].held
    text = swapped("invert = true", 'held = "no"')
    refusal(tmp_path, text, "[channels] u.held", "expected true or false")
    text = SOUND.replace("[channels]", '[channels]\nx = { column = "x", held = false }')
    refusal(tmp_path, text, "[channels] x.held", "only the command u", "delete the key")


# What is read


def test_sound_rig(tmp_path: Path) -> None:
    rig = read(tmp_path, SOUND)
    assert (rig.name, rig.layout.name) == ("test rig", "pull-pull")
    assert rig.geometry == pytest.approx(
        {"area": 1.18e-3, "chamber_length": 0.2, "radius": 0.085, "x_mid": -0.025}
    )
    assert rig.supply == pytest.approx({"P_s": 14e6, "P_r": 0.25e6})
    assert rig.sensors == pytest.approx(
        {"P_a1": 9e3, "psi": 1.7453292519943295e-4, "u": 2e-3}
    )
    assert rig.output_load == {"F": 0.0}
    assert rig.channels["u"].model_dump() == {
        "column": "MainU", "unit": "V", "invert": True, "scale": 1.0, "delay": "0 s",
        "held": True,
    }  # fmt: skip
    assert rig.channels["F"].unit is None
    assert not rig.channels["F"].invert
    assert rig.controller == {"omega_F": "40 rad/s", "k": 3.0}
    assert rig.command_unit == "V"
    assert rig.path == str(tmp_path / "rig.toml")


def test_parameters_held_and_free(tmp_path: Path) -> None:
    found = read(tmp_path, SOUND).parameters
    assert found["beta"] == Entry(8e8, (1e8, 3e9), "Pa")
    flow = "m^3/(s*V*Pa^0.5)"
    assert found["c_p1"] == Entry(2e-9, (0.0, 1e-8), flow)
    assert found["z_ss"].start == pytest.approx(60e-6)
    assert found["z_ss"].range is None
    assert found["k_fp"] == Entry(0.0, None, "1")
    assert found.keys() == {"beta", "c_p1", "z_ss", "k_fp", "delta"}


def test_reciprocal_parameter_is_stored_as_the_model_has_it(tmp_path: Path) -> None:
    found = read(tmp_path, SOUND).effects
    assert found.keys() == {"valve_lag", "viscous_friction"}
    assert found["viscous_friction"] == {}
    assert found["valve_lag"]["zeta"] == Entry(0.7, None, "1")
    assert found["valve_lag"]["tau"] == Entry(1e-3, (5e-4, 2e-3), "s")
    held = SOUND.split("omega = {")[0] + 'omega = "1250 rad/s"'
    tau = read(tmp_path, held).effects["valve_lag"]["tau"]
    assert tau.start == pytest.approx(8e-4)
    assert tau.range is None
    own = SOUND.split("omega = {")[0] + 'tau = "2 ms"'
    assert read(tmp_path, own).effects["valve_lag"]["tau"].start == 2e-3


def test_dimensionless_command(tmp_path: Path) -> None:
    text = SOUND.replace("s*V*Pa", "s*Pa").replace('"2 mV"', '"0.1 %"')
    rig = read(tmp_path, text + '[effects.null_bias]\nu_0 = "0.02"')
    assert rig.command_unit == "1"
    assert rig.parameters["c_p1"] == Entry(2e-9, (0.0, 1e-8), "m^3/(s*Pa^0.5)")
    assert rig.effects["null_bias"]["u_0"] == Entry(0.02, None, "1")
    assert rig.sensors["u"] == pytest.approx(1e-3)


def test_an_axis_without_a_valve_has_no_constants_of_one(tmp_path: Path) -> None:
    head = 'layout = "driven-axis"\n[parameters]\n'
    rig = RigFile.from_text(head + 'k_cp = "20 N"')
    assert not {"c_p1", "c_n2"} & set(rig.base) and "k_cp" in rig.base
    built = build_rig(rig)
    assert specs(built.valve) == {} and "c_p1" not in parameter_specs(built)
    with pytest.raises(InputError, match=r"c_n1: layout 'driven-axis' has no valve"):
        RigFile.from_text(head + 'c_n1 = "1e-9 m^3/(s*V*Pa^0.5)"')


def test_command_is_in_volts_if_nothing_says(tmp_path: Path) -> None:
    rig = read(tmp_path, 'layout = "driven-axis"')
    assert rig.command_unit == "V"
    assert rig.name == "rig"
    assert rig.parameters == rig.effects == rig.geometry == {}


@pytest.mark.parametrize(
    ("layout", "needed"),
    [
        ("pull-pull", ("area", "chamber_length")),
        ("differential", ("area_1", "area_2", "chamber_length")),
        ("single", ("area",)),
        ("driven-axis", ()),
    ],
)
def test_layout_needs_its_geometry(
    tmp_path: Path, layout: str, needed: tuple[str, ...]
) -> None:
    head = f'layout = "{layout}"\n[geometry]\n'
    unit = {"chamber_length": "m"}
    lines = [f'{key} = "0.1 {unit.get(key, "m^2")}"\n' for key in needed]
    assert read(tmp_path, head + "".join(lines)).geometry.keys() == set(needed)
    for i, key in enumerate(needed):
        rest = "".join(lines[:i] + lines[i + 1 :])
        refusal(tmp_path, head + rest, f"[geometry] {key} is missing", layout)


# Bad input


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[geometry]", "[geometri]", ("'geometri'", "did you mean 'geometry'?")),
        ("name = ", "nmae = ", ("'nmae'", "did you mean 'name'?")),
        ("chamber_length", "chamber_lenght", ("[geometry]", "'chamber_length'?")),
        ("P_r = ", "P_t = ", ("[supply]", "key 'P_t'")),
        ("psi = ", "phi = ", ("[sensors]", "'phi'", "'psi'?")),
        ("P_a1 = ", "time = ", ("[sensors]", "'time'")),
        ('F = "0 N"', 'G = "0 N"', ("[load]", "'G'")),
        ("u = { col", "U_in = { col", ("[channels]", "signal 'U_in'")),
        ("invert", "inverted", ("[channels] u", "'inverted'", "'invert'?")),
        ("beta = ", "betta = ", ("[parameters]", "'betta'", "'beta'?")),
        ('start = "8e8', 'begin = "8e8', ("[parameters] beta", "'begin'")),
        ("s.valve_lag", "s.valve_leg", ("[effects]", "'valve_leg'", "'valve_lag'?")),
        ("zeta", "zetta", ("[effects.valve_lag]", "'zetta'", "'zeta'?")),
        ("pull-pull", "pull-pul", ("layout 'pull-pul'", "did you mean 'pull-pull'?")),
        ("pull-pull", "rotary", ("layout 'rotary'", "differential")),
    ],
)
def test_misspelt(tmp_path: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    refusal(tmp_path, swapped(old, new), "unknown", *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"0 N"', '"0"', ("[load] F", '"0 N"')),
        ('"0 N"', "0", ("[load] F", '"0 N"')),
        ('"0 N"', '"0 Pa"', ("[load] F", "'Pa' does not fit", "N")),
        ('"60 um"', '"60 umm"', ("z_ss", "unknown unit 'umm'")),
        ('"60 um"', '"a lot"', ("z_ss", "not a quantity")),
        ('"60 um"', "[1, 2]", ("z_ss", "not a quantity")),
        ('"200 mm"', '"200 kg"', ("[geometry] chamber_length", "'kg'")),
        ('"3 GPa"', '"3 m"', ("beta range", "'m' does not fit")),
        ('"8e8 Pa"', '"8e8"', ("beta start", '"8e+08 Pa"')),
        ('"1000 rad/s"', '"1000 Hz"', ("omega start", "2*pi")),
        ('["500 rad/s"', '["0 rad/s"', ("omega range", "must be above 0")),
        ('"2 mV"', '"2 %"', ("[sensors] u", "V")),
        ('"0 m^3/(s*V*Pa^0.5)"', '"0 m^3/(s*Pa^0.5)"', ("c_p1 range", "V")),
        ('"2e-9 m^3/(s*V*Pa^0.5)"', '"2e-9 m^3/(s*A*Pa^0.5)"', ("c_p1 start", "A")),
    ],
)
def test_bad_unit(tmp_path: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    refusal(tmp_path, swapped(old, new), *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('["1e8 Pa", "3 GPa"]', '["3 GPa", "1e8 Pa"]', ("beta", "upside down")),
        ('["1e8 Pa", "3 GPa"]', '["8e8 Pa", "8e8 Pa"]', ("beta", "hold it fixed")),
        ('["1e8 Pa", "3 GPa"]', '["1e9 Pa", "3 GPa"]', ("beta start", "outside")),
        ('["1e8 Pa", "3 GPa"]', '["1e8 Pa", "7e8 Pa"]', ("beta start", "outside")),
        ('["1e8 Pa", "3 GPa"]', '["1e8 Pa"]', ("beta", "a range of two")),
        ('["1e8 Pa", "3 GPa"]', '"3 GPa"', ("beta", "a range of two")),
        (', range = ["1e8 Pa", "3 GPa"]', "", ("beta", "a range of two")),
        ('start = "8e8 Pa", ', "", ("beta", "needs a start")),
        ('["500 rad/s", "2000', '["5000 rad/s", "2000', ("omega", "upside down")),
        ('["500 rad/s", "2000', '["1500 rad/s", "2000', ("omega start", "outside")),
        ("zeta = 0.7", 'tau = "1 ms"', ("tau", "a second time")),
        ('"11.8 cm^2"', '"-11.8 cm^2"', ("[geometry] area", "above 0")),
        ('"200 mm"', '"0 mm"', ("[geometry] chamber_length", "above 0")),
        ('"9 kPa"', '"0 kPa"', ("[sensors] P_a1", "above 0")),
        ('"140 bar"', '"2 bar"', ("[supply] P_s", "P_r")),
        ('"140 bar"', '"-2 bar"', ("[supply] P_s",)),
        ('column = "Load"', 'unit = "N"', ("[channels] F", "no column")),
        ('column = "Load"', "column = 3", ("[channels] F.column", "3", "text")),
        (
            "invert = true",
            'invert = "yes"',
            ("[channels] u.invert", "'yes'", "true or false"),
        ),
        ('layout = "pull-pull"', "", ("layout is missing", "pull-pull")),
        ('layout = "pull-pull"', "layout = 3", ("layout 3",)),
        ("k = 3", "k = { a = 1 }", ("[controller] k:", "{'a': 1}", "text")),
        (
            "[effects.viscous_friction]",
            "[effects]\nb = 3",
            ("[effects] b:", "3", "table"),
        ),
        ('{ column = "Load" }', '"Load"', ("[channels] F", "{ column =")),
    ],
)
def test_bad_value(tmp_path: Path, old: str, new: str, words: tuple[str, ...]) -> None:
    refusal(tmp_path, swapped(old, new), *words)


def test_section_that_is_no_table(tmp_path: Path) -> None:
    refusal(
        tmp_path,
        'layout = "single"\nload = "0 N"',
        "load: invalid value '0 N'",
        "expected a table",
    )


def test_commands_in_volts_and_without_a_unit(tmp_path: Path) -> None:
    other = swapped("z_ss", 'c_n1 = "2e-9 m^3/(s*Pa^0.5)"\nz_ss')
    refusal(tmp_path, other, "[parameters] c_n1", "in 1, c_p1 in V")
    bias = SOUND + '[effects.null_bias]\nu_0 = "0.02"'
    refusal(tmp_path, bias, "[effects.null_bias] u_0", "in 1, c_p1 in V")
    assert read(tmp_path, bias.replace('"0.02"', '"20 mV"')).command_unit == "V"


def test_not_toml(tmp_path: Path) -> None:
    refusal(tmp_path, swapped("P_s = ", "P_s "), "not TOML", "line 12")
    (tmp_path / "rig.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not text in UTF-8"):
        RigFile.load(tmp_path / "rig.toml")
    with pytest.raises(InputError, match="no such file; check the path"):
        RigFile.load(tmp_path / "none.toml")
    with pytest.raises(InputError, match="not a regular file"):
        RigFile.load(tmp_path)


# -- tolerances --


@pytest.mark.parametrize("said", ["11.8 cm^2 +- 2 %", "11.8 cm^2 ± 0.236 cm^2"])
def test_a_held_constant_may_have_a_tolerance(tmp_path, said):
    file = read(tmp_path, swapped("11.8 cm^2", said))
    assert file.geometry["area"] == pytest.approx(1.18e-3)
    assert file.tolerances == {"area": pytest.approx(2.36e-5)}


def test_a_held_parameter_may_have_one_too(tmp_path):
    text = swapped('"60 um"', '"60 um +- 3 um"').replace(
        '"0.01 1/N"', '"0.01 1/N +- 10 %"'
    )
    file = read(tmp_path, text)
    assert file.parameters["z_ss"].tolerance == pytest.approx(3e-6)
    assert file.parameters["delta"].tolerance == pytest.approx(1e-3)
    assert file.parameters["k_fp"].tolerance == 0.0


def test_a_reciprocal_has_its_tolerance_in_the_unit_that_is_stored(tmp_path):
    line = '"1000 rad/s +- 1 %"'
    entry = '{ start = "1000 rad/s", range = ["500 rad/s", "2000 rad/s"] }'
    tau = read(tmp_path, swapped(entry, line)).effects["valve_lag"]["tau"]
    assert (tau.start, tau.tolerance) == (pytest.approx(1e-3), pytest.approx(1e-5))


@pytest.mark.parametrize(
    "said, word",
    [("11.8 cm^2 +- 0 %", "above 0"), ("11.8 cm^2 +- -1 %", "above 0"),
     ("11.8 cm^2 +- 1 kg", "kg"), ("11.8 cm^2 +- 2", "no unit")],
)  # fmt: skip
def test_a_bad_tolerance_is_refused(tmp_path, said, word):
    refusal(tmp_path, swapped("11.8 cm^2", said), "[geometry] area", word)


def test_a_tolerance_is_kept_where_a_file_is_written_again():
    text = SOUND.replace('"11.8 cm^2"', '"11.8 cm^2 +- 2 %"')
    rest = text[: text.index("[effects.valve_lag]")]
    file = RigFile.from_text(rest)
    again = RigFile.from_text(rewrite(file, {"beta": 9e8}))
    assert again.parameters["beta"].start == 9e8
    assert again.tolerances == file.tolerances == {"area": pytest.approx(2.36e-5)}
