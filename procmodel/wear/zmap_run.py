"""From what a user gives to what the cut takes: checks, windows, the compiled run."""

import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike

from procmodel.errors import InputError
from procmodel.wear.path_steps import CHUNK, PathSteps
from procmodel.wear.zmap_cut import Cavity, Cutter, Plan, cut_layer
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap, concrete
from procmodel.wear.zmap_wear import WearMode, check_wear, wear_of

# Above this a wear ratio is a percentage, or workpiece over electrode.
LARGEST_WEAR_RATIO = 10.0
# Positions this near to a cell's edge, in cells, are on it.
_ON_GRID = 1e-9


class Settings(eqx.Module):
    """What an electrode cuts with.

    Parameters
    ----------
    electrode : ElectrodeMap
        Section and cells; its loss is where the first layer begins.
    wear_ratio : array_like, shape ()
        Volumetric wear ratio R.
    side_gap, bottom_gap : array_like, shape () [um]
        Gaps.
    wear_mode : {"local", "rotating", "spread", "uniform"}
        How wear is shared among the bottom's cells.
    spread_width : array_like, shape () or None [um]
        Width of the spread, for that mode only.

    Raises
    ------
    InputError
        If one is out of its range.
    """

    electrode: ElectrodeMap
    wear_ratio: Array
    side_gap: Array
    bottom_gap: Array
    spread_width: Array | None
    wear_mode: WearMode = eqx.field(static=True)

    def __init__(
        self,
        electrode: ElectrodeMap,
        wear_ratio: ArrayLike,
        side_gap: ArrayLike,
        bottom_gap: ArrayLike,
        wear_mode: WearMode,
        spread_width: ArrayLike | None,
    ) -> None:
        self.electrode, self.wear_mode = electrode, wear_mode
        self.wear_ratio = _number(wear_ratio, "wear ratio")
        self.side_gap = _number(side_gap, "side gap")
        self.bottom_gap = _number(bottom_gap, "bottom gap")
        self.spread_width = None if spread_width is None else jnp.asarray(spread_width, float)
        if concrete(self.wear_ratio):
            if self.wear_ratio < 0:
                raise InputError(f"wear ratio {self.wear_ratio:g} must not be below 0.")
            if self.wear_ratio > LARGEST_WEAR_RATIO:
                raise InputError(
                    f"wear ratio {self.wear_ratio:g} is above {LARGEST_WEAR_RATIO:g}: give the "
                    "electrode's volume over the workpiece's, as a number, not in percent."
                )
        if concrete(self.side_gap) and not 0 <= self.side_gap <= electrode.reach:
            raise InputError(
                f"side gap {self.side_gap:g} um must lie between 0 and the reach of the "
                f"electrode's map, {electrode.reach:g} um: give ElectrodeMap a larger reach."
            )
        check_wear(wear_mode, electrode, spread_width)

    def cutter(self, splits: tuple[bool, bool]) -> Cutter:
        """The electrode with its wear mode and gaps."""
        wear = wear_of(self.wear_mode, self.electrode, self.spread_width)
        covered = self.electrode.covered(self.side_gap)
        return Cutter(wear, covered, self.wear_ratio, self.bottom_gap, splits)


class Balance(eqx.Module):
    """Volumes [cells x um], area [cells] and greatest loss [um] of every layer, shape (layers,)."""

    removed: Array | np.ndarray
    worn: Array | np.ndarray
    swept: Array | np.ndarray
    greatest: Array | np.ndarray

    def joined(self, more: "Balance", count: int) -> "Balance":
        """The layers of both, of the other only the first.

        In NumPy: JAX would compile anew for every number of layers.
        """
        return jax.tree.map(
            lambda a, b: np.concatenate([np.asarray(a), np.asarray(b)[:count]]), self, more
        )

    @classmethod
    def empty(cls) -> "Balance":
        """Of no layers."""
        return cls(*(np.zeros(0) for _ in range(4)))


