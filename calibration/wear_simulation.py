"""A planned cavity cut in simulation: stopped and resumed, for all that is believed of the wear.

Lengths in um, volumes in um^3; maps run along x first, then y, depth downwards.
"""

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from calibration.checkpoint import Checkpoint
from calibration.plans.belief import believed_wear_ratio
from calibration.progress import ProgressOption, reporting
from procmodel.errors import InputError, nearest
from procmodel.io import writing
from procmodel.wear.feed_law import fixed_length_feeds, layer_feeds
from procmodel.wear.path_steps import PathSteps
from procmodel.wear.zmap import Simulated, simulate_layers
from procmodel.wear.zmap_cut import Cavity
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap
from procmodel.wear.zmap_run import Settings
from procmodel.wear.zmap_wear import WearMode

FeedLaw = Literal["layer", "linear", "fixed-length"]
FEED_LAWS = ("layer", "linear", "fixed-length")
# Parts into which a run is cut, after each of which its state may be kept, and blocks of a part,
# after each of which progress is told.
_PARTS, _BLOCKS = 8, 4
_BALANCE = ("removed", "worn", "swept_area", "greatest_loss")
# Of what is believed of the wear ratio: the middle, and the ends of its 95 % range.
_LEVELS = (0.5, 0.025, 0.975)


@dataclass(frozen=True)
class CavityTask:
    """What is cut with what.

    Attributes
    ----------
    steps : PathSteps
        Positions of the electrode's axis, layer by layer.
    feeds : ndarray, shape (layers, steps) [um]
        Feed before the cut at every step.
    electrode : ElectrodeMap
        Section, cells and loss before; its reach holds the side gap.
    workpiece : WorkpieceMap
        Surface before.
    side_gap, bottom_gap : float [um]
        Gaps, as of `procmodel.wear.zmap.simulate`.
    wear_mode : {"local", "rotating", "spread", "uniform"}
        How the wear is shared among the bottom's cells.
    spread_width : float or None [um]
        For the mode ``spread``.
    """

    steps: PathSteps
    feeds: np.ndarray
    electrode: ElectrodeMap
    workpiece: WorkpieceMap
    side_gap: float = 0.0
    bottom_gap: float = 0.0
    wear_mode: WearMode = "local"
    spread_width: float | None = None

    def configuration(self, wear_ratio: float) -> dict[str, Any]:
        """All that a run's result depends on, as plain types."""
        import hashlib

        arrays = [self.steps.x, self.steps.y, self.feeds, self.steps.quarter_turns]
        arrays += [np.asarray(self.electrode.loss), np.asarray(self.workpiece.depth)]
        digest = hashlib.sha256()
        for array in arrays:
            digest.update(np.ascontiguousarray(array).tobytes())
        return {
            "path, feeds and maps": digest.hexdigest()[:12],
            "electrode": f"{self.electrode.section.shape} {self.electrode.section.size:g} um",
            "cell": self.electrode.cell,
            "wear ratio": wear_ratio,
            "wear mode": self.wear_mode,
            "side gap": self.side_gap,
            "bottom gap": self.bottom_gap,
            "spread width": self.spread_width,
        }


@dataclass(frozen=True)
class CutCavity:
    """What comes out of a plan.

    Attributes
    ----------
    task : CavityTask
        What was cut with what.
    simulated : Simulated
        At the middle of what is believed of the wear ratio.
    wear_ratios : tuple of float
        The middle, and where it is uncertain the ends of its 95 % range.
    low, high : ndarray, shape (nx, ny), or None [um]
        Depth at the ends of that range: a greater wear ratio cuts less deep.
    cell_updates_per_second : float or None
        Speed: steps times cells of the electrode in a second, in the middle of all blocks, so that
        compilation does not count; None where there was one block alone.
    notes : tuple of str
        What to know about the belief, as sentences.
    """

    task: CavityTask
    simulated: Simulated
    wear_ratios: tuple[float, ...]
    low: np.ndarray | None
    high: np.ndarray | None
    cell_updates_per_second: float | None
    notes: tuple[str, ...] = field(default=())

    @property
    def depth(self) -> np.ndarray:
        """Depth of every cell, shape (nx, ny) [um]."""
        return np.asarray(self.simulated.depth)


