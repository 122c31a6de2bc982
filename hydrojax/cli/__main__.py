"""`python -m hydrojax.cli`."""

from . import main

main()
