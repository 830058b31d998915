"""Log density of the scores of labelled cuts, levels integrated out.

The model and its notation are those of `calibration.chatter_scores`. Everything normal is done in
the space of the levels beta, which do not grow with the cuts: their precision afterwards is
P^-1 + X' V^-1 X, with P their variance beforehand and V that of a cut about its levels.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.chatter_arrays import CHATTER_COLUMN, MARGINAL_COLUMN, STABLE_COLUMN
from calibration.noise import Noise, StudentT
from procmodel.errors import InputError

# What a cut without weight adds to its variance.
_NO_WEIGHT = 1e8
# Least information of the windows of a cut, as a share of what is expected.
_LEAST_TOLD = 0.5
_T = StudentT("freedom")


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
    # Of few windows far apart the density has no single top; what is expected tells more then. A
    # smooth maximum, as a kink would hold up fits.
    least, width = _LEAST_TOLD * expected, 0.1 * expected
    told = 0.5 * (told + least + xp.sqrt((told - least) ** 2 + width**2))
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


class Known(NamedTuple):
    """What cuts tell of the levels.

    Attributes
    ----------
    design : array, shape (c, q)
        X.
    mean, prior : array, shape (q,)
        Mean and variance of the levels beforehand.
    variance : array, shape (c,)
        Of a cut about its levels.
    factor : array, shape (q, q)
        Lower factor of their precision afterwards, P^-1 + X' V^-1 X.
    pull : array, shape (q,)
        X' V^-1 (y - X mean).
    """

    design: Any
    mean: Any
    prior: Any
    variance: Any
    factor: Any
    pull: Any


def known_levels(
    params: Mapping[str, Any], x: Mapping[str, Any], told: Told, xp: Any = jnp
) -> Known:
    """What cuts tell of the levels, given spreads and windows.

    Parameters
    ----------
    params : mapping of str to array
        Those of `score_problem`.
    x : mapping of str to array
        From `arranged`.
    told : Told
        From `what_windows_tell`.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    Known
        The levels are normal.
    """
    stable = x["share"][:, STABLE_COLUMN] > 0.0
    design, mean, prior = levels_prior(params, x, xp)
    spread = xp.where(stable, params["stable_cut_spread"], params["chatter_cut_spread"])
    variance = spread**2 + told.error + _NO_WEIGHT * (1.0 - x["weight"])
    weighted = design.T / variance
    factor = xp.linalg.cholesky(xp.diag(1.0 / prior) + weighted @ design)
    return Known(design, mean, prior, variance, factor, weighted @ (told.centre - design @ mean))


@dataclass(frozen=True)
class CutNoise(Noise):
    """Log density of cuts and their windows, from what `CutDensities` gives.

    Attributes
    ----------
    deviations, scales : int
        How many of each there are.
    """

    deviations: int
    scales: int

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
        first, second = self.deviations, self.deviations + self.scales
        return prediction[:first], prediction[first:second], prediction[second:]


@dataclass(frozen=True)
class CutDensities:
    """What the log density of labelled cuts is made of, as a model.

    Its parameters are those of `score_problem`, its x the arrays of `arranged`.
    """

    def __call__(self, params: Mapping[str, Array], x: Mapping[str, Array]) -> Array:
        """Standardised deviations of cuts and levels, log scales, log densities of windows.

        Integrated over the levels, the density of the cuts is that of the best levels, times the
        root of the ratio of what is known of them before and after.
        """
        told = what_windows_tell(params, x)
        each = _T.log_likelihood(jnp.zeros(()), told.off, told.scale, params)
        each = jnp.where(x["used"], each, 0.0) * x["weight"][:, None]
        known = known_levels(params, x, told)
        best = jax.scipy.linalg.cho_solve((known.factor, True), known.pull)
        deviation = jnp.sqrt(known.variance)
        z = (told.centre - known.design @ (known.mean + best)) / deviation
        of_levels = best / jnp.sqrt(known.prior)
        # Laplace: the integral over v of the windows' density about its best value.
        added = 0.5 * jnp.log(told.error) + 0.5 * (told.centre - x["centre"]) ** 2 / told.error
        scale = jnp.log(deviation) - x["weight"] * added
        ratio = jnp.log(jnp.diag(known.factor)).sum() + 0.5 * jnp.log(known.prior).sum()
        return jnp.concatenate([z, of_levels, scale, ratio[None], each.ravel()])
