"""A mesh cut by horizontal planes: the rings of every section, and the areas they enclose.

A plane may run through corners and along whole triangles. It is then taken to lie infinitely little
above or below (`side`), so that every edge either crosses it or does not, and the rings always
close. Lengths in um, z downwards.
"""

from functools import reduce
from typing import Literal

import numpy as np
import shapely

from procmodel.errors import InputError

Side = Literal["above", "below"]

# Of an area, plus um per um of outline: what rounding may make of it.
_RELATIVE, _PER_LENGTH = 1e-7, 1e-6


def cut_mesh(
    vertices: np.ndarray, faces: np.ndarray, heights: np.ndarray, side: Side = "above"
) -> list[shapely.Geometry]:
    """Sections of a closed mesh with horizontal planes.

    Parameters
    ----------
    vertices : ndarray, shape (n, 3) [um]
        Corners; z counted downwards.
    faces : ndarray, shape (m, 3)
        Triangles of a surface that is closed, at least where the planes cut it.
    heights : ndarray, shape (k,) [um]
        Depths of the planes, increasing.
    side : {"above", "below"}
        Where a plane through a corner is taken to lie, infinitely near.

    Returns
    -------
    list of shapely geometries, length k
        Polygon or multi-polygon of every section; empty where the plane misses the mesh.

    Raises
    ------
    InputError
        If the surface is open at a plane, or bodies overlap there.
    """
    sections = [shapely.Polygon()] * len(heights)
    points, ring_starts, plane_of_ring = _rings(vertices, faces, heights, side)
    if not len(ring_starts):
        return sections
    counts = np.diff(np.append(ring_starts, len(points)))
    areas = _ring_areas(points, ring_starts, counts)
    # Fewer than three corners, or none that are apart, enclose nothing.
    real = (counts >= 3) & (np.abs(areas) > 1e-12 * np.max(np.abs(areas)))
    ring_of_point = np.repeat(np.arange(len(counts)), counts)
    kept = real[ring_of_point]
    renumbered = np.cumsum(real) - 1
    rings = shapely.linearrings(points[kept], indices=renumbered[ring_of_point[kept]])
    areas, planes = areas[real], plane_of_ring[real]
    polygons = shapely.polygons(rings)
    valid = shapely.is_valid(polygons)
    bounds = np.searchsorted(planes, np.arange(len(heights) + 1))
    for k in range(len(heights)):
        some = slice(bounds[k], bounds[k + 1])
        if some.start < some.stop:
            sections[k] = _region(polygons[some], areas[some], bool(valid[some].all()), heights[k])
    return sections


