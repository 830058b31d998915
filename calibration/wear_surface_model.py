"""A cavity cut along known paths, as plans and fits simulate it again and again.

Lengths in um.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from procmodel.wear.feed_law import layer_feeds
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.path_steps import PathSteps, path_steps
from procmodel.wear.zmap import Simulated, simulate
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap
from procmodel.wear.zmap_wear import WearMode


@dataclass(frozen=True, eq=False)
class CavityModel:
    """Paths, cells and wear mode of a simulation; feeds and wear are given at every run.

    Two models are never equal: what was compiled for one belongs to that one.

    Attributes
    ----------
    steps : PathSteps
        Positions of the electrode, layer by layer.
    electrode : ElectrodeMap
        A fresh electrode; its reach is the largest side gap that can be asked for.
    workpiece : WorkpieceMap
        The surface before.
    wear_mode : {"local", "rotating", "spread", "uniform"}
        See `procmodel.wear.zmap.simulate`.
    """

    steps: PathSteps
    electrode: ElectrodeMap
    workpiece: WorkpieceMap
    wear_mode: WearMode = "local"

    @classmethod
    def of(
        cls,
        paths: Sequence[LayerPath],
        section: ElectrodeSection,
        cell: float,
        *,
        step: float | None = None,
        reach: float = 0.0,
        wear_mode: WearMode = "local",
        margin: float = 0.0,
    ) -> Self:
        """Model of a flat workpiece that holds all that the paths can reach.

        Parameters
        ----------
        paths : sequence of LayerPath
            The way through every layer.
        section : ElectrodeSection
            The electrode.
        cell : float [um]
            Side of the cells.
        step : float, optional [um]
            Distance of positions along the path; the cell when left out.
        reach : float [um]
            Largest side gap.
        wear_mode : {"local", "rotating", "spread", "uniform"}
            How wear is shared.
        margin : float [um]
            Rim of the map beyond what the electrode reaches.

        Returns
        -------
        CavityModel
            The model.

        Raises
        ------
        InputError
            If there is no path, or cell, step or reach are out of range.
        """
        electrode = ElectrodeMap(section, cell, reach)
        steps = path_steps(paths, cell if step is None else step)
        workpiece = WorkpieceMap.around(steps, electrode, margin)
        return cls(steps, electrode, workpiece, wear_mode)

    @property
    def layers(self) -> int:
        """Number of layers."""
        return len(self.steps.x)

    def cut(
        self,
        feeds: ArrayLike,
        wear_ratio: ArrayLike,
        side_gap: ArrayLike = 0.0,
        bottom_gap: ArrayLike = 0.0,
        spread_width: ArrayLike | None = None,
    ) -> Simulated:
        """The cavity after all layers; differentiable in every argument.

        Parameters
        ----------
        feeds : array_like, shape (layers,) [um]
            Feed of every layer.
        wear_ratio : array_like
            Volumetric wear ratio.
        side_gap, bottom_gap : array_like [um]
            Gaps.
        spread_width : array_like, optional [um]
            Used in mode ``spread`` only, and needed there.

        Returns
        -------
        Simulated
            Surface, electrode, balance.

        Raises
        ------
        InputError
            If a known number is out of its range.
        """
        return simulate(
            self.steps,
            layer_feeds(self.steps, feeds),
            self.electrode,
            self.workpiece,
            wear_ratio,
            side_gap=side_gap,
            bottom_gap=bottom_gap,
            wear_mode=self.wear_mode,
            spread_width=spread_width if self.wear_mode == "spread" else None,
        )

    def depth(self, feeds: ArrayLike, wear_ratio: ArrayLike, **more: Any) -> Array:
        """Depth of every cell, shape (nx, ny) [um]; arguments as of `cut`."""
        return jnp.asarray(self.cut(feeds, wear_ratio, **more).depth)
