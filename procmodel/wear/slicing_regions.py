"""The layers of a cavity as polygons with islands, and what an electrode makes of them.

Lengths in um, areas in um^2, z downwards from the workpiece surface.
"""

import math
from dataclasses import dataclass
from typing import Literal

import jax.numpy as jnp
import numpy as np
import shapely

from procmodel.errors import InputError
from procmodel.precision import require_float64
from procmodel.wear.layer_path import ElectrodeSection
from procmodel.wear.slicing_reach import check_gap, dilate, erode, inscribed_radius, polygons_of
from procmodel.wear.solids import TargetLayers

# Of the electrode's area: a place out of reach that is not worth looking at.
_SPECK = 0.02
# How near outlines touch [um].
_TOUCH = 1e-3


@dataclass(frozen=True)
class Reach:
    """What an electrode makes of every layer.

    Attributes
    ----------
    reachable : tuple of shapely geometries
        Where its centre may go.
    cleared : tuple of shapely geometries
        What it clears from there, side gap included.
    narrow : tuple of int
        Layers, from 1, in which it fits nowhere; there it is taken to plunge in the middle of the
        widest place.
    lost : tuple of int
        Layers, from 1, of which whole parts stay uncut because it fits into others only.
    """

    reachable: tuple[shapely.Geometry, ...]
    cleared: tuple[shapely.Geometry, ...]
    narrow: tuple[int, ...]
    lost: tuple[int, ...]


