"""The whole way once round: cut a test cavity, measure it, fit the wear ratio, plan, cut again.

The profile is simulated by the same model that is fitted, with the true wear ratio kept from the
fit. This shows that the chain is consistent and its uncertainty honest; it cannot show that a
real cavity obeys the model.

Lengths in um, areas in um^2.
"""

from dataclasses import dataclass

import numpy as np

from calibration.plans.schedule import Machine, Schedule, exact_schedule
from calibration.wear import CavityFit, TestCavity, fit_cavity
from experiments.yu_1997_cavities.cavities import cut, paper_wall, told_feeds
from experiments.yu_1997_cavities.conditions import Conditions, Electrode, Wanted
from procmodel.wear import slice_solid

SEED = 1997


@dataclass(frozen=True)
class PlannedCut:
    """A cavity planned on a fit and cut with the true wear ratio; arrays of shape (n,) [um]."""

    wanted: Wanted
    schedule: Schedule
    depths: np.ndarray
    plain: np.ndarray

    @property
    def wall_error(self) -> np.ndarray:
        """Depth reached less depth wanted at every layer's corner [um]."""
        return self.depths - np.asarray(self.schedule.layers.bottom)

    @property
    def max_wall_error(self) -> float:
        """Greatest wall error [um]."""
        return float(np.max(np.abs(self.wall_error)))

    @property
    def max_plain_error(self) -> float:
        """Greatest wall error when every layer is fed by its wanted depth [um]."""
        return float(np.max(np.abs(self.plain - np.asarray(self.schedule.layers.bottom))))

    @property
    def share_of_band(self) -> float:
        """Greatest distance from the expected depth over the predicted half width of 95 %."""
        off = np.abs(self.depths - self.schedule.depths)
        return float(np.max(off / self.schedule.depth_spread))

    @property
    def inside_band(self) -> bool:
        """Whether the wall stays within the predicted 95 % band from top to bottom."""
        return self.share_of_band <= 1.0


def test_cavity(conditions: Conditions) -> TestCavity:
    """How the test cavity was cut, as the engineer knows it."""
    return TestCavity(
        section="square",
        half_width=conditions.opening,
        step=conditions.test_step,
        feed=conditions.test_feed,
        electrode_area=conditions.roughing.area,
        layers=conditions.test_layers,
    )


def simulated_profile(conditions: Conditions, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Noisy profile across the uncompensated cavity: position and depth, each (n,) [um]."""
    instrument = conditions.instrument
    position = np.arange(-instrument.reach, instrument.reach + 0.1, instrument.spacing)
    across = position - instrument.centre
    wall = np.asarray(paper_wall(conditions).cavity.wall_depth(across, instrument.spacing))
    noise = np.random.default_rng(seed).normal(0.0, instrument.noise, position.size)
    return position, wall + instrument.zero + instrument.tilt * across + noise


def fitted_profile(conditions: Conditions, seed: int = SEED) -> CavityFit:
    """Wear ratio, centre, zero and tilt from the simulated profile; its noise is estimated."""
    position, depth = simulated_profile(conditions, seed)
    return fit_cavity(position, depth, test_cavity(conditions))


def planned_cut(
    wanted: Wanted, fit: CavityFit, electrode: Electrode, conditions: Conditions
) -> PlannedCut:
    """Plan on the fit alone, then cut with the electrode as it truly wears."""
    layers = slice_solid(wanted.solid, conditions.layer_depth, wanted.depth)
    machine = Machine(resolution=conditions.resolution)
    schedule = exact_schedule(layers, fit.result, electrode.area, machine)
    return PlannedCut(
        wanted=wanted,
        schedule=schedule,
        depths=cut(wanted, layers, told_feeds(schedule), electrode),
        plain=cut(wanted, layers, np.asarray(layers.thickness), electrode),
    )


def coverage(wanted: Wanted, conditions: Conditions, repeats: int) -> float:
    """Share of repeated loops, each with its own noise, whose wall stays within the band."""
    electrode = conditions.roughing
    inside = [
        planned_cut(wanted, fitted_profile(conditions, seed), electrode, conditions).inside_band
        for seed in range(repeats)
    ]
    return float(np.mean(inside))


def staircase_bias(conditions: Conditions) -> float:
    """Relative error of R when the instrument sees sharp steps instead of the corner curve.

    The fitted curve runs through the outer bottom corners of the layers; a wall of ideal steps
    lies half a layer above it on average. Worn electrode edges leave something in between.
    """
    wall = paper_wall(conditions).cavity
    reach, spacing = conditions.instrument.reach, 0.5
    # Half a spacing off, so that no reading falls on the very edge of a step.
    position = np.arange(-reach + 0.5 * spacing, reach, spacing)
    walls = np.asarray(wall.wall_positions)
    layers_here = np.searchsorted(-walls, -np.abs(position), side="right")
    depth = np.concatenate([[0.0], np.asarray(wall.depths)])[layers_here]
    fit = fit_cavity(position, depth, test_cavity(conditions))
    return fit.result.parameters["wear_ratio"].value / conditions.roughing.wear_ratio - 1.0
