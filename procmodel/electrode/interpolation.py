"""Lines and arcs cut into steps of equal length, as a sampled-data controller moves along them.

A line of length L is run in N = ceil(L / dL) steps, the first N - 1 of length dL and the last of
what is left; an arc in steps of the angle theta = 2 asin(dL / (2 r)), whose chord is dL. Every
position is computed from its own number and then rounded to the resolution of the axes, so that no
error adds up along the path. Lengths in um, angles in rad, speeds in um/s.

`interpolate_...` returns NumPy arrays with as many points as the path takes. `line_points` and
`arc_points` are the same positions for a given count, in JAX, differentiable in everything else.

Notation: dL step, N number of steps, theta step angle, r radius.

References
----------
.. [1] X. Guo, W. Pei, Z. Yu, J. Li, shaped micro-electrodes by line and arc interpolation in wire
   electro-discharge grinding (in Chinese).
"""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.electrode.checks import number, position, positive, step_and_resolution
from procmodel.electrode.helix import interpolate_helix, interpolate_space_arc
from procmodel.electrode.positions import (
    direction,
    end_angle,
    fill_circle,
    fill_line,
    rounded,
)
from procmodel.electrode.steps import (
    arc_steps,
    axis_speeds,
    chord_error,
    line_steps,
    step_angle,
    step_for_tolerance,
)
from procmodel.errors import InputError
from procmodel.numerics import safe_sqrt
from procmodel.precision import require_float64

__all__ = [
    "arc_points",
    "arc_steps",
    "arc_through",
    "axis_speeds",
    "chord_error",
    "interpolate_arc",
    "interpolate_helix",
    "interpolate_line",
    "interpolate_space_arc",
    "line_points",
    "line_steps",
    "step_angle",
    "step_for_tolerance",
]

# How far off its circle the end of an arc may lie [um], when nothing else is said.
_ON_CIRCLE = 1e-6


def interpolate_line(
    start: ArrayLike | Sequence[float],
    end: ArrayLike | Sequence[float],
    step: float,
    resolution: float | None = None,
) -> np.ndarray:
    """Positions along a line, in a plane or in space.

    Parameters
    ----------
    start, end : array_like, shape (2,) or (3,) [um]
        The ends.
    step : float [um]
        Greatest step.
    resolution : float, optional [um]
        Step of the axes, to whose multiples every position is rounded.

    Returns
    -------
    numpy.ndarray, shape (N + 1, 2) or (N + 1, 3) [um]
        From the start to the end, both included; one point if they are the same.

    Raises
    ------
    InputError
        If an argument is not finite, the step is not above 0 or smaller than the resolution, or
        the ends differ in their number of axes.
    """
    dl, grid = step_and_resolution(step, resolution)
    first, last = position("the start", start, (2, 3)), position("the end", end, (2, 3))
    if len(first) != len(last):
        raise InputError(
            f"the start has {len(first)} coordinates and the end {len(last)}: give both as many."
        )
    along = last - first
    length = math.hypot(*along)
    count, _ = line_steps(length, dl)
    points = np.empty((count + 1, len(first)))
    fill_line(points, first, along / length * dl if length > 0.0 else along, grid)
    points[0], points[-1] = rounded(first, grid), rounded(last, grid)
    return points


def interpolate_arc(
    centre: ArrayLike | Sequence[float],
    radius: float,
    start_angle: float,
    sweep: float,
    step: float,
    resolution: float | None = None,
) -> np.ndarray:
    """Positions along an arc in the plane.

    Parameters
    ----------
    centre : array_like, shape (2,) [um]
        Centre of the circle.
    radius : float [um]
        Radius.
    start_angle : float [rad]
        Where the arc starts, from the first axis towards the second.
    sweep : float [rad]
        How far it goes: positive from the first axis towards the second, negative the other way;
        one turn or more is allowed.
    step : float [um]
        Greatest step, as a chord.
    resolution : float, optional [um]
        As for `interpolate_line`.

    Returns
    -------
    numpy.ndarray, shape (N + 1, 2) [um]
        From the start to the end; one point if the sweep is 0. A whole number of turns ends where
        it starts.

    Raises
    ------
    InputError
        If an argument is not finite, radius or step is not above 0, or the step is smaller than
        the resolution.
    """
    dl, grid = step_and_resolution(step, resolution)
    middle = position("the centre", centre, (2,))
    r, turn = positive("the radius", radius), number("the sweep", sweep, "rad")
    begin_angle = number("the start angle", start_angle, "rad")
    count, _ = arc_steps(r, turn, dl)
    theta = math.copysign(step_angle(r, dl), turn)
    points = np.empty((count + 1, 2))
    fill_circle(points, middle, r, begin_angle, theta, grid)
    points[-1] = rounded(middle + r * direction(end_angle(begin_angle, turn)), grid)
    return points