@dataclass(frozen=True)
class Slices:
    """Layers of a wanted cavity, from the surface down.

    Attributes
    ----------
    bottom, thickness : ndarray, shape (n,) [um]
        Depth of the bottom of every layer, and its thickness.
    regions : tuple of shapely geometries, length n
        Polygon or multi-polygon that is to be cleared in every layer; holes are islands.
    clipped : tuple of int
        Layers, from 1, that were wider than those above them and have been clipped to them.
    """

    bottom: np.ndarray
    thickness: np.ndarray
    regions: tuple[shapely.Geometry, ...]
    clipped: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.regions)

    @property
    def areas(self) -> np.ndarray:
        """Area wanted in every layer, shape (n,) [um^2]."""
        return shapely.area(np.array(self.regions, dtype=object))

    @property
    def islands(self) -> np.ndarray:
        """Number of islands in every layer, shape (n,)."""
        return np.array(
            [sum(len(p.interiors) for p in shapely.get_parts(region)) for region in self.regions]
        )

    @property
    def volume(self) -> float:
        """Volume of the staircase [um^3]."""
        return float(np.sum(self.areas * self.thickness))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Least x and y, greatest x and y of all layers [um]."""
        left, low, right, high = shapely.total_bounds(np.array(self.regions, dtype=object))
        return float(left), float(low), float(right), float(high)

    def reach(
        self,
        electrode: ElectrodeSection,
        gap: float = 0.0,
        narrow: Literal["refuse", "plunge"] = "refuse",
    ) -> Reach:
        """Where the electrode's centre may go in every layer, and what it clears.

        Parameters
        ----------
        electrode : ElectrodeSection
            Its section.
        gap : float [um]
            Side gap, >= 0.
        narrow : {"refuse", "plunge"}
            What becomes of a layer narrower than electrode and gap: an error, or a single plunge
            that cuts more than the layer asks for.

        Returns
        -------
        Reach
            The regions.

        Raises
        ------
        InputError
            If the gap is below 0, or the electrode is larger than the narrowest section.
        """
        check_gap(gap)
        if narrow not in ("refuse", "plunge"):
            raise InputError(f"narrow {narrow!r} is unknown: give refuse or plunge.")
        reachable, cleared, too_narrow, lost = [], [], [], []
        for n, region in enumerate(self.regions, start=1):
            places = erode(region, electrode, gap)
            if places.is_empty:
                if narrow == "refuse":
                    raise self._too_narrow(n, electrode, gap)
                too_narrow.append(n)
                middle = shapely.get_point(shapely.maximum_inscribed_circle(_largest(region)), 0)
                places = middle
            clear = dilate(places, electrode, gap)
            parts = shapely.get_parts(region)
            if len(parts) > 1 and not shapely.intersects(parts, clear).all():
                lost.append(n)
            reachable.append(places)
            cleared.append(clear)
        return Reach(tuple(reachable), tuple(cleared), tuple(too_narrow), tuple(lost))

    def target_layers(
        self,
        electrode: ElectrodeSection | None = None,
        gap: float = 0.0,
        reach: Reach | None = None,
    ) -> TargetLayers:
        """The layers as the schedules take them.

        Parameters
        ----------
        electrode : ElectrodeSection, optional
            With it the areas are those that it clears: corners rounded, necks uncut. Without it
            they are those of the regions.
        gap : float [um]
            Side gap; the regions are the finished walls, so it is inside them.
        reach : Reach, optional
            What `reach` gave for the same electrode and gap, to spare the work.

        Returns
        -------
        TargetLayers
            Half widths are the radii of the largest circles inside the regions.

        Raises
        ------
        InputError
            As `reach`.
        """
        require_float64("A sliced cavity")
        areas = self.areas
        if electrode is not None:
            reach = reach if reach is not None else self.reach(electrode, gap)
            areas = shapely.area(np.array(reach.cleared, dtype=object))
        return TargetLayers(
            bottom=jnp.asarray(self.bottom),
            thickness=jnp.asarray(self.thickness),
            half_width=jnp.asarray([inscribed_radius(region) for region in self.regions]),
            area=jnp.asarray(areas),
        )

    def out_of_reach(self, reach: Reach) -> shapely.Geometry:
        """Places that some layer wants cleared and the electrode cannot clear there.

        Parameters
        ----------
        reach : Reach
            From `reach`, of these slices.

        Returns
        -------
        shapely geometry
            Corners and passages that stay uncut, seen from above.
        """
        pairs = zip(self.regions, reach.cleared, strict=True)
        return shapely.union_all([region.difference(cleared) for region, cleared in pairs])

    def closed_passages(self, reach: Reach, electrode: ElectrodeSection) -> tuple[int, ...]:
        """Layers in which more than corners stays uncut.

        Parameters
        ----------
        reach : Reach
            From `reach`, of these slices.
        electrode : ElectrodeSection
            The electrode.

        Returns
        -------
        tuple of int
            Layers, from 1, with a place out of reach between places that are cleared, or as large
            as the electrode's own section.
        """
        found = []
        for n, (region, cleared) in enumerate(
            zip(self.regions, reach.cleared, strict=True), start=1
        ):
            if n in reach.narrow:
                continue
            pieces = shapely.get_parts(region.difference(cleared))
            pieces = pieces[shapely.area(pieces) > _SPECK * electrode.area]
            if any(p.area > electrode.area or _sides(p, cleared) > 1 for p in pieces):
                found.append(n)
        return tuple(found)

    def above(self, layer: int) -> "Slices":
        """The layers above a layer, which is counted from 1, without it."""
        kept = layer - 1
        return Slices(
            self.bottom[:kept],
            self.thickness[:kept],
            self.regions[:kept],
            tuple(n for n in self.clipped if n <= kept),
        )

    def inset(self, thickness: float) -> "Slices":
        """The layers without a ring along every wall, which is left for finishing.

        Parameters
        ----------
        thickness : float [um]
            Thickness of the ring, > 0.

        Returns
        -------
        Slices
            The layers down to the last one that is not all ring.

        Raises
        ------
        InputError
            If the thickness is not above 0, or leaves nothing of the first layer.
        """
        if not (math.isfinite(thickness) and thickness > 0):
            raise InputError(f"finishing thickness {thickness:g} um must be above 0.")
        regions = [polygons_of(r.buffer(-thickness, quad_segs=16)) for r in self.regions]
        count = next((n for n, region in enumerate(regions) if region.is_empty), len(regions))
        if count == 0:
            raise InputError(
                f"finishing thickness {thickness:g} um leaves nothing to rough in layer 1: it must "
                f"be below the half width {inscribed_radius(self.regions[0]):.4g} um."
            )
        kept = self.above(count + 1)
        return Slices(kept.bottom, kept.thickness, tuple(regions[:count]), kept.clipped)

    def _too_narrow(self, layer: int, electrode: ElectrodeSection, gap: float) -> InputError:
        width = 2 * inscribed_radius(self.regions[layer - 1])
        top = self.bottom[layer - 1] - self.thickness[layer - 1]
        name = "diameter" if electrode.shape == "round" else "side"
        above = f"end the cavity at a depth of {top:g} um, or " if layer > 1 else ""
        return InputError(
            f"electrode {name} {electrode.size:g} um with a side gap of {gap:g} um is larger than "
            f"the section of layer {layer} at the depth {self.bottom[layer - 1]:g} um, {width:.4g} "
            f"um at its widest: {above}take a thinner electrode."
        )


def _largest(region: shapely.Geometry) -> shapely.Geometry:
    parts = shapely.get_parts(region)
    return parts[int(np.argmax(shapely.area(parts)))]


def _sides(piece: shapely.Geometry, cleared: shapely.Geometry) -> int:
    """Along how many stretches of its outline a piece touches what is cleared."""
    shared = shapely.line_merge(piece.boundary.intersection(cleared.buffer(_TOUCH)))
    return sum(part.length > 10.0 * _TOUCH for part in shapely.get_parts(shared))
