"""The cavities of figs 12 and 16 (constant feed), 17, 19, 20 (compensated), 21, 22 (finished).

Pure computation: conditions in, arrays and figures of merit out. A wall is judged at the outer
bottom corners of its layers: wall error is the depth reached there less the depth wanted there.

Lengths in um, areas in um^2.
"""

from dataclasses import dataclass

import numpy as np
import scipy.special

from calibration.plans.schedule import Machine, Schedule, exact_schedule
from experiments.yu_1997_cavities.conditions import Conditions, Electrode, KnownCase, Wanted
from procmodel.wear import (
    AnnulusSection,
    LayeredCavity,
    SquareSection,
    StagedCavity,
    TargetLayers,
    constant_step_half_widths,
    continuous_wall_depth,
    pyramid,
    slice_solid,
)


@dataclass(frozen=True)
class ConstantFeedWall:
    """Square cavity cut with constant feed: the layers and the limit of thin ones."""

    cavity: LayeredCavity
    wear_ratio: float
    electrode_area: float
    step: float
    feed: float

    @property
    def half_widths(self) -> np.ndarray:
        """Half width of every layer, shape (n,) [um]."""
        return np.asarray(self.cavity.half_widths)

    @property
    def depths(self) -> np.ndarray:
        """Depth after every layer, shape (n,) [um]."""
        return np.asarray(self.cavity.depths)

    @property
    def innermost(self) -> float:
        """Where the thin-layer wall meets the floor: one step inside the last layer [um]."""
        return float(self.half_widths[-1]) - self.step

    def limit(self, position: np.ndarray) -> np.ndarray:
        """Wall of infinitely thin layers, the arctangent, shape (m,) [um]."""
        wear_per_area = self.wear_ratio / self.electrode_area
        slope = self.feed / self.step
        return np.asarray(
            continuous_wall_depth(position, self.half_widths[0], wear_per_area, slope=slope)
        )

    def intended(self, position: np.ndarray) -> np.ndarray:
        """The straight wall that the same feed cuts without wear, shape (m,) [um]."""
        return (self.half_widths[0] - position) * self.feed / self.step


def constant_feed_wall(
    half_width: float,
    step: float,
    feed: float,
    layers: int,
    wear_ratio: float,
    electrode_area: float,
) -> ConstantFeedWall:
    """Square cavity with constant feed, eqs (4) and (5)."""
    half_widths = constant_step_half_widths(half_width, step, layers)
    cavity = LayeredCavity(half_widths, feed, SquareSection(), wear_ratio, electrode_area)
    return ConstantFeedWall(cavity, wear_ratio, electrode_area, step, feed)


def paper_wall(conditions: Conditions) -> ConstantFeedWall:
    """Figs 12 and 16: the paper's electrode, the rest as assumed."""
    electrode = conditions.roughing
    return constant_feed_wall(
        conditions.opening,
        conditions.test_step,
        conditions.test_feed,
        conditions.test_layers,
        electrode.wear_ratio,
        electrode.area,
    )


def known_wall(case: KnownCase, layers: int) -> ConstantFeedWall:
    """A whole pyramid of equal steps and feeds, half width over layers."""
    step = case.half_width / layers
    return constant_feed_wall(
        case.half_width, step, step, layers, case.wear_ratio, case.electrode_area
    )


def known_schedule(case: KnownCase, layer_depth: float) -> Schedule:
    """Exact feeds for the 45 degree pyramid on the known case's opening."""
    layers = slice_solid(pyramid(case.half_width, np.pi / 4), layer_depth)
    return exact_schedule(layers, case.wear_ratio, case.electrode_area)


@dataclass(frozen=True)
class CompensatedCavity:
    """A wanted cavity, its plan, and the walls that three ways of feeding leave.

    Depths have shape (n,) [um]. `planned` is cut with the planned feeds as the machine rounds
    them, `plain` feeds every layer by its wanted depth, `even` spreads the plan's total feed
    evenly over the layers.
    """

    wanted: Wanted
    schedule: Schedule
    planned: np.ndarray
    plain: np.ndarray
    even: np.ndarray

    @property
    def layers(self) -> TargetLayers:
        """The wanted layers."""
        return self.schedule.layers

    def max_error(self, depths: np.ndarray) -> float:
        """Greatest wall error of one of the walls, as a depth [um]."""
        return float(np.max(np.abs(depths - np.asarray(self.layers.bottom))))


def compensated(wanted: Wanted, conditions: Conditions) -> CompensatedCavity:
    """Plan the exact feeds, and cut with them and with constant ones."""
    electrode = conditions.roughing
    layers = slice_solid(wanted.solid, conditions.layer_depth, wanted.depth)
    machine = Machine(resolution=conditions.resolution)
    schedule = exact_schedule(layers, electrode.wear_ratio, electrode.area, machine)
    return CompensatedCavity(
        wanted=wanted,
        schedule=schedule,
        planned=cut(wanted, layers, told_feeds(schedule), electrode),
        plain=cut(wanted, layers, np.asarray(layers.thickness), electrode),
        even=cut(wanted, layers, np.full(len(schedule.feeds), schedule.feeds.mean()), electrode),
    )


