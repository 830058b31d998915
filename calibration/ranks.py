"""Simulation-based calibration: whether a sampler returns the posteriors that it should.

Parameters are drawn from their priors, readings simulated with them, and the posterior of those
readings sampled. Over many repeats the rank of the true value among the draws is uniform if, and
in practice only if, priors, likelihood and sampler fit each other.

References
----------
.. [1] S. Talts et al., "Validating Bayesian inference algorithms with simulation-based
   calibration", 2018.
.. [2] T. Säilynoja, P.-C. Bürkner, A. Vehtari, "Graphical test for discrete uniformity and its
   applications in goodness-of-fit evaluation", Statistics and Computing 32, 2022: simultaneous
   bands of the empirical distribution of ranks.
"""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
import scipy.stats
from jax import Array

from calibration.fitting import fit
from calibration.priors import Truncated
from calibration.problem import Dataset, Problem
from calibration.progress import ProgressOption, reporting
from calibration.sampling import draws_alone
from calibration.structure import ProblemStructure
from procmodel.errors import InputError
from procmodel.precision import require_float64

Simulate = Callable[[np.random.Generator, dict[str, float]], dict[str, np.ndarray]]

_BINS = 20
_SIMULATED = 2_000


@dataclass(frozen=True)
class SimulationCheck:
    """Ranks of the true values among the draws.

    Attributes
    ----------
    sampler : str
        Which sampler was checked.
    ranks : dict of str to ndarray, shape (n,)
        Rank of the true value of every free parameter, 0 to `draws`.
    draws : int
        Draws that each rank is among.
    p_values : dict of str to float
        How often uniform ranks leave the band as far as these do, over all points together.
    failed : int
        Repeats without a rank, for their fit did not converge.
    """

    sampler: str
    ranks: dict[str, np.ndarray]
    draws: int
    p_values: dict[str, float]
    failed: int

    @property
    def passed(self) -> bool:
        """Whether no parameter leaves the simultaneous 99 % band, shared among the parameters."""
        return min(self.p_values.values()) >= 0.01 / len(self.p_values)

    def report(self) -> str:
        """The check as text.

        Returns
        -------
        str
            A line for each parameter.
        """
        count = len(next(iter(self.ranks.values())))
        lines = [f"{count} simulated calibrations, sampler {self.sampler}, {self.failed} failed"]
        for name, p in self.p_values.items():
            share = float(np.mean(self.ranks[name])) / self.draws
            lines.append(f"  {name}: p {p:.3f}, mean rank {share:.3f} (0.5 is right)")
        verdict = "uniform within the band" if self.passed else "NOT uniform: do not trust it"
        return "\n".join([*lines, f"ranks are {verdict}"])


def simulation_check(
    problem: Problem,
    repeats: int = 500,
    seed: int = 0,
    sampler: str = "auto",
    *,
    simulate: Simulate | None = None,
    steps: int = 400,
    warmup: int = 300,
    progress: ProgressOption = None,
) -> SimulationCheck:
    """Check a sampler on a problem by simulation.

    Parameters
    ----------
    problem : Problem
        Every free parameter needs a prior to draw from, or finite bounds; every data set its
        sigma, as a number or as a parameter. Its readings are replaced by simulated ones.
    repeats : int
        Number of simulated calibrations.
    seed : int
        Same seed, same check.
    sampler : {"auto", "stretch", "emcee", "nuts"}
        The sampler to check.
    simulate : callable, optional
        ``simulate(rng, parameters)`` giving the readings of every data set by name; the problem's
        own model and noise when left out.
    steps, warmup : int
        Length of each run. Ranks are among draws far apart, so that they are nearly independent.
    progress : bool or callable, optional
        See `calibration.sample`.

    Returns
    -------
    SimulationCheck
        Ranks and verdict.

    Raises
    ------
    InputError
        If a prior cannot be drawn from, a noise level is unknown, or a run is too short.
    """
    require_float64("A simulation check")
    if simulate is None and any(d.x_sigma is not None for d in problem.datasets.values()):
        raise InputError("errors in x need the true x to be simulated: give simulate=.")
    if not problem.noise_known:
        raise InputError("a simulation needs to know the noise: give sigma, or a parameter for it.")
    if repeats < 1:
        raise InputError(f"repeats is {repeats}, but must be at least 1, better some hundred.")
    rng = np.random.default_rng(seed)
    truths = _truths(problem, repeats, rng)
    ranks: list[np.ndarray] = []
    failed, chosen, count = 0, sampler, 0
    with reporting(progress) as told:
        told.compiling("calibrations")
        for number, truth in enumerate(truths):
            values = _all_values(problem, truth)
            readings = (simulate or functools.partial(_readings, problem))(rng, values)
            simulated = _with_readings(problem, readings, truth)
            start = fit(simulated)
            if start.converged:
                chosen, draws = draws_alone(
                    simulated, start, int(rng.integers(2**31)), sampler, steps, warmup
                )
                count = len(draws)
                if count == 0:
                    raise InputError(f"steps is {steps}, too few to keep a draw: raise it.")
                ranks.append(np.sum(draws < truth, axis=0))
            else:
                failed += 1
            told.running("calibrations", number + 1, repeats)
    if not ranks:
        raise InputError("no simulated readings could be fitted: check priors and model.")
    table = np.array(ranks)
    of_each = {name: table[:, i] for i, name in enumerate(problem.layout.free)}
    return SimulationCheck(
        sampler=chosen,
        ranks=of_each,
        draws=count,
        p_values={name: uniformity(values, count, seed) for name, values in of_each.items()},
        failed=failed,
    )


