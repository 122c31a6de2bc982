"""Scans over many steps, and steps that are launched whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Jaxpr, jaxpr_as_fun
from jaxtyping import Array, PyTree

try:
    from jax.experimental.scheduling_groups import xla_metadata_call
except ImportError:  # another version of JAX
    xla_metadata_call = None


_JAXPRS = (Jaxpr, ClosedJaxpr)


def in_one_kernel(step: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """A step of a scan, as one kernel of XLA's on a CPU.

    XLA makes a kernel of every few operations otherwise, and launches them one by one:
    of a step on a hundred windows that takes longer than what they do. What a caller
    does with the results is no longer fused with the step, nor is the step worked out
    anew for it.

    Elsewhere, where JAX knows no such mark, and where the step multiplies matrices, it
    is the step itself: XLA refuses some such products in a kernel of many operations.

    Args:
        step: of pytrees of arrays, to pytrees of arrays; vmapped and differentiated
            forward it stays one kernel.
    """
    mark = xla_metadata_call
    if mark is None or jax.default_backend() != "cpu":
        return step

    def call(*args: PyTree) -> PyTree:
        traced, gives = jax.make_jaxpr(step, return_shape=True)(*args)
        if _multiplies_matrices(traced.jaxpr):
            return step(*args)
        # What the step closes over is given to the kernel, too.
        every = [*traced.consts, *jax.tree.leaves(args)]
        varies = [isinstance(a, Tracer) and a.size > 0 for a in every]

        def whole(*given: Array) -> list[Array]:
            left = iter(given)
            filled = [
                next(left) if v else jnp.zeros_like(a) if isinstance(a, Tracer) else a
                for a, v in zip(every, varies, strict=True)
            ]
            consts, inputs = filled[: len(traced.consts)], filled[len(traced.consts) :]
            run = jaxpr_as_fun(ClosedJaxpr(traced.jaxpr, consts))
            return _asking(given, run(*inputs))

        given = (a for a, v in zip(every, varies, strict=True) if v)
        out = mark(whole, inlineable="false", xla_cpu_small_call="true")(*given)
        return jax.tree.structure(gives).unflatten(out)

    return call


def _multiplies_matrices(jaxpr: Jaxpr) -> bool:
    """Whether there is a product of matrices in it, or in what it calls."""
    for eqn in jaxpr.eqns:
        if eqn.primitive.name == "dot_general":
            return True
        for inner in jax.tree.leaves(
            list(eqn.params.values()), is_leaf=lambda p: isinstance(p, _JAXPRS)
        ):
            own = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
            if isinstance(own, Jaxpr) and _multiplies_matrices(own):
                return True
    return False


def _asking(given: Sequence[Array], out: Sequence[Array]) -> list[Array]:
    """What a step gives, unchanged, in a way that asks for all that it is given: over a
    kernel with an argument that nothing in it uses XLA ends the process.
    """
    each = sum((jnp.ravel(a)[0] * 1.0 for a in given), jnp.zeros(()))
    never = jnp.isnan(each) & jnp.isinf(each)  # no pass of XLA's knows
    return [jnp.where(never, each.astype(o.dtype), o) for o in out]


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
        last = jnp.broadcast_to(a[-1:], (blocks * size - n, *a.shape[1:]))
        return jnp.concatenate([a, last]).reshape(blocks, size, *a.shape[1:])

    def block(carry, steps):
        carry, stacked = jax.lax.scan(step, carry, steps)
        return carry, kept(stacked)

    out = jax.lax.scan(block, first, jax.tree.map(cut, over))[1]
    return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:])[:n], out)
