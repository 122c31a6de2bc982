"""Reports: the JSON's keys, a page that needs nothing else, pictures of any outcome."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import jsonschema
import numpy as np
import pytest

from hydrojax.identify.checking.words import Finding
from hydrojax.identify.report import explorer, figures, residuals, write
from hydrojax.identify.report.headline import headline
from hydrojax.identify.results.outcome import (
    Candidate,
    ChannelErrors,
    Covariance,
    Errors,
    FoundEffect,
    LoopCheck,
    Outcome,
    Parameter,
    Series,
    Unexplained,
)
from hydrojax.identify.results.report_json import report_json
from hydrojax.identify.results.summary import with_inputs
from hydrojax.report import files, text
from hydrojax.report.record import read_report
from hydrojax.report.schema import report_schema

NOISE = {"P_a1": 9e3, "P_a2": 9e3, "F": 2.5}
UNITS = {"P_a1": "Pa", "P_a2": "Pa", "F": "N"}
CHOKED = "m^3/(s*V*Pa^0.5)"


def parameter(value: float, unit: str, std: float | None = None, **more) -> Parameter:
    """A free parameter that was found with `std`, or a held one without."""
    interval = None if std is None else (value - 1.96 * std, value + 1.96 * std)
    given = {"description": "what it is", "start": 1.1 * value, "free": std is not None}
    return Parameter(value, unit, std=std, interval=interval, **(given | more))


PARAMETERS = {
    "beta": parameter(8.576e8, "Pa", 1.23e6, description="bulk modulus"),
    "c_p1": parameter(2.3014e-9, CHOKED, 1.2e-11, description="supply to chamber 1"),
    "k_cp": parameter(412.3, "N", 3.1, description="Coulomb level, v > 0"),
    "k_vp": parameter(
        1534.0, "N*s/m", 210.0, at_bound=True, description="fall with speed"
    ),
    "k_0": parameter(-0.4, "N", 38.0, identified=False, description="constant offset"),
    "z_ss": parameter(60e-6, "m", description="bristle deflection when sliding"),
    "L_slope": parameter(300.0, "s/m", description="slope of the switch"),
}


def series(name: str, n: int, lack: dict[str, float], **left: float) -> Series:
    """A log with noise, gaps, and a lack by channel that grows with a signal."""
    rng = np.random.default_rng(n)
    t = 0.5 + 1e-3 * np.arange(n)
    v = 0.12 * np.sin(2 * t) + 0.05 * np.sin(13 * t)
    x = 0.06 * np.cos(2 * t)
    follow = {"P_a1": v / 0.12, "P_a2": -v / 0.12, "F": np.sign(v) * (x / 0.06)}
    signals = {
        "v": v,
        "x": x,
        "P_a1 + P_a2": 14e6 + 4e5 * np.cos(2 * t),
        "P_a1 - P_a2": 5e6 * v / 0.12,
        "u": 3.0 * v,
    }
    before, after = {}, {}
    for channel, sigma in NOISE.items():
        noise = sigma * rng.standard_normal(n)
        before[channel] = noise + lack.get(channel, 0.0) * follow[channel]
        after[channel] = noise + left.get(channel, 0.0) * follow[channel]
    gap = np.arange(n) % 2501 == 2500
    gap[n // 2 : n // 2 + n // 10] = True
    for array in (t, *before.values(), *after.values(), *signals.values()):
        array[gap] = np.nan
    measured = {c: 100 * before[c] for c in before}
    return Series(name, t, measured, before, after, signals)


def candidates(added: tuple[str, ...]) -> tuple[Candidate, ...]:
    """A catalogue in all its statuses."""
    rest = (
        Candidate("valve_lag", "rejected", 3e-5, 0.99, 0.021, "explains too little"),
        Candidate("stribeck", "absent", 0.42, 0.97, 1.3e-4, "not beyond chance"),
        Candidate("payload_inertia", "cannot tell", 0.8, 0.11, 2e-5, "hardly excited"),
        Candidate("loadcell_gain", "absent", 1.0, 1.0, 0.0, ""),
        Candidate("gravity_load", "cannot tell", np.nan, np.nan, np.nan, "no angle"),
    )
    first = (Candidate(n, "added", 0.0, 1.0, 0.93, "helps") for n in added)
    return (*first, *rest)


def channels(**ratios: tuple[float, float]) -> dict[str, ChannelErrors]:
    """Channels with errors in multiples of the noise."""
    return {
        c: ChannelErrors(UNITS[c], NOISE[c], before * NOISE[c], after * NOISE[c])
        for c, (before, after) in ratios.items()
    }


def explained() -> Outcome:
    """A leakage and a friction were found and all channels are at their noise."""
    leak = FoundEffect(
        "internal_leakage",
        {"c_il": parameter(1.03e-12, "m^3/(s*Pa)", 1.4e-14, description="leakage")},
        0.0,
        {"P_a1": 41e3, "P_a2": 43e3, "F": 2.52},
        {"P_a1": 9.3e3, "P_a2": 9.2e3, "F": 2.52},
        (),
        "P_a1 - P_a2",
    )
    friction = FoundEffect(
        "position_friction",
        {"a_1": parameter(0.21, "1", 0.004, description="1st wave")},
        3.2e-41,
        {"P_a1": 9.3e3, "P_a2": 9.2e3, "F": 31.0},
        {"P_a1": 9.3e3, "P_a2": 9.2e3, "F": 2.6},
        ("gravity_load", "stribeck"),
        "x",
    )
    lack = {"P_a1": 55e3, "P_a2": 55e3, "F": 60.0}
    return Outcome(
        command="trace",
        rig="STVF joint 1",
        fit_logs=("fit_1.csv", "fit_2.csv"),
        validate_logs=("validate.csv", "slow <b>.csv"),
        verdict="explained",
        sentence="The residual is internal leakage, 1.03e-12 m^3/(s*Pa), & friction.",
        parameters=PARAMETERS,
        channels=channels(P_a1=(4.56, 1.03), P_a2=(4.8, 1.02), F=(12.4, 1.04)),
        effects=(leak, friction),
        candidates=candidates(("internal_leakage", "position_friction")),
        limits=("k_vp stands at the upper end of its range.",),
        notes=("fit_1.csv: above 210 Hz the position is noise.",),
        seconds={"compile": 9.13, "run": 14.02},
        series=(
            series("validate.csv", 23500, lack),
            series("slow <b>.csv", 9000, lack),
        ),
        loops=(loop_check(),),
        covariance=Covariance(("beta", "k_0"), np.array([[1e12, 3.0], [3.0, 1.0]])),
    )


def loop_check() -> LoopCheck:
    """A run of 8 s that the simulated loop follows within 4 N."""
    t = np.arange(0.5, 8.5, 1e-3)
    desired = 400 * np.sin(2 * t) + 90 * np.sin(17 * t)
    measured = desired - 20 * np.cos(17 * t)
    off = 4 * np.sin(300 * t)
    return LoopCheck(
        "validate.csv", t, desired, measured, measured - off, 2.83, 14.1, 14.4,
        "a pressure left (P_r, P_s): P_a1 in 3 of 8000 samples",
    )  # fmt: skip


def nothing_missing() -> Outcome:
    """One channel, one short log, no effect."""
    return replace(
        explained(),
        verdict="nothing missing",
        sentence="Nothing is missing: the error is the noise.",
        channels=channels(F=(1.02, 1.02)),
        effects=(),
        candidates=candidates(()),
        series=(series("validate.csv", 300, {}),),
        limits=(),
        notes=(),
    )


def unknown() -> Outcome:
    """The force stays above its noise."""
    lack = {"P_a1": 1e3, "F": 60.0}
    says = "F stays 55 N above its noise and follows x."
    return replace(
        explained(),
        verdict="unknown",
        sentence="Something else moves F, and no effect accounts for it.",
        channels=channels(P_a1=(1.01, 1.01), F=(24.0, 22.0)),
        effects=(),
        candidates=candidates(()),
        unexplained=(
            Unexplained("F", 55.0, "N", "x", says),
            Unexplained("F", 5.0, "N", "a signal that was not kept", "And more."),
        ),
        series=(series("validate.csv", 23500, lack, F=55.0),),
    )


def identified() -> Outcome:
    """What `identify` finds: no candidates, no series of some channels."""
    return replace(
        nothing_missing(),
        command="identify",
        candidates=(),
        channels=channels(P_a1=(9.0, 1.0), F=(np.nan, np.nan)),
        parameters=PARAMETERS | {"beta": parameter(np.nan, "Pa", np.inf)},
        loops=(),
    )


OUTCOMES = {f.__name__: f for f in (explained, nothing_missing, unknown, identified)}

CONTRACT = {
    "format": str,
    "command": str,
    "rig": str,
    "logs": dict,
    "verdict": str,
    "sentence": str,
    "explained_share": float,
    "parameters": dict,
    "channels": dict,
    "effects": list,
    "curves": list,
    "candidates": list,
    "unexplained": list,
    "closed_loop": list,
    "covariance": dict,
    "inputs": list,
    "limits": list,
    "notes": list,
    "seconds": dict,
    "criteria": dict,
    "files": list,
    "made": dict,
}
RECORDS = {
    "effects": {"name", "parameters", "p_value", "before", "after", "cannot_tell_from"},
    "candidates": {"name", "status", "p_value", "power"},
    "unexplained": {"channel", "excess", "unit", "follows", "says"},
    "closed_loop": {"log", "unit", "rms", "tracking_measured", "tracking_simulated"},
}
FREE = {"value", "std", "unit", "interval", "start", "at_bound", "identified", "held"}


def refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")


class Page(HTMLParser):
    """What a page shows, its pictures, the places in it and every address."""

    def __init__(self, text: str):
        super().__init__()
        self.images: list[dict[str, str]] = []
        self.addresses: list[str] = []
        self.places: set[str] = set()
        self.tags: set[str] = set()
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        found = {k: v or "" for k, v in attrs}
        self.tags.add(tag)
        self.addresses += [found[k] for k in ("src", "href", "srcset") if k in found]
        self.places.add(found.get("id", ""))
        if tag == "img":
            self.images.append(found)

    def handle_data(self, data):
        self.words.append(data)

    @property
    def said(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folder of each outcome's report, by the outcome's name."""
    top = tmp_path_factory.mktemp("reports")
    for name, make in OUTCOMES.items():
        write.write_report(make(), top / name)
    return top


