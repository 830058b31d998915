"""The three electrodes: sizes to expect, the chance of 2 %, and what spoils a size."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from calibration.electrode import measured_std
from calibration.electrode_gap import GapPosterior
from calibration.plans.electrode import CorrectedPath, corrected_path, gap_window
from experiments.guo_wedg_electrodes.conditions import Conditions, Shape
from procmodel.electrode import chord_error, dimensions_with_gap, interpolate_arc, wire_path


@dataclass(frozen=True)
class GroundShape:
    """A shape with its corrected path, and sizes that draws of the gap leave by the wire's law.

    `sizes` has the shape (draws, widths, heights): a square has two widths at a height.
    """

    shape: Shape
    plan: CorrectedPath
    sizes: np.ndarray

    @property
    def share_within(self) -> float:
        """Share of the draws with every size within the tolerance."""
        wanted = np.array(self.shape.sizes)
        off = np.abs(self.sizes / wanted - 1.0)
        return float(np.mean(np.all(off <= self.plan.prediction.tolerance, axis=(1, 2))))


def ground(
    shape: Shape, posterior: GapPosterior, conditions: Conditions, draws: int = 4000
) -> GroundShape:
    """Correct the path, and grind the shape along it with gaps as they are believed to come."""
    plan = corrected_path(
        shape.sizes,
        posterior,
        conditions.wire_radius,
        loss="outside",
        tolerance=conditions.tolerance,
        passes=shape.passes,
        slope=shape.slopes,
        resolution=conditions.resolution,
    )
    path = wire_path(shape.profile, conditions.wire_radius, plan.counted_gap)
    mean, spread = posterior.draws(draws, conditions.seed)
    rng = np.random.default_rng(conditions.seed)
    sizes = []
    for _ in range(shape.widths):
        gaps = rng.normal(mean[:, None], spread[:, None], (draws, shape.passes))
        given = gaps[:, 0] if shape.passes == 1 else gaps[:, None, :]
        sizes.append(dimensions_with_gap(path, shape.heights, given, conditions.wire_radius))
    return GroundShape(shape, plan, np.stack([np.asarray(s) for s in sizes], axis=1))


def chance_of_all(
    plans: list[GroundShape], posterior: GapPosterior, conditions: Conditions
) -> float:
    """Probability that all sizes of all electrodes are within the tolerance."""
    windows = []
    for made in plans:
        low, high = gap_window(
            made.plan.path_radius,
            conditions.wire_radius,
            np.array(made.shape.sizes),
            conditions.tolerance,
            made.shape.slopes,
        )
        window = (float(np.max(low)), float(np.min(high)), made.shape.passes)
        windows += [window] * made.shape.widths
    return posterior.chance(windows)


def spread_for_even_odds(conditions: Conditions) -> float:
    """Spread of the gap at which all three electrodes are within the tolerance half the time.

    The mean gap is known and counted on, which is the best case.
    """

    def chance(spread: float) -> float:
        product = 1.0
        for shape in conditions.shapes:
            allowed = np.array(shape.sizes) * np.cos(shape.slopes)
            window = 0.5 * conditions.tolerance * float(np.min(allowed))
            inside = 2.0 * float(ndtr(window / (spread / math.sqrt(shape.passes)))) - 1.0
            product *= inside**shape.widths
        return product

    return float(brentq(lambda s: chance(s) - 0.5, 0.01, 10.0))


def diameter_for(chance: float, posterior: GapPosterior, conditions: Conditions) -> float:
    """Diameter from which on the tolerance is kept with this probability, the path corrected."""
    ahead = posterior.next_gap()
    middle = float(ahead.quantile(0.5))

    def missing(diameter: float) -> float:
        half = 0.5 * conditions.tolerance * diameter
        return float(np.diff(ahead.below([middle - half, middle + half]))[0]) - chance

    return float(brentq(missing, 1.0, 1e5))


@dataclass(frozen=True)
class Cause:
    """A cause of error: its standard deviation in a diameter [um]."""

    name: str
    std: float


def budget(posterior: GapPosterior, conditions: Conditions) -> tuple[Cause, ...]:
    """What spoils the diameter of a turned electrode, greatest first.

    Rounding is that of a commanded distance; the chord's greatest error is taken whole.
    """
    scatter = math.sqrt(float(posterior.weight @ posterior.spread**2))
    return (
        Cause("gap: scatter from pass to pass", 2.0 * scatter),
        Cause("gap: mean not known better", 2.0 * posterior.mean.deviation),
        Cause("measuring the diameter", measured_std(conditions.diameter_error)),
        Cause("resolution of the axes", 2.0 * conditions.resolution / math.sqrt(12.0)),
        Cause(
            "chord of the interpolation",
            2.0 * float(chord_error(conditions.arc_radius, conditions.step)),
        ),
    )


def rounding_on_the_arc(conditions: Conditions) -> tuple[float, float]:
    """Root mean square and greatest distance of rounded positions from a quarter arc [um]."""
    radius = conditions.arc_radius
    points = interpolate_arc(
        (0.0, 0.0), radius, 0.0, 0.5 * math.pi, conditions.step, conditions.resolution
    )
    off = np.hypot(points[:, 0], points[:, 1]) - radius
    return float(np.sqrt(np.mean(off**2))), float(np.max(np.abs(off)))
