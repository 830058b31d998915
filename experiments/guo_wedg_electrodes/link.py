"""From the gap to the cavity: the electrode's area into the wear ratio and the schedule.

A test cavity is cut with one electrode and fitted; the next cavity is planned for the same
electrode, for another ground blind, or for two that were measured.
"""

import math
from dataclasses import dataclass

import numpy as np

from calibration.electrode_area import (
    ElectrodeArea,
    electrode_area,
    wear_ratio_draws,
    wear_ratio_for,
)
from calibration.electrode_gap import GapPosterior
from calibration.plans.schedule import Schedule, exact_schedule
from calibration.wear import CavityFit, TestCavity, fit_cavity
from experiments.guo_wedg_electrodes.conditions import Conditions
from procmodel.wear import CircleSection, LayeredCavity, cone, slice_solid

HALF_WIDTH, STEP, LAYERS, NOISE = 150.0, 2.0, 55, 0.5


@dataclass(frozen=True)
class Linked:
    """Areas, wear ratios and plans; `plans` by which electrode cuts the next cavity."""

    blind: ElectrodeArea
    measured: ElectrodeArea
    fit: CavityFit
    wear_ratio: np.ndarray
    plans: dict[str, Schedule]


def linked(posterior: GapPosterior, conditions: Conditions) -> Linked:
    """Fit a simulated test cavity and plan a cone with it."""
    nominal, wire = conditions.blind_area, conditions.wire_radius
    path = 0.5 * conditions.blind_diameter + wire + posterior.mean.mean
    fit = fitted_cavity(conditions)
    first = electrode_area(posterior, path, wire)
    second = electrode_area(posterior, path, wire, beside=first)
    seen = [
        electrode_area(posterior, path, wire, measured=conditions.blind_diameter, seed=seed)
        for seed in (0, 1)
    ]
    layers = slice_solid(cone(HALF_WIDTH, math.pi / 3), 1.0, depth=HALF_WIDTH)
    ratios = {
        "the same electrode": wear_ratio_for(fit.result, first, None, nominal),
        "both measured": wear_ratio_for(fit.result, seen[0], seen[1], nominal),
        "another, both blind": wear_ratio_for(fit.result, first, second, nominal),
    }
    plans = {name: exact_schedule(layers, ratio, nominal) for name, ratio in ratios.items()}
    return Linked(first, seen[0], fit, wear_ratio_draws(fit.result, first), plans)


def fitted_cavity(conditions: Conditions) -> CavityFit:
    """A circular test cavity, simulated with the nominal area, measured and fitted."""
    area = conditions.blind_area
    half_widths = HALF_WIDTH - STEP * np.arange(LAYERS)
    cut = LayeredCavity(half_widths, STEP, CircleSection(), conditions.wear_ratio, area, 0.0)
    x = np.linspace(half_widths[-1] + 1.0, HALF_WIDTH - 1.0, 106)
    z = np.interp(x, half_widths[::-1], np.asarray(cut.depths)[::-1])
    noise = np.random.default_rng(conditions.seed).normal(0.0, NOISE, len(x))
    cavity = TestCavity("circle", HALF_WIDTH, STEP, STEP, area, layers=LAYERS)
    return fit_cavity(x, z + noise, cavity, NOISE, reach="half")
