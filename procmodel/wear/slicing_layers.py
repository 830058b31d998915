"""Depths of layers: all alike, or as thick as the wall's slope and a tolerance allow.

A layer of thickness t leaves stairs on a wall that rises at the angle a from the surface. Their
height, measured square to the wall, is t cos a: a steep wall takes thick layers, a flat floor
layers of the tolerance. Lengths in um.
"""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from procmodel.errors import InputError
from procmodel.wear.layer_bottoms import require_depth
from procmodel.wear.solids import Solid

_CELLS = 2048
_GRADES = 128


class Mesh(Protocol):
    """A closed surface of triangles."""

    @property
    def vertices(self) -> np.ndarray:
        """Corners (x, y, depth), shape (n, 3) [um]."""

    @property
    def faces(self) -> np.ndarray:
        """Corners of every triangle, shape (m, 3)."""


@dataclass(frozen=True)
class WallSlopes:
    """How flat the wall is at most, over the depth.

    Attributes
    ----------
    depth : float [um]
        Depth of the cavity; cells of equal height divide it.
    flatness : ndarray, shape (k,)
        Greatest cosine of the angle between wall and surface in every cell; 0 for a vertical
        wall, 1 for a floor.
    floors : ndarray, shape (f,) [um]
        Depths of level floors, at which a layer has to end.
    """

    depth: float
    flatness: np.ndarray
    floors: np.ndarray


def level_floors(mesh: Mesh) -> tuple[float, ...]:
    """Depths at which a mesh has level floors.

    Parameters
    ----------
    mesh : Mesh
        The cavity, faces outward.

    Returns
    -------
    tuple of float [um]
        From the surface down; depths closer than a millionth of the whole are one.
    """
    corners = mesh.vertices[mesh.faces]
    depths = corners[:, :, 2]
    whole = float(np.ptp(depths))
    level = np.ptp(depths, axis=1) <= 1e-6 * whole
    sides = corners[:, 1:, :2] - corners[:, :1, :2]
    area = 0.5 * np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    found: list[float] = []
    for depth in np.sort(depths[level & (area > 0.0)].mean(axis=1)):
        if depth > 1e-6 * whole and (not found or depth - found[-1] > 1e-6 * whole):
            found.append(float(depth))
    return tuple(found)


def layer_bottoms_by_tolerance(
    slopes: WallSlopes, tolerance: float, greatest: float, least: float = 0.0
) -> np.ndarray:
    """Bottoms of layers whose stairs stay within a tolerance of the wall.

    Parameters
    ----------
    slopes : WallSlopes
        Of the cavity; see `mesh_slopes` and `solid_slopes`.
    tolerance : float [um]
        Greatest height of a stair, square to the wall.
    greatest : float [um]
        Greatest thickness of a layer.
    least : float [um]
        Least thickness, which goes before the tolerance; layers above a level floor may still be
        thinner.

    Returns
    -------
    ndarray, shape (n,) [um]
        Depth of the bottom of every layer.

    Raises
    ------
    InputError
        If a length is not above 0 or the least exceeds the greatest thickness.
    """
    require_depth(slopes.depth)
    for name, value in (("tolerance", tolerance), ("greatest layer depth", greatest)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} {value:g} um gives no layer: it must be above 0.")
    if not 0 <= least <= greatest:
        raise InputError(
            f"least layer depth {least:g} um must be from 0 to the greatest, {greatest:g} um."
        )
    cells = len(slopes.flatness)
    height = slopes.depth / cells
    floors = [*(f for f in slopes.floors if f < slopes.depth * (1 - 1e-9)), slopes.depth]
    bottoms: list[float] = []
    top = 0.0
    for floor in floors:
        while top < floor * (1 - 1e-9):
            cell = min(int(top / height * (1 + 1e-12)), cells - 1)
            thickness, flattest = max(greatest, least), 0.0
            # Downwards as long as the flattest wall passed so far allows the layer that far.
            while cell < cells and cell * height < top + thickness:
                flattest = max(flattest, float(slopes.flatness[cell]))
                allowed = tolerance / flattest if flattest > 0 else math.inf
                reached = max(allowed, least, cell * height - top)
                thickness = min(thickness, reached)
                cell += 1
            layers_left = (floor - top) / thickness
            # The last layers above a floor share what is left, lest one be a sliver.
            if layers_left < 2:
                thickness = (floor - top) / max(1, math.ceil(layers_left - 1e-9))
            top = min(top + thickness, floor)
            bottoms.append(top)
        bottoms[-1] = top = floor
    return np.array(bottoms)


