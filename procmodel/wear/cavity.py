"""The cavity that a list of layer feeds cuts, and its wall.

Lengths in um, areas in um^2.
"""

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from procmodel.wear.layers import cavity_depths, electrode_wear
from procmodel.wear.sections import AnnulusSection, Section


class LayeredCavity(eqx.Module):
    """A cavity cut layer by layer, each with its own half width and feed.

    A finishing stage is the same thing with an `AnnulusSection` and its own wear ratio.

    Parameters
    ----------
    half_widths : array_like, shape (n,) [um]
        Programmed half width of every layer, from the surface down, not increasing.
    feeds : array_like, shape (n,) or scalar [um]
        Feed of every layer.
    section : Section
        Shape of the layers.
    wear_ratio : array_like [-]
        Volumetric wear ratio R of this stage.
    electrode_area : array_like [um^2]
        Cross-section S_e of the electrode of this stage.
    gap : array_like [um]
        Side gap (overcut) on every wall.
    """

    half_widths: ArrayLike
    feeds: ArrayLike
    section: Section
    wear_ratio: ArrayLike
    electrode_area: ArrayLike
    gap: ArrayLike = 0.0

    @property
    def layer_areas(self) -> Array:
        """Area cleared in every layer, shape (n,) [um^2]."""
        return self.section.area(self.half_widths, self.gap)

    @property
    def depths(self) -> Array:
        """Depth after every layer, eq. (4) of Yu and Masuzawa, shape (n,) [um]."""
        return cavity_depths(self.feeds, self.layer_areas, self.wear_ratio, self.electrode_area)

    @property
    def electrode_wear(self) -> Array:
        """Electrode length lost in every layer, shape (n,) [um]."""
        return electrode_wear(self.feeds, self.layer_areas, self.wear_ratio, self.electrode_area)

    @property
    def electrode_length(self) -> Array:
        """Electrode length the whole stage consumes, R V / S_e [um]."""
        return jnp.sum(self.electrode_wear)

    @property
    def wall_positions(self) -> Array:
        """Distance of the wall from the centre in every layer, X_n + gap, shape (n,) [um]."""
        return jnp.asarray(self.half_widths) + jnp.asarray(self.gap)

    def wall_depth(self, position: ArrayLike, edge_width: ArrayLike = 0.0) -> Array:
        """Depth of the wall curve; see `wall_depth`."""
        return wall_depth(position, self.wall_positions, self.depths, edge_width)


class StagedCavity(eqx.Module):
    """Roughing followed by finishing: each with its own electrode, wear ratio and feeds.

    Parameters
    ----------
    roughing : LayeredCavity
        Clears the inside.
    finishing : LayeredCavity
        Takes off the ring that roughing left on the wall; an `AnnulusSection`.
    """

    roughing: LayeredCavity
    finishing: LayeredCavity

    def wall_depth(self, position: ArrayLike, edge_width: ArrayLike = 0.0) -> Array:
        """Depth of the finished wall: the roughed floor, the finished wall outside it."""
        rough = self.roughing.wall_depth(position, edge_width)
        finished = self.finishing.wall_depth(position, edge_width)
        innermost = self.finishing.wall_positions[-1] - self._ring
        in_ring = jnp.abs(jnp.asarray(position)) >= innermost
        return jnp.maximum(rough, jnp.where(in_ring, finished, 0.0))

    @property
    def _ring(self) -> Array:
        """Thickness of the last finishing layer; the whole width if it is no ring."""
        section = self.finishing.section
        if not isinstance(section, AnnulusSection):
            return self.finishing.wall_positions[-1]
        return jnp.broadcast_to(section.thickness, self.finishing.wall_positions.shape)[-1]

    @property
    def electrode_lengths(self) -> Array:
        """Electrode length consumed in (roughing, finishing), shape (2,) [um]."""
        return jnp.stack([self.roughing.electrode_length, self.finishing.electrode_length])


def wall_depth(
    position: ArrayLike, wall_positions: ArrayLike, depths: ArrayLike, edge_width: ArrayLike = 0.0
) -> Array:
    """Wall curve of a layered cavity, drawn through the outer bottom corners of the layers.

    The curve of figs 15 and 16 of Yu and Masuzawa: linear between the corners (X_n, Z_n),
    the floor Z_N inside the last one, and the untouched surface outside the first one.

    Parameters
    ----------
    position : array_like, shape (m,) [um]
        Signed distance from the centre.
    wall_positions : array_like, shape (n,) [um]
        Distance of the wall from the centre in every layer, not increasing.
    depths : array_like, shape (n,) [um]
        Depth after every layer.
    edge_width : array_like [um]
        Width over which the first layer's edge falls from Z_1 to 0. At 0 the edge is a step.

    Returns
    -------
    Array, shape (m,) [um]
        Depth at every position, positive downwards.
    """
    distance = jnp.abs(jnp.asarray(position))
    walls, depths = jnp.asarray(wall_positions)[::-1], jnp.asarray(depths)[::-1]
    inside = jnp.interp(distance, walls, depths)
    beyond = distance - walls[-1]
    width = jnp.asarray(edge_width)
    ramp = jnp.clip(1.0 - beyond / jnp.where(width > 0, width, 1.0), 0.0, 1.0)
    edge = jnp.where(width > 0, ramp, jnp.where(beyond > 0, 0.0, 1.0))
    return jnp.where(beyond > 0, depths[-1] * edge, inside)


def constant_step_half_widths(half_width: float, step: float, layers: int) -> Array:
    """Half widths of a test cavity: X_n = X_0 - (n - 1) dX.

    Parameters
    ----------
    half_width : float [um]
        Half width of the first layer, X_0.
    step : float [um]
        How much narrower every layer is than the one above, dX.
    layers : int
        Number of layers.

    Returns
    -------
    Array, shape (layers,) [um]
        The half widths.
    """
    return half_width - step * jnp.arange(layers)
