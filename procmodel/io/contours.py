"""Contours from any of the files in which users keep them: DXF, G-code and tables.

The table names the columns `x [mm]`, `y [mm]` and, as far as needed, `bulge [-]` (of the piece
that begins at the point), `contour [-]` (number of the contour, its rows in one block) and
`closed [-]` (1 or 0 throughout a contour). Without `closed`, a contour is closed where its last
point repeats the first.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.atomic import check_target
from procmodel.io.dxf import read_dxf
from procmodel.io.gcode_reader import read_gcode
from procmodel.io.polyline import JOIN_TOLERANCE, NEGLIGIBLE, BulgePolyline, checked
from procmodel.io.tables import Column, Table, place, read_table
from procmodel.io.writers import write_table

DXF_SUFFIXES = (".dxf",)
GCODE_SUFFIXES = (".nc", ".ngc", ".gcode", ".tap", ".cnc", ".iso")
TABLE_SUFFIXES = (".csv", ".txt")

COLUMNS = (
    Column("x", "mm"),
    Column("y", "mm"),
    Column("bulge", "-", required=False),
    Column("contour", "-", required=False),
    Column("closed", "-", required=False),
)

# A last point this close to the first, as a share of the contour's size, repeats it.
_REPEATED = 1e-6

# What a table is written with: a bulge of a metre's chord is then kept to the nanometre.
_DECIMALS = 9


def read_contours(
    path: str | os.PathLike[str],
    layer: str | None = None,
    units: str | None = None,
    tolerance: float = JOIN_TOLERANCE,
) -> list[BulgePolyline]:
    """Read contours from a drawing, a program or a table, by the suffix of the file.

    Parameters
    ----------
    path : path-like
        `.dxf` (`procmodel.io.read_dxf`); `.nc`, `.ngc`, `.gcode`, `.tap`, `.cnc` or `.iso`
        (`procmodel.io.read_gcode`); `.csv` or `.txt` (the module's docstring).
    layer : str, optional
        Layer of a drawing; other files have none.
    units : str, optional
        Unit of a drawing or program that does not state it; a table always does.
    tolerance : float [mm]
        For drawings, as in `procmodel.io.read_dxf`.

    Returns
    -------
    list of BulgePolyline
        At least one, in mm.

    Raises
    ------
    InputError
        If the suffix is unknown, an argument does not suit the file, or the file is faulty. The
        text names the file, the place in it and the remedy.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    known = (*DXF_SUFFIXES, *GCODE_SUFFIXES, *TABLE_SUFFIXES)
    if suffix not in known:
        raise InputError(
            f"{path}: '{path.suffix}' is no suffix of a drawing, program or table: "
            f"give a file that ends in one of {', '.join(known)}"
        )
    if suffix in DXF_SUFFIXES:
        return read_dxf(path, layer, units, tolerance)
    if layer is not None:
        raise InputError(
            f"{path}: layer is '{layer}', but only drawings (.dxf) have layers: leave layer out"
        )
    if suffix in GCODE_SUFFIXES:
        return list(read_gcode(path, units).moves)
    if units is not None:
        raise InputError(
            f"{path}: units is '{units}', but a table states its units in its header: "
            "leave units out"
        )
    return _read_contours_table(path)


def write_contours_csv(path: str | os.PathLike[str], polylines: Sequence[BulgePolyline]) -> None:
    """Write contours to a table that `read_contours` reads back.

    Parameters
    ----------
    path : path-like
        The file; one already there is replaced, completely or not at all.
    polylines : sequence of BulgePolyline [mm]
        At least one. Numbers are written with 9 decimals.

    Raises
    ------
    InputError
        If the file cannot be written, there is no contour, or one is faulty (`checked`).
    """
    check_target(Path(path))
    if not polylines:
        raise InputError(f"{path}: there is no contour to write: give at least one")
    counts = [len(checked(polyline).points) for polyline in polylines]
    bulges = [
        np.pad(polyline.bulges, (0, count - len(polyline.bulges)))
        for polyline, count in zip(polylines, counts, strict=True)
    ]
    x, y = np.concatenate([polyline.points for polyline in polylines]).T
    table = {
        "x": x,
        "y": y,
        "bulge": np.concatenate(bulges),
        "contour": np.repeat(np.arange(1, len(polylines) + 1), counts),
        "closed": np.repeat([int(polyline.closed) for polyline in polylines], counts),
    }
    write_table(path, {each.heading: table[each.name] for each in COLUMNS}, _DECIMALS)


def _read_contours_table(path: Path) -> list[BulgePolyline]:
    table = read_table(path, COLUMNS)
    numbers = table.values.get("contour", np.ones(len(table.rows)))
    starts = np.flatnonzero(np.diff(numbers, prepend=np.nan))
    _check_blocks(table, numbers, starts)
    blocks = np.split(np.arange(len(table.rows)), starts[1:])
    names = [
        f"{path.name}, contour {numbers[block[0]]:g}" if len(blocks) > 1 else path.name
        for block in blocks
    ]
    return [_contour(table, block, name) for block, name in zip(blocks, names, strict=True)]


def _check_blocks(table: Table, numbers: np.ndarray, starts: np.ndarray) -> None:
    seen: dict[float, int] = {}
    for start in starts.tolist():
        number, row = float(numbers[start]), int(table.rows[start])
        if number != round(number):
            raise InputError(
                f"{place(table.path, row)}: contour {number:g} is no whole number: "
                "count the contours 1, 2, 3"
            )
        if number in seen:
            raise InputError(
                f"{place(table.path, seen[number], row)}: the rows of contour {number:g} are not "
                "together: put them in one block, or give the second a number of its own"
            )
        seen[number] = row


def _contour(table: Table, block: np.ndarray, name: str) -> BulgePolyline:
    """One contour from the rows of its block."""
    points = np.column_stack([table.values["x"][block], table.values["y"][block]])
    bulges = table.values.get("bulge", np.zeros(len(table.rows)))[block]
    rows = table.rows[block]
    size = np.ptp(points, axis=0).max()
    gap = np.hypot(*(points[-1] - points[0]))
    stated = _stated_closed(table, block)
    # A contour said to be closed may have a short last piece; without a length it repeats a point.
    limit = (_REPEATED if stated is None else NEGLIGIBLE) * size
    repeats = len(points) > 1 and gap <= limit
    closed = repeats if stated is None else stated
    if bulges[-1] != 0 and (repeats or not closed):
        raise InputError(
            f"{place(table.path, int(rows[-1]))}: the last point of "
            f"{'a contour that repeats its first point' if repeats else 'an open contour'} has a "
            "bulge, but no piece begins there: write 0, and the bulge at the start of its piece"
        )
    if closed and repeats:
        points, bulges, rows = points[:-1], bulges[:-1], rows[:-1]
    contour = BulgePolyline(points, bulges if closed else bulges[: len(points) - 1], closed, name)
    return checked(contour, [f"row {row}" for row in rows])


def _stated_closed(table: Table, block: np.ndarray) -> bool | None:
    """Whether the table says that a contour is closed; None where it does not say."""
    if "closed" not in table.values:
        return None
    values, rows = table.values["closed"][block], table.rows[block]
    for value, row in zip(values.tolist(), rows.tolist(), strict=True):
        if value not in (0.0, 1.0):
            raise InputError(f"{place(table.path, row)}: closed is {value:g}: write 1 or 0")
    differing = np.flatnonzero(values != values[0])
    if len(differing):
        raise InputError(
            f"{place(table.path, int(rows[0]), int(rows[differing[0]]))}: closed is both "
            f"{values[0]:g} and {values[differing[0]]:g} in one contour: write the same in all "
            "its rows"
        )
    return bool(values[0])
