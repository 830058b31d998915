"""Exact parallel curves of contours: lines stay lines, arcs stay arcs, what cannot be reached goes.

Every piece is moved sideways, gaps at vertices are closed by arcs around them, all of it is cut
where it crosses itself, and what lies nearer to the contour than the distance is dropped. What is
kept are whole pieces of lines and arcs, so their curves are those of the contour moved sideways,
and differentiable in contour and distance (`Origin`). Lengths in mm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from shapely import STRtree, box
from shapely import points as points_of

from procmodel.engagement.contour import Contour, from_segments
from procmodel.engagement.meeting import meeting_points, place_on
from procmodel.engagement.segments import (
    Segments,
    advance,
    boxes,
    cross,
    distance_to,
    dot,
    end_directions,
    joined,
    left,
    lengths,
)
from procmodel.errors import InputError

# Of the extent of everything: points nearer to each other than this are one.
_SAME = 1e-9
# Of the extent: what may hang loose of a closed parallel curve.
_SLIVER = 1e-3
_MOVED, _AROUND = 0, 1


@dataclass(frozen=True)
class Origin:
    """Where the pieces of a parallel curve come from, so that they can be made again.

    Attributes
    ----------
    kind : ndarray, shape (m,), int
        0: a piece moved sideways; 1: an arc around the end of a piece.
    piece : ndarray, shape (m,), int
        The piece of the original.
    begin, length : ndarray, shape (m,) [mm]
        Which part of the moved piece was kept.
    following : ndarray, shape (m,), int
        The piece that goes on from each, -1 at the end of an open curve.
    """

    kind: np.ndarray
    piece: np.ndarray
    begin: np.ndarray
    length: np.ndarray
    following: np.ndarray


@dataclass(frozen=True)
class Parallel:
    """Curves at a distance from contours.

    Attributes
    ----------
    contours : list of Contour
        The curves, in the direction of the originals.
    origin : Origin
        Of their pieces, in the order of the contours.
    """

    contours: list[Contour]
    origin: Origin


def offset(contours: Sequence[Contour], distance: float) -> list[Contour]:
    """Curves at a distance from all of the contours.

    Parameters
    ----------
    contours : sequence of Contour
        Boundary of a region to the left of them.
    distance : float [mm]
        To the left when positive (the region shrinks), to the right when negative (it grows).

    Returns
    -------
    list of Contour
        What is exactly that far from the nearest point of the contours; empty where nothing is.

    Raises
    ------
    InputError
        If the curve cannot be closed, as may happen beside features of a billionth of the whole.
    """
    return parallel(contours, distance).contours


def parallel(contours: Sequence[Contour], distance: float) -> Parallel:
    """Curves at a distance, with the origin of their pieces; see `offset`."""
    if not contours or distance == 0.0:
        return _unmoved(contours)
    base = joined([c.segments.on_host() for c in contours])
    follows = _follows(contours)
    size = float(np.ptp(np.concatenate([base.start, base.end]), axis=0).max()) + abs(distance)
    same = _SAME * size
    raw, kind, piece, run = _moved_pieces(base, follows, distance, same)
    caps = [c for c in contours if not c.closed]
    owner, begin, end = _cut(raw, _caps(caps, abs(distance)), same)
    pieces = _parts(raw, owner, begin, end)
    kept = _far_enough(pieces, _runs(run[owner], begin, same), base, distance, same)
    kept &= ~_covered_twice(pieces, kept, same)
    # What is shorter than half the distance within which ends are joined is no piece of its own:
    # its direction is rounding, and at a vertex it would hide the turn.
    kept &= np.hypot(*(pieces.end - pieces.start).T) > 20.0 * same
    pieces, owner, begin, end = pieces[kept], owner[kept], begin[kept], end[kept]
    pairs = _neighbours(pieces, 40.0 * same)
    if not caps:
        pairs = _without_loose_ends(pairs, pieces, size)
    chains = _chains(len(pieces), *pairs, keep_open=bool(caps))
    span = lengths(pieces, np)
    # Beside open contours a loose end may be rounding, too.
    chains = [(c, closed) for c, closed in chains if closed or np.sum(span[c]) > 1000.0 * same]
    order = np.array([i for chain, _ in chains for i in chain], int)
    closings = [
        np.append(np.arange(1, len(chain)), 0 if closed else -len(chain))
        for chain, closed in chains
    ]
    first = np.cumsum([0, *(len(chain) for chain, _ in chains)])
    following = [np.where(c < 0, -1, c + f) for c, f in zip(closings, first, strict=False)]
    ordered = pieces[order]
    found = []
    for (chain, closed), f in zip(chains, first, strict=False):
        name = contours[0].name if len(contours) == 1 else "contour"
        found.append(from_segments(_snapped(ordered[f : f + len(chain)], closed), closed, name))
    origin = Origin(
        kind[owner[order]],
        piece[owner[order]],
        begin[order],
        end[order] - begin[order],
        np.concatenate([np.zeros(0, int), *following]),
    )
    return Parallel(found, origin)


def traced(base: Segments, origin: Origin, distance: Any) -> Segments:
    """The pieces of a parallel curve again, differentiable in the original and the distance.

    Parameters
    ----------
    base : Segments
        Pieces of the original contours, in their order.
    origin : Origin
        Of the pieces, from `parallel` of the same contours and nearly the same distance.
    distance : array_like [mm]
        As for `offset`.

    Returns
    -------
    Segments
        The pieces. The curves that carry them move with original and distance; where each begins
        and ends on its curve is held, which a crossing inside a piece does not notice.
    """
    source = base[origin.piece]
    around = jnp.asarray(origin.kind == _AROUND)
    end_point, end_direction = advance(
        source.start, source.direction, source.curvature, lengths(source)
    )
    anchor = jnp.where(around[:, None], end_point, source.start)
    direction = jnp.where(around[:, None], end_direction, source.direction)
    moved = anchor + distance * left(direction)
    bend = jnp.where(
        around, -1.0 / distance, source.curvature / (1.0 - source.curvature * distance)
    )
    start, heading = advance(moved, direction, bend, jnp.asarray(origin.begin))
    last, _ = advance(start, heading, bend, jnp.asarray(origin.length))
    goes_on = jnp.asarray(origin.following >= 0)[:, None]
    end = jnp.where(goes_on, start[origin.following], last)
    return Segments(start, end, heading, bend)


def _unmoved(contours: Sequence[Contour]) -> Parallel:
    base = joined([c.segments.on_host() for c in contours]) if contours else None
    count = 0 if base is None else len(base)
    length = np.zeros(0) if base is None else lengths(base, np)
    origin = Origin(
        np.zeros(count, int), np.arange(count), np.zeros(count), length, _follows(contours)
    )
    return Parallel(list(contours), origin)


def _follows(contours: Sequence[Contour]) -> np.ndarray:
    """Number of the piece after each, -1 after the last of an open contour."""
    following, first = [np.zeros(0, int)], 0
    for c in contours:
        count = len(c.bulges)
        after = np.arange(first + 1, first + count + 1)
        after[-1] = first if c.closed else -1
        following.append(after)
        first += count
    return np.concatenate(following)


def _moved_pieces(
    base: Segments, follows: np.ndarray, distance: float, same: float
) -> tuple[Segments, np.ndarray, np.ndarray, np.ndarray]:
    """Pieces moved sideways and arcs around vertices, in order; and where one touches the next."""
    heading = end_directions(base, np)
    stretch = 1.0 - base.curvature * distance
    reachable = stretch > 1e-9
    normal, end_normal = left(base.direction, np), left(heading, np)
    moved = Segments(
        base.start + distance * normal,
        base.end + distance * end_normal,
        base.direction,
        base.curvature / np.where(reachable, stretch, 1.0),
    )
    after = base[np.where(follows < 0, 0, follows)].direction
    turn = np.arctan2(cross(heading, after), dot(heading, after))
    smooth = np.abs(turn * distance) <= same
    opens = (follows >= 0) & (-np.sign(distance) * turn > 0.0) & ~smooth
    join = Segments(
        base.end + distance * end_normal,
        base.end + distance * left(after, np),
        heading,
        np.full(len(base), -1.0 / distance),
    )
    order = np.argsort(
        np.concatenate([2 * np.flatnonzero(reachable), 2 * np.flatnonzero(opens) + 1]),
        kind="stable",
    )
    kinds = np.repeat([_MOVED, _AROUND], [np.sum(reachable), np.sum(opens)])
    pieces = np.concatenate([np.flatnonzero(reachable), np.flatnonzero(opens)])
    raw = joined([moved[reachable], join[opens]])
    kind, piece = kinds[order], pieces[order]
    # Pieces of one run hang together: a gap or an overlap begins another.
    tight = smooth | opens
    before, here = piece[:-1], piece[1:]
    same_vertex = (kind[1:] == _AROUND) & (before == here)
    next_piece = (kind[1:] == _MOVED) & (follows[before] == here) & tight[before]
    return (
        raw[order],
        kind,
        piece,
        np.cumsum(np.append(False, ~(same_vertex | next_piece))[: len(order)]),
    )


def _caps(open_contours: Sequence[Contour], radius: float) -> Segments | None:
    """Circles around the ends of open contours; they cut, but are no part of the result."""
    if not open_contours:
        return None
    centres = np.concatenate([np.asarray(c.points)[[0, -1]] for c in open_contours])
    halves = []
    for sign in (1.0, -1.0):
        arm = np.array([sign * radius, 0.0])
        halves.append(
            Segments(
                centres + arm,
                centres - arm,
                np.tile([0.0, sign], (len(centres), 1)),
                np.full(len(centres), 1.0 / radius),
            )
        )
    return joined(halves)


def _cut(
    raw: Segments, caps: Segments | None, same: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut all pieces where they meet: the piece, begin and end of every part."""
    everything = raw if caps is None else joined([raw, caps])
    count, length = len(raw), lengths(everything, np)
    around = boxes(everything)
    shapes = box(*(around + same * np.array([-1, -1, 1, 1])).T)
    first, second = STRtree(shapes).query(shapes)
    pair = (first < second) & (first < count)
    first, second = first[pair], second[pair]
    owners, places = [np.zeros(0, int)], [np.zeros(0)]
    a, b = everything[first], everything[second]
    candidates = [*meeting_points(a, b), a.start, a.end, b.start, b.end]
    for point in candidates:
        on_a, on_b = (
            place_on(a, point, length[first], same),
            place_on(b, point, length[second], same),
        )
        meets = np.isfinite(on_a) & np.isfinite(on_b)
        for where, mine in ((on_a, first), (on_b, second)):
            real = meets & (mine < count)
            owners.append(mine[real])
            places.append(where[real])
    owner, place = np.concatenate(owners), np.concatenate(places)
    owner = np.concatenate([np.repeat(np.arange(count), 2), owner])
    ends = np.column_stack([np.zeros(count), length[:count]]).ravel()
    place = np.concatenate([ends, np.clip(place, 0.0, length[:count][owner[2 * count :]])])
    return _between(owner, place, length[:count], same)


