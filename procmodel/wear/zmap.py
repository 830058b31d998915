"""Simulation of electrode and cavity wearing each other, both as maps of square cells.

At every step of the path, in the cells under the electrode, the overlap p = [depth of the
electrode's bottom - depth of the workpiece - bottom gap]_+ is shared: the workpiece loses
p / (1 + R), and the electrode R times that volume. The volume ratio is R to rounding whatever the
path. Everything is differentiable in the wear ratio, the feeds, the gaps, the spread width and the
maps. Lengths in um, areas in um^2, volumes in um^3; depth downwards positive.

References
----------
Yu and Masuzawa 1997, eqs. (1) to (3), for what comes out of it in the mean.
"""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from procmodel.errors import InputError
from procmodel.precision import require_float64
from procmodel.wear import zmap_run
from procmodel.wear.path_steps import PathSteps
from procmodel.wear.zmap_cut import Cavity
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap
from procmodel.wear.zmap_run import Balance, Settings
from procmodel.wear.zmap_wear import WearMode


class Simulated(eqx.Module):
    """What a simulation leaves.

    Attributes
    ----------
    surface : WorkpieceMap
        The workpiece's surface after the last layer.
    tip : ElectrodeMap
        The electrode with its loss after the last layer, as it was mounted.
    removed, worn : Array, shape (layers,) [um^3]
        Volume removed and electrode volume lost in every layer. Both count what was cut beyond the
        edge of the map.
    swept_area : Array, shape (layers,) [um^2]
        Area S_w that every layer's path covers with the discharge.
    greatest_loss : Array, shape (layers,) [um]
        Greatest length lost anywhere on the bottom, after every layer.
    cavity : Cavity
        State from which to go on.
    planned : int
        Number of layers asked for.
    stopped : str
        Why fewer were simulated; empty when none is missing.
    """

    surface: WorkpieceMap
    tip: ElectrodeMap
    removed: Array | np.ndarray
    worn: Array | np.ndarray
    swept_area: Array | np.ndarray
    greatest_loss: Array | np.ndarray
    cavity: Cavity
    planned: int = eqx.field(static=True)
    stopped: str = eqx.field(static=True, default="")

    @property
    def depth(self) -> Array:
        """Depth of every cell, shape (nx, ny) [um]."""
        return self.surface.depth

    @property
    def electrode_loss(self) -> Array:
        """Length lost by every cell of the electrode, as mounted, shape (n, n) [um].

        Only the cells of `tip.bottom` are the electrode; those around follow the nearest of them.
        """
        return self.tip.loss

    @property
    def layer_depth(self) -> Array:
        """Mean depth L_w of every layer over what its path covers, shape (layers,) [um]."""
        area = self.swept_area
        return jnp.where(area > 0, self.removed / jnp.where(area > 0, area, 1.0), 0.0)

    @property
    def volume_ratio(self) -> Array:
        """Electrode volume lost over workpiece volume removed; 0 where nothing was removed."""
        removed = jnp.sum(self.removed)
        return jnp.where(
            removed > 0, jnp.sum(self.worn) / jnp.where(removed > 0, removed, 1.0), 0.0
        )

    @property
    def used_up(self) -> int:
        """Number of the first layer after which the usable length is exceeded; 0 if none."""
        over = np.asarray(self.greatest_loss) > self.tip.usable_length
        return int(np.argmax(over)) + 1 if np.any(over) else 0

    @property
    def status(self) -> str:
        """How the simulation ended, in one sentence."""
        if self.used_up:
            lost = float(self.greatest_loss[self.used_up - 1])
            return (
                f"the electrode is used up in layer {self.used_up} of {self.planned}: "
                f"{lost:.4g} um lost of {self.tip.usable_length:g} um usable; "
                "change it before that layer."
            )
        if self.stopped:
            return self.stopped
        if not np.any(np.asarray(self.removed) > 0):
            return "nothing was removed: the feeds never reach the workpiece."
        if not np.any(np.asarray(self.worn) > 0):
            return f"all {self.planned} layers are cut; the electrode does not wear."
        return f"all {self.planned} layers are cut."


def simulate(
    steps: PathSteps,
    feeds: ArrayLike,
    electrode: ElectrodeMap,
    workpiece: WorkpieceMap,
    wear_ratio: ArrayLike,
    *,
    side_gap: ArrayLike = 0.0,
    bottom_gap: ArrayLike = 0.0,
    wear_mode: WearMode = "local",
    spread_width: ArrayLike | None = None,
) -> Simulated:
    """Cut all layers.

    Parameters
    ----------
    steps : PathSteps
        Positions of the axis, shape (layers, steps) [um]; known numbers, not differentiated.
    feeds : array_like, shape (layers, steps) [um]
        Feed before the cut at every step; it adds up through all layers, from an unworn electrode
        on the surface.
    electrode : ElectrodeMap
        Section, cells and loss before. Its `reach` must hold the side gap.
    workpiece : WorkpieceMap
        Surface before, in cells of the same size.
    wear_ratio : array_like, shape ()
        Volumetric wear ratio R, 0 (no wear) to 10.
    side_gap : array_like, shape () [um]
        How far the discharge reaches beyond the section, >= 0. What it removes there wears the
        nearest cells of the rim. Piecewise smooth: the derivative of an area changes where an edge
        crosses from one cell into the next.
    bottom_gap : array_like, shape () [um]
        Depth that the bottom goes below the surface before it cuts: with a gap g between the
        two and feeds that count from contact it is -g.
    wear_mode : {"local", "rotating", "spread", "uniform"}
        ``local``: a fixed electrode wears where it cuts. ``rotating``: the loss is averaged over
        rings. ``spread``: it is blurred by `spread_width`. ``uniform``: the limit of a wide spread,
        the law of section 3 of Yu and Masuzawa.
    spread_width : array_like, shape (), optional [um]
        Standard deviation of the blur, > 0, for mode ``spread``.

    Returns
    -------
    Simulated
        Surface, electrode and the balance of every layer. Forward and reverse mode and `jit` go
        through; for several derivatives at once use `jax.lax.map` over them, `vmap` is not
        supported.

    Raises
    ------
    InputError
        If a value is out of its range, the cells differ, or the path leaves the map.
    RuntimeError
        If JAX makes 32-bit floats.
    """
    require_float64("a simulation of electrode and cavity")
    settings = Settings(electrode, wear_ratio, side_gap, bottom_gap, wear_mode, spread_width)
    plan, splits = zmap_run.planned(steps, electrode, workpiece)
    cavity = zmap_run.begin(settings, workpiece)
    feeds = zmap_run.checked_feeds(feeds, steps)
    cavity, balance = zmap_run.cut(settings, splits, cavity, plan, feeds)
    return _simulated(settings, workpiece, cavity, balance, steps)


