"""A hemisphere by constant feed, by eq. (3) and by a plan through the simulator.

Lengths in um.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from calibration.plans.schedule import exact_schedule
from calibration.plans.simulated_schedule import SimulationSettings, simulated_schedule
from experiments.yu_1997_path_rules.conditions import Conditions
from procmodel.wear import Hemisphere
from procmodel.wear.feed_law import layer_feeds
from procmodel.wear.layer_bottoms import uniform_bottoms
from procmodel.wear.layer_path import LayerPath
from procmodel.wear.path_steps import PathSteps, path_steps
from procmodel.wear.scanning import ScanningRules, scan_layers
from procmodel.wear.slicing import Slices, slices_of_solid
from procmodel.wear.surface_error import cleared_cells, surface_error
from procmodel.wear.target_map import target_map
from procmodel.wear.zmap import simulate
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap

# Plans through the simulator: for one wear ratio, and for all of the belief.
SEARCHED = ("simulator", "simulator, for the belief")


@dataclass(frozen=True)
class Bowl:
    """The hemisphere's layers and paths, and what it is compared with.

    `target` is the hemisphere with its flat end, `staircase` the layers themselves; both are means
    over cells. Errors are taken over `region`, all cells that are cut or should be.
    """

    slices: Slices
    paths: Sequence[LayerPath]
    steps: PathSteps
    electrode: ElectrodeMap
    workpiece: WorkpieceMap
    target: np.ndarray
    staircase: np.ndarray
    region: np.ndarray
    gap: float


@dataclass(frozen=True)
class Planned:
    """Feeds of a plan, and the bowl cut with them.

    `right`, `wrong` and `believed` are rms and greatest error [um]: with the wear ratio that was
    planned for, with one 10 % greater, and over the belief (rms over all of it, and the greatest
    error that 95 % of it keep).
    """

    name: str
    feeds: np.ndarray
    depth: np.ndarray
    worse: np.ndarray
    right: tuple[float, float]
    wrong: tuple[float, float]
    believed: tuple[float, float]
    length: float


def bowl(conditions: Conditions) -> Bowl:
    """Slice the hemisphere and lay the paths."""
    solid = Hemisphere(conditions.radius)
    bottoms = uniform_bottoms(conditions.hemisphere_depth, conditions.hemisphere_layer)
    slices = slices_of_solid(solid, bottoms)
    gap, cell = conditions.side_gap, conditions.coarse_cell
    rules = ScanningRules(overlap=conditions.overlap)
    paths = scan_layers(slices, conditions.round, gap, rules)
    steps = path_steps(paths, cell)
    electrode = ElectrodeMap(conditions.round, cell, reach=gap)
    workpiece = WorkpieceMap.around(steps, electrode)
    target = target_map(solid, workpiece, conditions.hemisphere_depth)
    staircase = target_map(slices, workpiece)
    region = cleared_cells(staircase, target)
    return Bowl(slices, paths, steps, electrode, workpiece, target, staircase, region, gap)


def cut_bowl(made: Bowl, feeds: np.ndarray, wear_ratio: float) -> tuple[np.ndarray, float]:
    """Depth of every cell, and the mean length that the electrode lost."""
    found = simulate(
        made.steps, layer_feeds(made.steps, feeds), made.electrode, made.workpiece, wear_ratio,
        side_gap=made.gap, wear_mode="rotating",
    )  # fmt: skip
    return np.asarray(found.depth), float(np.sum(found.worn)) / made.electrode.section_area


def belief(conditions: Conditions) -> np.ndarray:
    """Equally likely wear ratios: the posterior of a fit, without the luck of few draws."""
    levels = (np.arange(conditions.draws) + 0.5) / conditions.draws
    return conditions.wear_ratio * (1.0 + conditions.spread * scipy.stats.norm.ppf(levels))


def plans(made: Bowl, conditions: Conditions, searched: bool = True) -> dict[str, np.ndarray]:
    """Feeds of every layer, by name; the last two are searched through the simulator."""
    area = made.electrode.section_area
    layers = made.slices.target_layers(conditions.round, made.gap)
    exact = np.asarray(exact_schedule(layers, conditions.wear_ratio, area).feeds)
    constant = np.full(len(made.slices), conditions.hemisphere_layer)
    found = {"constant feed": constant, "eq. (3)": exact}
    if not searched:
        return found
    settings = SimulationSettings(
        cell=conditions.coarse_cell,
        side_gap=made.gap,
        wear_mode="rotating",
        evaluations=conditions.evaluations,
    )
    for name, ratio in zip(SEARCHED, (conditions.wear_ratio, belief(conditions)), strict=True):
        found[name] = simulated_schedule(
            made.paths, Hemisphere(conditions.radius), conditions.round, ratio, exact, settings,
            target_depth=conditions.hemisphere_depth,
        ).feeds  # fmt: skip
    return found


def cut_plan(made: Bowl, name: str, feeds: np.ndarray, conditions: Conditions) -> Planned:
    """Cut a plan with the right wear ratio, a wrong one, and those of the belief."""
    depth, length = cut_bowl(made, feeds, conditions.wear_ratio)
    worse, _ = cut_bowl(made, feeds, conditions.wrong * conditions.wear_ratio)
    drawn = [error(made, cut_bowl(made, feeds, r)[0]) for r in belief(conditions)]
    rms = float(np.sqrt(np.mean([e[0] ** 2 for e in drawn])))
    kept = float(np.quantile([e[1] for e in drawn], 0.95))
    return Planned(
        name, feeds, depth, worse, error(made, depth), error(made, worse), (rms, kept), length
    )


def error(made: Bowl, depth: np.ndarray) -> tuple[float, float]:
    """Rms and greatest error against the hemisphere."""
    found = surface_error(depth, made.target, made.region)
    return found.rms, found.max