def _between(
    owner: np.ndarray, place: np.ndarray, length: np.ndarray, same: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Parts between sorted places; places nearer than `same` are one, ends stay where they are."""
    order = np.lexsort((place, owner))
    owner, place = owner[order], place[order]
    # A meeting point is known to the root of rounding where two curves touch.
    near_end = np.minimum(place, length[owner] - place) <= 5.0 * same
    place = np.where(near_end, np.where(place < 0.5 * length[owner], 0.0, length[owner]), place)
    new = np.ones(len(place), bool)
    new[1:] = (owner[1:] != owner[:-1]) | (place[1:] - place[:-1] > 5.0 * same)
    owner, place = owner[new], place[new]
    inner = np.flatnonzero(owner[1:] == owner[:-1])
    return owner[inner], place[inner], place[inner + 1]


def _parts(raw: Segments, owner: np.ndarray, begin: np.ndarray, end: np.ndarray) -> Segments:
    chosen = raw[owner]
    start, direction = advance(chosen.start, chosen.direction, chosen.curvature, begin, np)
    stop, _ = advance(chosen.start, chosen.direction, chosen.curvature, end, np)
    whole_end = end >= lengths(chosen, np)
    start = np.where((begin == 0.0)[:, None], chosen.start, start)
    stop = np.where(whole_end[:, None], chosen.end, stop)
    return Segments(start, stop, direction, chosen.curvature)


def _runs(run: np.ndarray, begin: np.ndarray, same: float) -> np.ndarray:
    """Number the parts so that those which hang together without a cut share a number."""
    new = np.ones(len(run), bool)
    new[1:] = (begin[1:] > same) | (run[1:] != run[:-1])
    return np.cumsum(new) - 1


def _far_enough(
    pieces: Segments, runs: np.ndarray, base: Segments, distance: float, same: float
) -> np.ndarray:
    """Which parts keep the distance from everything; a run does as its longest part does."""
    if not len(runs):
        return np.zeros(0, bool)
    span = lengths(pieces, np)
    by_run = np.lexsort((-span, runs))
    spokesman = by_run[np.unique(runs[by_run], return_index=True)[1]]
    chosen = pieces[spokesman]
    middle, _ = advance(chosen.start, chosen.direction, chosen.curvature, 0.5 * span[spokesman], np)
    reach = abs(distance)
    found = STRtree(box(*boxes(base).T)).query(
        box(*np.column_stack([middle - reach, middle + reach]).T)
    )
    near = distance_to(base[found[1]], middle[found[0]], np)
    nearest = np.full(len(middle), np.inf)
    np.minimum.at(nearest, found[0], near)
    return (nearest >= reach - 100.0 * same)[runs]


def _covered_twice(pieces: Segments, kept: np.ndarray, same: float) -> np.ndarray:
    """Parts that lie on one another: both go when they run against each other, else one."""
    middle, direction = advance(
        pieces.start, pieces.direction, pieces.curvature, 0.5 * lengths(pieces, np), np
    )
    dropped = np.zeros(len(kept), bool)
    index = np.flatnonzero(kept)
    if len(index) < 2:
        return dropped
    at = middle[index]
    pad = np.column_stack([at - 20.0 * same, at + 20.0 * same])
    first, second = STRtree(box(*pad.T)).query(box(*pad.T))
    pair = first < second
    i, j = index[first[pair]], index[second[pair]]
    ends = np.minimum(
        np.hypot(*(pieces.start[i] - pieces.start[j]).T),
        np.hypot(*(pieces.start[i] - pieces.end[j]).T),
    )
    aligned = dot(direction[i], direction[j])
    twins = (ends <= 100.0 * same) & (np.abs(aligned) > 1.0 - 1e-6)
    dropped[j[twins]] = True
    dropped[i[twins & (aligned < 0.0)]] = True
    return dropped


def _neighbours(pieces: Segments, near: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of parts of which the second begins where the first ends, the best ones first."""
    if not len(pieces):
        return np.zeros(0, int), np.zeros(0, int)
    pad = np.column_stack([pieces.start - near, pieces.start + near])
    from_end, to = STRtree(box(*pad.T)).query(points_of(pieces.end))
    other = from_end != to
    from_end, to = from_end[other], to[other]
    gap = np.hypot(*(pieces.end[from_end] - pieces.start[to]).T)
    arriving = end_directions(pieces, np)[from_end]
    turn = np.arctan2(cross(arriving, pieces.direction[to]), dot(arriving, pieces.direction[to]))
    # Where several begin at one point, the one most to the left keeps loops apart.
    order = np.lexsort((-turn, gap > 0.5 * near, from_end))
    return from_end[order], to[order]


def _without_loose_ends(
    following: tuple[np.ndarray, np.ndarray], pieces: Segments, size: float
) -> tuple[np.ndarray, np.ndarray]:
    """Leave out parts that lead nowhere or come from nowhere: slivers that rounding kept."""
    from_end, to = following
    count = len(pieces)
    alive = np.ones(count, bool)
    while True:
        links = alive[from_end] & alive[to]
        goes_on, is_reached = np.zeros(count, bool), np.zeros(count, bool)
        goes_on[from_end[links]], is_reached[to[links]] = True, True
        still = alive & goes_on & is_reached
        if np.array_equal(still, alive):
            break
        alive = still
    loose = np.where(alive, 0.0, lengths(pieces, np))
    if count and loose.max() > _SLIVER * size:
        worst = int(np.argmax(loose))
        x, y = pieces.start[worst]
        raise InputError(
            f"the parallel curve does not close near ({x:.6g}, {y:.6g}), where {loose[worst]:.3g} "
            "mm of it hang loose: simplify the contour there, or change the distance a little."
        )
    return from_end[links], to[links]


def _chains(
    count: int, from_end: np.ndarray, to: np.ndarray, keep_open: bool
) -> list[tuple[list[int], bool]]:
    """Parts put end to end: their numbers in order, and whether the chain closes."""
    first = np.searchsorted(from_end, np.arange(count + 1))
    reached = np.zeros(count, bool)
    reached[to] = True
    unused = np.ones(count, bool)
    chains: list[tuple[list[int], bool]] = []
    # Open chains first, from where nothing arrives.
    for seed in [*np.flatnonzero(~reached), *range(count)]:
        if not unused[seed]:
            continue
        chain, here, closed = [], int(seed), False
        while True:
            chain.append(here)
            unused[here] = False
            going = to[first[here] : first[here + 1]]
            # Back where it began; whatever else begins there is another loop.
            closed = bool(np.any(going == seed))
            going = going[unused[going]]
            if closed or not len(going):
                break
            here = int(going[0])
        if (closed and len(chain) > 1) or (not closed and keep_open):
            chains.append((chain, closed))
    return chains


def _snapped(pieces: Segments, closed: bool) -> Segments:
    """Pieces whose ends are the starts of the next ones."""
    end = np.roll(pieces.start, -1, axis=0)
    if not closed:
        end[-1] = pieces.end[-1]
    return Segments(pieces.start, end, pieces.direction, pieces.curvature)