def simulate_layers(
    steps: PathSteps,
    feeds: ArrayLike,
    electrode: ElectrodeMap,
    workpiece: WorkpieceMap,
    wear_ratio: ArrayLike,
    *,
    side_gap: ArrayLike = 0.0,
    bottom_gap: ArrayLike = 0.0,
    wear_mode: WearMode = "local",
    spread_width: ArrayLike | None = None,
    block: int = 4,
    progress: Callable[[int, int], None] | None = None,
    resume: Simulated | None = None,
    until: int | None = None,
) -> Simulated:
    """Cut all layers in blocks: for long work, with progress, that can be stopped and resumed.

    The result is that of `simulate`. It ends early when the electrode is used up, and with what
    has been finished on an interrupt from the keyboard; `status` says so.

    Parameters
    ----------
    steps, feeds, electrode, workpiece, wear_ratio, side_gap, bottom_gap, wear_mode, spread_width
        As for `simulate`.
    block : int
        Layers between two reports, >= 1.
    progress : callable, optional
        Called with the number of finished layers and of all after every block.
    resume : Simulated, optional
        What an earlier call with the same arguments left; its layers are not cut again.
    until : int, optional
        Layers after which to pause, to look at what is there and go on; all when left out.

    Returns
    -------
    Simulated
        As from `simulate`, of the layers that were finished.

    Raises
    ------
    InputError
        As `simulate`; or if the block is below 1, or more was finished than there are layers.
    RuntimeError
        If JAX makes 32-bit floats.
    """
    require_float64("a simulation of electrode and cavity")
    settings = Settings(electrode, wear_ratio, side_gap, bottom_gap, wear_mode, spread_width)
    plan, splits = zmap_run.planned(steps, electrode, workpiece)
    fed = np.asarray(zmap_run.checked_feeds(feeds, steps))
    total, area = len(fed), electrode.cell**2
    if block < 1:
        raise InputError(f"block of {block} layers must be at least 1.")
    if resume is None:
        cavity, balance = zmap_run.begin(settings, workpiece), Balance.empty()
    else:
        cavity = resume.cavity
        balance = Balance(
            removed=np.asarray(resume.removed) / area,
            worn=np.asarray(resume.worn) / area,
            swept=np.asarray(resume.swept_area) / area,
            greatest=np.asarray(resume.greatest_loss),
        )
    done = len(balance.removed)
    if done > total:
        raise InputError(f"{done} layers are finished, but only {total} asked for.")
    # What the layer before covered may belong to an empty one that filled up the last block.
    plan.same[done : done + 1] = False
    stop = total if until is None else min(until, total)
    stopped = ""
    try:
        while done < stop and not np.any(balance.greatest > electrode.usable_length):
            part, fed_part = zmap_run.part_of(plan, fed, done, block)
            after, more = jax.block_until_ready(
                zmap_run.cut(settings, splits, cavity, part, jnp.asarray(fed_part))
            )
            # Nothing is taken over before all of the block is there.
            cavity, balance = after, balance.joined(more, total - done)
            done = len(balance.removed)
            if progress is not None:
                progress(done, total)
    except KeyboardInterrupt:
        stopped = f"stopped after layer {done} of {total}; give the result as resume to go on."
    return _simulated(settings, workpiece, cavity, balance, steps, stopped)


def _simulated(
    settings: Settings,
    workpiece: WorkpieceMap,
    cavity: Cavity,
    balance: Balance,
    steps: PathSteps,
    stopped: str = "",
) -> Simulated:
    """The result, in um and within the map."""
    electrode, beyond = settings.electrode, zmap_run.overhang(settings.electrode)
    done = len(balance.removed)
    turns = int(steps.quarter_turns[done - 1]) if done else 0
    loss = jnp.rot90(zmap_run.loss_of(settings, cavity.worn), -turns)
    inside = cavity.depth[beyond:-beyond, beyond:-beyond]
    area = electrode.cell**2
    if len(steps.x) > done and not stopped:
        stopped = (
            f"paused after layer {done} of {len(steps.x)}; give the result as resume to go on."
        )
    return Simulated(
        WorkpieceMap(inside, workpiece.cell, workpiece.origin),
        dataclasses.replace(electrode, loss=loss),
        balance.removed * area,
        balance.worn * area,
        balance.swept * area,
        balance.greatest,
        cavity,
        len(steps.x),
        stopped,
    )
