"""The path of the wire that leaves the wanted sizes as nearly as a random gap allows.

A profile is offset by wire radius and a gap that is counted on; the gap that comes is random, and
the same all along one pass, so that all diameters of an electrode are off by the same amount,
2 (counted on - come). Where the surface slopes by an angle a against the axis, gap and wire radius
lie across it, and both count 1 / cos(a) times in a diameter at a given height. What can be chosen
is the gap counted on. Lengths in um, angles in rad.

References
----------
.. [1] Guo, Pei, Yu, Li: shaped electrodes within 2 % of the drawing.
"""

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.stats import norm
from jax.typing import ArrayLike
from scipy.optimize import brentq

from calibration.electrode import measured_std
from calibration.electrode_gap import GapPosterior, NormalMixture
from procmodel.electrode.size import finished_diameter, path_radius
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

LOSSES = ("absolute", "squared", "outside")
# Share of the drawing's size that the paper's electrodes kept within.
TOLERANCE = 0.02
# From here on a surface is a face of the electrode and no flank.
_STEEPEST = math.radians(80.0)
# Levels between which the gap to be counted on is looked for.
_ENDS = (1e-4, 1.0 - 1e-4)


@dataclass(frozen=True)
class SizePrediction:
    """Sizes to expect of the next electrode.

    Attributes
    ----------
    path_radius : ndarray, shape (n,) [um]
        Commanded distance of the wire's centre from the axis.
    size : ndarray, shape (n,) [um]
        Expected diameter, or width across flats.
    std : ndarray, shape (n,) [um]
        Standard deviation; the same for every size of a surface along the axis.
    interval : ndarray, shape (n, 2) [um]
        Each size lies inside with probability `level`.
    level : float
        That probability.
    wanted : ndarray, shape (n,) [um], or None
        Sizes of the drawing.
    within : ndarray, shape (n,), or None
        Probability that each is within the tolerance of the drawing.
    all_within : float or None
        Probability that all are, on all sides; None where measured sizes are predicted.
    tolerance : float or None
        Share of each size that it may be off by.
    """

    path_radius: np.ndarray
    size: np.ndarray
    std: np.ndarray
    interval: np.ndarray
    level: float
    wanted: np.ndarray | None
    within: np.ndarray | None
    all_within: float | None
    tolerance: float | None

    def as_dict(self) -> dict[str, Any]:
        """The prediction as plain types."""
        return {
            "path_radius": self.path_radius.tolist(),
            "wanted": None if self.wanted is None else self.wanted.tolist(),
            "size": self.size.tolist(),
            "std": self.std.tolist(),
            "level": self.level,
            "interval": self.interval.tolist(),
            "within": None if self.within is None else self.within.tolist(),
            "all_within": self.all_within,
            "tolerance": self.tolerance,
        }


@dataclass(frozen=True)
class CorrectedPath:
    """The path that is best by what is known of the gap.

    Attributes
    ----------
    counted_gap : float [um]
        Gap that the path counts on, before rounding to the resolution.
    expected_error : float
        Least expected error of a size: absolute [um], squared [um^2] or the probability of one
        outside the tolerance.
    loss : str
        Which of them.
    prediction : SizePrediction
        What to expect of the rounded path.
    status : str
        A sentence.
    """

    counted_gap: float
    expected_error: float
    loss: str
    prediction: SizePrediction
    status: str

    @property
    def path_radius(self) -> np.ndarray:
        """Commanded distance of the wire's centre, shape (n,) [um]."""
        return self.prediction.path_radius


def expected_size_error(
    counted_gap: ArrayLike,
    weight: ArrayLike,
    centre: ArrayLike,
    std: ArrayLike,
    loss: str,
    window: ArrayLike = jnp.inf,
) -> Array:
    """Expected error of a diameter when a gap is counted on; differentiable.

    The error is 2 (counted - come), and the gap that comes a mixture of normal distributions.

    Parameters
    ----------
    counted_gap : array_like, scalar [um]
        Gap that is counted on.
    weight, centre, std : array_like, shape (k,)
        The mixture; see `NormalMixture`.
    loss : {"absolute", "squared", "outside"}
        Absolute error, its square, or the probability of more than `window`.
    window : array_like, scalar [um]
        Error of the diameter that is still allowed.

    Returns
    -------
    Array, scalar [um], [um^2] or [1]
        The expectation in closed form.
    """
    weight, centre, std, window = (jnp.asarray(a) for a in (weight, centre, std, window))
    off, scatter = 2.0 * (jnp.asarray(counted_gap) - centre), 2.0 * std
    z = off / scatter
    if loss == "absolute":
        each = off * (2.0 * norm.cdf(z) - 1.0) + 2.0 * scatter * norm.pdf(z)
    elif loss == "squared":
        each = off**2 + scatter**2
    elif loss == "outside":
        each = norm.cdf((-window - off) / scatter) + norm.cdf((off - window) / scatter)
    else:
        raise InputError(f"loss {loss!r} is unknown{nearest(loss, LOSSES)}.")
    return jnp.sum(weight * each)


