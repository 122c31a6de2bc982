"""`python -m hydrojax.cli`."""

from hydrojax.cli import main

main()
