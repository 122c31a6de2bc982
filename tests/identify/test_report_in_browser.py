"""Reports as people open them: quiet, self-contained, narrow and wide, alive."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from hydrojax.api import check
from hydrojax.identify.report import traces, write
from hydrojax.identify.results.outcome import Candidate, Horizon
from hydrojax.report.compare import Pair, compare
from hydrojax.tune.report import write_sweep
from tests.browser import Browser, Page
from tests.identify.test_notebook_views import sweep
from tests.identify.test_report import OUTCOMES, explained
from tests.pages import ROOT
from tests.tunings import tuned
from tests.workflows.test_batch import fleet, good, pretended

WIDTHS = (400, 1600)
DEMO_LOG = ROOT / "hydrojax/demo/validate.csv.gz"
PAGES = (*OUTCOMES, "tuned", "swept", "compared", "checked", "fleet", "job")
RUNS = ("0.25", "1", "5", "free")
LONG = Pair("c_p1", "m^3/(s*V*Pa^0.5)", 2.596336e-9, 2.596314e-9, 5.2e-14, 4.7e-14)
"""As wide as a parameter gets in print."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    found = Browser(tmp_path_factory.mktemp("profile"))
    yield found
    found.close()


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    """Folder with a report of each kind, by its name."""
    top = tmp_path_factory.mktemp("reports")
    for name, make in OUTCOMES.items():
        run = Horizon(231e3, 9.02e3, 1.06e6, 281e3)
        found = make()
        channels = {
            n: replace(c, horizons=dict.fromkeys(RUNS, run))
            for n, c in found.channels.items()
        }
        write.write_report(replace(found, channels=channels), top / name)
    tuned().save(top / "tuned")
    write_sweep(sweep(one=False), top / "swept", "hydrojax sweep rig.toml")
    (top / "compared").mkdir()
    found = compare(top / "explained", top / "unknown")
    found = replace(found, parameters=[*found.parameters, LONG])
    text = found.html("hydrojax compare explained unknown --out compared")
    (top / "compared" / "report.html").write_text(text)
    checked = check(ROOT / "hydrojax/demo/rig.toml", [DEMO_LOG])
    checked.save(top / "checked", "hydrojax check rig.toml log.csv")
    (top / "checked" / "check.html").rename(top / "checked" / "report.html")
    (top / "logs").mkdir()
    logs = good(9, effects=["stribeck"])
    logs[4] = {"bad": "log_4.csv: column 'P_a1 [bar]': row 17: a reason that is long"}
    table = fleet(top / "logs", logs, warm=[20.0 + i for i in range(9)])
    line = "hydrojax batch jobs.csv --out fleet"
    pretended(table, top / "fleet", report=True, command_line=line)
    (top / "fleet" / "fleet.html").rename(top / "fleet" / "report.html")
    (single,) = (top / "fleet" / "reports").glob("*.html")
    single.rename((top / "job").with_suffix(".html"))
    (top / "job").mkdir()
    (top / "job.html").rename(top / "job" / "report.html")
    return top


@pytest.fixture
def page(browser, reports):
    """The page of what was explained, on a wide screen."""
    return Page(browser, reports / "explained" / "report.html", 1600)


def test_a_tap_enlarges_a_picture_on_a_phone(browser, reports):
    seen = Page(browser, reports / "explained" / "report.html", 400)
    wide = "document.querySelector('figure img').offsetWidth"
    before = seen.ask(wide)
    seen.ask("document.querySelector('figure img').focus()")
    seen.settle()
    assert before < 400 and seen.ask(wide) > 600
    assert seen.overflow() <= 0  # the picture moves in its frame, not the page


# -- quiet and whole --

BAD = """<!doctype html><title>bad</title><img src="http://example.org/a.png">
<div class="scroll" style="overflow-x: auto"><p style="width: 1500px">cut</div>
<div style="width: 3000px">wide</div><script>console.error("oh"); null.x;</script>"""


def test_the_watch_sees_what_a_page_does_wrong(browser, tmp_path):
    """What the test below rests on."""
    (tmp_path / "bad.html").write_text(BAD)
    seen = Page(browser, tmp_path / "bad.html", 400)
    said = " ".join(seen.errors())
    assert "oh" in said and "TypeError" in said
    assert seen.requests() == ["http://example.org/a.png"]
    assert seen.overflow() > 1000 and len(seen.cut()) == 1
    assert seen.pictures() == [["", 0]]


