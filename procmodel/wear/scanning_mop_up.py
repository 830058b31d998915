"""What lines and contours leave standing between them, and the way back to it."""

import numpy as np
import shapely

from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.scanning_coverage import sweep
from procmodel.wear.scanning_links import Way, nearest_first
from procmodel.wear.slicing_reach import dilate, polygon_parts

# In the corner of a square with its gap: how far the gap reaches along each side, at least.
_DIAGONAL = 0.7
# Of the electrode's area: a piece left standing that is not worth going back for.
_SPECK = 1e-4
_MOP_UPS = 4
_GROWN, _ARC = 1.003, 16


def mop_up(way: Way, reachable: shapely.Geometry, electrode: ElectrodeSection, gap: float) -> None:
    """Go back for what lines and contours have left standing between them.

    Parameters
    ----------
    way : Way
        The way so far; grows by the places that were left out.
    reachable : shapely geometry [um]
        Where the electrode's centre may go.
    electrode : ElectrodeSection
        Its section.
    gap : float [um]
        Side gap.
    """
    # A little larger, so that its walls do not run along those that are wanted: quicker, and no
    # slivers are left of rounding. The chords of 16 segments stay within that little.
    grown = ElectrodeSection(electrode.shape, _GROWN * electrode.size)
    wanted = dilate(reachable, electrode, gap, _ARC)
    left = wanted.difference(sweep(way.path(), grown, _GROWN * gap, _ARC))
    for turn in range(_MOP_UPS):
        pieces = [p for p in polygon_parts(left) if p.area > _SPECK * electrode.area]
        if not pieces:
            return
        before = len(way.path().points)
        # Place by place: a straight way between two of them may leave the region.
        nearest_first(
            [_places_for(piece, reachable, electrode, gap, turn == 0) for piece in pieces], way
        )
        path = way.path()
        fresh = LayerPath(path.points[before - 1 :], path.cutting[before - 1 :])
        left = left.difference(sweep(fresh, grown, _GROWN * gap, _ARC))


def _places_for(
    piece: shapely.Polygon,
    reachable: shapely.Geometry,
    electrode: ElectrodeSection,
    gap: float,
    first: bool,
) -> list[list[np.ndarray]]:
    """Where the centre goes for a piece: round it, or at first next to its middle if it is small.

    Both ways of following the places, which are pieces of one point each.
    """
    corners = shapely.get_coordinates(piece.exterior)
    middle = np.array(piece.centroid.coords[0])
    small = first and np.max(np.hypot(*(corners - middle).T)) < 0.5 * electrode.half
    if not small:
        corners = shapely.get_coordinates(piece.exterior.simplify(0.1 * electrode.half))
    targets = shapely.points(middle[None] if small else corners)
    onto = shapely.shortest_line(reachable, targets)
    if electrode.shape == "square":
        # The nearest place may be across a corner of the square, from where it does not get there.
        x, y = shapely.get_coordinates(targets).T
        half = electrode.half + _DIAGONAL * gap
        squares = shapely.box(x - half, y - half, x + half, y + half)
        near = shapely.shortest_line(shapely.intersection(reachable, squares), targets)
        onto = np.where(shapely.is_missing(near), onto, near)
    places = shapely.get_coordinates(onto)[::2]
    apart = np.append(True, np.hypot(*np.diff(places, axis=0).T) > 1e-6)
    forwards = [place[None] for place in places[apart]]
    return [forwards, forwards[::-1]]
