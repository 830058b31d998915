"""Contours of lines and arcs, kept exact.

A contour is a chain of vertices; the piece from one to the next is a line or an arc, told by its
bulge, the tangent of a quarter of the angle it turns by, positive to the left (as in DXF).

Everywhere in this package the free side, where the tool is, lies to the left of a contour and the
material to its right: a pocket runs counter-clockwise, a boss or an island clockwise. Lengths in
mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike
from shapely import LineString, Point, Polygon

from procmodel.engagement.segments import (
    Segments,
    advance,
    dot,
    end_directions,
    half_sweeps,
    lengths,
    turned,
)
from procmodel.errors import InputError

# Shorter than this share of a contour's size is no length at all.
_NEGLIGIBLE = 1e-12


class Contour(eqx.Module):
    """A chain of lines and arcs; a pytree in its points and bulges.

    Attributes
    ----------
    points : array, shape (n, 2) [mm]
        Vertices.
    bulges : array, shape (n,) if closed, else (n - 1,)
        Tangent of a quarter of the sweep of the piece that begins at each vertex, -1 to 1.
    closed : bool
        Whether the last vertex is joined to the first.
    name : str
        What to call it in errors.
    """

    points: Any
    bulges: Any
    closed: bool = eqx.field(static=True)
    name: str = eqx.field(static=True, default="contour")

    @property
    def segments(self) -> Segments:
        """Its pieces, differentiable in points and bulges."""
        start = jnp.asarray(self.points)
        end = jnp.roll(start, -1, axis=0)
        if not self.closed:
            start, end = start[:-1], end[:-1]
        chord = end - start
        span = jnp.sqrt(dot(chord, chord))
        half = 2.0 * jnp.arctan(jnp.asarray(self.bulges))
        direction = turned(chord / span[:, None], -half)
        return Segments(start, end, direction, 2.0 * jnp.sin(half) / span)

    @property
    def length(self) -> float:
        """Its length [mm]."""
        return float(np.sum(lengths(self.segments.on_host(), np)))

    @property
    def area(self) -> float:
        """Area that it encloses [mm^2], negative when it runs clockwise; an open one is closed."""
        x, y = np.asarray(self.points, float).T
        polygon = 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
        pieces = self.segments.on_host()
        half = half_sweeps(pieces, np)
        chord = np.hypot(*(pieces.end - pieces.start).T)
        # Between an arc and its chord: R^2 (sweep - sin(sweep)) / 2.
        radius = np.divide(0.5 * chord, np.sin(half), out=np.zeros_like(half), where=half != 0)
        return polygon + float(np.sum(0.5 * radius**2 * (2.0 * half - np.sin(2.0 * half))))

    def reversed(self) -> "Contour":
        """The same way, walked from the other end."""
        points, bulges = np.asarray(self.points), np.asarray(self.bulges)
        points = np.roll(points[::-1], 1, axis=0) if self.closed else points[::-1]
        return Contour(points, -bulges[::-1], self.closed, self.name)

    def flattened(self, tolerance: float = 1e-3) -> np.ndarray:
        """Points on it between which straight lines stay within a tolerance.

        Parameters
        ----------
        tolerance : float [mm]
            Greatest distance of a chord from its arc.

        Returns
        -------
        ndarray, shape (m, 2) [mm]
            From the first vertex to the last; of a closed contour, without the first again.
        """
        pieces = self.segments.on_host()
        sweep = 2.0 * np.abs(half_sweeps(pieces, np))
        radius = 1.0 / np.maximum(np.abs(pieces.curvature), 1e-300)
        step = 2.0 * np.arccos(np.clip(1.0 - tolerance / radius, -1.0, 1.0))
        counts = np.maximum(np.ceil(sweep / np.maximum(step, 1e-9)), 1).astype(int)
        owner = np.repeat(np.arange(len(pieces)), counts)
        within = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        way = lengths(pieces, np)[owner] * within / counts[owner]
        chosen = pieces[owner]
        points, _ = advance(chosen.start, chosen.direction, chosen.curvature, way, np)
        return points if self.closed else np.concatenate([points, pieces.end[-1:]])


def contour(
    points: ArrayLike, bulges: ArrayLike | None = None, closed: bool = True, name: str = "contour"
) -> Contour:
    """Make a contour, everything checked.

    Parameters
    ----------
    points : array_like, shape (n, 2) [mm]
        Vertices; a closed contour does not repeat the first.
    bulges : array_like, shape (n,) or (n - 1,), optional
        Of the piece that begins at each vertex; lines when left out.
    closed : bool
        Whether the last vertex is joined to the first.
    name : str
        What to call it in errors.

    Returns
    -------
    Contour
        With arcs beyond a half circle split in two.

    Raises
    ------
    InputError
        If shapes do not match, something is not finite, or an edge has no length.
    """
    vertices = np.array(points, float)
    if vertices.ndim != 2 or vertices.shape[1] != 2 or len(vertices) < 2:
        raise InputError(f"{name}: give two or more points as rows of x and y.")
    count = len(vertices) if closed else len(vertices) - 1
    bends = np.zeros(count) if bulges is None else np.array(bulges, float)
    if bends.shape != (count,):
        kind = "closed" if closed else "open"
        raise InputError(
            f"{name}: {len(bends)} bulges for {count} pieces of {len(vertices)} vertices "
            f"({kind}): give one for each piece."
        )
    if not (np.all(np.isfinite(vertices)) and np.all(np.isfinite(bends))):
        raise InputError(f"{name}: a coordinate or bulge is not finite: correct it.")
    if closed and len(vertices) == 2 and not np.any(bends):
        raise InputError(f"{name}: two straight pieces enclose nothing: give a third point.")
    steps = np.roll(vertices, -1, axis=0)[:count] - vertices[:count]
    short = np.hypot(*steps.T) <= _NEGLIGIBLE * max(float(np.ptp(vertices, axis=0).max()), 1e-300)
    if np.any(short):
        i = int(np.argmax(short))
        x, y = vertices[i]
        raise InputError(
            f"{name}: the edge from vertex {i + 1} at ({x:g}, {y:g}) has no length: delete one of "
            "the two points."
        )
    return _without_large_arcs(Contour(vertices, bends, bool(closed), name))


def from_segments(pieces: Segments, closed: bool, name: str) -> Contour:
    """Contour of segments that follow each other, their starts being its vertices."""
    host = pieces.on_host()
    points = host.start if closed else np.concatenate([host.start, host.end[-1:]])
    following = np.roll(points, -1, axis=0)[: len(host)]
    fitted = Segments(host.start, following, host.direction, host.curvature)
    return Contour(points, np.tan(0.5 * half_sweeps(fitted, np)), closed, name)


def oriented(contours: Sequence[Contour], side: str) -> list[Contour]:
    """Turn walls so that the tool's side is to the left of each.

    Parameters
    ----------
    contours : sequence of Contour
        Walls as drawn, in any direction.
    side : {"inside", "outside", "left", "right"}
        "inside": closed walls are a pocket, and closed walls in it are islands. "outside": they
        are bosses. "left", "right": where the tool runs beside open walls, in the direction drawn.

    Returns
    -------
    list of Contour
        The walls, turned.

    Raises
    ------
    InputError
        If a wall is open and the side needs it closed, or the other way round.
    """
    if side not in ("inside", "outside", "left", "right"):
        raise InputError(f"side is {side!r}: choose inside, outside, left or right.")
    for wall in contours:
        if side in ("inside", "outside") and not wall.closed:
            (x0, y0), (x1, y1) = np.asarray(wall.points)[[0, -1]]
            raise InputError(
                f"{wall.name} is open, its ends ({x0:g}, {y0:g}) and ({x1:g}, {y1:g}) are "
                f"{np.hypot(x1 - x0, y1 - y0):g} mm apart, but side {side} needs a closed wall: "
                "close it, or say on which side the tool runs, left or right."
            )
        if side in ("left", "right") and wall.closed:
            raise InputError(f"{wall.name} is closed: choose side inside or outside.")
    if side in ("left", "right"):
        return [wall if side == "left" else wall.reversed() for wall in contours]
    depths = _nesting([Polygon(wall.flattened()) for wall in contours])
    turned_walls = []
    for wall, depth in zip(contours, depths, strict=True):
        counter_clockwise = (depth % 2 == 0) == (side == "inside")
        turned_walls.append(wall if (wall.area > 0) == counter_clockwise else wall.reversed())
    return turned_walls


@dataclass(frozen=True)
class Stations:
    """Places along a contour, every vertex among them, seen from both of its pieces.

    Attributes
    ----------
    point : ndarray, shape (m, 2) [mm]
        Where.
    direction : ndarray, shape (m, 2)
        Unit tangent there.
    curvature : ndarray, shape (m,) [1/mm]
        Of the piece.
    way : ndarray, shape (m,) [mm]
        Arc length from the first vertex.
    segment : ndarray, shape (m,), int
        Number of the piece.
    """

    point: np.ndarray
    direction: np.ndarray
    curvature: np.ndarray
    way: np.ndarray
    segment: np.ndarray

    def __len__(self) -> int:
        return len(self.way)


def stations(path: Contour, spacing: float) -> Stations:
    """Places along a contour.

    Parameters
    ----------
    path : Contour
        The contour.
    spacing : float [mm]
        Greatest distance from one place to the next.

    Returns
    -------
    Stations
        The places, both ends of every piece among them.
    """
    pieces = path.segments.on_host()
    length = lengths(pieces, np)
    counts = np.ceil(length / spacing).astype(int) + 1
    owner = np.repeat(np.arange(len(pieces)), counts)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    way = length[owner] * within / (counts[owner] - 1)
    begin = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    chosen = pieces[owner]
    point, direction = advance(chosen.start, chosen.direction, chosen.curvature, way, np)
    return Stations(point, direction, chosen.curvature, begin[owner] + way, owner)


def corner_turns(path: Contour) -> np.ndarray:
    """Angle by which a contour turns at each of its vertices, to the left positive.

    Parameters
    ----------
    path : Contour
        The contour.

    Returns
    -------
    ndarray, shape (n,) or (n - 2,) [rad]
        At every vertex of a closed contour, and at the inner ones of an open one.
    """
    pieces = path.segments.on_host()
    arriving, leaving = end_directions(pieces, np), pieces.direction
    arriving = np.roll(arriving, 1, axis=0) if path.closed else arriving[:-1]
    leaving = leaving if path.closed else leaving[1:]
    sine = arriving[:, 0] * leaving[:, 1] - arriving[:, 1] * leaving[:, 0]
    return np.arctan2(sine, dot(arriving, leaving))


def _without_large_arcs(path: Contour) -> Contour:
    large = np.flatnonzero(np.abs(path.bulges) > 1.0)
    if not len(large):
        return path
    points, bulges = list(path.points), list(path.bulges)
    for i in large[::-1]:
        start, end = points[i], points[(i + 1) % len(points)]
        # Half of an arc: the tangent of an eighth of its sweep, and the point on its middle.
        bend = bulges[i]
        half = bend / (1.0 + np.sqrt(1.0 + bend**2))
        chord = end - start
        middle = 0.5 * (start + end) + 0.5 * bend * np.array([chord[1], -chord[0]])
        points.insert(i + 1, middle)
        bulges[i : i + 1] = [half, half]
    split = Contour(np.array(points), np.array(bulges), path.closed, path.name)
    return _without_large_arcs(split)


def _nesting(polygons: list[Polygon]) -> list[int]:
    """How many of the others each polygon lies in."""
    inner = [polygon.representative_point() for polygon in polygons]
    outlines = [LineString([*p.exterior.coords]) for p in polygons]
    for i in range(len(polygons)):
        for j in range(i):
            if outlines[i].crosses(outlines[j]):
                x, y = Point(outlines[i].intersection(outlines[j]).representative_point()).coords[0]
                raise InputError(
                    f"two walls cross each other near ({x:g}, {y:g}): keep islands clear of the "
                    "wall around them."
                )
    return [
        sum(
            p.contains(point) and p.area > polygons[i].area
            for j, p in enumerate(polygons)
            if j != i
        )
        for i, point in enumerate(inner)
    ]


def part(path: Contour, begin: float, end: float) -> Contour:
    """Open part of a contour between two places.

    Parameters
    ----------
    path : Contour
        The contour.
    begin, end : float [mm]
        Arc lengths from the first vertex, begin < end; on a closed contour they may lie beyond its
        ends, on an open one they are kept within.

    Returns
    -------
    Contour
        The part, open.
    """
    pieces = path.segments.on_host()
    length = lengths(pieces, np)
    total = float(np.sum(length))
    if path.closed:
        end = min(end, begin + total)
        first = int(np.floor(begin / total))
        laps = int(np.ceil(end / total)) - first
        begins = first * total + np.cumsum(np.tile(length, laps)) - np.tile(length, laps)
        pieces, length = pieces[np.tile(np.arange(len(length)), laps)], np.tile(length, laps)
    else:
        begin, end = max(begin, 0.0), min(end, total)
        begins = np.cumsum(length) - length
    low, high = np.maximum(begins, begin) - begins, np.minimum(begins + length, end) - begins
    kept = high - low > _NEGLIGIBLE * total
    chosen, low, high = pieces[kept], low[kept], high[kept]
    start, direction = advance(chosen.start, chosen.direction, chosen.curvature, low, np)
    stop, _ = advance(chosen.start, chosen.direction, chosen.curvature, high, np)
    cut = Segments(start, stop, direction, chosen.curvature)
    return from_segments(cut, closed=False, name=path.name)