@pytest.mark.parametrize("name", OUTCOMES)
def test_json_keeps_the_contract(written, name):
    text = (written / name / "report.json").read_text(encoding="utf-8")
    found = json.loads(text, parse_constant=refuse)
    assert {k: type(v) for k, v in found.items()} == CONTRACT
    jsonschema.validate(found, report_schema())
    assert found["format"] == "hydrojax-report/1"
    assert read_report(written / name).rig == found["rig"]
    assert set(found["logs"]) == {"fit", "validate", "test"}
    for key, wanted in RECORDS.items():
        for record in found[key]:
            assert wanted <= set(record)
    own = [e["parameters"] for e in found["effects"]]
    for p in (p for group in (found["parameters"], *own) for p in group.values()):
        assert set(p) >= FREE
        assert not p["held"] or p["std"] is None
    for c in found["channels"].values():
        assert set(c) == {"unit", "noise", "before", "after", "horizons"}


def with_test_logs() -> Outcome:
    """An outcome with test logs, on which the force is worse than in validation."""
    F = replace(explained().channels["F"], validate=Errors(31.0, 2.6), after=4.0)
    return replace(
        explained(), test_logs=("third.csv",), channels=explained().channels | {"F": F}
    )


def test_errors_of_test_logs_stand_first_and_validation_s_beside_them(tmp_path):
    write.write_report(with_test_logs(), tmp_path)
    found = json.loads((tmp_path / "report.json").read_text())
    assert found["logs"]["test"] == ["third.csv"]
    assert found["channels"]["F"]["after"] == 4.0
    assert found["channels"]["F"]["validate"] == {"before": 31.0, "after": 2.6}
    said = Page((tmp_path / "report.html").read_text()).said
    assert "RMS of measured minus replayed on the test logs" in said
    assert "Test, in no decision third.csv" in said
    assert "31 N → 2.6 N" in said


