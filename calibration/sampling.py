"""`sample`: draws from the posterior of a problem, as an ArviZ DataTree."""

import functools
import importlib.metadata
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
import xarray
from jax import Array

from calibration.fitting import fit
from calibration.problem import Problem
from calibration.result import FitResult
from calibration.samplers import stretch
from calibration.samplers.ensemble import EnsembleDraws
from calibration.structure import ProblemStructure
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

SAMPLERS = ("auto", "stretch", "emcee")
# An estimate of the autocorrelation time is only as good as the chain is long (emcee's rule).
LENGTHS_WANTED = 50
RHAT_ALLOWED = 1.01


def sample(
    problem: Problem,
    seed: int = 0,
    draws: int = 30_000,
    sampler: str = "auto",
    *,
    ensembles: int = 4,
    walkers: int | None = None,
    start: FitResult | None = None,
    progress: Callable[[str], object] | None = None,
) -> xarray.DataTree:
    """Draw from the posterior of the free parameters.

    Parameters
    ----------
    problem : Problem
        Model, parameters (bounds and priors) and readings. A parameter without prior is uniform
        inside its bounds; an unknown noise level is integrated out under 1/sigma.
    seed : int
        Same seed, same draws.
    draws : int
        Draws kept in each ensemble, rounded up to whole steps of all its walkers.
    sampler : {"auto", "stretch", "emcee"}
        "stretch" is our compiled ensemble of the stretch move, "emcee" the same move by emcee, and
        "auto" takes "stretch".
    ensembles : int
        Independent ensembles of walkers, at least 2. They are the chains of the DataTree: the
        walkers of one ensemble know of each other and are not.
    walkers : int, optional
        Walkers of an ensemble, at least twice the number of free parameters.
    start : FitResult, optional
        Fit to start around; made when left out.
    progress : callable, optional
        Called with a sentence now and then.

    Returns
    -------
    xarray.DataTree
        Groups ``posterior`` (free and tied parameters, noise levels), ``sample_stats`` (``lp``)
        and ``observed_data``. Attributes: model, data hash, sampler, seed, acceptance,
        autocorrelation, rhat, ``converged`` (0 or 1) and ``status``, a sentence.

    Raises
    ------
    InputError
        If a name or count is wrong, the fit fails, or the posterior cannot be normalised because
        the data leave a parameter without finite bounds open.
    """
    require_float64("Sampling")
    if sampler not in SAMPLERS:
        raise InputError(f"sampler {sampler!r} is unknown{nearest(sampler, SAMPLERS)}.")
    dimensions = len(problem.layout.free)
    walkers = walkers or max(16, 4 * dimensions)
    if walkers < 2 * dimensions or walkers % 2:
        raise InputError(
            f"walkers is {walkers}, but must be even and at least {2 * dimensions}, twice the "
            "number of free parameters."
        )
    if ensembles < 2 or draws < walkers or seed < 0:
        raise InputError(
            f"ensembles must be at least 2, draws at least {walkers} and the seed not below 0."
        )
    start = start or fit(problem)
    _require_proper(problem, start)
    rng = np.random.default_rng(seed)
    positions = np.stack([_laplace_start(problem, start, walkers, rng) for _ in range(ensembles)])
    steps = -(-draws // walkers)
    length = {"steps": steps, "warmup": max(1, steps // 2)}
    lower, upper = problem.layout.natural_bounds()
    arguments = jax.device_put((problem.fixed_values, problem.data(), lower, upper))

    density = _LogPosterior(problem.structure)
    if sampler == "emcee":
        runs = _run_emcee(density, positions, arguments, length, rng, progress)
    else:
        sampler = "stretch"
        runs = stretch.run(
            density,
            positions,
            arguments,
            **length,
            seed=int(rng.integers(2**31)),
            progress=progress,
        )
    return _as_tree(problem, runs, rng, {"sampler": sampler, "seed": seed})


@dataclass(frozen=True)
class _LogPosterior:
    """Log density of a problem; two of the same structure share what was compiled."""

    structure: ProblemStructure

    def __call__(self, vector: Array, arguments: tuple) -> Array:
        return self.structure.log_density(vector, arguments)


def _run_emcee(
    density: _LogPosterior,
    positions: np.ndarray,
    arguments: tuple,
    length: dict[str, int],
    rng: np.random.Generator,
    progress: Callable[[str], object] | None,
) -> list[EnsembleDraws]:
    from calibration.samplers import emcee_ensemble

    def log_density(vectors: np.ndarray) -> np.ndarray:
        return np.asarray(_log_densities(density, vectors, arguments))

    runs = []
    for number, start in enumerate(positions, start=1):
        runs.append(emcee_ensemble.run(log_density, start, **length, rng=rng))
        if progress is not None:
            progress(f"ensemble {number} of {len(positions)} done")
    return runs


@functools.partial(jax.jit, static_argnames="density")
def _log_densities(density: _LogPosterior, vectors: Array, arguments: tuple) -> Array:
    return jax.vmap(lambda v: density(v, arguments))(vectors)


@functools.partial(jax.jit, static_argnames="structure")
def _all_values(structure: ProblemStructure, vectors: Array, fixed: Array) -> dict[str, Array]:
    layout = structure.layout.in_natural_coordinates()
    return jax.vmap(lambda v: layout.natural(v, fixed))(vectors)


@functools.partial(jax.jit, static_argnames="structure")
def _square_deviations(structure: ProblemStructure, vectors: Array, arguments: tuple) -> Array:
    """Sum of squared deviations of each data set at natural vectors, shape (draws, sets)."""
    natural = structure.in_natural_coordinates()

    def at(vector: Array) -> Array:
        parts = natural.deviations(vector, *arguments)
        return jax.numpy.stack([jax.numpy.sum(part**2) for part in parts])

    return jax.lax.map(at, vectors, batch_size=1024)


def _require_proper(problem: Problem, start: FitResult) -> None:
    if start.problem.structure != problem.structure or start.problem.data_hash != problem.data_hash:
        raise InputError("start is the fit of another problem: fit this one.")
    if not start.converged:
        raise InputError(f"the fit that sampling starts from failed ({start.status}).")
    if start.degrees_of_freedom == 0 and not problem.noise_known:
        raise InputError(
            "there are as many parameters as readings and no sigma, so that the noise level is "
            "unknown: give sigma or more readings."
        )
    for name, bounds in zip(problem.layout.free, problem.layout.bounds, strict=True):
        estimate = start.parameters[name]
        if estimate.interval95 is None and not np.all(np.isfinite(bounds)):
            raise InputError(
                f"the posterior of {name!r} cannot be normalised, for the data leave it open "
                "and its bounds are infinite: give it finite bounds or a prior, or fix it."
            )


def _laplace_start(
    problem: Problem, start: FitResult, walkers: int, rng: np.random.Generator
) -> np.ndarray:
    """Walkers around the optimum with the fit's covariance, reflected into the bounds."""
    names = problem.layout.free
    centre = np.array([start.parameters[n].value for n in names])
    known = np.isfinite(np.diag(start.covariance))
    spread = np.zeros((walkers, len(names)))
    if np.any(known):
        block = start.covariance[np.ix_(known, known)]
        # Widened: an ensemble started too narrow takes long to spread.
        spread[:, known] = rng.multivariate_normal(
            np.zeros(len(block)), 1.5 * block, size=walkers, method="eigh"
        )
    lower, upper = problem.layout.natural_bounds()
    for j in np.flatnonzero(~known):
        interval = start.parameters[names[j]].interval95
        width = (
            interval[1] - interval[0]
            if interval
            else 0.1 * min(upper[j] - lower[j], abs(centre[j]))
        )
        spread[:, j] = rng.normal(0.0, width / 2 if width > 0 else 1e-3, size=walkers)
    positions = centre + spread
    positions = np.where(positions < lower, 2 * lower - positions, positions)
    positions = np.where(positions > upper, 2 * upper - positions, positions)
    inside = (positions > lower) & (positions < upper)
    low = np.where(np.isfinite(lower), lower, centre - 1.0)
    high = np.where(np.isfinite(upper), upper, centre + 1.0)
    return np.where(inside, positions, rng.uniform(low, high, size=positions.shape))


def _as_tree(
    problem: Problem,
    runs: list[EnsembleDraws],
    rng: np.random.Generator,
    origin: dict[str, Any],
) -> xarray.DataTree:
    import arviz_base
    import arviz_stats

    structure, layout = problem.structure, problem.layout
    # One walker after the other: neighbouring draws of a chain then are neighbouring steps, as
    # estimates of the effective sample size expect.
    vectors = np.stack([run.positions.swapaxes(0, 1) for run in runs])
    chains = vectors.reshape(len(runs), -1, vectors.shape[-1])
    flat = chains.reshape(-1, chains.shape[-1])
    values = _all_values(structure, flat, problem.fixed_values)
    posterior = {
        name: np.asarray(values[name]).reshape(chains.shape[:2])
        for name in layout.names
        if name not in layout.fixed
    }
    posterior |= _noise_draws(problem, flat, chains.shape[:2], rng)
    lp = np.stack([run.log_density.T for run in runs]).reshape(chains.shape[:2])
    tree = arviz_base.from_dict(
        {
            "posterior": posterior,
            "sample_stats": {"lp": lp},
            "observed_data": {name: d.y for name, d in problem.datasets.items()},
        }
    )
    rhat = arviz_stats.rhat(tree["posterior"].dataset[list(layout.free)])
    worst = max(float(rhat[name]) for name in layout.free)
    correlation = max(run.autocorrelation for run in runs)
    tree.attrs = _attributes(problem, runs, origin, worst, correlation)
    return tree


def _attributes(
    problem: Problem,
    runs: list[EnsembleDraws],
    origin: dict[str, Any],
    worst: float,
    correlation: float,
) -> dict[str, Any]:
    steps, walkers = runs[0].positions.shape[:2]
    lengths = steps / correlation if np.isfinite(correlation) and correlation > 0 else 0.0
    converged = lengths >= LENGTHS_WANTED and worst <= RHAT_ALLOWED
    status = f"converged: {lengths:.0f} autocorrelation times long, R-hat {worst:.4f}"
    if not converged:
        wanted = 1.5 * LENGTHS_WANTED * max(correlation, 1.0) if lengths > 0 else 0.0
        needed = max(int(np.ceil(wanted)), 2 * steps) * walkers
        status = (
            f"not converged: {lengths:.0f} autocorrelation times long where {LENGTHS_WANTED} are "
            f"wanted, R-hat {worst:.4f} where at most {RHAT_ALLOWED} is; raise draws to about "
            f"{needed}"
        )
    return {
        "model": problem.name,
        "data_hash": problem.data_hash,
        **origin,
        **{
            f"fixed_{name}": value
            for name, value in zip(problem.layout.fixed, problem.fixed_values, strict=True)
        },
        "walkers": walkers,
        "steps": steps,
        "acceptance": float(np.mean([run.acceptance for run in runs])),
        "autocorrelation_steps": float(correlation),
        "rhat": worst,
        "converged": int(converged),
        "status": status,
        "procmodel_version": importlib.metadata.version("procmodel"),
        "jax_version": jax.__version__,
    }


def _noise_draws(
    problem: Problem, flat: np.ndarray, shape: tuple[int, int], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Noise levels given each draw: sigma^2 is the squared misfit over a chi-square draw."""
    unknown = [name for name, d in problem.datasets.items() if d.sigma is None]
    if not unknown:
        return {}
    arguments = (problem.fixed_values, problem.data())
    squares = np.asarray(_square_deviations(problem.structure, flat, arguments))
    noise = {}
    for i, (name, dataset) in enumerate(problem.datasets.items()):
        if dataset.sigma is None:
            label = "noise" if len(problem.datasets) == 1 else f"noise_{name}"
            level = np.sqrt(squares[:, i] / rng.chisquare(len(dataset.y), size=len(flat)))
            noise[label] = level.reshape(shape)
    return noise
