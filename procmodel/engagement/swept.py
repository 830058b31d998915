"""Engagement with what discs have cleared: a law that is differentiable in where they were.

What a tool clears is the union of its discs at all places of its path. With nodes close together in
the place of all, a scallop stays between two neighbours (`scallop`), and the engagement becomes a
plain function of the nodes, whatever loops and corners their path has. Lengths in mm, angles in
rad.

Notation: o and t place and feed of the tool of radius r, the wall to the right; n the normal to the
wall, right of t; c a node of the previous tool of radius r2, e = c - o.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from procmodel.engagement.segments import cross, dot

# The steepest slope of the arc cosine that is let through is the inverse root of twice this.
_TOUCHING = 1e-15


def swept_angle(
    centre: ArrayLike,
    direction: ArrayLike,
    discs: ArrayLike,
    radius: ArrayLike,
    previous_radius: ArrayLike,
) -> Array:
    """Engagement angle where discs have been cleared.

    Parameters
    ----------
    centre, direction : array_like, shape (..., 2) [mm, -]
        Tool centre o and unit feed direction t, the wall to the right.
    discs : array_like, shape (..., k, 2) [mm]
        Centres of the discs that may end the engaged arc.
    radius, previous_radius : array_like [mm]
        Radius r of the tool, and r2 of the discs.

    Returns
    -------
    Array, shape (...) [rad]
        Angle of the arc that is engaged at the wall; pi where no disc meets the leading half, and
        below 0 where a disc reaches over the flank at the wall, by as much as it does.

    Notes
    -----
    A disc covers the rim up to gamma to both sides of e, with
    cos(gamma) = (r^2 + |e|^2 - r2^2) / (2 r |e|); the engaged arc goes from n counter-clockwise to
    the first direction that is covered. The minimum over the discs is the plain one: it is exact
    for the union, whereas a soft one of temperature T is off by up to T log(k), and a thousandth of
    the angle is what counts here. Its gradient is that of the one disc which ends the arc.
    """
    o, t, c = jnp.asarray(centre), jnp.asarray(direction), jnp.asarray(discs)
    r, r2 = jnp.asarray(radius), jnp.asarray(previous_radius)
    e = c - o[..., None, :]
    squared = dot(e, e)
    meets = (squared > (r - r2) ** 2) & (squared < (r + r2) ** 2)
    # Where the circles do not cross, a vector for which they would keeps the gradient finite.
    e = jnp.where(meets[..., None], e, t[..., None, :])
    squared = jnp.where(meets, squared, 1.0)
    distance = jnp.sqrt(squared)
    cosine = jnp.where(meets, (r**2 + squared - r2**2) / (2.0 * r * distance), 0.0)
    gamma = jnp.arccos(jnp.clip(cosine, -1.0 + _TOUCHING, 1.0 - _TOUCHING))
    ahead = t[..., None, :]
    # From n, which is a right angle behind t.
    middle = 0.5 * jnp.pi + jnp.arctan2(cross(ahead, e), dot(ahead, e))
    # Discs that cover only what lies clockwise of n count as a turn farther on.
    begin = jnp.mod(middle + gamma, 2.0 * jnp.pi) - 2.0 * gamma
    # Without a crossing a disc covers the whole rim or nothing of it.
    apart = jax.lax.stop_gradient(dot(c - o[..., None, :], c - o[..., None, :]))
    whole = (r2 >= r) & (apart <= (r2 - r) ** 2)
    begin = jnp.where(meets, begin, jnp.where(whole, 0.0, jnp.pi))
    return jnp.minimum(jnp.min(begin, axis=-1), jnp.pi)


def scallop(spacing: ArrayLike, previous_radius: ArrayLike, curvature: ArrayLike = 0.0) -> Array:
    """Height of the stock that stays between two neighbouring discs.

    Parameters
    ----------
    spacing : array_like [mm]
        Distance h of the nodes.
    previous_radius : array_like [mm]
        Radius r2 of the discs.
    curvature : array_like [1/mm]
        Curvature k of their path, positive where it turns away from the wall.

    Returns
    -------
    Array [mm]
        h^2 / 8 (1 / r2 + k), to the second power of h.
    """
    h = jnp.asarray(spacing)
    return h**2 / 8.0 * (1.0 / jnp.asarray(previous_radius) + jnp.asarray(curvature))
