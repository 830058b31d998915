"""The affine-invariant stretch move, all ensembles in one compiled loop over the steps.

Each ensemble is split in two halves; a walker of one half is stretched along the line to a walker
of the other (Goodman and Weare). Same algorithm as emcee's default, without leaving the device.

References
----------
.. [1] J. Goodman and J. Weare, "Ensemble samplers with affine invariance", Comm. App. Math. Comp.
   Sci. 5(1), 65-80, 2010.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.samplers.driver import State, Steps

STRETCH = 2.0

LogDensity = Callable[[Array, Any], Array]


class StretchSampler:
    """Several independent ensembles that move together.

    Parameters
    ----------
    log_density : callable
        ``log_density(vector, arguments)`` of one vector of shape (p,); hashable, for it is
        compiled in.
    start : ndarray, shape (ensembles, walkers, p)
        First positions; walkers even.
    arguments : pytree
        Handed to `log_density`.
    warmup : int
        Steps thrown away.
    seed : int
        Same seed, same draws.
    """

    most = 256

    def __init__(
        self, log_density: LogDensity, start: np.ndarray, arguments: Any, warmup: int, seed: int
    ):
        self.warmup = warmup
        self._log_density = log_density
        self._start = start
        self._arguments = arguments
        self._seed = seed

    def begin(self) -> State:
        """Positions, their densities, and the random key."""
        positions = jnp.asarray(self._start)
        densities = _densities(self._log_density, positions, self._arguments)
        key = jax.random.key_data(jax.random.key(self._seed))
        return {"key": key, "positions": positions, "densities": densities}

    def warm_up(self, state: State, count: int) -> State:
        """Steps that are not kept."""
        return self._advance(state, count)[0]

    def advance(self, state: State, count: int) -> tuple[State, Steps]:
        """Steps that are kept."""
        state, parts = self._advance(state, count)
        positions, densities, moved = (np.asarray(part)[:count] for part in parts)
        return state, Steps(positions, densities, moved, np.zeros(moved.shape, bool))

    def _advance(self, state: State, count: int) -> tuple[State, tuple[Array, Array, Array]]:
        held = {name: jnp.asarray(array) for name, array in state.items()}
        return _advance(self._log_density, held, self._arguments, count, self.most)


@functools.partial(jax.jit, static_argnames="log_density")
def _densities(log_density: LogDensity, positions: Array, arguments: Any) -> Array:
    return jax.vmap(jax.vmap(lambda v: log_density(v, arguments)))(positions)


@functools.partial(jax.jit, static_argnames=("log_density", "most"))
def _advance(
    log_density: LogDensity, state: dict[str, Array], arguments: Any, count: Array, most: int
) -> tuple[dict[str, Array], tuple[Array, Array, Array]]:
    """Make `count` steps of at most `most`; the new state, and what each step left.

    The number of steps is an argument, not part of the program: however a run is cut into pieces,
    the same program makes the same steps.
    """
    shape = (most, *state["densities"].shape)
    chain = (
        jnp.zeros((*shape, state["positions"].shape[-1])),
        jnp.zeros(shape),
        jnp.zeros(shape, bool),
    )

    def step(i: Array, carry: tuple) -> tuple:
        (key, positions, densities), chain = carry
        half = positions.shape[1] // 2
        # All random numbers of a step at once: each call of the generator costs as much as many.
        key, now = jax.random.split(key)
        first, second = jax.random.uniform(now, (2, 3, positions.shape[0], half))
        a, b = positions[:, :half], positions[:, half:]
        lp_a, lp_b = densities[:, :half], densities[:, half:]
        a, lp_a, moved_a = _stretch(log_density, first, a, lp_a, b, arguments)
        b, lp_b, moved_b = _stretch(log_density, second, b, lp_b, a, arguments)
        positions = jnp.concatenate([a, b], axis=1)
        densities = jnp.concatenate([lp_a, lp_b], axis=1)
        moved = jnp.concatenate([moved_a, moved_b], axis=1)
        chain = tuple(
            jax.lax.dynamic_update_index_in_dim(part, new, i, 0)
            for part, new in zip(chain, (positions, densities, moved), strict=True)
        )
        return (key, positions, densities), chain

    key = jax.random.wrap_key_data(state["key"])
    carry = ((key, state["positions"], state["densities"]), chain)
    (key, positions, densities), chain = jax.lax.fori_loop(0, count, step, carry)
    state = {"key": jax.random.key_data(key), "positions": positions, "densities": densities}
    return state, chain


def _stretch(
    log_density: LogDensity, uniform: Array, moving: Array, lp: Array, others: Array, arguments: Any
) -> tuple[Array, Array, Array]:
    """Stretch every walker of one half towards or away from a random one of the other half."""
    count = moving.shape[-1]
    choose, scale, accept = uniform
    partner = jnp.floor(choose * others.shape[1]).astype(int)
    anchors = jnp.take_along_axis(others, partner[..., None], axis=1)
    z = ((STRETCH - 1.0) * scale + 1.0) ** 2 / STRETCH
    proposal = anchors + z[..., None] * (moving - anchors)
    new_lp = jax.vmap(jax.vmap(lambda v: log_density(v, arguments)))(proposal)
    # A ball stretched by z in p dimensions has z^(p-1) times the shell's volume.
    ratio = (count - 1) * jnp.log(z) + new_lp - lp
    taken = jnp.log(accept) < ratio
    return jnp.where(taken[..., None], proposal, moving), jnp.where(taken, new_lp, lp), taken
