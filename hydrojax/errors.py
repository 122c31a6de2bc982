"""The one error a user's input can raise, and how large an input may be.

What is beyond is refused in one line before it is worked on: no sound rig file or log
comes near, and a hostile one cannot take the machine's memory or its time.
`docs/security.md` lists the limits.
"""

import gzip
import stat
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path

MOST = 1200
"""Characters of a line for people; of a longer one the middle is left out."""


def one_line(text: object, most: int = MOST) -> str:
    """Text as one line that a terminal shows as it is.

    Characters that move the cursor, colour, turn the writing round or cannot be encoded
    are written as escapes.

    Args:
        text: anything.
        most: characters; of more, the middle is left out.
    """
    said = str(text)
    if len(said) > most:
        said = f"{said[: 2 * most // 3]} … {said[-(most // 3) :]}"
    if said.isprintable():
        return said
    escaped = (c.encode("unicode_escape").decode() for c in said)
    return "".join(
        c if c.isprintable() else e for c, e in zip(said, escaped, strict=True)
    )


class InputError(ValueError):
    """Invalid input, in one line: the file, the column or row, and how to correct it.

    The command line prints the line and exits with 2; library users catch it.
    """

    def __str__(self) -> str:
        """The line, whatever stands in the names that it quotes."""
        return one_line(" ".join(map(str, self.args)))


def check_known(
    where: str, given: Iterable[str], known: Iterable[str], what: str
) -> None:
    """Refuse the first name that is not known, and suggest the nearest.

    Args:
        where: opens the line of the error.
        given: names.
        known: those that are valid.
        what: a name is called in the error.

    Raises:
        InputError: a name that is not known.
    """
    known = list(known)
    for name in given:
        if name not in known:
            near = get_close_matches(name[:80], known, n=1, cutoff=0.5)
            mend = f"did you mean {near[0]!r}?" if near else f"known: {known}"
            raise InputError(f"{where} unknown {what} {name!r}; {mend}")


TEXT = 2**20
"""Bytes of a rig file, or of the first line of a CSV."""

REPORT = 2**26
"""Bytes of a report.json."""

WORD = 200
"""Characters of a quantity, of a column's name, or of a name of rig or log."""

MEMBERS = 10_000
"""Columns, variables, or topics of one file."""

COUNT = 10_000
"""Values of one axis, and plants of an ensemble."""

CELLS = 1_000_000
"""Cells of a sweep, over all axes and plants."""

SAMPLES = 10_000_000
"""Samples of a simulated run."""

SPARED = 2**26
"""Bytes that any file may expand to in memory."""

_PIECE = 2**20

EXPANSION = 100
"""How many times its own size a larger file may expand to."""


def check_expansion(size: int, path: Path) -> None:
    """Refuse contents that take far more memory than their file.

    Args:
        size: bytes in memory.
        path: the file.

    Raises:
        InputError: it expands beyond `EXPANSION` and `SPARED`.
    """
    most = max(SPARED, EXPANSION * path.stat().st_size)
    if size > most:
        raise InputError(
            f"{path}: would take {size / 2**20:,.0f} MiB of memory, and a file of its "
            f"size at most {most / 2**20:,.0f}; export it again with less compression"
        )


def check_members(count: int, path: Path) -> None:
    """Refuse a file of more columns or variables than `MEMBERS`.

    Raises:
        InputError: it has more.
    """
    if count > MEMBERS:
        raise InputError(
            f"{path}: {count} columns are more than the {MEMBERS} that are read; "
            "export those that are needed"
        )


class BoundedGzip(gzip.GzipFile):
    """A gzipped file that is refused where it expands beyond `check_expansion`."""

    def read(self, size: int | None = -1) -> bytes:
        """The next bytes; never all at once."""
        found = gzip.GzipFile.read(self, _PIECE if size is None or size < 0 else size)
        check_expansion(self.tell(), Path(str(self.name)))
        return found

    def read1(self, size: int = -1) -> bytes:
        """The next bytes."""
        return self.read(min(size, _PIECE) if size > 0 else _PIECE)


def file_text(path: Path, most: int, mend: str) -> str:
    """The text of a file, UTF-8.

    Args:
        path: the file.
        most: bytes it may have.
        mend: closes the line of an error.

    Raises:
        InputError: no file, no regular file, too large, or not UTF-8.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise InputError(f"{path}: is not a regular file; {mend}")
        with path.open("rb") as file:
            content = file.read(most + 1)
    except (FileNotFoundError, NotADirectoryError) as err:
        raise InputError(f"{path}: no such file; check the path") from err
    except (OSError, ValueError) as err:  # ValueError: a NUL in the path
        if isinstance(err, InputError):
            raise
        raise InputError(f"{path}: cannot be read; {mend}") from err
    if len(content) > most:
        raise InputError(f"{path}: is larger than {most} bytes; {mend}")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        raise InputError(f"{path}: not text in UTF-8 ({err}); {mend}") from err
    return text.replace("\r\n", "\n").replace("\r", "\n")
