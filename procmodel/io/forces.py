"""Tables of measured cutting forces, and files of force coefficients.

Lengths are handed over in mm, forces in N, angles in rad.
"""

from __future__ import annotations

import json
import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from procmodel.errors import InputError, nearest
from procmodel.io.tables import Column, Table, place, read_table
from procmodel.io.textfile import read_utf8

AXES = ("Fx", "Fy", "Fz")
_IN_PLANE = ("tangential_shear", "radial_shear", "tangential_edge", "radial_edge")
_AXIAL = ("axial_shear", "axial_edge")
_COLUMNS = (
    Column("feed per tooth", "mm", positive=True),
    Column("axial depth", "mm", positive=True),
    Column("start", "deg", required=False),
    Column("exit", "deg", required=False),
    Column("engagement angle", "deg", required=False),
    Column("rotation", "deg", required=False),
    Column("Fx", "N"),
    Column("Fy", "N"),
    Column("Fz", "N", required=False),
)


@dataclass(frozen=True)
class ForceReadings:
    """Forces on a tool, each reading with the conditions under which it was taken.

    Attributes
    ----------
    feed_per_tooth, axial_depth : numpy.ndarray, shape (n,), mm
        Conditions of the cut.
    start, exit : numpy.ndarray, shape (n,), rad
        Where a flute enters and leaves the stock, 0 <= start <= exit <= pi.
    forces : dict of str to numpy.ndarray, shape (n,), N
        Forces by axis: "Fx" along the feed, "Fy" across it, and "Fz" where it was measured.
    rotation : numpy.ndarray, shape (n,), rad, or None
        Angle of the spindle at an instantaneous force; None where the forces are means over turns.
    rows : numpy.ndarray, shape (n,), int, or None
        Line number in the file of each reading, from 1; None without a file.
    path : pathlib.Path or None
        The file.

    Raises
    ------
    InputError
        If lengths differ, an angle is out of its range, or an axis is unknown or missing.
    """

    feed_per_tooth: np.ndarray
    axial_depth: np.ndarray
    start: np.ndarray
    exit: np.ndarray
    forces: Mapping[str, np.ndarray]
    rotation: np.ndarray | None = None
    rows: np.ndarray | None = None
    path: Path | None = None

    def __post_init__(self) -> None:
        for axis in self.forces:
            if axis not in AXES:
                raise InputError(f"unknown force '{axis}'{nearest(axis, AXES)}")
        for axis in AXES[:2]:
            if axis not in self.forces:
                raise InputError(f"there is no {axis} among the forces: give it")
        forces = {name: np.asarray(f, float) for name, f in self.forces.items()}
        object.__setattr__(self, "forces", forces)
        count = len(forces["Fx"])
        for name in ("feed_per_tooth", "axial_depth", "start", "exit", "rotation"):
            given = getattr(self, name)
            if given is None:
                continue
            values = np.asarray(given, float)
            if values.shape not in ((), (count,)):
                raise InputError(
                    f"{name} has shape {values.shape} for {count} readings: give one, or one each"
                )
            object.__setattr__(self, name, np.array(np.broadcast_to(values, (count,))))
        for axis, force in forces.items():
            if force.shape != (count,):
                raise InputError(f"{axis} has shape {force.shape}, but Fx has {count} readings")
        self._require_ranges()

    def _require_ranges(self) -> None:
        for name in ("feed_per_tooth", "axial_depth"):
            self._require(getattr(self, name) > 0, f"{name.replace('_', ' ')} is not above 0")
        # To rounding: 180 deg in another unit may be a digit more than pi.
        low, high = -1e-9, math.pi + 1e-9
        self._require(self.start >= low, "start is below 0 deg")
        self._require(self.exit <= high, "exit is above 180 deg")
        self._require(self.start <= self.exit, "start is greater than exit")
        object.__setattr__(self, "start", np.clip(self.start, 0.0, math.pi))
        object.__setattr__(self, "exit", np.clip(self.exit, 0.0, math.pi))

    def _require(self, holds: np.ndarray, fault: str) -> None:
        if np.all(holds):
            return
        index = int(np.argmin(holds))
        if self.path is not None and self.rows is not None:
            where = place(self.path, int(self.rows[index]))
        else:
            where = f"reading {index + 1}"
        raise InputError(f"{where}: {fault}: correct it, or delete the row")


