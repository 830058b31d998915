"""The affine-invariant stretch move, all ensembles and steps in one compiled loop.

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

from calibration.samplers.ensemble import EnsembleDraws, longest_autocorrelation

STRETCH = 2.0
# Parts that a run is cut into, so that progress can be told.
_CHUNKS = 10

LogDensity = Callable[[Array, Any], Array]


def run(
    log_density: LogDensity,
    start: np.ndarray,
    arguments: Any,
    *,
    steps: int,
    warmup: int,
    seed: int,
    progress: Callable[[str], object] | None = None,
) -> list[EnsembleDraws]:
    """Run several independent ensembles together.

    Parameters
    ----------
    log_density : callable
        ``log_density(vector, arguments)`` of one vector of shape (p,); hashable, for it is
        compiled in.
    start : ndarray, shape (ensembles, walkers, p)
        First positions; walkers even.
    arguments : pytree
        Handed to `log_density`.
    steps, warmup : int
        Steps kept, and steps thrown away before them, the latter rounded up to whole tenths.
    seed : int
        Same seed, same draws.
    progress : callable, optional
        Called with a sentence after every tenth of the steps.

    Returns
    -------
    list of EnsembleDraws
        The steps kept of every ensemble.
    """
    positions = jnp.asarray(start)
    densities = _densities(log_density, positions, arguments)
    state = (jax.random.key(seed), positions, densities)
    # One length for warm-up and run, so that the loop is compiled once.
    chunk = max(1, -(-steps // _CHUNKS))
    for _ in range(-(-warmup // chunk)):
        state, _chain = _advance(log_density, state, arguments, chunk)
    kept: list[list[np.ndarray]] = []
    while (done := sum(len(part[1]) for part in kept)) < steps:
        state, chain = _advance(log_density, state, arguments, chunk)
        kept.append([np.asarray(part) for part in chain])
        if progress is not None:
            progress(f"{min(steps, done + chunk)} of {steps} steps done")
    chains, lps, accepted = (
        np.concatenate(parts)[:steps] for parts in zip(*kept, strict=True)
    )  # step, ensemble, walker
    return [
        EnsembleDraws(
            positions=chains[:, e],
            log_density=lps[:, e],
            acceptance=float(np.mean(accepted[:, e])),
            autocorrelation=longest_autocorrelation(chains[:, e]),
        )
        for e in range(chains.shape[1])
    ]


@functools.partial(jax.jit, static_argnames="log_density")
def _densities(log_density: LogDensity, positions: Array, arguments: Any) -> Array:
    return jax.vmap(jax.vmap(lambda v: log_density(v, arguments)))(positions)


@functools.partial(jax.jit, static_argnames=("log_density", "steps"))
def _advance(
    log_density: LogDensity, state: tuple, arguments: Any, steps: int
) -> tuple[tuple, tuple[Array, Array, Array]]:
    """Make `steps` steps; the new state, and positions, densities and acceptances of each."""

    def step(state: tuple, _: None) -> tuple[tuple, tuple[Array, Array, Array]]:
        key, positions, densities = state
        key, first, second = jax.random.split(key, 3)
        half = positions.shape[1] // 2
        a, b = positions[:, :half], positions[:, half:]
        lp_a, lp_b = densities[:, :half], densities[:, half:]
        a, lp_a, moved_a = _stretch(log_density, first, a, lp_a, b, arguments)
        b, lp_b, moved_b = _stretch(log_density, second, b, lp_b, a, arguments)
        positions = jnp.concatenate([a, b], axis=1)
        densities = jnp.concatenate([lp_a, lp_b], axis=1)
        moved = jnp.concatenate([moved_a, moved_b], axis=1)
        return (key, positions, densities), (positions, densities, moved)

    return jax.lax.scan(step, state, None, length=steps)


def _stretch(
    log_density: LogDensity, key: Array, moving: Array, lp: Array, others: Array, arguments: Any
) -> tuple[Array, Array, Array]:
    """Stretch every walker of one half towards or away from a random one of the other half."""
    ensembles, walkers, count = moving.shape
    choose, scale, accept = jax.random.split(key, 3)
    partner = jax.random.randint(choose, (ensembles, walkers), 0, others.shape[1])
    anchors = jnp.take_along_axis(others, partner[..., None], axis=1)
    uniform = jax.random.uniform(scale, (ensembles, walkers))
    z = ((STRETCH - 1.0) * uniform + 1.0) ** 2 / STRETCH
    proposal = anchors + z[..., None] * (moving - anchors)
    new_lp = jax.vmap(jax.vmap(lambda v: log_density(v, arguments)))(proposal)
    # A ball stretched by z in p dimensions has z^(p-1) times the shell's volume.
    ratio = (count - 1) * jnp.log(z) + new_lp - lp
    taken = jnp.log(jax.random.uniform(accept, (ensembles, walkers))) < ratio
    return jnp.where(taken[..., None], proposal, moving), jnp.where(taken, new_lp, lp), taken
