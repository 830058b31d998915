"""The engagement angle of an end mill in closed form: lines, arcs, the way from one to the other.

The engagement angle is measured at the tool's centre, on its leading half circle, from 0 (air) to
pi (slot). Lengths in mm, angles in rad. Every function works on scalars and on arrays, and is
differentiable in every argument.

Notation: r tool radius, a_e radial depth, alpha engagement angle, kappa curvature of the finished
wall (> 0 in a concave corner of a pocket, < 0 on a convex boss), R_p = 1 / |kappa|,
c = 1 - cos(alpha).

References
----------
.. [1] S. Ibaraki, I. Ikeda, A. Yamaji, Y. Kakino, S. Nishida, contour-parallel paths of constant
   engagement (in Japanese).
.. [2] M. S. Uddin, S. Ibaraki, A. Matsubara, S. Nishida, Y. Kakino, JSME Int. J. C 49(1), 43,
   2006.
"""

import math

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from procmodel.errors import InputError
from procmodel.numerics import safe_sqrt

ENGAGED, AIR, SLOT, CORNER_TOO_SMALL, MULTIPLE, DETACHED = range(6)

STATUS = {
    ENGAGED: "engaged",
    AIR: "air: the tool does not reach the stock",
    SLOT: "slot: the whole leading half of the tool is engaged",
    CORNER_TOO_SMALL: "corner too small: the tool does not fit into the wall's curvature",
    MULTIPLE: "multiple: several arcs are engaged, and the angle is of the one at the wall",
    DETACHED: "detached: the tool cuts, but nothing at the wall",
}


def engagement_angle_constant_curvature(
    radial_depth: ArrayLike, radius: ArrayLike, curvature: ArrayLike
) -> Array:
    """Engagement angle along a wall of constant curvature, the previous pass being parallel.

    Parameters
    ----------
    radial_depth : array_like [mm]
        Radial depth a_e of the stock over the finished wall.
    radius : array_like [mm]
        Tool radius r.
    curvature : array_like [1/mm]
        Curvature kappa of the finished wall: positive in a concave corner, 0 on a line, negative
        on a convex boss.

    Returns
    -------
    Array [rad]
        alpha with cos(alpha) = 1 - a_e (2 - kappa a_e) / (2 r (1 - kappa r)); 0 in air, and pi
        from a full slot on and where the tool does not fit (kappa r >= 1). Which of these it is,
        `engagement_status` says.
    """
    return _angle_of(_depth_ratio(radial_depth, radius, curvature))


def engagement_status(radial_depth: ArrayLike, radius: ArrayLike, curvature: ArrayLike) -> Array:
    """What the tool meets along a wall of constant curvature.

    Parameters
    ----------
    radial_depth, radius, curvature : array_like [mm, mm, 1/mm]
        As for `engagement_angle_constant_curvature`.

    Returns
    -------
    Array of int
        Key into `STATUS`.
    """
    ratio = _depth_ratio(radial_depth, radius, curvature)
    fits = jnp.asarray(curvature) * jnp.asarray(radius) < 1.0
    inside = jnp.select([ratio <= 0.0, ratio >= 2.0], [AIR, SLOT], ENGAGED)
    return jnp.where(fits, inside, CORNER_TOO_SMALL)


def radial_depth_for_angle(angle: ArrayLike, radius: ArrayLike, curvature: ArrayLike) -> Array:
    """Radial depth that gives an engagement angle along a wall of constant curvature.

    Parameters
    ----------
    angle : array_like [rad]
        Wanted engagement angle alpha, 0 to pi.
    radius : array_like [mm]
        Tool radius r.
    curvature : array_like [1/mm]
        Curvature kappa of the finished wall, kappa r < 1.

    Returns
    -------
    Array [mm]
        a_e, the smaller root of kappa a_e^2 - 2 a_e + 2 r (1 - kappa r) (1 - cos(alpha)) = 0.
    """
    kappa, r = jnp.asarray(curvature), jnp.asarray(radius)
    # 1 - cos as a square keeps its digits at small angles.
    ratio = 2.0 * jnp.sin(0.5 * jnp.asarray(angle)) ** 2
    twice = 2.0 * r * (1.0 - kappa * r) * ratio
    return twice / (1.0 + safe_sqrt(1.0 - kappa * twice))


