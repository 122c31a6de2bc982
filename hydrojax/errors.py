"""The one error a user's input can raise."""


class InputError(ValueError):
    """Bad input, said in one line: the file, the column or row, and the mend.

    The command line prints the line and exits with 2; library users catch it.
    """
