"""Windows of a large map in a loop, and linear maps that are their own transpose.

Reverse mode would add a whole map of zeros for every window read. Here a window is taken and put
back by a pair of linear functions whose transposes touch the window only.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array, lax
from jax.custom_derivatives import linear_call


def take_window(maps: Array, start: tuple[Any, ...], shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Read a window that `put_window` at the same place must put back.

    Parameters
    ----------
    maps : Array, shape (n, m)
        The map.
    start : tuple of int
        First cell of the window.
    shape : tuple of int
        Cells of the window, the same number of indices.

    Returns
    -------
    maps : Array, shape (n, m)
        The map, of which nothing within the window may be used but by `put_window`.
    window : Array, shape `shape`
        The window.
    """

    def read(start: tuple, maps: Array) -> tuple[Array, Array]:
        return maps, _read(maps, start, shape)

    # The map's own cotangent holds within the window what came from behind `put_window`, which
    # replaced it: it is replaced here.
    def written(start: tuple, cotangents: tuple[Array, Array]) -> Array:
        maps, window = cotangents
        return lax.dynamic_update_slice(maps, window, start)

    return linear_call(read, written, start, maps)


@jax.custom_jvp
def put_window(maps: Array, window: Array, start: tuple[Any, ...]) -> Array:
    """The map of `take_window` with the window replaced."""
    return lax.dynamic_update_slice(maps, window, start)


@put_window.defjvp
def _put_tangents(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    # A rule of its own only because `linear_call` does not take tangents that are absent.
    _, window, start = primals
    shape = window.shape

    def write(start: tuple, both: tuple[Array, Array]) -> Array:
        return lax.dynamic_update_slice(both[0], both[1], start)

    def read(start: tuple, maps: Array) -> tuple[Array, Array]:
        return maps, _read(maps, start, shape)

    return put_window(*primals), linear_call(write, read, start, (tangents[0], tangents[1]))


def _read(maps: Array, start: tuple[Any, ...], shape: tuple[int, ...]) -> Array:
    # Without the barrier the read is fused into what uses the window, also after the map has been
    # written to, and the compiler copies the whole map at every step.
    return lax.optimization_barrier(lax.dynamic_slice(maps, start, shape))


def symmetric(matrix: Callable[[Any, Array], Array], constants: Any, vector: Array) -> Array:
    """Product of a symmetric matrix, given as a function of constants, with a vector."""
    return linear_call(matrix, matrix, constants, vector)


def quarter_turned(square: Array, turns: Array) -> Array:
    """A square map turned counter-clockwise by quarter turns, shape (n, n)."""
    return lax.switch(turns % 4, [lambda a, k=k: jnp.rot90(a, k) for k in range(4)], square)
