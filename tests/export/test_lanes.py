"""Loops of many rounds in lanes, against the same in Python, instance by instance."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.export.codegen import compiler
from hydrojax.export.codegen.running import flat, stepper

pytestmark = pytest.mark.skipif(
    compiler.compiler() is None, reason="there is no C compiler"
)

ROWS = np.array([[0.3, 2.0], [1.7, 5.0], [0.9, 11.0], [2.5, 1.0], [1.1, 40.0]])
TICKS = np.linspace(-1.0, 1.0, 37)[:, None]


def run(step, state):
    """What is kept of each tick by five instances side by side, [ticks, kept, 5]."""
    made = stepper(
        step, state, ROWS[0], np.zeros(()), [True] * flat(state).size, "test"
    )
    begin = np.tile(np.asarray(flat(state))[:, None], len(ROWS))
    return made(ROWS.T, begin, TICKS, 2)[0]


def by_hand(step, s):
    """The same of a step in Python: `step(row, s, t)` gives s and what is kept."""
    kept = len(step(ROWS[0], s, 0.0)[1])
    out = np.empty((len(TICKS), kept, len(ROWS)))
    for j, row in enumerate(ROWS):
        now = s
        for i, (t,) in enumerate(TICKS):
            now, out[i, :, j] = step(row, now, float(t))
    return out


def test_rounds_that_all_take():
    """A root by halving, whose counter is of no use to it."""

    def step(row, s, t):
        def halve(_, ends):
            low, high = ends
            middle = (low + high) / 2
            over = jnp.exp(middle) + row[0] * middle > 3.0 + t + s
            return jnp.where(over, low, middle), jnp.where(over, middle, high)

        low, high = jax.lax.fori_loop(0, 30, halve, (-4.0 + 0 * t, 4.0 + 0 * t))
        return 0.5 * (low + high), jnp.stack([low, high])

    def plain(row, s, t):
        low, high = -4.0, 4.0
        for _ in range(30):
            middle = (low + high) / 2
            if math.exp(middle) + row[0] * middle > 3.0 + t + s:
                high = middle
            else:
                low = middle
        return 0.5 * (low + high), (low, high)

    np.testing.assert_allclose(run(step, jnp.zeros(())), by_hand(plain, 0.0), 1e-12)


def test_rounds_by_their_number():
    """A counter that is used, two values that change places, and a truth value."""

    def step(row, s, t):
        def turn(i, c):
            a, b, odd = c
            return b + i * row[0], a, ~odd

        a, b, odd = jax.lax.fori_loop(0, 13, turn, (s, t, jnp.asarray(False)))
        return s + 0.01 * a, jnp.stack([a, b, jnp.where(odd, a, b)])

    def plain(row, s, t):
        a, b, odd = s, t, False
        for i in range(13):
            a, b, odd = b + i * row[0], a, not odd
        return s + 0.01 * a, (a, b, a if odd else b)

    np.testing.assert_allclose(run(step, jnp.zeros(())), by_hand(plain, 0.0), 1e-12)


def test_each_goes_on_as_long_as_it_wants():
    """Rounds of another number in each lane, and how many they were."""

    def step(row, s, t):
        def on(c):
            return c[0] < row[1] + t

        def more(c):
            return c[0] * 1.1 + row[0], c[1] + 1

        x, count = jax.lax.while_loop(on, more, (0.1 + s, jnp.asarray(0)))
        return s + 1e-3 * x, jnp.stack([x, count.astype(float)])

    def plain(row, s, t):
        x, count = 0.1 + s, 0
        while x < row[1] + t:
            x, count = x * 1.1 + row[0], count + 1
        return s + 1e-3 * x, (x, count)

    found, wanted = run(step, jnp.zeros(())), by_hand(plain, 0.0)
    np.testing.assert_allclose(found, wanted, 1e-12)
    assert np.ptp(wanted[0, 1]) > 5, "all lanes take as many rounds"


def test_a_loop_in_a_loop():
    def step(row, s, t):
        def inner(j, r):
            return r * row[0] / 3 + t

        def outer(i, c):
            return c + jax.lax.fori_loop(0, 9, inner, 1.0 + c) * 1e-2

        a = jax.lax.fori_loop(0, 12, outer, s)
        return 0.5 * a, a[None]

    def plain(row, s, t):
        a = s
        for _ in range(12):
            r = 1.0 + a
            for _ in range(9):
                r = r * row[0] / 3 + t
            a = a + r * 1e-2
        return 0.5 * a, (a,)

    # Terms near 1 cancel in some lanes, and a compiler may join product and sum.
    found, wanted = run(step, jnp.zeros(())), by_hand(plain, 0.0)
    np.testing.assert_allclose(found, wanted, 1e-12, 1e-15)