@pytest.mark.parametrize("name", PAGES)
def test_a_report_is_quiet_and_fits_the_screen(browser, reports, name):
    seen = Page(browser, reports / name / "report.html", WIDTHS[0])
    for width in WIDTHS:
        seen.widen(width)
        seen.settle()
        assert seen.overflow() <= 0, width
        assert seen.cut() == [], width
    shown = seen.pictures()
    assert shown or name in ("compared", "job")
    assert all(alt and wide > 0 for alt, wide in shown)
    assert seen.requests() == [] and seen.errors() == []


def test_without_scripts_the_pictures_stand_still(browser, reports):
    file = reports / "explained" / "report.html"
    alive, still = Page(browser, file, 400), Page(browser, file, 400, scripts=False)
    shown = "[...document.querySelectorAll('.explorer, .bar, .still')].map(e => {}) "
    shown = shown.replace("{}", "[e.className, e.offsetHeight > 0]")
    assert alive.ask(shown) == [
        ["explorer", True], ["bar", True], ["still", False], ["bar", True],
    ]  # fmt: skip
    assert still.ask(shown) == [
        ["explorer", False], ["bar", False], ["still", True], ["bar", False],
    ]  # fmt: skip
    assert len(rows(still)) == len(told())


# -- the residual, zoomed --

PIXELS = """[...document.querySelectorAll("canvas")].map(c => c.toDataURL())"""


def view(page: Page) -> tuple[float, float]:
    """From when to when the residual is shown, s."""
    said = page.ask("document.querySelector('.explorer output').textContent")
    first, last = re.findall(r"[\d.]+", said)
    return float(first), float(last)


def extremes(page: Page, way: str) -> list[float]:
    """What the force's picture says of its least and largest value, N."""
    said = page.ask("[...document.querySelectorAll('canvas')].at(-1).ariaLabel")
    found = re.search(rf"{way} (\S+) to ([^\s,]+)", said.replace("−", "-"))
    assert found, said
    return [float(x) for x in found.groups()]


def test_zooming_changes_the_view_and_tells_it(page):
    page.settle()
    whole, pictures = view(page), page.ask(PIXELS)
    assert whole == (0.5, 24.0) and len(pictures) == 3
    page.click(".explorer [name=in]")
    first, last = view(page)
    assert last - first == pytest.approx((whole[1] - whole[0]) / 2, abs=0.2)
    assert all(a != b for a, b in zip(pictures, page.ask(PIXELS), strict=True))
    page.click(".explorer [name=left]")
    assert view(page)[0] < first
    page.click(".explorer [name=all]")
    assert view(page) == whole and page.ask(PIXELS) == pictures
    assert page.errors() == []


def test_the_view_holds_the_residual_itself(page):
    """Against the samples that the report was made from."""
    s = explained().series[0]
    page.ask("document.querySelector('.panels').focus()")
    for _ in range(6):
        page.press("+")
    page.press("ArrowRight")
    first, last = view(page)
    assert 0.2 < last - first < 0.5
    inside = (s.t >= first) & (s.t <= last)
    for way, y in (("before", s.before["F"]), ("after", s.after["F"])):
        wanted = [np.nanmin(y[inside]), np.nanmax(y[inside])]
        assert extremes(page, way) == pytest.approx(wanted, rel=0.01)


def test_the_picture_over_time_leads_to_the_same_stretch_to_zoom_into(page):
    outcome = explained()
    name, s = traces.traced(outcome)
    t = s.t[traces.stretch(s.t, s.before[name])]
    page.click(".closer a")
    assert view(page) == pytest.approx((t[0], t[-1]), abs=0.02)
    assert t[-1] - t[0] == pytest.approx(traces.SECONDS, abs=0.02)
    what = page.ask("document.querySelector('.panel .what').textContent")
    assert what == "measured and model"
    assert page.ask("location.hash") == "#explorer" and page.errors() == []
    page.click(".explorer [name=in]")
    first, last = view(page)
    assert last - first == pytest.approx(traces.SECONDS / 2, abs=0.05)


