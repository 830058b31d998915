"""Geometry of the entities of a drawing, as chains of lines and arcs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from procmodel.errors import InputError

# Least number of lines between two knots of a spline, and on an ellipse: enough that a turning
# point between them does not go unnoticed.
_LEAST_LINES = 8


@dataclass(frozen=True)
class Outline3d:
    """Chain of lines and arcs in space, before it is known to lie in a plane.

    Attributes
    ----------
    points : numpy.ndarray, shape (n, 3) [drawing units]
        Vertices in world coordinates.
    bulges : numpy.ndarray, shape (n,) if closed, else (n - 1,) [-]
        As in `procmodel.io.polyline.BulgePolyline`, seen from +z.
    closed : bool
        Whether the last vertex is joined to the first.
    """

    points: np.ndarray
    bulges: np.ndarray
    closed: bool


def outlines(entity: Any, tolerance: float) -> Iterator[Outline3d]:
    """Chains of lines and arcs that an entity consists of.

    Parameters
    ----------
    entity : ezdxf entity
        One of `KINDS`.
    tolerance : float [drawing units]
        How far a spline or an ellipse may lie from the lines that stand for it, and how far apart
        two points may be that are one.

    Yields
    ------
    Outline3d
        One for each entity, none for a polyline without points.

    Raises
    ------
    InputError
        If the plane of the entity is inclined; the text leaves it to the caller to name it.
    """
    yield from KINDS[entity.dxftype()](entity, tolerance)


def _line(entity: Any, _: float) -> Iterator[Outline3d]:
    yield _open_lines([entity.dxf.start, entity.dxf.end])


def _circle(entity: Any, _: float) -> Iterator[Outline3d]:
    centre, radius = entity.dxf.center, abs(entity.dxf.radius)
    if radius == 0:
        raise InputError("its radius is zero: delete it")
    points = [(centre.x + radius, centre.y), (centre.x - radius, centre.y)]
    # Counter-clockwise seen from +z, whichever way its own axis points.
    yield _in_world(entity, points, np.full(2, _side(entity)), True, centre.z)


def _arc(entity: Any, tolerance: float) -> Iterator[Outline3d]:
    sweep = (entity.dxf.end_angle - entity.dxf.start_angle) % 360.0
    if sweep == 0:
        yield from _circle(entity, tolerance)
        return
    centre, radius = entity.dxf.center, abs(entity.dxf.radius)
    points = [
        (centre.x + radius * math.cos(angle), centre.y + radius * math.sin(angle))
        for angle in map(math.radians, (entity.dxf.start_angle, entity.dxf.end_angle))
    ]
    bulge = math.tan(math.radians(sweep) / 4)
    yield _in_world(entity, points, np.array([bulge]), False, centre.z)


def _light_polyline(entity: Any, tolerance: float) -> Iterator[Outline3d]:
    vertices = [(x, y, bulge) for x, y, bulge in entity.get_points("xyb")]
    yield from _polyline_in_plane(entity, vertices, entity.closed, entity.dxf.elevation, tolerance)


def _polyline(entity: Any, tolerance: float) -> Iterator[Outline3d]:
    # The frame of a fitted curve is stored beside the curve and is not drawn.
    drawn = [each for each in entity.vertices if not each.dxf.get("flags", 0) & 16]
    if entity.is_2d_polyline:
        vertices = [
            (each.dxf.location.x, each.dxf.location.y, each.dxf.get("bulge", 0.0)) for each in drawn
        ]
        elevation = entity.dxf.get("elevation")
        z = elevation.z if elevation is not None else 0.0
        yield from _polyline_in_plane(entity, vertices, entity.is_closed, z, tolerance)
    elif entity.is_3d_polyline and drawn:
        points = [each.dxf.location for each in drawn]
        yield _open_lines([*points, points[0]] if entity.is_closed else points)


def _flattened(entity: Any, tolerance: float) -> Iterator[Outline3d]:
    # Half, because the distance is measured in the middle of each line, not where it is largest.
    points = list(entity.flattening(tolerance / 2, _LEAST_LINES))
    distinct = [points[0]]
    distinct += [point for before, point in pairwise(points) if point != before]
    yield _open_lines(distinct)


KINDS = {
    "LINE": _line,
    "ARC": _arc,
    "CIRCLE": _circle,
    "LWPOLYLINE": _light_polyline,
    "POLYLINE": _polyline,
    "SPLINE": _flattened,
    "ELLIPSE": _flattened,
}


def _open_lines(points: list[Any]) -> Outline3d:
    return Outline3d(np.array([tuple(point) for point in points]), np.zeros(len(points) - 1), False)


def _polyline_in_plane(
    entity: Any,
    vertices: list[tuple[float, float, float]],
    closed: bool,
    z: float,
    tolerance: float,
) -> Iterator[Outline3d]:
    # Many programs repeat the first point at the end of a polyline that they also mark as closed.
    if closed and len(vertices) > 1 and vertices[-1][2] == 0:
        first, last = vertices[0], vertices[-1]
        if math.dist(first[:2], last[:2]) <= tolerance:
            del vertices[-1]
    if not vertices:
        return
    bulges = np.array([bulge for _, _, bulge in vertices])
    points = [(x, y) for x, y, _ in vertices]
    yield _in_world(entity, points, bulges if closed else bulges[:-1], closed, z)


def _in_world(
    entity: Any, points: list[tuple[float, float]], bulges: np.ndarray, closed: bool, z: float
) -> Outline3d:
    """World coordinates of what an entity gives in its own, whose axis may point along -z."""
    side = _side(entity)
    own = np.array([(x, y, z) for x, y in points])
    return Outline3d(own * (side, 1.0, side), bulges * side, closed)


def _side(entity: Any) -> float:
    """Whether the axis of the entity points along +z (1) or -z (-1).

    By the rule of DXF, an axis along -z turns x and z around and keeps y.
    """
    axis = entity.dxf.get("extrusion", (0.0, 0.0, 1.0))
    x, y, z = axis
    if not math.hypot(x, y) <= 1e-9 * abs(z):
        raise InputError(
            f"its plane is inclined (extrusion {x:g}, {y:g}, {z:g}): flatten the drawing to one "
            "plane of constant z"
        )
    return math.copysign(1.0, z)