def planned_feeds(
    steps: PathSteps, layer_feed: np.ndarray, law: FeedLaw = "layer", length: float | None = None
) -> np.ndarray:
    """The feeds of a plan given along the path by one of three laws, the same in sum.

    Parameters
    ----------
    steps : PathSteps
        Positions.
    layer_feed : ndarray, shape (layers,) [um]
        Feed of every layer.
    law : {"layer", "linear", "fixed-length"}
        All at once where the layer begins (uniform wear); in proportion to the way; in equal parts
        after each fixed length of it.
    length : float, optional [um]
        That length, for ``fixed-length``.

    Returns
    -------
    ndarray, shape (layers, steps) [um]
        Feed before the cut at every step.

    Raises
    ------
    InputError
        If the law is unknown or lacks its length, or the numbers of layers differ.
    """
    if law not in FEED_LAWS:
        raise InputError(f"feed law {law!r} is unknown{nearest(str(law), FEED_LAWS)}.")
    if (length is not None) != (law == "fixed-length"):
        raise InputError("the fixed-length law needs a length between feeds, and no other does.")
    feeds = np.asarray(layer_feed, float)
    if feeds.shape != (len(steps.x),):
        raise InputError(f"the plan has {len(feeds)} layers, the path {len(steps.x)}.")
    if law == "layer":
        return np.asarray(layer_feeds(steps, feeds))
    shares = np.asarray(steps.length, float)
    if law == "fixed-length":
        assert length is not None
        shares = np.asarray(fixed_length_feeds(steps, 1.0, length))
    sums = shares.sum(axis=1, keepdims=True)
    # A plunge has no way, and a short layer may end before its first feed: there all comes first.
    first = np.asarray(layer_feeds(steps, 1.0))
    shares = np.where(sums > 0, shares / np.where(sums > 0, sums, 1.0), first)
    return shares * feeds[:, None]


def cut_cavity(
    task: CavityTask,
    wear_ratio: Any,
    *,
    checkpoint: str | Path | None = None,
    resume: bool = False,
    progress: ProgressOption = None,
) -> CutCavity:
    """Cut a plan for the middle of what is believed of the wear ratio, and for its ends.

    Parameters
    ----------
    task : CavityTask
        What is cut with what.
    wear_ratio : float, FitResult, xarray.DataTree or ndarray
        See `calibration.plans.belief`; a number is certain and cut once.
    checkpoint : path-like, optional
        Keep the state of the run at the middle here (.h5).
    resume : bool
        Go on from the checkpoint if it is there.
    progress : bool or callable, optional
        Show a bar, or call a function; see `calibration.progress`.

    Returns
    -------
    CutCavity
        The result. A run that was interrupted or used up the electrode ends early, and its
        ``simulated.status`` says so; the ends of the belief are then left out.

    Raises
    ------
    InputError
        If the belief cannot be used, the checkpoint belongs to another run, or `simulate_layers`
        refuses the task.
    """
    believed, notes = believed_wear_ratio(wear_ratio, task.electrode.section.area)
    ratios = np.quantile(believed, _LEVELS, method="hazen") if len(believed) > 1 else believed
    kept = None
    if checkpoint is not None:
        kept = Checkpoint(checkpoint, task.configuration(float(ratios[0])), resume)
    elif resume:
        raise InputError("resume needs a checkpoint to go on from: name it.")
    # What cannot be simulated is said before anything is shown or compiled.
    for ratio in ratios:
        gaps = (task.side_gap, task.bottom_gap)
        Settings(task.electrode, float(ratio), *gaps, task.wear_mode, task.spread_width)
    total = len(task.steps.x) * len(ratios)
    begun = _loaded(task, kept)
    clock = _Clock(task)
    with reporting(progress) as bar:
        bar.compiling("layers")
        runs: list[Simulated] = []
        for number, ratio in enumerate(ratios):
            before = number * len(task.steps.x)

            def tell(done: int, before: int = before) -> None:
                clock.after(done)
                bar.running("layers", before + done, total)

            clock.start()
            # Only the run at the middle is kept.
            file, at = (kept, begun) if number == 0 else (None, None)
            runs.append(_cut(task, float(ratio), tell, file, at))
            if runs[0].stopped or runs[0].used_up:
                break
    # Ends that did not come to their end say nothing.
    whole = len(runs) == 3 and not any(run.stopped or run.used_up for run in runs)
    if len(ratios) > 1 and not whole:
        notes = (*notes, "the ends of the belief were not cut to the last layer and are left out")
    return CutCavity(
        task,
        runs[0],
        tuple(float(r) for r in (ratios if whole else ratios[:1])),
        np.asarray(runs[2].depth) if whole else None,
        np.asarray(runs[1].depth) if whole else None,
        clock.speed,
        tuple(notes),
    )


class _Clock:
    """Times the blocks of runs; the middle of them is no block that was compiled for."""

    def __init__(self, task: CavityTask):
        self._cells = np.concatenate([[0], np.cumsum(task.steps.counts)]) * task.electrode.width**2
        self._speeds: list[float] = []
        self.start()

    def start(self) -> None:
        self._since, self._done = time.perf_counter(), -1

    def after(self, done: int) -> None:
        now = time.perf_counter()
        # Where a run begins is not known when it goes on from a file.
        if self._done >= 0 and now > self._since:
            cells = int(self._cells[done] - self._cells[self._done])
            self._speeds.append(cells / (now - self._since))
        self._since, self._done = now, done

    @property
    def speed(self) -> float | None:
        """Cell updates per second; None when nothing was timed."""
        return float(np.median(self._speeds)) if self._speeds else None


