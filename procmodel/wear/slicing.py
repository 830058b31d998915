"""A wanted cavity cut into layers: the section of every layer as polygons with islands.

Meshes, depth maps, outlines and parametric solids all become `Slices`, so that areas, scanning
paths and checks have one way to go. Lengths in um, areas in um^2, z downwards from the workpiece
surface.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
import shapely

from procmodel.errors import InputError, nearest
from procmodel.wear.sections import CircleSection, PolygonSection, SquareSection
from procmodel.wear.slicing_layers import Mesh
from procmodel.wear.slicing_planes import Side, cut_mesh
from procmodel.wear.slicing_reach import polygons_of
from procmodel.wear.slicing_regions import Reach, Slices
from procmodel.wear.solids import Hemisphere, Solid, TaperedSolid

__all__ = [
    "LEVELS",
    "DepthGrid",
    "Reach",
    "Slices",
    "Surface",
    "map_surface",
    "slice_mesh",
    "slices_of_depth_map",
    "slices_of_outline",
    "slices_of_slot",
    "slices_of_solid",
]

LEVELS = {"top": 0.0, "middle": 0.5, "bottom": 1.0}
# How far a circle may stray from the polygon that stands for it [um].
_CHORD = 0.01


class DepthGrid(Protocol):
    """Depth over a grid."""

    @property
    def x(self) -> np.ndarray:
        """Places along x, shape (n,) [um]."""

    @property
    def y(self) -> np.ndarray:
        """Places along y, shape (m,) [um]."""

    @property
    def depth(self) -> np.ndarray:
        """Depth at (x[i], y[j]), shape (n, m) [um]."""


@dataclass(frozen=True)
class Surface:
    """Triangles.

    Attributes
    ----------
    vertices : ndarray, shape (n, 3) [um]
        Corners (x, y, depth).
    faces : ndarray, shape (m, 3)
        Corners of every triangle.
    """

    vertices: np.ndarray
    faces: np.ndarray


def slice_mesh(
    mesh: Mesh,
    bottoms: np.ndarray,
    level: str = "middle",
    undercut: Literal["refuse", "clip"] = "refuse",
    tolerance: float = 0.01,
) -> Slices:
    """Cut a closed mesh into layers.

    Parameters
    ----------
    mesh : Mesh
        The volume to be removed, depths counted downwards from the workpiece surface; see
        `procmodel.io.read_solid`.
    bottoms : ndarray, shape (n,) [um]
        Depth of the bottom of every layer; see `uniform_bottoms`, `layer_bottoms_by_tolerance`.
    level : {"top", "middle", "bottom"}
        Height within the layer at which its section is taken, always inside the layer: "bottom"
        cuts nothing outside a wall that narrows downwards, "middle" has the least volume error.
    undercut : {"refuse", "clip"}
        What becomes of a layer wider than those above it, which no electrode reaches from above.
    tolerance : float [um]
        Width up to which a layer may be wider all the same.

    Returns
    -------
    Slices
        The layers.

    Raises
    ------
    InputError
        If the level is unknown, the bottoms do not increase from above 0, a layer has nothing to
        cut, bodies overlap, or there are undercuts.
    """
    bottom, thickness, heights, side = _planes(bottoms, level)
    regions = cut_mesh(np.asarray(mesh.vertices, float), np.asarray(mesh.faces), heights, side)
    return _checked(bottom, thickness, regions, heights, undercut, tolerance)


def slices_of_depth_map(depth_map: DepthGrid, bottoms: np.ndarray, level: str = "middle") -> Slices:
    """Cut a depth map into layers; between its places the depth is linear over triangles.

    Parameters
    ----------
    depth_map : DepthGrid
        See `procmodel.io.read_depth_map`. Where the cavity reaches the edge of the map its wall
        is vertical there.
    bottoms, level
        See `slice_mesh`.

    Returns
    -------
    Slices
        The layers.

    Raises
    ------
    InputError
        As `slice_mesh`.
    """
    bottom, thickness, heights, side = _planes(bottoms, level)
    surface = map_surface(depth_map)
    regions = cut_mesh(surface.vertices, surface.faces, heights, side)
    return _checked(bottom, thickness, regions, heights, "clip", 0.01)


def map_surface(depth_map: DepthGrid) -> Surface:
    """Triangles between the places of a depth map, closed everywhere but at depth 0.

    Parameters
    ----------
    depth_map : DepthGrid
        The map.

    Returns
    -------
    Surface
        The triangles, with a vertical wall where the cavity reaches the edge of the map.
    """
    # A rim of depth 0 at the same places closes the sections at the edge.
    x, y = np.pad(depth_map.x, 1, mode="edge"), np.pad(depth_map.y, 1, mode="edge")
    z = np.pad(np.maximum(depth_map.depth, 0.0), 1)
    grid = np.stack([*np.meshgrid(x, y, indexing="ij"), z], axis=-1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape(z.shape)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    # The outward normal of a cavity's floor points downwards, along +z.
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    return Surface(grid, faces.reshape(-1, 3))


def slices_of_outline(
    outline: shapely.Polygon, bottoms: np.ndarray, wall_angle: float = math.pi / 2
) -> Slices:
    """Layers of a pocket with the same outline all the way down, or with straight sloped walls.

    Parameters
    ----------
    outline : shapely.Polygon [um]
        Outline at the workpiece surface.
    bottoms : ndarray, shape (n,) [um]
        Depth of the bottom of every layer.
    wall_angle : float [rad]
        Between wall and surface, up to pi/2; a layer takes its section at its top, as eq. (5).

    Returns
    -------
    Slices
        The layers.

    Raises
    ------
    InputError
        If the outline is no polygon, the angle is out of range, or a layer has nothing to cut.
    """
    if not (outline.is_valid and outline.area > 0):
        raise InputError("the outline encloses no area, or crosses itself: list it in order.")
    if not 0 < wall_angle <= math.pi / 2:
        raise InputError(
            f"wall angle {math.degrees(wall_angle):g} deg must be above 0 and at most 90."
        )
    bottom, thickness, heights, _ = _planes(bottoms, "top")
    insets = heights / math.tan(wall_angle) if wall_angle < math.pi / 2 else 0.0 * heights
    regions = [
        polygons_of(outline.buffer(-inset, join_style="mitre", mitre_limit=1e6))
        if inset > 0
        else outline
        for inset in insets
    ]
    return _checked(bottom, thickness, regions, heights, "clip", 0.01)


def slices_of_slot(length: float, width: float, bottoms: np.ndarray) -> Slices:
    """Layers of a slot with vertical walls, its middle at the origin, its length along x.

    Parameters
    ----------
    length, width : float [um]
        Finished size, side gap included.
    bottoms : ndarray, shape (n,) [um]
        Depth of the bottom of every layer.

    Returns
    -------
    Slices
        The layers.

    Raises
    ------
    InputError
        If a size is not above 0 or the slot is wider than long.
    """
    if not (math.isfinite(length) and 0 < width <= length):
        raise InputError(
            f"slot of length {length:g} and width {width:g} um: both must be above 0, the length "
            "not below the width."
        )
    box = shapely.box(-length / 2, -width / 2, length / 2, width / 2)
    return slices_of_outline(box, bottoms)


def slices_of_solid(solid: Solid, bottoms: np.ndarray, level: str = "paper") -> Slices:
    """Cut a pyramid, cone, hemisphere or shrinking polygon into layers.

    Parameters
    ----------
    solid : Solid
        The wanted cavity, its axis at the origin.
    bottoms : ndarray, shape (n,) [um]
        Depth of the bottom of every layer.
    level : {"paper", "top", "middle", "bottom"}
        See `procmodel.wear.slice_solid`.

    Returns
    -------
    Slices
        The layers. Circles are polygons within 0.01 um of the circle and with its area. A last
        layer that has nothing to cut, as the pole of a hemisphere by eq. (6), is left out.

    Raises
    ------
    InputError
        If the solid has no outline (a table of areas), the level is unknown, or a layer has
        nothing to cut.
    """
    if level == "paper":
        level = solid.paper_level
    bottom, thickness, heights, _ = _planes(bottoms, level)
    half_widths = np.asarray(solid.half_width(heights))
    if len(half_widths) > 1 and half_widths[-1] <= 1e-9 * half_widths[0]:
        bottom, thickness, heights = bottom[:-1], thickness[:-1], heights[:-1]
        half_widths = half_widths[:-1]
    regions = [_section(solid, float(half_width)) for half_width in half_widths]
    return _checked(bottom, thickness, regions, heights, "clip", 0.01)


def _section(solid: Solid, half_width: float) -> shapely.Geometry:
    section = solid.section if isinstance(solid, TaperedSolid) else None
    if half_width <= 0:
        return shapely.Polygon()
    if isinstance(section, SquareSection):
        return shapely.box(-half_width, -half_width, half_width, half_width)
    if isinstance(section, CircleSection) or isinstance(solid, Hemisphere):
        corners = 4 * max(8, math.ceil(math.pi / 4 / math.sqrt(2 * _CHORD / half_width)))
        angle = 2 * np.pi * np.arange(corners) / corners
        radius = half_width * math.sqrt(2 * np.pi / corners / math.sin(2 * np.pi / corners))
        return shapely.Polygon(radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    if isinstance(section, PolygonSection):
        inset = half_width - section.half_width
        return polygons_of(
            shapely.Polygon(section.vertices).buffer(inset, join_style="mitre", mitre_limit=1e6)
        )
    raise InputError(
        f"{type(solid).__name__} has areas but no outline: give a solid with a section, a mesh or "
        "a depth map."
    )


def _planes(bottoms: np.ndarray, level: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, Side]:
    """Bottoms, thicknesses, and the depths of the sections with the side they are taken on."""
    if level not in LEVELS:
        raise InputError(f"level {level!r} is unknown{nearest(level, tuple(LEVELS))}.")
    bottom = np.asarray(bottoms, float)
    if bottom.ndim != 1 or len(bottom) == 0:
        raise InputError("there are zero layers to slice: give at least one bottom.")
    thickness = np.diff(bottom, prepend=0.0)
    if not (np.all(np.isfinite(bottom)) and np.all(thickness > 0)):
        first = int(np.argmin(np.isfinite(bottom) & (thickness > 0))) + 1
        raise InputError(
            f"layer {first} ends at {bottom[first - 1]:g} um, which is not below the layer above "
            "it: give bottoms that increase from above 0."
        )
    heights = bottom - (1.0 - LEVELS[level]) * thickness
    return bottom, thickness, heights, "below" if level == "top" else "above"


def _checked(
    bottom: np.ndarray,
    thickness: np.ndarray,
    regions: Sequence[shapely.Geometry],
    heights: np.ndarray,
    undercut: str,
    tolerance: float,
) -> Slices:
    """Slices, after refusing empty layers and refusing or clipping undercuts."""
    if undercut not in ("refuse", "clip"):
        raise InputError(f"undercut {undercut!r} is unknown: give refuse or clip.")
    array = np.array(regions, dtype=object)
    empty = np.flatnonzero(shapely.area(array) <= 0)
    if len(empty):
        first = int(empty[0])
        raise InputError(
            f"layer {first + 1} at the depth {heights[first]:g} um has nothing to cut: end the "
            f"cavity at {bottom[first] - thickness[first]:g} um, or check its depth."
        )
    beyond = shapely.area(shapely.difference(array[1:], array[:-1]))
    wider = np.flatnonzero(beyond > tolerance * shapely.length(array[1:])) + 1
    if len(wider) and undercut == "refuse":
        first = int(wider[0])
        raise InputError(
            f"layer {first + 1} at the depth {heights[first]:g} um is undercut: "
            f"{beyond[first - 1]:.4g} um^2 of it lie under the wall above, where no electrode "
            "comes from above; change the part, or let undercuts be clipped."
        )
    clipped = []
    if len(wider):
        for n in range(int(wider[0]), len(array)):
            whole = array[n]
            array[n] = polygons_of(shapely.intersection(whole, array[n - 1]))
            if whole.area - array[n].area > tolerance * whole.length:
                clipped.append(n + 1)
    return Slices(bottom, thickness, tuple(array), tuple(clipped))
