"""What objects show in a notebook: tables with the numbers, the telling picture."""

from __future__ import annotations

import sys
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from hydrojax.errors import InputError
from hydrojax.identify.report import interactive, write
from hydrojax.identify.results.outcome import Outcome
from hydrojax.tune import metrics
from hydrojax.tune.accessor import sentences
from tests.identify.test_report import (
    OUTCOMES,
    Page,
    explained,
    identified,
    nothing_missing,
)
from tests.tunings import tuned


class Tables(HTMLParser):
    """Every table's rows of cells; fails where a tag is left open."""

    def __init__(self, text: str):
        super().__init__()
        self.open: list[str] = []
        self.tables: list[list[list[str]]] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.tables[-1][-1][-1] += data


def bare(text: str) -> None:
    """Nothing is asked for from outside, and nothing runs."""
    page = Page(text)
    assert not page.addresses and not page.images and "script" not in page.tags
    assert "url(" not in text and "nan" not in text and "None" not in text


@pytest.mark.parametrize("name", OUTCOMES)
def test_an_outcome_shows_its_verdict_in_a_notebook(name):
    outcome = OUTCOMES[name]()
    text = write.result_html(outcome)
    bare(text)
    assert f"{outcome.verdict}." in Page(text).said
    assert outcome.sentence in Page(text).said
    assert Tables(text).tables


def test_an_outcome_shows_effects_channels_and_parameters():
    effects, channels, found = Tables(write.result_html(explained())).tables
    assert effects[1:] == [
        ["internal leakage", "c_il", "(1.030 ± 0.014) × 10⁻¹² m³/(s·Pa)",
         "< 10⁻⁶", ""],
        ["position friction", "a_1", "0.2100 ± 0.0040", "< 10⁻⁶",
         "gravity load or stribeck"],
    ]  # fmt: skip
    assert channels[3] == [
        "F", "2.5 N", "31 N", "2.6 N", "1.04 × noise", "at its noise",
    ]  # fmt: skip
    rows = {row[0]: row[1:] for row in found}
    # 857.6 ± 1.96 * 1.23 MPa
    assert rows["beta"][:2] == ["857.6 ± 1.2 MPa", "855.19 MPa to 860.01 MPa"]
    assert "not identified" in rows["k_0"][2]
    assert "z_ss" not in rows  # held, so nothing was found
    assert "internal_leakage.c_il" in rows


def test_an_outcome_plots_what_tells_most():
    assert len(write.plot(explained()).axes) == 3  # against the signal of each effect
    assert len(write.plot(nothing_missing()).axes) == 1
    assert len(write.plot(explained(), "residual").axes) == 6
    assert isinstance(write.plot(identified(), "parameter"), Figure)


@pytest.mark.parametrize(
    ("picture", "says"),
    [("residuum", "write one of traces"), ("loop", "nothing to show in loop")],
)
def test_a_picture_that_is_not_there_is_refused_in_one_line(picture, says):
    with pytest.raises(InputError, match=says):
        write.plot(identified(), picture)


def test_an_outcome_with_nothing_shows_its_sentence():
    empty = Outcome("identify", "rig", (), (), "nothing missing", "Nothing.", {}, {})
    assert Tables(write.result_html(empty)).tables == []
    with pytest.raises(InputError, match="nothing to show"):
        write.plot(empty)


def test_text_of_a_log_does_not_become_markup():
    outcome = replace(explained(), rig="<b>rig</b> & co", sentence="a < b")
    text = write.result_html(outcome)
    assert "&lt;b&gt;rig&lt;/b&gt; &amp; co" in text and "a &lt; b" in text
    cells = replace(outcome, channels={"<i>": explained().channels["F"]})
    assert "<i>" not in write.result_html(cells)


# -- the gains --


