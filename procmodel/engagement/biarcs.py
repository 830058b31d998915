"""Points with tangents joined by pairs of arcs, and chains of many arcs made into few.

Lengths in mm, angles in rad.
"""

import numpy as np

from procmodel.engagement.contour import Contour, from_segments
from procmodel.engagement.segments import Segments, advance, cross, dot, end_directions, lengths

# Of the whole length: nodes nearer to each other are one.
_SAME = 1e-11


def through(points: np.ndarray, directions: np.ndarray, closed: bool, name: str) -> Contour:
    """Smooth contour of two arcs from each point to the next.

    Parameters
    ----------
    points : ndarray, shape (n, 2) [mm]
        Where it goes through.
    directions : ndarray, shape (n, 2)
        Unit tangents there.
    closed : bool
        Whether it returns from the last point to the first.
    name : str
        Name of the contour.

    Returns
    -------
    Contour
        Off a smooth curve by the third power of the distance between the points, in direction by
        the second.
    """
    following = np.roll(points, -1, axis=0)
    step = np.hypot(*(following - points).T)
    if not closed:
        step[-1] = np.inf
    kept = step > _SAME * float(np.sum(step[np.isfinite(step)]))
    if not closed:
        kept[-1] = True
    points, directions = points[kept], directions[kept]
    p1, t1 = np.roll(points, -1, axis=0), np.roll(directions, -1, axis=0)
    count = len(points) if closed else len(points) - 1
    pieces = _pairs(points[:count], directions[:count], p1[:count], t1[:count])
    return from_segments(pieces, closed, name)


def simplified(path: Contour, tolerance: float) -> Contour:
    """A smooth contour with fewer arcs, near to the given one.

    Parameters
    ----------
    path : Contour
        Many pieces; vertices where it turns sharply are kept.
    tolerance : float [mm]
        Greatest distance from it, checked at its vertices and seven places between them.

    Returns
    -------
    Contour
        Pairs of arcs, each as long as the tolerance allows; lines where they are straight.
    """
    pieces = path.segments.on_host()
    heading = end_directions(pieces, np)
    nodes = np.concatenate([pieces.start, pieces.end[-1:]])
    arriving = np.concatenate([heading[-1:] if path.closed else pieces.direction[:1], heading])
    leaving = np.concatenate(
        [pieces.direction, pieces.direction[:1] if path.closed else heading[-1:]]
    )
    within = np.arange(1, 8) / 8.0
    inner, _ = advance(
        pieces.start[:, None],
        pieces.direction[:, None],
        pieces.curvature[:, None],
        lengths(pieces, np)[:, None] * within,
        np,
    )
    sharp = np.abs(np.arctan2(cross(arriving, leaving), dot(arriving, leaving))) > 1e-6
    found, here, last = [], 0, len(pieces)
    reach = 1
    while here < last:
        stop = here + 1 + int(np.argmax(np.append(sharp[here + 1 : last], True)))

        def joint(to: int, start: int = here) -> Segments | None:
            pair = _pairs(
                nodes[start : start + 1], leaving[start : start + 1],
                nodes[to : to + 1], arriving[to : to + 1],
            )  # fmt: skip
            between = np.concatenate([nodes[start + 1 : to], inner[start:to].reshape(-1, 2)])
            return pair if _within(pair, between, tolerance) else None

        if stop == here + 1:
            found.append(pieces[here : here + 1])
            here = stop
            continue
        # Grow while it fits, then halve the rest.
        good, best = here + 1, pieces[here : here + 1]
        bad, reach = stop + 1, max(reach, 2)
        while bad - good > 1:
            to = min(good + reach, bad - 1, stop)
            pair = joint(to)
            if pair is None:
                bad, reach = to, max(1, (to - good) // 2)
            else:
                good, best, reach = to, pair, 2 * reach
            if good == stop:
                break
            reach = min(reach, max(1, bad - good - 1))
        found.append(best)
        reach, here = max(2, good - here), good
    whole = Segments(*(np.concatenate(f) for f in zip(*(p.fields for p in found), strict=True)))
    return from_segments(whole, path.closed, path.name)


def _pairs(p0: np.ndarray, t0: np.ndarray, p1: np.ndarray, t1: np.ndarray) -> Segments:
    """Two arcs of equal arms from every point to the next, one after the other."""
    chord = p1 - p0
    along, squared = dot(chord, t0 + t1), dot(chord, chord)
    bend = 2.0 * (1.0 - dot(t0, t1))
    arm = (squared / (along + np.sqrt(along**2 + bend * squared)))[:, None]
    joint = 0.5 * (p0 + p1) + 0.5 * arm * (t0 - t1)
    first = _arc(p0, t0, joint)
    second = _arc(joint, end_directions(first, np), p1)
    both = [
        np.stack([a, b], axis=1).reshape(-1, *a.shape[1:])
        for a, b in zip(first.fields, second.fields, strict=True)
    ]
    return Segments(*both)


def _arc(start: np.ndarray, direction: np.ndarray, end: np.ndarray) -> Segments:
    chord = end - start
    return Segments(start, end, direction, 2.0 * cross(direction, chord) / dot(chord, chord))


def _within(pair: Segments, points: np.ndarray, tolerance: float) -> bool:
    """Whether points lie near to one of two arcs that follow each other."""
    if np.any(np.abs(lengths(pair, np) * pair.curvature) > 0.5 * np.pi):
        return False
    along = pair.end - pair.start
    second = dot(along[1], points - pair.start[1]) > 0.0
    kappa = pair.curvature[second.astype(int)]
    q = points - pair.start[second.astype(int)]
    direction = pair.direction[second.astype(int)]
    level = 0.5 * kappa * dot(q, q) - cross(direction, q)
    off = 2.0 * level / (1.0 + np.sqrt(np.maximum(1.0 + 2.0 * kappa * level, 0.0)))
    return bool(np.all(np.abs(off) <= tolerance))
