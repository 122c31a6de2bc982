"""Windows cut into pieces: one after the other in a program, shared by all cores."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jaxtyping import Array, Int, PyTree

from hydrojax.identify.estimation.columns import HANDFUL, Batch
from hydrojax.jax_setup import cores

PIECE = 96
"""Windows whose pressures are run side by side, at most: with 32 or 256 a step of a fit
takes up to half as long again."""

PIECES = 4
"""Pieces that one call runs at most, so that memory does not grow with the logs."""


class Span(NamedTuple):
    """Some of the pieces that windows are cut into.

    Attributes:
        first: of them.
        end: the first after them.
    """

    first: Int[Array, ""] | np.integer | int
    end: Int[Array, ""] | np.integer | int


def in_pieces(
    part: Callable, size: int, span: Span, *windows: PyTree, most: int = PIECES
) -> PyTree:
    """`part` of arrays with the windows first, in pieces of `size`, one after the other
    if they are many.

    Only the pieces of the span are run, so that one program serves batches that fill it
    by much and by little, and several threads. Their rows stand at the head of what
    comes back, which has room for `most` pieces; those of the rest are 0. `part` is
    given which piece it has, and the windows.
    """
    count = jax.tree.leaves(windows)[0].shape[0]
    if count <= size:
        return part(0, *windows)
    pieces = -(-count // size)
    first, end = span

    def piece(i):
        # The last piece is filled with copies of the last window.
        index = jnp.minimum(i * size + jnp.arange(size), count - 1)
        return part(i, *jax.tree.map(lambda a: a[index], windows))

    # Traced once, for the shapes of what it gives and for the loop.
    traced, gives = jax.make_jaxpr(piece, return_shape=True)(jnp.int32(0))
    leaves, tree = jax.tree.flatten(gives)

    def put_in(i, out):
        found = jaxpr_as_fun(traced)(jnp.int32(i))
        return [a.at[i - first].set(b) for a, b in zip(out, found, strict=True)]

    room = min(pieces, most)
    none = [jnp.zeros((room, *a.shape), a.dtype) for a in leaves]
    out = jax.lax.fori_loop(first, end, put_in, none)
    return jax.tree.unflatten(tree, [a.reshape(-1, *a.shape[2:]) for a in out])


def on_all_cores(run: Callable[[int, Span], PyTree], batch: Batch) -> PyTree:
    """What `run` gives of the pieces of a batch, each core at work on some of them.

    Args:
        run: is given how many windows a piece has, and some of the pieces.
        batch: of which only the windows with a weight are run.

    Returns:
        NumPy's arrays with the windows first, of which those that only fill the last
        piece up stand at the end.
    """
    # Two at least. Not one for each core: sums of other shapes are rounded otherwise,
    # and what is found would depend on the machine.
    half = -(-len(batch.P_0) // (2 * HANDFUL)) * HANDFUL
    size = min(half, PIECE, len(batch.P_0))
    pieces = -(-int(np.sum(np.asarray(batch.weight) > 0)) // size)
    # As many for each core, so that none waits for another.
    calls = min(-(-pieces // (PIECES * cores())) * cores(), pieces)
    ends = np.linspace(0, pieces, calls + 1).astype(np.int32)

    def part(first: np.int32, end: np.int32) -> PyTree:
        out = run(size, Span(first, end))
        return jax.tree.map(lambda a: np.asarray(a)[: (end - first) * size], out)

    parts = at_once(part, ends[:-1], ends[1:])
    return jax.tree.map(lambda *a: np.concatenate(a), *parts)


def at_once(part: Callable, *given: Sequence | np.ndarray) -> list:
    """`part` of the first of all that is given, of the second, ...; on all cores."""
    alone = cores() == 1 or len(given[0]) == 1
    return list(map(part, *given) if alone else _pool().map(part, *given))


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(cores(), "pieces")
