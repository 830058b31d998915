"""Grooves whose answers are known: tilt along the path, wedge and cone, start-up, levelling.

Lengths in um. Notation: u = R S_w / S_e.
"""

from dataclasses import dataclass

import numpy as np
import shapely

from calibration.plans.levelling import LevellingPlan, levelling_passes
from experiments.yu_1997_path_rules.conditions import Conditions
from experiments.yu_1997_path_rules.cutting import Cut, Job, cut
from procmodel.wear.feed_law import linear_feeds
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.zmap_wear import WearMode

# Steady to 1e-6 at u = 1, whose start-up shrinks by 0.22 a layer.
_STEADY = 12


def line_job(
    length: float, section: ElectrodeSection, mode: WearMode, wear_ratio: float, cell: float,
    reverses: list[bool],
) -> Job:  # fmt: skip
    """A groove as wide as the electrode, cut along its middle in the given directions."""
    reach = 0.5 * (length - section.size)
    there = LayerPath(np.array([[-reach, 0.0], [reach, 0.0]]), np.ones(1, bool))
    paths = [there.reversed() if reverse else there for reverse in reverses]
    half = section.half
    outline = shapely.box(-0.5 * length, -half, 0.5 * length, half)
    return Job(outline, paths, section, mode, wear_ratio, cell)


@dataclass(frozen=True)
class Tilt:
    """Bottom of a groove along its path after the last two layers, in feeds.

    `one_way` and `to_and_fro` are depths at the groove's left end less those at its right.
    `profile` is the last bottom of each, about its mean, over `x` [um].
    """

    length: float
    relative_wear: float
    one_way: tuple[float, float]
    to_and_fro: tuple[float, float]
    x: np.ndarray
    profile: tuple[np.ndarray, np.ndarray]


def tilt(conditions: Conditions, stretch: float = 1.0) -> Tilt:
    """A groove with u = 1, `stretch` times as long with a wear ratio so much less."""
    ratio = conditions.wear_ratio / stretch
    length = stretch * conditions.width / conditions.wear_ratio
    tilts, profiles = [], []
    for to_and_fro in (False, True):
        reverses = [to_and_fro and n % 2 == 1 for n in range(_STEADY)]
        cell = conditions.coarse_cell
        job = line_job(length, conditions.square, "uniform", ratio, cell, reverses)
        made = cut(job, conditions.feed, watched=2)
        rows = [_along(made, np.asarray(state.depth)) / conditions.feed for state in made.states]
        tilts.append((float(rows[0][0] - rows[0][-1]), float(rows[1][0] - rows[1][-1])))
        profiles.append(rows[1] - rows[1].mean())
    x = made.x[np.abs(made.x) < 0.5 * length]
    return Tilt(length, job.relative_wear, tilts[0], tilts[1], x, (profiles[0], profiles[1]))


def _along(made: Cut, depth: np.ndarray) -> np.ndarray:
    """Depth along the groove, the mean across it."""
    left, low, right, high = made.job.outline.bounds
    inside = (made.x > left) & (made.x < right)
    return depth[np.ix_(inside, (made.y > low) & (made.y < high))].mean(axis=1)


@dataclass(frozen=True)
class Shape:
    """Tip after a groove that is fed in proportion to its length.

    `place` is the distance along the path, or from the axis, and `loss` what the bottom has lost
    there; `slope` is that of the straight part and `wanted` k / R or pi k / R. `depth` is that of
    the groove's cross-section where it is steady, as an area, and `wanted_area` is k S_e / R.
    """

    place: np.ndarray
    loss: np.ndarray
    slope: float
    wanted: float
    area: float
    wanted_area: float


def linear_tip(conditions: Conditions, rotating: bool, cell: float) -> Shape:
    """Wedge of a fixed, or cone of a rotating electrode under linear compensation."""
    section = conditions.round if rotating else conditions.square
    mode: WearMode = "rotating" if rotating else "local"
    job = line_job(conditions.groove, section, mode, conditions.wear_ratio, cell, [False])
    made = cut(job, np.asarray(linear_feeds(job.steps, conditions.feed_per_length)))
    loss, electrode = np.asarray(made.last.electrode_loss), job.electrode
    x, y = electrode.centres
    if rotating:
        radius = np.hypot(x, y)[electrode.bottom]
        order = np.argsort(radius)
        place, values = radius[order], loss[electrode.bottom][order]
        straight = (place > 0.2 * section.half) & (place < 0.8 * section.half)
    else:
        place, values = x[:, 0], loss.mean(axis=1)
        straight = np.abs(place) < 0.6 * section.half
    slope = float(np.polyfit(place[straight], values[straight], 1)[0])
    k, ratio = conditions.feed_per_length, conditions.wear_ratio
    area = np.asarray(made.depth).sum(axis=1) * cell
    # Far from the plunge, and before the electrode's stand at the end.
    steady = (made.x > 0.1 * conditions.groove) & (made.x < 0.5 * conditions.groove - section.size)
    return Shape(
        place, values, slope, (np.pi if rotating else 1.0) * k / ratio,
        float(area[steady].mean()), k * electrode.section_area / ratio,
    )  # fmt: skip


@dataclass(frozen=True)
class Levelled:
    """Passes planned on the law of the path alone, cut in simulation; tilts in feeds."""

    plan: LevellingPlan
    relative_wear: float
    before: float
    after: float
    by_law: tuple[float, float]
    ends: tuple[np.ndarray, np.ndarray]


def levelled(job: Job, conditions: Conditions, floor: np.ndarray | None = None) -> Levelled:
    """Cut a job whose last layers are the passes; `floor` is where the bottom is measured."""
    feed, passes = conditions.feed, conditions.passes
    plan = levelling_passes(feed, job.relative_wear, passes)
    feeds = np.concatenate([np.full(len(job.paths) - passes, feed), plan.feeds])
    made = cut(job, feeds, watched=passes + 1)
    bottoms = [np.asarray(made.states[k].depth) for k in (0, -1)]
    if floor is None:
        values = [_along(made, bottom) for bottom in bottoms]
    else:
        values = [bottom[floor] for bottom in bottoms]
    return Levelled(
        plan, job.relative_wear, float(np.ptp(values[0])) / feed, float(np.ptp(values[1])) / feed,
        (plan.tilt_before / feed, plan.tilt / feed), (values[0], values[1]),
    )  # fmt: skip


def levelled_groove(conditions: Conditions, stretch: float) -> Levelled:
    """The groove of `tilt`, to and fro, with the passes after it."""
    reverses = [n % 2 == 1 for n in range(2 * _STEADY + conditions.passes)]
    job = line_job(
        stretch * conditions.width / conditions.wear_ratio, conditions.square, "uniform",
        conditions.wear_ratio / stretch, conditions.coarse_cell, reverses,
    )  # fmt: skip
    return levelled(job, conditions)
