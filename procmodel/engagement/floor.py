"""The overshoot that no previous pass can avoid where a path bends into a corner.

Where the path's curvature grows, the surface of constant engagement has a kink towards the stock.
A disc does not reach into it, so stock stays that the next pass meets. Lengths in mm, angles in
rad.
"""

import numpy as np

from procmodel.engagement.backward import previous_pass, wanted_segments
from procmodel.engagement.contour import Contour, corner_turns, part, stations
from procmodel.engagement.segments import cross, dot, end_directions, lengths

# Around a junction, in tool radii: what is looked at, and what is evaluated of it.
_AROUND, _EVALUATED = 4.0, 1.5
_MOST = 48
_LEAST_KINK = 1e-6
_PLACES = 3000


def junction_kinks(path: Contour, angle: float, radius: float) -> np.ndarray:
    """Turn of the surface of constant engagement at every vertex of a path.

    Parameters
    ----------
    path : Contour
        Of the tool centre, wall to the right.
    angle : float [rad]
        Engagement angle that is to be held.
    radius : float [mm]
        Tool radius.

    Returns
    -------
    ndarray, shape (n,) or (n - 2,) [rad]
        As `corner_turns`: positive kinks keep stock. A path that turns on the spot is counted by
        its turn on top.
    """
    surface = wanted_segments(path.segments.on_host(), angle, radius, np)
    arriving, leaving = end_directions(surface, np), surface.direction
    arriving = np.roll(arriving, 1, axis=0) if path.closed else arriving[:-1]
    leaving = leaving if path.closed else leaving[1:]
    return np.arctan2(cross(arriving, leaving), dot(arriving, leaving))


def unavoidable_angle(
    path: Contour, angle: float, radius: float, previous_radius: float | None = None
) -> float:
    """Greatest engagement angle that remains whatever the previous pass does.

    Parameters
    ----------
    path : Contour
        Of the tool centre, wall to the right.
    angle : float [rad]
        Engagement angle that is to be held, and nowhere to be gone below.
    radius : float [mm]
        Tool radius.
    previous_radius : float, optional [mm]
        Radius of the previous pass' tool; the same when left out.

    Returns
    -------
    float [rad]
        The greatest of all junctions, each looked at by itself: the deepest surface there that a
        disc can leave without cutting deeper than wanted. `angle` where nothing is unavoidable.
    """
    kinks = junction_kinks(path, angle, radius)
    turns = corner_turns(path)
    worst = np.argsort(-(kinks + np.abs(turns)))[:_MOST]
    begins = np.cumsum(np.append(0.0, lengths(path.segments.on_host(), np)))
    places = begins[: len(kinks)] if path.closed else begins[1 : len(kinks) + 1]
    greatest = angle
    half = _AROUND * radius
    if path.closed:
        half = min(half, 0.45 * begins[-1])
    for vertex in worst:
        if kinks[vertex] <= _LEAST_KINK:
            continue
        around = part(path, places[vertex] - half, places[vertex] + half)
        way = min(half, places[vertex]) if not path.closed else half
        near = min(_EVALUATED * radius, 0.6 * half)
        try:
            before = previous_pass([around], angle, radius, previous_radius)
        except ValueError:
            # The neighbourhood alone gives the previous tool no room: it says nothing of a floor.
            continue
        at = stations(part(around, way - near, way + near), 2.0 * near / _PLACES)
        found = before.surface.engagement(at.point, at.direction, radius)
        greatest = max(greatest, float(np.max(found.angle)))
    return greatest
