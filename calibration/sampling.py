"""`sample`: draws from the posterior of a problem, as an ArviZ DataTree."""

import functools
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import xarray
from jax import Array

from calibration.black_box import BlackBox, failures_explained
from calibration.checkpoint import Checkpoint
from calibration.fitting import fit
from calibration.noise import Robust
from calibration.posterior import as_tree
from calibration.problem import Problem
from calibration.progress import ProgressOption, reporting
from calibration.result import FitResult
from calibration.samplers import driver
from calibration.structure import ProblemStructure
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

SAMPLERS = ("auto", "stretch", "emcee", "nuts")
# Steps kept when nothing is said: a step of NUTS is worth some fifty of the stretch move.
STEPS = {"stretch": 4_000, "emcee": 4_000, "nuts": 1_000}
ENSEMBLES = {"stretch": 4, "emcee": 4, "nuts": 8}
# From here on gradients pay: stretch moves mix ever more slowly with the number of parameters.
NUTS_FROM = 5
_NUTS_WARMUP = 600
_CLOUD = 256


def sample(
    problem: Problem,
    seed: int = 0,
    draws: int | None = None,
    sampler: str = "auto",
    *,
    ensembles: int | None = None,
    walkers: int | None = None,
    warmup: int | None = None,
    start: FitResult | None = None,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: ProgressOption = None,
) -> xarray.DataTree:
    """Draw from the posterior of the free parameters.

    Parameters
    ----------
    problem : Problem
        Model, parameters (bounds and priors) and readings. A parameter without prior is uniform
        inside its bounds; an unknown noise level is integrated out under 1/sigma.
    seed : int
        Same seed, same draws.
    draws : int, optional
        Draws kept in each ensemble, rounded up to whole steps of all its walkers. When left out,
        4,000 steps of all walkers, or 1,000 of "nuts", whose draws are nearly independent.
    sampler : {"auto", "stretch", "emcee", "nuts"}
        "stretch" is our compiled ensemble of the stretch move, "emcee" the same move by emcee for
        models outside JAX, "nuts" blackjax' no-U-turn sampler. "auto" takes "emcee" for a black
        box, "nuts" from 5 free parameters on and "stretch" below; the DataTree says which and why.
    ensembles : int, optional
        Independent ensembles of walkers (4 when left out), or chains of "nuts" (8), at least 2.
        They are the chains of the DataTree: the walkers of one ensemble know of each other and
        are not.
    walkers : int, optional
        Walkers of an ensemble, at least twice the number of free parameters.
    warmup : int, optional
        Steps before those kept: half as many as kept when left out, 600 for "nuts".
    start : FitResult, optional
        Fit to start around; made when left out.
    checkpoint : path-like, optional
        File (.h5) that the state is written to every now and then.
    resume : bool
        Go on from that file if it is there. The result is that of an uninterrupted run to the bit.
    progress : bool or callable, optional
        True for a bar on stderr, or a function of (stage, done, total).

    Returns
    -------
    xarray.DataTree
        Groups ``posterior`` (free and tied parameters, noise levels), ``sample_stats`` (``lp``)
        and ``observed_data``. Attributes: model, data hash, sampler and why, seed, acceptance,
        autocorrelation, rhat, ess_bulk, ess_tail, ``converged`` (0 or 1) and ``status``, a
        sentence.

    Raises
    ------
    InputError
        If a name or count is wrong, the fit fails, the posterior cannot be normalised because
        the data leave a parameter without finite bounds open, or the checkpoint is of another run.
    """
    require_float64("Sampling")
    if sampler not in SAMPLERS:
        raise InputError(f"sampler {sampler!r} is unknown{nearest(sampler, SAMPLERS)}.")
    chosen, why = _choice(problem, sampler)
    dimensions = len(problem.layout.free)
    walkers = 1 if chosen == "nuts" else walkers or _walkers(problem)
    if chosen != "nuts" and (walkers < 2 * dimensions or walkers % 2):
        raise InputError(
            f"walkers is {walkers}, but must be even and at least {2 * dimensions}, twice the "
            "number of free parameters."
        )
    ensembles = ENSEMBLES[chosen] if ensembles is None else ensembles
    draws = STEPS[chosen] * walkers if draws is None else draws
    if ensembles < 2 or draws < walkers or seed < 0:
        raise InputError(
            f"ensembles must be at least 2, draws at least {walkers} and the seed not below 0."
        )
    if resume and checkpoint is None:
        raise InputError("resume needs the checkpoint to go on from: name it.")
    steps = -(-draws // walkers)
    if warmup is None:
        warmup = _NUTS_WARMUP if chosen == "nuts" else max(1, steps // 2)
    if warmup < (20 if chosen == "nuts" else 0):
        raise InputError(f"warmup is {warmup}, but must be at least 20 for nuts and 0 otherwise.")
    with reporting(progress) as told:
        told.compiling("fit")
        start = start or fit(problem)
        _require_proper(problem, start)
        told.running("fit", 1, 1)
        rng = np.random.default_rng(seed)
        clouds = _clouds(problem, start, chosen, ensembles, walkers, rng)
        seed_of_moves = int(rng.integers(2**31))
        configuration = {
            "model": problem.name,
            "model code": _code_of(problem),
            "data": problem.data_hash,
            "parameters": _parameters_of(problem),
            "sampler": chosen,
            "seed": seed,
            "draws": steps * walkers,
            "ensembles": ensembles,
            "walkers": walkers,
            "warm-up": warmup,
            "start": hashlib.sha256(clouds.tobytes()).hexdigest()[:12],
        }
        kept_in = None if checkpoint is None else Checkpoint(checkpoint, configuration, resume)
        engine = _engine(problem, chosen, clouds, warmup, seed_of_moves)
        with failures_explained(problem.structure.functions):
            found = driver.run(engine, steps, kept_in, told)
    return as_tree(problem, found, rng, {"sampler": chosen, "sampler_reason": why, "seed": seed})


def draws_alone(
    problem: Problem, start: FitResult, seed: int, sampler: str, steps: int, warmup: int
) -> tuple[str, np.ndarray]:
    """A few draws far apart, without diagnostics, for checks that repeat it many times.

    Parameters
    ----------
    problem : Problem
        What is sampled.
    start : FitResult
        Its fit.
    seed : int
        Same seed, same draws.
    sampler : str
        As for `sample`.
    steps, warmup : int
        Length of the run.

    Returns
    -------
    str, ndarray of shape (m, p)
        The sampler, and natural values of the free parameters.
    """
    chosen, _ = _choice(problem, sampler)
    _require_proper(problem, start)
    rng = np.random.default_rng(seed)
    clouds = _clouds(problem, start, chosen, 4, _walkers(problem), rng)
    engine = _engine(problem, chosen, clouds, warmup, int(rng.integers(2**31)))
    with reporting(None) as told:
        found = driver.run(engine, steps, None, told)
    # Far enough apart to be nearly independent: NUTS every few steps, walkers every fifty.
    apart = 5 if chosen == "nuts" else 50
    return chosen, found.positions[apart - 1 :: apart].reshape(-1, clouds.shape[-1])


def _choice(problem: Problem, sampler: str) -> tuple[str, str]:
    """The sampler to take, and why."""
    count = len(problem.layout.free)
    if sampler != "auto":
        return sampler, "asked for"
    if any(isinstance(f, BlackBox) for f in problem.structure.functions):
        return "emcee", "auto: the model is a black box"
    if count >= NUTS_FROM:
        return "nuts", f"auto: {count} free parameters, and gradients pay from {NUTS_FROM} on"
    return "stretch", f"auto: {count} free parameters, fewer than {NUTS_FROM}"


def _engine(
    problem: Problem, sampler: str, clouds: np.ndarray, warmup: int, seed: int
) -> driver.Sampler:
    lower, upper = problem.layout.natural_bounds()
    arguments = jax.device_put((problem.fixed_values, problem.data(), lower, upper))
    density = LogPosterior(problem.structure)
    if sampler == "nuts":
        from calibration.samplers.nuts import NutsSampler

        cloud = clouds.swapaxes(0, 1).reshape(-1, clouds.shape[-1])
        return NutsSampler(density, cloud, arguments, (lower, upper), len(clouds), warmup, seed)
    if sampler == "emcee":
        from calibration.samplers.emcee_ensemble import EmceeSampler

        return EmceeSampler(
            lambda vectors: np.asarray(_log_densities(density, vectors, arguments)),
            clouds,
            warmup,
            seed,
        )
    from calibration.samplers.stretch import StretchSampler

    return StretchSampler(density, clouds, arguments, warmup, seed)


@dataclass(frozen=True)
class LogPosterior:
    """Log density of a problem; two of the same structure share what was compiled."""

    structure: ProblemStructure

    def __call__(self, vector: Array, arguments: tuple) -> Array:
        """At natural values; arguments as for `ProblemStructure.log_density`."""
        return self.structure.log_density(vector, arguments)


@functools.partial(jax.jit, static_argnames="density")
def _log_densities(density: LogPosterior, vectors: Array, arguments: tuple) -> Array:
    return jax.vmap(lambda v: density(v, arguments))(vectors)


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
    for name, dataset in problem.datasets.items():
        if isinstance(dataset.noise, Robust) and dataset.sigma is None:
            raise InputError(
                f"data set {name!r}: a robust loss without sigma is no probability to draw from: "
                "give sigma, or take StudentT with sigma as a parameter."
            )
    for name, bounds in zip(problem.layout.free, problem.layout.bounds, strict=True):
        estimate = start.parameters[name]
        if estimate.interval95 is None and not np.all(np.isfinite(bounds)):
            raise InputError(
                f"the posterior of {name!r} cannot be normalised, for the data leave it open "
                "and its bounds are infinite: give it finite bounds or a prior, or fix it."
            )


def _walkers(problem: Problem) -> int:
    """Walkers of an ensemble when nothing is said."""
    return max(16, 4 * len(problem.layout.free))


def _clouds(
    problem: Problem,
    start: FitResult,
    sampler: str,
    ensembles: int,
    walkers: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Points to start each ensemble from, shape (ensembles, points, p); more of them for NUTS."""
    count = _CLOUD if sampler == "nuts" else walkers
    return np.stack([_laplace_start(problem, start, count, rng) for _ in range(ensembles)])


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


def _code_of(problem: Problem) -> str:
    """Digest of what the models do, as far as Python tells."""
    digest = hashlib.sha256()
    for function in problem.structure.functions:
        code = getattr(function, "__code__", None)
        text = repr(function) if code is None else f"{code.co_code!r}{code.co_names}"
        digest.update(text.split(" at 0x")[0].encode())
        if code is not None:
            constants = [c for c in code.co_consts if not hasattr(c, "co_code")]
            digest.update(repr(constants).encode())
    return digest.hexdigest()[:12]


def _parameters_of(problem: Problem) -> dict[str, Any]:
    """The parameters as plain types, for a checkpoint's configuration."""
    described = {}
    for name, p in problem.parameters.items():
        tied = getattr(p.tied, "__name__", p.tied)
        prior = None if p.prior is None else repr(p.prior).split(" at 0x")[0]
        described[name] = [p.value, list(map(str, p.bounds)), prior, p.transform, p.fixed, tied]
    return described
