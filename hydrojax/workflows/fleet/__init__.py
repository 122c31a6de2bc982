"""Many logs at once: a table of jobs, the work on them, what came of it.

`jobs` reads the table, `work` does one job, `store` keeps results, `local` and
`cluster` share the work out, `run` is the whole of it, `summary` and `report` look over
the fleet.
"""
