"""What the pages show: their code blocks, their commands, and what those printed."""

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
TUTORIAL = ROOT / "docs/tutorial.md"

FRAME = re.compile("[\u2500-\u257f]+")
"""What frames a table."""

NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.]*\w)")
CLOSE = 2e-3
"""How far a printed number may be from the page's, relative, beyond its last figure:
far above what processors differ by, below what any change of the method does."""


def blocks(path: Path, *kinds: str) -> Iterator[str]:
    """A page's code blocks of these kinds."""
    fence = re.compile(r"^```([^\n]*)\n(.*?)^```", re.M | re.S)
    for kind, text in fence.findall(path.read_text(encoding="utf-8")):
        if kind.strip() in kinds:
            yield text


def commands(path: Path) -> list[str]:
    """Every `hydrojax ...` line of a page's shell blocks, continued lines joined."""
    text = "\n".join(blocks(path, "", "bash", "console", "sh"))
    lines = (line.strip() for line in text.replace("\\\n", " ").splitlines())
    return [line for line in lines if line.startswith("hydrojax ")]


def differences(shown: str, printed: str) -> list[str]:
    """Where a block of a page differs from what its command printed.

    Compared are words and numbers, paragraph by paragraph; frames of tables, line ends
    and what the page leaves out between paragraphs are not.
    """
    whole, out = _flat(printed), []
    for part in shown.strip().split("\n\n"):
        flat = _flat(part)
        pattern = r"(\d+(?:\.\d+)?)".join(map(re.escape, NUMBER.split(flat)))
        match = re.search(pattern, whole)
        if match is None:
            out.append(f"not printed: {flat}")
            continue
        for text, found in zip(NUMBER.findall(flat), match.groups(), strict=True):
            last = 10.0 ** -len(text.partition(".")[2])
            if abs(float(text) - float(found)) > last + CLOSE * abs(float(text)):
                out.append(f"{text} is printed as {found}: {flat}")
    return out


def _flat(text: str) -> str:
    return " ".join(FRAME.sub(" ", text).split())
