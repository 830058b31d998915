"""Measured profiles, outlines and tables of layer areas."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.tables import Column, Table, place, read_table


@dataclass(frozen=True)
class Profile:
    """Depth measured along a line.

    Attributes
    ----------
    x : numpy.ndarray, shape (n,), um
        Position, strictly increasing.
    z : numpy.ndarray, shape (n,), um
        Depth or height at each position, in the sign of the file.
    sigma : numpy.ndarray, shape (n,), um, or None
        Standard deviation of each `z`; None where the file has no such column.
    rows : numpy.ndarray, shape (n,), int
        Line number in the file of each reading, from 1.
    path : pathlib.Path
        The file.
    """

    x: np.ndarray
    z: np.ndarray
    sigma: np.ndarray | None
    rows: np.ndarray
    path: Path


@dataclass(frozen=True)
class Outline:
    """Points along the outline of a section, in the order of the file.

    Attributes
    ----------
    x, y : numpy.ndarray, shape (n,), um
        The points.
    rows : numpy.ndarray, shape (n,), int
        Line number in the file of each point, from 1.
    path : pathlib.Path
        The file.
    """

    x: np.ndarray
    y: np.ndarray
    rows: np.ndarray
    path: Path

    @property
    def points(self) -> np.ndarray:
        """The points as one array, shape (n, 2), um."""
        return np.column_stack([self.x, self.y])


@dataclass(frozen=True)
class AreaTable:
    """Area of a cavity's section against depth.

    Attributes
    ----------
    z : numpy.ndarray, shape (n,), um
        Depth below the workpiece top, strictly increasing from zero or more.
    area : numpy.ndarray, shape (n,), um^2
        Area of the section at that depth, zero or more.
    rows : numpy.ndarray, shape (n,), int
        Line number in the file of each section, from 1.
    path : pathlib.Path
        The file.
    """

    z: np.ndarray
    area: np.ndarray
    rows: np.ndarray
    path: Path


def read_profile(path: str | os.PathLike[str]) -> Profile:
    """Read a profile with the columns `x [um]`, `z [um]` and, if known, `sigma [um]`.

    A profile measured from the far end, with decreasing x, is turned round.

    Parameters
    ----------
    path : path-like
        A table as `read_table` takes it, with three readings or more.

    Returns
    -------
    Profile
        The readings in the order of increasing x.

    Raises
    ------
    InputError
        If the table is faulty, x turns back or stands twice, a sigma is not positive, or there
        are fewer than three readings.
    """
    table = read_table(
        path,
        [
            Column("x", "um"),
            Column("z", "um"),
            Column("sigma", "um", required=False, positive=True),
        ],
    )
    _require_rows(table, 3, "a profile")
    x = table.values["x"]
    _refuse_repeated(table, x)
    steps = np.sign(np.diff(x))
    direction = 1 if np.sum(steps) >= 0 else -1
    _require_one_direction(table, x, steps, direction)
    order = slice(None, None, direction)
    sigma = table.values.get("sigma")
    return Profile(
        x[order],
        table.values["z"][order],
        None if sigma is None else sigma[order],
        table.rows[order],
        table.path,
    )


def read_outline(path: str | os.PathLike[str]) -> Outline:
    """Read an outline with the columns `x [um]` and `y [um]`, its points kept in their order.

    Parameters
    ----------
    path : path-like
        A table as `read_table` takes it, with three points or more.

    Returns
    -------
    Outline
        The points.

    Raises
    ------
    InputError
        If the table is faulty or has fewer than three points.
    """
    table = read_table(path, [Column("x", "um"), Column("y", "um")])
    _require_rows(table, 3, "an outline")
    return Outline(table.values["x"], table.values["y"], table.rows, table.path)


def read_area_table(path: str | os.PathLike[str]) -> AreaTable:
    """Read section areas with the columns `z [um]` and `area [um^2]`.

    Parameters
    ----------
    path : path-like
        A table as `read_table` takes it, with two rows or more.

    Returns
    -------
    AreaTable
        The areas in the order of increasing depth.

    Raises
    ------
    InputError
        If the table is faulty or has fewer than two rows, z starts above the workpiece or does
        not increase from row to row, or an area is negative.
    """
    table = read_table(path, [Column("z", "um"), Column("area", "um^2")])
    _require_rows(table, 2, "a table of areas")
    z, area, rows = table.values["z"], table.values["area"], table.rows
    if np.any(area < 0):
        first = int(np.argmax(area < 0))
        raise InputError(
            f"{place(table.path, rows[first])}: negative area ({area[first]:g} um^2): "
            "give the area of each section as zero or more"
        )
    if z[0] < 0:
        raise InputError(
            f"{place(table.path, rows[0])}: z starts at {z[0]:g} um, above the workpiece: "
            "count the depth downwards from 0"
        )
    fallen = np.diff(z) <= 0
    if np.any(fallen):
        first = int(np.argmax(fallen))
        raise InputError(
            f"{place(table.path, rows[first + 1])}: z is {z[first + 1]:g} um after {z[first]:g} um "
            f"in row {rows[first]}: sort the rows by increasing z, each z once"
        )
    return AreaTable(z, area, rows, table.path)


def _require_rows(table: Table, least: int, what: str) -> None:
    count = len(table.rows)
    if count < least:
        raise InputError(
            f"{place(table.path, table.rows[-1])}: the table ends after {count} "
            f"reading{'s' if count > 1 else ''}: {what} needs at least {least}"
        )


def _refuse_repeated(table: Table, x: np.ndarray) -> None:
    order = np.argsort(x, kind="stable")
    repeated = np.flatnonzero(np.diff(x[order]) == 0)
    if repeated.size:
        first, second = order[repeated[0]], order[repeated[0] + 1]
        raise InputError(
            f"{place(table.path, table.rows[first], table.rows[second])}: x is {x[first]:g} um in "
            "both: keep one of them, or their mean"
        )


def _require_one_direction(table: Table, x: np.ndarray, steps: np.ndarray, direction: int) -> None:
    against = steps != direction
    if np.any(against):
        first = int(np.argmax(against))
        raise InputError(
            f"{place(table.path, table.rows[first + 1])}: x turns back from {x[first]:g} to "
            f"{x[first + 1]:g} um: sort the rows by x"
        )
