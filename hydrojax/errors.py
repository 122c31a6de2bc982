"""The one error a user's input can raise, and how it names what is near."""

from collections.abc import Iterable
from difflib import get_close_matches

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