def read_forces(path: str | os.PathLike[str], milling: str | None = None) -> ForceReadings:
    """Read measured forces, means over turns or instantaneous ones.

    Columns are `feed per tooth [mm]`, `axial depth [mm]`, `Fx [N]`, `Fy [N]`, optionally `Fz [N]`,
    and either `start [deg]` with `exit [deg]` or `engagement angle [deg]`. With `rotation [deg]`
    the forces are instantaneous.

    Parameters
    ----------
    path : path-like
        A table as `read_table` takes it.
    milling : {"down", "up"}, optional
        Where the engaged arc lies, needed for a column `engagement angle`: down milling ends at
        180 deg, up milling begins at 0.

    Returns
    -------
    ForceReadings
        The readings in the order of the file.

    Raises
    ------
    InputError
        If the table is faulty, an angle is out of its range, or it does not say where a flute is
        engaged.
    """
    table = read_table(path, _COLUMNS)
    values = table.values
    start, exit = _engaged(table, milling)
    rotation = values.get("rotation")
    return ForceReadings(
        feed_per_tooth=values["feed per tooth"],
        axial_depth=values["axial depth"],
        start=start,
        exit=exit,
        forces={axis: values[axis] for axis in AXES if axis in values},
        rotation=None if rotation is None else np.deg2rad(rotation),
        rows=table.rows,
        path=table.path,
    )


def _engaged(table: Table, milling: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Where a flute enters and leaves the stock, in rad."""
    values, path = table.values, table.path
    limits = [name for name in ("start", "exit") if name in values]
    if "engagement angle" in values:
        if limits:
            raise InputError(
                f"{path}: there are both '{limits[0]}' and 'engagement angle': keep one of them"
            )
        if milling not in ("down", "up"):
            raise InputError(
                f"{path}: a column 'engagement angle' does not say where a flute enters: "
                "name the milling, down or up, or write 'start [deg], exit [deg]' instead"
            )
        angle = values["engagement angle"]
        faulty = np.flatnonzero((angle < 0.0) | (angle > 180.0))
        if len(faulty):
            raise InputError(
                f"{place(path, int(table.rows[faulty[0]]))}: engagement angle "
                f"{angle[faulty[0]]:g} deg is not between 0 and 180: correct it, or delete the row"
            )
        alpha, zero = np.deg2rad(angle), np.zeros_like(angle)
        return (np.pi - alpha, zero + np.pi) if milling == "down" else (zero, alpha)
    if len(limits) == 1:
        missing = "exit" if limits == ["start"] else "start"
        raise InputError(
            f"{path}: there is '{limits[0]}' but no '{missing}': add '{missing} [deg]'"
        )
    if not limits:
        raise InputError(
            f"{path}: no column says where a flute is engaged: add 'start [deg], exit [deg]' or "
            "'engagement angle [deg]'"
        )
    return np.deg2rad(values["start"]), np.deg2rad(values["exit"])


def read_coefficients(path: str | os.PathLike[str]) -> dict[str, float]:
    """Read force coefficients from a TOML file or from the JSON of `procmodel force fit --out`.

    Parameters
    ----------
    path : path-like
        TOML with the keys `tangential_shear`, `radial_shear`, `axial_shear` [N/mm^2] and
        `tangential_edge`, `radial_edge`, `axial_edge` [N/mm], and if wanted a text `source`; or a
        file that ends in .json.

    Returns
    -------
    dict of str to float
        All six. Where both axial ones are absent, as after a fit without Fz, they are 0: no axial
        force is predicted then.

    Raises
    ------
    InputError
        If the file is neither, a coefficient is missing, not a number or misspelt, or the fit did
        not converge or left a coefficient open.
    """
    path = Path(path)
    text = read_utf8(path)
    found = _from_json(path, text) if path.suffix.lower() == ".json" else _from_toml(path, text)
    if not any(name in found for name in _AXIAL):
        found |= dict.fromkeys(_AXIAL, 0.0)
    for name in (*_IN_PLANE, *_AXIAL):
        if name not in found:
            raise InputError(f"{path}: there is no {name}: add it")
        value = found[name]
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not math.isfinite(value)
        ):
            raise InputError(f"{path}: {name} is {value!r}: write a finite number")
    return {name: float(found[name]) for name in (*_IN_PLANE, *_AXIAL)}


def _from_toml(path: Path, text: str) -> dict[str, Any]:
    try:
        found = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: this is not valid TOML ({error}): correct that line") from None
    found.pop("source", None)
    known = (*_IN_PLANE, *_AXIAL)
    for name in found:
        if name not in known:
            raise InputError(f"{path}: unknown key '{name}'{nearest(name, known)}")
    return found


def _from_json(path: Path, text: str) -> dict[str, Any]:
    try:
        result = json.loads(text)
        parameters = {
            name: result["parameters"][name]
            for name in (*_IN_PLANE, *_AXIAL)
            if name in result["parameters"]
        }
        values = {name: estimate["value"] for name, estimate in parameters.items()}
        open_ones = [
            name
            for name, estimate in parameters.items()
            if estimate["verdict"] == "flat" and estimate["interval95"] is None
        ]
        converged = result["converged"]
    except (json.JSONDecodeError, KeyError, TypeError):
        raise InputError(
            f"{path}: this is not the result of a fit: give the JSON of 'force fit --out'"
        ) from None
    if not converged:
        raise InputError(f"{path}: the fit did not converge ({result['status']}): fit again first")
    if open_ones:
        raise InputError(
            f"{path}: the forces left {' and '.join(open_ones)} open: measure at another feed or "
            "engagement and fit again"
        )
    return values