def test_a_tuning_shows_gains_metrics_and_limits():
    t = tuned()
    text = t._repr_html_()
    bare(text)
    gains, merit, limits = Tables(text).tables
    assert gains[1:] == [
        ["k_p", "1.2", "1.31", "V/kN"], ["k_f", "2.4", "3.2", "V/kN"],
    ]  # fmt: skip
    assert merit[2] == ["Within 1 dB", "16 Hz", "14 Hz", "32 Hz", "28 Hz"]
    assert limits[1] == ["spool: ten times as fast", "38 Hz", "+36 %"]
    gain, phase = t.plot().axes
    assert "dB" in gain.get_ylabel() and "deg" in phase.get_ylabel()


def sweep(one: bool) -> xr.Dataset:
    """What a sweep of k_p, or of k_p and k_f, gives; k_p k_f Hz wide."""
    k_p, k_f = np.array([0.5, 1.0, 2.0]), np.array([1.0] if one else [1.0, 3.0])
    hertz = metrics.grid(1000.0)
    band = k_p[:, None] * k_f
    data = xr.Dataset(
        attrs={"title": "rig: gains to bandwidth", "rig": "rig", "methods": "linear"}
    )
    for name, values, here in (("k_p", k_p, 1.2), ("k_f", k_f, 2.4)):
        attrs = {"units": "V/kN", "long_name": f"what {name} is", "rig_value": here}
        data[name] = (name, values, attrs)
    for name in ("within_1dB", "peak", "lag_90", "radius", "minus_3dB"):
        values = np.full(band.shape, 0.5) if name == "radius" else band
        attrs = {"units": "Hz", "long_name": name}
        data[f"linear_{name}"] = (("k_p", "k_f"), values, attrs)
    data["linear_hertz"] = ("linear_hertz", hertz, {"units": "Hz"})
    for name in ("gain", "phase"):
        table = np.zeros((*band.shape, hertz.size))
        data[f"linear_{name}"] = (("k_p", "k_f", "linear_hertz"), table)
    return data


def test_a_sweep_shows_its_gist_and_its_axes():
    text = sweep(one=False).hydrojax._repr_html_()
    bare(text)
    said = Page(text).said
    widest = "widest band within 1 dB 6.0 Hz at k_p = 2, k_f = 3 (at an end of k_p)"
    assert f"{widest}, peak 6.0 dB" in said
    assert "with a peak of at most 3 dB: 3.0 Hz at k_p = " in said
    assert Tables(text).tables[0][1:] == [
        ["k_p", "what k_p is", "3", "0.5 to 2 V/kN", "1.2"],
        ["k_f", "what k_f is", "2", "1 to 3 V/kN", "2.4"],
    ]


def test_a_sweep_plots_a_map_or_lines():
    data = sweep(one=False)
    titles = [ax.get_title() for ax in data.hydrojax.plot().axes]
    assert "linearised, adaptation frozen" in titles
    assert data.hydrojax.plot("peak").get_suptitle() == "rig: peak"
    assert len(sweep(one=True).hydrojax.plot().axes) == 4
    assert sentences(data)[0].startswith("linear: widest")


def test_a_sweep_refuses_what_it_does_not_hold():
    with pytest.raises(InputError, match="'gain': expected one of lag_90, minus_3dB"):
        sweep(one=False).hydrojax.plot("gain")
    for part in (xr.Dataset(), sweep(one=False)[["linear_peak"]]):
        with pytest.raises(InputError, match="not a whole sweep"):
            part.hydrojax.plot("peak")
    with pytest.raises(InputError, match="no axis of the sweep is left"):
        sweep(one=False).isel(k_p=0, k_f=0).hydrojax.plot()


def test_a_sweep_summarises_itself_and_draws_bode_plots():
    data = sweep(one=False)
    title, line = data.hydrojax.summary().split("\n")
    assert title == "rig: gains to bandwidth" and line == sentences(data)[0]
    chosen = data.hydrojax.plot_bode().axes
    assert [ax.get_title().partition("\n")[0] for ax in chosen[:2]] == [
        "next to the rig's gains", "widest within 1 dB",
    ]  # fmt: skip
    own = data.hydrojax.plot_bode({"low": {"k_p": 0, "k_f": -1}}).axes
    assert own[0].get_title() == "low\nk_p = 0.5, k_f = 3"
    assert len(own) == 2 and "dB" in own[0].get_ylabel()


