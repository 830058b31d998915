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
from typing import Any

import jax.numpy as jnp
import numpy as np
import scipy.linalg
import xarray

from calibration.chatter_arrays import NullLaw, arranged, speeds_of, tools_of
from calibration.chatter_cuts import CutScores
from calibration.chatter_density import CutDensities, CutNoise, known_levels, what_windows_tell
from calibration.fitting import fit
from calibration.parameters import Parameter
from calibration.priors import Beta, LogNormal, Normal, Prior
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
        fixed = self.tree.attrs.get(f"fixed_{name}")
        if fixed is not None:
            return np.full(len(self.levels), float(fixed))
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
        Instead of those of `score_problem`, such as a number that fixes one.
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
    start = start if start.converged else fit(problem)
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
        `tool_gap_spread`, `speed_spread`. Spreads and nu are sampled by their logarithms `log_`,
        correlations by `artanh_`.

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
    chosen: dict[str, Parameter | float] = {}
    for name, prior in _priors(null if bare else None).items():
        if name in (parameters or {}):
            continue
        if isinstance(prior, LogNormal):
            at = math.log(prior.median)
            chosen[f"log_{name}"] = Parameter(at, prior=Normal(at, prior.log_std))
            chosen[name] = Parameter(prior.median, tied=_Exponential(f"log_{name}"))
        elif name.endswith("_correlation"):
            chosen[f"artanh_{name}"] = Parameter(0.0, prior=prior)
            chosen[name] = Parameter(0.0, tied=_Tangent(f"artanh_{name}"))
        else:
            low, high = prior.support
            chosen[name] = Parameter(0.5 * (low + high), "", (low, high), prior)
    for name, given in (parameters or {}).items():
        known = tuple(_priors(None))
        if name not in known:
            raise InputError(f"parameter {name!r} is unknown{nearest(name, known)}.")
        chosen[name] = given
    x = arranged(cuts, left_out=left_out)
    level = _USUAL_LEVEL if null is None else null.quantile(0.5)
    spread = _NULL_SPREAD if bare else _LEVEL_SPREAD
    x["level_mean"] = np.array([level, _GAP])
    x["level_variance"] = np.array([spread, _GAP_SPREAD]) ** 2
    levels = 2 + 2 * x["tool"].shape[1] + x["speed"].shape[1]
    noise = CutNoise(len(cuts) + levels, len(cuts) + 1)
    nothing = np.zeros(noise.deviations + noise.scales + x["windows"].size)
    dataset = Dataset(x, nothing, 1.0, CutDensities(), noise=noise)
    return Problem(chosen, {"cuts": dataset}, name="scores of labelled cuts")


def _priors(null: NullLaw | None) -> dict[str, Prior]:
    """Weak priors, in units of y; of a correlation, that of its Fisher transform.

    The null law tells of the windows of stable cuts where there are none.
    """
    cut, windows = LogNormal(0.3, 0.6), LogNormal(0.3, 0.6)
    stable = windows
    if null is not None:
        stable = LogNormal(0.5 * (null.quantile(0.84) - null.quantile(0.16)), 0.4)
    return {
        "stable_cut_spread": cut,
        "chatter_cut_spread": cut,
        "stable_spread": stable,
        "chatter_spread": windows,
        "stable_correlation": Normal(0.0, 0.5),
        "chatter_correlation": Normal(0.0, 0.5),
        "freedom": LogNormal(8.0, 0.7),
        "marginal_share": Beta(2.0, 2.0),
        "tool_spread": LogNormal(0.5, 0.6),
        "tool_gap_spread": LogNormal(0.3, 0.6),
        "speed_spread": LogNormal(0.3, 0.6),
    }


@dataclass(frozen=True)
class _Exponential:
    """A parameter by its logarithm: on it, spreads that a few cuts tell of are nearly normal."""

    of: str

    def __call__(self, params: Mapping[str, Any]) -> Any:
        return jnp.exp(params[self.of])


@dataclass(frozen=True)
class _Tangent:
    """A correlation by Fisher's transform."""

    of: str

    def __call__(self, params: Mapping[str, Any]) -> Any:
        return jnp.tanh(params[self.of])


def _levels(
    problem: Problem, tree: xarray.DataTree, x: Mapping[str, np.ndarray], rng: np.random.Generator
) -> np.ndarray:
    """Levels given each draw of the others: normal, with precision P^-1 + X' V^-1 X."""
    drawn = tree["posterior"].dataset
    values = {str(name): np.asarray(drawn[name]).ravel() for name in drawn}
    size = len(next(iter(values.values())))
    fixed = dict(zip(problem.layout.fixed, problem.fixed_values, strict=True))
    values |= {name: np.full(size, value) for name, value in fixed.items()}
    levels = []
    for i in range(size):
        at = {name: float(value[i]) for name, value in values.items()}
        known = known_levels(at, x, what_windows_tell(at, x, np), np)
        best = scipy.linalg.cho_solve((known.factor, True), known.pull)
        noise = scipy.linalg.solve_triangular(known.factor.T, rng.normal(size=len(best)))
        levels.append(known.mean + best + noise)
    return np.array(levels)
