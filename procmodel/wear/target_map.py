"""The wanted depth of every cell of a workpiece's map: solids, meshes, depth maps, slices.

Lengths in um, depths downwards positive.
"""

import math
from typing import Any

import numpy as np
import shapely
from scipy.interpolate import RegularGridInterpolator

from procmodel.errors import InputError
from procmodel.wear.sections import CircleSection, SquareSection
from procmodel.wear.slicing import DepthGrid, Slices
from procmodel.wear.slicing_layers import Mesh
from procmodel.wear.solids import Hemisphere, Solid, TaperedSolid
from procmodel.wear.target_mesh import mesh_depth
from procmodel.wear.zmap_maps import WorkpieceMap

SAMPLES = 8
Target = Solid | Mesh | Slices | DepthGrid


def target_map(
    target: Target,
    workpiece: WorkpieceMap,
    depth: float = math.inf,
    samples: int = SAMPLES,
) -> np.ndarray:
    """Mean wanted depth of every cell.

    Parameters
    ----------
    target : Solid, Mesh, Slices or DepthGrid
        A hemisphere, pyramid or cone about the origin; a closed mesh, at its deepest; slices, taken
        as the staircase they are (a slot is one); or a depth map, bilinear between its places and 0
        beyond them.
    workpiece : WorkpieceMap
        The cells.
    depth : float [um]
        Depth at which the cavity ends, for a frustum and for a vertical wall.
    samples : int
        Places along each side of a cell over which the depth is averaged, at least 1: a vertical
        wall is right to a share of 1 / samples of the cell it crosses.

    Returns
    -------
    ndarray, shape (nx, ny) [um]
        Wanted depth, 0 where nothing is to be cut.

    Raises
    ------
    InputError
        If the target has no outline, its depth does not end, or the number of samples is below 1.
    """
    if not depth > 0:
        raise InputError(f"depth {depth:g} um of the target must be above 0.")
    if samples < 1:
        raise InputError(f"samples {samples} along a cell must be at least 1.")
    shift = ((np.arange(samples) + 0.5) / samples - 0.5) * workpiece.cell
    x, y = ((line[:, None] + shift).ravel() for line in (workpiece.x, workpiece.y))
    fine = np.minimum(_depth_at(target, x, y, depth), depth)
    nx, ny = workpiece.depth.shape
    return np.mean(fine.reshape(nx, samples, ny, samples), axis=(1, 3))


def cells_inside(place: shapely.Geometry, workpiece: WorkpieceMap) -> np.ndarray:
    """Cells of a map whose middles lie in a place.

    Parameters
    ----------
    place : shapely geometry [um]
        Seen from above.
    workpiece : WorkpieceMap
        The cells.

    Returns
    -------
    ndarray of bool, shape (nx, ny)
        True inside.
    """
    x, y = np.meshgrid(workpiece.x, workpiece.y, indexing="ij")
    return shapely.contains_xy(place, x, y)


def _depth_at(target: Any, x: np.ndarray, y: np.ndarray, depth: float) -> np.ndarray:
    """Wanted depth at the places of a grid, shape (len(x), len(y)) [um]."""
    if isinstance(target, Hemisphere):
        square = target.radius**2 - x[:, None] ** 2 - y[None, :] ** 2
        return np.sqrt(np.maximum(square, 0.0))
    if isinstance(target, TaperedSolid):
        return _tapered(target, x, y, depth)
    if isinstance(target, Slices):
        return _staircase(target, x, y)
    if hasattr(target, "vertices") and hasattr(target, "faces"):
        return mesh_depth(target, x, y)
    if hasattr(target, "depth") and hasattr(target, "x") and hasattr(target, "y"):
        known = RegularGridInterpolator(
            (target.x, target.y), np.maximum(target.depth, 0.0), bounds_error=False, fill_value=0.0
        )
        places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        return known(places.reshape(-1, 2)).reshape(len(x), len(y))
    raise InputError(
        f"{type(target).__name__} has no depth at a place: give a hemisphere, pyramid, cone, a "
        "mesh, a depth map or slices."
    )


def _tapered(solid: TaperedSolid, x: np.ndarray, y: np.ndarray, depth: float) -> np.ndarray:
    if isinstance(solid.section, SquareSection) and solid.section.corner_radius == 0.0:
        across = np.maximum(np.abs(x)[:, None], np.abs(y)[None, :])
    elif isinstance(solid.section, CircleSection):
        across = np.hypot(x[:, None], y[None, :])
    else:
        raise InputError(
            "a tapered target needs a circle or a square with sharp corners as its section: give "
            "its slices instead."
        )
    inside = solid.opening - across
    if solid.wall_angle == math.pi / 2:
        if not math.isfinite(depth):
            raise InputError("a target with vertical walls has no depth of its own: give depth.")
        return np.where(inside > 0, depth, 0.0)
    return np.maximum(inside, 0.0) * math.tan(solid.wall_angle)


def _staircase(slices: Slices, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    fine = np.zeros((len(x), len(y)))
    # Layers narrow downwards, so that only places inside the last one need be looked at.
    rows, columns = np.divmod(np.arange(fine.size), len(y))
    for bottom, region in zip(slices.bottom, slices.regions, strict=True):
        shapely.prepare(region)
        inside = shapely.contains_xy(region, x[rows], y[columns])
        rows, columns = rows[inside], columns[inside]
        fine[rows, columns] = bottom
    return fine
