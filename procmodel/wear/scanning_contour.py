"""Contours of a region and, a step apart, contours inside them."""

import numpy as np
import shapely

from procmodel.wear.scanning_links import Way
from procmodel.wear.slicing_reach import polygons_of

_ARC, _COARSE = 16, 4
# Farther from the next contour than this many half electrodes, a place is covered by no contour:
# a branch of the region has ended. The corners between two contours are nearer (sqrt 2).
_FAR = 1.5


def add_rings(way: Way, polygon: shapely.Polygon, direction: np.ndarray) -> None:
    """Follow the outline of a polygon and of its islands.

    Parameters
    ----------
    way : Way
        Grows by the rings.
    polygon : shapely.Polygon [um]
        Whose rings.
    direction : ndarray, shape (2,)
        A way that has not begun begins at the corner farthest in this direction.
    """
    left = [ring for ring in (polygon.exterior, *polygon.interiors) if ring.length > 0]
    while left:
        end = way.end
        if end is None:
            ring = left.pop(0)
        else:
            at = shapely.Point(end)
            ring = left.pop(int(np.argmin([r.distance(at) for r in left])))
        corners = shapely.get_coordinates(ring)[:-1]
        if not shapely.is_ccw(ring):
            corners = corners[::-1]
        if end is None:
            start = int(np.argmax(corners @ direction))
        else:
            start = int(np.argmin(np.hypot(*(corners - end).T)))
        way.add(np.vstack([corners[start:], corners[: start + 1]]))


def add_contours(
    way: Way, polygon: shapely.Polygon, step: float, half: float, direction: np.ndarray
) -> None:
    """Follow the outline of a polygon, then contours a step apart until its inside is covered.

    Parameters
    ----------
    way : Way
        Grows by the contours, those of a branch before those of the next.
    polygon : shapely.Polygon [um]
        Where the electrode's centre may go.
    step : float [um]
        Distance of neighbouring contours.
    half : float [um]
        Half the electrode's size: what a contour covers on its inner side.
    direction : ndarray, shape (2,)
        See `add_rings`.
    """
    add_rings(way, polygon, direction)
    inner = polygons_of(polygon.buffer(-step, quad_segs=_ARC))
    bare = polygons_of(polygon.buffer(-half, quad_segs=_ARC))
    if not inner.is_empty:
        bare = polygons_of(bare.difference(inner.buffer(_FAR * half, quad_segs=_COARSE)))
    branches = [(part, True) for part in shapely.get_parts(inner) if part.area > 0]
    branches += [(part, False) for part in shapely.get_parts(bare) if part.area > 1e-9 * half**2]
    while branches:
        at = shapely.Point(way.end)
        nearest = int(np.argmin([part.distance(at) for part, _ in branches]))
        part, goes_on = branches.pop(nearest)
        if goes_on:
            add_contours(way, part, step, half, direction)
        else:
            add_rings(way, part, direction)
