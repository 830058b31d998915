"""What to expect of a feed schedule, from simulations over everything believed of the wear.

Lengths in um.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax

from calibration.wear_surface_model import CavityModel
from procmodel.errors import InputError
from procmodel.wear.surface_error import SurfaceError, cleared_cells, surface_error

COVERED = 0.95


@dataclass(frozen=True)
class Belief:
    """Equally likely wear ratios, and the ends of their 95 % range.

    Attributes
    ----------
    nodes : ndarray, shape (k,)
        Increasing, the median in the middle.
    ends : ndarray, shape (2,)
        Both ends of the range.
    """

    nodes: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(cls, believed: np.ndarray, nodes: int) -> "Belief":
        """Of as many equally likely values as there are, by fewer."""
        count = nodes if len(believed) > 1 else 1

        def quantile(levels: np.ndarray) -> np.ndarray:
            # Each value stands for its share (Hazen's positions).
            return np.quantile(believed, levels, method="hazen")

        outer = np.array([0.5 - COVERED / 2, 0.5 + COVERED / 2])
        return cls(quantile((np.arange(count) + 0.5) / count), quantile(outer))

    @property
    def median(self) -> float:
        """Middle value."""
        return float(self.nodes[len(self.nodes) // 2])


@dataclass(frozen=True)
class Outlook:
    """What comes out of feeds.

    Attributes
    ----------
    expected_rms : float [um]
        Root mean square error over the cleared cells and all that is believed of the wear ratio.
    expected_max : float [um]
        Greatest error of a cell, its mean over what is believed.
    rms_limit, max_limit : float [um]
        The worst of both within the 95 % range of the wear ratio.
    middle : SurfaceError
        Error at the median wear ratio, with its map.
    depth : ndarray, shape (nx, ny) [um]
        Surface at the median wear ratio.
    depths : ndarray, shape (n,) [um]
        Mean depth after every layer at the median, as far as its path reaches.
    depth_ends : ndarray, shape (2, n) [um]
        The same at both ends of the 95 % range of the wear ratio.
    tip_loss, tip_loss_limit : ndarray, shape (n,) [um]
        Greatest loss of the electrode's tip after every layer, at the median and at the upper end.
    """

    expected_rms: float
    expected_max: float
    rms_limit: float
    max_limit: float
    middle: SurfaceError
    depth: np.ndarray
    depths: np.ndarray
    depth_ends: np.ndarray
    tip_loss: np.ndarray
    tip_loss_limit: np.ndarray

    @property
    def depth_spread(self) -> np.ndarray:
        """Half the width of the 95 % range of the depth after every layer, shape (n,) [um]."""
        return 0.5 * np.abs(self.depth_ends[1] - self.depth_ends[0])


class Foresight:
    """Simulates feeds over a belief and compares the surfaces with their target.

    Parameters
    ----------
    model : CavityModel
        What is simulated.
    more : mapping
        Gaps and spread width, as `CavityModel.cut` takes them.
    target : ndarray, shape (nx, ny) [um]
        Wanted depth; NaN in cells that do not count.
    belief : Belief
        Wear ratios.
    """

    def __init__(
        self,
        model: CavityModel,
        more: Mapping[str, Any],
        target: np.ndarray,
        belief: Belief,
    ) -> None:
        self.target, self.belief = target, belief
        certain = len(belief.nodes) == 1
        self.ratios = belief.nodes if certain else np.concatenate([belief.nodes, belief.ends])

        @jax.jit
        def run(feeds: Array, ratios: Array) -> tuple[Array, Array, Array]:
            def at(ratio: Array) -> tuple[Array, Array, Array]:
                cut = model.cut(feeds, ratio, **more)
                return cut.depth, jnp.cumsum(cut.layer_depth), jnp.asarray(cut.greatest_loss)

            return lax.map(at, ratios)

        self._run = run

    def of(self, feeds: np.ndarray) -> Outlook:
        """What comes out of feeds, shape (n,) [um]."""
        surfaces, depths, losses = map(np.asarray, self._run(feeds, self.ratios))
        count = len(self.belief.nodes)
        middle = count // 2
        region = cleared_cells(np.max(surfaces, axis=0), self.target) & np.isfinite(self.target)
        errors = [surface_error(surface, self.target, region) for surface in surfaces]
        nodes = errors[:count]
        low, high = (0, 0) if count == 1 else (count, count + 1)
        return Outlook(
            expected_rms=math.sqrt(float(np.mean([e.rms**2 for e in nodes]))),
            expected_max=float(np.mean([e.max for e in nodes])),
            rms_limit=max(e.rms for e in errors),
            max_limit=max(e.max for e in errors),
            middle=errors[middle],
            depth=surfaces[middle],
            depths=depths[middle],
            depth_ends=depths[[low, high]],
            tip_loss=losses[middle],
            tip_loss_limit=losses[high],
        )


def touch_offs(depth_ends: np.ndarray, tolerance: float) -> tuple[int, ...]:
    """Fewest layers after which to measure so that the spread since the last stays within.

    Parameters
    ----------
    depth_ends : ndarray, shape (2, n) [um]
        Depth after every layer at both ends of the belief.
    tolerance : float [um]
        Half the width of the range that is allowed.

    Returns
    -------
    tuple of int
        Layers, from 1.
    """
    touches: list[int] = []
    gap = depth_ends[1] - depth_ends[0]
    since = 0
    for n in range(len(gap)):
        known = gap[since - 1] if since else 0.0
        if 0.5 * abs(gap[n] - known) > tolerance and n > since:
            touches.append(n)
            since = n
    return tuple(touches)


def electrode_changes(tip_loss: np.ndarray, usable: float | None) -> tuple[int, ...]:
    """Layers before which the electrode is dressed or changed.

    Parameters
    ----------
    tip_loss : ndarray, shape (n,) [um]
        Greatest loss of the tip after every layer of one electrode that is never changed.
    usable : float or None [um]
        Length that may be lost; None for no end.

    Returns
    -------
    tuple of int
        Layers, from 1.

    Raises
    ------
    InputError
        If a layer alone may use up more.
    """
    if usable is None:
        return ()
    rises = np.diff(tip_loss, prepend=0.0)
    if np.max(rises) > usable:
        worst = int(np.argmax(rises)) + 1
        raise InputError(
            f"layer {worst} alone may wear {np.max(rises):.4g} um off the electrode's tip, more "
            f"than its usable length of {usable:g} um: take thinner layers or a longer electrode."
        )
    changes, used = [], 0.0
    for n, rise in enumerate(rises, start=1):
        if used + rise > usable:
            changes.append(n)
            used = 0.0
        used += rise
    return tuple(changes)
