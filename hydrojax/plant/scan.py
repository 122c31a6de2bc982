"""Scans over many steps."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import PyTree


def scan_in_blocks(
    step: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]],
    first: PyTree,
    over: PyTree,
    kept: Callable[[PyTree], PyTree] = lambda stacked: stacked,
) -> PyTree:
    """What `jax.lax.scan` of `step` stacks, run in blocks of some sqrt(n) of n steps.

    XLA's CPU compiler, with the options of `programs.compiled` and `jax_setup.FITS`,
    copies all that a scan has stacked so far at each of its steps: most of a fit's time
    where windows are long. Of a block little is copied, and the whole once a block.

    Args:
        step: from a carry and one step's inputs to the next carry and what is stacked.
        first: the carry to begin with.
        over: the inputs; every array has n steps on its first axis.
        kept: what is kept of a block's stack, with its steps on the first axis.

    Returns:
        The second of what `step` returns, or what is kept of it, with n on the first
        axis of every array.
    """
    n = len(jax.tree.leaves(over)[0])
    size = max(1, int(n**0.5))
    blocks = -(-n // size)

    def cut(a):
        index = jnp.minimum(jnp.arange(blocks * size), n - 1)
        return a[index].reshape(blocks, size, *a.shape[1:])

    def block(carry, steps):
        carry, stacked = jax.lax.scan(step, carry, steps)
        return carry, kept(stacked)

    out = jax.lax.scan(block, first, jax.tree.map(cut, over))[1]
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:n], out)
