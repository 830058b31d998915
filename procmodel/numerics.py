"""Functions whose value and gradient both stay finite at the edge of their domain."""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


def safe_sqrt(x: ArrayLike) -> Array:
    """Square root that is 0 with gradient 0 for x <= 0.

    Parameters
    ----------
    x : array_like
        Any real numbers.

    Returns
    -------
    Array
        ``sqrt(x)`` where x > 0, else 0.
    """
    x = jnp.asarray(x)
    inside = x > 0
    # The inner `where` keeps the branch not taken away from sqrt'(0) = inf,
    # which would turn into NaN in the gradient.
    return jnp.where(inside, jnp.sqrt(jnp.where(inside, x, 1.0)), 0.0)
