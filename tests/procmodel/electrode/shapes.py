"""Profiles for the tests, and the wire's discs by brute force."""

import math

import numpy as np

from procmodel.electrode import Arc, Line, chain, cone_frustum, curved, from_bulges


def rounded_steps():
    """A cone, a convex arc, a cylinder, a hollow and a shank, all tangent."""
    flank = math.radians(70.0)
    start = np.array([20.0, 0.0])
    first = start + 50.0 * np.array([math.cos(flank), math.sin(flank)])
    turn = math.pi / 2 - flank
    centre = first - 30.0 * np.array([math.sin(flank), -math.cos(flank)])
    top = centre + np.array([30.0, 0.0])
    high = top + np.array([0.0, 60.0])
    hollow_centre = high + np.array([25.0, 0.0])
    end = hollow_centre + 25.0 * np.array([math.cos(math.pi - 1.0), math.sin(math.pi - 1.0)])
    shank = end + 40.0 * np.array([math.sin(1.0), math.cos(1.0)])
    return chain(
        [
            Line(start, first),
            Arc(centre, 30.0, -turn, turn),
            Line(top, high),
            Arc(hollow_centre, 25.0, math.pi, -1.0),
            Line(end, shank),
        ]
    )


def with_corners():
    """Two corners that bulge, one of them at the start of an arc."""
    return from_bulges([[20, 0], [30, 40], [30, 100], [20, 130]], [0, 0, 0.1])


PROFILES = {
    "cone": cone_frustum(30.0, 60.0, 150.0),
    "waist": cone_frustum(60.0, 30.0, 150.0),
    "hollow": curved(30.0, 60.0, 150.0, 200.0),
    "bulge": curved(30.0, 60.0, 150.0, 100.0, convex=True),
    "steps": rounded_steps(),
    "corners": with_corners(),
}


def centres_along(path, count):
    """Many centres of the wire, and none of the library's interpolation."""
    parts, share = [], np.linspace(0.0, 1.0, count)[:, None]
    for piece in path.pieces:
        if isinstance(piece, Line):
            parts.append(np.asarray(piece.start) * (1 - share) + np.asarray(piece.end) * share)
        else:
            angle = float(piece.start_angle) + share[:, 0] * float(piece.sweep)
            turned = np.column_stack([np.cos(angle), np.sin(angle)])
            parts.append(np.asarray(piece.centre) + float(piece.radius) * turned)
    return np.concatenate(parts)


def radius_by_discs(path, reach, heights, count=20_001):
    """Least x of the discs about many centres, one height after the other."""
    centres, left = centres_along(path, count), []
    for height in heights:
        off = centres[:, 1] - height
        near = np.abs(off) <= reach
        x = centres[near, 0] - np.sqrt(reach**2 - off[near] ** 2)
        left.append(max(float(x.min()), 0.0) if len(x) else np.inf)
    return np.array(left)