def test_json_has_null_for_what_is_no_number(written):
    found = json.loads((written / "identified" / "report.json").read_text())
    beta = found["parameters"]["beta"]
    assert beta["value"] is None and beta["std"] is None
    assert beta["interval"] == [None, None]
    assert found["channels"]["F"]["after"] is None
    explained = json.loads((written / "explained" / "report.json").read_text())
    assert explained["candidates"][-1]["power"] is None
    assert explained["effects"][0]["p_value"] == 0.0


def test_json_takes_numpy_numbers():
    odd = ChannelErrors("N", np.float64(2.5), np.float32(3.0), np.array(2.6))  # pyright: ignore
    outcome = replace(
        nothing_missing(), channels={"F": odd}, seconds={"run": np.int64(3)}
    )
    assert json.loads(json.dumps(report_json(outcome)))["channels"]["F"]["before"] == 3


@pytest.mark.parametrize("name", OUTCOMES)
def test_page_needs_nothing_else(written, name):
    text = (written / name / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    for word in ("http:", "https:", "@import", "url("):
        assert word not in text
    own = {f"#{place}" for place in page.places}
    assert page.addresses
    assert all(a.startswith("data:") or a in own for a in page.addresses)
    assert page.images and all(i["alt"].strip() for i in page.images)
    assert OUTCOMES[name]().sentence in page.said
    assert not re.search(r"\b(nan|inf|None)\b", page.said)


def test_page_says_what_the_outcome_says(written):
    said = Page((written / "explained" / "report.html").read_text()).said
    for words in (
        "857.6 ± 1.2 MPa",
        "(1.030 ± 0.014) × 10⁻¹² m³/(s·Pa)",
        "do not distinguish it from gravity load or stribeck",
        "No other candidate accounts for the residual as well",
        "at the end of its range",
        "not identified",
        "p < 10⁻⁶",
        "12.40 × noise",
        "slow <b>.csv",
        "k_vp stands at the upper end of its range.",
        "9.1 s",
    ):
        assert words in said
    unexplained = Page((written / "unknown" / "report.html").read_text()).said
    assert "F stays 55 N above its noise and follows x." in unexplained
    assert "above its noise" in unexplained


def test_a_report_replaces_an_older_one_and_leaves_other_files(tmp_path):
    folder = tmp_path / "deep" / "out"
    write.write_report(explained(), folder)
    (folder / "mine.png").write_bytes(b"mine")
    write.write_report(identified(), folder)
    names = {p.name for p in folder.iterdir()}
    assert names == {
        "mine.png",
        "report.html",
        "report.json",
        "report_error.png",
        "report_parameter.png",
        "report_residual.png",
        "report_traces.png",
    }
    assert json.loads((folder / "report.json").read_text())["command"] == "identify"
    assert [p.name for p in folder.parent.iterdir()] == ["out"]


def test_nothing_is_left_when_a_figure_fails(tmp_path, monkeypatch):
    def fail(_):
        raise RuntimeError("no picture")

    monkeypatch.setattr(figures, "ranking_figure", fail)
    with pytest.raises(RuntimeError):
        write.write_report(explained(), tmp_path / "new" / "out")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_when_the_disk_fails(tmp_path, monkeypatch):
    def full(*_):
        raise OSError("no space")

    monkeypatch.setattr(files.os, "replace", full)
    with pytest.raises(OSError, match="no space"):
        write.write_report(nothing_missing(), tmp_path / "out")
    assert [p for p in tmp_path.iterdir() if p.name != "out"] == []


AXES = {
    # error, residual, dependence, ranking, parameter
    "explained": (1, 6, 3, 1, 1),
    "nothing_missing": (1, 1, None, 1, 1),
    "unknown": (1, 2, 1, 1, 1),
    "identified": (1, 2, None, None, 1),
}


@pytest.mark.parametrize("name", OUTCOMES)
def test_figures_have_a_panel_for_each_thing(name):
    outcome = OUTCOMES[name]()
    for picture, wanted in zip(
        ("error", "residual", "dependence", "ranking", "parameter"),
        AXES[name],
        strict=True,
    ):
        figure = getattr(write.PICTURES[picture], f"{picture}_figure")(outcome)
        assert (figure and len(figure.axes)) == wanted, picture


def test_figures_leave_the_callers_style_alone():
    import matplotlib

    before = dict(matplotlib.rcParams)
    figures.png(figures.error_figure(explained()))  # pyright: ignore
    assert dict(matplotlib.rcParams) == before


def test_a_bare_outcome_has_no_figures_and_a_page(tmp_path):
    bare = Outcome("identify", "rig", (), (), "nothing missing", "Nothing.", {}, {})
    assert write.report_pictures(bare) == []
    write.write_report(bare, tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "report.html",
        "report.json",
    ]


def test_series_of_nothing_but_gaps_and_missing_signals():
    empty = series("validate.csv", 50, {})
    for array in (empty.t, *empty.before.values(), *empty.signals.values()):
        array[:] = np.nan
    outcome = replace(explained(), series=(replace(empty, signals={}), empty))
    assert residuals.dependence_figure(outcome) is None
    assert residuals.residual_figure(outcome) is None
    time = replace(explained().effects[0], residual_axis="t")
    drifting = residuals.dependence_figure(replace(explained(), effects=(time,)))
    assert drifting is not None and len(drifting.axes) == 2


def test_condensing_keeps_extremes_and_gaps():
    t = np.arange(1000) * 1e-3
    y = np.zeros(1000)
    y[400], y[700:720] = 9.0, np.nan
    at, line = residuals.condensed(t, y, 0.05)
    assert at.size < 80 and np.nanmax(line) == 9.0
    assert np.isnan(line[:-1]).sum() == 1
    assert 0.65 <= at[np.isnan(line)][0] < 0.72


def unpacked(line):
    """Lows and highs of a line of the page, in the channel's printed unit."""
    scale, low, high = line
    whole = [np.frombuffer(base64.b64decode(v or low), "<i2") for v in (low, high)]
    return [np.where(v == -32768, np.nan, v * scale) for v in whole]


def test_the_page_holds_a_short_log_sample_by_sample():
    s = explained().series[0]
    data = explorer.explorer_data(explained())
    assert [(c["name"], c["unit"]) for c in data["channels"]] == [
        ("P_a1", "kPa"), ("P_a2", "kPa"), ("F", "N"),
    ]  # fmt: skip
    log = data["logs"][0]
    assert (log["start"], log["size"]) == (0.5, 23500)
    low, high = unpacked(log["lines"]["P_a1"]["before"])
    wanted = s.before["P_a1"] / 1e3
    assert np.allclose(low, wanted, atol=4e-3, equal_nan=True)
    assert np.array_equal(low, high, equal_nan=True)


def test_the_page_holds_a_long_log_as_its_envelope(monkeypatch):
    monkeypatch.setattr(explorer, "BYTES", 40_000)
    s = explained().series[0]
    data = explorer.explorer_data(replace(explained(), series=(s,)))
    assert len(json.dumps(data)) < 42_000
    log = data["logs"][0]
    low, high = unpacked(log["lines"]["F"]["after"])
    y = s.after["F"]
    assert np.nanmin(low) == pytest.approx(np.nanmin(y), rel=1e-3)
    assert np.nanmax(high) == pytest.approx(np.nanmax(y), rel=1e-3)
    for i in (1, 200, log["size"] - 2):
        off = s.t - (log["start"] + i * log["step"])
        own = y[np.abs(off) < 0.499 * log["step"]]
        near = y[np.abs(off) < 0.501 * log["step"]]
        assert np.min(near) - 1e-3 <= low[i] <= np.min(own) + 1e-3
        assert np.max(own) - 1e-3 <= high[i] <= np.max(near) + 1e-3
    middle = int((s.t[0] + 12.5 - log["start"]) / log["step"])
    assert np.isnan(low[middle])  # the gap stays one


def test_the_page_shows_one_line_where_nothing_was_changed():
    s = explained().series[0]
    same = replace(explained(), series=(replace(s, after=s.before),))
    assert explorer.explorer_data(same)["ways"] == ["after"]
    assert explorer.explorer_data(replace(explained(), series=())) is None


def test_bins_follow_a_line():
    x = np.linspace(-1, 1, 5000)
    at, mean, spread = residuals.binned(x, 3 * x)
    assert np.allclose(mean, 3 * at) and np.all(spread < 0.1)


@pytest.mark.parametrize(
    ("value", "unit", "std", "wanted"),
    [
        (8.576e8, "Pa", 1.23e6, "857.6 ± 1.2 MPa"),
        (8.576e8, "Pa", None, "857.6 MPa"),
        (999.99, "Pa", None, "1 kPa"),
        (2.3014e-9, CHOKED, 1.2e-11, "(2.301 ± 0.012) × 10⁻⁹ m³/(s·V·√Pa)"),
        (60e-6, "m", None, "60 µm"),
        (0.001 - 1e-15, "N", None, "0.001 N"),
        (-1534.0, "N*s/m", 210.0, "−1.53 ± 0.21 kN·s/m"),
        (-0.4, "N", 38.0, "0 ± 38 N"),
        (0.0, "N", None, "0 N"),
        (0.7, "1", 0.0, "0.7"),
        (5.0, "V", np.inf, "5 V"),
        (np.nan, "Pa", 1.0, "–"),
        (1234.0, "kg", 250.0, "1230 ± 250 kg"),
    ],
)
def test_quantities_read_as_an_engineer_writes_them(value, unit, std, wanted):
    assert write.quantity_text(value, unit, std) == wanted


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("P_a1 - P_a2", "Pa"),
        ("abs(u)", "V"),
        ("u_rate", "V/s"),
        ("P_rate", "Pa/s"),
        ("F_rate", "N/s"),
        ("z_rate", "m/s"),
        ("a", "m/s^2"),
        ("psi", "rad"),
        ("temperature", ""),
    ],
)
def test_signals_tell_their_unit(name, wanted):
    assert text.signal_unit(name, "V") == wanted


