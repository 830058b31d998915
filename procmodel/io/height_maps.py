"""Measured height maps: the height of a surface at places in any order."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.tables import Column, place, read_table

LEAST_POINTS = 4


@dataclass(frozen=True)
class HeightMap:
    """Height measured at places of a surface.

    Attributes
    ----------
    x, y : numpy.ndarray, shape (n,), um
        Places.
    z : numpy.ndarray, shape (n,), um
        Depth or height at each, in the sign of the file.
    sigma : numpy.ndarray, shape (n,), um, or None
        Standard deviation of each `z`; None where the file has no such column.
    path : pathlib.Path or None
        The file.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    sigma: np.ndarray | None = None
    path: Path | None = None


def read_height_map(path: str | os.PathLike[str]) -> HeightMap:
    """Read a height map with the columns `x [um]`, `y [um]`, `z [um]` and, if known, `sigma [um]`.

    Unlike `read_depth_map` it need be no grid: places that the instrument could not see are left
    out of the file.

    Parameters
    ----------
    path : path-like
        A table as `read_table` takes it, one row for every place.

    Returns
    -------
    HeightMap
        The readings in the order of the file.

    Raises
    ------
    InputError
        If the table is faulty, a place stands twice, all places lie on one line along x or y, a
        sigma is not positive, or there are fewer than four readings.
    """
    table = read_table(
        path,
        [
            Column("x", "um"),
            Column("y", "um"),
            Column("z", "um"),
            Column("sigma", "um", required=False, positive=True),
        ],
    )
    x, y, z = (table.values[name] for name in "xyz")
    if len(x) < LEAST_POINTS:
        raise InputError(
            f"{table.path}: {len(x)} readings are no height map: give {LEAST_POINTS} or more."
        )
    for name, values in (("x", x), ("y", y)):
        if np.ptp(values) == 0.0:
            raise InputError(
                f"{table.path}: all {name} are {values[0]:g} um: a height map needs two or more "
                "places along each axis; a single line is a profile."
            )
    order = np.lexsort((y, x))
    same = (np.diff(x[order]) == 0.0) & (np.diff(y[order]) == 0.0)
    if np.any(same):
        first = int(np.argmax(same))
        rows = sorted(int(table.rows[i]) for i in order[first : first + 2])
        raise InputError(
            f"{place(table.path, *rows)}: both are for the place ({x[order[first]]:g}, "
            f"{y[order[first]]:g}) um: keep one of them."
        )
    return HeightMap(x, y, z, table.values.get("sigma"), table.path)
