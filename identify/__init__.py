"""What the residual is, what explains it, and the error before and after."""

if __name__ != "hydrojax.identify":
    raise ImportError(
        "this folder is hydrojax.identify: write `import hydrojax.identify` after "
        "`pip install .` (a bare `identify` belongs to another project)"
    )
