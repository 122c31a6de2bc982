"""Effects of a user's own: the documented one at work, and what is refused, and how."""

from __future__ import annotations

import json
import re
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import jax.numpy as jnp
import pandas as pd
import pytest

from hydrojax import effects
from hydrojax.effects import EFFECTS, load_effects, registry
from hydrojax.errors import InputError
from hydrojax.rigfile.schema import RigFile
from tests import generator

PAGE = Path(__file__).parents[2] / "docs" / "your_own_effect.md"


def blocks(kind: str) -> list[str]:
    """The page's code blocks of one kind."""
    return re.findall(rf"```{kind}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


@pytest.fixture
def mine(tmp_path) -> Path:
    path = tmp_path / "my_effects.py"
    path.write_text(blocks("python")[0])
    return path


# -- the documented effect, at work --


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A case whose truth is the page's effect; the pressures drive, F is predicted.

    They are logged almost without noise, which F would otherwise have from them.
    """
    folder = tmp_path_factory.mktemp("own")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generator, "NOISE_P", 100.0)
        generator.write_case(folder, 31, {"quadratic_drag": {}}, seconds=6.0)
    for name in ("fit_1", "fit_2", "validate"):
        log = pd.read_csv(folder / f"{name}.csv")
        log.drop(columns="u [V]").to_csv(folder / f"{name}.csv", index=False)
    hydraulic = ("beta", "c_p1", "c_n1", "c_p2", "c_n2", "delta_1", "delta_2")
    lines = (folder / "rig.toml").read_text().splitlines()
    kept = [line for line in lines if line.split(" ")[0] not in hydraulic]
    (folder / "rig.toml").write_text("\n".join(kept) + "\n")
    return folder


@pytest.mark.slow
def test_the_trace_finds_the_page_s_effect(call, vocabulary, case, mine, tmp_path):
    out = tmp_path / "out"
    code, _, err = call(
        "trace", case / "rig.toml", case / "fit_1.csv", case / "fit_2.csv",
        "--validate", case / "validate.csv", "--effects", mine, "--out", out,
    )  # fmt: skip
    assert code == 0, err
    report = json.loads((out / "report.json").read_text())
    assert report["verdict"] == "explained"
    (found,) = report["effects"]
    assert found["name"] == "quadratic_drag"
    drag = found["parameters"]["c"]
    assert drag["unit"] == "N*s^2/m^2"
    assert drag["value"] == pytest.approx(2e5, abs=4 * drag["std"])
    assert drag["std"] < 4e4
    names = {c["name"] for c in report["candidates"]}
    assert {"stribeck", "viscous_friction", "quadratic_drag"} <= names
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "quadratic drag" in page or "quadratic_drag" in page


@pytest.mark.slow
def test_identify_fits_it_where_the_rig_file_declares_it(
    call, vocabulary, case, mine, tmp_path
):
    (declared,) = (b for b in blocks("toml") if b.startswith("[effects."))
    rig = tmp_path / "rig.toml"
    rig.write_text((case / "rig.toml").read_text() + "\n" + declared)
    out = tmp_path / "out"
    words = ("identify", rig, case / "fit_1.csv", "--out", out, "--starts", 1)
    code, _, err = call(*words)
    assert code == 2 and "unknown effect 'quadratic_drag'" in err
    code, _, err = call(*words, "--effects", mine)
    assert code == 0, err
    drag = json.loads((out / "report.json").read_text())["parameters"][
        "quadratic_drag.c"
    ]
    assert drag["identified"]
    assert drag["value"] == pytest.approx(2e5, abs=4 * drag["std"])


# -- the vocabulary --


def test_a_file_s_effects_stand_behind_the_others(vocabulary, mine):
    before = list(EFFECTS)
    found = load_effects(mine)
    assert list(found) == ["quadratic_drag"]
    assert list(EFFECTS) == [*before, "quadratic_drag"]


def test_a_file_may_be_read_again(vocabulary, mine):
    load_effects(mine)
    mine.write_text(mine.read_text().replace('"drag"', '"drag of oil"'))
    again = load_effects(mine)
    assert EFFECTS["quadratic_drag"] is again["quadratic_drag"]


def test_reading_a_file_leaves_nothing_beside_it(vocabulary, mine):
    load_effects(mine)
    assert [p.name for p in mine.parent.iterdir()] == [mine.name]


def test_a_package_offers_its_effects(vocabulary, mine, monkeypatch, case):
    """As a class, or as a module of them; and a rig file may declare them."""
    monkeypatch.syspath_prepend(mine.parent)
    monkeypatch.delitem(sys.modules, "my_effects", raising=False)
    for value in ("my_effects", "my_effects:QuadraticDrag"):
        EFFECTS.pop("quadratic_drag", None)
        point = EntryPoint("mine", value, registry.GROUP)
        monkeypatch.setattr(registry, "entry_points", lambda group, p=point: [p])
        effects.offered.cache_clear()
        RigFile.load(case / "rig.toml")
        assert "quadratic_drag" in EFFECTS
    point = EntryPoint("mine", "no_such_package:Thing", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    effects.offered.cache_clear()
    with pytest.raises(InputError, match="no_such_package.*uninstall its package"):
        RigFile.load(case / "rig.toml")
    monkeypatch.undo()
    effects.offered.cache_clear()


# -- what is refused --

HEAD = "from hydrojax.effects import *\nimport jax.numpy as jnp\n"
GOOD = """
class Mine(FrictionForce):
    name = "mine"
    residual_axis = "v"
    c: Array = param("N*s/m", 0.0, 0.0, 1e6, "drag", strength=True, size=1e3)

    def force(self, at):
        return self.c * at.v
"""


def test_the_example_of_what_is_refused_would_do(vocabulary, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(HEAD + GOOD)
    assert list(load_effects(path)) == ["mine"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (GOOD, "x = 1\n", "defines no effect: write a class"),
        (GOOD, GOOD + "y = 1 +\n", "line 11: SyntaxError"),
        (GOOD, GOOD + "y = 1 / 0\n", "line 11: ZeroDivisionError"),
        (GOOD, "import no_such_package\n", "line 3: ModuleNotFoundError"),
        ('"mine"', '"stribeck"', "'stribeck' is taken; give it another"),
        ('    name = "mine"\n', "", 'add name = "my_effect"'),
        ("(FrictionForce)", "(Effect)", "has no place: add place = one of"),
        (
            '    name = "mine"',
            '    name = "mine"\n    place = "nowhere"',
            "'nowhere' is unknown: write one of",
        ),
        (
            '    name = "mine"',
            '    name = "mine"\n    needs = ("speed",)',
            "invalid needs ('speed',)",
        ),
        ('    residual_axis = "v"\n', "", "add residual_axis"),
        ("def force", "def power", "needs a method force(...)"),
        ("(FrictionForce)", "(HysteresisForce)", "needs a method reach(...)"),
        ('"N*s/m"', '""', "the unit '' is unknown"),
        ('"N*s/m"', '"N*s/furlough"', "the unit 'N*s/furlough' is unknown"),
        ("strength=True, ", "", "one of ['c'] must have strength=True"),
        ("c: Array = ", "c = ", "has no type annotation"),
        ('0.0, 0.0, 1e6, "', '5.0, 0.0, 1e6, "', "a strength must be 0"),
        ('0.0, 0.0, 1e6, "', '0.0, 1.0, 1e6, "', "c: 0 is outside its range"),
        ('0.0, 0.0, 1e6, "', '0.0, 0.0, 0.0, "', "range 0 to 0 is invalid"),
        ("size=1e3", "prior=-1.0", "standard deviation, above 0"),
        ("self.c * at.v", "self.c**2 * at.v", "no trace would find it"),
        ("self.c * at.v", "at.v", "is not 0 when c = 0"),
        ("self.c * at.v", "self.c * at.speeed", "has no attribute 'speeed'"),
        ("self.c * at.v", "at.v if self.c > 0 else 0.0", "force(...) fails"),
    ],
)
def test_what_cannot_be_taken_is_refused_in_one_line(
    vocabulary, tmp_path, old, new, said
):
    path = tmp_path / "mine.py"
    path.write_text((HEAD + GOOD).replace(old, new))
    before = dict(EFFECTS)
    with pytest.raises(InputError) as refused:
        load_effects(path)
    text = str(refused.value)
    assert text.startswith(str(path)) and said in text
    assert "\n" not in text
    assert before == EFFECTS


FLOW = """
class Mine(FlowEffect):
    name = "mine"
    residual_axis = "P_a1 - P_a2"
    c: Array = param("m^3/(s*Pa)", 0.0, 0.0, 1e-6, "leak", strength=True, size=1e-10)

    def flow(self, at):
        d = at.P_a1 - at.P_a2
        q = self.c * ROOT
        return q, -q
"""
LOOP = """(
            jax.lax.while_loop(lambda s: s[1] > 0, lambda s: (2 * s[0], s[1] - 1),
                               (d, 3))[0])"""


@pytest.mark.parametrize(
    ("root", "said"),
    [
        ("jnp.where(d > 0, jnp.sqrt(jnp.where(d > 0, d, 1.0)), -d)", None),
        ("jnp.where(d > 0, jnp.sqrt(d), -d)", "that is not taken must be finite"),
        ("jnp.where(d > 0, d, jnp.sqrt(-d))", "that is not taken must be finite"),
        (LOOP, "flow(...) cannot be differentiated backward: ValueError"),
    ],
)
def test_what_acts_on_the_pressures_bears_backward_derivatives(
    vocabulary, tmp_path, root, said
):
    """Forward ones are finite in all of these."""
    path = tmp_path / "mine.py"
    path.write_text("import jax\n" + HEAD + FLOW.replace("ROOT", root))
    if said is None:
        assert list(load_effects(path)) == ["mine"]
        return
    with pytest.raises(InputError) as refused:
        load_effects(path)
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_two_files_may_not_share_a_name(vocabulary, mine, tmp_path):
    load_effects(mine)
    other = tmp_path / "other.py"
    other.write_text(mine.read_text())
    with pytest.raises(InputError, match="'quadratic_drag' is taken"):
        load_effects(other)


def test_no_such_file_is_refused(call, vocabulary, case, tmp_path):
    gone = tmp_path / "gone.py"
    code, _, err = call(
        "identify", case / "rig.toml", case / "fit_1.csv", "--effects", gone
    )
    assert code == 2
    assert str(gone) in err and len(err.strip().splitlines()) == 1


# -- the decorator --


def define(strength: float):
    """What a notebook's cell does: a class of one name, made anew at every run."""

    @effects.effect
    class CellDrag(effects.FrictionForce):
        name = "cell_drag"
        residual_axis = "v"
        c: effects.Array = effects.param(
            "N*s^2/m^2", 0.0, 0.0, 1e8, "drag", strength=True, size=1e3
        )

        def force(self, at):
            return strength * self.c * at.v * jnp.abs(at.v)

    return CellDrag


def test_a_cell_that_runs_again_replaces_its_effect(vocabulary):
    first, second = define(1.0), define(2.0)
    assert first is not second and EFFECTS["cell_drag"] is second


def test_the_decorator_refuses_what_is_no_effect(vocabulary):
    with pytest.raises(InputError, match="is not 0 when c = 0"):

        @effects.effect
        class Offset(effects.FrictionForce):
            name = "always_there"
            residual_axis = "v"
            c: effects.Array = effects.param(
                "N", 0.0, 0.0, 1e3, "offset", strength=True
            )

            def force(self, at):
                return self.c + 1.0

    assert "always_there" not in EFFECTS
    with pytest.raises(InputError, match="'stribeck' is taken"):

        @effects.effect
        class Twice(effects.FrictionForce):
            name = "stribeck"
            residual_axis = "v"
            c: effects.Array = effects.param(
                "N", 0.0, 0.0, 1e3, "offset", strength=True
            )

            def force(self, at):
                return self.c
