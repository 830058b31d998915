"""Depth maps: a cavity as its depth over a regular grid of places."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.tables import Column, Table, place, read_table

# Of a step of the grid: how far a place may lie off it and still be meant for it.
_OFF_GRID = 0.01


@dataclass(frozen=True)
class DepthMap:
    """Depth over a regular grid.

    Attributes
    ----------
    x, y : numpy.ndarray, shape (n,) and (m,), um
        Places along each axis, evenly spaced, increasing.
    depth : numpy.ndarray, shape (n, m), um
        Depth below the workpiece surface at (x[i], y[j]), counted downwards.
    path : pathlib.Path or None
        The file.
    """

    x: np.ndarray
    y: np.ndarray
    depth: np.ndarray
    path: Path | None = None


def read_depth_map(path: str | os.PathLike[str]) -> DepthMap:
    """Read a depth map with the columns `x [um]`, `y [um]` and `z [um]`, its rows in any order.

    Parameters
    ----------
    path : path-like
        A table as `read_table` takes it, one row for every place of a regular grid, two or more
        along each axis; z is the depth, counted downwards.

    Returns
    -------
    DepthMap
        The map.

    Raises
    ------
    InputError
        If the table is faulty, a place stands twice, is missing or lies off the grid, there are
        fewer than two places along an axis, or no depth is above 0.
    """
    table = read_table(path, [Column("x", "um"), Column("y", "um"), Column("z", "um")])
    x, column = _grid(table, "x")
    y, row = _grid(table, "y")
    cell = column * len(y) + row
    order = np.argsort(cell, kind="stable")
    repeated = np.flatnonzero(np.diff(cell[order]) == 0)
    if len(repeated):
        first, second = order[repeated[0]], order[repeated[0] + 1]
        raise InputError(
            f"{place(table.path, table.rows[first], table.rows[second])}: both are for the place "
            f"({x[column[first]]:g}, {y[row[first]]:g}) um: keep one of them."
        )
    if len(cell) < len(x) * len(y):
        known = np.zeros(len(x) * len(y), bool)
        known[cell] = True
        hole = int(np.argmin(known))
        before = table.rows[np.flatnonzero(cell == max(hole - 1, cell.min()))[0]]
        raise InputError(
            f"{place(table.path, before)}: the grid of {len(x)} x {len(y)} places has "
            f"{len(x) * len(y) - len(cell)} holes, the first near this row at "
            f"({x[hole // len(y)]:g}, {y[hole % len(y)]:g}) um: fill them in."
        )
    depth = np.empty(len(cell))
    depth[cell] = table.values["z"]
    if not np.max(depth) > 0:
        raise InputError(
            f"{table.path}: no z is above 0, so there is no cavity: count the depth downwards."
        )
    return DepthMap(x, y, depth.reshape(len(x), len(y)), table.path)


def _grid(table: Table, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spaced places along an axis, and which of them every row stands for."""
    values = table.values[name]
    size = float(np.ptp(values))
    unique, rows = np.unique(np.round(values, 12), return_counts=True)
    # A place with few rows is a slip, which the grid must not be guessed from.
    steps = np.diff(unique[rows >= 0.5 * np.max(rows)])
    # Differences of rounding within one place are no steps.
    steps = steps[steps > 1e-6 * size] if size > 0 else steps
    if not len(steps):
        raise InputError(
            f"{place(table.path, table.rows[0])}: all {name} are {values[0]:g} um: a map needs two "
            "or more places along each axis."
        )
    step = size / round(size / float(np.median(steps)))
    count = round(size / step) + 1
    start = float(np.min(values))
    index = np.rint((values - start) / step).astype(np.int64)
    off = np.abs(values - start - index * step)
    if np.max(off) > _OFF_GRID * step:
        worst = int(np.argmax(off > _OFF_GRID * step))
        raise InputError(
            f"{place(table.path, table.rows[worst])}: {name} is {values[worst]:g} um, off the grid "
            f"of {step:g} um that most rows keep: give a regular grid."
        )
    return start + step * np.arange(count), index
