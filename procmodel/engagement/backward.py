"""Algorithm II, backward: keep this pass and change the surface that the previous pass leaves.

Where the tool centre goes along o(s) with the wall to its right, the engagement angle is alpha
everywhere if the previous pass leaves the surface P(s) = o(s) + r (cos(alpha) n + sin(alpha) t),
n being the normal to the wall. Lines give lines and arcs give arcs. Where the path's curvature
grows, P has a kink that no disc can leave (`surface_kink`): what the previous tool can do of it is
its opening by that tool, and the engagement overshoots there by what the kink makes unavoidable.
Lengths in mm, angles in rad.

References
----------
.. [1] S. Ibaraki, I. Ikeda, A. Yamaji, Y. Kakino, S. Nishida, section 2.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
import shapely
from shapely import MultiLineString, MultiPoint

from procmodel.engagement.angle import require_target
from procmodel.engagement.contour import Contour, from_segments
from procmodel.engagement.offset import offset
from procmodel.engagement.segments import (
    Segments,
    cross,
    dot,
    end_directions,
    left,
    lengths,
    turned,
)
from procmodel.engagement.surface import Surface, cleared_by
from procmodel.errors import InputError

# Of the polylines [mm] on which crossings are looked for, and then touches.
_FLATTENED = (1e-4, 1e-2)
# A turn below this is the rounding of a smooth path.
_SMOOTH = 1e-9


def wanted_segments(path: Segments, angle: Any, radius: Any, xp: Any = jnp) -> Segments:
    """Surface of constant engagement beside every piece of a path.

    Parameters
    ----------
    path : Segments, n of them
        Of the tool centre, wall to the right.
    angle : array_like [rad]
        Engagement angle that is to be held.
    radius : array_like [mm]
        Tool radius r.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    Segments, n of them
        P(s) = o(s) + r (cos(alpha) n + sin(alpha) t) of each; P' = t (1 + r k cos(alpha)) -
        n r k sin(alpha), with k the curvature of the path.
    """
    arm = xp.asarray(angle) - 0.5 * np.pi
    start = path.start + radius * turned(path.direction, arm, xp)
    end = path.end + radius * turned(end_directions(path, xp), arm, xp)
    ahead = 1.0 + radius * path.curvature * xp.cos(angle)
    aside = radius * path.curvature * xp.sin(angle)
    speed = xp.hypot(ahead, aside)
    direction = turned(path.direction, xp.arctan2(aside, ahead), xp)
    return Segments(start, end, direction, path.curvature / speed)


def wanted_surface(path: Contour, angle: float, radius: float) -> Contour:
    """Surface of constant engagement beside a whole path.

    Parameters
    ----------
    path : Contour
        Of the tool centre, wall to the right.
    angle : float [rad]
        Engagement angle that is to be held.
    radius : float [mm]
        Tool radius r.

    Returns
    -------
    Contour
        The surface; where the path turns on the spot, an arc of the tool's radius around it.

    Raises
    ------
    InputError
        If the angle is not between 0 and pi.
    """
    require_target(angle)
    pieces = path.segments.on_host()
    surface = wanted_segments(pieces, angle, radius, np)
    heading = end_directions(pieces, np)
    following = np.roll(pieces.direction, -1, axis=0)
    turn = np.arctan2(cross(heading, following), dot(heading, following))
    if not path.closed:
        turn[-1] = 0.0
    parts = []
    for i in range(len(pieces)):
        parts.append(surface[i : i + 1])
        if abs(turn[i]) > _SMOOTH:
            parts.append(_turning(pieces.end[i], heading[i], turn[i], angle, radius))
    return from_segments(_chained(parts, path.closed), path.closed, path.name)


@dataclass(frozen=True)
class BackwardPass:
    """A pass inside the one that it prepares.

    Attributes
    ----------
    wanted : list of Contour
        Surface that would hold the engagement everywhere.
    path : list of Contour
        Of the previous tool's centre, wall to the right.
    surface : Surface
        What that pass leaves: nowhere deeper than wanted.
    radius : float [mm]
        Radius of its tool.
    """

    wanted: list[Contour]
    path: list[Contour]
    surface: Surface
    radius: float


def previous_pass(
    paths: Sequence[Contour], angle: float, radius: float, previous_radius: float | None = None
) -> BackwardPass:
    """The pass before a given one that makes its engagement constant, as far as can be.

    Parameters
    ----------
    paths : sequence of Contour
        Of the tool centre in the pass that is kept, wall to the right.
    angle : float [rad]
        Engagement angle that it is to have.
    radius : float [mm]
        Radius of its tool.
    previous_radius : float, optional [mm]
        Radius of the previous pass' tool; the same when left out.

    Returns
    -------
    BackwardPass
        Path and surface. Of all surfaces that cut nowhere deeper than wanted it is the deepest, so
        no other one has less overshoot anywhere. Where the wanted surfaces cross themselves or one
        another nothing fits all of the path: some places beside the crossing are then engaged less
        than wanted, never a wall cut into.

    Raises
    ------
    InputError
        If the previous tool finds no room, or the angle is not between 0 and pi.
    """
    r2 = radius if previous_radius is None else previous_radius
    wanted = [wanted_surface(path, angle, radius) for path in paths]
    try:
        before = offset(wanted, r2)
        cleared = cleared_by(before, r2)
    except InputError as error:
        raise _explained(error, wanted, angle) from None
    if not before:
        raise InputError(
            f"a previous tool of radius {r2:g} mm finds no room inside the pass: take fewer "
            "passes, a smaller radial depth or a smaller previous tool."
        )
    return BackwardPass(wanted, before, Surface(cleared), r2)


def _explained(error: InputError, wanted: Sequence[Contour], angle: float) -> InputError:
    """Why a parallel curve of the wanted surfaces was not found: most often they cross themselves.

    What lies beyond a crossing would have to be cut deeper than the engagement allows.
    """
    for tolerance in _FLATTENED:
        lines = []
        for surface in wanted:
            points = surface.flattened(tolerance)
            lines.append(np.append(points, points[:1], axis=0) if surface.closed else points)
        drawn = MultiLineString(lines)
        if not drawn.is_simple:
            break
    else:
        return error
    pieces = [np.asarray(piece.coords) for piece in shapely.node(drawn).geoms]
    ends = np.concatenate([piece[[0, -1]] for piece in pieces])
    begins = MultiPoint(np.concatenate([line[[0, -1]] for line in lines]))
    away = shapely.distance(shapely.points(ends), begins)
    x, y = ends[np.argmax(away)]
    return InputError(
        f"the surface that would hold {np.degrees(angle):.4g} degrees all along crosses or touches "
        f"itself near ({x:.6g}, {y:.6g}) and leaves no room there for the pass before it: "
        "take a smaller radial depth or target angle, fewer passes, or a smaller tool."
    )


def _turning(
    centre: np.ndarray, heading: np.ndarray, turn: float, angle: float, radius: float
) -> Segments:
    """Where the engaged arc ends while the tool turns on the spot: arcs around its centre."""
    halves = 1 if abs(turn) <= 0.5 * np.pi else 2
    angles = angle - 0.5 * np.pi + turn * np.arange(halves + 1) / halves
    arm = turned(np.tile(heading, (halves + 1, 1)), angles, np)
    return Segments(
        centre + radius * arm[:-1],
        centre + radius * arm[1:],
        np.sign(turn) * left(arm[:-1], np),
        np.full(halves, np.sign(turn) / radius),
    )


def _chained(parts: list[Segments], closed: bool) -> Segments:
    start, end, direction, curvature = (
        np.concatenate(fields) for fields in zip(*(p.fields for p in parts), strict=True)
    )
    chained = np.roll(start, -1, axis=0)
    if not closed:
        chained[-1] = end[-1]
    whole = Segments(start, chained, direction, curvature)
    return whole[lengths(whole, np) > 0.0]
