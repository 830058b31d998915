"""Arcs in any plane of space, and helices about their axes, cut into steps.

Lengths in um, angles in rad.
"""

import math
from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike

from procmodel.electrode.checks import (
    number,
    position,
    positive,
    step_and_resolution,
    step_count,
)
from procmodel.electrode.positions import direction, end_angle, fill_circle, rounded
from procmodel.electrode.steps import step_angle
from procmodel.errors import InputError

# First, second and third axis of a plane, in the sense in which a control turns in it.
_PLANES = {"xy": (0, 1, 2), "zx": (2, 0, 1), "yz": (1, 2, 0)}

# How far off its plane the start of an arc may lie [um].
_IN_PLANE = 1e-6


def interpolate_helix(
    centre: ArrayLike | Sequence[float],
    radius: float,
    start_angle: float,
    sweep: float,
    rise: float,
    step: float,
    resolution: float | None = None,
    plane: str = "xy",
) -> np.ndarray:
    """Positions along an arc in the plane of two axes while the third one moves evenly.

    Parameters
    ----------
    centre : array_like, shape (3,) [um]
        On the axis of the helix, in the plane of its start.
    radius : float [um]
        Radius.
    start_angle, sweep : float [rad]
        As for `interpolate_arc`, from the plane's first axis towards its second.
    rise : float [um]
        Way of the third axis from start to end; 0 for an arc in a plane.
    step : float [um]
        Greatest step, in space.
    resolution : float, optional [um]
        As for `interpolate_line`.
    plane : str
        "xy", "zx" or "yz": the first and the second axis.

    Returns
    -------
    numpy.ndarray, shape (N + 1, 3) [um]
        From the start to the end.

    Raises
    ------
    InputError
        As `interpolate_arc`, if the plane is unknown, or there is a rise without a sweep.
    """
    if plane not in _PLANES:
        raise InputError(f"the plane is {plane!r}, but must be xy, zx or yz.")
    axes = np.eye(3)[list(_PLANES[plane])]
    return _helix(centre, axes, radius, start_angle, sweep, rise, step, resolution)


def interpolate_space_arc(
    centre: ArrayLike | Sequence[float],
    start: ArrayLike | Sequence[float],
    normal: ArrayLike | Sequence[float],
    sweep: float,
    step: float,
    resolution: float | None = None,
    rise: float = 0.0,
) -> np.ndarray:
    """Positions along an arc or a helix in any plane.

    Parameters
    ----------
    centre : array_like, shape (3,) [um]
        Centre of the circle.
    start : array_like, shape (3,) [um]
        Where the arc starts, in the plane through the centre across `normal`.
    normal : array_like, shape (3,)
        Direction about which a positive sweep turns like a right-hand screw; of any length.
    sweep, step, resolution
        As for `interpolate_arc`.
    rise : float [um]
        Way along the normal from start to end.

    Returns
    -------
    numpy.ndarray, shape (N + 1, 3) [um]
        From the start to the end.

    Raises
    ------
    InputError
        As `interpolate_helix`, or if the normal is zero or the start is not in the plane; the
        text says how far off.
    """
    middle, first = position("the centre", centre, (3,)), position("the start", start, (3,))
    across = position("the normal", normal, (3,))
    if not np.any(across):
        raise InputError("the normal is zero: give the direction about which the arc turns.")
    across = across / np.linalg.norm(across)
    spoke = first - middle
    off = float(spoke @ across)
    if abs(off) > _IN_PLANE:
        raise InputError(
            f"the start lies {abs(off):g} um off the plane through the centre: correct the start, "
            "the centre or the normal."
        )
    spoke -= off * across
    radius = positive("the radius, from centre to start,", float(np.linalg.norm(spoke)))
    axes = np.stack([spoke / radius, np.cross(across, spoke / radius), across])
    return _helix(middle, axes, radius, 0.0, sweep, rise, step, resolution)


def _helix(
    centre: ArrayLike | Sequence[float],
    axes: np.ndarray,
    radius: float,
    start_angle: float,
    sweep: float,
    rise: float,
    step: float,
    resolution: float | None,
) -> np.ndarray:
    """A helix about the third of three perpendicular directions."""
    dl, grid = step_and_resolution(step, resolution)
    middle = position("the centre", centre, (3,))
    r, turn = positive("the radius", radius), number("the sweep", sweep, "rad")
    begin, climb = number("the start angle", start_angle, "rad"), number("the rise", rise)
    if turn == 0.0 and climb != 0.0:
        raise InputError("the helix rises without turning: it is a line, use interpolate_line.")
    theta = _helix_step_angle(r, climb / turn if turn else 0.0, dl)
    count = step_count(abs(turn) / theta)
    circle = np.empty((count + 1, 2))
    fill_circle(circle, np.zeros(2), r, begin, math.copysign(theta, turn), None)
    circle[-1] = r * direction(end_angle(begin, turn))
    share = np.arange(count + 1) * (theta / abs(turn) if turn else 0.0)
    share[-1] = float(count > 0)
    points = middle + circle @ axes[:2] + np.outer(share * climb, axes[2])
    return rounded(points, grid)


def _helix_step_angle(radius: float, pitch: float, step: float) -> float:
    """Angle whose chord in space is the step: (2 r sin(theta/2))^2 + (pitch theta)^2 = dL^2."""
    if pitch == 0.0:
        return step_angle(radius, step)

    def too_long(theta: float) -> bool:
        return math.hypot(2.0 * radius * math.sin(0.5 * theta), pitch * theta) > step

    # A chord is shorter than its arc, and grows with the angle up to half a turn.
    low, high = step / math.hypot(radius, pitch), math.pi
    if not too_long(high):
        return high
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return low
        low, high = (low, middle) if too_long(middle) else (middle, high)
