"""Modes of a tool's tip, and what sensors see of them.

SI units. Notation: q modal displacement, w = 2 pi f natural frequency, zeta damping ratio, m modal
mass, d direction in which the tip moves in a mode; q'' + 2 zeta w q' + w^2 q = d . F / m.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from procmodel.chatter.cutting import as_float
from procmodel.errors import InputError


class Modes(eqx.Module):
    """Modes of the tool's tip.

    Parameters
    ----------
    frequency : array_like, shape (q,) [Hz]
        Natural frequencies, undamped.
    damping : array_like, shape (q,)
        Damping ratios zeta, 0 to 1.
    mass : array_like, shape (q,) [kg]
        Modal masses at the tip.
    direction : array_like, shape (q, 2), optional
        Unit vectors in which the tip moves; along the feed when left out.

    Raises
    ------
    InputError
        If a number is out of its range, or the shapes do not match.
    """

    frequency: Array
    damping: Array
    mass: Array
    direction: Array

    def __init__(
        self,
        frequency: ArrayLike,
        damping: ArrayLike,
        mass: ArrayLike,
        direction: ArrayLike | None = None,
    ) -> None:
        self.frequency = jnp.atleast_1d(as_float("frequency", frequency, above=0.0, unit="Hz"))
        count = len(self.frequency)
        self.damping = jnp.atleast_1d(as_float("damping", damping, least=0.0, most=0.999))
        self.mass = jnp.atleast_1d(as_float("mass", mass, above=0.0, unit="kg"))
        along = jnp.tile(jnp.array([1.0, 0.0]), (count, 1)) if direction is None else direction
        self.direction = jnp.atleast_2d(as_float("direction", along))
        for name, shape in (("damping", (count,)), ("mass", (count,)), ("direction", (count, 2))):
            found = getattr(self, name).shape
            if found != shape:
                raise InputError(
                    f"{name} has the shape {found}, but {count} frequencies need {shape}."
                )

    @property
    def angular(self) -> Array:
        """Natural frequencies w [rad/s]."""
        return 2.0 * jnp.pi * self.frequency

    @property
    def compliance(self) -> Array:
        """Static displacement of the tip per force, shape (2, 2) [m/N]."""
        each = 1.0 / (self.mass * self.angular**2)
        return jnp.einsum("q,qi,qj->ij", each, self.direction, self.direction)


class Sensors(eqx.Module):
    """What is measured, as mixtures of the modes.

    Parameters
    ----------
    displacement_gain : array_like, shape (d, q)
        Displacement at each sensor per modal displacement.
    acceleration_gain : array_like, shape (a, q)
        Acceleration at each sensor per modal acceleration.

    Raises
    ------
    InputError
        If a gain is not finite.
    """

    displacement_gain: Array
    acceleration_gain: Array

    def __init__(self, displacement_gain: ArrayLike, acceleration_gain: ArrayLike) -> None:
        self.displacement_gain = jnp.atleast_2d(as_float("displacement gain", displacement_gain))
        self.acceleration_gain = jnp.atleast_2d(as_float("acceleration gain", acceleration_gain))


def mode_propagator(
    angular: ArrayLike, damping: ArrayLike, time: ArrayLike
) -> tuple[Array, Array, Array, Array]:
    """Free motion of modes after a time, exactly.

    Parameters
    ----------
    angular : array_like, shape (...) [rad/s]
        Natural frequencies w.
    damping : array_like, shape (...)
        Damping ratios zeta, below 1.
    time : array_like [s]
        The time.

    Returns
    -------
    qq, qv, vq, vv : Array, shape (...)
        q becomes qq q + qv v, and v becomes vq q + vv v. A constant force per mass f adds
        (1 - qq) / w^2 f to q and qv f to v.
    """
    w, zeta = jnp.asarray(angular), jnp.asarray(damping)
    damped = w * jnp.sqrt(1.0 - zeta**2)
    decay = jnp.exp(-zeta * w * time)
    sine, cosine = decay * jnp.sin(damped * time) / damped, decay * jnp.cos(damped * time)
    return cosine + zeta * w * sine, sine, -(w**2) * sine, cosine - zeta * w * sine
