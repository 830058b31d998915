"""Where lines and arcs meet, one pair of segments each; NumPy alone. Lengths in mm."""

import numpy as np

from procmodel.engagement.segments import Segments, advance, dot, left, place_along


def meeting_points(a: Segments, b: Segments) -> list[np.ndarray]:
    """Where the curves of two sets of segments meet, one of each, as NumPy.

    Parameters
    ----------
    a, b : Segments, n of them each
        The segments.

    Returns
    -------
    list of two ndarray, shape (n, 2) [mm]
        The points; NaN where the curves do not meet.
    """
    # The one that bends more takes the quadratic equation: the other may be a line.
    swap = np.abs(a.curvature) > np.abs(b.curvature)
    one = Segments(*(_chosen(swap, y, x) for x, y in zip(a.fields, b.fields, strict=True)))
    two = Segments(*(_chosen(swap, x, y) for x, y in zip(a.fields, b.fields, strict=True)))
    base, k1, k2 = one.start, one.curvature, two.curvature
    n1, n2, e = left(one.direction, np), left(two.direction, np), two.start - one.start
    both_lines = k2 == 0.0
    # k2 f1 - k1 f2 is linear; of two lines, the first itself.
    m = -k2[:, None] * n1 + k1[:, None] * (k2[:, None] * e + n2)
    h = k1 * (0.5 * k2 * dot(e, e) + dot(n2, e))
    m = np.where(both_lines[:, None], -n1, m)
    h = np.where(both_lines, 0.0, h)
    norm = np.hypot(*m.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        foot = m * (h / norm**2)[:, None]
        along = left(m, np) / norm[:, None]
        to = foot - e
        qa = 0.5 * k2
        qb = k2 * dot(to, along) - dot(n2, along)
        qc = 0.5 * k2 * dot(to, to) - dot(n2, to)
        disc = qb**2 - 4.0 * qa * qc
        # Curves that just touch may miss each other by rounding.
        touching = (disc < 0.0) & (disc > -1e-12 * qb**2 - 1e-15)
        root = np.sqrt(np.where(touching, 0.0, disc))
        big = -0.5 * (qb + np.where(qb >= 0.0, root, -root))
        t1, t2 = qc / big, big / qa
        t2 = np.where(both_lines, np.nan, t2)
        return [base + foot + t[:, None] * along for t in (t1, t2)]


def place_on(segments: Segments, point: np.ndarray, length: np.ndarray, same: float) -> np.ndarray:
    """Arc length of points on segments, NaN where a point is not on its segment, shape (n,)."""
    with np.errstate(invalid="ignore"):
        along = place_along(segments, point, np)
        bent = segments.curvature != 0.0
        circle = 2.0 * np.pi / np.abs(np.where(bent, segments.curvature, 1.0))
        along = np.where(bent & (along < -same), along + circle, along)
        foot, _ = advance(segments.start, segments.direction, segments.curvature, along, np)
        gap = np.hypot(*(foot - point).T)
        # Where two curves touch, the meeting point is off by the root of rounding.
        near = (gap <= 10.0 * same) & (along >= -10.0 * same) & (along <= length + 10.0 * same)
    return np.where(near, along, np.nan)


def _chosen(first: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.where(first.reshape(-1, *([1] * (a.ndim - 1))), a, b)
