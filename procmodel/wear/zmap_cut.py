"""The cut itself: steps of a path in windows of the map, in chunks, in layers.

Lengths in um, volumes in cells times um.

A cell at a wall is only partly open to the electrode. It has two depths, that of its open part and
that of the rest, and the share of the open part: the largest share that the layer's path covers.
Without it every pass would cut the same part of the cell again, and the wall would creep out.

notation: D, V depth of the open part and of the rest; s share of the open part; F depth of an
unworn electrode's bottom.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax

from procmodel.wear.path_steps import CHUNK
from procmodel.wear.zmap_wear import Wear
from procmodel.wear.zmap_windows import put_window, take_window

# Cells covered by less are closed.
_LEAST_SHARE = 1e-7
# Depth that is never reached, of cells that are closed to a layer [um].
_CLOSED = 1e12


class Plan(NamedTuple):
    """Where the window stands at every step, shape (layers, steps) each.

    Attributes
    ----------
    row, column : Array of int
        First cell of the window.
    across, along : Array
        Share of a cell by which the electrode's cells lie beyond the map's, along x and y.
    live : Array of bool
        False in padding, where nothing is cut.
    used : Array of bool, shape (layers, chunks)
        Chunks with a step in them.
    turns : Array of int, shape (layers,)
        Quarter turns since the layer before.
    same : Array of bool, shape (layers,)
        Whether the path covers what the one before covered.
    """

    row: Any
    column: Any
    across: Any
    along: Any
    live: Any
    used: Any
    turns: Any
    same: Any


class Cavity(NamedTuple):
    """State between two layers.

    Attributes
    ----------
    deep, rest : Array, shape (nx, ny) [um]
        Depth of the open part of every cell, and of the rest.
    share : Array, shape (nx, ny)
        Share of the open part.
    touched : Array of bool, shape (nx, ny)
        Cells that the last layer's path covered, by what is their share.
    worn : Array [um]
        State of the wear mode, turned as the electrode stands.
    fed : Array, shape () [um]
        Depth of the bottom of an unworn electrode.
    """

    deep: Array
    rest: Array
    share: Array
    touched: Array
    worn: Array
    fed: Array

    @property
    def depth(self) -> Array:
        """Mean depth of every cell, shape (nx, ny) [um]."""
        return self.share * self.deep + (1.0 - self.share) * self.rest


class Cutter(eqx.Module):
    """The electrode with its wear and gaps: what is the same at every step.

    Parameters
    ----------
    wear : Wear
        Wear mode.
    covered : Array, shape (n, n)
        Share of every cell that the discharge reaches.
    wear_ratio : Array, shape ()
        Volumetric wear ratio R.
    bottom_gap : Array, shape () [um]
        Depth below the surface from which the bottom cuts.
    splits : tuple of bool
        Whether any step lies between the map's cells, along x and y.
    """

    wear: Wear
    covered: Array
    removal: Array
    ratios: Array
    bottom_gap: Array
    splits: tuple[bool, bool] = eqx.field(static=True)

    def __init__(
        self, wear: Wear, covered: Array, wear_ratio: Array, bottom_gap: Array,
        splits: tuple[bool, bool],
    ) -> None:  # fmt: skip
        self.wear, self.covered, self.splits = wear, covered, splits
        self.bottom_gap = bottom_gap
        # Area reached by the discharge over area that wears: 1 but at a rim with a side gap, where
        # the same split leaves contact as it does everywhere else.
        reached = wear.length(wear.lost(covered))
        self.removal = covered / (1.0 + wear_ratio * reached)
        # In cells, so that its derivative is summed over them once, not at every step.
        self.ratios = jnp.broadcast_to(wear_ratio, jnp.shape(wear.lost(covered)))

    @property
    def window(self) -> tuple[int, int]:
        """Cells of the map under the electrode at a step."""
        rows, columns = self.covered.shape
        return rows + self.splits[0], columns + self.splits[1]

    def pairs(self, across: Array, along: Array) -> list[tuple[int, int, Array]]:
        """Offsets from the electrode's cells to the map's, and the shares of area they have."""
        rows = [(0, 1.0 - across), (1, across)] if self.splits[0] else [(0, 1.0)]
        columns = [(0, 1.0 - along), (1, along)] if self.splits[1] else [(0, 1.0)]
        return [(i, j, jnp.asarray(a * b)) for i, a in rows for j, b in columns]

    def on_map(self, cells: Array, row: int, column: int) -> Array:
        """Electrode's cells as seen from the window's, at one offset; 0 beyond."""
        before = [(o, int(s) - o) for o, s in zip((row, column), self.splits, strict=True)]
        return jnp.pad(cells, before)

    def shadow(self, across: Array, along: Array) -> Array:
        """Share of the window's cells that is covered at a step."""
        seen = jnp.zeros(self.window)
        for i, j, weight in self.pairs(across, along):
            seen += weight * self.on_map(self.covered, i, j)
        return seen


