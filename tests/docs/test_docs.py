"""The site builds without a warning; the program takes what its pages show."""

from __future__ import annotations

import ast
import contextlib
import inspect
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import tomlkit
import typer

import hydrojax as hj
from hydrojax import cli
from hydrojax.effects import load_effects
from hydrojax.rigfile.schema import RigFile
from tests.browser import Browser, Page
from tests.pages import ROOT, TUTORIAL, blocks, commands

PAGES = sorted((ROOT / "docs").rglob("*.md"))
README = ROOT / "README.md"


# -- the site --


def built(
    site: Path, config: Path = ROOT / "mkdocs.yml"
) -> subprocess.CompletedProcess:
    """Build the site; whatever would go to the network goes to a closed port."""
    nowhere = dict.fromkeys(("http_proxy", "https_proxy"), "http://127.0.0.1:9")
    words = ("build", "--strict", "-f", config, "--site-dir", site)
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", *words],
        cwd=ROOT,
        env={**os.environ, **nowhere, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    pytest.importorskip("material", reason="mkdocs-material is not installed: [docs]")
    pytest.importorskip("mkdocstrings_handlers.python")
    folder = tmp_path_factory.mktemp("site")
    done = built(folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.mark.slow
def test_the_site_builds_without_a_warning(site):
    """Links, anchors, navigation and docstrings are all in order."""
    assert (site / "index.html").is_file()


@pytest.mark.slow
def test_every_page_is_there(site):
    pages = {p.relative_to(ROOT / "docs").with_suffix(".html") for p in PAGES}
    assert pages <= {p.relative_to(site) for p in site.rglob("*.html")}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "hydrojax.identify.case.open_case",
        "hydrojax.identify.api.trace_case",
        "hydrojax.identify.result.Result.plot",
        "hydrojax.plant.step.step",
        "hydrojax.control.loop.run",
        "hydrojax.control.simulation.simulate_loop",
        "hydrojax.control.adaptive.Law",
        "hydrojax.plant.friction.Friction",
        "hydrojax.plant.chambers.Chambers",
        "hydrojax.effects.load_effects",
        "hydrojax.tune.api.sweep",
        "hydrojax.jax_setup.set_up_jax",
        "hydrojax.export.formats.export",
        "hydrojax.logs.log.Log.load",
    ],
)
def test_the_api_pages_hold(site, name):
    text = "".join(p.read_text(encoding="utf-8") for p in (site / "api").glob("*.html"))
    assert f'id="{name}"' in text


SIDEWAYS = (
    "[...document.querySelectorAll('.md-content *')].filter(e => e.clientWidth && "
    "e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).overflowX != 'visible')"
    ".map(e => e.textContent.slice(0, 60))"
)
"""What a page has to be scrolled sideways for, inside frames of its own."""


@pytest.mark.slow
def test_pages_fit_the_screen(site, tmp_path):
    """A phone's and a desk's: nothing goes sideways, and no picture is missing. On a
    phone, code and the widest tables do inside their frames.
    """
    browser = Browser(tmp_path)
    try:
        for name in sorted(site.rglob("*.html")):
            for width in (400, 1600):
                seen = Page(browser, name, width)
                assert seen.overflow() <= 0, (name, width)
                assert width == 400 or seen.ask(SIDEWAYS) == [], name
            assert all(alt and wide for alt, wide in seen.pictures()), name
            seen.close()
        seen = Page(browser, site / "index.html", 1600)
        for wanted, scheme in (("dark", "slate"), ("light", "default")):
            media = [{"name": "prefers-color-scheme", "value": wanted}]
            seen.call("Emulation.setEmulatedMedia", features=media)
            seen.settle()
            got = seen.ask("document.body.getAttribute('data-md-color-scheme')")
            assert got == scheme
    finally:
        browser.close()


FETCHED = re.compile(
    r"<(?:script|img|iframe|source)\b[^>]*?\bsrc=[\"']?(?:https?:)?//[^\s\"'>]+"
    r"|<link\b(?![^>]*canonical)[^>]*?\bhref=[\"']?(?:https?:)?//[^\s\"'>]+"
    r"|@import[^;]*//[^;]+|url\([\"']?(?:https?:)?//[^)]+\)"
)
"""What a browser would get from elsewhere on opening a page."""


