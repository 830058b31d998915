"""Draws as a labelled DataTree: diagnostics, predictions, and the file they are kept in."""

import functools
import importlib.metadata
from typing import Any

import jax
import numpy as np
import xarray
from emcee.autocorr import integrated_time
from jax import Array

from calibration.black_box import failures_explained
from calibration.problem import Problem
from calibration.samplers.driver import Steps
from calibration.structure import ProblemStructure
from procmodel.errors import InputError

# An estimate of the autocorrelation time is only as good as the chain is long (emcee's rule).
LENGTHS_WANTED = 50
RHAT_ALLOWED = 1.01
# Effective draws wanted of each chain, for the bulk and for the tails (Vehtari et al. 2021).
EFFECTIVE_WANTED = 100
_DIVERGENT_ALLOWED = 0.002
_STEPS_JUDGED = 500


def as_tree(
    problem: Problem, steps: Steps, rng: np.random.Generator, origin: dict[str, Any]
) -> xarray.DataTree:
    """Steps of a sampler as a DataTree.

    Parameters
    ----------
    problem : Problem
        What was sampled.
    steps : Steps
        Its draws.
    rng : numpy.random.Generator
        For the noise levels that were integrated out.
    origin : dict
        Attributes that say how the draws came about.

    Returns
    -------
    xarray.DataTree
        See `calibration.sample`.
    """
    import arviz_base

    structure, layout = problem.structure, problem.layout
    # One walker after the other: neighbouring draws of a chain then are neighbouring steps, as
    # estimates of the effective sample size expect.
    vectors = np.moveaxis(steps.positions, 0, 2)
    chains = vectors.reshape(len(vectors), -1, vectors.shape[-1])
    flat = chains.reshape(-1, chains.shape[-1])
    values = _all_values(structure, flat, problem.fixed_values)
    posterior = {
        name: np.asarray(values[name]).reshape(chains.shape[:2])
        for name in layout.names
        if name not in layout.fixed
    }
    posterior |= _noise_draws(problem, flat, chains.shape[:2], rng)
    stats = {"lp": np.moveaxis(steps.log_density, 0, 2).reshape(chains.shape[:2])}
    if np.any(steps.trouble):
        stats["diverging"] = np.moveaxis(steps.trouble, 0, 2).reshape(chains.shape[:2])
    tree = arviz_base.from_dict(
        {
            "posterior": posterior,
            "sample_stats": stats,
            "observed_data": {name: d.y for name, d in problem.datasets.items()},
        }
    )
    for name in posterior:
        parameter = problem.parameters.get(name)
        if parameter is not None and parameter.unit:
            tree["posterior"][name].attrs["unit"] = parameter.unit
    tree.attrs = _attributes(problem, steps, origin)
    return tree


