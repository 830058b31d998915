"""Where the rim of the tool meets the stock: every crossing, exact on lines and arcs.

Angles phi on the leading half circle count from the flank that is turned away from the wall
(phi = 0) over the feed direction (pi / 2) to the flank at the wall (pi). Between two crossings the
rim is either in the stock or not, so sums over the crossings, in any order, give what an integral
over the rim would:

    total angle   I0 pi + sum s (pi - phi)
    swept width   r (2 I0 + sum s (1 + cos(phi)))

with I0 whether the rim is in the stock at phi = 0, and s = +1 where it goes in, -1 where it comes
out. Lengths in mm, angles in rad.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from procmodel.engagement.segments import Segments, cross, distance_to, dot, left
from procmodel.numerics import safe_sqrt

ARCS_KEPT = 3
# Of the radius: a crossing this near to a segment's end may lie on either side of it.
_AT_END = 1e-9


class Contact(NamedTuple):
    """What the leading half of the rim meets, at one place or many.

    Attributes
    ----------
    angle : Array, shape (...) [rad]
        Engagement angle: of the engaged arc that ends at the wall; 0 where there is none.
    depth_ratio : Array, shape (...)
        c = 1 - cos(angle), continued: below 0 by the gap between flank and stock over the radius,
        beyond 2 by the depth of the other flank in the stock.
    total : Array, shape (...) [rad]
        All engaged arcs together.
    area_rate : Array, shape (...) [mm]
        Area cut per length of travel.
    arcs : Array, shape (..., ARCS_KEPT, 2) [rad]
        From where to where each engaged arc goes, in order; (pi, pi) where there is none.
    arc_count : Array of int, shape (...)
        Number of engaged arcs.
    at_wall : Array of bool, shape (...)
        Whether the flank at the wall is in the stock.
    crossings : Array of int, shape (...)
        Of the whole rim with the surface.
    """

    angle: Array
    depth_ratio: Array
    total: Array
    area_rate: Array
    arcs: Array
    arc_count: Array
    at_wall: Array
    crossings: Array


def contact(
    centre: ArrayLike,
    direction: ArrayLike,
    radius: ArrayLike,
    segments: Segments,
    present: ArrayLike,
) -> Contact:
    """What the leading half of the rim meets, the wall being to the right.

    Parameters
    ----------
    centre : array_like, shape (..., 2) [mm]
        Tool centre.
    direction : array_like, shape (..., 2)
        Unit feed direction.
    radius : array_like [mm]
        Tool radius.
    segments : Segments, with fields of shape (..., k, 2) or (..., k)
        Pieces of the stock's boundary that may meet the rim, free side to the left.
    present : array_like of bool, shape (..., k)
        Which of them are there; others fill up the shape.

    Returns
    -------
    Contact
        Differentiable in centre, direction, radius and segments but where the rim passes a vertex
        or just touches.
    """
    o, t, r = jnp.asarray(centre), jnp.asarray(direction), jnp.asarray(radius)
    there = jnp.asarray(present)
    side = left(t)
    entering, leaving, goes_in, comes_out = _crossings(o, r, segments, there)
    # Seen along growing phi, which turns to the right, the rim leaves the stock where the boundary
    # enters the circle, and enters it where the boundary leaves.
    point = jnp.concatenate([leaving, entering], axis=-2)
    real = jnp.concatenate([comes_out, goes_in], axis=-1)
    sign = jnp.concatenate([jnp.ones_like(comes_out, float), -jnp.ones_like(goes_in, float)], -1)
    across, ahead = dot(point, side[..., None, :]), dot(point, t[..., None, :])
    phi = jnp.arctan2(ahead, across)
    phi = jnp.where(phi < 0.0, phi + 2.0 * jnp.pi, phi)
    first = jnp.argmin(jnp.where(real, phi, jnp.inf), axis=-1)
    sign_of_first = jnp.take_along_axis(sign, first[..., None], axis=-1)[..., 0]
    crossings = jnp.sum(real, axis=-1)
    flank = o + r * side
    begins_in = jnp.where(crossings > 0, sign_of_first < 0.0, _in_stock(flank, segments, there))
    inside_first = begins_in.astype(phi.dtype)

    leads = real & (ahead >= 0.0)
    weight = jnp.where(leads, sign, 0.0)
    at_wall = inside_first + jnp.sum(weight, axis=-1) > 0.5
    kept = jnp.where(leads, phi, 0.0)
    last = jnp.argmax(kept, axis=-1)
    any_leads = jnp.any(leads, axis=-1)
    last_across = jnp.take_along_axis(across, last[..., None], axis=-1)[..., 0]
    last_phi = jnp.take_along_axis(kept, last[..., None], axis=-1)[..., 0]
    full = at_wall & ~any_leads
    angle = jnp.where(at_wall, jnp.pi - last_phi, 0.0)
    ratio = jnp.where(
        at_wall,
        jnp.where(any_leads, 1.0 + last_across, 2.0 + _gap(flank, segments, there) / r),
        -_gap(o - r * side, segments, there) / r,
    )
    starts = jnp.where(leads & (sign > 0.0), phi, jnp.pi)
    exits = jnp.where(leads & (sign < 0.0), phi, jnp.pi)
    zero = jnp.where(begins_in, 0.0, jnp.pi)[..., None]
    starts = jnp.sort(jnp.concatenate([zero, starts], -1), -1)[..., :ARCS_KEPT]
    exits = jnp.sort(jnp.concatenate([jnp.full_like(zero, jnp.pi), exits], -1), -1)[..., :ARCS_KEPT]
    return Contact(
        jnp.where(full, jnp.pi, angle),
        ratio,
        inside_first * jnp.pi + jnp.sum(weight * (jnp.pi - kept), axis=-1),
        r * (2.0 * inside_first + jnp.sum(weight * (1.0 + across), axis=-1)),
        jnp.stack([starts, exits], axis=-1),
        begins_in.astype(int) + jnp.sum(leads & (sign > 0.0), axis=-1),
        at_wall,
        crossings,
    )


def _crossings(
    centre: Array, radius: Array, segments: Segments, present: Array
) -> tuple[Array, Array, Array, Array]:
    """Unit vectors to where each segment enters and leaves the circle, and whether it does.

    A segment whose ends lie on different sides of the circle crosses it once, whatever rounding
    says of the crossing itself: so the crossings of a closed boundary always come in pairs.
    """
    kappa, normal = segments.curvature, left(segments.direction)
    w = centre[..., None, :] - segments.start
    to_end = centre[..., None, :] - segments.end
    squared = dot(w, w)
    level = 0.5 * kappa * (squared + radius**2) - dot(normal, w)
    slope = radius * (kappa[..., None] * w - normal)
    steepness = dot(slope, slope)
    steepness = jnp.where(steepness > 0.0, steepness, 1.0)
    root = safe_sqrt(steepness - level**2)[..., None]
    base, swing = -level[..., None] * slope, root * left(slope)
    entering, leaving = (
        (base - swing) / steepness[..., None],
        (base + swing) / steepness[..., None],
    )
    out_first = squared >= radius**2
    out_last = dot(to_end, to_end) >= radius**2
    same = out_first == out_last
    both = (
        same
        & (steepness > level**2)
        & _on_segment(w + radius * entering, segments, radius)
        & _on_segment(w + radius * leaving, segments, radius)
    )
    goes_in = present & ((out_first & ~out_last) | both)
    comes_out = present & ((~out_first & out_last) | both)
    return entering, leaving, goes_in, comes_out


def _on_segment(q: Array, segments: Segments, radius: Array) -> Array:
    """Whether points of a segment's curve, seen from its start, lie between its ends."""
    chord = segments.end - segments.start
    span = jnp.sqrt(dot(chord, chord))
    span = jnp.where(span > 0.0, span, 1.0)
    slack = _AT_END * radius
    along = dot(q, chord) / span
    above = cross(chord, q) / span * jnp.sign(segments.curvature)
    return (along >= -slack) & (along <= span + slack) & (above <= slack)


