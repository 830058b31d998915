"""Which layer depth to plan with: stairs against time and electrode."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from calibration.plans.schedule import Schedule, Trade
from procmodel.errors import InputError
from procmodel.wear import Solid, TargetLayers, slice_solid


@dataclass(frozen=True)
class LayerDepthOption:
    """One layer depth with its plan.

    Attributes
    ----------
    layer_depth : float [um]
        Depth of a layer.
    layers : TargetLayers
        The cavity in such layers.
    schedule : Schedule
        The plan.
    stair_error : float [um]
        Root mean square depth of the stairs between the corners and a straight wall.
    cost : float [um^2]
        Mean square of both errors plus the price of time and electrode.
    """

    layer_depth: float
    layers: TargetLayers
    schedule: Schedule
    stair_error: float
    cost: float


def compare_layer_depths(
    solid: Solid,
    layer_depths: Sequence[float],
    plan: Callable[[TargetLayers], Schedule],
    trade: Trade,
    depth: float | None = None,
    level: str = "paper",
) -> list[LayerDepthOption]:
    """Plan the same solid in layers of several depths.

    Parameters
    ----------
    solid : Solid
        The wanted cavity.
    layer_depths : sequence of float [um]
        Layer depths to try.
    plan : callable
        Makes the schedule of given layers.
    trade : Trade
        What wall error is worth.
    depth : float, optional [um]
        Depth of the cavity.
    level : {"paper", "top", "middle", "bottom"}
        See `procmodel.wear.slice_solid`.

    Returns
    -------
    list of LayerDepthOption
        Cheapest first.

    Raises
    ------
    InputError
        If no layer depth is given, or a price of time without a predicted time.
    """
    if not layer_depths:
        raise InputError("no layer depth was given to compare: name at least one.")
    options = []
    for layer_depth in layer_depths:
        layers = slice_solid(solid, layer_depth, depth, level)
        schedule = plan(layers)
        if trade.per_minute > 0 and schedule.time is None:
            raise InputError("a trade per minute needs the removal rate: give it, or drop it.")
        # A stair is as deep as the layer; its depth is uniform in between, hence the third.
        stair = layer_depth**2 / 3.0
        cost = schedule.expected_wall_error**2 + stair
        cost += trade.per_minute * (schedule.time or 0.0) / 60.0
        cost += trade.per_length * schedule.electrode_length
        options.append(LayerDepthOption(layer_depth, layers, schedule, stair**0.5, cost))
    return sorted(options, key=lambda option: option.cost)
