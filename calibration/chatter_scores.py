"""How far the scores of stable and of chattering cuts lie apart: a hierarchical model.

What is modelled is y = log(1 + D), the logarithm of a power over that of air cutting. Levels of
tools and of spindle speeds have a parent in common; windows of a cut have the cut's own level in
common, so that evidence counts cuts, not windows. Windows scatter about it by Student's t, for a
few are far off.

Notation: v level of a cut and tau its spread, beta levels (of stable cuts, of the gap to chatter,
of every tool and speed) and X which of them a cut has; s, nu, phi scale, degrees of freedom and
correlation of the windows of a cut.

    v ~ N(X beta, tau^2),  y_1 = v + s t(nu),
    y_i = v + phi (y_{i-1} - v) + s sqrt(1 - phi^2) t(nu)

All of v and beta is linear and normal and is integrated out, what the windows tell of v being taken
as normal about its best value (Laplace; exact in the limit of many degrees of freedom). What is
left, spreads and the law of windows, is sampled; levels are drawn given these.

References
----------
.. [1] A. Gelman, J. Hill, "Data analysis using regression and multilevel/hierarchical models",
   2007: partial pooling.
.. [2] K. L. Lange, R. J. A. Little, J. M. G. Taylor, JASA 84, 881-896, 1989: Student's t.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
import xarray
from jax import Array

from calibration.chatter_arrays import (
    CHATTER_COLUMN,
    MARGINAL_COLUMN,
    STABLE_COLUMN,
    NullLaw,
    arranged,
    speeds_of,
    tools_of,
)
from calibration.chatter_cuts import CutScores
from calibration.fitting import fit
from calibration.noise import Noise, StudentT
from calibration.parameters import Parameter
from calibration.priors import Beta, LogNormal, Prior
from calibration.problem import Dataset, Problem
from calibration.progress import ProgressOption
from calibration.sampling import sample
from procmodel.chatter import CHATTER, STABLE
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

# Priors of levels: where nothing is known of the noise, stable cuts are about a tenfold of air; a
# cut adds to noise, so that its level is known to a factor of four or so; chatter is at a few to a
# few thousand times that.
_USUAL_LEVEL, _LEVEL_SPREAD = math.log(10.0), 1.5
_GAP, _GAP_SPREAD = 2.0, 1.5
# Without a stable cut the law of noise stands for them; real cuts differ by about this much.
_NULL_SPREAD = 0.5
# What a cut without weight adds to its variance.
_NO_WEIGHT = 1e8
# Least information of the windows of a cut, as a share of what is expected.
_LEAST_TOLD = 0.5
_T = StudentT("freedom")


@dataclass(frozen=True)
class CutNoise(Noise):
    """Log density of cuts and their windows, from what `CutDensities` gives.

    Attributes
    ----------
    cuts : int
        Number of cuts c.
    """

    cuts: int

    @property
    def takes(self) -> tuple[str, ...]:
        """A number, which has no effect."""
        return ("given",)

    def log_likelihood(self, prediction: Array, y: Array, sigma: Array, values: Any) -> Array:
        """Minus z^2 / 2, minus the log scales, and the log densities of windows."""
        z, scale, windows = self._parts(prediction)
        return jnp.concatenate([-0.5 * z**2, -scale, windows])

    def rows(self, prediction: Array, y: Array, sigma: Array, values: Any) -> tuple[Array, ...]:
        """Deviations z, log scales with their part of the information, and windows.

        Of the windows J'J is the empirical information, the sum of squared derivatives.
        """
        z, scale, windows = self._parts(prediction)
        fixed = jax.lax.stop_gradient
        return (jnp.concatenate([z, scale - fixed(scale) + 1.0, windows - fixed(windows) - 1.0]),)

    def draw(self, rng: Any, prediction: Any, sigma: Any, values: Any) -> np.ndarray:
        """Not known here."""
        raise InputError("scores of cuts are not simulated by their noise.")

    def _parts(self, prediction: Array) -> tuple[Array, Array, Array]:
        c = self.cuts
        return prediction[:c], prediction[c : 2 * c], prediction[2 * c :]


@dataclass(frozen=True)
class CutDensities:
    """What the log density of labelled cuts is made of, as a model.

    Its parameters are those of `score_problem`, its x the arrays of `arranged`.
    """

    def __call__(self, params: Mapping[str, Array], x: Mapping[str, Array]) -> Array:
        """Standardised deviations and log scales of c cuts, then log densities of windows."""
        stable = x["share"][:, STABLE_COLUMN] > 0.0
        told = what_windows_tell(params, x)
        each = _T.log_likelihood(jnp.zeros(()), told.off, told.scale, params)
        each = jnp.where(x["used"], each, 0.0) * x["weight"][:, None]
        design, prior_mean, prior_variance = levels_prior(params, x)
        spread = jnp.where(stable, params["stable_cut_spread"], params["chatter_cut_spread"])
        variance = spread**2 + told.error + _NO_WEIGHT * (1.0 - x["weight"])
        covariance = (design * prior_variance) @ design.T + jnp.diag(variance)
        factor = jnp.linalg.cholesky(covariance)
        off = told.centre - design @ prior_mean
        z = jax.scipy.linalg.solve_triangular(factor, off, lower=True)
        # Laplace: the integral over v of the windows' density about its best value.
        added = 0.5 * jnp.log(told.error) + 0.5 * (told.centre - x["centre"]) ** 2 / told.error
        scale = jnp.log(jnp.diag(factor)) - x["weight"] * added
        return jnp.concatenate([z, scale, each.ravel()])


class Told(NamedTuple):
    """What the windows of every cut tell of its level.

    Attributes
    ----------
    centre, error : array, shape (c,)
        Best value of v, by a step of Newton's from the centre of the windows, and its variance.
    off, scale : array, shape (c, w)
        Innovation of every window about the centre of the windows, and its scale.
    """

    centre: Any
    error: Any
    off: Any
    scale: Any


def what_windows_tell(params: Mapping[str, Any], x: Mapping[str, Any], xp: Any = jnp) -> Told:
    """What the windows of every cut tell of its level, given how they scatter.

    Parameters
    ----------
    params : mapping of str to array
        Those of `score_problem`.
    x : mapping of str to array
        From `arranged`.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    Told
        For every cut.
    """
    stable, nu = x["share"][:, STABLE_COLUMN] > 0.0, params["freedom"]
    s, phi = (
        xp.where(stable, params[f"stable_{name}"], params[f"chatter_{name}"])[:, None]
        for name in ("spread", "correlation")
    )
    off = x["windows"] - x["centre"][:, None]
    before = xp.concatenate([xp.zeros_like(off[:, :1]), off[:, :-1]], axis=1)
    pull = xp.where(x["first"], 0.0, phi)
    scale = s * xp.sqrt(1.0 - pull**2)
    off = off - pull * before
    z, moves = off / scale, (1.0 - pull) / scale
    slope = xp.where(x["used"], moves * (nu + 1.0) * z / (nu + z**2), 0.0).sum(axis=1)
    expected = xp.where(x["used"], moves**2, 0.0).sum(axis=1) * (nu + 1.0) / (nu + 3.0)
    bend = moves**2 * (nu + 1.0) * (nu - z**2) / (nu + z**2) ** 2
    told = xp.where(x["used"], bend, 0.0).sum(axis=1)
    # Of few windows far apart the density has no single top; what is expected tells more then.
    told = xp.maximum(told, _LEAST_TOLD * expected)
    return Told(x["centre"] + slope / told, 1.0 / told, off, scale)


def levels_prior(
    params: Mapping[str, Any], x: Mapping[str, Any], xp: Any = jnp
) -> tuple[Any, Any, Any]:
    """Which levels a cut has, and what is known of them beforehand.

    Parameters
    ----------
    params : mapping of str to array
        Those of `score_problem`.
    x : mapping of str to array
        From `arranged`.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    design : array, shape (c, 2 + 2 t + k)
        X: level of stable cuts, gap to chatter, then level and gap of t tools, level of k speeds.
    mean, variance : array, shape (2 + 2 t + k,)
        Of the levels beta.
    """
    up = x["share"][:, CHATTER_COLUMN] + params["marginal_share"] * x["share"][:, MARGINAL_COLUMN]
    tool, speed, up = x["tool"], x["speed"], up[:, None]
    design = xp.concatenate([xp.ones_like(up), up, tool, up * tool, speed], axis=1)
    sizes = (tool.shape[1], tool.shape[1], speed.shape[1])
    names = ("tool_spread", "tool_gap_spread", "speed_spread")
    parts = [xp.ones(k) * params[name] ** 2 for k, name in zip(sizes, names, strict=True)]
    variance = xp.concatenate([x["level_variance"], *parts])
    mean = xp.concatenate([x["level_mean"], xp.zeros(sum(sizes))])
    return design, mean, variance


@dataclass(frozen=True)
class ScorePosterior:
    """What is known of the scores of cuts.

    Attributes
    ----------
    tree : xarray.DataTree
        Draws of the spreads and of the windows, from `calibration.sample`, with its diagnostics.
    cuts : tuple of CutScores
        The labelled cuts.
    used : ndarray, shape (c,) of bool
        Which of them it was learnt from.
    tools : tuple of str
        Tools, in the order of the levels.
    speeds : tuple of float [1/min]
        Spindle speeds, likewise.
    levels : ndarray, shape (m, 2 + 2 t + k)
        Draws of the levels, in the order of `levels_prior`.
    warnings : tuple of str
        What to know before using it.
    """

    tree: xarray.DataTree
    cuts: tuple[CutScores, ...]
    used: np.ndarray
    tools: tuple[str, ...]
    speeds: tuple[float, ...]
    levels: np.ndarray
    warnings: tuple[str, ...] = ()

    def draws(self, name: str) -> np.ndarray:
        """Draws of a parameter of `score_problem`, shape (m,), those of `levels` beside them."""
        return np.asarray(self.tree["posterior"][name]).ravel()

    @property
    def converged(self) -> bool:
        """Whether the chains agree and are long enough."""
        return bool(self.tree.attrs["converged"])

    @property
    def status(self) -> str:
        """R-hat and effective draws, as a sentence."""
        return str(self.tree.attrs["status"])

    def learnt_from(
        self, label: str | None = None, tool: str | Sequence[str] | None = None
    ) -> list[CutScores]:
        """Cuts that it was learnt from, of a label and of some tools, or of all."""
        tools = self.tools if tool is None else (tool,) if isinstance(tool, str) else tuple(tool)
        pairs = zip(self.cuts, self.used, strict=True)
        cuts = [cut for cut, used in pairs if used and cut.tool in tools]
        return [cut for cut in cuts if label in (None, cut.label)]

    def level(self, label: str, tool: str | None, speed: float | None, seed: int = 0) -> np.ndarray:
        """Level of cuts of a tool at a speed.

        Parameters
        ----------
        label : str
            "stable", "marginal" or "chatter".
        tool : str, optional
            One of `tools`; one that was never seen when left out.
        speed : float, optional [1/min]
            One of `speeds`; one that was never seen when left out.
        seed : int
            Of what is drawn for the unseen.

        Returns
        -------
        ndarray, shape (m,)
            Draws of the mean of y over cuts and windows.

        Raises
        ------
        InputError
            If tool or speed are unknown.
        """
        rng = np.random.default_rng(seed)
        count = len(self.tools)
        share = {STABLE: 0.0, CHATTER: 1.0}.get(label)
        up = self.draws("marginal_share") if share is None else share
        if tool is None:
            of_tool = self.draws("tool_spread") * rng.normal(size=len(self.levels))
            gap = self.draws("tool_gap_spread") * rng.normal(size=len(self.levels))
        else:
            if tool not in self.tools:
                raise InputError(f"no cut is of the tool {tool!r}{nearest(tool, self.tools)}.")
            place = 2 + self.tools.index(tool)
            of_tool, gap = self.levels[:, place], self.levels[:, place + count]
        if speed is None:
            of_speed = self.draws("speed_spread") * rng.normal(size=len(self.levels))
        else:
            if speed not in self.speeds:
                known = ", ".join(f"{s:g}" for s in self.speeds)
                raise InputError(f"no cut is at {speed:g} 1/min; known are {known}.")
            of_speed = self.levels[:, 2 + 2 * count + self.speeds.index(speed)]
        return self.levels[:, 0] + of_tool + of_speed + up * (self.levels[:, 1] + gap)


def fit_scores(
    cuts: Sequence[CutScores],
    *,
    null: NullLaw | None = None,
    left_out: Sequence[int] = (),
    parameters: Mapping[str, Parameter | float] | None = None,
    seed: int = 0,
    draws: int = 500,
    warmup: int = 300,
    chains: int = 4,
    progress: ProgressOption = None,
) -> ScorePosterior:
    """Learn the scores of stable and chattering cuts.

    Parameters
    ----------
    cuts : sequence of CutScores
        Labelled cuts, of any number of tools and speeds; a tool with few cuts borrows from others.
    null : NullLaw, optional
        Law of noise alone, which tells where stable scores are to be expected; without a stable
        cut it stands for them.
    left_out : sequence of int
        Cuts that are not to be learnt from, though their tools and speeds keep their place.
    parameters : mapping of str to Parameter or float, optional
        Instead of those of `score_problem`.
    seed : int
        Same seed, same draws.
    draws, warmup, chains : int
        Of the no-U-turn sampler, for each of its independent chains.
    progress : bool or callable, optional
        See `calibration.sample`.

    Returns
    -------
    ScorePosterior
        The posterior; a doubt about its convergence is among its warnings.

    Raises
    ------
    InputError
        If no chatter cut is left, or neither a stable cut nor the law of noise.
    """
    require_float64("A model of scores")
    problem = score_problem(cuts, null=null, left_out=left_out, parameters=parameters)
    start = fit(problem, bend=False, linear_algebra="gram")
    tree = sample(
        problem, seed, draws, "nuts", ensembles=chains, warmup=warmup, start=start,
        progress=progress,
    )  # fmt: skip
    used = np.ones(len(cuts), bool)
    used[list(left_out)] = False
    dataset = problem.datasets["cuts"]
    posterior = ScorePosterior(
        tree=tree,
        cuts=tuple(cuts),
        used=used,
        tools=tools_of(cuts),
        speeds=speeds_of(cuts),
        levels=_levels(problem, tree, dataset.x, np.random.default_rng(seed)),
    )
    warnings = []
    if not posterior.converged:
        warnings.append(f"the posterior is not to be trusted yet: {posterior.status}")
    if not posterior.learnt_from(STABLE):
        warnings.append(
            "no cut is labelled stable, and the law of noise stands for stable cuts: label some, "
            "for cutting alone raises the scores"
        )
    return dataclasses.replace(posterior, warnings=tuple(warnings))


def score_problem(
    cuts: Sequence[CutScores],
    *,
    null: NullLaw | None = None,
    left_out: Sequence[int] = (),
    parameters: Mapping[str, Parameter | float] | None = None,
) -> Problem:
    """The spreads and the windows of labelled cuts as a problem, levels integrated out.

    Parameters
    ----------
    cuts, null, left_out, parameters
        As for `fit_scores`.

    Returns
    -------
    Problem
        Parameters `stable_` and `chatter_`, each with `cut_spread` (tau), `spread` (s) and
        `correlation` (phi), marginal cuts being taken with chatter; `freedom` (nu);
        `marginal_share`, where between the two marginal cuts lie; `tool_spread`,
        `tool_gap_spread`, `speed_spread`.

    Raises
    ------
    InputError
        As for `fit_scores`, or if a parameter is unknown.
    """
    kept = [cut for i, cut in enumerate(cuts) if i not in set(left_out)]
    labels = [cut.label for cut in kept]
    if CHATTER not in labels:
        raise InputError("no cut is labelled chatter, so that nothing tells how high it scores.")
    bare = STABLE not in labels
    if bare and null is None:
        raise InputError(
            "no cut is labelled stable, so that nothing tells how low one scores; label one, or "
            "give the law of noise."
        )
    chosen = {name: _parameter(prior) for name, prior in _priors(null if bare else None).items()}
    for name, given in (parameters or {}).items():
        if name not in chosen:
            raise InputError(f"parameter {name!r} is unknown{nearest(name, tuple(chosen))}.")
        chosen[name] = given if isinstance(given, Parameter) else Parameter(given, fixed=True)
    x = arranged(cuts, left_out=left_out)
    level = _USUAL_LEVEL if null is None else null.quantile(0.5)
    spread = _NULL_SPREAD if bare else _LEVEL_SPREAD
    x["level_mean"] = np.array([level, _GAP])
    x["level_variance"] = np.array([spread, _GAP_SPREAD]) ** 2
    nothing = np.zeros(2 * len(cuts) + x["windows"].size)
    dataset = Dataset(x, nothing, 1.0, CutDensities(), noise=CutNoise(len(cuts)))
    return Problem(chosen, {"cuts": dataset}, name="scores of labelled cuts")


def _priors(null: NullLaw | None) -> dict[str, Prior]:
    """Weak priors, in units of y; the null law tells of stable windows where no stable cut does."""
    cut, windows = LogNormal(0.3, 0.6), LogNormal(0.3, 0.6)
    stable = windows
    if null is not None:
        stable = LogNormal(0.5 * (null.quantile(0.84) - null.quantile(0.16)), 0.4)
    return {
        "stable_cut_spread": cut,
        "chatter_cut_spread": cut,
        "stable_spread": stable,
        "chatter_spread": windows,
        "stable_correlation": Beta(2.0, 2.0, -1.0, 1.0),
        "chatter_correlation": Beta(2.0, 2.0, -1.0, 1.0),
        "freedom": LogNormal(8.0, 0.7),
        "marginal_share": Beta(2.0, 2.0),
        "tool_spread": LogNormal(0.5, 0.6),
        "tool_gap_spread": LogNormal(0.3, 0.6),
        "speed_spread": LogNormal(0.3, 0.6),
    }


def _parameter(prior: Prior) -> Parameter:
    if isinstance(prior, LogNormal):
        return Parameter(prior.median, "", (0.0, math.inf), prior, "log")
    low, high = prior.support
    return Parameter(0.5 * (low + high), "", (low, high), prior)


def _levels(
    problem: Problem, tree: xarray.DataTree, x: Mapping[str, np.ndarray], rng: np.random.Generator
) -> np.ndarray:
    """Levels given each draw of the others: normal, with precision P^-1 + X' V^-1 X."""
    drawn = tree["posterior"].dataset
    values = {name: np.asarray(drawn[name]).ravel() for name in problem.layout.free}
    size = len(next(iter(values.values())))
    fixed = dict(zip(problem.layout.fixed, problem.fixed_values, strict=True))
    values |= {name: np.full(size, value) for name, value in fixed.items()}
    stable = x["share"][:, STABLE_COLUMN] > 0.0
    levels = []
    for i in range(size):
        at = {name: float(value[i]) for name, value in values.items()}
        design, mean, variance = levels_prior(at, x, np)
        told = what_windows_tell(at, x, np)
        spread = np.where(stable, at["stable_cut_spread"], at["chatter_cut_spread"])
        known = x["weight"] / (spread**2 + told.error)
        precision = np.diag(1.0 / variance) + (design.T * known) @ design
        factor = scipy.linalg.cholesky(precision, lower=True)
        right = mean / variance + design.T @ (known * told.centre)
        centre = scipy.linalg.cho_solve((factor, True), right)
        noise = scipy.linalg.solve_triangular(factor.T, rng.normal(size=len(mean)))
        levels.append(centre + noise)
    return np.array(levels)