def test_the_loop_run_again_stands_in_the_page(written):
    text = (written / "explained" / "report.html").read_text(encoding="utf-8")
    assert "The closed loop, run again" in text and "2.83 N" in text
    assert "a pressure left (P_r, P_s)" in text
    found = json.loads((written / "explained" / "report.json").read_text())
    assert found["closed_loop"][0]["tracking_measured"] == 14.1
    other = (written / "identified" / "report.html").read_text(encoding="utf-8")
    assert "closed loop" not in other


# -- inputs, and three splits --


def lied() -> Outcome:
    """An area that is wrong, and the effect that it looks like."""
    area = Finding("area", "factor", 0.98, 6.9, 4.1, "N", "area is 2 % too large")
    return with_inputs(explained(), (area,))


def test_an_input_that_looks_wrong_is_said_first(tmp_path):
    write.write_report(lied(), tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["inputs"] == [
        {
            "input": "area", "finding": "factor", "factor": 0.98, "error": 6.9,
            "error_if_mended": 4.1, "unit": "N", "says": "area is 2 % too large",
            "lines": {}, "mended": False, "effects": [],
        }
    ]  # fmt: skip
    assert report["sentence"].startswith("An input looks wrong")
    assert "area is 2 % too large" in report["sentence"]
    assert "Inputs that look wrong" in (tmp_path / "report.html").read_text()


def test_an_input_that_was_mended_is_said_to_be(tmp_path):
    lines = {"channels": {"u": {"column": "u", "invert": True}}}
    sign = Finding("u", "sign", -1.0, 9.0, 1.0, "Pa", "u runs against", lines)
    area = Finding("area", "factor", 0.98, 6.9, 4.1, "N", "area is 2 % too large")
    outcome = with_inputs(explained(), (replace(sign, mended=True), area))
    assert headline(outcome).startswith("As given, u looked wrong: mended first.")
    assert "With it mended: " in outcome.sentence
    write.write_report(outcome, tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert page.count("This report is of the mended input.") == 1


def test_nothing_is_said_of_inputs_that_are_plausible(tmp_path):
    outcome = with_inputs(explained(), ())
    assert outcome.sentence == explained().sentence
    write.write_report(outcome, tmp_path)
    assert json.loads((tmp_path / "report.json").read_text())["inputs"] == []
    assert "look wrong" not in (tmp_path / "report.html").read_text()


def test_fitted_logs_are_not_called_validated(tmp_path):
    write.write_report(replace(explained(), validate_logs=()), tmp_path)
    page = (tmp_path / "report.html").read_text()
    assert "never fitted" not in page
    assert "on the fitted logs" in page and "validation logs" not in page
    assert json.loads((tmp_path / "report.json").read_text())["logs"]["validate"] == []
