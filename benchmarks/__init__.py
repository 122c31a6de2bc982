"""Studies that are too slow for the suite; each prints its own table."""