@pytest.mark.slow
def test_a_reader_s_browser_fetches_nothing(site):
    """Scripts, style sheets, pictures and fonts all come from the site itself."""
    for path in (*site.rglob("*.html"), *site.rglob("*.css")):
        assert not FETCHED.search(path.read_text(encoding="utf-8")), path


@pytest.mark.parametrize(
    "text",
    [
        '<script defer src="https://example.org/a.js"></script>',
        '<link rel="stylesheet" href="//example.org/a.css">',
        "@font-face{src:url(https://example.org/a.woff2)}",
    ],
)
def test_what_would_be_fetched_is_seen(text):
    assert FETCHED.search(text)


def test_a_broken_link_and_a_broken_anchor_fail_the_build(tmp_path):
    """What the build is trusted with, seen once."""
    pytest.importorskip("material", reason="mkdocs-material is not installed: [docs]")
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    validation = re.search(r"^validation:\n(?:  .*\n)+", text, re.M)
    assert validation
    (tmp_path / "mkdocs.yml").write_text(
        f"site_name: broken\nstrict: true\n{validation[0]}"
    )
    (tmp_path / "docs").mkdir()
    page = tmp_path / "docs" / "index.md"
    for link, code in (("#here", 0), ("#gone", 1), ("gone.md", 1)):
        page.write_text(f"# Here\n\n[a link]({link})\n")
        assert built(tmp_path / "site", tmp_path / "mkdocs.yml").returncode == code, (
            link
        )


# -- the first page --


def dead_links(text: str, folder: Path) -> list[str]:
    """Links of a page to files of the repository, or headings in them, that are not
    there.
    """
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    slugify = pytest.importorskip("markdown.extensions.toc").slugify
    inside = [link.partition("#")[::2] for link in links if "://" not in link]
    gone = [file for file, _ in inside if file and not (folder / file).exists()]
    for file, anchor in inside:
        if anchor and file not in gone:
            page = (folder / file).read_text(encoding="utf-8") if file else text
            if anchor not in {slugify(h, "-") for h in HEADING.findall(page)}:
                gone.append(f"{file}#{anchor}")
    return gone


HEADING = re.compile(r"^#+ (.+)$", re.M)


def test_the_readme_is_short_and_its_links_lead_somewhere():
    text = README.read_text(encoding="utf-8")
    assert len(text.encode()) <= 8000
    assert dead_links(text, ROOT) == []
    assert dead_links("[a](docs/gone.md) [b](docs/index.md)", ROOT) == ["docs/gone.md"]
    links = "[a](docs/limits.md#limits) [b](docs/limits.md#none) [c](#one)\n## One"
    assert dead_links(links, ROOT) == ["docs/limits.md#none"]


# -- the commands that the pages show --


def parse(line: str) -> typer.Context | None:
    """Take a command line apart as the program does, without running it."""
    group: Any = typer.main.get_command(cli.app)
    words = cli.spread(shlex.split(line, comments=True)[1:])
    context = group.make_context("hydrojax", words)
    name, command, rest = group.resolve_command(
        context, [*context._protected_args, *context.args]
    )
    return command.make_context(name, rest, parent=context)


SHOWN = [
    pytest.param(line, id=f"{path.name}: {line}"[:80])
    for path in (*PAGES, README)
    for line in commands(path)
]


@pytest.mark.parametrize("line", SHOWN)
def test_a_command_shown_is_taken(line):
    with contextlib.suppress(typer.Exit):  # an option that prints and exits
        parse(line)


def test_there_are_commands():
    assert len(SHOWN) > 20


@pytest.mark.parametrize(
    "line", ["hydrojax trase rig.toml", "hydrojax tune rig.toml --speed 3"]
)
def test_a_command_that_is_none_is_not_taken(line):
    with pytest.raises(Exception, match=r"(?i)no such"):
        parse(line)


