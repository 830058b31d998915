"""Plans of cavities as `wear plan` writes them: feeds by layer, and the scanning paths."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.tables import Column, Table, place, read_table


@dataclass(frozen=True)
class WrittenPlan:
    """Layers and feeds of one stage.

    Attributes
    ----------
    bottom : numpy.ndarray, shape (n,), um
        Wanted depth of the bottom of every layer.
    cumulative_feed : numpy.ndarray, shape (n,), um
        Feed from the surface after every layer.
    area : numpy.ndarray, shape (n,), or None, um^2
        Area of every layer, where the file says it.
    path : pathlib.Path
        The file.
    """

    bottom: np.ndarray
    cumulative_feed: np.ndarray
    area: np.ndarray | None
    path: Path

    @property
    def feed(self) -> np.ndarray:
        """Feed of every layer, shape (n,), um."""
        return np.diff(self.cumulative_feed, prepend=0.0)


@dataclass(frozen=True)
class WrittenPath:
    """Way of the electrode's centre through one layer.

    Attributes
    ----------
    points : numpy.ndarray, shape (m, 2), um
        Corners of the way.
    cutting : numpy.ndarray of bool, shape (m - 1,)
        Whether the move to the next corner is made at depth.
    quarter_turns : int
        Quarter turns of the electrode.
    cumulative_feed : float, um
        Feed from the surface in this layer.
    """

    points: np.ndarray
    cutting: np.ndarray
    quarter_turns: int
    cumulative_feed: float


def read_plan(path: str | os.PathLike[str], stage: int = 1) -> WrittenPlan:
    """Read a schedule with the columns `target z [um]` and `cumulative feed [um]`.

    Parameters
    ----------
    path : path-like
        A table as `read_table` takes it, one row for every layer from the surface down; with the
        column `stage` only the rows of one stage are taken.
    stage : int
        Which one.

    Returns
    -------
    WrittenPlan
        Its layers.

    Raises
    ------
    InputError
        If the table is faulty or has no layer of the stage, or depth or feed do not grow from row
        to row.
    """
    columns = [Column("target z", "um"), Column("cumulative feed", "um")]
    more = [Column("stage", "-", required=False), Column("area", "um^2", required=False)]
    table = read_table(path, [*columns, *more])
    table = _of_stage(table, stage)
    for name in ("target z", "cumulative feed"):
        rises = np.diff(table.values[name], prepend=0.0) > 0
        if not np.all(rises):
            at = int(np.argmin(rises))
            raise InputError(
                f"{place(table.path, table.rows[at])}: {name} is {table.values[name][at]:g} um, "
                "but must grow from layer to layer, from above 0: sort the layers from the surface "
                "down."
            )
    values = table.values
    return WrittenPlan(
        values["target z"], values["cumulative feed"], values.get("area"), table.path
    )


def read_paths(path: str | os.PathLike[str], stage: int = 1) -> list[WrittenPath]:
    """Read scanning paths, one row for every corner.

    Parameters
    ----------
    path : path-like
        A table as `read_table` takes it with the columns `layer`, `x [um]`, `y [um]`,
        `cumulative feed [um]`, `cutting` (1 where the move to this corner is made at depth) and
        `quarter turns`; with the column `stage` only the rows of one stage are taken.
    stage : int
        Which one.

    Returns
    -------
    list of WrittenPath
        One for every layer.

    Raises
    ------
    InputError
        If the table is faulty or has no layer of the stage, layers do not count up from 1, or a
        layer has more than one feed or turn, or none of its moves cuts.
    """
    plain = ("layer", "cutting", "quarter turns")
    lengths = ("x", "y", "cumulative feed")
    table = read_table(
        path,
        [
            *(Column(name, "-") for name in plain),
            *(Column(name, "um") for name in lengths),
            Column("stage", "-", required=False),
        ],
    )
    table = _of_stage(table, stage)
    values, rows = table.values, table.rows
    steps = np.diff(values["layer"], prepend=0.0)
    wrong = (steps != 0.0) & (steps != 1.0)
    wrong[0] = steps[0] != 1.0
    if np.any(wrong):
        at = int(np.argmax(wrong))
        raise InputError(
            f"{place(table.path, rows[at])}: layer {values['layer'][at]:g} comes out of turn: "
            "layers count up from 1, the rows of one behind the other."
        )
    begins = np.flatnonzero(steps)
    return [_layer(table, part) for part in np.split(np.arange(len(rows)), begins[1:])]


def _layer(table: Table, part: np.ndarray) -> WrittenPath:
    values = {name: column[part] for name, column in table.values.items()}
    where = place(table.path, table.rows[part[0]])
    for name in ("cumulative feed", "quarter turns"):
        if np.any(values[name] != values[name][0]):
            at = part[int(np.argmax(values[name] != values[name][0]))]
            raise InputError(
                f"{place(table.path, table.rows[at])}: {name} changes within layer "
                f"{values['layer'][0]:g}: give one for all of its rows."
            )
    cutting = values["cutting"][1:] != 0.0
    if len(cutting) and not np.any(cutting):
        raise InputError(
            f"{where}: no move of layer {values['layer'][0]:g} cuts: write 1 under cutting for "
            "those made at depth."
        )
    return WrittenPath(
        np.column_stack([values["x"], values["y"]]),
        cutting,
        int(values["quarter turns"][0]),
        float(values["cumulative feed"][0]),
    )


def _of_stage(table: Table, stage: int) -> Table:
    if "stage" in table.values:
        chosen = table.values["stage"] == stage
        values = {name: column[chosen] for name, column in table.values.items()}
        table = Table(values, table.rows[chosen], table.path)
    if len(table.rows) == 0:
        raise InputError(f"{table.path.name} has no layer of stage {stage}: give a plan that has.")
    return table
