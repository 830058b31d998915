"""Derivatives one after the other, for functions through which `vmap` does not go."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_derivatives import SymbolicZero

Named = dict[str, Array]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def one_by_one(function: Callable[[Named], Array], params: Named) -> Array:
    """A function of named numbers whose derivatives are taken one direction at a time.

    `jax.jacfwd` maps all directions at once through a function. Here it meets one matrix of
    derivatives, found by a loop, that the directions are multiplied by.

    Parameters
    ----------
    function : callable
        ``function(params)``; hashable, closing over known numbers only.
    params : dict of str to Array, shape ()
        Where it is evaluated; numbers that do not move cost nothing.

    Returns
    -------
    Array
        The function's value.
    """
    return function(params)


@functools.partial(one_by_one.defjvp, symbolic_zeros=True)
def _directional(
    function: Callable[[Named], Array], primals: tuple, tangents: tuple
) -> tuple[Array, Array]:
    (params,), (directions,) = primals, tangents
    moving = [n for n, along in directions.items() if not isinstance(along, SymbolicZero)]
    point = jnp.stack([params[name] for name in moving])

    def at(vector: Array) -> Array:
        return function(params | dict(zip(moving, vector, strict=True)))

    units = jnp.eye(len(moving))
    columns = jax.lax.map(lambda unit: jax.jvp(at, (point,), (unit,))[1], units)
    along = jnp.stack([directions[name] for name in moving])
    return one_by_one(function, params), jnp.tensordot(along, columns, axes=1)
