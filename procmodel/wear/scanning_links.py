"""A way put together piece by piece that stays where the electrode's centre may go.

From the end of one piece to the start of the next the electrode goes straight if that stays in the
reachable region, else along the region's outline if both ends lie on one, else it is lifted.
"""

import numpy as np
import shapely

from procmodel.wear.layer_path import LayerPath

# Nearer than this two places are the same [um].
_SAME = 1e-6
# An end nearer than this to an outline lies on it [um].
_ON_OUTLINE = 1e-3


class Way:
    """Way of the electrode's centre, growing.

    Parameters
    ----------
    reachable : shapely geometry [um]
        Where the centre may go.
    """

    def __init__(self, reachable: shapely.Geometry):
        # Room for rounding: ends of moves lie on the outline, to its last digits.
        self._room = shapely.buffer(reachable, _SAME, quad_segs=1)
        shapely.prepare(self._room)
        polygons = [p for p in shapely.get_parts(reachable) if p.geom_type == "Polygon"]
        self._outlines = [ring for p in polygons for ring in (p.exterior, *p.interiors)]
        self._pieces: list[np.ndarray] = []
        self._cutting: list[np.ndarray] = []

    @property
    def end(self) -> np.ndarray | None:
        """Where the way ends now, shape (2,); None before it has begun."""
        return self._pieces[-1][-1] if self._pieces else None

    def add(self, piece: np.ndarray) -> None:
        """Go to the start of a piece and follow it.

        Parameters
        ----------
        piece : ndarray, shape (m, 2) [um]
            Corners of a polyline in the reachable region.
        """
        end = self.end
        if end is None:
            self._append(piece, np.ones(len(piece) - 1, bool))
            return
        target = piece[0]
        if np.hypot(*(target - end)) <= _SAME:
            self._append(piece[1:], np.ones(len(piece) - 1, bool))
            return
        link, cut = self._link(end, target)
        self._append(link, np.full(len(link), cut))
        self._append(piece[1:], np.ones(len(piece) - 1, bool))

    def path(self, quarter_turns: int = 0) -> LayerPath:
        """The way as the path of a layer."""
        return LayerPath(np.concatenate(self._pieces), np.concatenate(self._cutting), quarter_turns)

    def _append(self, points: np.ndarray, cutting: np.ndarray) -> None:
        if len(points):
            self._pieces.append(points)
            self._cutting.append(cutting)

    def _link(self, start: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, bool]:
        """Corners after the start up to the target, and whether they are cut."""
        if shapely.covers(self._room, shapely.LineString([start, target])):
            return target[None], True
        ends = shapely.points([start, target])
        for ring in self._outlines:
            if np.all(shapely.distance(ring, ends) <= _ON_OUTLINE):
                return _along(ring, start, target), True
        return target[None], False


def _along(ring: shapely.LinearRing, start: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The shorter way along a ring, without the start."""
    corners = shapely.get_coordinates(ring)[:-1]
    reached = np.append(0.0, np.cumsum(np.hypot(*np.diff(corners, axis=0).T)))
    total = ring.length
    begin, end = (float(shapely.line_locate_point(ring, shapely.Point(p))) for p in (start, target))
    ahead = (end - begin) % total
    if ahead <= total - ahead:
        gone = (reached - begin) % total
        inside, order = (gone > 0) & (gone < ahead), gone
    else:
        gone = (begin - reached) % total
        inside, order = (gone > 0) & (gone < total - ahead), gone
    between = corners[inside][np.argsort(order[inside], kind="stable")]
    return np.vstack([between, target])


def nearest_first(pieces: list[list[list[np.ndarray]]], way: Way) -> None:
    """Add pieces to a way, always the one whose start is nearest to where the way ends.

    Parameters
    ----------
    pieces : list of lists of lists of ndarray, each shape (m, 2) [um]
        Pieces; each in the ways in which it may be followed; each of these as polylines, to which
        the way finds its own links.
    way : Way
        Grows by all of them.
    """
    left = list(pieces)
    while left:
        end = way.end
        if end is None:
            chosen, option = 0, left[0][0]
        else:
            choices = [(i, option) for i, options in enumerate(left) for option in options]
            starts = np.array([option[0][0] for _, option in choices])
            chosen, option = choices[int(np.argmin(np.hypot(*(starts - end).T)))]
        left.pop(chosen)
        for polyline in option:
            way.add(polyline)