def test_the_tutorial_s_last_command_runs(call, tmp_path, monkeypatch):
    """On the demo's rig in place of the tuned one, which takes minutes to make."""
    (line,) = (c for c in commands(TUTORIAL) if " export " in c)
    (tmp_path / "tuned").mkdir()
    rig = (ROOT / "hydrojax/demo/rig.toml").read_text()
    (tmp_path / "tuned/rig.toml").write_text(rig)
    monkeypatch.chdir(tmp_path)
    said = call(*shlex.split(line)[1:])
    assert said.code == 0, said.err
    made = json.loads((tmp_path / "exported/rig.json").read_text())
    assert made["name"] == "demo rig"
    assert (tmp_path / "exported/law.c").is_file()


# -- the rig files that the pages show --

BASE = {
    "layout": "pull-pull",
    "geometry": {"area": "1.18e-3 m^2", "chamber_length": "0.2 m"},
}


def merged(base: Mapping, over: Mapping) -> dict:
    """Two trees of tables as one; the second has the last word."""
    out = dict(base)
    for key, value in over.items():
        both = isinstance(value, Mapping) and isinstance(base.get(key), Mapping)
        out[key] = merged(base[key], value) if both else value
    return out


RIGS = [
    pytest.param(text, id=f"{path.name} {i}")
    for path in (*PAGES, README)
    for i, text in enumerate(blocks(path, "toml"))
    if not text.startswith("[project")  # of a package, not of a rig
]


@pytest.fixture
def own_effects(tmp_path, vocabulary):
    """The effect that a page writes, known while the test runs."""
    page = ROOT / "docs/your_own_effect.md"
    (tmp_path / "my_effects.py").write_text(next(blocks(page, "python")))
    load_effects(tmp_path / "my_effects.py")


@pytest.mark.parametrize("text", RIGS)
def test_a_rig_file_shown_is_taken(text, tmp_path, own_effects):
    """Each piece, completed where it shows only a section."""
    shown = tomllib.loads(text)
    path = tmp_path / "rig.toml"
    whole = merged({"name": "shown", **BASE}, shown)
    path.write_text(tomlkit.dumps(whole))
    RigFile.load(path)


# -- the Python that the pages show --

KINDS = {
    "result": hj.Result,
    "rig": hj.RigFile,
    "run": hj.Simulation,
    "log": hj.Log,
}
"""What the pages call such an object."""

PYTHON = [
    pytest.param(text, id=f"{path.name} {i}")
    for path in (*PAGES, README)
    if path.name != "api.md"
    for i, text in enumerate(blocks(path, "python"))
]


def unknown_names(code: str) -> list[str]:
    """Names of `hydrojax`, or of what it gives, that are not there, and calls with
    arguments that are not taken.
    """
    out = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            of = hj if node.value.id == "hj" else KINDS.get(node.value.id)
            if of and not hasattr(of, node.attr) and node.attr not in FIELDS:
                out.append(f"{node.value.id}.{node.attr}")
    calls = (n for n in ast.walk(ast.parse(code)) if isinstance(n, ast.Call))
    for node in calls:
        called = node.func
        if isinstance(called, ast.Attribute) and isinstance(called.value, ast.Name):
            thing = getattr(hj, called.attr, None) if called.value.id == "hj" else None
            if callable(thing):
                taken = inspect.signature(thing).parameters
                given = [k.arg for k in node.keywords if k.arg]
                out += [f"hj.{called.attr}({k}=)" for k in given if k not in taken]
    return out


FIELDS = {f for kind in KINDS.values() for f in getattr(kind, "__annotations__", ())}


@pytest.mark.parametrize("text", PYTHON)
def test_python_shown_names_what_is_there(text):
    assert unknown_names(text) == []


def test_python_that_names_what_is_not_there_is_seen():
    code = "import hydrojax as hj\nrun = hj.simulat(rig)\nhj.fit(rig, logs, tests=[])\n"
    assert unknown_names(code) == ["hj.simulat", "hj.fit(tests=)"]
    assert unknown_names("result.plott()") == ["result.plott"]
