"""A cavity with vertical walls cut layer by layer, and what is measured on it and on the tip.

Lengths in um, areas in um^2.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.interpolate import RegularGridInterpolator

from procmodel.wear.feed_law import layer_feeds
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.path_steps import PathSteps, path_steps
from procmodel.wear.scanning import coverage
from procmodel.wear.slicing_reach import dilate, erode
from procmodel.wear.zmap import Simulated, simulate_layers
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap
from procmodel.wear.zmap_wear import WearMode

# Section area that a fillet of radius 1 leaves in a square corner.
FILLET = 1.0 - math.pi / 4.0
# Places along a corner's side at which the surface is looked at.
_FINE = 200


@dataclass(frozen=True)
class Job:
    """Paths and feeds of a cavity, and how the electrode wears."""

    outline: shapely.Polygon
    paths: Sequence[LayerPath]
    section: ElectrodeSection
    wear_mode: WearMode
    wear_ratio: float
    cell: float
    gap: float = 0.0
    wear_spread: float | None = None

    @property
    def steps(self) -> PathSteps:
        """Positions along the paths, a cell apart."""
        return path_steps(self.paths, self.cell)

    @property
    def electrode(self) -> ElectrodeMap:
        """The electrode before the first layer."""
        return ElectrodeMap(self.section, self.cell, reach=self.gap)

    @property
    def relative_wear(self) -> float:
        """u = R S_w / S_e of a layer that leaves nothing uncut."""
        cleared = dilate(erode(self.outline, self.section, self.gap), self.section, self.gap)
        return self.wear_ratio * cleared.area / self.electrode.section_area


@dataclass(frozen=True)
class Cut:
    """A job after its last layers: the states after each of the watched ones."""

    job: Job
    feeds: np.ndarray
    states: tuple[Simulated, ...]

    @property
    def last(self) -> Simulated:
        """State after the last layer."""
        return self.states[-1]

    @property
    def depth(self) -> np.ndarray:
        """Depth of every cell after the last layer."""
        return np.asarray(self.last.depth)

    @property
    def x(self) -> np.ndarray:
        """Middles of the cells along x."""
        return self.last.surface.x

    @property
    def y(self) -> np.ndarray:
        """Middles of the cells along y."""
        return self.last.surface.y


def cut(job: Job, feeds: np.ndarray | float, watched: int = 1) -> Cut:
    """Cut all layers; `feeds` is one number, one for every layer, or one for every step."""
    steps, electrode = job.steps, job.electrode
    fed = np.asarray(feeds, float)
    if fed.ndim < 2:
        fed = np.asarray(layer_feeds(steps, fed))
    workpiece = WorkpieceMap.around(steps, electrode)
    states: list[Simulated] = []
    at = None
    for stop in range(len(steps.x) - watched + 1, len(steps.x) + 1):
        at = simulate_layers(
            _first(steps, stop), fed[:stop], electrode, workpiece,
            job.wear_ratio, side_gap=job.gap, wear_mode=job.wear_mode,
            spread_width=job.wear_spread,
            block=1, resume=at,
        )  # fmt: skip
        states.append(at)
    return Cut(job, fed, tuple(states))


def _first(steps: PathSteps, stop: int) -> PathSteps:
    """The layers down to one, padded as all are: their feeds fit."""
    return PathSteps(*(np.asarray(field)[:stop] for field in steps))


@dataclass(frozen=True)
class Floor:
    """Bottom of the cavity and of the electrode.

    Attributes
    ----------
    inside, whole : float
        Peak to valley of the floor in feeds, the worst of the watched layers: further than half an
        electrode from the wall, and up to the wall.
    tip : float
        Peak to valley of the electrode's bottom in feeds, the worst of the watched layers.
    foot, rim : float [um]
        Radii of the fillets that have the section area of what stands at the foot of the walls,
        and of what the electrode's rim has lost.
    corner : float [um]
        Radius of the pocket's corners from above, at half its depth.
    """

    inside: float
    whole: float
    tip: float
    foot: float
    rim: float
    corner: float


def measured(made: Cut, feed: float) -> Floor:
    """Measure floor, tip and corners."""
    near = region(made, made.job.section.half + made.job.gap)
    floor = region(made, 0.0)
    inside, whole, tip = [], [], []
    for state in made.states:
        depth = np.asarray(state.depth)
        inside.append(float(np.ptp(depth[near])) if np.any(near) else math.nan)
        whole.append(float(np.ptp(depth[floor])))
        tip.append(float(np.ptp(np.asarray(state.electrode_loss)[made.job.electrode.bottom])))
    return Floor(
        inside=max(inside) / feed,
        whole=max(whole) / feed,
        tip=max(tip) / feed,
        foot=foot_radius(made),
        rim=rim_radius(made),
        corner=corner_radius(made, 0.5 * float(np.median(made.depth[floor]))),
    )


def region(made: Cut, inset: float) -> np.ndarray:
    """Cells whose middle lies in what the electrode can clear, so far from its edge."""
    job = made.job
    cleared = dilate(erode(job.outline, job.section, job.gap), job.section, job.gap)
    # A cell that the edge of a round electrode passes is cut in part only.
    margin = inset if job.section.shape == "square" else max(inset, job.cell)
    cleared = cleared.buffer(-margin, join_style="mitre") if margin else cleared
    x, y = np.meshgrid(made.x, made.y, indexing="ij")
    return np.asarray(shapely.contains_xy(cleared, x, y))


def foot_radius(made: Cut) -> float:
    """Fillet at the foot of the walls, halfway along them: the mean of all four.

    What stands is counted from the floor between a quarter and half an electrode from the wall.
    """
    job, depth = made.job, made.depth
    left, low, right, high = job.outline.bounds
    areas = []
    for lines, across, along, start, end, centre in (
        (depth, made.x, made.y, left, right, 0.5 * (low + high)),
        (depth.T, made.y, made.x, low, high, 0.5 * (left + right)),
    ):
        profile = lines[:, np.abs(along - centre) < 0.5 * job.section.half].mean(axis=1)
        for wall in (across - start, end - across):
            near = (wall > 0) & (wall < 0.5 * job.section.half)
            level = (wall >= 0.5 * job.section.half) & (wall < job.section.half)
            areas.append(np.sum(np.maximum(profile[level].mean() - profile[near], 0.0)) * job.cell)
    return math.sqrt(float(np.mean(areas)) / FILLET)


def rim_radius(made: Cut) -> float:
    """Fillet of the electrode's rim, in the middle of its sides: the mean of all four."""
    job = made.job
    loss, bottom = np.asarray(made.last.electrode_loss), job.electrode.bottom
    middle = slice(len(loss) // 2 - 1, len(loss) // 2 + 1)
    areas = []
    for lines, inside in ((loss, bottom), (loss.T, bottom.T)):
        profile = lines[:, middle].mean(axis=1)[inside[:, middle].all(axis=1)]
        quarter = len(profile) // 4
        for side in (profile, profile[::-1]):
            level = side[quarter : 2 * quarter].mean()
            areas.append(np.sum(np.maximum(side[:quarter] - level, 0.0)) * job.cell)
    return math.sqrt(float(np.mean(areas)) / FILLET)


def corner_radius(made: Cut, level: float) -> float:
    """Radius of the corners from above at a depth: the mean of all four.

    The area of a corner that is less deep, the surface taken as bilinear between the cells'
    middles, is that which a fillet leaves standing.
    """
    job = made.job
    left, low, right, high = job.outline.bounds
    surface = RegularGridInterpolator((made.x, made.y), made.depth)
    reach = 0.8 * job.section.size
    place = (np.arange(_FINE) + 0.5) / _FINE * reach
    areas = []
    for x in (left + place, right - place):
        for y in (low + place, high - place):
            at = surface(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1))
            areas.append(float(np.mean(at < level)) * reach**2)
    return math.sqrt(float(np.mean(areas)) / FILLET)


def uncovered_share(job: Job) -> float:
    """Greatest share of what the electrode can clear that a layer's path leaves standing."""
    return max(
        coverage(path, job.outline, job.section, job.gap).uncovered_share for path in job.paths
    )
