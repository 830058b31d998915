"""What an electrode reaches of a section: where its centre may go, and what it clears from there.

A round electrode with a side gap is a disc of its radius + gap. A square one is its square, the gap
laid round it, so that it rounds corners with the gap alone. Lengths in um.
"""

import math
from itertools import pairwise

import numpy as np
import shapely

from procmodel.errors import InputError
from procmodel.wear.layer_path import ElectrodeSection

# An electrode that just fits has a way of no width. There alone the centre is allowed this much
# more [um], far below what the gap is known to, and the way is a thin polygon instead of nothing.
FIT = 0.01

# Segments per quarter circle. The chords lie at most 7.5e-5 of the radius inside the arc.
QUAD_SEGMENTS = 64


_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def check_gap(gap: float) -> None:
    """Refuse a side gap that is not a number of 0 or more [um].

    Raises
    ------
    InputError
        If it is not.
    """
    if not (math.isfinite(gap) and gap >= 0):
        raise InputError(f"side gap {gap:g} um must be 0 or more.")


def erode(
    region: shapely.Geometry, electrode: ElectrodeSection, gap: float = 0.0
) -> shapely.Geometry:
    """Places of the electrode's centre from which it cuts nothing outside a region.

    Parameters
    ----------
    region : shapely geometry [um]
        Polygon or multi-polygon.
    electrode : ElectrodeSection
        Its section.
    gap : float [um]
        Side gap.

    Returns
    -------
    shapely geometry
        The reachable region, a way `FIT` wide about the middle where the electrode just fits;
        empty where it does not fit.
    """
    eroded = []
    for part in shapely.get_parts(region):
        inside = _eroded(part, electrode, gap, electrode.half)
        if inside.is_empty and electrode.half > FIT:
            inside = _eroded(part, electrode, gap, electrode.half - FIT)
        eroded += [p for p in shapely.get_parts(inside) if not p.is_empty]
    return eroded[0] if len(eroded) == 1 else shapely.MultiPolygon(eroded)


def dilate(
    places: shapely.Geometry,
    electrode: ElectrodeSection,
    gap: float = 0.0,
    quad_segments: int = QUAD_SEGMENTS,
) -> shapely.Geometry:
    """What the electrode clears when its centre visits some places.

    Parameters
    ----------
    places : shapely geometry [um]
        Points, lines or polygons.
    electrode : ElectrodeSection
        Its section.
    gap : float [um]
        Side gap.
    quad_segments : int
        Segments per quarter circle.

    Returns
    -------
    shapely geometry
        The cleared region.
    """
    if places.is_empty:
        return shapely.Polygon()
    if electrode.shape == "round":
        return places.buffer(electrode.half + gap, quad_segs=quad_segments)
    swept = _dilated_by_square(places, electrode.half)
    return swept.buffer(gap, quad_segs=quad_segments) if gap > 0 else swept


def polygons_of(geometry: shapely.Geometry) -> shapely.Geometry:
    """The polygons of a geometry as one polygon or multi-polygon, lines and points dropped."""
    if geometry.geom_type == "Polygon":
        return geometry
    parts = shapely.get_parts(shapely.get_parts(geometry))
    parts = [p for p in parts if p.geom_type == "Polygon" and not p.is_empty]
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def polygon_parts(geometry: shapely.Geometry) -> list[shapely.Polygon]:
    """The polygons of a geometry, one by one; lines, points and empty ones dropped."""
    parts = shapely.get_parts(geometry)
    return [p for p in parts if p.geom_type == "Polygon" and not p.is_empty]


def inscribed_radius(region: shapely.Geometry) -> float:
    """Radius of the largest circle inside a region, within 1e-4 of its size; 0 if empty [um]."""
    return max(
        (
            shapely.maximum_inscribed_circle(part, tolerance=1e-4 * math.sqrt(part.area)).length
            for part in shapely.get_parts(region)
            if part.area > 0
        ),
        default=0.0,
    )


def _eroded(
    part: shapely.Polygon, electrode: ElectrodeSection, gap: float, half: float
) -> shapely.Geometry:
    if electrode.shape == "round":
        return polygons_of(part.buffer(-half - gap, quad_segs=QUAD_SEGMENTS))
    inner = polygons_of(part.buffer(-gap, quad_segs=QUAD_SEGMENTS)) if gap > 0 else part
    return _eroded_by_square(inner, half)


def _dilated_by_square(places: shapely.Geometry, half: float) -> shapely.Geometry:
    if _is_convex(places):
        corners = shapely.get_coordinates(places)[:, None, :] + half * _CORNERS
        return shapely.MultiPoint(corners.reshape(-1, 2)).convex_hull
    swept = shapely.union_all([places, *_swept_squares(places, half)])
    return polygons_of(swept)  # a line has no area of its own


def _eroded_by_square(region: shapely.Geometry, half: float) -> shapely.Geometry:
    """What is left when a square run along the outline is cut away."""
    if region.is_empty:
        return shapely.Polygon()
    left, low, right, high = region.bounds
    box_area = (right - left) * (high - low)
    if abs(region.area - box_area) <= 1e-12 * box_area:  # a rectangle along the axes
        if min(right - left, high - low) <= 2 * half:
            return shapely.Polygon()
        return shapely.box(left + half, low + half, right - half, high - half)
    if _is_convex(region):
        # All four corners of the square must be inside.
        moved = [shapely.transform(region, lambda xy, c=c: xy - half * c) for c in _CORNERS]
        return polygons_of(shapely.intersection_all(moved))
    hulls = _swept_squares(region.boundary, half)
    return polygons_of(region.difference(shapely.union_all(hulls)))


def _is_convex(geometry: shapely.Geometry) -> bool:
    if geometry.geom_type != "Polygon" or geometry.interiors:
        return False
    hull = shapely.area(shapely.convex_hull(geometry))
    return bool(hull - geometry.area <= 1e-9 * hull)


def _swept_squares(geometry: shapely.Geometry, half: float) -> list[shapely.Polygon]:
    """What a square covers on its way along every line and outline; around every single point."""
    parts = shapely.get_parts(geometry)
    kinds = shapely.get_type_id(parts)
    areal = parts[kinds == shapely.GeometryType.POLYGON]
    outlines = shapely.get_parts(shapely.get_parts(shapely.boundary(areal)))
    lines = [*parts[kinds == shapely.GeometryType.POINT], *parts[np.isin(kinds, (1, 2))], *outlines]
    return [
        _swept_run(run, half)
        for line in lines
        for run in _monotone_runs(shapely.get_coordinates(line))
    ]


def _monotone_runs(corners: np.ndarray) -> list[np.ndarray]:
    """A polyline in pieces along which neither x nor y turns back."""
    moves = np.sign(np.diff(corners, axis=0))
    if not len(moves):
        return [corners]
    # A move along an axis goes on as the one before it: it turns back in neither.
    known = np.maximum.accumulate(np.where(moves != 0, np.arange(len(moves))[:, None], 0), axis=0)
    moves = np.take_along_axis(moves, known, axis=0)
    turns = np.flatnonzero(np.any(moves[1:] * moves[:-1] < 0, axis=1)) + 1
    ends = [0, *turns, len(corners) - 1]
    return [corners[a : b + 1] for a, b in pairwise(ends)]


def _swept_run(run: np.ndarray, half: float) -> shapely.Polygon:
    """Between the ways of the two corners of the square that lie across the direction."""
    along = np.where(run[-1] >= run[0], half, -half)
    across = along * [1.0, -1.0]
    return shapely.Polygon(
        np.vstack([run[0] - along, run + across, run[-1] + along, run[::-1] - across])
    )
