"""The layer law of the uniform wear method: how deep one layer becomes.

A layer is fed by ``feed``; the electrode loses part of it, the workpiece gets the rest.
Lengths in um, areas in um^2. Every function works on scalars and on arrays, and is
differentiable in every argument.

Notation: R wear ratio (electrode volume lost / workpiece volume removed), S_e electrode
area, S_w layer area, rho = R / S_e wear per area [1/um^2], u = rho S_w.

References
----------
.. [1] Z. Yu and T. Masuzawa, "Machining of microcavities by EDM" (in Japanese), 1997.
.. [2] Z. Y. Yu, T. Masuzawa, M. Fujino, CIRP Annals 47(1), 169-172, 1998.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


def layer_depth(
    feed: ArrayLike, layer_area: ArrayLike, wear_ratio: ArrayLike, electrode_area: ArrayLike
) -> Array:
    """Depth of the layer that one feed leaves in the workpiece, eq. (3) of [1]_.

    Parameters
    ----------
    feed : array_like [um]
        Feed of the layer, dZ.
    layer_area : array_like [um^2]
        Area swept in the layer, S_w.
    wear_ratio : array_like [-]
        Volumetric wear ratio R.
    electrode_area : array_like [um^2]
        Cross-section of the electrode, S_e.

    Returns
    -------
    Array [um]
        Mean depth of the layer, L_w = dZ / (1 + S_w R / S_e).
    """
    return jnp.asarray(feed) / (1.0 + relative_wear(layer_area, wear_ratio, electrode_area))


def layer_feed(
    depth: ArrayLike, layer_area: ArrayLike, wear_ratio: ArrayLike, electrode_area: ArrayLike
) -> Array:
    """Feed that leaves a layer of the wanted depth: eq. (3) of [1]_ solved for dZ.

    Parameters
    ----------
    depth : array_like [um]
        Wanted depth of the layer, L_w.
    layer_area : array_like [um^2]
        Area swept in the layer, S_w.
    wear_ratio : array_like [-]
        Volumetric wear ratio R.
    electrode_area : array_like [um^2]
        Cross-section of the electrode, S_e.

    Returns
    -------
    Array [um]
        dZ = L_w (1 + S_w R / S_e).
    """
    return jnp.asarray(depth) * (1.0 + relative_wear(layer_area, wear_ratio, electrode_area))


def relative_wear(layer_area: ArrayLike, wear_ratio: ArrayLike, electrode_area: ArrayLike) -> Array:
    """Electrode length lost per depth gained, u = R S_w / S_e, from eq. (2) of [1]_.

    Parameters
    ----------
    layer_area : array_like [um^2]
        Area swept in the layer, S_w.
    wear_ratio : array_like [-]
        Volumetric wear ratio R.
    electrode_area : array_like [um^2]
        Cross-section of the electrode, S_e.

    Returns
    -------
    Array [-]
        L_e / L_w.
    """
    return jnp.asarray(wear_ratio) * jnp.asarray(layer_area) / jnp.asarray(electrode_area)


def electrode_wear(
    feed: ArrayLike, layer_area: ArrayLike, wear_ratio: ArrayLike, electrode_area: ArrayLike
) -> Array:
    """Length the electrode loses in a layer, eqs. (1) and (2) of [1]_.

    Parameters
    ----------
    feed : array_like [um]
        Feed of the layer, dZ.
    layer_area : array_like [um^2]
        Area swept in the layer, S_w.
    wear_ratio : array_like [-]
        Volumetric wear ratio R.
    electrode_area : array_like [um^2]
        Cross-section of the electrode, S_e.

    Returns
    -------
    Array [um]
        L_e = dZ u / (1 + u), so that L_w + L_e = dZ.
    """
    u = relative_wear(layer_area, wear_ratio, electrode_area)
    return jnp.asarray(feed) * u / (1.0 + u)


def wear_ratio_of_layer(
    feed: ArrayLike, depth: ArrayLike, layer_area: ArrayLike, electrode_area: ArrayLike
) -> Array:
    """Wear ratio that explains one measured layer, eq. (2) of [1]_ with L_e = dZ - L_w.

    Parameters
    ----------
    feed : array_like [um]
        Feed of the layer, dZ.
    depth : array_like [um]
        Measured depth of the layer, L_w > 0.
    layer_area : array_like [um^2]
        Area swept in the layer, S_w.
    electrode_area : array_like [um^2]
        Cross-section of the electrode, S_e.

    Returns
    -------
    Array [-]
        R = S_e (dZ - L_w) / (S_w L_w).
    """
    feed, depth = jnp.asarray(feed), jnp.asarray(depth)
    return jnp.asarray(electrode_area) * (feed - depth) / (jnp.asarray(layer_area) * depth)


def cavity_depths(
    feeds: ArrayLike, layer_areas: ArrayLike, wear_ratio: ArrayLike, electrode_area: ArrayLike
) -> Array:
    """Depth of the cavity after every layer, eq. (4) of [1]_.

    Parameters
    ----------
    feeds : array_like, shape (n,) or scalar [um]
        Feed of every layer, from the top one down.
    layer_areas : array_like, shape (n,) [um^2]
        Area swept in every layer.
    wear_ratio : array_like [-]
        Volumetric wear ratio R.
    electrode_area : array_like [um^2]
        Cross-section of the electrode, S_e.

    Returns
    -------
    Array, shape (n,) [um]
        Z_n, the sum of the layer depths down to layer n.
    """
    return jnp.cumsum(layer_depth(feeds, layer_areas, wear_ratio, electrode_area))


def continuous_wall_depth(
    position: ArrayLike,
    half_width: ArrayLike,
    wear_per_area: ArrayLike,
    area_factor: float = 4.0,
    slope: ArrayLike = 1.0,
) -> Array:
    """Wall left by infinitely thin uncompensated layers: the limit of eq. (4) of [1]_.

    Parameters
    ----------
    position : array_like [um]
        Distance X from the centre, at most `half_width`.
    half_width : array_like [um]
        Half width X0 of the first layer.
    wear_per_area : array_like [1/um^2]
        rho = R / S_e.
    area_factor : float [-]
        Layer area over X^2: 4 for a square, pi for a circle.
    slope : array_like [-]
        Feed over step, dZ / dX.

    Returns
    -------
    Array [um]
        z(X) = slope [atan(k X0) - atan(k X)] / k with k = sqrt(area_factor rho).
    """
    square = area_factor * jnp.asarray(wear_per_area)
    worn = square > 0
    # The double `where`: without wear the wall is straight, and sqrt'(0) must not be evaluated.
    k = jnp.sqrt(jnp.where(worn, square, 1.0))
    half_width, position = jnp.asarray(half_width), jnp.asarray(position)
    curved = (jnp.arctan(k * half_width) - jnp.arctan(k * position)) / k
    # To first order in rho, so that the gradient at rho = 0 is the right one.
    straight = half_width - position - square * (half_width**3 - position**3) / 3.0
    return jnp.asarray(slope) * jnp.where(worn, curved, straight)
