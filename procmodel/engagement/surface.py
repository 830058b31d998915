"""The surface that the previous pass leaves, and the engagement of the next pass with it.

Lengths in mm, angles in rad.
"""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jax import Array
from numpy.typing import ArrayLike
from shapely import STRtree

from procmodel.engagement.angle import AIR, DETACHED, ENGAGED, MULTIPLE, SLOT
from procmodel.engagement.contact import Contact, contact
from procmodel.engagement.contour import Contour
from procmodel.engagement.index import SegmentIndex
from procmodel.engagement.offset import offset, parallel, traced
from procmodel.engagement.segments import Segments, joined
from procmodel.errors import InputError

# Places evaluated in one compiled call: bounds the memory, whatever the length of the path.
_CHUNK = 1 << 16
_FEWEST = 1 << 8


class Engagement(NamedTuple):
    """Engagement of the tool at places along a path.

    Attributes
    ----------
    angle, total, area_rate, arcs, arc_count
        As in `procmodel.engagement.contact.Contact`, as NumPy.
    status : ndarray of int, shape (n,)
        Key into `STATUS`.
    """

    angle: np.ndarray
    total: np.ndarray
    area_rate: np.ndarray
    arcs: np.ndarray
    arc_count: np.ndarray
    status: np.ndarray


