"""The electrode's section and its way through one layer: what scanning makes and others follow.

Lengths in um, areas in um^2.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from procmodel.errors import InputError

_SHAPES = ("round", "square")
# A change of direction below this is a corner of a polyline that stands for a curve.
_TURN = math.radians(15.0)


@dataclass(frozen=True)
class ElectrodeSection:
    """Cross-section of the electrode, from above.

    Parameters
    ----------
    shape : {"round", "square"}
        A square's sides lie along x and y.
    size : float [um]
        Diameter or side, > 0.

    Raises
    ------
    InputError
        If the shape is unknown or the size not above 0.
    """

    shape: Literal["round", "square"]
    size: float

    def __post_init__(self) -> None:
        if self.shape not in _SHAPES:
            raise InputError(f"electrode shape {self.shape!r} is unknown: give round or square.")
        if not (math.isfinite(self.size) and self.size > 0):
            raise InputError(f"electrode size {self.size:g} um must be above 0.")

    @property
    def half(self) -> float:
        """Radius, or half the side [um]."""
        return self.size / 2.0

    @property
    def area(self) -> float:
        """Area S_e of the section [um^2]."""
        return math.pi * self.half**2 if self.shape == "round" else self.size**2


@dataclass(frozen=True)
class LayerPath:
    """Way of the electrode's centre through one layer.

    Parameters
    ----------
    points : ndarray, shape (m, 2) [um]
        Corners of the way, m >= 1.
    cutting : ndarray of bool, shape (m - 1,)
        Whether the move to the next point is made at depth; otherwise the electrode is lifted.
    quarter_turns : int
        Quarter turns of the electrode about its axis, from how it was mounted (slots, fig. 9).

    Raises
    ------
    InputError
        If the shapes do not fit or a point is not finite.
    """

    points: np.ndarray
    cutting: np.ndarray
    quarter_turns: int = 0

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 2 or len(self.points) < 1:
            raise InputError("points of a layer's path must be (x, y) pairs, at least one.")
        if not np.all(np.isfinite(self.points)):
            raise InputError("points of a layer's path must be finite numbers.")
        if self.cutting.shape != (len(self.points) - 1,):
            raise InputError("cutting of a layer's path must have one entry for every move.")

    @property
    def move_lengths(self) -> np.ndarray:
        """Length of every move, shape (m - 1,) [um]."""
        return np.hypot(*np.diff(self.points, axis=0).T)

    @property
    def length(self) -> float:
        """Length cut [um]."""
        return float(np.sum(self.move_lengths[self.cutting]))

    @property
    def lifted_length(self) -> float:
        """Length travelled with the electrode lifted [um]."""
        return float(np.sum(self.move_lengths[~self.cutting]))

    @property
    def turning_points(self) -> int:
        """Corners sharper than 15 degrees between two moves that cut."""
        steps = np.diff(self.points, axis=0)
        both = self.cutting[:-1] & self.cutting[1:]
        cross = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
        dot = np.sum(steps[:-1] * steps[1:], axis=1)
        return int(np.sum(both & (np.abs(np.arctan2(cross, dot)) > _TURN)))

    def reversed(self) -> "LayerPath":
        """The same way from its end to its start."""
        return LayerPath(self.points[::-1], self.cutting[::-1], self.quarter_turns)
