"""Nodes of a path of which parts are free, and the path made again from where they are moved to.

Lengths in mm, angles in rad.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from calibration.plans.path import Survey
from procmodel.engagement.angle import AIR, SLOT
from procmodel.engagement.biarcs import through
from procmodel.engagement.contour import Contour, Stations, from_segments, part, stations
from procmodel.engagement.segments import Segments, cross, dot, joined, left, turned

_NOTICED = 1e-4
_SHARP = 1e-6
# A cubic spline that begins with value, slope and curvature 0 lacks its first three coefficients.
_DEGREE = 3


@dataclass(frozen=True)
class Line:
    """A contour cut open far from what is free.

    Attributes
    ----------
    original, path : Contour
        As it was, and open.
    at : Stations
        Nodes along the open path.
    normal : ndarray, shape (n, 2)
        Towards the wall; at corners of the path along the bisector and longer, as a mitre.
    corner : ndarray of bool, shape (n,)
        The last node of a piece after which the path turns sharply.
    parts : list of tuple of float [mm]
        Free parts of the way.
    marks : ndarray [mm]
        Where along the way the nodes are that leave too much stock.
    """

    original: Contour
    path: Contour
    at: Stations
    normal: np.ndarray
    corner: np.ndarray
    parts: list[tuple[float, float]]
    marks: np.ndarray


def opened(
    paths: list[Contour], met: Survey, radius: float, between: float, reach: float
) -> list[Line]:
    """Nodes of the previous path, free around those that leave too much stock.

    Parameters
    ----------
    paths : list of Contour
        Of the previous tool.
    met : Survey
        Of the pass after it.
    radius : float [mm]
        Tool radius of that pass.
    between : float [mm]
        Greatest distance of the nodes.
    reach : float [mm]
        How far from where too much stock is left the path is free.

    Returns
    -------
    list of Line
        One for each contour; without free parts where nothing overshoots.
    """
    over = _cuts(met) & (met.angle > met.target * (1.0 + _NOTICED))
    places = [stations(path, between) for path in paths]
    owner = np.repeat(np.arange(len(paths)), [len(p) for p in places])
    way = np.concatenate([p.way for p in places])
    _, nearest = cKDTree(np.concatenate([p.point for p in places])).query(rim(met, radius)[over])
    nearest = np.unique(nearest)
    lines = []
    for number, (path, at) in enumerate(zip(paths, places, strict=True)):
        marks, total = way[nearest[owner[nearest] == number]], path.length
        line = path
        if path.closed and len(marks):
            gaps = np.diff(np.append(marks, marks[0] + total))
            widest = int(np.argmax(gaps))
            seam = marks[widest] + 0.5 * gaps[widest]
            line = part(path, seam, seam + total)
            at = stations(line, between)
            marks = np.mod(marks - seam, total)
        right = -left(at.direction, np)
        turn = np.arctan2(
            cross(at.direction[:-1], at.direction[1:]), dot(at.direction[:-1], at.direction[1:])
        )
        corner = np.append((np.diff(at.segment) != 0) & (np.abs(turn) > _SHARP), False)
        i = np.flatnonzero(corner)
        both = 1.0 + dot(right[i], right[i + 1])
        right[i] = right[i + 1] = (right[i] + right[i + 1]) / np.maximum(both, 0.2)[:, None]
        parts = _around(marks, at.way, reach)
        lines.append(Line(path, line, at, right, corner, parts, marks))
    return lines


class Splines:
    """Displacement of a line's free parts as cubic B-splines, angular only where the path is.

    Parameters
    ----------
    line : Line
        The line.
    between : float [mm]
        Greatest distance of the knots.

    Attributes
    ----------
    which : ndarray of int, shape (n, 4)
        For each node, the variables that move it; -1 for none.
    share : ndarray, shape (n, 4)
        Of each of them; not below 0, and together at most 1.
    variables : int
        How many there are.
    away : ndarray, shape (variables,) [mm]
        How far along the way each is from the nearest node that leaves too much stock.
    """

    def __init__(self, line: Line, between: float):
        way = line.at.way
        self.which = np.full((len(way), _DEGREE + 1), -1)
        self.share = np.zeros((len(way), _DEGREE + 1))
        self.knots: list[np.ndarray] = []
        self.variables = 0
        middles = [np.zeros(0)]
        for begin, end in line.parts:
            mine = (way >= begin) & (way <= end)
            bends = way[mine & line.corner]
            bends = bends[(bends > begin) & (bends < end)]
            stops = np.concatenate([[begin], bends, [end]])
            counts = np.maximum(np.ceil(np.diff(stops) / between), 4).astype(int)
            inner = [
                np.linspace(a, b, n + 1)[1:-1]
                for a, b, n in zip(stops[:-1], stops[1:], counts, strict=True)
            ]
            ends = np.repeat([begin, end], _DEGREE + 1)
            knots = np.sort(np.concatenate([ends, np.repeat(bends, _DEGREE), *inner]))
            table = BSpline.design_matrix(way[mine], knots, _DEGREE)
            index = table.indices.reshape(-1, _DEGREE + 1) - _DEGREE
            count = table.shape[1] - 2 * _DEGREE
            held = (index < 0) | (index >= count)
            self.which[mine] = np.where(held, -1, index + self.variables)
            self.share[mine] = table.data.reshape(-1, _DEGREE + 1)
            self.knots.append(knots)
            self.variables += count
            # Where a coefficient counts most: the mean of the knots inside its support.
            mean = np.convolve(knots[1:-1], np.full(_DEGREE, 1.0 / _DEGREE), "valid")
            middles.append(mean[_DEGREE:-_DEGREE])
        middle, marks = np.concatenate(middles), np.append(line.marks, np.inf)
        self.away = np.abs(middle[:, None] - marks).min(axis=1)

    def curves(self, values: np.ndarray) -> list[BSpline]:
        """Displacement along the way of every free part [mm], from the variables' values."""
        curves, first = [], 0
        for knots in self.knots:
            count = len(knots) - 3 * _DEGREE - 1
            held = np.zeros(_DEGREE)
            values_here = np.concatenate([held, values[first : first + count], held])
            curves.append(BSpline(knots, values_here, _DEGREE))
            first += count
        return curves


