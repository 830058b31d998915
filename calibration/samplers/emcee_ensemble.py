"""emcee's affine-invariant ensemble, all walkers of a move evaluated in one call."""

from collections.abc import Callable

import emcee
import numpy as np

from calibration.samplers.driver import State, Steps


class EmceeSampler:
    """Several independent ensembles of emcee, one after the other.

    Parameters
    ----------
    log_density : callable
        Log density of positions of shape (m, p), as shape (m,).
    start : ndarray, shape (ensembles, walkers, p)
        First positions.
    warmup : int
        Steps thrown away.
    seed : int
        Same seed, same draws.
    """

    most = 100_000

    def __init__(
        self,
        log_density: Callable[[np.ndarray], np.ndarray],
        start: np.ndarray,
        warmup: int,
        seed: int,
    ):
        self.warmup = warmup
        self._log_density = log_density
        self._start = start
        self._seed = seed

    def begin(self) -> State:
        """Positions and densities, and the state of NumPy's random numbers, per ensemble."""
        rng = np.random.default_rng(self._seed)
        seeds = rng.integers(2**32, size=len(self._start))
        randoms = [np.random.RandomState(seed).get_state() for seed in seeds]
        return {
            "positions": self._start,
            "densities": np.stack([self._log_density(start) for start in self._start]),
            "random_words": np.stack([random[1] for random in randoms]),
            "random_rest": np.array([random[2:] for random in randoms], float),
        }

    def warm_up(self, state: State, count: int) -> State:
        """Steps that are not kept."""
        return self.advance(state, count)[0]

    def advance(self, state: State, count: int) -> tuple[State, Steps]:
        """Steps that are kept."""
        ends, parts = [], []
        for e, positions in enumerate(state["positions"]):
            walkers, dimensions = positions.shape
            sampler = emcee.EnsembleSampler(walkers, dimensions, self._log_density, vectorize=True)
            place, has_gauss, gauss = state["random_rest"][e]
            words = state["random_words"][e].astype(np.uint32)
            random = ("MT19937", words, int(place), int(has_gauss), float(gauss))
            begin = emcee.State(positions, log_prob=state["densities"][e], random_state=random)
            # Independent of where a run is cut: no warning about the start of each piece.
            end = sampler.run_mcmc(begin, count, skip_initial_state_check=True)
            chain = sampler.get_chain()
            before = np.concatenate([positions[None], chain[:-1]])
            moved = np.any(chain != before, axis=-1)
            parts.append((chain, sampler.get_log_prob(), moved))
            ends.append((end.coords, end.log_prob, end.random_state))
        chains, densities, moved_all = (np.stack(part, axis=1) for part in zip(*parts, strict=True))
        state = {
            "positions": np.stack([end[0] for end in ends]),
            "densities": np.stack([end[1] for end in ends]),
            "random_words": np.stack([end[2][1] for end in ends]),
            "random_rest": np.array([end[2][2:] for end in ends], float),
        }
        return state, Steps(chains, densities, moved_all, np.zeros(moved_all.shape, bool))