def _gap(point: Array, segments: Segments, present: Array) -> Array:
    """Distance of points from the nearest of the segments that are there."""
    reach = distance_to(segments, point[..., None, :])
    return jnp.min(jnp.where(present, reach, _FAR), axis=-1, initial=_FAR)


def _in_stock(point: Array, segments: Segments, present: Array) -> Array:
    """Whether points lie on the stock's side of the nearest segment; far from all: no."""
    if segments.curvature.shape[-1] == 0:
        return jnp.zeros(point.shape[:-1], bool)
    q = jax.lax.stop_gradient(point)[..., None, :] - segments.start
    distance = jnp.where(present, distance_to(segments, point[..., None, :]), _FAR)
    nearest = jnp.min(distance, axis=-1, keepdims=True)
    # At a shared vertex both neighbours are nearest: the one seen less along itself tells the side.
    level = 0.5 * segments.curvature * dot(q, q) - dot(left(segments.direction), q)
    ties = distance <= nearest * (1.0 + 1e-9) + 1e-12
    chosen = jnp.argmax(jnp.where(ties, jnp.abs(level), -1.0), axis=-1, keepdims=True)
    side = jnp.take_along_axis(level, chosen, axis=-1)[..., 0]
    return (side > 0.0) & (nearest[..., 0] < _FAR)


_FAR = 1e6