def _cut(
    cutter: Cutter, openness: Array, place: tuple, fed: Array, deep: Array, worn: Array
) -> tuple[Array, Array]:
    """One step: the window's depth and the electrode's wear after it.

    Every pair of cells that lie upon each other has its own overlap and its own share of area, so
    what one loses is what wears the other, to rounding.
    """
    row, column, across, along = place
    bottom = fed - cutter.wear.length(worn)
    n, m = cutter.covered.shape
    taken = jnp.zeros_like(deep)
    volume = jnp.zeros_like(cutter.covered)
    for i, j, weight in cutter.pairs(across, along):
        overlap = jnp.maximum(bottom - deep[i : i + n, j : j + m], 0.0)
        volume += weight * overlap
        if deep.shape == (n, m):
            taken = cutter.removal * overlap
        else:
            seen = jnp.maximum(cutter.on_map(bottom, i, j) - deep, 0.0)
            taken += weight * cutter.on_map(cutter.removal, i, j) * seen
    lost = cutter.wear.lost(cutter.removal * volume)
    opened = lax.dynamic_slice(openness, (row, column), deep.shape)
    return deep + taken * opened, worn + cutter.ratios * lost


def _steps(cutter: Cutter, openness: Array, state: tuple, positions: tuple[Array, ...]) -> tuple:
    """The steps of a chunk."""
    window = cutter.window

    # The window alone is kept for the reverse pass.
    cut = jax.checkpoint(_cut, prevent_cse=False)

    def step(state: tuple, position: tuple) -> tuple[tuple, None]:
        deep, worn = state
        row, column, across, along, bottom = position
        deep, part = take_window(deep, (row, column), window)
        place = (row, column, across, along)
        part, worn = cut(cutter, openness, place, bottom, part, worn)
        deep = put_window(deep, part, (row, column))
        return (deep, worn), None

    return lax.scan(step, state, positions)[0]


def _chunked(steps: Array) -> Array:
    return steps.reshape((-1, CHUNK, *steps.shape[1:]))