def corrected_path(
    wanted: Any,
    posterior: GapPosterior,
    wire_radius: float,
    *,
    loss: str = "absolute",
    tolerance: float = TOLERANCE,
    passes: int = 1,
    slope: Any = 0.0,
    resolution: float = 0.1,
    level: float = 0.9,
    diameter_error: float = 0.0,
) -> CorrectedPath:
    """The path with the least expected size error.

    Parameters
    ----------
    wanted : array_like, shape (n,) [um]
        Diameters of the drawing, or widths across flats.
    posterior : GapPosterior
        What is known of the gap, from `fit_gap` and updates.
    wire_radius : float [um]
        Radius of the wire.
    loss : {"absolute", "squared", "outside"}
        What to make small on average: error, squared error, or missing the tolerance.
    tolerance : float
        Share of each size that it may be off by.
    passes : int
        1 for a turning electrode, 2 for widths across indexed flats, where the mean of two gaps
        counts; two pairs of flats then have to be within the tolerance together.
    slope : float or array_like, shape (n,) [rad]
        Angle between surface and axis where each size is looked at; atan of the change of radius
        over that of height.
    resolution : float [um]
        Step of the machine's axes, to which the path is rounded.
    level : float
        Probability inside the intervals.
    diameter_error : float [um]
        Above 0: predict what will be measured with this greatest error, not the size itself.

    Returns
    -------
    CorrectedPath
        The path and what it will leave.

    Raises
    ------
    InputError
        If a number is out of its range.
    """
    require_float64("A corrected path")
    sizes = _sizes("wanted size", wanted)
    if loss not in LOSSES:
        raise InputError(f"loss {loss!r} is unknown{nearest(loss, LOSSES)}.")
    _require_above_zero("resolution", resolution)
    _require_tolerance(tolerance)
    sigma = 0.5 * measured_std(diameter_error) if diameter_error else 0.0
    ahead = posterior.next_gap(passes, sigma)
    across = _across(slope, len(sizes))
    window = tolerance * float(np.min(sizes / across))
    counted = _best_gap(ahead, loss, window)
    exact = np.asarray(path_radius(0.5 * sizes, wire_radius * across, counted * across))
    rounded = resolution * np.round(exact / resolution)
    prediction = predict_sizes(
        rounded,
        posterior,
        wire_radius,
        wanted=sizes,
        tolerance=tolerance,
        passes=passes,
        slope=slope,
        level=level,
        diameter_error=diameter_error,
    )
    least = float(expected_size_error(counted, ahead.weight, ahead.centre, ahead.std, loss, window))
    status = f"least expected {_NAMES[loss]} when a gap of {counted:.4g} um is counted on" + (
        "" if posterior.readings else "; no gap was measured, the prior alone decides"
    )
    return CorrectedPath(counted, least, loss, prediction, status)


_NAMES = {
    "absolute": "absolute error of a size",
    "squared": "squared error of a size",
    "outside": "probability to miss the tolerance",
}


