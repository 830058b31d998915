"""Feed schedules: the feed of every layer for a wanted cavity, and what to expect of it.

Two plans. `exact_schedule` inverts eq. (3) of Yu and Masuzawa layer by layer. With
`optimised_schedule` the feeds keep to bounds and minimise the expected wall error under
everything believed of the wear ratio, traded against time and electrode length. Either way the
machine is told the *cumulative* feed, rounded to its resolution, so that rounding never adds up.

Lengths in um, areas in um^2, times in s.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from calibration.plans.belief import believed_wear_ratio
from calibration.solvers import box_lm
from procmodel.errors import InputError
from procmodel.precision import require_float64
from procmodel.wear import TargetLayers, cavity_depths, electrode_wear, layer_depth, layer_feed

COVERED = 0.95


@dataclass(frozen=True)
class Machine:
    """What the machine and the electrode allow.

    Parameters
    ----------
    resolution : float [um]
        Step of the feed axis, to which the cumulative feed is rounded.
    removal_rate : float, optional [um^3/s]
        Workpiece volume removed in a second; without it no time is predicted.
    layer_overhead : float [s]
        Time spent on a layer besides removing material.
    usable_length : float, optional [um]
        Length of one electrode that may wear away; without it one electrode does all.
    tolerance : float, optional [um]
        Depth spread at which a touch-off pays; half the thickest layer when left out.

    Raises
    ------
    InputError
        If one of them is not above 0.
    """

    resolution: float = 0.1
    removal_rate: float | None = None
    layer_overhead: float = 0.0
    usable_length: float | None = None
    tolerance: float | None = None

    def __post_init__(self) -> None:
        for name in ("resolution", "removal_rate", "usable_length", "tolerance"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise InputError(f"{name.replace('_', ' ')} {value:g} must be above 0.")
        if not (math.isfinite(self.layer_overhead) and self.layer_overhead >= 0):
            raise InputError(f"layer overhead {self.layer_overhead:g} s must not be below 0.")


@dataclass(frozen=True)
class Trade:
    """What a unit of wall error is worth: the weights of the optimised plan.

    The plan minimises the mean square of the wall error [um^2] plus `per_minute` times the
    minutes plus `per_length` times the electrode length.

    Parameters
    ----------
    per_minute : float [um^2/min]
        Mean square wall error accepted to save a minute; needs `Machine.removal_rate`.
    per_length : float [um^2/um]
        Mean square wall error accepted to save a micrometre of electrode.
    """

    per_minute: float = 0.0
    per_length: float = 0.0

    def __post_init__(self) -> None:
        for name in ("per_minute", "per_length"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise InputError(f"trade {name} is {value:g}, but must be a number of 0 or more.")


@dataclass(frozen=True)
class Schedule:
    """A planned cavity.

    Attributes
    ----------
    layers : TargetLayers
        What was wanted.
    feeds : ndarray, shape (n,) [um]
        Planned feed of every layer, not rounded.
    cumulative_feed : ndarray, shape (n,) [um]
        Feed from the surface after every layer, rounded to the machine's resolution: what the
        machine is told.
    depths, depth_spread : ndarray, shape (n,) [um]
        Expected depth after every layer at the middle of what is believed of the wear ratio,
        and half the width of its 95 % range.
    wear : ndarray, shape (n,) [um]
        Electrode length lost in every layer.
    electrode_left : ndarray, shape (n,) [um]
        Usable length left on the electrode in the spindle; of the plan's own need when no usable
        length was given.
    new_electrode_before : tuple of int
        Layers before which a fresh electrode is needed.
    touch_off_after : tuple of int
        Layers after which to measure, so that the depth spread stays within tolerance.
    expected_wall_error : float [um]
        Root mean square over layers and over what is believed of the wear ratio.
    electrode_length_limit : float [um]
        Electrode length not exceeded with 97.5 % probability.
    time : float or None [s]
        Expected time.
    status : str
        What was done, as a sentence.
    warnings : tuple of str
        What to know before cutting.
    """

    layers: TargetLayers
    feeds: np.ndarray
    cumulative_feed: np.ndarray
    depths: np.ndarray
    depth_spread: np.ndarray
    wear: np.ndarray
    electrode_left: np.ndarray
    new_electrode_before: tuple[int, ...]
    touch_off_after: tuple[int, ...]
    expected_wall_error: float
    electrode_length_limit: float
    time: float | None
    status: str
    warnings: tuple[str, ...] = field(default=())

    @property
    def wall_error(self) -> np.ndarray:
        """Expected depth less wanted depth of every layer's outer corner, shape (n,) [um]."""
        return self.depths - np.asarray(self.layers.bottom)

    @property
    def max_wall_error(self) -> float:
        """Greatest expected wall error, as a depth [um]."""
        return float(np.max(np.abs(self.wall_error)))

    @property
    def total_feed(self) -> float:
        """Sum of the planned feeds [um]."""
        return float(np.sum(self.feeds))

    @property
    def electrode_length(self) -> float:
        """Electrode length consumed [um]."""
        return float(np.sum(self.wear))

    @property
    def electrodes(self) -> int:
        """Number of electrodes needed."""
        return 1 + len(self.new_electrode_before)


