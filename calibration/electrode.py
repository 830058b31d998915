"""From measured diameters to the problem that finds the discharge gap and its scatter.

The gap g of a pass is random: normal about `gap_mean` with standard deviation `gap_spread`. It is
read off twice measured diameters: of a drilled hole and its electrode, (D - d) / 2, or of an
electrode that the wire ground at a known distance r_p, r_p - r_w - d / 2 with wire radius r_w.
A diameter is measured within +-e. This is read as: every error inside is equally likely, none is
greater, so that its standard deviation is e / sqrt(3), which enters as normal.
Lengths in um.

References
----------
.. [1] Guo, Pei, Yu, Li: ten drilled holes with gaps from 11.2 to 18.3 um, measured within +-1 um.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.noise import NORMAL, Noise, Values
from calibration.parameters import Parameter
from calibration.priors import LogNormal, Normal
from calibration.problem import Dataset, Problem
from procmodel.errors import InputError
from procmodel.io.tables import Column, place, read_table

# Error of a measured diameter, of the measuring microscope in the paper.
DIAMETER_ERROR = 1.0
_HOLES = (
    Column("hole diameter", "um", positive=True),
    Column("electrode diameter", "um", positive=True),
)
_ELECTRODES = (
    Column("path radius", "um", positive=True),
    Column("electrode diameter", "um", positive=True),
)


@dataclass(frozen=True)
class GapPrior:
    """What is known of the gap before any reading; weak beside ten readings.

    Parameters
    ----------
    mean, mean_std : float [um]
        Normal prior of the mean gap.
    spread : float [um]
        Median of the log-normal prior of the spread. Nearly the usual 1/spread where the data
        speak, but finite where they do not, so that a few readings that happen to agree do not
        make the gap certain.
    spread_log_std : float
        Standard deviation of the log of the spread; 1 spans a factor of 50 from 2.5 to 97.5 %.

    Raises
    ------
    InputError
        If a number is not finite or, but for the mean, not above 0.
    """

    mean: float = 20.0
    mean_std: float = 10.0
    spread: float = 2.0
    spread_log_std: float = 1.0

    def __post_init__(self) -> None:
        if not math.isfinite(self.mean):
            raise InputError(f"prior mean of the gap is {self.mean}, but must be a finite number.")
        for name in ("mean_std", "spread", "spread_log_std"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"prior {name} of the gap is {value}, but must be above 0.")

    def parameters(self) -> dict[str, Parameter]:
        """The two unknowns of `gap_problem`."""
        return {
            "gap_mean": Parameter(self.mean, "um", prior=Normal(self.mean, self.mean_std)),
            "gap_spread": Parameter(
                self.spread,
                "um",
                bounds=(0.0, math.inf),
                prior=LogNormal(self.spread, self.spread_log_std),
                transform="log",
            ),
        }


WEAK_PRIOR = GapPrior()


@dataclass(frozen=True)
class GapData:
    """Readings of the discharge gap.

    Attributes
    ----------
    gap : ndarray, shape (n,) [um]
        The readings.
    sigma : float or ndarray, shape (n,) [um]
        Standard deviation that measuring alone gives each.
    passes : int or ndarray, shape (n,)
        Over how many independent gaps a reading goes: 1 for a hole or a turned diameter, 2 for a
        width across flats, each of which was a pass of its own.
    places : tuple of str
        Where each reading stands, for errors; its number when left out.

    Raises
    ------
    InputError
        If lengths differ, a gap is negative or not finite, or a sigma is not above 0.
    """

    gap: np.ndarray
    sigma: Any
    passes: Any = 1
    places: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        gap = np.atleast_1d(np.asarray(self.gap, float))
        if gap.ndim != 1 or len(gap) == 0:
            raise InputError(f"gap must be a list of readings, not an array of shape {gap.shape}.")
        object.__setattr__(self, "gap", gap)
        if not self.places:
            numbered = tuple(f"reading {i + 1}" for i in range(len(gap)))
            object.__setattr__(self, "places", numbered)
        for name, kind in (("sigma", float), ("passes", int)):
            values = np.asarray(getattr(self, name), float)
            if values.shape not in ((), gap.shape):
                raise InputError(
                    f"{name} has shape {values.shape} for {len(gap)} gaps: give one, or one each."
                )
            values = np.array(np.broadcast_to(values, gap.shape))
            self._require((values > 0) & np.isfinite(values), f"{name} is not above 0")
            self._require(values == values.astype(kind), f"{name} is not a whole number")
            object.__setattr__(self, name, values.astype(kind))
        self._require(np.isfinite(gap), "the gap is not a finite number")
        self._require(gap >= 0, "the gap is negative")

    def _require(self, holds: np.ndarray, fault: str) -> None:
        if not np.all(holds):
            where = self.places[int(np.argmin(holds))]
            raise InputError(f"{where}: {fault}: correct it, or delete the reading.")

    def __len__(self) -> int:
        return len(self.gap)

    def joined(self, other: "GapData") -> "GapData":
        """These readings and others after them.

        Parameters
        ----------
        other : GapData
            The others.

        Returns
        -------
        GapData
            All of them.
        """
        return GapData(
            np.concatenate([self.gap, other.gap]),
            np.concatenate([self.sigma, other.sigma]),
            np.concatenate([self.passes, other.passes]),
            self.places + other.places,
        )

    @classmethod
    def from_holes(
        cls,
        hole_diameter: Any,
        electrode_diameter: Any,
        diameter_error: float = DIAMETER_ERROR,
        repeats: int = 1,
        places: tuple[str, ...] = (),
    ) -> "GapData":
        """Gaps from drilled holes and the electrodes that drilled them.

        Parameters
        ----------
        hole_diameter, electrode_diameter : array_like, shape (n,) [um]
            Measured diameters.
        diameter_error : float [um]
            Greatest error of one measured diameter.
        repeats : int
            Over how many measurements each diameter is the mean.
        places : tuple of str
            Where each pair stands.

        Returns
        -------
        GapData
            The readings.

        Raises
        ------
        InputError
            If a hole is smaller than its electrode, or a number cannot be used.
        """
        holes = np.atleast_1d(np.asarray(hole_diameter, float))
        electrodes = np.atleast_1d(np.asarray(electrode_diameter, float))
        if holes.shape != electrodes.shape or holes.ndim != 1:
            raise InputError(
                f"hole and electrode diameters have shapes {holes.shape} and {electrodes.shape}: "
                "give one electrode diameter for each hole."
            )
        gap = 0.5 * (holes - electrodes)
        if np.any(gap < 0):
            i = int(np.argmax(gap < 0))
            raise InputError(
                f"{places[i] if places else f'hole {i + 1}'}: the hole of {holes[i]:g} um is "
                f"smaller than its electrode of {electrodes[i]:g} um, a negative gap: correct or "
                "exchange them, or delete the row."
            )
        # Half the difference of two diameters with independent errors.
        sigma = measured_std(diameter_error, repeats) / math.sqrt(2.0)
        return cls(gap, sigma, 1, places)

    @classmethod
    def from_electrodes(
        cls,
        path_radius: Any,
        electrode_diameter: Any,
        wire_radius: float,
        diameter_error: float = DIAMETER_ERROR,
        repeats: int = 1,
        passes: int = 1,
        places: tuple[str, ...] = (),
    ) -> "GapData":
        """Gaps from ground electrodes: where the wire was against what was measured.

        Parameters
        ----------
        path_radius : array_like, shape (n,) [um]
            Commanded distance of the wire's centre from the axis in the last pass, along a
            straight length of the electrode.
        electrode_diameter : array_like, shape (n,) [um]
            Measured diameters, or widths across flats.
        wire_radius : float [um]
            Radius of the wire.
        diameter_error, repeats, places
            As for `from_holes`.
        passes : int
            1 for diameters, 2 for widths across flats.

        Returns
        -------
        GapData
            The readings.

        Raises
        ------
        InputError
            If an electrode is thicker than its path allows, or a number cannot be used.
        """
        paths = np.atleast_1d(np.asarray(path_radius, float))
        diameters = np.atleast_1d(np.asarray(electrode_diameter, float))
        if paths.shape != diameters.shape or paths.ndim != 1:
            raise InputError(
                f"path radii and diameters have shapes {paths.shape} and {diameters.shape}: give "
                "one diameter for each path."
            )
        if not (math.isfinite(wire_radius) and wire_radius > 0):
            raise InputError(f"wire radius {wire_radius:g} um must be above 0.")
        gap = paths - wire_radius - 0.5 * diameters
        if np.any(gap < 0):
            i = int(np.argmax(gap < 0))
            raise InputError(
                f"{places[i] if places else f'electrode {i + 1}'}: the electrode of "
                f"{diameters[i]:g} um is thicker than a path at {paths[i]:g} um with a wire of "
                f"radius {wire_radius:g} um allows, a negative gap: correct them, or delete the "
                "row."
            )
        return cls(gap, 0.5 * measured_std(diameter_error, repeats), passes, places)


def read_holes(
    path: str | Path, diameter_error: float = DIAMETER_ERROR, repeats: int = 1
) -> GapData:
    """Gaps from a table with `hole diameter [um]` and `electrode diameter [um]`.

    Parameters
    ----------
    path : path-like
        A table as `procmodel.io.read_table` takes it.
    diameter_error, repeats
        As for `GapData.from_holes`.

    Returns
    -------
    GapData
        The readings, which know their rows.

    Raises
    ------
    InputError
        If the table is faulty or a hole is smaller than its electrode; names file and row.
    """
    (holes, electrodes), places = _columns(path, _HOLES)
    return GapData.from_holes(holes, electrodes, diameter_error, repeats, places)


def read_electrodes(
    path: str | Path,
    wire_radius: float,
    diameter_error: float = DIAMETER_ERROR,
    repeats: int = 1,
    passes: int = 1,
) -> GapData:
    """Gaps from a table with `path radius [um]` and `electrode diameter [um]`.

    Parameters
    ----------
    path : path-like
        A table as `procmodel.io.read_table` takes it.
    wire_radius, diameter_error, repeats, passes
        As for `GapData.from_electrodes`.

    Returns
    -------
    GapData
        The readings, which know their rows.

    Raises
    ------
    InputError
        If the table is faulty or an electrode thicker than its path allows; names file and row.
    """
    (paths, diameters), places = _columns(path, _ELECTRODES)
    return GapData.from_electrodes(
        paths, diameters, wire_radius, diameter_error, repeats, passes, places
    )


def _columns(
    path: str | Path, columns: tuple[Column, ...]
) -> tuple[list[np.ndarray], tuple[str, ...]]:
    """Columns of a table, and where each row stands."""
    table = read_table(path, columns)
    places = tuple(place(table.path, int(row)) for row in table.rows)
    return [table.values[column.name] for column in columns], places


def measured_std(diameter_error: float, repeats: int = 1) -> float:
    """Standard deviation of a measured diameter.

    Parameters
    ----------
    diameter_error : float [um]
        Greatest error e of one measurement; every error up to it is equally likely.
    repeats : int
        Over how many measurements the diameter is the mean.

    Returns
    -------
    float [um]
        e / sqrt(3 repeats).

    Raises
    ------
    InputError
        If one of them is not above 0.
    """
    if not (math.isfinite(diameter_error) and diameter_error > 0):
        raise InputError(
            f"error of a measured diameter is {diameter_error:g} um, but must be above 0."
        )
    if repeats < 1:
        raise InputError(f"repeats is {repeats}, but must be 1 or more.")
    return diameter_error / math.sqrt(3.0 * repeats)


@dataclass(frozen=True)
class GapScatter(Noise):
    """Normal scatter of the gap itself beside the error of measuring it.

    Parameters
    ----------
    passes : int
        Over how many independent gaps each reading goes.
    """

    passes: int = 1

    @property
    def names(self) -> dict[str, tuple[float, float]]:
        """The spread."""
        return {"gap_spread": (0.0, math.inf)}

    @property
    def takes(self) -> tuple[str, ...]:
        """The measuring error, as numbers."""
        return ("given",)

    def scale(self, prediction: Any, sigma: Any, values: Values) -> Array:
        """Both together: sqrt(sigma^2 + spread^2 / passes)."""
        return jnp.sqrt(sigma**2 + values["gap_spread"] ** 2 / self.passes)

    def log_likelihood(self, prediction: Array, y: Array, sigma: Array, values: Values) -> Array:
        """Of the normal distribution."""
        return NORMAL.log_likelihood(prediction, y, self.scale(prediction, sigma, values), values)

    def rows(self, prediction: Array, y: Array, sigma: Array, values: Values) -> tuple[Array, ...]:
        """Deviations, and the log of the standard deviations."""
        return NORMAL.rows(prediction, y, self.scale(prediction, sigma, values), values)

    def draw(
        self, rng: np.random.Generator, prediction: np.ndarray, sigma: np.ndarray, values: Any
    ) -> np.ndarray:
        """Normal readings."""
        return rng.normal(prediction, np.asarray(self.scale(prediction, sigma, values)))


def mean_gap(params: Mapping[str, Array], x: Array) -> Array:
    """The model: every reading is about the mean gap, shape (n,) [um]."""
    return params["gap_mean"] + 0.0 * x


def gap_problem(data: GapData, prior: GapPrior = WEAK_PRIOR) -> Problem:
    """The problem of the gap's mean and spread, for `fit`, `sample` and `simulation_check`.

    Parameters
    ----------
    data : GapData
        The readings.
    prior : GapPrior
        What is known before.

    Returns
    -------
    Problem
        Parameters `gap_mean` and `gap_spread` [um]; one data set for each number of passes.

    Raises
    ------
    InputError
        If there is a single reading, which tells nothing of the spread.
    """
    require_scatter(data)
    datasets = {}
    for passes in np.unique(data.passes):
        chosen = data.passes == passes
        name = "gaps" if passes == 1 else f"gaps_over_{passes}_passes"
        number = np.arange(1.0, 1.0 + np.count_nonzero(chosen))
        noise = GapScatter(int(passes))
        datasets[name] = Dataset(number, data.gap[chosen], data.sigma[chosen], noise=noise)
    name = "random discharge gap, normal scatter and measuring error"
    return Problem(prior.parameters(), datasets, mean_gap, name=name)


def require_scatter(data: GapData) -> None:
    """Refuse a single reading.

    Parameters
    ----------
    data : GapData
        The readings.

    Raises
    ------
    InputError
        If there is one.
    """
    if len(data) < 2:
        raise InputError(
            f"{data.places[0]}: a single gap of {data.gap[0]:g} um tells nothing of how gaps "
            "scatter: measure at least two, better ten."
        )
