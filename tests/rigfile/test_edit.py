"""A rig file with new values: what changed, what stayed, and that it reads back."""

from typing import Any

import pytest

from hydrojax.errors import InputError
from hydrojax.identify.estimation.known import free_parameters
from hydrojax.rigfile.build import effects_of, over_travel
from hydrojax.rigfile.edit import rewrite
from hydrojax.rigfile.schema import RigFile

RIG = """# mine
name = "a rig"
layout = "pull-pull"

[geometry]
area = "11.8 cm^2"   # from the drawing
chamber_length = "200 mm"
radius = "85 mm"

[parameters]
beta = { start = "8e8 Pa", range = ["1e8 Pa", "9e8 Pa"] }
k_fp = { start = "0.5", range = ["0", "2"] }
delta = "1.1111e-3 1/N"

[effects.valve_lag]
omega = { start = "900 rad/s", range = ["300 rad/s", "3000 rad/s"] }
zeta = "0.7"

[controller]
k_p = "1.2 V/kN"
"""


@pytest.fixture
def spec(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return RigFile.load(path)


def reread(tmp_path, text):
    path = tmp_path / "new.toml"
    path.write_text(text)
    return RigFile.load(path)


def test_what_did_not_change_stays_to_the_letter(spec):
    values = {"beta": 8e8, "k_fp": 0.5, "delta": 1.1111e-3, "valve_lag.tau": 1 / 900}
    assert rewrite(spec, values) == RIG


def test_values_are_replaced_and_all_else_stays(spec, tmp_path):
    text = rewrite(spec, {"beta": 8.4e8, "valve_lag.tau": 1 / 1250.0})
    new = reread(tmp_path, text)
    assert new.parameters["beta"].start == 8.4e8
    assert new.parameters["beta"].range == (1e8, 9e8)
    assert new.effects["valve_lag"]["tau"].start == pytest.approx(1 / 1250)
    assert new.parameters["k_fp"].start == 0.5
    for line in ("# mine", "# from the drawing", 'zeta = "0.7"', 'k_p = "1.2 V/kN"'):
        assert line in text


def test_a_range_is_widened_to_hold_the_value(spec, tmp_path):
    new = reread(tmp_path, rewrite(spec, {"beta": 9.3e8}))
    assert new.parameters["beta"].range == (1e8, 9.3e8)


def test_an_added_effect_can_be_fitted_again(spec, tmp_path):
    text = rewrite(spec, {"internal_leakage.c_il": 2e-12}, ("internal_leakage",))
    entry = reread(tmp_path, text).effects["internal_leakage"]["c_il"]
    assert entry.start == 2e-12 and entry.range is not None
    assert entry.range[0] == 0.0


def test_what_a_declared_effect_leaves_out_is_found_where_it_is_known_roughly(tmp_path):
    """And written; nothing of an effect that is held as a whole."""
    text = (
        RIG.replace('zeta = "0.7"\n', "")
        + '\n[effects.entrained_air]\nalpha = "0.01"\n'
    )
    spec = reread(tmp_path, text)
    found = free_parameters(spec)
    assert set(found) == {"beta", "k_fp", "valve_lag.tau", "valve_lag.zeta"}
    zeta = found["valve_lag.zeta"]
    assert (zeta.start, zeta.lower, zeta.upper, zeta.prior) == (0.7, 0.2, 3.0, 0.2)

    values = {"valve_lag.zeta": 0.85, "entrained_air.n": 1.2}
    new = reread(tmp_path, rewrite(spec, values))
    assert new.effects["valve_lag"]["zeta"].start == pytest.approx(0.85)
    assert new.effects["valve_lag"]["zeta"].range == pytest.approx((0.2, 3.0))
    assert new.effects["valve_lag"]["tau"] == spec.effects["valve_lag"]["tau"]
    assert set(new.effects["entrained_air"]) == {"alpha"}


def test_controller_and_name(spec, tmp_path):
    keys = {"k_p": "2 V/kN", "k_cp": ["0.5 kN", "1.5 kN"]}
    new = reread(tmp_path, rewrite(spec, {}, controller=keys, name="tuned"))
    assert new.name == "tuned"
    assert new.controller["k_p"] == "2 V/kN"
    assert new.controller["k_cp"] == ["0.5 kN", "1.5 kN"]


def test_a_profile_keeps_the_travel_that_it_was_laid_over(spec, tmp_path):
    """Under logs of another travel the same file means the same wave."""
    values, added = {"position_friction.s_1": 0.3}, ("position_friction",)
    text = rewrite(over_travel(spec, (-0.012, 0.031)), values, added)
    new = reread(tmp_path, text)
    for travel in ((-0.012, 0.031), (-0.05, 0.05)):
        file = over_travel(new, travel)
        effect: Any = effects_of(added, file)["position_friction"]
        assert float(effect.x_from) == pytest.approx(-0.012)
        assert float(effect.x_to) == pytest.approx(0.031)
    # What the file says stays, and no other effect asks for it.
    again = rewrite(over_travel(new, (-1.0, 1.0)), {})
    assert again == text
    plain = rewrite(over_travel(spec, (-1.0, 1.0)), {}, ("internal_leakage",))
    assert "x_from" not in plain


def test_a_declared_profile_is_the_files_own_under_any_log(tmp_path):
    """A file that declares one without its ends means half a chamber to each side."""
    declared = RIG + '\n[effects.position_friction]\ns_1 = "0.3"\n'
    file = reread(tmp_path, declared)
    assert file.stroke == pytest.approx((-0.1, 0.1))
    assert over_travel(file, (-0.012, 0.031)) == file


def test_a_travel_with_one_end_or_turned_round_is_refused(tmp_path):
    for ends in ('x_from = "1 cm"', 'x_from = "1 cm"\nx_to = "-1 cm"'):
        with pytest.raises(InputError, match="x_from and x_to"):
            reread(tmp_path, RIG.replace("[geometry]", f"[geometry]\n{ends}"))
