"""How a volume lost at the electrode's bottom is shared among its cells: the wear modes.

Each mode turns the volume removed under every cell of the map into lengths lost, keeping the
volume exactly. Volumes in cells times um, lengths in um.
"""

from functools import partial
from typing import Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike

from procmodel.errors import InputError, nearest
from procmodel.wear.zmap_maps import ElectrodeMap, concrete
from procmodel.wear.zmap_windows import quarter_turned, symmetric

WearMode = Literal["local", "rotating", "spread", "uniform"]
WEAR_MODES: tuple[WearMode, ...] = ("local", "rotating", "spread", "uniform")
# Least width of the spread in cells: a narrower one is local but for rounding, and its kernel
# would underflow between the bottom's cells.
_LEAST_WIDTH = 0.2
_BALANCINGS = 30


class LocalWear(eqx.Module):
    """A fixed electrode: every cell loses what it removes. The state is the length lost.

    Cells outside the bottom hand their volume to the nearest one of the bottom and follow it.

    Parameters
    ----------
    electrode : ElectrodeMap
        The bottom, and which of its cells every other cell belongs to.
    """

    area: Array
    inner: Array
    members: Array
    group: Array
    group_area: Array
    alone: bool = eqx.field(static=True)
    margin: int | None = eqx.field(static=True)

    def __init__(self, electrode: ElectrodeMap) -> None:
        bottom, belongs = electrode.bottom.ravel(), electrode.nearest.ravel()
        area, shape = electrode.area.ravel(), electrode.bottom.shape
        follows = belongs != np.arange(bottom.size)
        rim, first = np.unique(belongs[follows], return_inverse=True)
        # Group of every cell: a cell of the rim with those that belong to it; one number more
        # stands for no group.
        group = np.full(bottom.size, len(rim))
        group[rim], group[follows] = np.arange(len(rim)), first
        counts = np.bincount(group, minlength=len(rim) + 1)[:-1]
        # Place `size` of a flattened map with a 0 appended stands for no member.
        members = np.full((len(rim), int(np.max(counts, initial=1))), bottom.size)
        order = np.argsort(group, kind="stable")[: int(np.sum(counts))]
        members[
            group[order], np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts)
        ] = order
        inner = bottom & (group == len(rim))
        self.area = jnp.asarray(area.reshape(shape))
        self.inner = jnp.asarray((inner / np.where(inner, area, 1.0)).reshape(shape))
        self.members = jnp.asarray(members, jnp.int32)
        self.group = jnp.asarray(group.reshape(shape), jnp.int32)
        self.group_area = jnp.asarray(area[rim])
        self.alone = len(rim) == 0
        self.margin = _margin_of_square(electrode.bottom)

    def begun(self, loss: Array) -> Array:
        """State of an electrode that has lost these lengths."""
        return self.lost(self.area * loss)

    def lost(self, volume: Array) -> Array:
        """Change of the state by a volume lost under every cell, shape (n, n)."""
        if self.alone:
            return self.inner * volume
        if self.margin is not None:
            core = self.area[(slice(self.margin, -self.margin),) * 2]
            return symmetric(partial(_clamped, self.margin), core, volume)
        return symmetric(_grouped, (self.inner, self.members, self.group, self.group_area), volume)

    def length(self, state: Array) -> Array:
        """Length lost at every cell, shape (n, n)."""
        return state

    def turned(self, state: Array, turns: Array) -> Array:
        """State as seen after quarter turns."""
        return quarter_turned(state, turns)


def _grouped(constants: tuple[Array, ...], volume: Array) -> Array:
    """Lengths from volumes, by groups; the matrix is symmetric."""
    inner, members, group, group_area = constants
    flat = jnp.append(volume.ravel(), 0.0)
    # The barrier keeps the sums from being made again for every cell that looks one up.
    together = lax.optimization_barrier(jnp.sum(_at(flat, members), axis=1) / group_area)
    return inner * volume + _at(jnp.append(together, 0.0), group)


def _at(flat: Array, places: Array) -> Array:
    # Places are known to be inside: looking whether they are takes longer than the look-up.
    return flat.at[places].get(mode="promise_in_bounds", wrap_negative_indices=False)


def _clamped(margin: int, area: Array, volume: Array) -> Array:
    """The same for a bottom that is a whole square with a margin around it, without look-ups."""
    for _ in range(2):
        first = jnp.sum(volume[: margin + 1], axis=0, keepdims=True)
        last = jnp.sum(volume[-margin - 1 :], axis=0, keepdims=True)
        volume = jnp.concatenate([first, volume[margin + 1 : -margin - 1], last]).T
    return jnp.pad(volume / area, margin, mode="edge")