def uniformity(ranks: np.ndarray, draws: int, seed: int = 0) -> float:
    """How often uniform ranks stray as far from their expected distribution as these do.

    Parameters
    ----------
    ranks : ndarray of int, shape (n,)
        Ranks from 0 to `draws`.
    draws : int
        Number of draws that each rank is among.
    seed : int
        Of the simulation that the answer is found by.

    Returns
    -------
    float
        Probability, over all points of the distribution at once.
    """
    rng = np.random.default_rng(seed)
    # Ranks share points of the line: spread evenly, they are uniform on it if they are at all.
    spread = (ranks + rng.uniform(size=len(ranks))) / (draws + 1)
    found = _farthest(np.sort(spread)[None, :])[0]
    simulated = _farthest(np.sort(rng.uniform(size=(_SIMULATED, len(ranks))), axis=1))
    return float((1 + np.sum(simulated <= found)) / (1 + _SIMULATED))


def _farthest(ordered: np.ndarray) -> np.ndarray:
    """Least two-sided binomial probability over the points of the distribution, shape (m,)."""
    points = np.arange(1, _BINS) / _BINS
    size = ordered.shape[1]
    below = np.stack([np.sum(ordered <= point, axis=1) for point in points], axis=1)
    counts = np.arange(size + 1)[:, None]
    at_most = scipy.stats.binom.cdf(counts, size, points)
    at_least = scipy.stats.binom.sf(counts - 1, size, points)
    # One row for each count that there can be, looked up for those that there are.
    chances = 2.0 * np.minimum(at_most, at_least)
    return np.min(chances[below, np.arange(len(points))], axis=1)


def _truths(problem: Problem, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draws of the free parameters from their priors, inside their bounds, shape (count, p)."""
    priors = dict(problem.layout.priors)
    for name, _ in problem.layout.tied:
        if name in priors:
            raise InputError(
                f"parameter {name!r} is tied and has a prior, so that the free ones cannot be "
                "drawn from theirs alone: drop it for this check."
            )
    columns = []
    for name, (low, high) in zip(problem.layout.free, problem.layout.bounds, strict=True):
        prior = priors.get(name)
        if prior is None:
            if not np.isfinite(high - low):
                raise InputError(f"parameter {name!r} has neither a prior nor finite bounds.")
            columns.append(rng.uniform(low, high, count))
            continue
        columns.append(Truncated(prior, low, high).draw(rng, count))
    return np.stack(columns, axis=1)


def _all_values(problem: Problem, truth: np.ndarray) -> dict[str, float]:
    layout = problem.layout.in_natural_coordinates()
    values = layout.natural(truth, problem.fixed_values)
    return {name: float(value) for name, value in values.items()}


def _readings(
    problem: Problem, rng: np.random.Generator, values: dict[str, float]
) -> dict[str, np.ndarray]:
    """Readings that the problem's own model and noise give."""
    truth = np.array([values[name] for name in problem.layout.free])
    predictions = _predictions(problem.structure, truth, problem.fixed_values, problem.data())
    return {
        name: dataset.simulated(rng, np.asarray(prediction), values)
        for (name, dataset), prediction in zip(problem.datasets.items(), predictions, strict=True)
    }


@functools.partial(jax.jit, static_argnames="structure")
def _predictions(
    structure: ProblemStructure, vector: Array, fixed: Array, data: tuple
) -> tuple[Array, ...]:
    return structure.in_natural_coordinates().predictions(vector, fixed, data)


def _with_readings(problem: Problem, readings: dict[str, np.ndarray], truth: np.ndarray) -> Problem:
    """The problem with other readings, started at the truth, from where the mode is near."""
    parameters = dict(problem.parameters)
    for name, value in zip(problem.layout.free, truth, strict=True):
        parameters[name] = dataclasses.replace(parameters[name], value=float(value))
    datasets: dict[str, Dataset] = {
        name: dataclasses.replace(dataset, y=readings[name], function=function)
        for (name, dataset), function in zip(
            problem.datasets.items(), problem.structure.functions, strict=True
        )
    }
    return Problem(parameters, datasets, name=problem.name)
