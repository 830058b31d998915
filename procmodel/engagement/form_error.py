"""Form error of a milled wall: how far the tool is bent while a flute generates the wall.

Lengths in mm, forces in N, angles in rad. A point of the rim at the angle phi is at
(r sin(phi), r cos(phi)) from the tool's centre, x along the feed. Down milling leaves the stock at
phi = pi: its wall is at y = -r, and a force Fy > 0 pushes the tool off the wall, so that material
is left. Up milling enters at phi = 0: its wall is at y = +r, and a force Fy > 0 pulls the tool
into it. In both, the wall at a height z is generated when the flute's point at z passes the wall's
angle; what the force is at any other instant leaves no trace there.

Notation: alpha engagement angle, N flutes, a axial depth, c feed per tooth, r tool radius, z height
above the tool's end, lag = tan(helix) / r.

References
----------
.. [1] Y. Altintas, "Manufacturing Automation", 2nd ed., 2012, chapter 4: surface errors of
   helical end mills.
.. [2] W. A. Kline, R. E. DeVor, I. A. Shareef, "The prediction of surface accuracy in end
   milling", J. Eng. Ind. 104(3), 272-278, 1982.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.engagement.deflection import ToolStiffness
from procmodel.engagement.force import (
    ForceCoefficients,
    engaged_angles,
    force_per_height,
    instantaneous_force,
    mean_force,
    peak_force,
)
from procmodel.errors import InputError, nearest

MILLING = ("down", "up")
# Gauss-Legendre on (0, 1): over the longest engagement, pi, its error is 1e-11 of the force.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS


def engaged_between(angle: ArrayLike, milling: str = "down") -> tuple[Array, Array]:
    """Where a flute enters and leaves the stock.

    Parameters
    ----------
    angle : array_like [rad]
        Engagement angle alpha, 0 to pi.
    milling : {"down", "up"}
        Whether a flute leaves or enters at the wall.

    Returns
    -------
    start, exit : Array [rad]
        pi - alpha to pi in down milling, 0 to alpha in up milling.

    Raises
    ------
    InputError
        If it is neither of the two.
    """
    require_milling(milling)
    alpha = 1.0 * jnp.asarray(angle)
    if milling == "down":
        return jnp.pi - alpha, jnp.full_like(alpha, jnp.pi)
    return jnp.zeros_like(alpha), alpha


def wall_force(
    coefficients: ForceCoefficients,
    angle: ArrayLike,
    flutes: int,
    axial_depth: ArrayLike,
    feed_per_tooth: ArrayLike,
    radius: ArrayLike,
    helix: ArrayLike,
    heights: ArrayLike,
    milling: str = "down",
) -> Array:
    """Force on the tool at the instant in which the wall is generated.

    Parameters
    ----------
    coefficients, angle, flutes, axial_depth, feed_per_tooth, radius, helix, heights, milling
        As for `form_error`.

    Returns
    -------
    Array, shape (..., m, 3) [N]
        Along x, y and z, exact along the helix of all flutes that are in the cut then.
    """
    alpha, feed = jnp.asarray(angle)[..., None], jnp.asarray(feed_per_tooth)[..., None]
    start, exit = engaged_between(alpha, milling)
    rotation = _rotation(heights, flutes, jnp.tan(jnp.asarray(helix)) / radius, milling)
    return instantaneous_force(
        coefficients, rotation, start, exit, flutes, axial_depth, feed, radius, helix
    )


def form_error(
    coefficients: ForceCoefficients,
    angle: ArrayLike,
    flutes: int,
    axial_depth: ArrayLike,
    feed_per_tooth: ArrayLike,
    radius: ArrayLike,
    helix: ArrayLike,
    tool_stiffness: ToolStiffness,
    heights: ArrayLike,
    milling: str = "down",
) -> Array:
    """Error of the wall at every height, from the tool's bending.

    Parameters
    ----------
    coefficients : ForceCoefficients
        Of tool and material.
    angle : array_like, shape (...) [rad]
        Engagement angle alpha, such as at the places of a path; 0 where the tool is in air.
    flutes : int
        Number of flutes N.
    axial_depth : array_like [mm]
        Axial depth a.
    feed_per_tooth : array_like, shape (...) or scalar [mm]
        Feed per tooth c.
    radius : array_like [mm]
        Tool radius r.
    helix : array_like [rad]
        Helix angle, > 0.
    tool_stiffness : ToolStiffness
        How the tool gives way.
    heights : array_like, shape (m,) [mm]
        Heights z above the tool's end, 0 to a.
    milling : {"down", "up"}
        Whether a flute leaves or enters at the wall.

    Returns
    -------
    Array, shape (..., m) [mm]
        Positive where material is left on the wall, negative where the tool cuts into it.

    Raises
    ------
    InputError
        If `milling` is unknown.

    Notes
    -----
    Every piece of a flute loads the tool at its own height; the pieces are summed by
    Gauss-Legendre over the part of each flute that is in the stock. In down milling the piece of
    the generating flute lies above z, from z to z + alpha / lag, so that the error falls to 0 at
    the upper end of the cut where no other flute is engaged; in up milling it lies below.
    The static bending is taken: the tool follows the force without inertia, and its bending does
    not change the chip.
    """
    z = jnp.asarray(heights)
    lag = jnp.tan(jnp.asarray(helix)) / jnp.asarray(radius)
    start, exit = engaged_between(jnp.asarray(angle)[..., None], milling)
    rotation = _rotation(z, flutes, lag, milling)
    ends, lowest, highest = engaged_angles(
        rotation, start, exit, flutes, lag * jnp.asarray(axial_depth)
    )
    span = (lowest - highest)[..., None]
    phi = highest[..., None] + span * _NODES
    feed = jnp.asarray(feed_per_tooth)[..., None, None, None]
    across = force_per_height(coefficients, phi, feed)[..., 1] * span * _WEIGHTS / lag
    load_height = (ends[..., None] - phi) / lag
    bent = tool_stiffness.deflection(across, load_height, z[..., None, None])
    away = 1.0 if milling == "down" else -1.0
    return away * jnp.sum(bent, axis=(-2, -1))


class Cut(eqx.Module):
    """Tool and conditions of a cut whose engagement varies along a path.

    Parameters
    ----------
    flutes : int
        Number of flutes N.
    axial_depth : array_like [mm]
        Axial depth a.
    feed_per_tooth : array_like [mm]
        Feed per tooth c.
    radius : array_like [mm]
        Tool radius r.
    helix : array_like [rad]
        Helix angle, 0 to pi/2, both excluded.
    milling : {"down", "up"}
        Whether a flute leaves or enters at the wall.

    Raises
    ------
    InputError
        If a plain number is out of its range, or `milling` is unknown.
    """

    flutes: int = eqx.field(static=True)
    axial_depth: ArrayLike
    feed_per_tooth: ArrayLike
    radius: ArrayLike
    helix: ArrayLike
    milling: str = eqx.field(static=True, default="down")

    def __check_init__(self) -> None:
        require_milling(self.milling)
        require_flutes(self.flutes)
        for name in ("axial_depth", "feed_per_tooth", "radius"):
            value = getattr(self, name)
            # Arrays may be traced: what they hold is not known here.
            if isinstance(value, int | float) and not (math.isfinite(value) and value > 0):
                raise InputError(f"{name.replace('_', ' ')} is {value:g} mm, but must be above 0.")
        if isinstance(self.helix, int | float):
            require_helix(self.helix)

    def mean_force(self, coefficients: ForceCoefficients, angle: ArrayLike) -> Array:
        """Force averaged over a turn, shape (..., 3) [N]; see `mean_force`."""
        start, exit = engaged_between(angle, self.milling)
        return mean_force(
            coefficients, start, exit, self.flutes, self.axial_depth, self.feed_per_tooth
        )

    def peak_force(self, coefficients: ForceCoefficients, angle: ArrayLike) -> Array:
        """Greatest force across the axis during a turn, shape (...) [N]; see `peak_force`."""
        start, exit = engaged_between(angle, self.milling)
        return peak_force(coefficients, start, exit, *self._conditions)

    def wall_force(
        self, coefficients: ForceCoefficients, angle: ArrayLike, heights: ArrayLike
    ) -> Array:
        """Force while the wall is generated, shape (..., m, 3) [N]; see `wall_force`."""
        return wall_force(coefficients, angle, *self._conditions, heights, self.milling)

    def form_error(
        self,
        coefficients: ForceCoefficients,
        angle: ArrayLike,
        tool_stiffness: ToolStiffness,
        heights: ArrayLike,
    ) -> Array:
        """Error of the wall, shape (..., m) [mm]; see `form_error`."""
        return form_error(
            coefficients, angle, *self._conditions, tool_stiffness, heights, self.milling
        )

    @property
    def _conditions(self) -> tuple[int, ArrayLike, ArrayLike, ArrayLike, ArrayLike]:
        return self.flutes, self.axial_depth, self.feed_per_tooth, self.radius, self.helix


def require_milling(milling: str) -> None:
    """Refuse a direction of milling that is not known.

    Parameters
    ----------
    milling : str
        The direction.

    Raises
    ------
    InputError
        If it is neither "down" nor "up".
    """
    if milling not in MILLING:
        raise InputError(f"milling {milling!r} is unknown{nearest(str(milling), MILLING)}")


def require_flutes(flutes: int) -> None:
    """Refuse a number of flutes that no tool has.

    Parameters
    ----------
    flutes : int
        The number.

    Raises
    ------
    InputError
        If it is not a whole number above 0.
    """
    if isinstance(flutes, bool) or not isinstance(flutes, int) or flutes < 1:
        raise InputError(f"flutes is {flutes!r}, but must be a whole number, 1 or more.")


def require_helix(helix: float) -> None:
    """Refuse a helix angle without a finite lead.

    Parameters
    ----------
    helix : float [rad]
        The angle.

    Raises
    ------
    InputError
        If it is not between 0 and pi/2.
    """
    if not 0.0 < helix < 0.5 * math.pi:
        raise InputError(
            f"helix is {math.degrees(helix):g} deg, but must be above 0 and below 90: for straight "
            "flutes give a small angle such as 0.1."
        )


def _rotation(heights: ArrayLike, flutes: int, lag: ArrayLike, milling: str) -> Array:
    """Angle of a flute at the tool's end as its point at a height passes the wall, shape (m,)."""
    wall = jnp.pi if milling == "down" else 0.0
    # Turned back by whole pitches, which puts other flutes in its place.
    return wall + jnp.mod(jnp.asarray(lag) * jnp.asarray(heights), 2.0 * jnp.pi / flutes)
