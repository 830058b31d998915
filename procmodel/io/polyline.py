"""Contours of lines and arcs as files hold them, in mm.

A contour is a chain of vertices; the piece from one to the next is a line or an arc, told by its
bulge, the tangent of a quarter of the angle that the arc turns by, positive counter-clockwise (the
convention of DXF). A bulge of 0 is a line, 1 a half circle to the right of its chord.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from procmodel.errors import InputError

JOIN_TOLERANCE = 1e-3
"""How far apart, in mm, two ends may be that still are one point."""

# Shorter than this share of a contour's size is no length at all.
NEGLIGIBLE = 1e-9


@dataclass(frozen=True, eq=False)
class BulgePolyline:
    """A chain of lines and arcs.

    Attributes
    ----------
    points : numpy.ndarray, shape (n, 2) [mm]
        Vertices.
    bulges : numpy.ndarray, shape (n,) if closed, else (n - 1,) [-]
        Bulge of the piece that begins at each vertex: 0 a line, else the tangent of a quarter of
        the arc's sweep, positive counter-clockwise. Any finite number; readers give at most 1.
    closed : bool
        Whether the last vertex is joined to the first.
    name : str
        Where it comes from, as errors begin: `wall.dxf, layer WALL, contour 2`.

    Raises
    ------
    ValueError
        If the arrays have other shapes. What a user may have drawn wrongly is left to `checked`.
    """

    points: np.ndarray
    bulges: np.ndarray
    closed: bool
    name: str

    def __post_init__(self) -> None:
        points = np.array(self.points, dtype=np.float64)
        bulges = np.array(self.bulges, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
            raise ValueError(f"{self.name}: points have shape {points.shape}, not (n, 2)")
        pieces = len(points) if self.closed else len(points) - 1
        if bulges.shape != (pieces,):
            raise ValueError(f"{self.name}: bulges have shape {bulges.shape}, not ({pieces},)")
        points.flags.writeable = bulges.flags.writeable = False
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "bulges", bulges)

    @property
    def starts(self) -> np.ndarray:
        """First points of the pieces, shape (len(bulges), 2) [mm]."""
        return self.points[: len(self.bulges)]

    @property
    def ends(self) -> np.ndarray:
        """Last points of the pieces, shape (len(bulges), 2) [mm]."""
        return np.roll(self.points, -1, axis=0)[: len(self.bulges)]

    @property
    def chords(self) -> np.ndarray:
        """Distances from start to end of each piece, shape (len(bulges),) [mm]."""
        return np.hypot(*(self.ends - self.starts).T)

    @property
    def length(self) -> float:
        """Length along lines and arcs [mm]."""
        bulges = np.abs(self.bulges)
        curved = bulges > 0
        # Sweep over twice the sine of its half: 1 for a line, pi/2 for a half circle.
        stretch = np.ones(len(bulges))
        stretch[curved] = (1 + bulges[curved] ** 2) * np.arctan(bulges[curved]) / bulges[curved]
        return float(np.sum(self.chords * stretch))

    def reversed(self) -> BulgePolyline:
        """The same contour, run through the other way."""
        bulges = -self.bulges[::-1]
        return replace(
            self, points=self.points[::-1], bulges=np.roll(bulges, -1) if self.closed else bulges
        )

    def with_arcs_halved(self) -> BulgePolyline:
        """The same contour, each arc of more than half a circle (bulge above 1) cut in two."""
        wide = np.flatnonzero(np.abs(self.bulges) > 1)
        if not len(wide):
            return self
        halves = half_bulge(self.bulges[wide])
        middles = arc_middle(self.starts[wide], self.ends[wide], self.bulges[wide])
        bulges = self.bulges.copy()
        bulges[wide] = halves
        return replace(
            self,
            points=np.insert(self.points, wide + 1, middles, axis=0),
            bulges=np.insert(bulges, wide + 1, halves),
        )


def half_bulge(bulge: ArrayLike) -> np.ndarray:
    """Bulge of each half of an arc with the given bulge [-]."""
    bulge = np.asarray(bulge, dtype=np.float64)
    return bulge / (1 + np.hypot(1, bulge))


def arc_middle(start: ArrayLike, end: ArrayLike, bulge: ArrayLike) -> np.ndarray:
    """Point halfway along an arc.

    Parameters
    ----------
    start, end : array_like, shape (..., 2) [mm]
        Its ends.
    bulge : array_like, shape (...) [-]
        Its bulge.

    Returns
    -------
    numpy.ndarray, shape (..., 2) [mm]
        The point.
    """
    start, end = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    chord = end - start
    to_the_right = np.stack([chord[..., 1], -chord[..., 0]], axis=-1)
    return (start + end) / 2 + np.asarray(bulge)[..., None] / 2 * to_the_right


def arc_bulge(
    start: Sequence[float], end: Sequence[float], centre: Sequence[float], clockwise: bool
) -> float:
    """Bulge of an arc about a centre.

    Parameters
    ----------
    start, end, centre : sequence of float, shape (2,) [mm]
        Points; start and end must not coincide (see `full_circle`).
    clockwise : bool
        Which way the arc runs from start to end.

    Returns
    -------
    float
        The bulge, negative where clockwise.
    """
    from_x, from_y = start[0] - centre[0], start[1] - centre[1]
    to_x, to_y = end[0] - centre[0], end[1] - centre[1]
    turn = math.atan2(from_x * to_y - from_y * to_x, from_x * to_x + from_y * to_y)
    sweep = (-turn if clockwise else turn) % (2 * math.pi)
    return math.tan(sweep / 4) * (-1 if clockwise else 1)


def full_circle(
    centre: Sequence[float], start: Sequence[float], clockwise: bool, name: str
) -> BulgePolyline:
    """A full circle as two half circles.

    Parameters
    ----------
    centre, start : sequence of float, shape (2,) [mm]
        Its centre, and the point on it where it begins.
    clockwise : bool
        Which way it runs.
    name : str
        Where it comes from.

    Returns
    -------
    BulgePolyline
        Closed, with two vertices.
    """
    first = np.asarray(start, dtype=np.float64)
    opposite = 2 * np.asarray(centre, dtype=np.float64) - first
    bulge = -1.0 if clockwise else 1.0
    return BulgePolyline(np.stack([first, opposite]), np.full(2, bulge), True, name)


def checked(polyline: BulgePolyline, places: Sequence[str] | None = None) -> BulgePolyline:
    """The contour itself, after checking what a user may have drawn wrongly.

    Parameters
    ----------
    polyline : BulgePolyline
        The contour.
    places : sequence of str, optional
        What to call each vertex, `row 7`; without it they are counted, `vertex 1`.

    Returns
    -------
    BulgePolyline
        The same object.

    Raises
    ------
    InputError
        If it has too few points, a number is not finite, or a piece has no length (less than
        1e-9 of the contour's size). The text names the contour, the points and the remedy.
    """
    name, count = polyline.name, len(polyline.points)

    def place(vertex: int) -> str:
        return places[vertex] if places is not None else f"vertex {vertex + 1}"

    finite = np.isfinite(polyline.points).all(axis=1)
    finite[: len(polyline.bulges)] &= np.isfinite(polyline.bulges)
    if not finite.all():
        raise InputError(
            f"{name}, {place(int(np.argmin(finite)))}: a coordinate or bulge is not a finite "
            "number: correct it or delete the point"
        )
    if count < 2:
        raise InputError(f"{name}: a contour of one point has no length: add a point or delete it")
    chords = polyline.chords
    empty = np.flatnonzero(chords <= NEGLIGIBLE * np.ptp(polyline.points, axis=0).max())
    if len(empty):
        vertex = int(empty[0])
        raise InputError(
            f"{name}, {place(vertex)} and {place((vertex + 1) % count)}: the points coincide at "
            f"{point_text(polyline.points[vertex])}: delete one of the two points"
        )
    if polyline.closed and count == 2 and not polyline.bulges.any():
        raise InputError(
            f"{name}: a closed contour of two points and no arc encloses nothing: "
            "delete a line drawn twice, or add a point"
        )
    return polyline


def point_text(point: Sequence[float] | np.ndarray) -> str:
    """A point as errors name it: `(12.5, -3) mm`."""
    return f"({point[0]:.6g}, {point[1]:.6g}) mm"


def join_edges(
    edges: Sequence[BulgePolyline], tolerance: float = JOIN_TOLERANCE
) -> list[BulgePolyline]:
    """Join edges end to end, whatever their order and direction.

    Parameters
    ----------
    edges : sequence of BulgePolyline
        Open ones are joined; closed ones come back as they are.
    tolerance : float [mm]
        Ends up to this far apart are one point, halfway between the two; 1e-3 by default.

    Returns
    -------
    list of BulgePolyline
        Chains in the order of the first edge of each, which keeps its direction and gives its
        name; closed where the last end meets the first, else open. Arcs of more than half a
        circle are cut in two, so that moving their ends does not change their radius.

    Raises
    ------
    InputError
        If three or more ends meet in one point, or an edge is no longer than the tolerance.
    """
    edges = [edge.with_arcs_halved() for edge in edges]
    numbers = [number for number, edge in enumerate(edges) if not edge.closed]
    opened = [edges[number] for number in numbers]
    for edge in opened:
        if not edge.length > tolerance:
            raise InputError(
                f"{edge.name}: the edge at {point_text(edge.points[0])} is {edge.length:.3g} mm "
                f"long, not more than the {tolerance:g} mm within which ends are joined: "
                "delete it, or lower the tolerance"
            )
    found = {number: edge for number, edge in enumerate(edges) if edge.closed}
    if opened:
        partners = _partners(opened, tolerance)
        found |= {numbers[first]: chain for first, chain in _chains(opened, partners)}
    return [found[number] for number in sorted(found)]


def _partners(edges: Sequence[BulgePolyline], tolerance: float) -> list[int]:
    """For each end the one it meets, or -1; the ends of edge k are 2k (first) and 2k + 1 (last)."""
    # Here, because it takes longer to load than most commands to run.
    from scipy.spatial import cKDTree

    ends = np.stack([edge.points[[0, -1]] for edge in edges]).reshape(-1, 2)
    # A crowd of ends in one point would make the search below slow.
    crowd, count = np.unique(ends, axis=0, return_counts=True)
    if count.max() > 2:
        raise _ambiguous(edges, ends, crowd[int(np.argmax(count > 2))], tolerance)
    # The bound is exclusive; the first neighbour of an end is the end itself or its twin.
    bound = np.nextafter(tolerance, np.inf)
    _, neighbours = cKDTree(ends).query(ends, k=3, distance_upper_bound=bound)
    third = neighbours[:, 2] < len(ends)
    if third.any():
        raise _ambiguous(edges, ends, ends[int(np.argmax(third))], tolerance)
    own = np.arange(len(ends))
    other = np.where(neighbours[:, 0] == own, neighbours[:, 1], neighbours[:, 0])
    partners: list[int] = np.where(other < len(ends), other, -1).tolist()
    return partners


def _ambiguous(
    edges: Sequence[BulgePolyline], ends: np.ndarray, point: np.ndarray, tolerance: float
) -> InputError:
    meeting = np.flatnonzero(np.hypot(*(ends - point).T) <= tolerance)
    names = list(dict.fromkeys(edges[end // 2].name for end in meeting.tolist()))
    listed = ", ".join(names[:4]) + (" and others" if len(names) > 4 else "")
    return InputError(
        f"{names[0]}: {len(meeting)} ends meet at {point_text(point)} ({listed}): "
        "delete a line drawn twice or the branch, so that two ends remain"
    )


def _chains(
    edges: Sequence[BulgePolyline], partners: Sequence[int]
) -> list[tuple[int, BulgePolyline]]:
    """Chains of edges, each with the number of its first edge."""
    chains = []
    used = [False] * len(edges)
    for first in range(len(edges)):
        if used[first]:
            continue
        # Ends at which the chain enters its edges.
        entries = deque([2 * first])
        following = partners[2 * first + 1]
        while following not in (-1, 2 * first):
            entries.append(following)
            following = partners[following ^ 1]
        closed = following != -1
        preceding = -1 if closed else partners[2 * first]
        while preceding != -1:
            entries.appendleft(preceding ^ 1)
            preceding = partners[preceding ^ 1]
        for entry in entries:
            used[entry // 2] = True
        parts = [edges[entry // 2] for entry in entries]
        oriented = [
            part.reversed() if entry % 2 else part
            for entry, part in zip(entries, parts, strict=True)
        ]
        chains.append((first, _chain(oriented, closed, edges[first].name)))
    return chains


def _chain(parts: Sequence[BulgePolyline], closed: bool, name: str) -> BulgePolyline:
    """One chain of parts that follow each other, their ends moved to the point between them."""
    begins = np.array([part.points[0] for part in parts])
    finishes = np.array([part.points[-1] for part in parts])
    joints = (begins + np.roll(finishes, 1, axis=0)) / 2
    if not closed:
        joints[0] = begins[0]
    vertices = [
        vertex
        for joint, part in zip(joints, parts, strict=True)
        for vertex in (joint[None], part.points[1:-1])
    ]
    if not closed:
        vertices.append(finishes[-1:])
    bulges = np.concatenate([part.bulges for part in parts])
    return BulgePolyline(np.concatenate(vertices), bulges, closed, name)
