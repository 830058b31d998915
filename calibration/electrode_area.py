"""How uncertain an electrode's cross-section is, and what that does to wear ratio and feeds.

Depths of a test cavity determine the wear per area, R / S_e. The wear ratio R that a fit reports
is proportional to the electrode area it was given; an electrode ground blind has an area that is
known to some per cent only. Which electrode cuts the next cavity decides what of this matters:
the same one, nothing; another one, the ratio of both areas. Lengths in um, areas in um^2.
"""

import math
from dataclasses import dataclass

import numpy as np
import xarray
from scipy.special import ndtr, ndtri

from calibration.electrode import DIAMETER_ERROR, measured_std
from calibration.electrode_gap import GapPosterior
from calibration.result import FitResult
from procmodel.electrode.size import finished_diameter, rectangle_area, round_area
from procmodel.errors import InputError, nearest

SHAPES = ("round", "square")
# A measurement that the known gaps make rarer than this is taken for a mistake.
_TOO_RARE = 1e-6


@dataclass(frozen=True)
class ElectrodeArea:
    """Equally likely cross-sections of an electrode.

    Attributes
    ----------
    draws : ndarray, shape (m,) [um^2]
        The draws.
    gap_mean, gap_spread : ndarray, shape (m,) [um]
        Mean and spread of the gap that each was ground with; electrodes that share them are
        ground on one machine.
    status : str
        How they came about, a sentence.
    order : int
        How many electrodes were drawn beside each other before this one.
    """

    draws: np.ndarray
    gap_mean: np.ndarray
    gap_spread: np.ndarray
    status: str
    order: int = 0

    @property
    def mean(self) -> float:
        """Mean [um^2]."""
        return float(np.mean(self.draws))

    @property
    def std(self) -> float:
        """Standard deviation [um^2]."""
        return float(np.std(self.draws, ddof=1))

    @property
    def relative(self) -> float:
        """Standard deviation over mean."""
        return self.std / self.mean

    def interval(self, level: float = 0.9) -> tuple[float, float]:
        """Interval with as much probability below as above [um^2]."""
        low, high = np.quantile(self.draws, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
        return float(low), float(high)

    def as_tree(self) -> xarray.DataTree:
        """The draws as a DataTree with `electrode_area`, as `calibration.sample` gives them."""
        import arviz_base

        chains = 4 if len(self.draws) % 4 == 0 else 1
        columns = {
            "electrode_area": self.draws.reshape(chains, -1),
            "gap_mean": self.gap_mean.reshape(chains, -1),
            "gap_spread": self.gap_spread.reshape(chains, -1),
        }
        tree = arviz_base.from_dict({"posterior": columns})
        for name, unit in (("electrode_area", "um^2"), ("gap_mean", "um"), ("gap_spread", "um")):
            tree["posterior"][name].attrs["unit"] = unit
        tree.attrs = {"sampler": "independent draws", "converged": 1, "status": self.status}
        return tree


def electrode_area(
    posterior: GapPosterior,
    path_radius: float,
    wire_radius: float,
    *,
    shape: str = "round",
    slope: float = 0.0,
    measured: float | None = None,
    diameter_error: float = DIAMETER_ERROR,
    beside: ElectrodeArea | None = None,
    count: int = 4000,
    seed: int = 0,
) -> ElectrodeArea:
    """Cross-section of an electrode, ground blind or measured afterwards.

    Parameters
    ----------
    posterior : GapPosterior
        What is known of the gap.
    path_radius : float [um]
        Commanded distance of the wire's centre from the axis.
    wire_radius : float [um]
        Radius of the wire.
    shape : {"round", "square"}
        Turned in one pass, or four flats ground in a pass each.
    slope : float [rad]
        Angle between surface and axis where the cross-section is looked at, of an electrode that
        is not measured; wire radius and gap lie across the surface.
    measured : float, optional [um]
        Measured diameter of a round electrode; then its error is all that is left.
    diameter_error : float [um]
        Greatest error of that measurement; every error up to it is equally likely.
    beside : ElectrodeArea, optional
        Another electrode of the machine: mean and spread of the gap are the same in every draw,
        the gap itself is another.
    count : int
        Number of draws; as many as `beside` has.
    seed : int
        Same seed, same draws.

    Returns
    -------
    ElectrodeArea
        The draws.

    Raises
    ------
    InputError
        If the gap may leave nothing of the electrode, or the measured diameter cannot be its own.
    """
    if shape not in SHAPES:
        raise InputError(f"shape {shape!r} is unknown{nearest(shape, SHAPES)}.")
    if count < 2:
        raise InputError(f"count is {count}, but must be at least 2.")
    if measured is not None:
        if shape != "round" or slope != 0.0 or beside is not None:
            raise InputError(
                "measured is for a round, straight electrode by itself: update the posterior with "
                "the electrode beside it first."
            )
        gap, mean, spread = _measured_gaps(
            posterior, path_radius, wire_radius, measured, diameter_error, count, seed
        )
        area = np.asarray(round_area(finished_diameter(path_radius, wire_radius, gap)))
        said = f"a round electrode, measured as {measured:g} um within +-{diameter_error:g} um"
        return ElectrodeArea(area, mean, spread, said)
    if beside is None:
        mean, spread = posterior.draws(count, seed)
    else:
        mean, spread = beside.gap_mean, beside.gap_spread
    order = 0 if beside is None else beside.order + 1
    # A stream of its own for every electrode, so that its gap is independent of the others'.
    rng = np.random.default_rng((seed, 1, order))
    gaps = rng.normal(mean, spread, (1 if shape == "round" else 4, len(mean))) / math.cos(slope)
    wire_radius = wire_radius / math.cos(slope)
    nothing = np.any(path_radius - wire_radius - gaps <= 0, axis=0)
    if np.any(nothing):
        raise InputError(
            f"path radius {path_radius:g} um leaves nothing of the electrode with probability "
            f"{float(np.mean(nothing)):.2g}: move the path outwards."
        )
    if shape == "round":
        area = np.asarray(round_area(finished_diameter(path_radius, wire_radius, gaps[0])))
        said = "a round electrode, ground in one pass and not measured"
    else:
        across = finished_diameter(path_radius, wire_radius, 0.5 * (gaps[:2] + gaps[2:]))
        area = np.asarray(rectangle_area(across[0], across[1]))
        said = "a square electrode, its flats ground in a pass each and not measured"
    return ElectrodeArea(area, mean, spread, said, order)


def _measured_gaps(
    posterior: GapPosterior,
    path_radius: float,
    wire_radius: float,
    measured: float,
    diameter_error: float,
    count: int,
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws of gap, mean and spread, each of shape (count,), where a diameter was measured."""
    measured_std(diameter_error)
    widest = path_radius - wire_radius - 0.5 * (measured - diameter_error)
    if measured - diameter_error <= 0 or widest < 0:
        raise InputError(
            f"a diameter of {measured:g} um cannot come from path radius {path_radius:g} um and "
            f"wire radius {wire_radius:g} um: correct one of them."
        )
    ahead = posterior.next_gap()
    low, high = widest - diameter_error, widest
    if min(float(ahead.below(high)), 1.0 - float(ahead.below(low))) < _TOO_RARE:
        raise InputError(
            f"a diameter of {measured:g} um is too far from what the known gaps leave at path "
            f"radius {path_radius:g} um: check wire radius, path and measurement."
        )
    # The gap is as predicted, cut to where the measurement allows it.
    rng = np.random.default_rng((seed, 1, 0))
    starts, ends = (ndtr((end - ahead.centre) / ahead.std) for end in (low, high))
    chance = ahead.weight * (ends - starts)
    part = rng.choice(len(chance), count, p=chance / np.sum(chance))
    share = starts[part] + rng.uniform(size=count) * (ends - starts)[part]
    gap = np.clip(ahead.centre[part] + ahead.std[part] * ndtri(share), low, high)
    # Mean given this gap and the spread that it was drawn with.
    known, scatter = 1.0 / posterior.std[part] ** 2, 1.0 / posterior.spread[part] ** 2
    centre = (posterior.centre[part] * known + gap * scatter) / (known + scatter)
    return gap, rng.normal(centre, 1.0 / np.sqrt(known + scatter)), posterior.spread[part]


def wear_ratio_for(
    fit: FitResult,
    test_electrode: ElectrodeArea,
    next_electrode: ElectrodeArea | None,
    planned_area: float,
    seed: int = 0,
) -> np.ndarray:
    """Wear ratios to plan the next cavity with, the areas of both electrodes uncertain.

    The plan computes with one area, `planned_area`, and a wear ratio; only R / S_e of the
    electrode that cuts matters. With the fitted wear per area r, the area S of the electrode that
    cut the test cavity and S' of the next, that is R / S' = r S / S', so that the wear ratio to
    plan with is r S / S' times the planned area.

    Parameters
    ----------
    fit : FitResult
        Of a test cavity; has `wear_per_area` [1/um^2].
    test_electrode : ElectrodeArea
        Area of the electrode that cut it.
    next_electrode : ElectrodeArea or None
        Area of the one that cuts the next cavity, of as many draws; None for the same one, whose
        area then does not matter.
    planned_area : float [um^2]
        Area that the plan is given.
    seed : int
        Of the draws of the wear per area.

    Returns
    -------
    ndarray, shape (m,)
        Equally likely wear ratios, as `calibration.plans.schedule` takes them.

    Raises
    ------
    InputError
        If the fit has no wear per area to draw from, or the draws differ in number.
    """
    if not (math.isfinite(planned_area) and planned_area > 0):
        raise InputError(f"planned area is {planned_area:g} um^2, but must be above 0.")
    per_area = _wear_per_area(fit, len(test_electrode.draws), seed)
    if next_electrode is None:
        return per_area * planned_area
    if len(next_electrode.draws) != len(test_electrode.draws):
        raise InputError(
            f"the electrodes have {len(test_electrode.draws)} and {len(next_electrode.draws)} "
            "draws: make as many of each."
        )
    return per_area * planned_area * test_electrode.draws / next_electrode.draws


def wear_ratio_draws(fit: FitResult, electrode: ElectrodeArea, seed: int = 0) -> np.ndarray:
    """The wear ratio itself, with the area of the electrode that cut the test cavity uncertain.

    Parameters
    ----------
    fit : FitResult
        Of a test cavity; has `wear_per_area`.
    electrode : ElectrodeArea
        Area of the electrode that cut it.
    seed : int
        Of the draws of the wear per area.

    Returns
    -------
    ndarray, shape (m,)
        Equally likely wear ratios.

    Raises
    ------
    InputError
        If the fit has no wear per area to draw from.
    """
    return _wear_per_area(fit, len(electrode.draws), seed) * electrode.draws


def _wear_per_area(fit: FitResult, count: int, seed: int) -> np.ndarray:
    estimate = fit.parameters.get("wear_per_area")
    if estimate is None or estimate.std is None or not fit.converged:
        raise InputError(
            "the fit has no wear_per_area with a standard deviation: fit a test cavity with "
            "calibration.wear first."
        )
    levels = (np.arange(count) + 0.5) / count
    shuffled = np.random.default_rng((seed, 2)).permutation(levels)
    return np.maximum(fit.quantiles("wear_per_area", shuffled), 0.0)
