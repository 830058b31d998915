"""The same pocket by three feed laws, its levelling, and its start-up. Lengths in um."""

from dataclasses import dataclass, replace

import numpy as np

from calibration.wear_simulation import FeedLaw, planned_feeds
from experiments.yu_1997_path_rules.conditions import Conditions
from experiments.yu_1997_path_rules.cutting import Cut, cut, region
from experiments.yu_1997_path_rules.known import Levelled, levelled
from experiments.yu_1997_path_rules.rules import ALL, Variant, pocket_job, variants
from procmodel.wear.layer_path import LayerPath
from procmodel.wear.layers import layer_feed
from procmodel.wear.scanning import ScanningRules

LAWS: tuple[FeedLaw, ...] = ("layer", "linear", "fixed-length")


@dataclass(frozen=True)
class Compensated:
    """A pocket that should be flat at a depth.

    `mean`, `rms` and `greatest` [um] are of the error of the floor; `time` [s] is path over scan
    speed, `length` [um] the mean length that the electrode lost.
    """

    law: str
    electrode: str
    assumed: float
    mean: float
    rms: float
    greatest: float
    time: float
    length: float
    made: Cut


def compensated(
    conditions: Conditions, law: FeedLaw, electrode: str, assumed: float
) -> Compensated:
    """Cut the pocket with feeds planned for a wear ratio that may be wrong."""
    job = pocket_job(conditions, variants(conditions)[ALL], electrode)
    wear = job.relative_wear * assumed / conditions.wear_ratio
    feed = float(layer_feed(conditions.depth_per_layer, wear, 1.0, 1.0))
    length = conditions.fixed_length if law == "fixed-length" else None
    steps = job.steps
    made = cut(job, planned_feeds(steps, np.full(len(job.paths), feed), law, length))
    wanted = conditions.depth_per_layer * len(job.paths)
    error = made.depth[region(made, 0.0)] - wanted
    return Compensated(
        law=law,
        electrode=electrode,
        assumed=assumed,
        mean=float(error.mean()),
        rms=float(np.sqrt(np.mean(error**2))),
        greatest=float(np.max(np.abs(error))),
        time=sum(path.length for path in job.paths) / conditions.scan_speed,
        length=float(np.sum(np.asarray(made.last.worn))) / job.electrode.section_area,
        made=made,
    )


def start_up(conditions: Conditions, electrode: str) -> np.ndarray:
    """Depth of every layer of the pocket over eq. (3); one path, one way, repeated."""
    once = Variant(ScanningRules(False, False, conditions.overlap, False))
    job = pocket_job(conditions, once, electrode)
    made = cut(job, conditions.feed)
    # A path that leaves something standing sweeps less than the pocket.
    area = float(made.last.swept_area[-1])
    wear = job.wear_ratio * area / job.electrode.section_area
    return np.asarray(made.last.layer_depth) * (1.0 + wear) / conditions.feed


def levelled_pocket(conditions: Conditions) -> Levelled:
    """Levelling passes on the pocket's path, to and fro, with a flat bottom."""
    coarse = replace(conditions, cell=conditions.coarse_cell)
    once = Variant(ScanningRules(False, False, conditions.overlap, False))
    total = conditions.layers + conditions.passes
    job = pocket_job(coarse, once, "flat", layers=1)
    path: LayerPath = job.paths[0]
    paths = [path if n % 2 == 0 else path.reversed() for n in range(total)]
    job = replace(job, paths=paths)
    first = cut(replace(job, paths=paths[:1]), conditions.feed)
    floor = region(first, 0.0)
    return levelled(job, conditions, floor)