def _covered_by(cutter: Cutter, shape: tuple[int, ...], plan: Plan) -> Array:
    """Largest share of every cell of the map that one layer's path covers, shape (nx, ny).

    The step at which it does is found without derivatives; the share itself has one.
    """
    window = cutter.window
    fixed = lax.stop_gradient(cutter)
    places = (plan.row, plan.column, plan.across, plan.along)
    number = jnp.arange(plan.row.size, dtype=jnp.int32)

    def step(best: tuple, position: tuple) -> tuple[tuple, None]:
        most, when = best
        row, column, across, along, now = position
        here = fixed.shadow(across, along)
        before = lax.optimization_barrier(lax.dynamic_slice(most, (row, column), window))
        earlier = lax.optimization_barrier(lax.dynamic_slice(when, (row, column), window))
        later = here > before
        most = lax.dynamic_update_slice(most, jnp.where(later, here, before), (row, column))
        when = lax.dynamic_update_slice(when, jnp.where(later, now, earlier), (row, column))
        return (most, when), None

    def chunk(best: tuple, part: tuple) -> tuple[tuple, None]:
        used, positions = part
        return lax.cond(used, lambda b: lax.scan(step, b, positions)[0], lambda b: b, best), None

    start = (jnp.zeros(shape), jnp.full(shape, -1, jnp.int32))
    chunks = tuple(map(_chunked, (*places, number)))
    when = lax.scan(chunk, start, (plan.used, chunks))[0][1]

    row, column = jnp.indices(shape)
    row, column = row - plan.row[when], column - plan.column[when]
    across, along = plan.across[when], plan.along[when]
    n, m = cutter.covered.shape
    share = jnp.zeros(shape)
    for i, j, weight in cutter.pairs(across, along):
        inside = (row >= i) & (row < n + i) & (column >= j) & (column < m + j)
        cell = cutter.covered[jnp.clip(row - i, 0, n - 1), jnp.clip(column - j, 0, m - 1)]
        share += jnp.where(inside, weight * cell, 0.0)
    return jnp.where(when < 0, 0.0, share)


def _opened(cavity: Cavity, cover: Array) -> Cavity:
    """The same cavity with the open parts as large as the next path covers."""
    touched = cover > _LEAST_SHARE
    wider, narrower = touched & (cover > cavity.share), touched & (cover < cavity.share)
    safe_cover, safe_rest = jnp.where(wider, cover, 1.0), jnp.where(narrower, 1.0 - cover, 1.0)
    deep, rest, share = cavity.deep, cavity.rest, cavity.share
    mixed = (share * deep + (cover - share) * rest) / safe_cover
    left = ((1.0 - share) * rest + (share - cover) * deep) / safe_rest
    return cavity._replace(
        deep=jnp.where(wider, mixed, deep),
        rest=jnp.where(narrower, left, rest),
        share=jnp.where(touched, cover, share),
        touched=touched,
    )


def cut_layer(cutter: Cutter, cavity: Cavity, plan: Plan, feeds: Array) -> Cavity:
    """One layer; the fields of the plan are those of the layer.

    Parameters
    ----------
    cutter : Cutter
        The electrode.
    cavity : Cavity
        State before.
    plan : Plan
        Windows of the layer's steps.
    feeds : Array, shape (steps,) [um]
        Feed before the cut at every step.

    Returns
    -------
    Cavity
        State after.
    """
    cover = lax.cond(
        plan.same,
        lambda: jnp.where(cavity.touched, cavity.share, 0.0),
        lambda: _covered_by(cutter, cavity.deep.shape, plan),
    )
    cavity = _opened(cavity, cover)
    touched = cavity.touched
    openness = jnp.where(touched, 1.0 / jnp.where(touched, cover, 1.0), 0.0)
    deep = jnp.where(touched, cavity.deep, _CLOSED)
    worn = cutter.wear.turned(cavity.worn, plan.turns)

    def chunk(state: tuple, part: tuple) -> tuple[tuple, None]:
        used, positions = part
        return lax.cond(
            used, lambda s: _steps(cutter, openness, s, positions), lambda s: s, state
        ), None

    fed = cavity.fed + jnp.cumsum(feeds)
    # In padding the electrode is far above and cuts nothing.
    bottom = jnp.where(plan.live, fed - cutter.bottom_gap, -_CLOSED)
    positions = (plan.row, plan.column, plan.across, plan.along, bottom)
    chunk = jax.checkpoint(chunk, prevent_cse=False)
    parts = (plan.used, tuple(map(_chunked, positions)))
    (deep, worn), _ = lax.scan(chunk, (deep, worn), parts)
    return cavity._replace(deep=jnp.where(touched, deep, cavity.deep), worn=worn, fed=fed[-1])
