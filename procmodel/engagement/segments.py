"""Lines and arcs in one form: a start, a direction there, a curvature, an end.

A line is an arc of curvature 0, and every formula holds for both. Points on the curve that
carries a segment are the zeros of f(x) = kappa |q|^2 / 2 - n . q with q = x - start and n the left
normal of the direction at the start; f < 0 to the left of it (near it). Lengths in mm, angles in
rad.

The functions take the array module they work with, `jax.numpy` where derivatives are wanted,
`numpy` in the searches that have none.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np


class Segments(eqx.Module):
    """Lines and arcs, none of them longer than a half circle.

    Attributes
    ----------
    start, end : Array, shape (n, 2) [mm]
        End points.
    direction : Array, shape (n, 2)
        Unit tangent at the start.
    curvature : Array, shape (n,) [1/mm]
        Positive where the segment turns left, 0 on a line.
    """

    start: Any
    end: Any
    direction: Any
    curvature: Any

    def __len__(self) -> int:
        return self.start.shape[-2]

    def __getitem__(self, index: Any) -> "Segments":
        return Segments(
            self.start[index], self.end[index], self.direction[index], self.curvature[index]
        )

    def on_host(self) -> "Segments":
        """The same with NumPy arrays."""
        return Segments(*(np.asarray(field) for field in self.fields))

    @property
    def fields(self) -> tuple[Any, Any, Any, Any]:
        """Start, end, direction and curvature."""
        return self.start, self.end, self.direction, self.curvature


def left(vector: Any, xp: Any = jnp) -> Any:
    """Vectors turned by a right angle to the left, shape (..., 2)."""
    return xp.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def turned(vector: Any, angle: Any, xp: Any = jnp) -> Any:
    """Vectors turned to the left by an angle [rad], shape (..., 2)."""
    return vector * xp.cos(angle)[..., None] + left(vector, xp) * xp.sin(angle)[..., None]


def cross(a: Any, b: Any) -> Any:
    """Cross product of plane vectors, positive where b lies to the left of a."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def dot(a: Any, b: Any) -> Any:
    """Scalar product of plane vectors."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def advance(start: Any, direction: Any, curvature: Any, length: Any, xp: Any = jnp) -> Any:
    """Point and direction after a way along lines and arcs.

    Parameters
    ----------
    start, direction : array, shape (..., 2) [mm, -]
        Where the way begins, and its unit tangent there.
    curvature : array, shape (...) [1/mm]
        Of the way.
    length : array, shape (...) [mm]
        Of the way, negative for backwards.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    point, direction : array, shape (..., 2)
        At its end.
    """
    half = 0.5 * curvature * length
    chord = (length * xp.sinc(half / np.pi))[..., None] * turned(direction, half, xp)
    return start + chord, turned(direction, 2.0 * half, xp)


def half_sweeps(segments: Segments, xp: Any = jnp) -> Any:
    """Half the angle by which every segment turns, shape (n,) [rad]."""
    chord = segments.end - segments.start
    return xp.arctan2(cross(segments.direction, chord), dot(segments.direction, chord))


def lengths(segments: Segments, xp: Any = jnp) -> Any:
    """Arc length of every segment, shape (n,) [mm]."""
    chord = segments.end - segments.start
    return xp.sqrt(dot(chord, chord)) / xp.sinc(half_sweeps(segments, xp) / np.pi)


def end_directions(segments: Segments, xp: Any = jnp) -> Any:
    """Unit tangent at the end of every segment, shape (n, 2)."""
    return turned(segments.direction, 2.0 * half_sweeps(segments, xp), xp)


def place_along(segments: Segments, point: Any, xp: Any = jnp) -> Any:
    """Arc length at which the curve of a segment comes nearest to a point.

    Parameters
    ----------
    segments : Segments, n of them
        The segments.
    point : array, shape (n, 2) [mm]
        One point for each.
    xp : module
        `jax.numpy` or `numpy`.

    Returns
    -------
    array, shape (n,) [mm]
        From the start; below 0 or beyond the length where the nearest point is not on the segment.
    """
    q = point - segments.start
    kappa = segments.curvature
    straight = kappa == 0.0
    across = dot(left(segments.direction, xp), q)
    angle = xp.arctan2(kappa * dot(segments.direction, q), 1.0 - kappa * across)
    bent = angle / xp.where(straight, 1.0, kappa)
    return xp.where(straight, dot(segments.direction, q), bent)


def distance_to(segments: Segments, point: Any, xp: Any = jnp) -> Any:
    """Distance of points from segments, one of each, shape (n,) [mm]."""
    q, to_end = point - segments.start, point - segments.end
    kappa, normal = segments.curvature, left(segments.direction, xp)
    level = 0.5 * kappa * dot(q, q) - dot(normal, q)
    # |grad f|: the distance from the curve's centre over its radius, 0 at the centre itself.
    steepness = _root(1.0 + 2.0 * kappa * level, xp)
    off = 2.0 * level / (1.0 + steepness)
    slope = (kappa[..., None] * q - normal) / xp.where(steepness > 0.0, steepness, 1.0)[..., None]
    foot = q - off[..., None] * slope
    chord = segments.end - segments.start
    beside = (dot(foot, chord) >= 0.0) & (dot(foot, chord) <= dot(chord, chord))
    # Of a line with a curvature of rounding, the foot is on its chord to rounding.
    beside &= cross(chord, foot) * xp.sign(kappa) <= 1e-9 * dot(chord, chord)
    ends = _root(xp.minimum(dot(q, q), dot(to_end, to_end)), xp)
    return xp.where(beside, xp.minimum(xp.abs(off), ends), ends)


def _root(x: Any, xp: Any) -> Any:
    """Square root, 0 with gradient 0 where there is none."""
    inside = x > 0.0
    return xp.where(inside, xp.sqrt(xp.where(inside, x, 1.0)), 0.0)


def joined(parts: list[Segments], xp: Any = np) -> Segments:
    """Several sets of segments as one."""
    return Segments(*(xp.concatenate(c) for c in zip(*(p.fields for p in parts), strict=True)))


def boxes(segments: Segments) -> np.ndarray:
    """Box around every segment, shape (n, 4) [mm]: x and y from, x and y to; never too small."""
    start, end, _, _ = segments.fields
    half = half_sweeps(segments, np)
    # The rise of an arc over its chord, to either side: simple, and at most twice too wide.
    rise = 0.5 * np.hypot(*(end - start).T) * np.abs(np.tan(0.5 * half))
    low, high = np.minimum(start, end), np.maximum(start, end)
    return np.column_stack([low - rise[:, None], high + rise[:, None]])
