"""Scanning paths of the layers by the rules of the uniform wear method.

Yu and Masuzawa, section 2, keep the electrode's bottom flat by four rules: scan to and fro over the
same path and change the main direction after every pair (figs 2 and 3), overlap the lines (fig. 4),
cut the inside and the periphery in turn; slots narrow as the electrode are cut in one line with the
electrode turned by 90 degrees after every layer (fig. 9). Lengths in um.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely

from procmodel.errors import InputError, nearest
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.scanning_contour import add_contours, add_rings
from procmodel.wear.scanning_coverage import Coverage, Rates, coverage, path_time, sweep
from procmodel.wear.scanning_links import Way, nearest_first
from procmodel.wear.scanning_mop_up import mop_up
from procmodel.wear.scanning_raster import raster_pieces
from procmodel.wear.slicing import Reach, Slices
from procmodel.wear.slicing_reach import FIT, check_gap, erode, polygon_parts

__all__ = [
    "PATTERNS",
    "Coverage",
    "Rates",
    "ScanningRules",
    "coverage",
    "finish_layer",
    "finishing_caution",
    "path_time",
    "scan_layer",
    "scan_layers",
    "sweep",
]

Pattern = Literal["raster", "contour", "alternate"]
# Way through a layer [um] beyond which the part's unit is wrong.
_LONGEST = 1e7
PATTERNS = ("raster", "contour", "alternate")
# Of the electrode's size: how wide the reachable region of a slot may be.
_SLOT = 0.02


@dataclass(frozen=True)
class ScanningRules:
    """The rules of the uniform wear method, each of which can be switched off.

    Parameters
    ----------
    to_and_fro : bool
        Every second layer follows its path from the end to the start. Off: always from the start.
    alternate_direction : bool
        After every pair of layers (every layer without `to_and_fro`) lines change from x to y, and
        contours begin a quarter turn further. Off: always along x, always at the same corner.
    overlap : float
        Share of the electrode's size by which neighbouring lines overlap, from 0 to below 1; what
        still stays between them is gone over at the end. At 0 the rule is off: lines are the
        electrode's size apart.
    inside_and_periphery : bool
        Lines inside and a contour at the wall, in changing order. Off: lines alone, and contours
        always from the wall inwards.

    Raises
    ------
    InputError
        If the overlap is out of its range.
    """

    to_and_fro: bool = True
    alternate_direction: bool = True
    overlap: float = 0.2
    inside_and_periphery: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.overlap < 1:
            raise InputError(
                f"overlap {self.overlap:g} must be a share of the electrode's size from 0 to "
                "below 1."
            )


def scan_layer(
    region: shapely.Geometry,
    electrode: ElectrodeSection,
    gap: float = 0.0,
    rules: ScanningRules = ScanningRules(),
    number: int = 1,
    pattern: Pattern = "contour",
) -> LayerPath:
    """Path of the electrode's centre that clears a layer.

    Parameters
    ----------
    region : shapely geometry [um]
        The finished layer, side gap inside it; holes are islands.
    electrode : ElectrodeSection
        Its section.
    gap : float [um]
        Side gap.
    rules : ScanningRules
        What is alternated and overlapped.
    number : int
        Number of the layer, from 1: the rules alternate by it.
    pattern : {"raster", "contour", "alternate"}
        Parallel lines; contours from the wall inwards (concentric squares and circles, figs 5 and
        18); or pairs of layers of each in turn.

    Returns
    -------
    LayerPath
        The path. The electrode is lifted only where it can neither go straight nor along a wall.

    Raises
    ------
    InputError
        If the pattern is unknown, the number below 1, the gap below 0, or the electrode does not
        fit.
    """
    check_gap(gap)
    reachable = erode(region, electrode, gap)
    if reachable.is_empty:
        raise InputError(
            f"electrode size {electrode.size:g} um with a side gap of {gap:g} um does not fit into "
            f"layer {number}: take a thinner electrode."
        )
    return _scan(reachable, electrode, gap, rules, number, pattern)


def scan_layers(
    slices: Slices,
    electrode: ElectrodeSection,
    gap: float = 0.0,
    rules: ScanningRules = ScanningRules(),
    pattern: Pattern = "contour",
    reach: Reach | None = None,
) -> list[LayerPath]:
    """Paths of all layers.

    Parameters
    ----------
    slices : Slices
        The layers.
    electrode, gap, rules, pattern
        See `scan_layer`.
    reach : Reach, optional
        What `Slices.reach` gave for the same electrode and gap; with narrow="plunge" too narrow
        layers become a single plunge.

    Returns
    -------
    list of LayerPath
        One path for every layer.

    Raises
    ------
    InputError
        As `scan_layer`; the text names the layer.
    """
    reach = reach if reach is not None else slices.reach(electrode, gap)
    widest = max(region.area for region in reach.reachable)
    length = widest / (electrode.size * (1.0 - rules.overlap))
    if length > _LONGEST:
        raise InputError(
            f"the widest layer, {widest / 1e6:.4g} mm^2, would take about {length / 1e6:.3g} m of "
            f"path with an electrode of {electrode.size:g} um: check the unit of the part, or take "
            "a larger electrode."
        )
    return [
        _scan(reachable, electrode, gap, rules, n, pattern)
        for n, reachable in enumerate(reach.reachable, start=1)
    ]


def finish_layer(
    region: shapely.Geometry,
    thickness: float,
    electrode: ElectrodeSection,
    gap: float = 0.0,
    rules: ScanningRules = ScanningRules(),
    number: int = 1,
) -> LayerPath:
    """Path along the wall that removes what roughing has left there (section 3.4).

    Parameters
    ----------
    region : shapely geometry [um]
        The finished layer.
    thickness : float [um]
        Thickness left at the wall, > 0; see `finishing_caution`.
    electrode, gap, rules, number
        See `scan_layer`.

    Returns
    -------
    LayerPath
        Along every wall, and a step further inside as often as the thickness needs.

    Raises
    ------
    InputError
        If the thickness is not above 0, or as `scan_layer`.
    """
    if not (math.isfinite(thickness) and thickness > 0):
        raise InputError(f"finishing thickness {thickness:g} um must be above 0.")
    check_gap(gap)
    reachable = erode(region, electrode, gap)
    if reachable.is_empty:
        raise InputError(
            f"electrode size {electrode.size:g} um with a side gap of {gap:g} um does not fit into "
            f"layer {number}: take a thinner electrode for finishing."
        )
    way = Way(reachable)
    direction = _direction(_block(rules, number), rules)
    step = electrode.size * (1 - rules.overlap)
    inset, covered = 0.0, electrode.size + gap
    while True:
        inside = reachable.buffer(-inset) if inset > 0 else reachable
        for part in polygon_parts(inside):
            add_rings(way, part, direction)
        if inside.is_empty or covered >= thickness:
            break
        inset, covered = inset + step, covered + step
    path = way.path()
    return path.reversed() if _is_reversed(rules, number) else path


def finishing_caution(thickness: float, electrode: ElectrodeSection) -> str | None:
    """What is wrong with a thickness left for finishing, if anything.

    Parameters
    ----------
    thickness : float [um]
        Thickness left at the wall.
    electrode : ElectrodeSection
        The finishing electrode.

    Returns
    -------
    str or None
        A warning when it is not thicker than half the electrode, whose bottom would then not wear
        evenly (section 3.4).
    """
    if thickness > electrode.half:
        return None
    return (
        "the ring left for finishing is not thicker than half the finishing electrode, "
        "which then cuts with its side and loses its shape: leave more or go thinner"
    )


def _block(rules: ScanningRules, number: int) -> int:
    """How often the main direction may have changed before a layer."""
    return (number - 1) // 2 if rules.to_and_fro else number - 1


def _is_reversed(rules: ScanningRules, number: int) -> bool:
    return rules.to_and_fro and number % 2 == 0


def _direction(block: int, rules: ScanningRules) -> np.ndarray:
    """Where contours begin; a quarter turn further from block to block."""
    turns = block % 4 if rules.alternate_direction else 0
    return np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)][turns])


def _scan(
    reachable: shapely.Geometry,
    electrode: ElectrodeSection,
    gap: float,
    rules: ScanningRules,
    number: int,
    pattern: str,
) -> LayerPath:
    if pattern not in PATTERNS:
        raise InputError(f"pattern {pattern!r} is unknown{nearest(pattern, PATTERNS)}.")
    if number < 1:
        raise InputError(f"layer number {number} must be 1 or more.")
    if reachable.geom_type == "Point":
        return LayerPath(shapely.get_coordinates(reachable), np.zeros(0, bool))
    slot = _slot_line(reachable, electrode)
    if slot is not None:
        turns = (number - 1) % 4 if electrode.shape == "square" else 0
        ends = np.vstack([slot, slot[:1]]) if rules.to_and_fro else slot
        return LayerPath(ends, np.ones(len(ends) - 1, bool), turns)
    block = _block(rules, number)
    raster = pattern == "raster" or (pattern == "alternate" and block % 2 == 0)
    if pattern == "alternate":
        block //= 2
    step = electrode.size * (1 - rules.overlap)
    way = Way(reachable)
    if raster:
        _add_raster(way, reachable, step, block, rules, number)
    else:
        for part in polygon_parts(reachable):
            add_contours(way, part, step, electrode.half, _direction(block, rules))
    if rules.overlap > 0:
        mop_up(way, reachable, electrode, gap)
    path = way.path()
    inwards_again = rules.inside_and_periphery and not rules.to_and_fro and number % 2 == 0
    turned = _is_reversed(rules, number) or (not raster and inwards_again)
    return path.reversed() if turned else path


def _add_raster(
    way: Way,
    reachable: shapely.Geometry,
    step: float,
    block: int,
    rules: ScanningRules,
    number: int,
) -> None:
    along = "y" if rules.alternate_direction and block % 2 == 1 else "x"
    contour = rules.inside_and_periphery
    pieces = raster_pieces(reachable, step, along, at_edges=not contour)
    # To and fro reverses every second layer and with it the order of inside and periphery.
    first = contour and not rules.to_and_fro and number % 2 == 0
    if contour and first:
        _add_periphery(way, reachable, block, rules)
    nearest_first([[[option] for option in piece] for piece in pieces], way)
    if contour and not first:
        _add_periphery(way, reachable, block, rules)


def _add_periphery(way: Way, reachable: shapely.Geometry, block: int, rules: ScanningRules) -> None:
    for part in polygon_parts(reachable):
        add_rings(way, part, _direction(block, rules))


def _slot_line(reachable: shapely.Geometry, electrode: ElectrodeSection) -> np.ndarray | None:
    """Both ends of the middle line of a region as thin as a line; None for any other."""
    width = _SLOT * electrode.size + 2 * FIT
    if reachable.area > width * reachable.length:  # twice as wide, at least
        return None
    box = shapely.minimum_rotated_rectangle(reachable)
    if box.geom_type != "Polygon":
        return None
    corners = shapely.get_coordinates(box)[:4]
    sides = np.hypot(*(corners - np.roll(corners, -1, axis=0)).T)
    if min(sides[0], sides[1]) > width or max(sides[0], sides[1]) <= 2 * width:
        return None
    if sides[0] > sides[1]:
        corners = np.roll(corners, -1, axis=0)
    line = np.array([(corners[0] + corners[1]) / 2, (corners[2] + corners[3]) / 2])
    return line[np.lexsort((line[:, 1], line[:, 0]))]
