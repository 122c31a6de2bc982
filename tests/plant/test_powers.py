"""Logarithm and powers against NumPy, their derivatives against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np

from hydrojax.plant.powers import log, power

X = np.concatenate([np.geomspace(1e-300, 1e300, 4001), 1 + np.linspace(-0.4, 0.6, 999)])


def test_a_logarithm_is_that_of_numpy():
    np.testing.assert_allclose(log(jnp.asarray(X)), np.log(X), rtol=1e-15, atol=3e-16)


def test_what_is_not_finite_stays_so():
    assert np.isnan(log(jnp.asarray(np.nan))) and np.isnan(power(jnp.array(np.nan), 2))
    assert log(jnp.asarray(np.inf)) == np.inf


def test_a_power_and_its_first_two_derivatives_are_the_closed_forms():
    x = np.geomspace(1e-4, 1e3, 301)
    for a in (0.02, 1 / 1.4, 1.5, 4.0):
        np.testing.assert_allclose(power(jnp.asarray(x), a), x**a, rtol=1e-13)
        by_x = jax.vmap(jax.grad(power), (0, None))(jnp.asarray(x), a)
        np.testing.assert_allclose(by_x, a * x ** (a - 1), rtol=1e-13)
        by_a = jax.vmap(jax.grad(power, 1), (0, None))(jnp.asarray(x), a)
        np.testing.assert_allclose(by_a, x**a * np.log(x), rtol=1e-12, atol=1e-15)
        twice = jax.vmap(jax.grad(jax.grad(power)), (0, None))(jnp.asarray(x), a)
        np.testing.assert_allclose(twice, a * (a - 1) * x ** (a - 2), rtol=1e-11)


def test_single_precision_stays_so():
    x = jnp.asarray([0.5, 2.0], jnp.float32)
    assert power(x, jnp.float32(1.5)).dtype == jnp.float32
