"""The one error a user's input can raise."""


class InputError(ValueError):
    """Invalid input, in one line: the file, the column or row, and how to correct it.

    The command line prints the line and exits with 2; library users catch it.
    """
