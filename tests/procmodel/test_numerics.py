"""Values and gradients at the edge of the domain."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from procmodel.numerics import safe_sqrt

TRANSFORMED = {
    "plain": jax.grad(safe_sqrt),
    "jit": jax.jit(jax.grad(safe_sqrt)),
    "forward": jax.jacfwd(safe_sqrt),
    "vmap": lambda x: jax.vmap(jax.grad(safe_sqrt))(jnp.stack([x, jnp.asarray(4.0)]))[0],
}


@pytest.mark.parametrize("x", [0.0, 1e-300, 0.25, 2.0, 1e300])
def test_is_the_square_root_inside(x):
    assert float(safe_sqrt(x)) == pytest.approx(np.sqrt(x), rel=1e-15)


@pytest.mark.parametrize("x", [-0.0, -1e-300, -1.0, -np.inf])
def test_is_zero_outside(x):
    assert float(safe_sqrt(x)) == 0.0


@pytest.mark.parametrize("transform", TRANSFORMED)
@pytest.mark.parametrize("x", [0.0, -1e-12, -3.0])
def test_gradient_is_zero_at_and_below_the_edge(transform, x):
    # Without the guard the square root's derivative is infinite or NaN here.
    assert not np.isfinite(float(jax.grad(jnp.sqrt)(jnp.asarray(x))))
    assert float(TRANSFORMED[transform](jnp.asarray(x))) == 0.0


@pytest.mark.parametrize("transform", TRANSFORMED)
@pytest.mark.parametrize("x", [1e-8, 0.3, 7.0])
def test_gradient_inside(transform, x):
    assert float(TRANSFORMED[transform](jnp.asarray(x))) == pytest.approx(0.5 / np.sqrt(x))


def test_composed_gradient_stays_finite():
    # A hemisphere's half width through and below its pole.
    slope = jax.vmap(jax.grad(lambda z: safe_sqrt(1.0 - z**2)))(jnp.array([0.0, 0.6, 1.0, 1.5]))
    np.testing.assert_allclose(slope, [0.0, -0.75, 0.0, 0.0], rtol=1e-14)


def test_takes_python_numbers_and_integers():
    assert float(safe_sqrt(9)) == 3.0
    np.testing.assert_array_equal(safe_sqrt(np.array([-4, 0, 4])), [0.0, 0.0, 2.0])