def _attributes(problem: Problem, steps: Steps, origin: dict[str, Any]) -> dict[str, Any]:
    import arviz_base
    import arviz_stats

    # Neighbouring steps of walkers say much the same: a few hundred of each tell all there is.
    apart = max(1, len(steps.positions) // _STEPS_JUDGED) if steps.positions.shape[2] > 1 else 1
    judged = np.moveaxis(steps.positions[::apart], 0, 2)
    judged = judged.reshape(len(judged), -1, judged.shape[-1])
    columns = {name: judged[:, :, i] for i, name in enumerate(problem.layout.free)}
    free = arviz_base.from_dict({"posterior": columns})["posterior"].dataset

    def of_all(values: xarray.Dataset, worst: Any) -> float:
        return float(worst([float(values[name]) for name in problem.layout.free]))

    rhat = of_all(arviz_stats.rhat(free), np.max)
    bulk = of_all(arviz_stats.ess(free, method="bulk"), np.min)
    tail = of_all(arviz_stats.ess(free, method="tail"), np.min)
    count, ensembles, walkers = steps.log_density.shape
    attributes = {
        "model": problem.name,
        "data_hash": problem.data_hash,
        **origin,
        **{
            f"fixed_{name}": value
            for name, value in zip(problem.layout.fixed, problem.fixed_values, strict=True)
        },
        "walkers": walkers,
        "steps": count,
        "acceptance": float(np.mean(steps.accepted)),
        "rhat": rhat,
        "ess_bulk": bulk,
        "ess_tail": tail,
        "divergences": int(np.sum(steps.trouble)),
    }
    failings, remedy = [], 2.0
    said = f"R-hat {rhat:.4f}, {bulk:.0f} effective draws in the bulk and {tail:.0f} in the tails"
    if walkers > 1:
        correlation = max(_autocorrelation(steps.positions[:, e]) for e in range(ensembles))
        attributes["autocorrelation_steps"] = correlation
        lengths = count / correlation if np.isfinite(correlation) and correlation > 0 else 0.0
        said = f"{lengths:.0f} autocorrelation times long, {said}"
        if lengths < LENGTHS_WANTED:
            failings.append(f"{LENGTHS_WANTED} autocorrelation times are wanted")
            remedy = max(remedy, 1.5 * LENGTHS_WANTED / lengths if lengths > 0 else 2.0)
    if not rhat <= RHAT_ALLOWED:
        failings.append(f"R-hat of at most {RHAT_ALLOWED} is wanted")
    wanted = EFFECTIVE_WANTED * ensembles
    if not min(bulk, tail) >= wanted:
        failings.append(f"{wanted} effective draws are wanted")
        if min(bulk, tail) > 0:
            remedy = max(remedy, 1.5 * wanted / min(bulk, tail))
    divergent = float(np.mean(steps.trouble))
    if divergent > _DIVERGENT_ALLOWED:
        failings.append(
            f"{100 * divergent:.2g} % of the moves diverged: another transform or sampler='stretch'"
        )
    status = f"converged: {said}"
    if failings:
        needed = int(np.ceil(remedy * count * walkers))
        status = f"not converged: {said}, where {' and '.join(failings)}; raise draws to {needed}"
    return {
        **attributes,
        "converged": int(not failings),
        "status": status,
        "procmodel_version": importlib.metadata.version("procmodel"),
        "jax_version": jax.__version__,
    }


def _autocorrelation(positions: np.ndarray) -> float:
    """Longest integrated autocorrelation time of any parameter of an ensemble, in steps.

    `positions` has the shape (steps, walkers, p); infinite when there are too few steps.
    """
    if len(positions) <= 10:
        return float("inf")
    return float(np.max(integrated_time(positions, tol=0)))


def with_predictions(
    problem: Problem, tree: xarray.DataTree, draws: int = 250, seed: int = 0
) -> xarray.DataTree:
    """The draws with new readings that they predict, and how likely they make those at hand.

    Parameters
    ----------
    problem : Problem
        What was sampled.
    tree : xarray.DataTree
        From `calibration.sample`.
    draws : int
        Draws of each chain to predict from, evenly spaced.
    seed : int
        Same seed, same predictions.

    Returns
    -------
    xarray.DataTree
        A copy with the groups ``posterior_predictive`` (noise included), ``predictions_mean``
        (the model alone) and ``log_likelihood``, for ArviZ and `procmodel compare`.

    Raises
    ------
    InputError
        If the draws are of another problem.
    """
    import arviz_base

    if tree.attrs.get("data_hash") != problem.data_hash:
        raise InputError("the draws are of other data than the problem: sample this problem.")
    posterior = tree["posterior"].dataset
    chains, count = posterior.sizes["chain"], posterior.sizes["draw"]
    picked = np.unique(np.linspace(0, count - 1, min(draws, count)).round().astype(int))
    shape = (chains, len(picked))
    natural = np.stack(
        [np.asarray(posterior[name])[:, picked].ravel() for name in problem.layout.free], axis=1
    )
    levels = np.stack(
        [
            np.asarray(posterior[label])[:, picked].ravel()
            if (label := _noise_label(problem, name)) in posterior
            else np.ones(len(natural))
            for name in problem.datasets
        ],
        axis=1,
    )
    with failures_explained(problem.structure.functions):
        means, densities = jax.block_until_ready(
            _predicted(problem.structure, natural, levels, problem.fixed_values, problem.data())
        )
    rng = np.random.default_rng(seed)
    values = {
        name: np.asarray(drawn)
        for name, drawn in _all_values(problem.structure, natural, problem.fixed_values).items()
    }
    drawn, mean, density = {}, {}, {}
    for i, (name, dataset) in enumerate(problem.datasets.items()):
        predictions = np.asarray(means[i])
        mean[name] = predictions.reshape(*shape, -1)
        density[name] = np.asarray(densities[i]).reshape(*shape, -1)
        rows = []
        for k in range(len(natural)):
            at = {n: float(v[k]) for n, v in values.items()}
            rows.append(dataset.simulated(rng, predictions[k], at, levels[k, i]))
        drawn[name] = np.stack(rows).reshape(*shape, -1)
    added = arviz_base.from_dict(
        {"posterior_predictive": drawn, "predictions_mean": mean, "log_likelihood": density}
    )
    copy = tree.copy()
    for group in ("posterior_predictive", "predictions_mean", "log_likelihood"):
        copy[group] = added[group]
    return copy


@functools.partial(jax.jit, static_argnames="structure")
def _predicted(
    structure: ProblemStructure, vectors: Array, levels: Array, fixed: Array, data: tuple
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """Model values and log-likelihoods of every reading at natural vectors."""
    natural = structure.in_natural_coordinates()

    def at(drawn: tuple[Array, Array]) -> tuple:
        vector, level = drawn
        scaled = tuple(
            (x, y, inverse if known else inverse / level[i], x_sigma)
            for i, ((x, y, inverse, x_sigma), known) in enumerate(
                zip(data, structure.noise_known, strict=True)
            )
        )
        return (
            natural.predictions(vector, fixed, scaled),
            natural.log_likelihoods(vector, fixed, scaled),
        )

    return jax.lax.map(at, (vectors, levels), batch_size=256)


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


def _noise_label(problem: Problem, name: str) -> str:
    label = "noise" if len(problem.datasets) == 1 else f"noise_{name}"
    # A parameter of that name keeps it.
    return f"{label}_level" if label in problem.parameters else label


def _noise_draws(
    problem: Problem, flat: np.ndarray, shape: tuple[int, int], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Noise levels given each draw: sigma^2 is the squared misfit over a chi-square draw."""
    if problem.noise_known:
        return {}
    arguments = (problem.fixed_values, problem.data())
    squares = np.asarray(_square_deviations(problem.structure, flat, arguments))
    noise = {}
    for i, (name, dataset) in enumerate(problem.datasets.items()):
        if dataset.sigma is None:
            level = np.sqrt(squares[:, i] / rng.chisquare(len(dataset.y), size=len(flat)))
            noise[_noise_label(problem, name)] = level.reshape(shape)
    return noise