@eqx.filter_jit
def begin(settings: Settings, workpiece: WorkpieceMap) -> Cavity:
    """State before the first layer; the map is continued by what the electrode overhangs."""
    electrode = settings.electrode
    depth = jnp.pad(workpiece.depth, overhang(electrode), mode="edge")
    wear = wear_of(settings.wear_mode, electrode, settings.spread_width)
    return Cavity(
        deep=depth,
        rest=depth,
        share=jnp.ones(depth.shape),
        touched=jnp.zeros(depth.shape, bool),
        worn=wear.begun(electrode.loss),
        fed=jnp.zeros(()),
    )


@eqx.filter_jit
def cut(
    settings: Settings, splits: tuple[bool, bool], cavity: Cavity, plan: Plan, feeds: Array
) -> tuple[Cavity, Balance]:
    """Cut the layers of a plan.

    Parameters
    ----------
    settings : Settings
        What cuts.
    splits : tuple of bool
        Whether any window lies between the map's cells, along x and y.
    cavity : Cavity
        State before.
    plan : Plan
        Windows of the steps, shape (layers, steps).
    feeds : Array, shape (layers, steps) [um]
        Feed before the cut at every step.

    Returns
    -------
    cavity : Cavity
        State after.
    balance : Balance
        What every layer removed and wore.
    """
    cutter = settings.cutter(splits)
    own, bottom = jnp.asarray(settings.electrode.own), jnp.asarray(settings.electrode.bottom)

    def totals(cavity: Cavity) -> tuple[Array, Array]:
        return jnp.sum(cavity.depth), jnp.sum(own * cutter.wear.length(cavity.worn))

    def layer(state: tuple, part: tuple) -> tuple:
        cavity, before, worn_before = state
        cavity = cut_layer(cutter, cavity, *part)
        after, worn = totals(cavity)
        swept = jnp.sum(jnp.where(cavity.touched, cavity.share, 0.0))
        greatest = jnp.max(jnp.where(bottom, cutter.wear.length(cavity.worn), -jnp.inf))
        balance = Balance(after - before, worn - worn_before, swept, greatest)
        return (cavity, after, worn), balance

    layer = jax.checkpoint(layer, prevent_cse=False)
    (cavity, _, _), balance = lax.scan(layer, (cavity, *totals(cavity)), (plan, feeds))
    return cavity, balance


@eqx.filter_jit
def loss_of(settings: Settings, worn: Array) -> Array:
    """Length lost at every cell of the electrode's map, from the wear mode's state."""
    wear = wear_of(settings.wear_mode, settings.electrode, settings.spread_width)
    return wear.length(worn)


def overhang(electrode: ElectrodeMap) -> int:
    """Cells by which the map is continued on every side."""
    return electrode.width // 2 + 2


