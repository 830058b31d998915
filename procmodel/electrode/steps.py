"""How many steps a line or an arc takes, how far its chords are off, how fast every axis moves.

Lengths in um, angles in rad, speeds in um/s.

Notation: dL step, N number of steps, theta step angle, L length, r radius.

References
----------
.. [1] X. Guo, W. Pei, Z. Yu, J. Li, shaped micro-electrodes by line and arc interpolation in wire
   electro-discharge grinding (in Chinese).
"""

import math

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.electrode.checks import number, positive, step_count
from procmodel.errors import InputError
from procmodel.numerics import safe_sqrt


def line_steps(length: float, step: float) -> tuple[int, float]:
    """Steps along a line.

    Parameters
    ----------
    length : float [um]
        Length L of the line, 0 or more.
    step : float [um]
        Greatest step dL.

    Returns
    -------
    tuple of int and float [um]
        N = ceil(L / dL) [1]_, and the length of the last step. A whole multiple of the step to
        within 1e-9 of it takes no further step.

    Raises
    ------
    InputError
        If a length is not finite or has the wrong sign, or there are too many steps for an array.
    """
    dl, total = positive("the step", step), number("the length", length)
    if total < 0.0:
        raise InputError(f"the length is {total:g} um, but must be 0 or more.")
    count = step_count(total / dl) or int(total > 0.0)
    return count, total - max(count - 1, 0) * dl


def step_angle(radius: float, step: float) -> float:
    """Angle of a step along an arc.

    Parameters
    ----------
    radius : float [um]
        Radius r.
    step : float [um]
        Chord dL of a step.

    Returns
    -------
    float [rad]
        theta = 2 asin(dL / (2 r)), or half a turn where the step reaches across the circle.

    Raises
    ------
    InputError
        If a length is not above 0.
    """
    r, dl = positive("the radius", radius), positive("the step", step)
    return 2.0 * math.asin(min(dl / (2.0 * r), 1.0))


def arc_steps(radius: float, sweep: float, step: float) -> tuple[int, float]:
    """Steps along an arc.

    Parameters
    ----------
    radius : float [um]
        Radius r.
    sweep : float [rad]
        Angle of the arc, in either direction.
    step : float [um]
        Chord dL of a step.

    Returns
    -------
    tuple of int and float [rad]
        N = ceil(abs(sweep) / theta) [1]_, and the angle of the last step, guarded as in
        `line_steps`.

    Raises
    ------
    InputError
        As `line_steps`.
    """
    theta, turn = step_angle(radius, step), abs(number("the sweep", sweep, "rad"))
    count = step_count(turn / theta) or int(turn > 0.0)
    return count, turn - max(count - 1, 0) * theta


def chord_error(radius: ArrayLike, step: ArrayLike) -> Array:
    """Greatest distance of a chord from its arc.

    Parameters
    ----------
    radius : array_like [um]
        Radius r.
    step : array_like [um]
        Chord dL, at most 2 r.

    Returns
    -------
    Array [um]
        r (1 - cos(theta / 2)), about dL^2 / (8 r).
    """
    r, half = jnp.asarray(radius), 0.5 * jnp.asarray(step)
    # r - sqrt(r^2 - half^2) without the difference of two almost equal numbers.
    return half**2 / (r + safe_sqrt(r**2 - half**2))


def step_for_tolerance(radius: ArrayLike, tolerance: ArrayLike) -> Array:
    """Step whose chord leaves its arc by a given distance.

    Parameters
    ----------
    radius : array_like [um]
        Radius r.
    tolerance : array_like [um]
        Chord error allowed.

    Returns
    -------
    Array [um]
        dL = 2 sqrt(e (2 r - e)); the diameter where the tolerance is the radius or more.
    """
    r = jnp.asarray(radius)
    error = jnp.minimum(jnp.asarray(tolerance), r)
    return 2.0 * safe_sqrt(error * (2.0 * r - error))


def axis_speeds(points: ArrayLike, feed: float) -> np.ndarray:
    """Speed of every axis in every step, all of them arriving together.

    Parameters
    ----------
    points : array_like, shape (N + 1, d) [um]
        Positions along the path.
    feed : float [um/s]
        Speed along the path.

    Returns
    -------
    numpy.ndarray, shape (N, d) [um/s]
        The feed times the cosines of the step's direction; 0 in a step that does not move.

    Raises
    ------
    InputError
        If the feed is not above 0.
    """
    speed = positive("the feed", feed, "um/s")
    moves = np.diff(np.asarray(points, dtype=np.float64), axis=0)
    lengths = np.sqrt(np.sum(moves**2, axis=1, keepdims=True))
    return speed * np.divide(moves, lengths, out=np.zeros_like(moves), where=lengths > 0.0)
