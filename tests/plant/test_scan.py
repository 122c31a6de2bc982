"""Steps that XLA compiles as one kernel: the same numbers, in fewer launches."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hydrojax.plant.scan import in_one_kernel, scan_in_blocks

GIVEN = np.linspace(0.1, 2.0, 7)


def chain(x, y):
    for k in range(1, 6):
        x, y = x + jnp.sin(k * y) / k, jnp.where(x > 1, y * x, y - jnp.exp(-x))
    return {"x": x, "pair": (y, x * y)}


def by_hand(x, y):
    for k in range(1, 6):
        x, y = x + np.sin(k * y) / k, np.where(x > 1, y * x, y - np.exp(-x))
    return x, y, x * y


def test_a_step_in_one_kernel_gives_what_it_gives():
    out = jax.jit(in_one_kernel(chain))(GIVEN, 0.3 * GIVEN)
    x, y, product = by_hand(GIVEN, 0.3 * GIVEN)
    np.testing.assert_allclose(out["x"], x, rtol=1e-13)
    np.testing.assert_allclose(out["pair"][0], y, rtol=1e-13)
    np.testing.assert_allclose(out["pair"][1], product, rtol=1e-13)


def test_it_may_close_over_what_is_traced_be_vmapped_and_differentiated():
    def last(a, rows):
        step = in_one_kernel(lambda s, r: (jnp.cos(a * s) + r, s * a))
        return jax.lax.scan(step, a, rows)[0]

    def by_numpy(a, rows):
        s = a
        for r in rows:
            s = np.cos(a * s) + r
        return s

    rows = np.arange(21.0).reshape(3, 7) / 20
    at = 0.7
    one = jax.vmap(lambda r: jax.jvp(lambda a: last(a, r), (at,), (1.0,)))
    value, slope = jax.jit(one)(rows)
    np.testing.assert_allclose(value, [by_numpy(at, r) for r in rows], rtol=1e-12)
    d = 1e-6
    expected = [(by_numpy(at + d, r) - by_numpy(at - d, r)) / (2 * d) for r in rows]
    np.testing.assert_allclose(slope, expected, rtol=1e-7)


@pytest.mark.parametrize("spare", [GIVEN, 2.0, np.zeros((7, 0)), np.int32(3), True])
def test_what_a_step_does_not_ask_for_does_not_matter(spare):
    """XLA may end the process over an argument of a kernel that nothing in it uses: all
    that has elements is asked for.
    """

    def step(x, unused):
        return x * 2, (x, jnp.zeros_like(unused))

    def run(x, unused):
        return jax.lax.fori_loop(
            0, 3, lambda _, x: in_one_kernel(step)(x, unused)[0], x
        )

    program = jax.jit(run).lower(GIVEN, jnp.asarray(spare)).compile()
    np.testing.assert_array_equal(program(GIVEN, jnp.asarray(spare)), 8 * GIVEN)
    if jax.default_backend() == "cpu":
        (call,) = re.findall(r" call\((.*?)\), .*inlineable", program.as_text())
        assert call.count("%") == 1 + (np.size(spare) > 0)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="XLA's CPU compiler")
def test_a_step_is_launched_once():
    rows = jnp.ones((50, 7))

    def launches(step):
        """Kernels of the scan's body."""
        scan = jax.jit(
            lambda a: jax.lax.scan(lambda c, r: (step(c, r)["x"], c), a, rows)
        )
        text = scan.lower(GIVEN).compile().as_text()
        name = re.search(r"body=%(\S+?)[,\s]", text)[1]
        body = text[text.index(f"\n%{name} (") :].split("\n}")[0]
        return len(re.findall(r" (?:fusion|call|reduce|sine|multiply|add)\(", body))

    def sums(x, y):
        for k in range(1, 9):
            x, y = x + jnp.sum(jnp.sin(y / k)), y * jnp.max(x)
        return {"x": x + y}

    assert launches(in_one_kernel(sums)) < 0.5 * launches(sums)


def test_a_step_that_multiplies_matrices_runs_too():
    """XLA has no kernel of several operations for some such products."""
    weights = jnp.arange(21.0).reshape(7, 3)

    def step(x, _):
        x = jnp.sin(
            x + jax.jit(lambda a: a[:, None] ** jnp.arange(3.0))(x) @ weights[0]
        )
        return x, jnp.stack([x, x + (x @ weights)[0]])

    def run(step):
        return jax.jit(lambda x: jax.lax.scan(step, x, jnp.zeros(5)))(GIVEN)[1]

    np.testing.assert_allclose(run(in_one_kernel(step)), run(step), rtol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 10, 16, 17, 250])
def test_blocks_stack_what_a_scan_stacks(n):
    rows = np.random.default_rng(n).normal(size=(n, 4))

    def step(carry, row):
        carry = 0.9 * carry + row
        return carry, (carry, row[0])

    out = scan_in_blocks(step, jnp.zeros(4), jnp.asarray(rows))
    state, stacked = np.zeros(4), []
    for row in rows:
        state = 0.9 * state + row
        stacked.append(state)
    np.testing.assert_allclose(out[0], stacked, rtol=1e-13)
    np.testing.assert_array_equal(out[1], rows[:, 0])