class Surface:
    """Boundary of what is cleared so far, with the means to find what is near a place.

    Parameters
    ----------
    contours : sequence of Contour
        The boundary, free side to the left.
    segments : Segments, optional
        The pieces of the contours in their order, where they are made differentiable elsewhere.

    Raises
    ------
    InputError
        If there is no contour.
    """

    def __init__(self, contours: Sequence[Contour], segments: Segments | None = None):
        if not contours:
            raise InputError(
                "the previous pass leaves no surface: the pocket is too narrow for its tool; take "
                "a smaller tool or radial depth."
            )
        self.contours = list(contours)
        self.host = joined([c.segments.on_host() for c in contours])
        self.segments = self.host if segments is None else segments
        self.index = SegmentIndex(self.host)

    def windows(
        self, centres: np.ndarray, radius: float, margin: float = 0.0
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Which segments may meet the rim of the tool, or come as near to it as a margin.

        Parameters
        ----------
        centres, radius, margin
            As for `SegmentIndex.tables`; the margin may be how far the centres are still moved.

        Returns
        -------
        list of (ndarray of int, shape (m,), ndarray of int, shape (m, k))
            Its tables, in chunks that bound the memory.
        """
        return self.index.tables(centres, radius, margin, _CHUNK)

    def near(self, centres: np.ndarray, radius: float, margin: float = 0.0) -> np.ndarray:
        """One table of the segments near a few places, for laws that are to be differentiated.

        Parameters
        ----------
        centres, radius, margin
            As for `windows`.

        Returns
        -------
        ndarray of int, shape (n, k)
            Numbers of segments, filled up with -1.
        """
        groups = self.windows(centres, radius, margin)
        table = np.full((len(centres), max(found.shape[1] for _, found in groups)), -1)
        for chosen, found in groups:
            table[chosen, : found.shape[1]] = found
        return table

    def in_stock(self, points: np.ndarray) -> np.ndarray:
        """Whether points lie in the stock; on the boundary itself either may be said.

        Parameters
        ----------
        points : ndarray, shape (n, 2) [mm]
            Where.

        Returns
        -------
        ndarray of bool, shape (n,)
            True to the right of the boundary.
        """
        tree, start, end = self._straightened
        asked, nearest = tree.query_nearest(shapely.points(points))
        chord, q = end[nearest] - start[nearest], points[asked] - start[nearest]
        side = (chord[:, 0] * q[:, 1] - chord[:, 1] * q[:, 0]) / np.hypot(*chord.T)
        # At a vertex both neighbours are nearest: the one seen less along itself tells the side.
        best = np.lexsort((-np.abs(side), asked))
        _, chosen = np.unique(asked[best], return_index=True)
        return side[best[chosen]] < 0.0

    def engagement(self, centres: ArrayLike, directions: ArrayLike, radius: float) -> Engagement:
        """Engagement of a tool at places of its path.

        Parameters
        ----------
        centres, directions : array_like, shape (n, 2) [mm, -]
            Tool centres and unit feed directions, the wall to the right.
        radius : float [mm]
            Tool radius.

        Returns
        -------
        Engagement
            NumPy arrays of n.
        """
        o, t = np.asarray(centres, float), np.asarray(directions, float)
        found = None
        for chosen, table in self.windows(o, radius):
            part = _evaluated(self.segments, *padded_rows(o[chosen], t[chosen], table), radius)
            if found is None:
                found = [np.zeros((len(o), *p.shape[1:]), p.dtype) for p in part]
            for whole, p in zip(found, part, strict=True):
                whole[chosen] = np.asarray(p)[: len(chosen)]
        angle, total, area_rate, arcs, count, at_wall, crossings = found or _nothing()
        untouched = np.flatnonzero(crossings == 0)
        if len(untouched):
            away = np.column_stack([-t[untouched, 1], t[untouched, 0]])
            full = self.in_stock(o[untouched] + radius * away)
            angle[untouched] = total[untouched] = np.where(full, np.pi, 0.0)
            area_rate[untouched] = np.where(full, 2.0 * radius, 0.0)
            arcs[untouched] = np.pi
            arcs[untouched[full], 0, 0] = 0.0
            count[untouched], at_wall[untouched] = full, full
        status = np.select(
            [count == 0, angle >= np.pi, ~at_wall, count > 1],
            [AIR, SLOT, DETACHED, MULTIPLE],
            ENGAGED,
        )
        return Engagement(angle, total, area_rate, arcs, count, status)

    @cached_property
    def _straightened(self) -> tuple[STRtree, np.ndarray, np.ndarray]:
        starts, ends = [], []
        for c in self.contours:
            points = c.flattened(1e-4)
            starts.append(points if c.closed else points[:-1])
            ends.append(np.roll(points, -1, axis=0) if c.closed else points[1:])
        start, end = np.concatenate(starts), np.concatenate(ends)
        return STRtree(shapely.linestrings(np.stack([start, end], axis=1))), start, end


def previous_surface(
    walls: Sequence[Contour], radial_depth: float, previous_radius: float
) -> Surface:
    """Surface that a parallel previous pass leaves.

    Parameters
    ----------
    walls : sequence of Contour
        Finished walls, free side to the left.
    radial_depth : float [mm]
        Stock that the pass leaves on the walls.
    previous_radius : float [mm]
        Radius of its tool; corners narrower than that keep more stock.

    Returns
    -------
    Surface
        The surface, exact.

    Raises
    ------
    InputError
        If the tool finds no room.
    """
    return Surface(cleared_by(offset(walls, radial_depth + previous_radius), previous_radius))


def traced_surface(
    walls: Sequence[Contour], radial_depth: float, previous_radius: float
) -> tuple[Surface, Callable[[Sequence[Contour], Any, Any], Segments]]:
    """Surface of a parallel previous pass, and the way to make it again with derivatives.

    Parameters
    ----------
    walls, radial_depth, previous_radius
        As for `previous_surface`.

    Returns
    -------
    surface : Surface
        The surface.
    again : callable
        Of walls, radial depth and previous radius near the given ones: the segments of the surface
        in the same order, differentiable in all of them, also under `jit`.

    Raises
    ------
    InputError
        As `previous_surface`.
    """
    shrunk = parallel(walls, radial_depth + previous_radius)
    grown = parallel(shrunk.contours, -previous_radius)

    def again(walls: Sequence[Contour], radial_depth: Any, previous_radius: Any) -> Segments:
        base = joined([wall.segments for wall in walls], jnp)
        path = traced(base, shrunk.origin, radial_depth + previous_radius)
        return traced(path, grown.origin, -previous_radius)

    return Surface(grown.contours), again


def cleared_by(paths: Sequence[Contour], radius: float) -> list[Contour]:
    """Boundary of what a tool clears on its way round.

    Parameters
    ----------
    paths : sequence of Contour
        Of the tool centre, the wall to the right; what lies inside the paths is cleared already.
    radius : float [mm]
        Tool radius.

    Returns
    -------
    list of Contour
        The boundary, free side to the left.
    """
    return offset(paths, -radius)


def padded_rows(o: np.ndarray, t: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, ...]:
    """Rows filled up to a power of 2 with copies of the first, so that few shapes are compiled."""
    wanted = max(_FEWEST, 1 << (len(o) - 1).bit_length())
    more = wanted - len(o)
    return tuple(np.concatenate([a, np.repeat(a[:1], more, axis=0)]) for a in (o, t, table))


@jax.jit
def _evaluated(
    segments: Segments, centres: Array, directions: Array, table: Array, radius: float
) -> tuple[Array, ...]:
    found: Contact = contact(
        centres, directions, radius, segments[jnp.maximum(table, 0)], table >= 0
    )
    return (
        found.angle, found.total, found.area_rate, found.arcs, found.arc_count, found.at_wall,
        found.crossings,
    )  # fmt: skip


def _nothing() -> list[np.ndarray]:
    empty = np.zeros(0)
    none = np.zeros(0, int)
    return [empty, empty, empty, np.zeros((0, 3, 2)), none, np.zeros(0, bool), none]
