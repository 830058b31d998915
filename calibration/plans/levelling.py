"""Levelling: a few last passes with falling feeds that take the tilt out of a cavity's bottom.

To-and-fro scanning turns the tilt of a layer over but leaves it as large. Passes that go on to and
fro with smaller and smaller feeds level it; which feeds, the derivative of the bottom says.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.plans.belief import believed_values
from calibration.plans.schedule import Schedule
from calibration.solvers import box_lm
from procmodel.errors import InputError
from procmodel.precision import require_float64
from procmodel.wear import TargetLayers
from procmodel.wear.tilt import start_up_layers, tilted_layers

PIECES = 100
# The bottom before levelling must be that of layers which no longer remember the first.
_LEAST_LAYERS, _MOST_LAYERS = 30, 400
_MOST_WEAR = 20.0
# Falls of the feed from pass to pass that the search starts from.
_FALLS = (0.2, 0.3, 0.4, 0.5, 0.65)


@dataclass(frozen=True)
class LevellingPlan:
    """Passes after the last layer, on its path, to and fro.

    Attributes
    ----------
    feeds : ndarray, shape (p,) [um]
        Feed before every pass, in whole steps of the machine's resolution.
    tilt_before, tilt : float [um]
        Greatest less least depth of the bottom before and after the passes, at the middle of what
        is believed of the wear.
    tilt_limit : float [um]
        The worst tilt after the passes over what is believed of the wear.
    depths : ndarray, shape (p,) [um]
        Mean depth of the bottom after every pass, below where it was before the first.
    wear : ndarray, shape (p,) [um]
        Electrode length lost in every pass.
    bottom_before, bottom : ndarray, shape (m,) [um]
        Depth along the path about its mean, before and after.
    status : str
        What was done, as a sentence.
    """

    feeds: np.ndarray
    tilt_before: float
    tilt: float
    tilt_limit: float
    depths: np.ndarray
    wear: np.ndarray
    bottom_before: np.ndarray
    bottom: np.ndarray
    status: str

    @property
    def depth_added(self) -> float:
        """Mean depth that the passes add to the bottom [um]; feed the layers so much less."""
        return float(self.depths[-1])


def levelling_passes(
    feed: float,
    relative_wear: Any,
    passes: int = 4,
    *,
    resolution: float = 0.0,
) -> LevellingPlan:
    """Feeds of levelling passes, found by the derivative of the bottom.

    Parameters
    ----------
    feed : float [um]
        Feed of the layers before, cut to and fro until they are steady.
    relative_wear : float, FitResult, xarray.DataTree or ndarray
        u = R S_w / S_e of the layer: a number, or what is believed of it, under its name
        ``relative_wear``. The bottom is levelled for all of it together.
    passes : int
        Number of passes, at least 1.
    resolution : float [um]
        Step of the machine; feeds are whole steps, at least one. 0 does not round.

    Returns
    -------
    LevellingPlan
        The passes.

    Raises
    ------
    InputError
        If feed, wear, number of passes or resolution are out of range.
    """
    require_float64("Levelling")
    if not (math.isfinite(feed) and feed > 0.0):
        raise InputError(f"feed is {feed:g} um, but must be above 0.")
    if passes < 1:
        raise InputError(f"the number of levelling passes is {passes}, but must be at least 1.")
    if not 0.0 <= resolution < feed:
        raise InputError(
            f"resolution is {resolution:g} um, but must be 0 or more and below the feed of "
            f"{feed:g} um."
        )
    believed = believed_values(relative_wear, "relative_wear")
    if not 0.0 < believed[0] <= believed[-1] <= _MOST_WEAR:
        raise InputError(
            f"relative wear is {believed[0]:g} to {believed[-1]:g}, but must be above 0 and at "
            f"most {_MOST_WEAR:g}: with none there is no tilt, with more a layer uses the "
            "electrode up."
        )
    settled = max(start_up_layers(float(u), 1e-4) for u in believed)
    layers = min(max(settled, _LEAST_LAYERS), _MOST_LAYERS)
    arguments = (jnp.asarray(believed), jnp.ones(layers))
    least, most = np.full(passes, resolution / feed), np.ones(passes)
    best: tuple[float, np.ndarray, bool] = (math.inf, least, False)
    for fall in _FALLS:
        begin = np.clip(fall ** np.arange(1, passes + 1), least, most)
        vector, code = _level(jnp.asarray(begin), jnp.asarray(least), jnp.asarray(most), arguments)
        found = _in_steps(np.asarray(vector), resolution / feed)
        worst = float(jnp.max(_tilts(jnp.asarray(found), arguments)))
        if worst < best[0]:
            best = (worst, found, int(code) in box_lm.CONVERGED)
    worst, shares, converged = best
    middle = len(believed) // 2
    found = _levelled(jnp.asarray(shares), arguments)
    # From before the first pass on.
    bottoms, worn = (np.asarray(values)[middle, -passes - 1 :] for values in found)
    before, after = bottoms[0], bottoms[-1]
    end = (
        "no feed inside the bounds levels better"
        if converged
        else f"the best of {len(_FALLS)} searches, which ended at a kink where a pass stops cutting"
    )
    return LevellingPlan(
        feeds=feed * shares,
        tilt_before=feed * float(np.ptp(before)),
        tilt=feed * float(np.ptp(after)),
        tilt_limit=feed * worst,
        depths=feed * (bottoms[1:].mean(axis=1) - before.mean()),
        wear=feed * worn[1:],
        bottom_before=feed * (before - before.mean()),
        bottom=feed * (after - after.mean()),
        status=f"{passes} levelling passes after {layers} steady layers: {end}",
    )


def with_levelling(
    schedule: Schedule, passes: LevellingPlan, usable_length: float | None = None
) -> Schedule:
    """A schedule that goes on with levelling passes over its last layer.

    Parameters
    ----------
    schedule : Schedule
        The layers.
    passes : LevellingPlan
        For the last layer's feed and relative wear, in the machine's steps.
    usable_length : float, optional [um]
        Usable length of an electrode, as the schedule was planned with.

    Returns
    -------
    Schedule
        The passes stand behind the layers as thin layers of the last one's section, with the mean
        depth that they reach as what is wanted.
    """
    layers, count = schedule.layers, len(passes.feeds)
    bottom = np.concatenate([layers.bottom, float(layers.bottom[-1]) + passes.depths])

    def again(values: Any) -> np.ndarray:
        return np.concatenate([values, np.repeat(np.asarray(values)[-1:], count)])

    fed = schedule.cumulative_feed
    # Without a usable length what is left is counted from the need of the whole plan.
    need = float(np.sum(passes.wear))
    left = schedule.electrode_left + (need if usable_length is None else 0.0)
    warnings = schedule.warnings
    if usable_length is None:
        warnings = (*warnings, f"the levelling passes need {need:.4g} um more of it")
    if usable_length is not None and left[-1] < need:
        warnings = (
            *warnings,
            f"the levelling passes wear {need:.4g} um off an electrode that has {left[-1]:.4g} um "
            "left: change it before them and touch off anew",
        )
    return replace(
        schedule,
        layers=TargetLayers(
            bottom=jnp.asarray(bottom),
            thickness=jnp.asarray(np.diff(bottom, prepend=0.0)),
            half_width=jnp.asarray(again(layers.half_width)),
            area=jnp.asarray(again(layers.area)),
        ),
        feeds=np.concatenate([schedule.feeds, passes.feeds]),
        cumulative_feed=np.concatenate([fed, fed[-1] + np.cumsum(passes.feeds)]),
        depths=np.concatenate([schedule.depths, schedule.depths[-1] + passes.depths]),
        depth_spread=again(schedule.depth_spread),
        wear=np.concatenate([schedule.wear, passes.wear]),
        electrode_left=np.concatenate([left, left[-1] - np.cumsum(passes.wear)]),
        electrode_length_limit=schedule.electrode_length_limit + float(np.sum(passes.wear)),
        status=f"{schedule.status}, and {count} levelling passes",
        warnings=warnings,
    )


def _in_steps(shares: np.ndarray, step: float) -> np.ndarray:
    """Feeds in whole steps, their sum rounded rather than each of them."""
    if step <= 0.0:
        return shares
    sums = np.round(np.cumsum(shares) / step)
    return np.maximum(np.diff(sums, prepend=0.0), 1.0) * step


@jax.jit
def _levelled(shares: Array, arguments: tuple[Array, Array]) -> tuple[Array, Array]:
    """Bottoms after every layer and pass, shape (k, n, m), and wear in each, for a feed of 1."""
    believed, layers = arguments
    feeds = jnp.concatenate([layers, shares])
    forward = np.arange(len(layers) + len(shares)) % 2 == 0
    found = jax.vmap(lambda wear: tilted_layers(feeds, wear, forward, PIECES))(believed)
    return found.depth, found.wear


def _tilts(shares: Array, arguments: tuple[Array, Array]) -> Array:
    after = _levelled(shares, arguments)[0][:, -1]
    return jnp.max(after, axis=1) - jnp.min(after, axis=1)


def _unevenness(shares: Array, arguments: tuple[Array, Array]) -> Array:
    after = _levelled(shares, arguments)[0][:, -1]
    return (after - jnp.mean(after, axis=1, keepdims=True)).ravel()


@jax.jit
def _level(
    begin: Array, least: Array, most: Array, arguments: tuple[Array, Array]
) -> tuple[Array, Array]:
    outcome = box_lm.solve(_unevenness, begin, least, most, arguments)
    return outcome.vector, outcome.status