def predict_sizes(
    path: Any,
    posterior: GapPosterior,
    wire_radius: float,
    *,
    wanted: Any = None,
    tolerance: float = TOLERANCE,
    passes: int = 1,
    slope: Any = 0.0,
    level: float = 0.9,
    diameter_error: float = 0.0,
) -> SizePrediction:
    """Sizes that a path will leave, with their intervals.

    Parameters
    ----------
    path : array_like, shape (n,) [um]
        Commanded distance of the wire's centre from the axis; where the surface slopes, that of
        the path at the height of the size.
    posterior, wire_radius, tolerance, passes, slope, level, diameter_error
        As for `corrected_path`.
    wanted : array_like, shape (n,) [um], optional
        Sizes of the drawing.

    Returns
    -------
    SizePrediction
        Intervals and, where sizes are wanted, probabilities.

    Raises
    ------
    InputError
        If a number is out of its range.
    """
    paths = _sizes("path radius", path)
    _require_above_zero("wire radius", wire_radius)
    _require_tolerance(tolerance)
    if not 0 < level < 1:
        raise InputError(f"level is {level:g}, but must be between 0 and 1.")
    if np.min(paths) <= wire_radius:
        raise InputError(
            f"path radius {np.min(paths):g} um is not above the wire radius {wire_radius:g} um: "
            "the wire would cut through the axis."
        )
    sigma = 0.5 * measured_std(diameter_error) if diameter_error else 0.0
    across = _across(slope, len(paths))
    ahead = posterior.next_gap(passes, sigma)

    def left(gap: float) -> np.ndarray:
        return np.asarray(finished_diameter(paths, wire_radius * across, gap * across))

    low, high = ahead.interval(level)
    within, together, drawing = None, None, None
    if wanted is not None:
        drawing = _sizes("wanted size", wanted)
        if drawing.shape != paths.shape:
            raise InputError(f"{len(drawing)} sizes are wanted of {len(paths)} path radii.")
        window = gap_window(paths, wire_radius, drawing, tolerance, slope)
        within = ahead.below(window[1]) - ahead.below(window[0])
        tightest = (float(np.max(window[0])), float(np.min(window[1])))
        if sigma == 0.0:
            together = posterior.chance([(*tightest, passes)] * (2 if passes > 1 else 1))
    return SizePrediction(
        path_radius=paths,
        size=left(ahead.mean),
        std=2.0 * ahead.deviation * across,
        interval=np.stack([left(high), left(low)], axis=1),
        level=level,
        wanted=drawing,
        within=within,
        all_within=together,
        tolerance=None if drawing is None else tolerance,
    )


def gap_window(
    path: np.ndarray,
    wire_radius: float,
    wanted: np.ndarray,
    tolerance: float,
    slope: Any = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Gaps that keep sizes within the tolerance.

    Parameters
    ----------
    path, wanted : ndarray, shape (n,) [um]
        Path radii and sizes of the drawing.
    wire_radius : float [um]
        Radius of the wire.
    tolerance : float
        Share of each size that it may be off by.
    slope : float or array_like, shape (n,) [rad]
        As for `corrected_path`.

    Returns
    -------
    ndarray, ndarray, each of shape (n,) [um]
        Lowest and highest gap.
    """
    across = _across(slope, len(path))
    exact = (path - 0.5 * wanted) / across - wire_radius
    half = 0.5 * tolerance * wanted / across
    return exact - half, exact + half


# Compiled once for every loss, whatever the numbers.
_slope = jax.jit(jax.grad(expected_size_error), static_argnames="loss")


def _best_gap(ahead: NormalMixture, loss: str, window: float) -> float:
    """Where the slope of the expected error changes its sign."""

    def slope(counted: float) -> float:
        return float(_slope(counted, ahead.weight, ahead.centre, ahead.std, loss, window))

    low, high = (float(q) for q in ahead.quantile(_ENDS))
    if not slope(low) < 0.0 < slope(high):
        # A window so wide that every gap in reach is as good: stay in the middle of it.
        return float(ahead.quantile(0.5))
    return float(brentq(slope, low, high, xtol=1e-10))


def _across(slope: Any, count: int) -> np.ndarray:
    """How many times a distance across the surface counts along a radius, shape (count,)."""
    angle = np.asarray(slope, float)
    if angle.shape not in ((), (count,)):
        raise InputError(f"slope has shape {angle.shape} for {count} sizes: give one, or one each.")
    if not np.all(np.abs(angle) <= _STEEPEST):
        raise InputError(
            "a slope is not within +-80 deg of the axis: no diameter can be told of a face."
        )
    return np.array(np.broadcast_to(1.0 / np.cos(angle), (count,)))


def _sizes(name: str, given: Any) -> np.ndarray:
    sizes = np.atleast_1d(np.asarray(given, float))
    if sizes.ndim != 1 or len(sizes) == 0:
        raise InputError(f"{name} must be one number or a list of them.")
    for value in sizes:
        _require_above_zero(name, float(value))
    return sizes


def _require_above_zero(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise InputError(f"{name} is {value:g} um, but must be above 0.")


def _require_tolerance(tolerance: float) -> None:
    if not 0 < tolerance < 1:
        raise InputError(
            f"tolerance is {tolerance:g}, but must be a share between 0 and 1, such as 0.02."
        )
