"""The one error a user's input can raise, and how it names what is near."""

from collections.abc import Iterable
from difflib import get_close_matches


class InputError(ValueError):
    """Invalid input, in one line: the file, the column or row, and how to correct it.

    The command line prints the line and exits with 2; library users catch it.
    """


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
            near = get_close_matches(name, known, n=1, cutoff=0.5)
            mend = f"did you mean {near[0]!r}?" if near else f"known: {known}"
            raise InputError(f"{where} unknown {what} {name!r}; {mend}")