def rebuilt(line: Line, splines: Splines, values: np.ndarray) -> Contour:
    """Path of lines and arcs through displaced nodes, what is not free being as it was.

    Parameters
    ----------
    line : Line
        The line.
    splines : Splines
        Of it.
    values : ndarray [mm]
        Of the variables.

    Returns
    -------
    Contour
        The path: pairs of arcs with the displaced curve's own tangents.
    """
    at, pieces, here = line.at, list[Segments](), 0.0
    total = float(at.way[-1])
    for (begin, end), curve in zip(line.parts, splines.curves(values), strict=True):
        if begin > here:
            pieces.append(part(line.path, here, begin).segments.on_host())
        rows = np.flatnonzero((at.way >= begin) & (at.way <= end))
        # A kink of the displacement is seen from the piece that a node belongs to.
        beside = np.where(line.corner[rows], -1e-9 * total, 0.0)
        slope = curve.derivative()(np.clip(at.way[rows] + beside, begin, end))
        shift = curve(at.way[rows])[:, None]
        ahead, aside = at.direction[rows], -left(at.direction[rows], np)
        tangent = ahead * (1.0 + shift * at.curvature[rows, None]) + slope[:, None] * aside
        tangent /= np.hypot(*tangent.T)[:, None]
        points = at.point[rows] + shift * line.normal[rows]
        for run in np.split(np.arange(len(rows)), np.flatnonzero(line.corner[rows]) + 1):
            if len(run) > 1:
                smooth = through(points[run], tangent[run], False, line.original.name)
                pieces.append(smooth.segments.on_host())
        here = end
    if here < total:
        pieces.append(part(line.path, here, total).segments.on_host())
    return from_segments(joined(pieces), line.original.closed, line.original.name)


def windows(
    met: Survey, lines: list[Line], free: np.ndarray, radius: float, half: int
) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes may end the engaged arc at which places.

    Parameters
    ----------
    met : Survey
        Of the pass after the lines'.
    lines : list of Line
        Of the previous tool.
    free : ndarray of bool, shape (n,)
        Nodes of all lines that may move.
    radius : float [mm]
        Tool radius of the later pass.
    half : int
        Nodes to either side of the one that ends the arc at the start.

    Returns
    -------
    seen : ndarray of bool
        The places at which a free node may end the arc.
    window : ndarray of int, shape (m, 2 half + 1)
        Numbers of nodes for each of them; at the end of a line the last one again.
    """
    nodes = np.concatenate([line.at.point for line in lines])
    counts = np.array([len(line.at) for line in lines])
    low = np.repeat(np.cumsum(counts) - counts, counts)
    high = np.repeat(np.cumsum(counts) - 1, counts)
    _, nearest = cKDTree(nodes).query(rim(met, radius))
    window = nearest[:, None] + np.arange(-half, half + 1)
    window = np.clip(window, low[nearest, None], high[nearest, None])
    seen = _cuts(met) & free[window].any(axis=1)
    return seen, window[seen]


def rim(met: Survey, radius: float) -> np.ndarray:
    """Where the rim of the tool leaves the stock at all places of a survey, shape (n, 2) [mm]."""
    centre = np.concatenate([p.point for p in met.places])
    direction = np.concatenate([p.direction for p in met.places])
    return centre + radius * turned(direction, met.angle - 0.5 * np.pi, np)


def _cuts(met: Survey) -> np.ndarray:
    return (met.status != AIR) & (met.status != SLOT) & (met.angle > 0.0)


def _around(marks: np.ndarray, way: np.ndarray, reach: float) -> list[tuple[float, float]]:
    """Stretches of a way within reach of marks, from node to node."""
    parts: list[tuple[float, float]] = []
    for mark in np.sort(marks):
        begin = float(way[np.searchsorted(way, max(mark - reach, 0.0))])
        end = float(way[min(np.searchsorted(way, mark + reach), len(way) - 1)])
        if parts and begin <= parts[-1][1]:
            parts[-1] = (parts[-1][0], end)
        elif end > begin:
            parts.append((begin, end))
    return parts
