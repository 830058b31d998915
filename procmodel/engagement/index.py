"""Which pieces of a surface the rim of a tool may meet, for many places at once.

Places share cells of a grid; a cell lists the runs of neighbouring pieces that are near, and every
place goes down from them, runs being halved twice on each level, to the pieces at its own rim. So
neither the work nor what is found grows with the number of pieces. Lengths in mm.
"""

from typing import NamedTuple

import numpy as np
from shapely import STRtree, box

from procmodel.engagement.segments import Segments, end_directions, half_sweeps, lengths

# Places looked up together: their pairs with pieces stay in the cache.
_CHUNK = 1 << 12
# Of the tool radius: the sizes of the cells, and how long the runs are that cells list.
_CELLS, _RUN = (1 / 4, 1 / 16), 1 / 32
_FAN = 4
# Of the tool radius: rounding of a distance.
_ROUNDING = 1e-9
_NOWHERE = (0.0, 0.0, 0.0, 0.0, -1e30)


class _Runs(NamedTuple):
    """Runs of neighbouring pieces: chords, and how far the pieces may be from them."""

    x: np.ndarray
    y: np.ndarray
    end_x: np.ndarray
    end_y: np.ndarray
    off: np.ndarray


class SegmentIndex:
    """Looks up the pieces that lie near the rim of a tool.

    Parameters
    ----------
    segments : Segments
        The pieces, as NumPy arrays, neighbours in order.

    Attributes
    ----------
    spacing : float [mm]
        Length of a piece, the median.
    """

    def __init__(self, segments: Segments):
        self._pieces = segments
        self._end_direction = end_directions(segments, np)
        self._length = lengths(segments, np)
        self.spacing = float(np.median(self._length))
        # The rise of an arc of a half circle at most over its chord.
        half = half_sweeps(segments, np)
        rise = 0.5 * np.hypot(*(segments.end - segments.start).T) * np.abs(np.tan(0.5 * half))
        (x, y), (end_x, end_y) = segments.start.T, segments.end.T
        self._levels = [_filled_up(_Runs(x, y, end_x, end_y, rise))]
        self._tree: dict[int, STRtree] = {}

    def tables(
        self, centres: np.ndarray, radius: float, margin: float, most: int
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Pieces that come as near to the rim as a margin, as tables of few shapes.

        Parameters
        ----------
        centres : ndarray, shape (n, 2) [mm]
            Tool centres.
        radius : float [mm]
            Tool radius.
        margin : float [mm]
            How far a piece may be from the rim.
        most : int
            Rows in one table at most.

        Returns
        -------
        list of (ndarray of int, shape (m,), ndarray of int, shape (m, k))
            Numbers of the places in groups, and for each the numbers of the pieces, filled up with
            -1; a few pieces that are farther away may be among them. The widths are powers of 2,
            so that few shapes are compiled.
        """
        if not len(centres):
            return []
        reach = margin + _ROUNDING * radius
        fits = max(1.0, _RUN * radius / self.spacing)
        top = int(np.log(fits) / np.log(_FAN))
        while len(self._levels) <= top:
            self._levels.append(_grouped(self._levels[-1]))
        cell, run, middle, owner = self._by_cells(top, centres, radius, reach)
        if top == 0:
            # Where pieces are long their cell has told enough of them apart.
            slack = _slack(_CELLS[1], radius, reach)
            kept = self._meets(run, middle[cell, 0], middle[cell, 1], radius, slack)
            return _tables(cell[kept], run[kept], owner, len(middle), most)
        count = np.bincount(cell, minlength=len(middle))
        first = np.cumsum(count) - count
        found = []
        for begin in range(0, len(centres), _CHUNK):
            here = owner[begin : begin + _CHUNK]
            x, y = centres[begin : begin + _CHUNK].T
            place, runs = _listed(first[here], count[here], run)
            for level in range(top, -1, -1):
                hit = _may_meet(self._levels[level], runs, x[place], y[place], radius, reach)
                place, runs = place[hit], runs[hit]
                if level:
                    place = np.repeat(place, _FAN)
                    runs = (_FAN * runs[:, None] + np.arange(_FAN)).ravel()
            kept = self._meets(runs, x[place], y[place], radius, reach)
            found.append((place[kept] + begin, runs[kept]))
        place, piece = (np.concatenate(part) for part in zip(*found, strict=True))
        return _tables(place, piece, np.arange(len(centres)), len(centres), most)

    def _meets(
        self, piece: np.ndarray, x: np.ndarray, y: np.ndarray, radius: float, reach: float
    ) -> np.ndarray:
        """Whether pieces come within reach of the rim around (x, y)."""
        ends = self._levels[0]
        sx, sy = x - ends.x[piece], y - ends.y[piece]
        ex, ey = x - ends.end_x[piece], y - ends.end_y[piece]
        first, last = sx * sx + sy * sy, ex * ex + ey * ey
        outside = np.minimum(first, last) > (radius + reach) ** 2
        inside = np.maximum(first, last) < max(radius - reach, 0.0) ** 2
        meets = ~(outside | inside)
        # With both ends on one side a piece may still reach the rim between them: a nearest or
        # farthest point there, to which the way comes nearer first and then goes away, or back.
        rest = np.flatnonzero(~meets)
        one = piece[rest]
        dx, dy = self._pieces.direction[one].T
        fx, fy = self._end_direction[one].T
        begins, stops = sx[rest] * dx + sy[rest] * dy, ex[rest] * fx + ey[rest] * fy
        kappa = self._pieces.curvature[one]
        level = 0.5 * kappa * first[rest] - (sy[rest] * dx - sx[rest] * dy)
        off = 2.0 * level / (1.0 + np.sqrt(np.maximum(1.0 + 2.0 * kappa * level, 0.0)))
        turns = np.abs(kappa) * self._length[one] > 3.0
        nearest = (begins >= -reach) & (stops <= reach) & (np.abs(off) <= radius + reach)
        farthest = (kappa != 0.0) & (begins <= reach) & (stops >= -reach)
        meets[rest] = np.where(outside[rest], nearest, farthest) | turns
        return meets

    def _by_cells(
        self, level: int, centres: np.ndarray, radius: float, reach: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Pairs of cells and near runs in the order of the cells, their middles, places' cells."""
        runs = self._levels[level]
        coarse, fine = _CELLS
        middle, owner = _cells(centres, fine * radius)
        centre, parent = _cells(middle, coarse * radius)
        if level not in self._tree:
            x, y, end_x, end_y, off = np.stack(runs)[:, runs.off >= 0.0]
            self._tree[level] = STRtree(
                box(
                    np.minimum(x, end_x) - off, np.minimum(y, end_y) - off,
                    np.maximum(x, end_x) + off, np.maximum(y, end_y) + off,
                )
            )  # fmt: skip
        slack = _slack(coarse, radius, reach)
        within = radius + slack
        at, run = self._tree[level].query(
            box(*np.column_stack([centre - within, centre + within]).T)
        )
        hit = _may_meet(runs, run, centre[at, 0], centre[at, 1], radius, slack)
        at, run = at[hit], run[hit]
        order = np.argsort(at, kind="stable")
        count = np.bincount(at, minlength=len(centre))
        cell, run = _listed((np.cumsum(count) - count)[parent], count[parent], run[order])
        slack = _slack(fine, radius, reach)
        hit = _may_meet(runs, run, middle[cell, 0], middle[cell, 1], radius, slack)
        return cell[hit], run[hit], middle, owner


def _grouped(runs: _Runs) -> _Runs:
    """Runs joined to longer ones, one level up."""
    first = np.arange(0, len(runs.x), _FAN)
    last = np.minimum(first + _FAN, np.count_nonzero(runs.off >= 0.0)) - 1
    group = np.arange(len(runs.x)) // _FAN
    x, y, end_x, end_y = runs.x[first], runs.y[first], runs.end_x[last], runs.end_y[last]
    off = np.zeros(len(runs.x))
    # What is farthest of a chord from another is one of its ends.
    for px, py in ((runs.x, runs.y), (runs.end_x, runs.end_y)):
        cx, cy = (end_x - x)[group], (end_y - y)[group]
        qx, qy = px - x[group], py - y[group]
        squared = cx * cx + cy * cy
        share = np.clip((qx * cx + qy * cy) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
        off = np.maximum(off, np.hypot(qx - share * cx, qy - share * cy))
    return _filled_up(_Runs(x, y, end_x, end_y, np.maximum.reduceat(off + runs.off, first)))


def _filled_up(runs: _Runs) -> _Runs:
    """Runs in a number that can be grouped: the last ones are nowhere and meet nothing."""
    more = -len(runs.x) % _FAN
    return _Runs(*(np.append(c, np.full(more, e)) for c, e in zip(runs, _NOWHERE, strict=True)))


def _may_meet(
    runs: _Runs, run: np.ndarray, x: np.ndarray, y: np.ndarray, radius: float, reach: float
) -> np.ndarray:
    """Whether a run may come within reach of the rim around (x, y)."""
    sx, sy = x - runs.x[run], y - runs.y[run]
    ex, ey = x - runs.end_x[run], y - runs.end_y[run]
    first, last = sx * sx + sy * sy, ex * ex + ey * ey
    slack = runs.off[run] + reach
    meets = np.maximum(first, last) >= np.maximum(radius - slack, 0.0) ** 2
    outside = np.flatnonzero(meets & (np.minimum(first, last) > (radius + slack) ** 2))
    sx, sy, ex, ey = sx[outside], sy[outside], ex[outside], ey[outside]
    cx, cy = sx - ex, sy - ey
    across = np.abs(cx * sy - cy * sx) <= np.hypot(cx, cy) * (radius + slack[outside])
    meets[outside] = across & (cx * sx + cy * sy >= 0.0) & (cx * ex + cy * ey <= 0.0)
    return meets


def _cells(points: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Middles of the cells of a grid in which points lie, and every point's cell."""
    row, column = (np.floor(np.ascontiguousarray(c) / size).astype(np.int64) for c in points.T)
    low = np.array([row.min(), column.min()])
    row -= low[0]
    column -= low[1]
    height, width = int(row.max()) + 1, int(column.max()) + 1
    row *= width
    row += column
    if width * height <= 8 * len(points) + 1024:
        number = np.zeros(width * height, int)
        number[row] = 1
        keys = np.flatnonzero(number)
        number[keys] = np.arange(len(keys))
        owner = number[row]
    else:
        keys, owner = np.unique(row, return_inverse=True)
    return (np.column_stack([keys // width, keys % width]) + low + 0.5) * size, owner


def _listed(
    first: np.ndarray, count: np.ndarray, listed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the places and what their lists hold, one pair after the other."""
    place = np.repeat(np.arange(len(first)), count)
    begins = np.cumsum(count) - count
    return place, listed[np.arange(len(place)) + np.repeat(first - begins, count)]


def _slack(cell: float, radius: float, reach: float) -> float:
    """Farther reach of the middle of a cell than of what may be in it."""
    return 0.7072 * cell * radius + reach


def _tables(
    row: np.ndarray, piece: np.ndarray, owner: np.ndarray, count: int, most: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pairs of rows and pieces, in the order of the rows, as tables for the rows' owners."""
    counts = np.bincount(row, minlength=count)
    rank = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    widths = 1 << np.ceil(np.log2(np.maximum(counts, 2))).astype(int)
    groups = []
    for k in np.flatnonzero(np.bincount(widths)):
        rows = np.flatnonzero(widths == k)
        number = np.full(count, -1)
        number[rows] = np.arange(len(rows))
        at = number[row]
        mine = at >= 0
        table = np.full((len(rows), k), -1, np.int32)
        table[at[mine], rank[mine]] = piece[mine]
        at = number[owner]
        places = np.flatnonzero(at >= 0)
        for chosen in np.array_split(places, -(-len(places) // most)):
            groups.append((chosen, table[at[chosen]]))
    return groups