def engagement_angle_entering_arc(
    distance: ArrayLike, radial_depth: ArrayLike, radius: ArrayLike, wall_radius: ArrayLike
) -> Array:
    """Engagement angle on a straight path that leads tangentially into a concave arc.

    Parameters
    ----------
    distance : array_like [mm]
        Distance s of the tool's centre before the tangent point, >= 0.
    radial_depth : array_like [mm]
        Radial depth a_e.
    radius : array_like [mm]
        Tool radius r.
    wall_radius : array_like [mm]
        Radius R_p of the finished concave wall, > r.

    Returns
    -------
    Array [rad]
        That of the line for s >= r sin(alpha_0); then
        pi/2 + atan2(R_p - r, s) - acos((T^2 + r^2 - (R_p - a_e)^2) / (2 T r)) with
        T = hypot(s, R_p - r).
    """
    s, r = jnp.asarray(distance), jnp.asarray(radius)
    on_line = engagement_angle_constant_curvature(radial_depth, r, 0.0)
    path_radius = jnp.asarray(wall_radius) - r
    stock_radius = jnp.asarray(wall_radius) - jnp.asarray(radial_depth)
    before = s >= r * jnp.sin(on_line)
    # On the branch not taken the crossing does not exist: there the tangent point stands in.
    near = jnp.where(before, 0.0, s)
    reach = jnp.hypot(near, path_radius)
    cosine = (reach**2 + r**2 - stock_radius**2) / (2.0 * reach * r)
    crossing = _angle_of(1.0 - cosine)
    return jnp.where(before, on_line, 0.5 * jnp.pi + jnp.arctan2(path_radius, near) - crossing)


def sharp_corner_angle(
    interior_angle: ArrayLike, radial_depth: ArrayLike, radius: ArrayLike
) -> Array:
    """Greatest engagement angle of a path that turns sharply.

    Parameters
    ----------
    interior_angle : array_like [rad]
        Angle between the two straight parts of the path, 0 to pi.
    radial_depth : array_like [mm]
        Radial depth a_e.
    radius : array_like [mm]
        Tool radius r.

    Returns
    -------
    Array [rad]
        min(pi, pi - interior angle + alpha on the line).
    """
    on_line = engagement_angle_constant_curvature(radial_depth, radius, 0.0)
    return jnp.minimum(jnp.pi, jnp.pi - jnp.asarray(interior_angle) + on_line)


def area_rate(start: ArrayLike, exit: ArrayLike, radius: ArrayLike) -> Array:
    """Area of stock cut per length of travel.

    Parameters
    ----------
    start, exit : array_like [rad]
        Where the engaged arc begins and ends, from the direction across the path.
    radius : array_like [mm]
        Tool radius r.

    Returns
    -------
    Array [mm]
        r (cos(start) - cos(exit)), eq. of the swept width; r (1 - cos(alpha)) only where the arc
        begins at the flank.
    """
    return jnp.asarray(radius) * (jnp.cos(jnp.asarray(start)) - jnp.cos(jnp.asarray(exit)))


def surface_kink(angle: ArrayLike, radius: ArrayLike, path_curvature: ArrayLike) -> Array:
    """Turn of the surface of constant engagement where the path's curvature jumps from 0.

    Parameters
    ----------
    angle : array_like [rad]
        Engagement angle alpha that is held.
    radius : array_like [mm]
        Tool radius r.
    path_curvature : array_like [1/mm]
        Curvature k of the tool centre's path after the jump.

    Returns
    -------
    Array [rad]
        atan(r k sin(alpha) / (1 + r k cos(alpha))). A concave kink cannot be left by a previous
        tool of any radius, so that some overshoot of the engagement remains there.
    """
    bend = jnp.asarray(radius) * jnp.asarray(path_curvature)
    return jnp.arctan2(bend * jnp.sin(jnp.asarray(angle)), 1.0 + bend * jnp.cos(jnp.asarray(angle)))


def require_target(angle: float) -> None:
    """Refuse an engagement angle that cannot be held.

    Parameters
    ----------
    angle : float [rad]
        What is to be held.

    Raises
    ------
    InputError
        If it is not between 0 and pi.
    """
    if not 0.0 < angle < math.pi:
        raise InputError(
            f"the target angle is {math.degrees(angle):g} degrees, but must be between 0 and 180."
        )


def _depth_ratio(radial_depth: ArrayLike, radius: ArrayLike, curvature: ArrayLike) -> Array:
    """Depth ratio c = 1 - cos(alpha), beyond 0 to 2 where there is no such angle."""
    depth, r, kappa = jnp.asarray(radial_depth), jnp.asarray(radius), jnp.asarray(curvature)
    room = 1.0 - kappa * r
    fits = room > 0.0
    ratio = depth * (2.0 - kappa * depth) / (2.0 * r * jnp.where(fits, room, 1.0))
    return jnp.where(fits, ratio, 2.0)


def _angle_of(ratio: Array) -> Array:
    """Engagement angle of c = 1 - cos(alpha), kept in 0 to pi, its gradient finite everywhere."""
    inside = (ratio > 0.0) & (ratio < 2.0)
    kept = jnp.where(inside, ratio, 1.0)
    # 2 asin(sqrt(c / 2)) keeps its digits at small angles, where acos(1 - c) loses half of them.
    angle = 2.0 * jnp.arctan2(safe_sqrt(kept), safe_sqrt(2.0 - kept))
    return jnp.where(inside, angle, jnp.where(ratio >= 2.0, jnp.pi, 0.0))