def _cut(
    task: CavityTask,
    wear_ratio: float,
    tell: Callable[[int], None],
    kept: Checkpoint | None,
    at: Simulated | None,
) -> Simulated:
    """One run from where it stands, in parts between which its state is kept."""
    total = len(task.steps.x)
    part = max(1, -(-total // _PARTS))
    done = 0 if at is None else len(np.asarray(at.removed))
    while True:
        at = simulate_layers(
            task.steps,
            task.feeds,
            task.electrode,
            task.workpiece,
            wear_ratio,
            side_gap=task.side_gap,
            bottom_gap=task.bottom_gap,
            wear_mode=task.wear_mode,
            spread_width=task.spread_width,
            block=max(1, part // _BLOCKS),
            progress=lambda done, _: tell(done),
            resume=at,
            until=done + part,
        )
        before, done = done, len(np.asarray(at.removed))
        # Less than was asked for: an interrupt, or the electrode is used up.
        ended = done >= total or done < before + part
        if kept is not None and (ended or kept.due):
            kept.save(_state(at))
        if ended:
            break
    if at.stopped:
        hint = "run again with --resume" if kept else "name a checkpoint to be able to go on"
        return dataclasses.replace(at, stopped=f"stopped after layer {done} of {total}; {hint}.")
    return at


def _state(at: Simulated) -> dict[str, np.ndarray]:
    arrays = {name: np.asarray(getattr(at, name)) for name in _BALANCE}
    return arrays | {f"cavity {k}": np.asarray(v) for k, v in at.cavity._asdict().items()}


def _loaded(task: CavityTask, kept: Checkpoint | None) -> Simulated | None:
    arrays = kept.load() if kept is not None else None
    if arrays is None:
        return None
    cavity = Cavity(**{name: jnp.asarray(arrays[f"cavity {name}"]) for name in Cavity._fields})
    return Simulated(
        task.workpiece,
        task.electrode,
        cavity=cavity,
        planned=len(task.steps.x),
        removed=jnp.asarray(arrays["removed"]),
        worn=jnp.asarray(arrays["worn"]),
        swept_area=jnp.asarray(arrays["swept_area"]),
        greatest_loss=jnp.asarray(arrays["greatest_loss"]),
    )


def save_cavity(path: str | Path, cut: CutCavity, target: np.ndarray | None = None) -> None:
    """Write a cut cavity as netCDF, completely or not at all.

    Parameters
    ----------
    path : path-like
        Where; a file there is replaced.
    cut : CutCavity
        What was cut.
    target : ndarray, shape (nx, ny), optional [um]
        Wanted depth.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    import xarray

    task, at = cut.task, cut.simulated
    place, tip, layer = ("x", "y"), ("electrode_x", "electrode_y"), "layer"
    line = np.asarray(task.electrode.centres[0])[:, 0]
    layers = np.arange(1, len(np.asarray(at.removed)) + 1)
    um, um3 = {"units": "um"}, {"units": "um^3"}
    variables: dict[str, Any] = {
        "depth": (place, cut.depth, um),
        "electrode_loss": (tip, np.asarray(at.electrode_loss), um),
        "removed_volume": (layer, np.asarray(at.removed), um3),
        "electrode_volume": (layer, np.asarray(at.worn), um3),
        "swept_area": (layer, np.asarray(at.swept_area), {"units": "um^2"}),
        "layer_depth": (layer, np.asarray(at.layer_depth), um),
        "greatest_loss": (layer, np.asarray(at.greatest_loss), um),
    }
    if target is not None:
        variables["target"] = (place, target, um)
    if cut.low is not None and cut.high is not None:
        variables["depth_low"] = (place, cut.low, um)
        variables["depth_high"] = (place, cut.high, um)
    attributes = {k: v for k, v in task.configuration(cut.wear_ratios[0]).items() if v is not None}
    data = xarray.Dataset(
        variables,
        coords={
            "x": ("x", task.workpiece.x, um),
            "y": ("y", task.workpiece.y, um),
            "electrode_x": ("electrode_x", line, um),
            "electrode_y": ("electrode_y", line, um),
            "layer": ("layer", layers),
        },
        attrs={
            **{name.replace(" ", "_").replace(",", ""): v for name, v in attributes.items()},
            "volume_ratio": float(at.volume_ratio),
            "status": at.status,
        },
    )
    with writing(path) as draft:
        data.to_netcdf(draft, engine="h5netcdf")
