"""Posteriors to sample: each as a Problem of ours, and as the NumPy function emcee users write."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks import peers
from calibration import HalfNormal, Normal, Parameter, Problem

LAYERS, FEED = 100, 2.0
HALF_WIDTHS = 250.0 - FEED * np.arange(LAYERS)


@dataclass(frozen=True)
class Posterior:
    """One posterior, twice.

    Attributes
    ----------
    title : str
        What it is.
    problem : Problem
        Ours.
    log_density : callable
        Of a position of shape (p,), plain NumPy; of positions (m, p) too, as shape (m,).
    emcee_steps : int
        Steps of emcee's ensembles.
    """

    title: str
    problem: Problem
    log_density: Callable[[np.ndarray], Any]
    emcee_steps: int


def wear_depths(params: dict[str, Any], x: Any) -> Any:
    area = 4.0 * (x + params["gap"]) ** 2
    worn = params["wear_ratio"] * area / peers.ELECTRODE_AREA
    return params["zero"] + jnp.cumsum(FEED / (1.0 + worn))


def _wear_curve() -> Posterior:
    rng = np.random.default_rng(11)

    def depths(v: np.ndarray) -> np.ndarray:
        ratio, gap, zero = v[..., 0, None], v[..., 1, None], v[..., 2, None]
        area = 4.0 * (HALF_WIDTHS + gap) ** 2
        return zero + np.cumsum(FEED / (1.0 + ratio * area / peers.ELECTRODE_AREA), axis=-1)

    truth = np.array([0.3, 3.0, 0.5])
    y = depths(truth) + rng.normal(0.0, 1.0, LAYERS)

    def log_density(v: np.ndarray) -> Any:
        inside = (v[..., 0] >= 0.0) & (v[..., 1] >= 0.0)
        prior = ((v[..., 1] - 3.0) / 1.0) ** 2
        misfit = np.sum((depths(np.maximum(v, [0.0, 0.0, -np.inf])) - y) ** 2, axis=-1)
        return np.where(inside, -0.5 * (misfit + prior), -np.inf)

    parameters = {
        "wear_ratio": Parameter(0.2, bounds=(0.0, 1e3)),
        "gap": Parameter(3.0, bounds=(0.0, 250.0), prior=Normal(3.0, 1.0)),
        "zero": Parameter(0.0, bounds=(-50.0, 50.0)),
    }
    problem = Problem.from_function(wear_depths, parameters, HALF_WIDTHS, y, 1.0)
    return Posterior("wear curve, 3 parameters", problem, log_density, 2000)


def linear_force(params: dict[str, Any], x: Any) -> Any:
    return x @ jnp.stack([params[f"k{i}"] for i in range(5)])


def _linear_force() -> Posterior:
    rng = np.random.default_rng(12)
    # Force coefficients on regressors that nearly follow each other, as chip loads do.
    common = rng.normal(size=(120, 1))
    design = 1.0 + 0.25 * rng.normal(size=(120, 5)) + common
    truth = np.array([900.0, 400.0, 150.0, 60.0, 20.0])
    y = design @ truth + rng.normal(0.0, 50.0, 120)

    def log_density(v: np.ndarray) -> Any:
        return -0.5 * np.sum(((v @ design.T - y) / 50.0) ** 2, axis=-1)

    parameters = {f"k{i}": Parameter(100.0, "N", bounds=(-1e5, 1e5)) for i in range(5)}
    problem = Problem.from_function(linear_force, parameters, design, y, 50.0)
    return Posterior("correlated linear force model, 5 parameters", problem, log_density, 2500)


def banana(params: dict[str, Any], x: Any) -> Any:
    a, b = params["a"], params["b"]
    return jnp.stack([a, 4.0 * (b - a**2)])


def _banana() -> Posterior:
    def log_density(v: np.ndarray) -> Any:
        a, b = v[..., 0], v[..., 1]
        return -0.5 * (a**2 + (4.0 * (b - a**2)) ** 2)

    parameters = {
        "a": Parameter(0.3, bounds=(-20.0, 20.0)),
        "b": Parameter(0.3, bounds=(-20.0, 60.0)),
    }
    problem = Problem.from_function(banana, parameters, np.zeros(2), np.zeros(2), 1.0)
    return Posterior("banana, 2 parameters", problem, log_density, 4000)


GROUPS, EACH = 8, 12


def hierarchical(params: dict[str, Any], x: Any) -> Any:
    offsets = jnp.stack([params[f"z{i}"] for i in range(GROUPS)])
    return jnp.repeat(params["mean"] + params["between"] * offsets, EACH)


def _hierarchical() -> Posterior:
    rng = np.random.default_rng(14)
    groups = 10.0 + 2.0 * rng.normal(size=GROUPS)
    y = np.repeat(groups, EACH) + rng.normal(0.0, 3.0, GROUPS * EACH)
    sums = y.reshape(GROUPS, EACH)

    def log_density(v: np.ndarray) -> Any:
        mean, between, z = v[..., 0, None], v[..., 1, None], v[..., 2:]
        level = (mean + between * z)[..., None]
        misfit = np.sum((level - sums) ** 2, axis=(-2, -1)) / 9.0
        prior = np.sum(z**2, axis=-1) + (between[..., 0] / 5.0) ** 2
        prior = prior + ((mean[..., 0] - 10.0) / 20.0) ** 2
        return np.where(between[..., 0] >= 0.0, -0.5 * (misfit + prior), -np.inf)

    parameters = {
        "mean": Parameter(8.0, prior=Normal(10.0, 20.0)),
        "between": Parameter(1.0, bounds=(0.0, 100.0), prior=HalfNormal(5.0)),
        **{f"z{i}": Parameter(0.1, prior=Normal(0.0, 1.0)) for i in range(GROUPS)},
    }
    problem = Problem.from_function(hierarchical, parameters, np.zeros(y.size), y, 3.0)
    return Posterior(
        "hierarchical model of eight groups, 10 parameters", problem, log_density, 5000
    )


def posteriors() -> list[Posterior]:
    """All of them."""
    return [_wear_curve(), _linear_force(), _banana(), _hierarchical()]
