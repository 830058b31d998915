"""The rules one by one: the same pocket, and a slot, with each of them on and off."""

from dataclasses import dataclass, replace

import numpy as np
import shapely

from calibration.wear_simulation import FeedLaw, planned_feeds
from experiments.yu_1997_path_rules.conditions import Conditions
from experiments.yu_1997_path_rules.cutting import Cut, Floor, Job, cut, measured, uncovered_share
from procmodel.wear.layer_path import LayerPath
from procmodel.wear.scanning import Pattern, ScanningRules, scan_layer
from procmodel.wear.zmap_wear import WearMode

ALL = "all rules"
# Section and wear mode. Local wear is the limit of the fixed electrode's without any spread; a flat
# bottom is what the layer law assumes.
ELECTRODES: dict[str, tuple[str, WearMode]] = {
    "fixed": ("square", "spread"),
    "local": ("square", "local"),
    "rotating": ("round", "rotating"),
    "flat": ("square", "uniform"),
}


@dataclass(frozen=True)
class Variant:
    """Rules that are on, and how the feed of a layer is given."""

    rules: ScanningRules
    pattern: Pattern = "raster"
    law: FeedLaw = "layer"


@dataclass(frozen=True)
class Row:
    """A variant cut with one electrode. `length` [um] and `turns` are of the first layer.

    `law` is the mean depth of the watched layers over that of eq. (3), less 1.
    """

    variant: str
    electrode: str
    floor: Floor
    uncovered: float
    length: float
    turns: int
    law: float
    volume: float
    made: Cut


def variants(conditions: Conditions) -> dict[str, Variant]:
    """All rules on, and each off."""
    on = ScanningRules(overlap=conditions.overlap)
    off = ScanningRules(False, False, 0.0, False)
    return {
        ALL: Variant(on),
        "feed along the path": Variant(on, law="linear"),
        "one way": Variant(replace(on, to_and_fro=False)),
        "one direction": Variant(replace(on, alternate_direction=False)),
        "no overlap": Variant(replace(on, overlap=0.0)),
        "no overlap, one direction": Variant(
            replace(on, overlap=0.0, alternate_direction=False)
        ),
        "lines alone": Variant(replace(on, inside_and_periphery=False)),
        "no rule": Variant(off),
        "contours (fig. 5)": Variant(on, "contour"),
        "contours, inwards only": Variant(
            replace(off, overlap=conditions.overlap), "contour"
        ),
    }  # fmt: skip


def pocket(conditions: Conditions) -> shapely.Polygon:
    """Outline of the pocket, side gap included."""
    half = 0.5 * conditions.pocket
    return shapely.box(-half, -half, half, half)


def pocket_job(
    conditions: Conditions, variant: Variant, electrode: str, layers: int | None = None
) -> Job:
    """The pocket's paths for a variant and an electrode."""
    outline = pocket(conditions)
    shape, mode = ELECTRODES[electrode]
    section = conditions.square if shape == "square" else conditions.round
    paths = [
        scan_layer(outline, section, conditions.side_gap, variant.rules, n, variant.pattern)
        for n in range(1, (layers or conditions.layers) + 1)
    ]
    spread = conditions.wear_spread if mode == "spread" else None
    return Job(
        outline, paths, section, mode, conditions.wear_ratio, conditions.cell,
        conditions.side_gap, spread,
    )  # fmt: skip


def cut_variant(conditions: Conditions, name: str, electrode: str) -> Row:
    """Cut the pocket by a variant and measure it."""
    variant = variants(conditions)[name]
    job = pocket_job(conditions, variant, electrode)
    feeds = np.full(len(job.paths), conditions.feed)
    fed = planned_feeds(job.steps, feeds, variant.law)
    return _row(name, electrode, cut(job, fed, conditions.watched), conditions.feed)


def slot(conditions: Conditions, turning: bool, electrode: str = "fixed") -> Row:
    """The slot of figs 9 and 10 with a square electrode that is or is not turned."""
    half = 0.5 * conditions.slot
    width = 0.5 * conditions.width + conditions.side_gap
    outline = shapely.box(-half, -width, half, width)
    paths = [
        scan_layer(outline, conditions.square, conditions.side_gap, ScanningRules(), n)
        for n in range(1, conditions.layers + 1)
    ]
    if not turning:
        paths = [LayerPath(path.points, path.cutting) for path in paths]
    mode = ELECTRODES[electrode][1]
    job = Job(
        outline, paths, conditions.square, mode, conditions.wear_ratio, conditions.cell,
        conditions.side_gap, conditions.wear_spread if mode == "spread" else None,
    )  # fmt: skip
    name = "slot, turned" if turning else "slot, not turned"
    return _row(name, electrode, cut(job, conditions.feed, conditions.watched), conditions.feed)


def _row(name: str, electrode: str, made: Cut, feed: float) -> Row:
    job, last = made.job, made.last
    expected = feed / (1.0 + job.relative_wear)
    watched = np.asarray(last.layer_depth)[-len(made.states) :]
    return Row(
        variant=name,
        electrode=electrode,
        floor=measured(made, feed),
        uncovered=uncovered_share(job),
        length=job.paths[0].length,
        turns=job.paths[0].turning_points,
        law=float(watched.mean()) / expected - 1.0,
        volume=float(last.volume_ratio) - job.wear_ratio,
        made=made,
    )
