"""Maps that a simulation starts from: the electrode's bottom and the workpiece's surface.

Lengths in um, areas in um^2. A map's first index runs along x, its second along y.
"""

import math
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.spatial import cKDTree

from procmodel.errors import InputError
from procmodel.wear.layer_path import ElectrodeSection
from procmodel.wear.path_steps import PathSteps

# A normal closer to an axis than this is taken to be this far from it: the area of a cell cut by
# a line divides by both components.
_LEAST_COMPONENT = 1e-3


def coverage(
    section: ElectrodeSection, gap: ArrayLike, x: ArrayLike, y: ArrayLike, cell: float
) -> Any:
    """Share of square cells that lies within the section widened by a gap.

    Parameters
    ----------
    section : ElectrodeSection
        Round or square section about the origin.
    gap : array_like, shape () [um]
        Widening on every side; a square keeps its corners.
    x, y : array_like, shape (n, m) [um]
        Centres of the cells.
    cell : float [um]
        Side of the cells.

    Returns
    -------
    Array, shape (n, m)
        Shares from 0 to 1, differentiable in the gap. Exact for a square; for a round section the
        edge is straight within a cell, so the whole area is right to second order in the cell.
    """
    # Known numbers need no compilation.
    xp: Any = jnp if isinstance(gap, Array) else np
    half = section.half + gap
    x, y = np.abs(np.asarray(x)), np.abs(np.asarray(y))

    def share_of_width(inside: Any) -> Any:
        return xp.clip(inside / cell + 0.5, 0.0, 1.0)

    if section.shape == "square":
        return share_of_width(half - x) * share_of_width(half - y)
    # At the axis any direction does.
    x = np.where(np.hypot(x, y) > 0, x, 1e-9 * cell)
    radius = np.hypot(x, y)
    larger = np.maximum(x, y) / radius
    smaller = np.maximum(np.minimum(x, y) / radius, _LEAST_COMPONENT)
    # Area below a line, of a unit cell, by the four triangles that its corners cut.
    inner = (half - radius) / cell + 0.5 * (larger + smaller)
    area = sum(
        sign * xp.square(xp.maximum(inner - corner, 0.0))
        for sign, corner in ((1, 0.0), (-1, larger), (-1, smaller), (1, larger + smaller))
    )
    return xp.clip(area / (2.0 * larger * smaller), 0.0, 1.0)