def _rings(
    vertices: np.ndarray, faces: np.ndarray, heights: np.ndarray, side: Side
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of all rings one after another, where each begins, and its plane."""
    z = vertices[faces, 2]
    search: Literal["left", "right"] = "right" if side == "above" else "left"
    first = np.searchsorted(heights, z.min(axis=1), search)
    crossings = np.searchsorted(heights, z.max(axis=1), search) - first
    face = np.repeat(np.arange(len(faces)), crossings)
    begins = np.cumsum(crossings) - crossings
    plane = first[face] + np.arange(len(face)) - begins[face]
    height = heights[plane][:, None]
    deep = z[face] >= height if side == "above" else z[face] > height
    next_deep = np.roll(deep, -1, axis=1)
    # Every triangle is entered over one edge that goes down and left over one that comes up, and
    # its neighbour runs along the shared edge the other way: segments meet head to tail.
    low, high, start = _crossed_edges(faces, face, np.argmax(~deep & next_deep, axis=1), plane)
    _, _, end = _crossed_edges(faces, face, np.argmax(deep & ~next_deep, axis=1), plane)
    order, end_order = np.argsort(start, kind="stable"), np.argsort(end, kind="stable")
    open_at = start[order] != end[end_order]
    if np.any(open_at):
        depth = float(heights[plane[order[int(np.argmax(open_at))]]])
        raise InputError(f"the mesh is open at the depth {depth:g} um: close it.")
    follower = np.empty(len(face), np.int64)
    follower[end_order] = order
    way, ring_starts = _cycles(follower)
    a, b = vertices[low], vertices[high]
    share = (heights[plane] - a[:, 2]) / (b[:, 2] - a[:, 2])
    points = a[:, :2] + share[:, None] * (b[:, :2] - a[:, :2])
    plane_of_ring = plane[way[ring_starts]] if len(way) else plane
    by_plane = np.argsort(plane_of_ring, kind="stable")
    return _reordered(points[way], ring_starts, by_plane), *_new_starts(
        ring_starts, len(way), by_plane, plane_of_ring
    )


def _crossed_edges(
    faces: np.ndarray, face: np.ndarray, corner: np.ndarray, plane: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both corners of the edges, the smaller number first, and one number for edge and plane."""
    a, b = faces[face, corner], faces[face, (corner + 1) % 3]
    low, high = np.minimum(a, b), np.maximum(a, b)
    count, planes = np.int64(faces.max()) + 1, np.int64(plane.max(initial=0)) + 1
    return low, high, (low * count + high) * planes + plane


def _cycles(follower: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cycles of a permutation, one after another, and where each begins."""
    then = follower.tolist()
    seen = bytearray(len(then))
    way: list[int] = []
    starts: list[int] = []
    for begin in range(len(then)):
        if seen[begin]:
            continue
        starts.append(len(way))
        at = begin
        while not seen[at]:
            seen[at] = 1
            way.append(at)
            at = then[at]
    return np.array(way, np.int64), np.array(starts, np.int64)


def _new_starts(
    starts: np.ndarray, total: int, order: np.ndarray, plane_of_ring: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    counts = np.diff(np.append(starts, total))[order]
    return np.cumsum(counts) - counts, plane_of_ring[order]


def _reordered(points: np.ndarray, starts: np.ndarray, order: np.ndarray) -> np.ndarray:
    """The rings' corners with the rings in another order."""
    counts = np.diff(np.append(starts, len(points)))[order]
    into = np.cumsum(counts) - counts
    return points[np.arange(len(points)) + np.repeat(starts[order] - into, counts)]


def _ring_areas(points: np.ndarray, starts: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Signed area of every ring; positive around what belongs to the solid."""
    following = np.arange(1, len(points) + 1)
    following[starts + counts - 1] = starts
    # About each ring's first corner, lest large coordinates eat the digits.
    local = points - np.repeat(points[starts], counts, axis=0)
    ahead = local[following]
    twice = local[:, 0] * ahead[:, 1] - local[:, 1] * ahead[:, 0]
    return _TURN * 0.5 * np.add.reduceat(twice, starts)


# Entering downwards and leaving upwards runs clockwise about the solid in (x, y).
_TURN = -1.0


def _region(
    polygons: np.ndarray, areas: np.ndarray, valid: bool, height: float
) -> shapely.Geometry:
    """What an odd number of rings encloses, which must be what the signed areas add up to."""
    wanted = float(np.sum(areas))
    length = float(np.sum(shapely.length(polygons)))
    allowed = _RELATIVE * float(np.sum(np.abs(areas))) + _PER_LENGTH * length
    if valid:
        if len(polygons) == 1 and wanted > 0:
            return polygons[0]
        region = shapely.build_area(shapely.multilinestrings(shapely.get_exterior_ring(polygons)))
        if abs(region.area - wanted) <= allowed:
            return region
    # Rings that touch or cross themselves or each other: slower, and exact.
    parts = [_areal(shapely.make_valid(polygon)) for polygon in polygons]
    region = _areal(reduce(shapely.symmetric_difference, parts))
    if abs(region.area - wanted) > allowed:
        raise InputError(
            f"bodies of the mesh overlap at the depth {height:g} um: unite them into one body."
        )
    return region


def _areal(geometry: shapely.Geometry) -> shapely.Geometry:
    """The polygons of a geometry, without points and lines."""
    parts = shapely.get_parts(geometry)
    polygons = [p for p in parts if p.geom_type == "Polygon" and p.area > 0]
    polygons += [q for p in parts if p.geom_type == "MultiPolygon" for q in p.geoms]
    return polygons[0] if len(polygons) == 1 else shapely.MultiPolygon(polygons)
