"""emcee's affine-invariant ensemble, all walkers of a move evaluated in one call."""

from collections.abc import Callable

import emcee
import numpy as np

from calibration.samplers.ensemble import EnsembleDraws, longest_autocorrelation


def run(
    log_density: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    *,
    steps: int,
    warmup: int,
    rng: np.random.Generator,
) -> EnsembleDraws:
    """Run one ensemble.

    Parameters
    ----------
    log_density : callable
        Log density of positions of shape (m, p), as shape (m,).
    start : ndarray, shape (walkers, p)
        First positions.
    steps, warmup : int
        Steps kept, and steps thrown away before them.
    rng : numpy.random.Generator
        Source of the seed.

    Returns
    -------
    EnsembleDraws
        The steps kept.
    """
    walkers, dimensions = start.shape
    sampler = emcee.EnsembleSampler(walkers, dimensions, log_density, vectorize=True)
    random = np.random.RandomState(int(rng.integers(2**32))).get_state()
    state = emcee.State(start, random_state=random)
    state = sampler.run_mcmc(state, warmup)
    sampler.reset()
    sampler.run_mcmc(state, steps)
    positions = sampler.get_chain()
    return EnsembleDraws(
        positions=positions,
        log_density=sampler.get_log_prob(),
        acceptance=float(np.mean(sampler.acceptance_fraction)),
        autocorrelation=longest_autocorrelation(positions),
    )