class ElectrodeMap(eqx.Module):
    """The electrode's bottom in cells, and what it has lost before.

    The bottom consists of the cells that lie at least half within the section. Those covered less
    belong to the nearest of the bottom, with their area, so that no small share divides a volume;
    so do the cells around the section that the discharge reaches.

    Parameters
    ----------
    section : ElectrodeSection
        Cross-section.
    cell : float [um]
        Side of a cell, at most half the electrode's size.
    reach : float [um]
        Largest side gap that will be asked for, >= 0: cells are kept for it.
    loss : array_like, shape (n, n), optional [um]
        Length lost before; 0 when left out.
    usable_length : float [um]
        Length that may be lost before the electrode is used up.

    Raises
    ------
    InputError
        If the cell is larger than half the electrode, the reach is negative, or the loss has
        another shape.
    """

    loss: Array
    section: ElectrodeSection = eqx.field(static=True)
    cell: float = eqx.field(static=True)
    reach: float = eqx.field(static=True)
    usable_length: float = eqx.field(static=True)

    def __init__(
        self,
        section: ElectrodeSection,
        cell: float,
        reach: float = 0.0,
        loss: ArrayLike | None = None,
        usable_length: float = math.inf,
    ) -> None:
        _check_cell(cell)
        if cell > section.half:
            raise InputError(
                f"cell {cell:g} um is larger than half the electrode's size {section.size:g} um: "
                f"give at most {section.half:g} um."
            )
        if not (math.isfinite(reach) and reach >= 0):
            raise InputError(f"reach {reach:g} um of the side gap must not be below 0.")
        if not usable_length > 0:
            raise InputError(f"usable length {usable_length:g} um must be above 0.")
        self.section, self.cell, self.reach = section, float(cell), float(reach)
        self.usable_length = float(usable_length)
        self.loss = jnp.zeros((self.width,) * 2) if loss is None else jnp.asarray(loss, float)
        if self.loss.shape != (self.width,) * 2:
            raise InputError(
                f"loss of the electrode has shape {self.loss.shape}: its map has "
                f"{self.width} x {self.width} cells."
            )

    @property
    def width(self) -> int:
        """Cells along a side of the map: the section, and the reach on both sides."""
        across = math.ceil(self.section.size / self.cell - 1e-9)
        return across + 2 * math.ceil(self.reach / self.cell - 1e-9)

    @property
    def centres(self) -> tuple[np.ndarray, np.ndarray]:
        """X and y of the cells from the axis, shape (n, n) each [um]."""
        line = (np.arange(self.width) - (self.width - 1) / 2.0) * self.cell
        x, y = np.meshgrid(line, line, indexing="ij")
        return x, y

    def covered(self, gap: ArrayLike) -> Array:
        """Share of every cell that lies within the section and a gap, shape (n, n)."""
        return coverage(self.section, gap, *self.centres, self.cell)

    @property
    def own(self) -> np.ndarray:
        """Share of each cell within the section, shape (n, n)."""
        return np.asarray(self.covered(0.0))

    @property
    def bottom(self) -> np.ndarray:
        """Cells of the bottom, shape (n, n)."""
        return self.own >= 0.5

    @property
    def nearest(self) -> np.ndarray:
        """Flat index of the cell of the bottom that each cell belongs to, shape (n, n).

        Cells of the bottom, and those that no discharge reaches, belong to themselves.
        """
        n, bottom = self.width, self.bottom
        places = np.stack(self.centres, axis=-1)
        chosen = np.argwhere(bottom)
        # One quarter is looked up and turned, so that where two are equally near the choice turns
        # with the electrode.
        quarter = np.argwhere(np.ones((n // 2, n - n // 2), bool))
        nearest = cKDTree(places[bottom]).query(places[tuple(quarter.T)])[1]
        at, found = quarter, chosen[nearest]
        flat = np.arange(n * n).reshape(n, n)
        for _ in range(4):
            flat[tuple(at.T)] = found[:, 0] * n + found[:, 1]
            at, found = (np.column_stack([n - 1 - c[:, 1], c[:, 0]]) for c in (at, found))
        reached = np.asarray(self.covered(self.reach)) > 0
        return np.where(bottom | ~reached, np.arange(n * n).reshape(n, n), flat)

    @property
    def area(self) -> np.ndarray:
        """Section's area of each cell of the bottom with its own, in cells, shape (n, n)."""
        own = self.own
        return np.bincount(self.nearest.ravel(), weights=own.ravel(), minlength=own.size).reshape(
            own.shape
        )

    def volume(self, loss: ArrayLike) -> Array:
        """Volume of a loss of length over the bottom [um^3]."""
        return jnp.sum(self.area * jnp.asarray(loss)) * self.cell**2

    @property
    def section_area(self) -> float:
        """Area S_e of the section as its cells have it [um^2]."""
        return float(np.sum(self.own)) * self.cell**2


class WorkpieceMap(eqx.Module):
    """Surface of the workpiece in square cells.

    Parameters
    ----------
    depth : array_like, shape (nx, ny) [um]
        Depth of every cell below the surface, downwards positive.
    cell : float [um]
        Side of a cell.
    origin : tuple of float [um]
        x and y of the corner of the first cell.

    Raises
    ------
    InputError
        If the map is not two-dimensional or empty, or the cell not above 0.
    """

    depth: Array
    cell: float = eqx.field(static=True)
    origin: tuple[float, float] = eqx.field(static=True)

    def __init__(self, depth: ArrayLike, cell: float, origin: tuple[float, float]) -> None:
        _check_cell(cell)
        self.depth = jnp.asarray(depth, float)
        if self.depth.ndim != 2 or self.depth.size == 0:
            raise InputError(
                f"depth of the workpiece has shape {self.depth.shape}: give (nx, ny), not empty."
            )
        self.cell, self.origin = float(cell), (float(origin[0]), float(origin[1]))

    @classmethod
    def around(cls, steps: PathSteps, electrode: ElectrodeMap, margin: float = 0.0) -> Self:
        """Flat surface that holds all that the electrode can reach, and a margin [um].

        The electrode's cells lie on the map's when it stands at a whole multiple of the cell.
        """
        cell = electrode.cell
        # From the axis to beyond the last cell, in whole cells (an odd map's axis is in a cell's
        # middle).
        out = (electrode.width // 2 + 1 + math.ceil(margin / cell)) * cell
        shift = 0.5 * cell * (electrode.width % 2)
        spans = [
            (math.floor(np.min(c) / cell) * cell - out, math.ceil(np.max(c) / cell) * cell + out)
            for c in (np.asarray(steps.x), np.asarray(steps.y))
        ]
        shape = tuple(round((high - low) / cell) + electrode.width % 2 for low, high in spans)
        return cls(jnp.zeros(shape), cell, (spans[0][0] - shift, spans[1][0] - shift))

    @property
    def x(self) -> np.ndarray:
        """X of the cells' middles, shape (nx,) [um]."""
        return self.origin[0] + (np.arange(self.depth.shape[0]) + 0.5) * self.cell

    @property
    def y(self) -> np.ndarray:
        """Y of the cells' middles, shape (ny,) [um]."""
        return self.origin[1] + (np.arange(self.depth.shape[1]) + 0.5) * self.cell


def concrete(value: Any) -> bool:
    """Whether a value is known, not a tracer of a transformation."""
    return not isinstance(value, jax.core.Tracer)


def _check_cell(cell: float) -> None:
    if not (math.isfinite(cell) and cell > 0):
        raise InputError(f"cell {cell:g} um must be above 0.")