def arc_through(
    centre: ArrayLike | Sequence[float],
    start: ArrayLike | Sequence[float],
    end: ArrayLike | Sequence[float],
    clockwise: bool = False,
    tolerance: float = _ON_CIRCLE,
) -> tuple[float, float, float]:
    """Radius and angles of an arc given by its centre and its ends.

    Parameters
    ----------
    centre, start, end : array_like, shape (2,) [um]
        The three points; equal ends make a full circle.
    clockwise : bool
        Whether the arc turns from the second axis towards the first.
    tolerance : float [um]
        How far off the circle through the start the end may lie.

    Returns
    -------
    tuple of float [um, rad, rad]
        Radius, start angle and sweep, as `interpolate_arc` takes them.

    Raises
    ------
    InputError
        If the end is not on the circle (the text says by how much), or the start is the centre.
    """
    middle = position("the centre", centre, (2,))
    first, last = (
        position("the start", start, (2,)) - middle,
        position("the end", end, (2,)) - middle,
    )
    radius = positive("the radius, from centre to start,", math.hypot(*first))
    off = math.hypot(*last) - radius
    if abs(off) > tolerance:
        raise InputError(
            f"the end of the arc lies {abs(off):g} um {'outside' if off > 0 else 'inside'} the "
            f"circle of radius {radius:g} um through its start: correct the end or the centre."
        )
    begin = math.atan2(first[1], first[0])
    turn = (math.atan2(last[1], last[0]) - begin) % (2.0 * math.pi) or 2.0 * math.pi
    if clockwise and turn < 2.0 * math.pi:
        turn = 2.0 * math.pi - turn
    return radius, begin, -turn if clockwise else turn


def line_points(start: ArrayLike, end: ArrayLike, step: ArrayLike, count: int) -> Array:
    """Positions along a line for a given count, differentiable in ends and step.

    Parameters
    ----------
    start, end : array_like, shape (d,) [um]
        The ends.
    step : array_like [um]
        Step dL.
    count : int
        N, from `line_steps`.

    Returns
    -------
    Array, shape (N + 1, d) [um]
        ``start + i dL (end - start) / L`` for i < N, then the end.

    Raises
    ------
    RuntimeError
        If JAX still makes 32-bit floats.
    """
    require_float64("interpolated positions")
    first, last = jnp.asarray(start), jnp.asarray(end)
    if count == 0:
        return first[None]
    along = last - first
    length = safe_sqrt(jnp.sum(along**2))
    share = jnp.asarray(step) / jnp.where(length > 0.0, length, 1.0)
    inner = first + jnp.arange(count)[:, None] * share * along
    return jnp.concatenate([inner, last[None]])


def arc_points(
    centre: ArrayLike,
    radius: ArrayLike,
    start_angle: ArrayLike,
    sweep: ArrayLike,
    step: ArrayLike,
    count: int,
) -> Array:
    """Positions along an arc for a given count, differentiable in everything but the count.

    Parameters
    ----------
    centre : array_like, shape (2,) [um]
        Centre of the circle.
    radius : array_like [um]
        Radius, more than half a step.
    start_angle, sweep : array_like [rad]
        As for `interpolate_arc`.
    step : array_like [um]
        Step dL, as a chord.
    count : int
        N, from `arc_steps`.

    Returns
    -------
    Array, shape (N + 1, 2) [um]
        At ``start_angle + i theta`` for i < N, then at the end.

    Raises
    ------
    RuntimeError
        If JAX still makes 32-bit floats.
    """
    require_float64("interpolated positions")
    r, turn, begin = jnp.asarray(radius), jnp.asarray(sweep), jnp.asarray(start_angle)
    theta = jnp.where(turn < 0.0, -2.0, 2.0) * jnp.arcsin(jnp.asarray(step) / (2.0 * r))
    angles = begin + jnp.arange(max(count, 1)) * theta
    if count > 0:
        angles = jnp.append(angles, begin + turn)
    return jnp.asarray(centre) + r * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
