"""Horizontal sections of a cavity: the area that the electrode sweeps in a layer.

A section is asked for its area at a *half width* X: the half width that the electrode's
outer edge is programmed to. The side gap (overcut) widens the cut on every side by
``gap``, so the cleared half width is X + gap.

Lengths in um, areas in um^2.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jax import Array
from jax.typing import ArrayLike

from procmodel.errors import InputError

# Segments per quarter circle of the round corners: at 128 the polygon misses 2.5e-5 of a
# corner's area, far below what the side gap is known to.
_QUAD_SEGMENTS = 128


class Section(eqx.Module):
    """A family of similar horizontal sections, told apart by their half width."""

    @abc.abstractmethod
    def area(self, half_width: ArrayLike, gap: ArrayLike = 0.0) -> Array:
        """Area cleared at a programmed half width.

        Parameters
        ----------
        half_width : array_like [um]
            Programmed half width X; any shape.
        gap : array_like [um]
            Side gap on every wall.

        Returns
        -------
        Array [um^2]
            Layer area S_w, of the broadcast shape.
        """


class SquareSection(Section):
    """Square section, eq. (5) of Yu and Masuzawa: S_w = 4 (X + gap)^2.

    Parameters
    ----------
    corner_radius : float [um]
        Radius of the round electrode whose corners stay uncut: the corner is then rounded
        with this radius + gap. 0 for the sharp square of eq. (5). Where the half width is below
        the radius, the electrode alone cuts its own circle.
    """

    corner_radius: ArrayLike = 0.0

    def area(self, half_width: ArrayLike, gap: ArrayLike = 0.0) -> Array:
        """Area cleared at a programmed half width [um^2]; see `Section.area`."""
        radius = jnp.asarray(self.corner_radius)
        half_width = jnp.asarray(half_width)
        half_width = jnp.where(radius > 0, jnp.maximum(half_width, radius), half_width)
        cleared = half_width + jnp.asarray(gap)
        rounding = jnp.where(radius > 0, radius + jnp.asarray(gap), 0.0)
        return 4.0 * cleared**2 - (4.0 - jnp.pi) * rounding**2


class CircleSection(Section):
    """Circular section: S_w = pi (X + gap)^2."""

    def area(self, half_width: ArrayLike, gap: ArrayLike = 0.0) -> Array:
        """Area cleared at a programmed half width [um^2]; see `Section.area`."""
        return jnp.pi * (jnp.asarray(half_width) + jnp.asarray(gap)) ** 2


class AnnulusSection(Section):
    """Ring that a finishing pass removes: a section less the same section, narrower.

    Parameters
    ----------
    outer : Section
        The section after finishing.
    thickness : array_like [um]
        Radial thickness removed, one for all layers or one for each. The uniform wear method wants
        more than half the electrode's size, so that the bottom does the cutting (section 3.4).
    """

    outer: Section
    thickness: ArrayLike

    def area(self, half_width: ArrayLike, gap: ArrayLike = 0.0) -> Array:
        """Area of the ring at a programmed outer half width [um^2]; see `Section.area`.

        Where the ring is thicker than the half width the whole section counts.
        """
        half_width = jnp.asarray(half_width)
        remaining = half_width - jnp.asarray(self.thickness)
        left = remaining > -jnp.asarray(gap)
        inside = self.outer.area(jnp.where(left, remaining, half_width), gap)
        return self.outer.area(half_width, gap) - jnp.where(left, inside, 0.0)


class PolygonSection(Section):
    """Any polygon, shrunk in parallel for the deeper layers; the electrode rounds its corners.

    The area is that of the morphological opening of the cleared polygon by a disc of the
    electrode's radius + gap: what a round electrode can clear, shapely's polygons with 128
    segments per quarter circle. Necks narrower than the electrode stay uncut; where nothing of a
    layer is wide enough, the electrode plunges and cuts its own circle.

    Parameters
    ----------
    vertices : array_like, shape (m, 2) [um]
        The programmed section of the first layer, not closed, either orientation.
    electrode_radius : float [um]
        Radius of the electrode, > 0.

    Attributes
    ----------
    half_width : float [um]
        Half width of the given polygon: the radius of its largest inscribed circle.

    Raises
    ------
    InputError
        If the vertices do not make a simple polygon, or the electrode does not fit.
    """

    vertices: tuple[tuple[float, float], ...] = eqx.field(static=True)
    electrode_radius: ArrayLike
    half_width: float = eqx.field(static=True)

    def __init__(self, vertices: ArrayLike, electrode_radius: float):
        corners = np.asarray(vertices, float)
        if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
            raise InputError("vertices must be at least three (x, y) pairs in um.")
        if not np.all(np.isfinite(corners)):
            raise InputError("vertices must be finite numbers: correct those that are not.")
        polygon = shapely.Polygon(corners)
        if not polygon.is_valid:
            reason = shapely.is_valid_reason(polygon)
            raise InputError(f"vertices cross or repeat ({reason}): list the corners in order.")
        inscribed = shapely.maximum_inscribed_circle(polygon, tolerance=1e-6)
        if not 0 < electrode_radius <= inscribed.length * (1 + 1e-6):
            raise InputError(
                f"electrode_radius {electrode_radius:g} um does not fit the polygon, whose largest "
                f"inscribed circle has a radius of {inscribed.length:g} um: go thinner."
            )
        self.vertices = tuple((float(x), float(y)) for x, y in corners)
        self.electrode_radius = electrode_radius
        self.half_width = float(inscribed.length)

    def area(self, half_width: ArrayLike, gap: ArrayLike = 0.0) -> Array:
        """Area cleared at a programmed half width [um^2]; see `Section.area`."""
        inset = self.half_width - jnp.asarray(half_width) + jnp.asarray(self.electrode_radius)
        reach = jnp.asarray(self.electrode_radius) + jnp.asarray(gap)
        inset, reach = jnp.broadcast_arrays(inset, reach)
        return _swept_area(self.vertices, inset, reach)


@jax.custom_jvp
def _swept_area_of(vertices: Array, inset: Array, reach: Array) -> Array:
    """Area of the polygon eroded by `inset` and then dilated by `reach`, elementwise."""
    shape = jax.ShapeDtypeStruct(inset.shape, inset.dtype)
    return jax.pure_callback(
        _shapely_areas, shape, vertices, inset, reach, vmap_method="sequential"
    )


@_swept_area_of.defjvp
def _swept_area_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    # Away from the insets where an edge vanishes the area is quadratic in both lengths, so
    # central differences are exact; the step only has to stay clear of rounding.
    vertices, inset, reach = primals
    _, inset_tangent, reach_tangent = tangents
    step = 1e-3
    by_inset = _swept_area_of(vertices, inset + step, reach)
    by_inset = (by_inset - _swept_area_of(vertices, inset - step, reach)) / (2 * step)
    by_reach = _swept_area_of(vertices, inset, reach + step)
    by_reach = (by_reach - _swept_area_of(vertices, inset, reach - step)) / (2 * step)
    tangent = by_inset * inset_tangent + by_reach * reach_tangent
    return _swept_area_of(vertices, inset, reach), tangent


def _swept_area(vertices: tuple[tuple[float, float], ...], inset: Array, reach: Array) -> Array:
    return _swept_area_of(jnp.asarray(vertices), inset, reach)


def _shapely_areas(vertices: np.ndarray, inset: np.ndarray, reach: np.ndarray) -> np.ndarray:
    polygon = shapely.Polygon(np.asarray(vertices))
    insets, reaches = np.asarray(inset, float), np.asarray(reach, float)
    areas = [
        _dilated_area(polygon, e, r) for e, r in zip(insets.ravel(), reaches.ravel(), strict=True)
    ]
    return np.asarray(areas).reshape(insets.shape).astype(np.asarray(inset).dtype)


def _dilated_area(polygon: shapely.Polygon, inset: float, reach: float) -> float:
    """Area of the electrode centre's region (the polygon eroded) grown by the reach."""
    centres = polygon.buffer(-inset, quad_segs=_QUAD_SEGMENTS)
    if centres.is_empty:
        # Narrower than the electrode everywhere: it plunges, and cuts its own circle.
        return np.pi * max(reach, 0.0) ** 2
    return centres.buffer(reach, quad_segs=_QUAD_SEGMENTS).area
