"""What a path has cleared of a layer, what it has missed, and how long it takes."""

import math
from dataclasses import dataclass

import numpy as np
import shapely

from procmodel.errors import InputError
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.slicing_reach import QUAD_SEGMENTS, check_gap, dilate, erode


@dataclass(frozen=True)
class Coverage:
    """A layer after its path.

    Attributes
    ----------
    region, reach : float [um^2]
        Area wanted, and the area that the electrode can clear of it.
    missed : float [um^2]
        Area of what it can clear that the path leaves standing.
    beyond : float [um^2]
        Area cut outside the wanted region.
    """

    region: float
    reach: float
    missed: float
    beyond: float

    @property
    def uncovered_share(self) -> float:
        """Share of what the electrode can clear that the path leaves standing."""
        return self.missed / self.reach if self.reach > 0 else 0.0


@dataclass(frozen=True)
class Rates:
    """How fast the machine moves.

    Parameters
    ----------
    scan, plunge, rapid : float [um/s]
        Along the path, downwards, and lifted.
    lift : float [um]
        How far it is lifted for a move above the workpiece.

    Raises
    ------
    InputError
        If one of them is not above 0.
    """

    scan: float
    plunge: float
    rapid: float = 10_000.0
    lift: float = 1000.0

    def __post_init__(self) -> None:
        for name in ("scan", "plunge", "rapid", "lift"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"{name} rate or height {value:g} must be above 0.")


def sweep(
    path: LayerPath,
    electrode: ElectrodeSection,
    gap: float = 0.0,
    quad_segments: int = QUAD_SEGMENTS,
) -> shapely.Geometry:
    """Region that the electrode clears on a path.

    Parameters
    ----------
    path : LayerPath
        The way of its centre; lifted moves clear nothing, the place where it comes down again
        does.
    electrode : ElectrodeSection
        Its section. A square stays one after quarter turns.
    gap : float [um]
        Side gap.
    quad_segments : int
        Segments per quarter circle.

    Returns
    -------
    shapely geometry
        The cleared region.
    """
    runs = np.split(np.arange(len(path.points)), np.flatnonzero(~path.cutting) + 1)
    lines = [path.points[run] for run in runs]
    places = [shapely.Point(p[0]) if len(p) == 1 else shapely.LineString(p) for p in lines]
    visited = places[0] if len(places) == 1 else shapely.GeometryCollection(places)
    return dilate(visited, electrode, gap, quad_segments)


def coverage(
    path: LayerPath,
    region: shapely.Geometry,
    electrode: ElectrodeSection,
    gap: float = 0.0,
    cleared: shapely.Geometry | None = None,
) -> Coverage:
    """Compare what a path clears with the region that is wanted.

    Parameters
    ----------
    path : LayerPath
        The way of the electrode's centre.
    region : shapely geometry [um]
        The finished layer, side gap inside it.
    electrode : ElectrodeSection
        Its section.
    gap : float [um]
        Side gap.
    cleared : shapely geometry, optional [um]
        What the electrode can clear of the region, as `Slices.reach` gives it, to spare the work.

    Returns
    -------
    Coverage
        The areas.

    Raises
    ------
    InputError
        If the gap is below 0.
    """
    check_gap(gap)
    swept = sweep(path, electrode, gap)
    wanted = cleared
    if wanted is None:
        wanted = dilate(erode(region, electrode, gap), electrode, gap)
    return Coverage(
        region=region.area,
        reach=wanted.area,
        missed=wanted.difference(swept).area,
        beyond=swept.difference(region).area,
    )


def path_time(path: LayerPath, feed: float, rates: Rates) -> float:
    """Time of the moves of a layer, if the discharge keeps up with them.

    Parameters
    ----------
    path : LayerPath
        The way of the electrode's centre.
    feed : float [um]
        Feed of the layer, plunged at the start and after every lifted move.
    rates : Rates
        How fast the machine moves.

    Returns
    -------
    float [s]
        Scanning, plunging, and lifting between layers and on the way.
    """
    lifts = 1 + int(np.sum(~path.cutting))
    return (
        path.length / rates.scan
        + lifts * feed / rates.plunge
        + (path.lifted_length + 2 * lifts * rates.lift) / rates.rapid
    )