def exact_schedule(
    layers: TargetLayers,
    wear_ratio: Any,
    electrode_area: float,
    machine: Machine = Machine(),
) -> Schedule:
    """Feeds that leave exactly the wanted layers at the middle value of the wear ratio.

    Parameters
    ----------
    layers : TargetLayers
        The wanted cavity; see `procmodel.wear.slice_solid`.
    wear_ratio : float, FitResult or xarray.DataTree
        Number, fit or posterior with parameter ``wear_ratio``.
    electrode_area : float [um^2]
        Cross-section of the electrode.
    machine : Machine
        Resolution, times, electrode.

    Returns
    -------
    Schedule
        The plan.

    Raises
    ------
    InputError
        If wear ratio or area are out of range, or a feed is below the machine's resolution.
    """
    require_float64("A schedule")
    believed, cautions = _believed(wear_ratio, electrode_area)
    middle = believed[len(believed) // 2]
    feeds = np.asarray(layer_feed(layers.thickness, layers.area, middle, electrode_area))
    status = f"exact feeds for {len(feeds)} layers by eq. (3)"
    return _evaluated(layers, feeds, believed, electrode_area, machine, status, cautions)


def optimised_schedule(
    layers: TargetLayers,
    wear_ratio: Any,
    electrode_area: float,
    machine: Machine = Machine(),
    *,
    feed_bounds: tuple[float, float] = (0.0, math.inf),
    trade: Trade = Trade(),
) -> Schedule:
    """Feeds within bounds that minimise expected wall error, time and electrode length.

    Parameters
    ----------
    layers : TargetLayers
        The wanted cavity; see `procmodel.wear.slice_solid`.
    wear_ratio : float, FitResult or xarray.DataTree
        Number, fit or posterior with parameter ``wear_ratio``. The wall error is averaged over
        all of it.
    electrode_area : float [um^2]
        Cross-section of the electrode.
    machine : Machine
        Resolution, times, electrode.
    feed_bounds : (float, float) [um]
        Least and greatest feed of a layer, taken inwards to whole steps of the resolution.
    trade : Trade
        What wall error is worth in time and electrode.

    Returns
    -------
    Schedule
        The plan.

    Raises
    ------
    InputError
        If wear ratio, area, bounds or trade cannot be used.
    """
    require_float64("A schedule")
    believed, cautions = _believed(wear_ratio, electrode_area)
    # Inwards to whole steps: then the rounded increments keep the bounds too.
    step = machine.resolution
    least = step * math.ceil(max(feed_bounds[0], step) / step - 1e-9)
    most = feed_bounds[1]
    if math.isfinite(most):
        most = step * math.floor(most / step + 1e-9)
    if not least < most:
        raise InputError(
            f"feed bounds ({feed_bounds[0]:g}, {most:g}) um must be increasing and above the "
            f"machine's resolution of {machine.resolution:g} um."
        )
    if trade.per_minute > 0 and machine.removal_rate is None:
        raise InputError("a trade per minute needs the removal rate: give it, or drop the trade.")
    arguments = (layers, jnp.asarray(believed), electrode_area, *_prices(machine, trade))
    start = np.asarray(
        layer_feed(layers.thickness, layers.area, believed[len(believed) // 2], electrode_area)
    )
    start = np.clip(start, least, most)
    feeds, status_code = _minimise(start, least, most, arguments)
    feeds = np.asarray(feeds)
    converged = int(status_code) in box_lm.CONVERGED
    held = [i + 1 for i, f in enumerate(feeds) if f >= most * (1 - 1e-9)]
    end = (
        "no feed inside the bounds lowers the cost" if converged else "the optimum was not reached"
    )
    warnings = list(cautions)
    if not converged:
        warnings.append(f"{end}: the solver is {box_lm.STATUS[int(status_code)]}")
    if held:
        warnings.append(
            f"the greatest feed of {most:g} um holds back {len(held)} layers (the first is "
            f"{held[0]}): thinner layers would follow the wall better"
        )
    status = f"feeds of {len(feeds)} layers optimised: {end}"
    return _evaluated(layers, feeds, believed, electrode_area, machine, status, tuple(warnings))


def plan_cost(
    feeds: Array,
    layers: TargetLayers,
    wear_ratios: Array,
    electrode_area: Array,
    per_second: Array,
    per_length: Array,
    removal_rate: Array,
) -> Array:
    """What the optimised plan minimises; quadratic in the feeds.

    Parameters
    ----------
    feeds : Array, shape (n,) [um]
        Feed of every layer.
    layers : TargetLayers
        The wanted cavity.
    wear_ratios : Array, shape (k,) [-]
        Equally likely wear ratios.
    electrode_area : Array [um^2]
        Cross-section of the electrode.
    per_second, per_length : Array [um^2/s, um^2/um]
        Prices of time and electrode.
    removal_rate : Array [um^3/s]
        Workpiece volume removed in a second.

    Returns
    -------
    Array [um^2]
        Mean square wall error plus the price of time and electrode.
    """

    def at(wear_ratio: Array) -> Array:
        depths = cavity_depths(feeds, layers.area, wear_ratio, electrode_area)
        worn = jnp.sum(electrode_wear(feeds, layers.area, wear_ratio, electrode_area))
        removed = jnp.sum(layers.area * layer_depth(feeds, layers.area, wear_ratio, electrode_area))
        error = jnp.mean((depths - layers.bottom) ** 2)
        return error + per_second * removed / removal_rate + per_length * worn

    return jnp.mean(jax.vmap(at)(wear_ratios))


def _prices(machine: Machine, trade: Trade) -> tuple[float, float, float]:
    """Prices of a second and of electrode length, and the removal rate, as `plan_cost` takes."""
    return trade.per_minute / 60.0, trade.per_length, machine.removal_rate or 1.0


def _whitened(feeds: Array, arguments: tuple[Array, Array]) -> Array:
    factor, centre = arguments
    return factor.T @ (feeds - centre)


@jax.jit
def _minimise(start: Array, least: Array, most: Array, arguments: tuple) -> tuple[Array, Array]:
    """Minimum of the quadratic cost in a box, as least squares about the free minimum."""
    scale = 1.0 / plan_cost(jnp.zeros_like(start), *arguments)
    gradient = jax.grad(plan_cost)(start, *arguments) * scale
    curvature = jax.hessian(plan_cost)(start, *arguments) * scale
    factor = jnp.linalg.cholesky(curvature)
    centre = start - jax.scipy.linalg.cho_solve((factor, True), gradient)
    box = (jnp.full_like(start, least), jnp.full_like(start, most))
    outcome = box_lm.solve(_whitened, start, *box, (factor, centre))
    return outcome.vector, outcome.status


def _believed(wear_ratio: Any, electrode_area: float) -> tuple[np.ndarray, tuple[str, ...]]:
    if not (math.isfinite(electrode_area) and electrode_area > 0):
        raise InputError(f"electrode area {electrode_area:g} um^2 must be above 0.")
    believed, cautions = believed_wear_ratio(wear_ratio, electrode_area)
    if believed[0] < 0:
        raise InputError(f"wear ratio {believed[0]:g} is below 0: check it.")
    return believed, cautions


def _evaluated(
    layers: TargetLayers,
    feeds: np.ndarray,
    believed: np.ndarray,
    electrode_area: float,
    machine: Machine,
    status: str,
    warnings: tuple[str, ...],
) -> Schedule:
    """Everything there is to expect of the feeds, as the machine will round them."""
    if np.min(feeds) < machine.resolution * (1 - 1e-9):
        worst = int(np.argmin(feeds)) + 1
        raise InputError(
            f"the feed of layer {worst} is {np.min(feeds):.4g} um, below the machine's resolution "
            f"of {machine.resolution:g} um: take thicker layers or a finer resolution."
        )
    cumulative = machine.resolution * np.round(np.cumsum(feeds) / machine.resolution)
    rounded = np.diff(cumulative, prepend=0.0)
    area, target = np.asarray(layers.area), np.asarray(layers.bottom)
    share = 1.0 / (1.0 + np.outer(believed, area) / electrode_area)
    all_depths = np.cumsum(rounded * share, axis=1)
    all_wear = rounded * (1.0 - share)
    middle = len(believed) // 2
    wear = all_wear[middle]
    spread = _half_range(all_depths)
    limit = float(_quantile(np.sum(all_wear, axis=1), 0.5 + COVERED / 2))
    left, changes = _electrodes(wear, _quantile(all_wear, 0.5 + COVERED / 2), machine.usable_length)
    tolerance = machine.tolerance or 0.5 * float(np.max(layers.thickness))
    touches = _touch_offs(all_depths, tolerance)
    time = None
    if machine.removal_rate is not None:
        removed = float(np.mean(np.sum(area * rounded * share, axis=1)))
        time = removed / machine.removal_rate + machine.layer_overhead * len(feeds)
    return Schedule(
        layers=layers,
        feeds=feeds,
        cumulative_feed=cumulative,
        depths=all_depths[middle],
        depth_spread=spread,
        wear=wear,
        electrode_left=left,
        new_electrode_before=changes,
        touch_off_after=touches,
        expected_wall_error=float(np.sqrt(np.mean((all_depths - target) ** 2))),
        electrode_length_limit=limit,
        time=time,
        status=status,
        warnings=warnings + _cautions(layers, wear, machine, electrode_area, rounded),
    )


def _half_range(values: np.ndarray) -> np.ndarray:
    """Half the width of the 95 % range over equally likely cases (the first axis)."""
    return 0.5 * (_quantile(values, 0.5 + COVERED / 2) - _quantile(values, 0.5 - COVERED / 2))


def _quantile(values: np.ndarray, level: float) -> np.ndarray:
    """Quantile over equally likely cases, each standing for its share (Hazen's positions)."""
    return np.quantile(values, level, axis=0, method="hazen")


def _electrodes(
    wear: np.ndarray, wear_limit: np.ndarray, usable: float | None
) -> tuple[np.ndarray, tuple[int, ...]]:
    """Length left after every layer, and the layers before which the electrode is changed."""
    if usable is None:
        return np.sum(wear) - np.cumsum(wear), ()
    if np.max(wear_limit) > usable:
        worst = int(np.argmax(wear_limit)) + 1
        raise InputError(
            f"layer {worst} alone may wear {np.max(wear_limit):.4g} um off the electrode, more "
            f"than its usable length of {usable:g} um: take thinner layers or a longer electrode."
        )
    left, changes = np.empty_like(wear), []
    used = used_at_most = 0.0
    for n in range(len(wear)):
        if used_at_most + wear_limit[n] > usable:
            changes.append(n + 1)
            used = used_at_most = 0.0
        used += wear[n]
        used_at_most += wear_limit[n]
        left[n] = usable - used
    return left, tuple(changes)


def _touch_offs(all_depths: np.ndarray, tolerance: float) -> tuple[int, ...]:
    """Fewest layers after which to measure so that the spread since the last stays within."""
    touches, since = [], 0
    for n in range(all_depths.shape[1]):
        zero = all_depths[:, since - 1 : since] if since else 0.0
        spread = _half_range(all_depths[:, n : n + 1] - zero)[0]
        if spread > tolerance and n > since:
            touches.append(n)
            since = n
    return tuple(touches)


def _cautions(
    layers: TargetLayers,
    wear: np.ndarray,
    machine: Machine,
    electrode_area: float,
    feeds: np.ndarray,
) -> tuple[str, ...]:
    cautions = []
    radius = math.sqrt(electrode_area / math.pi)
    narrow = np.flatnonzero(np.asarray(layers.area) < electrode_area * (1 - 1e-9))
    if len(narrow):
        cautions.append(
            f"{len(narrow)} layers from layer {narrow[0] + 1} on are smaller than the electrode's "
            f"own section ({electrode_area:.4g} um^2, radius {radius:.4g} um if round), which cuts "
            "more than they ask for: stop above them or take a thinner electrode"
        )
    if machine.usable_length is None and float(np.max(feeds)) > 0:
        worn = float(np.sum(wear))
        cautions.append(
            f"no usable electrode length was given: the plan needs {worn:.4g} um of one electrode"
        )
    return tuple(cautions)
