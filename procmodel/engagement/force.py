"""Cutting force of an end mill: mechanistic coefficients, integrated exactly over the flutes.

Lengths in mm, forces in N, angles in rad. Angles of the cutter count from +y towards the cut, the
chip at an angle phi is c sin(phi) thick. Forces act on the tool: x along the feed, y across.

Notation: K_tc, K_rc, K_ac shearing coefficients [N/mm^2] and K_te, K_re, K_ae edge coefficients
[N/mm], tangential, radial and axial; N flutes, a axial depth, c feed per tooth.

References
----------
.. [1] Y. Altintas, "Manufacturing Automation", 2nd ed., 2012, chapter 2: mean and instantaneous
   force of helical end mills.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from procmodel.numerics import safe_sqrt


class ForceCoefficients(eqx.Module):
    """Mechanistic coefficients of a tool in a material.

    Attributes
    ----------
    tangential_shear, radial_shear, axial_shear : array_like [N/mm^2]
        K_tc, K_rc, K_ac, per area of the chip.
    tangential_edge, radial_edge, axial_edge : array_like [N/mm]
        K_te, K_re, K_ae, per length of the edge.
    """

    tangential_shear: ArrayLike
    radial_shear: ArrayLike
    axial_shear: ArrayLike
    tangential_edge: ArrayLike
    radial_edge: ArrayLike
    axial_edge: ArrayLike


def mean_force(
    coefficients: ForceCoefficients,
    start: ArrayLike,
    exit: ArrayLike,
    flutes: int,
    axial_depth: ArrayLike,
    feed_per_tooth: ArrayLike,
) -> Array:
    """Force averaged over a turn; the helix does not change it.

    Parameters
    ----------
    coefficients : ForceCoefficients
        Of tool and material.
    start, exit : array_like [rad]
        Where a flute enters and leaves the stock; down milling ends at pi.
    flutes : int
        Number of flutes N.
    axial_depth : array_like [mm]
        Axial depth a.
    feed_per_tooth : array_like [mm]
        Feed per tooth c.

    Returns
    -------
    Array, shape (..., 3) [N]
        Along x, y and z.
    """
    whole = _integral(coefficients, jnp.asarray(exit), feed_per_tooth) - _integral(
        coefficients, jnp.asarray(start), feed_per_tooth
    )
    return flutes * jnp.asarray(axial_depth)[..., None] / (2.0 * jnp.pi) * whole


def instantaneous_force(
    coefficients: ForceCoefficients,
    rotation: ArrayLike,
    start: ArrayLike,
    exit: ArrayLike,
    flutes: int,
    axial_depth: ArrayLike,
    feed_per_tooth: ArrayLike,
    radius: ArrayLike,
    helix: ArrayLike,
) -> Array:
    """Force at an angle of rotation, integrated exactly along the helix of every flute.

    Parameters
    ----------
    coefficients : ForceCoefficients
        Of tool and material.
    rotation : array_like, shape (...) [rad]
        Angle of the first flute at the tool's end, 0 to 2 pi.
    start, exit : array_like, shape (...) [rad]
        Where a flute enters and leaves the stock, 0 <= start <= exit <= pi.
    flutes : int
        Number of flutes N.
    axial_depth : array_like [mm]
        Axial depth a.
    feed_per_tooth : array_like [mm]
        Feed per tooth c.
    radius : array_like [mm]
        Tool radius r.
    helix : array_like [rad]
        Helix angle, > 0: a straight flute enters all at once, which has no derivative.

    Returns
    -------
    Array, shape (..., 3) [N]
        Along x, y and z. Continuous, and differentiable but where a flute's end meets an edge of
        the stock.

    Notes
    -----
    A flute lags by z tan(helix) / r at the height z. Lags of more than a turn are counted too.
    """
    lag_per_height = jnp.tan(jnp.asarray(helix)) / jnp.asarray(radius)
    _, lowest, highest = engaged_angles(
        rotation, start, exit, flutes, lag_per_height * jnp.asarray(axial_depth)
    )
    feed = jnp.asarray(feed_per_tooth)[..., None]
    engaged = _integral(coefficients, lowest, feed) - _integral(coefficients, highest, feed)
    return jnp.sum(engaged, axis=-2) / lag_per_height[..., None]


def peak_force(
    coefficients: ForceCoefficients,
    start: ArrayLike,
    exit: ArrayLike,
    flutes: int,
    axial_depth: ArrayLike,
    feed_per_tooth: ArrayLike,
    radius: ArrayLike,
    helix: ArrayLike,
) -> Array:
    """Greatest force across the tool's axis during a turn.

    Parameters
    ----------
    coefficients, start, exit, flutes, axial_depth, feed_per_tooth, radius, helix
        As for `instantaneous_force`.

    Returns
    -------
    Array, shape (...) [N]
        hypot(Fx, Fy) at its greatest of 64 angles in a tooth's pitch and those where a flute
        begins or ends to engage at either end of the cut, which are where it stops rising when one
        flute is in the cut at a time.
    """
    start, exit, depth, feed, r, tilt = (
        jnp.asarray(v)[..., None] for v in (start, exit, axial_depth, feed_per_tooth, radius, helix)
    )
    pitch = 2.0 * jnp.pi / flutes
    lag = jnp.tan(tilt) / r * depth
    even = pitch * jnp.arange(64) / 64
    shape = jnp.broadcast_shapes(start.shape, exit.shape, lag.shape)
    edges = [jnp.broadcast_to(e, shape) for e in (start, exit, start + lag, exit + lag)]
    rotation = jnp.concatenate([jnp.broadcast_to(even, (*shape[:-1], 64)), *edges], axis=-1) % pitch
    force = instantaneous_force(coefficients, rotation, start, exit, flutes, depth, feed, r, tilt)
    square = jnp.max(force[..., 0] ** 2 + force[..., 1] ** 2, axis=-1)
    return safe_sqrt(square)


def force_per_height(
    coefficients: ForceCoefficients, angle: ArrayLike, feed_per_tooth: ArrayLike
) -> Array:
    """Force of a flute per height, at a point of it that is in the stock.

    Parameters
    ----------
    coefficients : ForceCoefficients
        Of tool and material.
    angle : array_like, shape (...) [rad]
        Angle phi of the point.
    feed_per_tooth : array_like [mm]
        Feed per tooth c.

    Returns
    -------
    Array, shape (..., 3) [N/mm]
        (-F_t cos - F_r sin, F_t sin - F_r cos, F_a) with F = K_c c sin(phi) + K_e for each.
    """
    k, sine, cosine = coefficients, jnp.sin(jnp.asarray(angle)), jnp.cos(jnp.asarray(angle))
    chip = jnp.asarray(feed_per_tooth) * sine
    tangential = k.tangential_shear * chip + k.tangential_edge
    radial = k.radial_shear * chip + k.radial_edge
    along = -tangential * cosine - radial * sine
    across = tangential * sine - radial * cosine
    upwards = k.axial_shear * chip + k.axial_edge
    return jnp.stack(jnp.broadcast_arrays(along, across, upwards), axis=-1)


def engaged_angles(
    rotation: ArrayLike, start: ArrayLike, exit: ArrayLike, flutes: int, lag: ArrayLike
) -> tuple[Array, Array, Array]:
    """What of every flute is in the stock.

    Parameters
    ----------
    rotation : array_like, shape (...) [rad]
        Angle of the first flute at the tool's end, 0 to 2 pi.
    start, exit : array_like, shape (...) [rad]
        Where a flute enters and leaves the stock.
    flutes : int
        Number of flutes N.
    lag : array_like [rad]
        How far a flute's upper end in the cut lags behind its end.

    Returns
    -------
    ends : Array, shape (..., m) [rad]
        Angle of every flute at the tool's end; a flute lies there once for each turn in which its
        upper part may still be in the cut.
    lowest, highest : Array, shape (..., m) [rad]
        Angles at the lowest and the highest point in the stock; equal where none is.
    """
    turns = 2.0 * jnp.pi * (jnp.arange(_TURNS * flutes) / flutes - 1.0)
    ends = jnp.asarray(rotation)[..., None] + turns
    start, exit, lag = (jnp.asarray(v)[..., None] for v in (start, exit, lag))
    return ends, jnp.clip(ends, start, exit), jnp.clip(ends - lag, start, exit)


# Turns counted: enough for an axial depth of nine diameters at a helix of 60 degrees.
_TURNS = 7


def _integral(coefficients: ForceCoefficients, angle: Array, feed_per_tooth: ArrayLike) -> Array:
    """Antiderivative by the angle of the force per height of a flute, shape (..., 3)."""
    k, chip = coefficients, jnp.asarray(feed_per_tooth)
    half_square = 0.5 * jnp.sin(angle) ** 2
    area = 0.5 * angle - 0.25 * jnp.sin(2.0 * angle)
    sine, cosine = jnp.sin(angle), jnp.cos(angle)
    along = -chip * (k.tangential_shear * half_square + k.radial_shear * area)
    along = along - k.tangential_edge * sine + k.radial_edge * cosine
    across = chip * (k.tangential_shear * area - k.radial_shear * half_square)
    across = across - k.tangential_edge * cosine - k.radial_edge * sine
    upwards = -chip * k.axial_shear * cosine + k.axial_edge * angle
    return jnp.stack(jnp.broadcast_arrays(along, across, upwards), axis=-1)
