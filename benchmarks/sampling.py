"""Draws from the posterior: ours beside emcee on a NumPy log density, time and memory."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import measure, peers
from benchmarks.report import Section
from benchmarks.sizes import Sizes

LAYERS, FEED = 100, 2.0
HALF_WIDTHS = 250.0 - FEED * np.arange(LAYERS)
WEAR_RATIO, GAP = 0.3, 3.0
GAP_PRIOR = (3.0, 1.0)
SIGMA = 1.0
UPPER = np.array([1e3, 250.0])
ENSEMBLES, WALKERS = 4, 16
# Each contestant in a process of its own: the greatest memory of a process never falls.
_WORKER = (
    "import sys; from benchmarks.sampling import worker; worker(sys.argv[1], int(sys.argv[2]))"
)


@dataclass(frozen=True)
class Draws:
    """What a contestant drew.

    Attributes
    ----------
    wear_ratio : ndarray, shape (n,)
        Draws of all ensembles.
    autocorrelation : float
        Longest integrated autocorrelation time of any parameter in any ensemble, in steps.
    """

    wear_ratio: np.ndarray
    autocorrelation: float

    @property
    def effective(self) -> float:
        return len(self.wear_ratio) / self.autocorrelation

    @property
    def error_of_mean(self) -> float:
        return float(np.std(self.wear_ratio)) / np.sqrt(self.effective)


def run(section: Section, sizes: Sizes) -> None:
    samplers = _samplers(sizes.draws)
    first, _ = measure.first_call(samplers["ours"])
    turns = measure.interleaved(samplers, sizes.sampling_repeats)
    seconds, found = turns.seconds, turns.outcomes
    memory = {name: _memory(name, sizes.draws) for name in samplers}
    section.text(
        "Wear ratio and gap from 100 depths with 1 µm of known noise and the gap known beforehand "
        f"to ± 1 µm. {ENSEMBLES} ensembles of {WALKERS} walkers for everyone, {sizes.draws} draws "
        "kept in each after half as many for the warm-up, stretch moves, the start around the "
        "optimum. The first contestant is `calibration.sample` as it comes. Effective draws are "
        "all draws over the longest autocorrelation time of a parameter in an ensemble. Ours "
        "includes the fit it starts from, and the posterior as a labelled data tree. Memory is "
        "the peak of a process that imports, samples once and exits."
    )
    rows = []
    for name, draws in found.items():
        middle = float(np.median(seconds[name]))
        ratios = draws.wear_ratio
        rows.append(
            [
                name,
                measure.time_spread(seconds[name]),
                measure.ratio(seconds[name], seconds["ours"]),
                f"{len(ratios) / middle:.3g}",
                f"{draws.autocorrelation:.3g} steps",
                f"{draws.effective / middle:.3g}",
                f"{np.mean(ratios):.5f} ± {np.std(ratios):.5f}",
                f"{memory[name]:.0f} MiB",
            ]
        )
    section.table(
        [
            "contestant",
            "time",
            "time / ours",
            "draws per second",
            "autocorrelation",
            "effective draws per second",
            "wear ratio",
            "memory",
        ],
        rows,
    )
    section.text(f"First call of ours, nothing compiled: {first:.2f} s.")
    _agree(section, found)


def _agree(section: Section, found: dict[str, Draws]) -> None:
    """All have to sample the same distribution: means within the error of the draws."""
    ours = found["ours"]
    for name, draws in found.items():
        if name == "ours":
            continue
        error = np.hypot(ours.error_of_mean, draws.error_of_mean)
        off = float(np.mean(ours.wear_ratio) - np.mean(draws.wear_ratio)) / error
        section.target(
            f"mean wear ratio of the draws beside {name}",
            "within 4 standard errors",
            f"{off:+.1f}",
            abs(off) <= 4.0,
        )


def _samplers(draws: int) -> dict[str, Callable[[], Draws]]:
    return {
        "ours": _ours(draws, "auto"),
        "ours through emcee": _ours(draws, "emcee"),
        **_peers(draws),
    }


def _peers(draws: int) -> dict[str, Callable[[], Draws]]:
    return {
        "emcee, NumPy": lambda: _emcee(draws, _log_density, vectorize=False),
        "emcee, NumPy, all walkers at once": lambda: _emcee(draws, _log_densities, vectorize=True),
    }


def _readings() -> np.ndarray:
    exact = np.cumsum(FEED / (1.0 + _u(HALF_WIDTHS + GAP, WEAR_RATIO)))
    return exact + np.random.default_rng(3).normal(0.0, SIGMA, LAYERS)


def _u(half_widths: np.ndarray, wear_ratio: Any) -> np.ndarray:
    return wear_ratio * 4.0 * half_widths**2 / peers.ELECTRODE_AREA


Y = _readings()


def _log_density(position: np.ndarray) -> float:
    if np.any(position < 0.0) or np.any(position > UPPER):
        return -np.inf
    wear_ratio, gap = position
    depths = np.cumsum(FEED / (1.0 + _u(HALF_WIDTHS + gap, wear_ratio)))
    prior = ((gap - GAP_PRIOR[0]) / GAP_PRIOR[1]) ** 2
    return -0.5 * (np.sum(((depths - Y) / SIGMA) ** 2) + prior)


def _log_densities(positions: np.ndarray) -> np.ndarray:
    wear_ratio, gap = positions.T[:, :, None]
    depths = np.cumsum(FEED / (1.0 + _u(HALF_WIDTHS + gap, wear_ratio)), axis=1)
    prior = ((gap[:, 0] - GAP_PRIOR[0]) / GAP_PRIOR[1]) ** 2
    inside = np.all((positions >= 0.0) & (positions <= UPPER), axis=1)
    return np.where(inside, -0.5 * (np.sum(((depths - Y) / SIGMA) ** 2, axis=1) + prior), -np.inf)


def _emcee(draws: int, log_density: Callable[..., Any], vectorize: bool) -> Draws:
    import emcee

    rng = np.random.default_rng(5)
    optimum, spread = np.array([WEAR_RATIO, GAP]), np.array([0.003, 0.5])
    steps = -(-draws // WALKERS)
    chains = []
    for _ in range(ENSEMBLES):
        start = optimum + spread * rng.normal(size=(WALKERS, 2))
        sampler = emcee.EnsembleSampler(WALKERS, 2, log_density, vectorize=vectorize)
        # Left alone, every sampler starts from the same random state.
        random = np.random.RandomState(rng.integers(2**32)).get_state()
        state = sampler.run_mcmc(emcee.State(start, random_state=random), steps // 2)
        sampler.reset()
        sampler.run_mcmc(state, steps)
        chains.append(sampler.get_chain())
    times = [emcee.autocorr.integrated_time(chain, tol=0) for chain in chains]
    return Draws(np.stack(chains)[..., 0].ravel(), float(np.max(times)))


def _ours(draws: int, sampler: str) -> Callable[[], Draws]:
    from benchmarks.cases import square_depths
    from calibration import Normal, Parameter, Problem, sample

    parameters = {
        "wear_ratio": Parameter(0.1, bounds=(0.0, UPPER[0])),
        "gap": Parameter(GAP_PRIOR[0], bounds=(0.0, UPPER[1]), prior=Normal(*GAP_PRIOR)),
    }
    x = {"half_widths": HALF_WIDTHS, "feed": FEED}
    problem = Problem.from_function(square_depths, parameters, x, Y, SIGMA)

    def run_once() -> Draws:
        tree = sample(problem, 5, draws, sampler, ensembles=ENSEMBLES, walkers=WALKERS)
        ratios = np.asarray(tree["posterior"].dataset["wear_ratio"]).ravel()
        return Draws(ratios, float(tree.attrs["autocorrelation_steps"]))

    return run_once


def worker(name: str, draws: int) -> None:
    """Sample once in this process and print its greatest memory in MiB."""
    if name in _peers(draws):
        _peers(draws)[name]()
    else:
        import jax

        jax.config.update("jax_enable_x64", True)
        _samplers(draws)[name]()
    print(json.dumps(measure.peak_memory()))


def _memory(name: str, draws: int) -> float:
    done = subprocess.run(
        [sys.executable, "-c", _WORKER, name, str(draws)],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"sampling in a process of its own failed: {done.stderr.strip()[-300:]}")
    return float(json.loads(done.stdout.splitlines()[-1]))
