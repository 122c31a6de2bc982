# ruff: noqa: E501  (lines of the page)
"""The page of the Python names: every public one with its signature and docstring."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from types import ModuleType

import hydrojax as hj

SAID = """\
Everything that `import hydrojax as hj` offers, with what it takes, gives and raises. Arrays
have their shape in square brackets; everything is SI unless a quantity is given as text with
its unit, such as `"300 N"`. [API](../api/index.md) has the modules behind these names.
"""
"""What stands above the names."""

LINES = ",\n    "
"""Between the arguments of a long call."""

SECTIONS = re.compile(
    r"^(Args|Attributes|Returns|Raises|Warns|Yields|Examples|Note):$", re.M
)


def api_page() -> str:
    """Every public name of `hydrojax`."""
    parts = ["# Python names\n", SAID]
    things = {name: getattr(hj, name) for name in sorted(hj.__all__)}
    rooms = {n: t for n, t in things.items() if isinstance(t, ModuleType)}
    for name, thing in things.items():
        if name not in rooms:
            parts += _described(f"hj.{name}", thing, 2)
    for name, room in rooms.items():
        parts += [f"## hj.{name}\n", markdown(room)]
        for own in sorted(getattr(room, "__all__", ())):
            thing = getattr(room, own)
            if callable(thing) and getattr(thing, "__module__", "").startswith("hydro"):
                parts += _described(f"hj.{name}.{own}", thing, 3)
    return "\n".join(parts)


def _described(name: str, thing: object, level: int) -> Iterator[str]:
    """Heading, signature and docstring of a function or class, and its methods."""
    yield f"{'#' * level} {name}\n"
    if not (isinstance(thing, type) and issubclass(thing, Exception)):
        yield f"```text\n{signature(name, thing)}\n```\n"
    yield markdown(thing)
    if isinstance(thing, type):
        for own, method in _methods(thing):
            yield f"**`{_call(own, method)}`**\n"
            yield markdown(method)


def _methods(kind: type) -> Iterator[tuple[str, object]]:
    """Public methods and properties that a class defines itself, in order."""
    for name, thing in vars(kind).items():
        if name.startswith("_"):
            continue
        if isinstance(thing, classmethod | staticmethod):
            thing = thing.__func__
        func = getattr(thing, "func", None) or getattr(thing, "fget", None) or thing
        func = inspect.unwrap(func) if callable(func) else func
        if inspect.isfunction(func) and (func.__doc__ or "").strip():
            yield name, thing


def signature(name: str, thing: object) -> str:
    """The call, one argument a line where it is long."""
    try:
        found = inspect.signature(thing)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return name
    whole = f"{name}{_annotated(found)}"
    if len(whole) <= 88:
        return whole
    return f"{name}{_annotated(found, LINES)}"


def _call(name: str, thing: object) -> str:
    """A method's call as one line; a property is its name."""
    if isinstance(thing, property) or hasattr(thing, "func"):
        kind = getattr(thing, "fget", None) or getattr(thing, "func", None)
        gives = inspect.signature(kind).return_annotation if kind else ""
        return f"{name}: {_plain(gives)}"
    found = inspect.signature(thing)  # type: ignore[arg-type]
    own = [p for n, p in found.parameters.items() if n not in ("self", "cls")]
    return f"{name}{_annotated(found.replace(parameters=own))}"


def _annotated(found: inspect.Signature, between: str = ", ") -> str:
    """Parameters with annotations and defaults, and what is returned."""
    words, starred = [], False
    for p in found.parameters.values():
        if p.kind is p.KEYWORD_ONLY and not starred:
            words.append("*")
        starred |= p.kind in (p.KEYWORD_ONLY, p.VAR_POSITIONAL)
        name = {p.VAR_POSITIONAL: "*", p.VAR_KEYWORD: "**"}.get(p.kind, "") + p.name
        if p.annotation is not p.empty:
            name += f": {_plain(p.annotation)}"
        if p.default is not p.empty:
            name += f" = {_default(p.default)}"
        words.append(name)
    gives = found.return_annotation
    end = "" if gives in (found.empty, None) else f" -> {_plain(gives)}"
    if "\n" in between and words:
        return f"(\n    {between.join(words)},\n){end}"
    return f"({between.join(words)}){end}"


def _default(value: object) -> str:
    """A default as one would write it."""
    if inspect.isfunction(value):
        return "..."
    text = repr(value)
    made = re.match(r"(\w+)\(", text)
    return f"{made[1]}()" if made and len(text) > 24 else text


def _plain(annotation: object) -> str:
    """An annotation as it stands in the code."""
    if isinstance(annotation, str):
        return annotation
    own = isinstance(annotation, type)
    text = annotation.__name__ if own else str(annotation)
    return re.sub(r"\b(?:[a-z_]\w*\.)+", "", text)


def markdown(thing: object) -> str:
    """A docstring with its sections as Markdown."""
    text = inspect.cleandoc(getattr(thing, "__doc__", "") or "")
    head, *rest = SECTIONS.split(text)
    out = [head.strip() + "\n"] if head.strip() else []
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        if title == "Examples":
            out.append(f"```python\n{_code(body)}\n```\n")
            continue
        out.append(f"*{title}*\n")
        lines = inspect.cleandoc("\n" + body.strip("\n")).splitlines()
        out.append("\n".join(_items(lines)) + "\n")
    return "\n".join(out)


def _items(lines: list[str]) -> Iterator[str]:
    """`name: meaning` as list entries; other lines go on as they are."""
    for line in lines:
        found = re.match(r"([*\w][\w*, ]*): (.*)", line)
        yield f"- `{found[1]}`: {found[2]}" if found else line


def _code(body: str) -> str:
    """An example without its prompts."""
    lines = inspect.cleandoc("\n" + body.strip("\n")).splitlines()
    return "\n".join(re.sub(r"^(>>>|\.\.\.) ?", "", line) for line in lines)