def planned(
    steps: PathSteps, electrode: ElectrodeMap, workpiece: WorkpieceMap
) -> tuple[Plan, tuple[bool, bool]]:
    """Windows of every step, and whether any lies between the map's cells.

    Parameters
    ----------
    steps : PathSteps
        Positions.
    electrode : ElectrodeMap
        Its cells.
    workpiece : WorkpieceMap
        Its cells and where they lie.

    Raises
    ------
    InputError
        If the cells differ, there are no layers, or the path leaves the map.
    """
    if electrode.cell != workpiece.cell:
        raise InputError(
            f"cells of the electrode ({electrode.cell:g} um) and of the workpiece "
            f"({workpiece.cell:g} um) must be the same."
        )
    if not all(concrete(field) for field in steps):
        raise InputError("positions of the path must be known numbers: do not trace them.")
    if len(steps.x) == 0:
        raise InputError("there are no layers: give a path for at least one.")
    firsts, shares = [], []
    for name, values, origin, count in zip(
        "xy", (steps.x, steps.y), workpiece.origin, workpiece.depth.shape, strict=True
    ):
        place = (np.asarray(values) - origin) / workpiece.cell
        outside = (place < -_ON_GRID) | (place > count + _ON_GRID)
        if np.any(outside):
            layer, step = (int(i) for i in np.argwhere(outside)[0])
            raise InputError(
                f"layer {layer + 1}, step {step + 1}: {name} = {np.asarray(values)[layer, step]:g} "
                f"um lies outside the map, which ends at {origin:g} and "
                f"{origin + count * workpiece.cell:g} um; give a larger one."
            )
        corner = place - electrode.width / 2.0
        first = np.floor(corner + _ON_GRID)
        share = corner - first
        shares.append(np.where(np.abs(share) < _ON_GRID, 0.0, share))
        firsts.append(first.astype(np.int32) + np.int32(overhang(electrode)))
    live = np.asarray(steps.valid)
    spare = -live.shape[1] % CHUNK
    row, column, across, along, live = (
        np.pad(field, ((0, 0), (0, spare)), mode="edge" if field is not live else "constant")
        for field in (*firsts, *shares, live)
    )
    turns = np.asarray(steps.quarter_turns, int)
    plan = Plan(
        row, column, across, along, live,
        used=np.any(live.reshape(len(live), -1, CHUNK), axis=2),
        turns=np.diff(turns, prepend=0),
        same=_same_ground(steps),
    )  # fmt: skip
    splits = (bool(np.any(across[live] != 0.0)), bool(np.any(along[live] != 0.0)))
    return plan, splits


def part_of(plan: Plan, feeds: np.ndarray, start: int, count: int) -> tuple[Plan, np.ndarray]:
    """Some layers of a plan, always as many as asked for: beyond the last they are empty."""
    fields = (*plan, feeds)
    stop = min(start + count, len(feeds))
    chunks = max(1, int(np.max(np.sum(plan.used[start:stop], axis=1))))
    # As few different numbers of steps as those of whole paths.
    width = min(1 << (chunks - 1).bit_length(), plan.used.shape[1])
    parts = []
    for field in fields:
        part = field[start:stop]
        if part.ndim == 2:
            part = part[:, : width * (CHUNK if part.shape[1] != plan.used.shape[1] else 1)]
        spare = count - len(part)
        parts.append(np.concatenate([part, np.zeros((spare, *part.shape[1:]), part.dtype)]))
    return Plan(*parts[:-1]), parts[-1]


def checked_feeds(feeds: ArrayLike, steps: PathSteps) -> Array:
    """Feeds in whole chunks of steps, shape (layers, steps) [um]."""
    values = jnp.asarray(feeds, float)
    if values.shape != np.shape(steps.x):
        raise InputError(
            f"feeds have shape {values.shape}: give one for every step of the path, "
            f"{np.shape(steps.x)}."
        )
    if concrete(values) and not np.all(np.isfinite(np.asarray(values))):
        raise InputError("feeds must be finite numbers.")
    return jnp.pad(jnp.where(steps.valid, values, 0.0), ((0, 0), (0, -values.shape[1] % CHUNK)))


def _same_ground(steps: PathSteps) -> np.ndarray:
    """Whether the positions of each layer are those of the layer before, in any order."""
    places = [
        np.unique(np.column_stack([x[v], y[v]]).round(9), axis=0)
        for x, y, v in zip(steps.x, steps.y, np.asarray(steps.valid), strict=True)
    ]
    same = [np.array_equal(*both) for both in itertools.pairwise(places)]
    return np.array([False, *same])


def _number(value: ArrayLike, name: str) -> Any:
    number = jnp.asarray(value, float)
    if number.ndim != 0:
        raise InputError(f"{name} has shape {number.shape}: give one number.")
    if concrete(number) and not np.isfinite(np.asarray(number)):
        raise InputError(f"{name} must be a finite number.")
    return number
