"""Feed of the electrode at every step of a path: per layer, per length, per fixed length.

Uniform wear, linear compensation and fixed-length compensation are one simulation with different
feeds. All are linear in their amount, and differentiable in it. Lengths in um.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.errors import InputError
from procmodel.wear.path_steps import PathSteps


def layer_feeds(steps: PathSteps, feed: ArrayLike) -> Array:
    """Feed given at once where a layer begins: the uniform wear method.

    Parameters
    ----------
    steps : PathSteps
        Positions, shape (layers, steps).
    feed : array_like, shape () or (layers,) [um]
        Feed dZ of every layer.

    Returns
    -------
    Array, shape (layers, steps) [um]
        Feed before the cut at every step.

    Raises
    ------
    InputError
        If the feeds are neither one nor one for every layer.

    References
    ----------
    Yu and Masuzawa 1997, section 2 and eq. (1).
    """
    first = np.zeros(np.shape(steps.x))
    first[:, 0] = steps.valid[:, 0]
    return _per_layer(steps, feed, "feed") * first


def linear_feeds(steps: PathSteps, feed_per_length: ArrayLike) -> Array:
    """Feed in proportion to the way cut: linear compensation.

    Parameters
    ----------
    steps : PathSteps
        Positions, shape (layers, steps).
    feed_per_length : array_like, shape () or (layers,) [um/um]
        Feed k per length of the way.

    Returns
    -------
    Array, shape (layers, steps) [um]
        Feed before the cut at every step.

    Raises
    ------
    InputError
        If the feeds are neither one nor one for every layer.
    """
    return _per_layer(steps, feed_per_length, "feed per length") * np.asarray(steps.length)


def fixed_length_feeds(
    steps: PathSteps, feed: ArrayLike, length: float, first: float | None = None
) -> Array:
    """The same feed again after each fixed length of the way: fixed-length compensation.

    The way is counted on through all layers; a feed that is due between two positions is given at
    the second.

    Parameters
    ----------
    steps : PathSteps
        Positions, shape (layers, steps).
    feed : array_like, shape () or (layers,) [um]
        Feed dZ.
    length : float [um]
        Way between two feeds, > 0.
    first : float, optional [um]
        Way before the first feed, from 0; a whole `length` when left out.

    Returns
    -------
    Array, shape (layers, steps) [um]
        Feed before the cut at every step.

    Raises
    ------
    InputError
        If a length is not a finite number above 0, or the feeds are neither one nor one for every
        layer.
    """
    if not (np.isfinite(length) and length > 0):
        raise InputError(f"length between feeds {length:g} um must be above 0.")
    start = length if first is None else first
    if not (np.isfinite(start) and start >= 0):
        raise InputError(f"way before the first feed {start:g} um must not be below 0.")
    way = np.cumsum(np.ravel(steps.length)).reshape(np.shape(steps.x))
    # Rounding of a long sum must not put a feed off to the next position.
    due = np.maximum(np.floor((way - start) / length + 1e-6) + 1.0, 0.0)
    times = np.diff(np.ravel(due), prepend=0.0).reshape(due.shape)
    return _per_layer(steps, feed, "feed") * times


def _per_layer(steps: PathSteps, amount: ArrayLike, name: str) -> Array:
    """The amounts as a column that goes with the steps."""
    values, layers = jnp.asarray(amount, float), len(steps.x)
    if values.ndim > 1 or (values.ndim == 1 and len(values) != layers):
        raise InputError(
            f"{name} has shape {values.shape}: give one number or one for each of {layers} layers."
        )
    return jnp.broadcast_to(values, (layers,))[:, None]