def told_feeds(schedule: Schedule) -> np.ndarray:
    """Feed of every layer as the machine makes it, from the rounded cumulative feed [um]."""
    return np.diff(schedule.cumulative_feed, prepend=0.0)


def cut(
    wanted: Wanted, layers: TargetLayers, feeds: np.ndarray, electrode: Electrode
) -> np.ndarray:
    """Depth after every layer by the forward model, shape (n,) [um]."""
    half_widths, ratio, area = layers.half_width, electrode.wear_ratio, electrode.area
    return np.asarray(LayeredCavity(half_widths, feeds, wanted.section, ratio, area).depths)


@dataclass(frozen=True)
class FinishedCavity:
    """A cavity roughed short of its wall by a ring, which finishing then takes off."""

    wanted: Wanted
    staged: StagedCavity
    rough_plan: Schedule
    finish_plan: Schedule
    with_roughing_ratio: float

    @property
    def max_error(self) -> float:
        """Greatest error of the finished wall at the layers' corners [um]."""
        depths = np.asarray(self.staged.finishing.depths)
        return float(np.max(np.abs(depths - np.asarray(self.finish_plan.layers.bottom))))

    @property
    def electrode_lengths(self) -> tuple[float, float]:
        """Electrode length consumed in roughing and in finishing [um]."""
        rough, finish = np.asarray(self.staged.electrode_lengths)
        return float(rough), float(finish)


def ring_is_thick_enough(ring: float, electrode_size: float) -> bool:
    """Section 3.4: the ring must be thicker than half the finishing electrode's size."""
    return ring > 0.5 * electrode_size


def finished(wanted: Wanted, conditions: Conditions) -> FinishedCavity:
    """Rough short of the wall by the ring, then finish with the ring's own area and wear ratio.

    Roughing stops at the last layer whose opening, less the ring, still admits its electrode;
    below that finishing clears whole layers.

    Raises
    ------
    ValueError
        If the ring is too thin for the finishing electrode.
    """
    rough, finish = conditions.roughing, conditions.finishing
    if not ring_is_thick_enough(conditions.ring, finish.size):
        raise ValueError(
            f"a ring of {conditions.ring:g} um is not thicker than half of the electrode's "
            f"{finish.size:g} um."
        )
    layers = slice_solid(wanted.solid, conditions.layer_depth, wanted.depth)
    machine = Machine(resolution=conditions.resolution)
    half_width = np.asarray(layers.half_width)
    inner = half_width - conditions.ring
    roughed = inner >= rough.radius
    count = int(np.sum(roughed))
    rough_layers = TargetLayers(
        bottom=layers.bottom[:count],
        thickness=layers.thickness[:count],
        half_width=inner[:count],
        area=wanted.section.area(inner[:count]),
    )
    annulus = AnnulusSection(wanted.section, np.where(roughed, conditions.ring, half_width))
    ring_layers = TargetLayers(
        bottom=layers.bottom,
        thickness=layers.thickness,
        half_width=half_width,
        area=annulus.area(half_width),
    )
    rough_plan = exact_schedule(rough_layers, rough.wear_ratio, rough.area, machine)
    finish_plan = exact_schedule(ring_layers, finish.wear_ratio, finish.area, machine)
    mistaken = exact_schedule(ring_layers, rough.wear_ratio, finish.area, machine)

    def finishing(plan: Schedule) -> LayeredCavity:
        return LayeredCavity(half_width, told_feeds(plan), annulus, finish.wear_ratio, finish.area)

    roughing = LayeredCavity(
        inner[:count], told_feeds(rough_plan), wanted.section, rough.wear_ratio, rough.area
    )
    short = np.asarray(layers.bottom) - np.asarray(finishing(mistaken).depths)
    return FinishedCavity(
        wanted=wanted,
        staged=StagedCavity(roughing, finishing(finish_plan)),
        rough_plan=rough_plan,
        finish_plan=finish_plan,
        with_roughing_ratio=float(np.max(np.abs(short))),
    )


def startup_decay(relative_wear: float) -> float:
    """Factor by which the start-up transient shrinks with every repeated layer.

    The layers' delay equation T' = -[T(x) - T(x - P)] / lambda has modes exp(z x / P) with
    z = -u (1 - exp(-z)), that is (z + u) exp(z + u) = u exp(u): another branch of Lambert's W
    than the trivial z = 0. Eq. (3) holds once this factor to the number of layers is small.

    Parameters
    ----------
    relative_wear : float [-]
        u = R S_w / S_e of the layer.

    Returns
    -------
    float [-]
        |exp(z)| of the slowest mode.
    """
    mode = scipy.special.lambertw(relative_wear * np.exp(relative_wear), 1) - relative_wear
    return float(np.abs(np.exp(mode)))