def test_a_bode_plot_of_no_cell_is_refused():
    data = sweep(one=False)
    with pytest.raises(InputError, match="an index for each of k_p, k_f"):
        data.hydrojax.plot_bode({"low": {"k_p": 0}})
    with pytest.raises(InputError, match="an index of k_p below 3, got 3"):
        data.hydrojax.plot_bode({"low": {"k_p": 3, "k_f": 0}})
    for view in (xr.Dataset().hydrojax.plot_bode, xr.Dataset().hydrojax.summary):
        with pytest.raises(InputError, match="not a whole sweep"):
            view()


def test_a_tuning_plots_what_its_limits_cost():
    t = tuned()
    (ax,) = t.plot("limits").axes
    assert [label.get_text() for label in ax.get_yticklabels()] == [
        "spool: ten times as fast"
    ]
    with pytest.raises(InputError, match="'step': expected one of bode, limits"):
        t.plot("step")
    with pytest.raises(InputError, match="no limit was examined"):
        replace(t, relaxed=()).plot("limits")


# -- pictures to zoom into and slide through --


def test_an_outcome_is_explored_measured_against_model():
    pytest.importorskip("plotly", reason="plotly is not installed: [notebook]")
    outcome = explained()
    figure: Any = interactive.explore(outcome)
    (menu,) = figure.layout.updatemenus
    shown = [b.label for b in menu.buttons]
    s = outcome.series[0]
    assert shown[: len(s.before)] == [f"{name}, {s.log}" for name in s.before]
    own = [line for line in figure.data if line.visible]
    by_name = {line.name: line for line in own}
    assert {"measured", "model before", "model after"} <= set(by_name)
    name = next(iter(s.before))
    good = np.isfinite(s.measured[name])
    measured = np.asarray(by_name["measured"].y, float)
    factor = np.nanmax(s.measured[name][good]) / np.nanmax(measured)
    off = np.asarray(by_name["residual after"].y, float) * factor
    assert np.nanmax(off) == pytest.approx(np.nanmax(s.after[name]), rel=1e-3)
    last = menu.buttons[-1].args[0]["visible"]
    assert len(last) == len(figure.data) and not last[0] and last[-1]
    rest = replace(outcome, series=())
    with pytest.raises(InputError, match="no residual"):
        interactive.explore(rest)


def test_a_sweep_slides_over_its_last_axis():
    pytest.importorskip("plotly", reason="plotly is not installed: [notebook]")
    data = sweep(one=False)
    figure = data.hydrojax.explore("peak")
    (slider,) = figure.layout.sliders
    assert [float(s.label) for s in slider.steps] == data.k_f.values.tolist()
    assert slider.currentvalue.prefix == "k_f (V/kN): "
    for i, step in enumerate(slider.steps):
        lines = [
            line
            for line, seen in zip(figure.data, step.args[0]["visible"], strict=True)
            if seen
        ]
        np.testing.assert_array_equal(lines[0].y, data.linear_peak.isel(k_f=i))
        assert len(lines) == 2  # the gain of the widest cell of this slice
        widest = int(np.argmax(data.isel(k_f=i).linear_within_1dB.values))
        assert f"k_p = {float(data.k_p[widest]):.3g}" in lines[1].name
    single = sweep(one=True).hydrojax.explore()
    assert len(single.layout.sliders[0].steps) == len(single.data) / 3
    with pytest.raises(InputError, match="'gain': expected one of"):
        data.hydrojax.explore("gain")


def test_without_plotly_the_mend_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly", None)
    with pytest.raises(InputError, match=r"pip install 'hydrojax\[notebook\]'"):
        sweep(one=False).hydrojax.explore()
