"""Gains to bandwidth: not there yet; see the README for what is."""

if __name__ != "hydrojax.tune":
    raise ImportError(
        "this folder is hydrojax.tune: write `import hydrojax.tune` after "
        "`pip install .` (a bare `tune` belongs to another project)"
    )