def test_the_drag_of_a_mouse_and_the_pinch_of_fingers(page):
    page.click(".explorer [name=in]")
    before = view(page)
    page.ask("document.querySelector('canvas').scrollIntoView({block: 'center'})")
    box = page.ask(
        "(b => [b.x, b.y, b.width, b.height])"
        "(document.querySelector('canvas').getBoundingClientRect())"
    )
    x, y = box[0] + box[2] / 2, box[1] + box[3] / 2
    for kind, at in (("Pressed", x), ("Moved", x + 90), ("Released", x + 90)):
        page.call(
            "Input.dispatchMouseEvent", type=f"mouse{kind}", x=at, y=y, button="left",
            buttons=int(kind != "Released"), clickCount=1,
        )  # fmt: skip
    page.settle()
    after = view(page)
    span = before[1] - before[0]
    assert before[0] - after[0] == pytest.approx(span * 90 / (box[2] - 60), abs=0.2)

    page.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    for kind, apart in (("Start", 50), ("Move", 100), ("Move", 200), ("End", None)):
        fingers = [] if apart is None else [x - apart, x + apart]
        points = [{"x": f, "y": y, "id": i} for i, f in enumerate(fingers)]
        page.call("Input.dispatchTouchEvent", type=f"touch{kind}", touchPoints=points)
    page.settle()
    now = view(page)
    assert now[1] - now[0] == pytest.approx(span / 4, rel=0.1)
    assert page.errors() == []


def test_lines_can_be_left_out_and_logs_chosen(page):
    page.settle()
    pictures = page.ask(PIXELS)
    page.click(".explorer [name=before]")
    assert all(a != b for a, b in zip(pictures, page.ask(PIXELS), strict=True))
    page.ask(
        "(s => { s.value = '1'; s.dispatchEvent(new Event('change')) })"
        "(document.querySelector('.explorer [name=log]'))"
    )
    page.settle()
    assert view(page) == (0.5, 9.5)
    names = page.ask("[...document.querySelector('.explorer select')].map(o => o.text)")
    assert names == ["validate.csv", "slow <b>.csv"]
    assert page.errors() == []


# -- the table of candidates --


def told() -> list[Candidate]:
    """Candidates of the table; those that are absent are folded below it."""
    return [c for c in explained().candidates if c.status != "absent"]


def rows(page: Page) -> list[str]:
    """Names of the candidates that are seen, in order."""
    return page.ask(
        "[...document.querySelectorAll('#candidates tbody tr')]"
        ".filter(r => r.offsetHeight).map(r => r.cells[0].textContent)"
    )


def test_candidates_are_found_by_text_and_by_status(page):
    every = [c.name for c in write.figures.ranking(explained())]
    assert rows(page) == [n for n in every if n in [c.name for c in told()]]
    page.ask("document.querySelector('#filter input').focus()")
    page.call("Input.insertText", text="Valve_ little")
    assert rows(page) == ["valve_lag"]
    shown = page.ask("document.querySelector('#filter output').textContent")
    assert f"1 of {len(told())}" in shown
    page.ask("document.querySelector('#filter input').select()")
    page.press("Delete")
    page.call("Input.insertText", text="a")
    page.click("#filter [value='cannot tell']")
    assert rows(page) == ["internal_leakage", "position_friction", "valve_lag"]
    assert page.errors() == []


def test_candidates_are_put_in_order(page):
    """What is no number comes last, whichever way."""
    known = [c for c in told() if np.isfinite(c.power)]
    powers = [c.power for c in known]
    heads = "document.querySelectorAll('#candidates th')"
    for falling in (True, False):
        page.ask(f"{heads}[4].querySelector('button').click()")
        got = {c.name: c.power for c in known}
        seen = rows(page)
        assert seen[-1] == "gravity_load"
        assert [got[n] for n in seen[:-1]] == sorted(powers, reverse=falling)
        wanted = "descending" if falling else "ascending"
        assert page.ask(f"{heads}[4].ariaSort") == wanted
    page.ask(f"{heads}[0].querySelector('button').click()")
    assert rows(page) == sorted(c.name for c in told())
    assert page.ask(f"[...{heads}].filter(h => h.ariaSort).length") == 1


def test_a_page_of_many_long_logs_stays_small_and_quick(browser, tmp_path):
    """Six logs of 15 minutes: 3 MB, and an envelope in place of the samples."""
    n = 900_000
    t = 1e-3 * np.arange(n)
    y = np.random.default_rng(1).standard_normal(n)
    y[n // 3] = 1e3
    one = explained().series[0]
    lines = {"F": y}
    long = replace(one, t=t, measured=lines, before=lines, after={"F": 0.5 * y})
    outcome = replace(
        explained(),
        series=tuple(replace(long, log=f"{i}.csv", signals={}) for i in range(6)),
    )
    (tmp_path / "long.html").write_text(
        write.report_page(outcome, [], {"version": "0", "date": "", "command_line": ""})
    )
    assert (tmp_path / "long.html").stat().st_size < 3e6
    page = Page(browser, tmp_path / "long.html", 1600)
    page.settle()
    assert extremes(page, "before")[1] == pytest.approx(1e3, rel=0.01)
    assert extremes(page, "after")[1] == pytest.approx(500, rel=0.01)
    assert page.errors() == []