def mesh_slopes(mesh: Mesh, depth: float | None = None) -> WallSlopes:
    """Slopes of a mesh's walls.

    Parameters
    ----------
    mesh : Mesh
        Closed surface, z counted downwards from the workpiece surface.
    depth : float, optional [um]
        Depth of the cavity; the mesh's own when left out.

    Returns
    -------
    WallSlopes
        The slopes; level triangles that together make a thousandth of the mesh's section count as
        a floor.
    """
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    z = corners[:, :, 2]
    top, bottom = z.min(axis=1), z.max(axis=1)
    full = float(np.max(bottom))
    depth = full if depth is None else depth
    require_depth(depth)
    real = size > 1e-12 * np.sum(size)
    level = real & (bottom - top <= 1e-9 * full)
    wall = real & ~level & (top < depth)
    cosine = np.abs(normal[wall, 2]) / size[wall]
    floor_depths = bottom[level & (bottom > 1e-9 * full)]
    floor_areas = 0.5 * size[level & (bottom > 1e-9 * full)]
    unique, which = np.unique(np.round(floor_depths / (1e-9 * full)), return_inverse=True)
    areas = np.bincount(which, weights=floor_areas, minlength=len(unique))
    extent = float(np.prod(np.ptp(mesh.vertices[:, :2], axis=0)))
    floors = unique[areas > 1e-3 * extent] * 1e-9 * full
    return WallSlopes(
        depth, _flattest(top[wall], bottom[wall], cosine, depth), floors[floors < depth]
    )


def solid_slopes(solid: Solid, depth: float | None = None) -> WallSlopes:
    """Slopes of a parametric solid's wall.

    Parameters
    ----------
    solid : Solid
        Pyramid, cone, hemisphere ...
    depth : float, optional [um]
        Depth of the cavity; the solid's own when left out.

    Returns
    -------
    WallSlopes
        The slopes.

    Raises
    ------
    InputError
        If the depth is missing or more than the solid's.
    """
    depth = solid.full_depth if depth is None else depth
    require_depth(depth)
    if depth > solid.full_depth * (1 + 1e-9):
        raise InputError(
            f"depth {depth:g} um must be at most {solid.full_depth:g} um, the solid's own."
        )
    edges = np.linspace(0.0, depth, _CELLS + 1)
    slope = np.abs(np.diff(np.asarray(solid.half_width(edges)))) / np.diff(edges)
    # Within a cell the wall may be as flat as in the next: the mean slope alone hides it.
    slope = np.maximum(slope, np.maximum(np.roll(slope, 1), np.roll(slope, -1)))
    return WallSlopes(depth, slope / np.hypot(1.0, slope), np.empty(0))


def _flattest(top: np.ndarray, bottom: np.ndarray, cosine: np.ndarray, depth: float) -> np.ndarray:
    """Greatest cosine in every cell of the depth, of the triangles that reach into it."""
    # By grades, upwards, so that a triangle costs two numbers however many cells it spans.
    grade = np.ceil(cosine * _GRADES).astype(np.int64)
    height = depth / _CELLS
    first = np.clip(np.floor(top / height + 1e-9).astype(np.int64), 0, _CELLS)
    end = np.clip(np.ceil(bottom / height - 1e-9).astype(np.int64), 0, _CELLS)
    covered = np.zeros((_GRADES + 1, _CELLS + 1), np.int64)
    np.add.at(covered, (grade, first), 1)
    np.add.at(covered, (grade, end), -1)
    present = np.cumsum(covered, axis=1)[:, :_CELLS] > 0
    return np.max(present * np.arange(_GRADES + 1)[:, None], axis=0) / _GRADES
