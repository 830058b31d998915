"""Along the path of a layer: why its bottom is tilted, and how far.

The electrode's bottom stays flat and wears while it cuts, so a layer is deeper where its path
begins. Which way a path runs decides what the next one finds.

Lengths in um. Notation: x share of the path from its fixed end, 0 to 1; u = R S_w / S_e relative
wear of the layer (`procmodel.wear.relative_wear`): over a layer of undisturbed overlap the overlap
falls by e^-u.

References
----------
.. [1] Z. Yu, T. Masuzawa, "Machining of microcavities by EDM" (in Japanese), 1997, section 2.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.special import lambertw

from procmodel.errors import InputError


class TiltedLayers(NamedTuple):
    """Bottoms of layers cut one after the other on the same path.

    Attributes
    ----------
    depth : Array, shape (n, m) [um]
        Mean depth of every piece of the path after every layer, from its fixed end on.
    wear : Array, shape (n,) [um]
        Electrode length lost in every layer.
    """

    depth: Array
    wear: Array

    @property
    def tilt(self) -> Array:
        """Greatest less least depth along the path after every layer, shape (n,) [um]."""
        return jnp.max(self.depth, axis=1) - jnp.min(self.depth, axis=1)


def one_way_pass(share: ArrayLike, feed: ArrayLike, relative_wear: ArrayLike) -> Array:
    """Depth that a single pass cuts into a flat surface.

    Parameters
    ----------
    share : array_like
        Share x of the path behind the electrode, 0 to 1.
    feed : array_like [um]
        Feed dZ before the pass.
    relative_wear : array_like
        u of the layer.

    Returns
    -------
    Array [um]
        dZ exp(-u x), whose mean over the path is dZ (1 - e^-u) / u.
    """
    return jnp.asarray(feed) * jnp.exp(-jnp.asarray(relative_wear) * jnp.asarray(share))


def steady_tilt(feed: ArrayLike, relative_wear: ArrayLike) -> Array:
    """Tilt of the bottom after many equal layers scanned one way.

    Parameters
    ----------
    feed : array_like [um]
        Feed dZ of every layer.
    relative_wear : array_like
        u of the layer.

    Returns
    -------
    Array [um]
        dZ u / (1 + u): the electrode's wear of one layer, less than one feed.
    """
    u = jnp.asarray(relative_wear)
    return jnp.asarray(feed) * u / (1.0 + u)


def start_up_decay(relative_wear: float) -> float:
    """Factor by which the deviation from the steady layer shrinks from layer to layer.

    The deviation on a path scanned one way again and again obeys a delay equation, whose slowest
    mode multiplies by e^z a layer, z = -u (1 - e^-z); eq. (3) holds once it has died out.

    Parameters
    ----------
    relative_wear : float
        u of the layer, > 0.

    Returns
    -------
    float
        |e^z|, below 1.

    Raises
    ------
    InputError
        If the relative wear is not above 0.
    """
    u = _positive_wear(relative_wear)
    # (z + u) e^(z + u) = u e^u, whose first branch is the steady layer z = 0.
    return math.exp(float(np.real(lambertw(u * math.exp(u), 1))) - u) if u < 500.0 else 1.0


def start_up_layers(relative_wear: float, tolerance: float = 1e-2) -> int:
    """Layers after which the depth of a layer is that of eq. (3).

    Parameters
    ----------
    relative_wear : float
        u of the layer, > 0.
    tolerance : float
        What may be left of the deviation, above 0 and below 1.

    Returns
    -------
    int
        The number of layers.

    Raises
    ------
    InputError
        If the relative wear is not above 0 or so large that the deviation stays, or the tolerance
        is not between 0 and 1.
    """
    if not 0.0 < tolerance < 1.0:
        raise InputError(f"tolerance is {tolerance:g}, but must be between 0 and 1.")
    decay = start_up_decay(relative_wear)
    if decay >= 1.0 - 1e-9:
        raise InputError(
            f"relative wear is {relative_wear:g}: the electrode is gone before the end of a layer; "
            "take a larger electrode or divide the layer."
        )
    return math.ceil(math.log(tolerance) / math.log(decay))


def tilted_layers(
    feeds: ArrayLike,
    relative_wear: ArrayLike,
    forward: np.ndarray,
    pieces: int = 100,
    surface: ArrayLike | None = None,
) -> TiltedLayers:
    """Bottoms of layers on one path, scanned one way or to and fro.

    Volume is conserved to rounding: what the path loses, times R, is what the electrode loses.

    Parameters
    ----------
    feeds : array_like, shape (n,) [um]
        Feed before every pass, >= 0.
    relative_wear : array_like [-]
        u of a layer: a number, or one for every pass.
    forward : ndarray of bool, shape (n,)
        Whether the pass runs from the fixed end of the path to the other.
    pieces : int
        Pieces of the path; their mean depths are known, so a tilt lacks half a piece at either end.
    surface : array_like, shape (m,), optional [um]
        Depth of the pieces below the electrode's tip before the first feed; flat and touched by the
        electrode when left out.

    Returns
    -------
    TiltedLayers
        Depths and wear. Differentiable in feeds, relative wear and surface.

    Raises
    ------
    InputError
        If the number of directions is not that of the feeds, or there are no pieces.
    """
    feeds = jnp.asarray(feeds, float)
    if feeds.ndim != 1 or np.shape(forward) != feeds.shape:
        raise InputError(
            f"forward has the shape {np.shape(forward)}, but the feeds have {feeds.shape}: give "
            "one direction for every feed."
        )
    if pieces < 1:
        raise InputError(f"pieces is {pieces}, but must be at least 1.")
    each = jnp.broadcast_to(jnp.asarray(relative_wear, float), feeds.shape)
    before = jnp.zeros(pieces) if surface is None else jnp.asarray(surface, float)
    return _tilted_layers(feeds, each, jnp.asarray(forward, bool), before)


@jax.jit
def _tilted_layers(feeds: Array, wear: Array, forward: Array, surface: Array) -> TiltedLayers:
    pieces = len(surface)

    def layer(carry: tuple[Array, Array], of: tuple) -> tuple[tuple[Array, Array], tuple]:
        tip, depth = carry
        feed, u, onwards = of
        # Over a piece the overlap falls by e^-q, and its mean is this share of the first.
        q = u / pieces
        lost = -jnp.expm1(-q)
        small = q < 1e-8
        mean = jnp.where(small, 1.0 - 0.5 * q, lost / jnp.where(small, 1.0, q))

        def piece(tip: Array, height: Array) -> tuple[Array, Array]:
            overlap = jnp.maximum(tip - height, 0.0)
            return tip - lost * overlap, height + mean * overlap

        met = jnp.where(onwards, depth, depth[::-1])
        after, cut = jax.lax.scan(piece, tip + feed, met)
        left = jnp.where(onwards, cut, cut[::-1])
        return (after, left), (left, tip + feed - after)

    start = (jnp.zeros((), feeds.dtype), surface)
    _, (depth, worn) = jax.lax.scan(layer, start, (feeds, wear, forward))
    return TiltedLayers(depth, worn)


def _positive_wear(relative_wear: float) -> float:
    if not (math.isfinite(relative_wear) and relative_wear > 0.0):
        raise InputError(f"relative wear is {relative_wear:g}, but must be above 0.")
    return float(relative_wear)
