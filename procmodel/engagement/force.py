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
    start, exit : array_like [rad]
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
    lag = lag_per_height * jnp.asarray(axial_depth)
    # Every flute in this turn, and in those before it whose upper part may still be in the cut.
    turns = 2.0 * jnp.pi * (jnp.arange(_TURNS * flutes) / flutes - 1.0)
    ends = jnp.asarray(rotation)[..., None] + turns
    lowest, highest = jnp.clip(ends, start, exit), jnp.clip(ends - lag, start, exit)
    engaged = _integral(coefficients, lowest, feed_per_tooth) - _integral(
        coefficients, highest, feed_per_tooth
    )
    return jnp.sum(engaged, axis=-2) / lag_per_height


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
