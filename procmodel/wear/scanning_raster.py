"""Parallel lines to and fro over a region with islands."""

import math

import numpy as np
import shapely

from procmodel.wear.slicing_reach import FIT

Row = tuple[float, float, float]
_EDGE = 1e-6


def raster_pieces(
    reachable: shapely.Geometry, step: float, along: str, at_edges: bool
) -> list[list[np.ndarray]]:
    """Zigzags that together cover a region with lines a step apart.

    Parameters
    ----------
    reachable : shapely geometry [um]
        Where the electrode's centre may go.
    step : float [um]
        Greatest distance of neighbouring lines.
    along : {"x", "y"}
        Direction of the lines.
    at_edges : bool
        Whether there is a line at either edge of the region; without them something else, a
        contour, has to go there.

    Returns
    -------
    list of lists of ndarray, each shape (m, 2) [um]
        Zigzags between islands, each in the four ways in which it may be followed. Their
        turns are straight: the links along curved walls are left to `Way`, which is why a zigzag
        whose turns leave the region comes in pieces.
    """
    if along == "y":
        turned = shapely.transform(reachable, lambda xy: xy[:, ::-1])
        pieces = raster_pieces(turned, step, "x", at_edges)
        return [[option[:, ::-1] for option in options] for options in pieces]
    found = []
    for part in shapely.get_parts(reachable):
        if part.geom_type != "Polygon":
            continue
        rows = _rows(part, step, at_edges)
        room = shapely.buffer(part, _EDGE, quad_segs=1)
        shapely.prepare(room)
        for chain in _chains(rows):
            found += [_ways(rows_of_piece) for rows_of_piece in _straight_turns(chain, room)]
    return found


def _rows(part: shapely.Polygon, step: float, at_edges: bool) -> list[list[Row]]:
    """Of every line the pieces inside a polygon, as (y, left, right)."""
    left, low, right, high = part.bounds
    height = high - low
    count = max(1, math.ceil(height / step - 1e-9))
    y = np.linspace(low, high, count + 1)
    if height <= 4 * _EDGE or (at_edges and height <= 4 * FIT):
        y = np.array([(low + high) / 2])
    elif at_edges:
        y[0], y[-1] = low + _EDGE, high - _EDGE
    else:
        y = y[1:-1]
    if not len(y):
        return []
    ends = np.empty((len(y), 2, 2))
    ends[:, 0, 0], ends[:, 1, 0] = left - 1.0, right + 1.0
    ends[:, :, 1] = y[:, None]
    cut = shapely.intersection(shapely.linestrings(ends), part)
    pieces, line = shapely.get_parts(cut, return_index=True)
    rows: list[list[Row]] = [[] for _ in y]
    for piece, k in zip(pieces, line, strict=True):
        if not piece.is_empty:
            begin, _, end, _ = piece.bounds
            rows[k].append((float(y[k]), begin, end))
    return [sorted(row, key=lambda r: r[1]) for row in rows]


def _chains(rows: list[list[Row]]) -> list[list[Row]]:
    """Rows in chains: pieces of neighbouring lines that face each other and nothing else."""
    chains: list[list[Row]] = []
    active: list[list[Row]] = []
    for row in rows:
        facing = [[c for c in active if c[-1][1] <= b and a <= c[-1][2]] for _, a, b in row]
        faced = {id(c): sum(c in f for f in facing) for c in active}
        following = []
        for piece, above in zip(row, facing, strict=True):
            if len(above) == 1 and faced[id(above[0])] == 1:
                above[0].append(piece)
                following.append(above[0])
            else:
                chains.append([piece])
                following.append(chains[-1])
        active = following
    return chains


def _straight_turns(chain: list[Row], room: shapely.Geometry) -> list[list[Row]]:
    """A chain, parted where a straight turn at its left or right would leave the region."""
    if len(chain) < 2:
        return [chain]
    rows = np.array(chain)
    inside = np.ones(len(chain) - 1, bool)
    for side in (1, 2):
        ends = np.column_stack([rows[:, side], rows[:, 0]])
        turns = shapely.linestrings(np.stack([ends[:-1], ends[1:]], axis=1))
        inside &= shapely.covers(room, turns)
    cuts = np.flatnonzero(~inside) + 1
    return [chain[a:b] for a, b in zip([0, *cuts], [*cuts, len(chain)], strict=True)]


def _ways(chain: list[Row]) -> list[np.ndarray]:
    """A chain as a zigzag from each of its four ends."""
    rows = np.array(chain)
    ways = []
    for order in (rows, rows[::-1]):
        for first in (1, 2):
            side = np.where(np.arange(len(order)) % 2 == 0, first, 3 - first)
            begin = order[np.arange(len(order)), side]
            end = order[np.arange(len(order)), 3 - side]
            zigzag = np.stack([begin, end], axis=1).reshape(-1)
            points = np.column_stack([zigzag, np.repeat(order[:, 0], 2)])
            apart = np.append(True, np.hypot(*np.diff(points, axis=0).T) > _EDGE)
            ways.append(points[apart])
    return ways
