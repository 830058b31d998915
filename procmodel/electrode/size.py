"""What size an electrode gets from the path of the wire: radius, width, cross-section.

The finished surface lies a wire radius and a discharge gap inside the path of the wire's centre,
so that a smaller gap leaves a thicker electrode. The wire runs, and its own wear is neglected.
Lengths in um, areas in um^2.

References
----------
.. [1] T. Masuzawa et al., "Wire electro-discharge grinding for micro-machining", Annals of the
   CIRP 34(1), 213-216, 1985: the method.
.. [2] Guo, Pei, Yu, Li: shaped micro-electrodes; the random discharge gap is the first of the
   causes of error that they name.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


def finished_radius(path_radius: ArrayLike, wire_radius: ArrayLike, gap: ArrayLike) -> Array:
    """Radius that a turning electrode gets, or half width up to one indexed flat.

    Parameters
    ----------
    path_radius : array_like [um]
        Distance of the wire's centre from the axis of the spindle.
    wire_radius : array_like [um]
        Radius of the wire.
    gap : array_like [um]
        Discharge gap between wire and electrode.

    Returns
    -------
    Array [um]
        path_radius - wire_radius - gap, of the broadcast shape; below 0 nothing is left.
    """
    return jnp.asarray(path_radius) - wire_radius - gap


def path_radius(radius: ArrayLike, wire_radius: ArrayLike, gap: ArrayLike) -> Array:
    """Distance of the wire's centre from the axis that leaves a wanted radius.

    Parameters
    ----------
    radius : array_like [um]
        Wanted radius, or half width up to a flat.
    wire_radius : array_like [um]
        Radius of the wire.
    gap : array_like [um]
        Discharge gap that is counted on.

    Returns
    -------
    Array [um]
        radius + wire_radius + gap, of the broadcast shape; the inverse of `finished_radius`.
    """
    return jnp.asarray(radius) + wire_radius + gap


def finished_diameter(path_radius: ArrayLike, wire_radius: ArrayLike, gap: ArrayLike) -> Array:
    """Diameter of a turning electrode, or width across two opposite flats.

    Parameters
    ----------
    path_radius, wire_radius : array_like [um]
        As for `finished_radius`.
    gap : array_like [um]
        Discharge gap; across two flats, each ground in a pass of its own, the mean of both gaps.

    Returns
    -------
    Array [um]
        Twice the finished radius.
    """
    return 2.0 * finished_radius(path_radius, wire_radius, gap)


def round_area(diameter: ArrayLike) -> Array:
    """Cross-section of a round electrode.

    Parameters
    ----------
    diameter : array_like [um]
        Its diameter.

    Returns
    -------
    Array [um^2]
        pi d^2 / 4.
    """
    return jnp.pi * jnp.square(jnp.asarray(diameter)) / 4.0


def rectangle_area(width: ArrayLike, depth: ArrayLike) -> Array:
    """Cross-section between two pairs of flats at a right angle.

    Parameters
    ----------
    width, depth : array_like [um]
        Widths across the two pairs; alike only when their gaps are.

    Returns
    -------
    Array [um^2]
        The product.
    """
    return jnp.asarray(width) * depth
