"""Scans over many steps."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import PyTree


def scan_in_blocks(
    step: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]], first: PyTree, over: PyTree
) -> tuple[PyTree, PyTree]:
    """`jax.lax.scan` of `step`, in blocks of some sqrt(n) of the n steps: its last
    carry and what each step returns, stacked.

    XLA's CPU compiler, with the options that fits are compiled with, copies all that a
    scan has stacked so far at each of its steps: over 270 steps that took three
    quarters of a fit's time. Of a block little is copied, and the whole once a block.
    The last block is filled with copies of the last step, so the carry is the one
    after those.
    """
    n = len(jax.tree.leaves(over)[0])
    size = max(1, int(n**0.5))
    blocks = -(-n // size)

    def cut(a):
        index = jnp.minimum(jnp.arange(blocks * size), n - 1)
        return a[index].reshape(blocks, size, *a.shape[1:])

    def block(carry, steps):
        return jax.lax.scan(step, carry, steps)

    last, out = jax.lax.scan(block, first, jax.tree.map(cut, over))
    return last, jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:n], out)