def _margin_of_square(bottom: np.ndarray) -> int | None:
    """Cells around a bottom that is a square of two or more cells; None if it is not one."""
    margin = int(np.argmax(bottom[len(bottom) // 2]))
    inner = bottom[(slice(margin, len(bottom) - margin),) * 2]
    square = margin > 0 and len(inner) > 1 and np.all(inner) and np.sum(bottom) == inner.size
    return margin if square else None


class SpreadWear(eqx.Module):
    """A fixed electrode whose wear is blurred: a Gaussian kernel, normalised on the bottom.

    The kernel is balanced, so that an even loss stays even up to the rim. A width of infinity
    wears the bottom evenly. The state is the length lost.

    Parameters
    ----------
    electrode : ElectrodeMap
        The bottom.
    width : array_like, shape () [um]
        Standard deviation of the kernel, > 0; differentiable. Below a fifth of a cell it counts as
        a fifth, which is local.
    """

    local: LocalWear
    kernel: Array
    after: Array
    before: Array

    def __init__(self, electrode: ElectrodeMap, width: ArrayLike) -> None:
        self.local = LocalWear(electrode)
        area, bottom = self.local.area, jnp.asarray(electrode.bottom)
        place = np.arange(electrode.width)
        apart = np.abs(place[:, None] - place[None, :])
        scaled = jnp.maximum(jnp.asarray(width, float) / electrode.cell, _LEAST_WIDTH)
        self.kernel = jnp.exp(-0.5 * jnp.square(apart / scaled))

        def summed(weights: Array) -> Array:
            return jnp.where(bottom, self._blurred(area * weights), 1.0)

        def balanced(weights: Array, _: None) -> tuple[Array, None]:
            return jnp.sqrt(weights / summed(weights)), None

        weights, _ = lax.scan(balanced, jnp.ones(area.shape), length=_BALANCINGS)
        # What is left unbalanced goes into the division, so that the volume is kept exactly.
        self.after, self.before = bottom * weights, bottom / summed(weights)

    def _blurred(self, cells: Array) -> Array:
        return self.kernel @ cells @ self.kernel

    def begun(self, loss: Array) -> Array:
        """State of an electrode that has lost these lengths."""
        return self.local.begun(loss)

    def lost(self, volume: Array) -> Array:
        """Change of the state by a volume lost under every cell, shape (n, n)."""
        own = self.local.area * self.local.lost(volume)
        spread = self.after * self._blurred(self.before * own)
        # Cells outside the bottom follow theirs.
        return spread if self.local.alone else self.local.lost(self.local.area * spread)

    def length(self, state: Array) -> Array:
        """Length lost at every cell, shape (n, n)."""
        return state

    def turned(self, state: Array, turns: Array) -> Array:
        """State as seen after quarter turns."""
        return quarter_turned(state, turns)


class RingWear(eqx.Module):
    """A rotating electrode: the loss is averaged over rings about the axis.

    The state is the length lost at radii one cell apart, between which it is linear; with a single
    ring the whole bottom wears evenly.

    Parameters
    ----------
    electrode : ElectrodeMap
        The bottom.
    rings : int
        Number of radii.
    """

    shares: Array
    ring_area: Array
    own: Array
    width: int = eqx.field(static=True)

    def __init__(self, electrode: ElectrodeMap, rings: int) -> None:
        self.width = electrode.width
        x, y = (c[self.width // 2 :, self.width // 2 :] for c in electrode.centres)
        place = np.clip(np.hypot(x, y).ravel() / electrode.cell - 0.5, 0.0, rings - 1.0)
        self.shares = jnp.asarray(np.maximum(1.0 - np.abs(place[:, None] - np.arange(rings)), 0.0))
        self.own = jnp.asarray(electrode.own)
        self.ring_area = self._summed(self.own)

    def _summed(self, cells: Array) -> Array:
        """Sums over the rings, by the symmetry of the four quarters."""
        middle, odd = self.width // 2, self.width % 2
        for _ in range(2):
            low, high = cells[:middle][::-1], cells[middle:]
            # The middle line of an odd map is its own mirror image.
            cells = (high.at[1:].add(low) if odd else high + low).T
        return cells.ravel() @ self.shares

    def begun(self, loss: Array) -> Array:
        """State of an electrode that has lost these lengths."""
        return self.lost(self.own * loss)

    def lost(self, volume: Array) -> Array:
        """Change of the state by a volume lost under every cell, shape (rings,)."""
        return self._summed(volume) / self.ring_area

    def length(self, state: Array) -> Array:
        """Length lost at every cell, shape (n, n)."""
        if len(self.ring_area) == 1:
            return jnp.broadcast_to(state, (self.width, self.width))
        middle, odd = self.width // 2, self.width % 2
        cells = (self.shares @ state).reshape((middle + odd,) * 2)
        for _ in range(2):
            cells = jnp.concatenate([cells[odd:][::-1], cells]).T
        return cells

    def turned(self, state: Array, turns: Array) -> Array:
        """State as seen after quarter turns: the same."""
        return state


Wear = LocalWear | SpreadWear | RingWear


def check_wear(mode: WearMode, electrode: ElectrodeMap, width: ArrayLike | None) -> None:
    """Refuse a wear mode that does not go with the electrode or the width.

    Parameters
    ----------
    mode : {"local", "rotating", "spread", "uniform"}
        How wear is shared among the bottom's cells.
    electrode : ElectrodeMap
        The bottom.
    width : array_like, shape () or None [um]
        Width of the spread; for that mode only.

    Raises
    ------
    InputError
        If the mode is unknown, a rotating electrode is not round, or the width is missing, not
        above 0 or given for another mode.
    """
    if mode not in WEAR_MODES:
        raise InputError(f"wear mode {mode!r} is unknown{nearest(mode, WEAR_MODES)}.")
    if mode != "spread" and width is not None:
        raise InputError(f"spread width goes with wear mode spread: leave it out for {mode}.")
    if mode == "rotating" and electrode.section.shape != "round":
        raise InputError(
            "a rotating electrode must be round: a square one that turns cuts like a round one of "
            "its diagonal, give that."
        )
    if mode == "spread":
        if width is None:
            raise InputError("wear mode spread needs a spread width; infinity wears evenly.")
        if concrete(width) and not np.all(np.asarray(width) > 0):
            raise InputError(f"spread width {width} um must be above 0.")


def wear_of(mode: WearMode, electrode: ElectrodeMap, width: ArrayLike | None) -> Wear:
    """The wear mode of a name, which `check_wear` has let pass."""
    match mode:
        case "local":
            return LocalWear(electrode)
        case "spread":
            assert width is not None
            return SpreadWear(electrode, width)
        case "rotating":
            return RingWear(electrode, max(1, round(electrode.section.half / electrode.cell)))
        case "uniform":
            return RingWear(electrode, 1)
