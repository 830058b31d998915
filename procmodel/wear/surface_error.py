"""How far a cut surface is from the wanted one.

Lengths in um, depths downwards positive: an error above 0 is cut too deep.
"""

from dataclasses import dataclass

import numpy as np
from jax.typing import ArrayLike

from procmodel.errors import InputError

# Depths below this are rounding, not a cut [um].
_LEAST_DEPTH = 1e-9
# How far below the deepest place a flat bottom may lie and still be of one depth [um].
_SAME_DEPTH = 1e-6


@dataclass(frozen=True)
class SurfaceError:
    """Error of a surface over a region.

    Attributes
    ----------
    rms, mean : float [um]
        Root mean square and mean of depth less target over the region's cells.
    max : float [um]
        Greatest of their absolute values.
    peak_to_valley : float [um]
        Greatest less least error over the cells of the bottom.
    map : ndarray, shape (nx, ny) [um]
        Depth less target; NaN outside the region.
    """

    rms: float
    mean: float
    max: float
    peak_to_valley: float
    map: np.ndarray


def cleared_cells(depth: ArrayLike, target: ArrayLike, before: ArrayLike = 0.0) -> np.ndarray:
    """Cells over which a surface is compared with its target: those cut, and those to be cut.

    Parameters
    ----------
    depth : array_like, shape (nx, ny) [um]
        Depth after cutting.
    target : array_like, shape (nx, ny) [um]
        Wanted depth.
    before : array_like, shape () or (nx, ny) [um]
        Depth before cutting.

    Returns
    -------
    ndarray of bool, shape (nx, ny)
        True where the surface was lowered or should have been.
    """
    start = np.asarray(before)
    cut = np.asarray(depth) > start + _LEAST_DEPTH
    return cut | (np.asarray(target) > start + _LEAST_DEPTH)


def surface_error(
    depth: ArrayLike,
    target: ArrayLike,
    region: ArrayLike | None = None,
    bottom: ArrayLike | None = None,
) -> SurfaceError:
    """Compare a surface with its target.

    Parameters
    ----------
    depth : array_like, shape (nx, ny) [um]
        Depth after cutting.
    target : array_like, shape (nx, ny) [um]
        Wanted depth; see `procmodel.wear.target_map.target_map`.
    region : array_like of bool, shape (nx, ny), optional
        Cells that count; `cleared_cells` when left out.
    bottom : array_like of bool, shape (nx, ny), optional
        Cells of the bottom; when left out the region's cells at the target's greatest depth.

    Returns
    -------
    SurfaceError
        The error.

    Raises
    ------
    InputError
        If the shapes differ, a depth in the region is not finite, or the region is empty.
    """
    cut, wanted = np.asarray(depth, float), np.asarray(target, float)
    given = {"target": wanted, "region": region, "bottom": bottom}
    for name, values in given.items():
        if values is not None and np.shape(values) != cut.shape:
            raise InputError(
                f"{name} has shape {np.shape(values)}: give one value for every cell of the "
                f"depth, {cut.shape}."
            )
    inside = cleared_cells(cut, wanted) if region is None else np.asarray(region, bool)
    if not np.any(inside):
        raise InputError("no cell is cut or to be cut: there is no error to speak of.")
    error = np.where(inside, cut - wanted, np.nan)
    values = error[inside]
    if not np.all(np.isfinite(values)):
        raise InputError("depth or target of a cell is not a finite number: check both maps.")
    floor = inside & (
        wanted >= np.max(wanted[inside]) - _SAME_DEPTH
        if bottom is None
        else np.asarray(bottom, bool)
    )
    return SurfaceError(
        rms=float(np.sqrt(np.mean(values**2))),
        mean=float(np.mean(values)),
        max=float(np.max(np.abs(values))),
        peak_to_valley=float(np.ptp(error[floor])) if np.any(floor) else 0.0,
        map=error,
    )
