"""Gains to bandwidth: sweep them, map what they give, tune them."""

if __name__ != "hydrojax.tune":
    raise ImportError(
        "this folder is hydrojax.tune: write `import hydrojax.tune` after "
        "`pip install .` (a bare `tune` belongs to another project)"
    )
