# ruff: noqa: E501  (lines of the pages)
"""The pages of the rig file, the commands and report.json."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping
from typing import Any

import typer

from benchmarks.reference.markdown import table, unit
from hydrojax import cli
from hydrojax.logs.tables import SIGNALS, TABLES
from hydrojax.plant.layout import LAYOUTS
from hydrojax.report.schema import report_schema
from hydrojax.rigfile.controller import KEYS, PAPER, written_unit
from hydrojax.rigfile.json_schema import KEY_MEANINGS, MEANINGS
from hydrojax.rigfile.sections import GEOMETRY, LOAD, SUPPLY_UNITS
from hydrojax.rigfile.valve import MEANINGS as VALVE


def rig_file_page() -> str:
    """Every section and key of a rig file."""
    parts = ["# Rig file\n", "TOML. A quantity is text with its unit, `\"8e8 Pa\"`; any "
             "unit of the right dimension is accepted. `hydrojax init` drafts a file; "
             "[rig.schema.json](rig.schema.json) is its JSON schema.\n"]  # fmt: skip
    for name, said in MEANINGS.items():
        title = name if name in ("name", "layout") else f"[{name}]"
        parts += [f"## {title}\n", f"{said}\n"]
        parts.append(_section(name))
    return "\n".join(p for p in parts if p)


def _section(name: str) -> str:
    """The keys of one section."""
    wants = {"geometry": GEOMETRY, "supply": SUPPLY_UNITS, "load": LOAD}
    if name == "layout":
        rows = ((f"`{n}`", ", ".join(f"`{k}`" for k in layout.geometry) or "–",
                 ", ".join(layout.pressures) or "none")
                for n, layout in LAYOUTS.items())  # fmt: skip
        return table(("layout", "geometry it needs", "pressures"), rows)
    if name in wants:
        rows = ((f"`{k}`", unit(u), KEY_MEANINGS[f"{name}.{k}"])
                for k, u in wants[name].items())  # fmt: skip
        return table(("key", "SI unit", "meaning"), rows)
    if name in ("channels", "sensors"):
        rows = ((f"`{k}`", unit(u)) for k, u in SIGNALS.items())
        example = '`u = { column = "MainU", unit = "1", invert = true }`\n\n'
        own = example if name == "channels" else '`F = "2.5 N"`\n\n'
        return own + table(("signal", "SI unit"), rows)
    if name == "controller":
        rows = ((f"`{k}`", unit(written_unit(k)),
                 f"{PAPER[k]:g}" if k in PAPER else "–",
                 g.description + ("; one value, or two bounds" if g.pair else ""))
                for k, g in KEYS.items())  # fmt: skip
        return table(("key", "unit of a bare number", "default", "meaning"), rows)
    if name == "valve":
        return table(("key", "meaning"), ((f"`{k}`", m) for k, m in VALVE.items()))
    links = {
        "parameters": "[Every parameter](parameters.md). "
        '`beta = { start = "8e8 Pa", range = ["1e8 Pa", "3e9 Pa"] }`\n',
        "effects": "[Every effect](effects.md).\n",
    }
    return links.get(name, "")


def commands_page() -> str:
    """Every command with its arguments and options."""
    group: Any = typer.main.get_command(cli.app)
    parts = ["# Commands\n", "Exit status: 0 when the work was done, 2 on bad input with "
             "one line, 1 where `--fail-on` says so, a job of a batch failed or a tuning "
             "finds no gains that hold. Logs are "
             + ", ".join(f"`{e}`" for e in TABLES)
             + ", `.mcap` or a ROS 2 bag's folder. `hydrojax --install-completion` sets "
             "up completion for your shell.\n"]  # fmt: skip
    for name in sorted(group.commands):
        command = group.commands[name]
        parts += [f"## {name}\n", inspect.cleandoc(command.help or "") + "\n"]
        rows = (
            (f"`{_called(p)}`", _plain(getattr(p, "help", None)), _default(p))
            for p in command.params
        )
        parts.append(table(("argument or option", "meaning", "default"), rows))
    return "\n".join(parts)


def _plain(text: str | None) -> str:
    """A help text, of which Markdown takes nothing for emphasis."""
    return re.sub(r"([*_<\[\]])", r"\\\1", text or "–")


def _called(parameter: Any) -> str:
    """What a parameter of a command is called on the line."""
    if parameter.param_type_name == "argument":
        return (parameter.name or "").upper() + ("..." if parameter.nargs == -1 else "")
    return ", ".join(parameter.opts)


def _default(parameter: Any) -> str:
    if isinstance(parameter.show_default, str):
        return parameter.show_default
    value = parameter.default
    if callable(value) or value in (None, "", False) or value == ():
        return "–"
    return f"`{value}`"


def report_page() -> str:
    """Every key of report.json."""
    schema = report_schema()
    keys, known = schema["properties"], schema.get("$defs", {})
    rows = (
        (f"`{name}`", _type(shape, known), shape.get("description", ""))
        for name, shape in keys.items()
    )
    parts = [
        "# report.json\n",
        "`identify` and `trace` write it beside the page. SI units; `null` is no finite "
        "number. Readers ignore keys that they do not know. "
        "[report.schema.json](report.schema.json) is its JSON schema.\n",
        table(("key", "type", "meaning"), rows),
    ]
    return "\n".join([*parts, *_nested(keys, known, set())])


def _nested(
    keys: Mapping[str, Shape], known: Mapping[str, Shape], shown: set[str], at: str = ""
) -> Iterator[str]:
    """A table for each kind of table that keys hold, where it is first met."""
    for name, shape in keys.items():
        inner = _inner(_real(shape, known), known)
        if inner is None or not inner.get("properties") or inner["title"] in shown:
            continue
        shown.add(inner["title"])
        own = inner["properties"]
        rows = (
            (f"`{k}`", _type(v, known), v.get("description", ""))
            for k, v in own.items()
        )
        yield f"{'###' if at else '##'} {at}{name}\n"
        yield " ".join(inner.get("description", "").split()) + "\n"
        yield table(("key", "type", "meaning"), rows)
        yield from _nested(own, known, shown, f"{name}.")


Shape = Mapping[str, Any]


def _real(shape: Shape, known: Mapping[str, Shape]) -> Shape:
    """A shape itself, where it is given by its name, or may be null."""
    if "$ref" in shape:
        return _real(known[shape["$ref"].rsplit("/", 1)[-1]], known)
    some = [s for s in shape.get("anyOf", ()) if s.get("type") != "null"]
    return _real(some[0], known) if len(some) == 1 else shape


def _inner(shape: Shape, known: Mapping[str, Shape]) -> Shape | None:
    """The table that a key holds, or that each entry of its list or table is."""
    inner = shape.get("items") or shape.get("additionalProperties")
    if isinstance(inner, Mapping):
        return _real(inner, known)
    return shape if "properties" in shape else None


def _type(shape: Shape, known: Mapping[str, Shape]) -> str:
    """A type of the schema in words."""
    null = any(s.get("type") == "null" for s in shape.get("anyOf", ()))
    shape = _real(shape, known)
    if "enum" in shape:
        return " or ".join(f"`{v}`" for v in shape["enum"] if v)
    if "const" in shape:
        return f"`{shape['const']}`"
    named = shape.get("type", "value")
    kinds = [named] if isinstance(named, str) else list(named)
    inner = shape.get("items") or shape.get("additionalProperties")
    if "prefixItems" in shape:
        kinds = ["pair"]
    if isinstance(inner, Mapping):
        of = _real(inner, known)
        what = "tables" if "properties" in of else f"{_type(inner, known)}"
        what = f"({what})" if " or " in what else what
        kinds[0] = f"{what} by name" if kinds[0] == "object" else f"list of {what}"
    said = ["table" if k == "object" else k for k in kinds] + ["null"] * null
    return " or ".join(dict.fromkeys(said))
