"""Paths and simulations that several tests of the z-map share."""

import numpy as np

from benchmarks.zmap_peers import Case, Tool
from procmodel.wear.feed_law import layer_feeds
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.path_steps import path_steps
from procmodel.wear.zmap import simulate
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap
from procmodel.wear.zmap_run import overhang

MODES = [
    ("square", "local"), ("round", "local"), ("square", "spread"), ("round", "rotating"),
    ("square", "uniform"),
]  # fmt: skip


def whole(points, turns=0):
    """A path that cuts all the way."""
    points = np.array(points, float)
    return LayerPath(points, np.ones(len(points) - 1, bool), turns)


def raster(width, apart, layers, to_and_fro=True):
    """Lines along x, to and fro; the layers run the same way forwards and backwards."""
    points = []
    for number, y in enumerate(np.arange(0.0, width + 1e-9, apart)):
        points += [(0.0, y), (width, y)][:: 1 if number % 2 == 0 else -1]
    path = whole(points)
    return [path.reversed() if to_and_fro and n % 2 else path for n in range(layers)]


def electrode(shape="square", size=10.0, cell=1.0, **more):
    return ElectrodeMap(ElectrodeSection(shape, size), cell, **more)


def width_of(mode, width=3.0):
    return width if mode == "spread" else None


def cut(paths, tool, feed=1.0, ratio=0.2, step=1.0, mode="local", width=3.0, **more):
    """A simulation with a feed per layer on a flat workpiece."""
    steps = path_steps(paths, step)
    workpiece = WorkpieceMap.around(steps, tool)
    return simulate(
        steps, layer_feeds(steps, feed), tool, workpiece, ratio,
        wear_mode=mode, spread_width=width_of(mode, width), **more,
    )  # fmt: skip


def as_peers_have_it(steps, feeds, tool, workpiece, gap, **more):
    """The same for the simulators that take plain arrays, and the map's own part of theirs."""
    beyond = overhang(tool)
    x, y = (
        (values - origin) / workpiece.cell + beyond
        for values, origin in zip((steps.x, steps.y), workpiece.origin, strict=True)
    )
    depth = np.pad(np.asarray(workpiece.depth), beyond, mode="edge")
    case = Case(x, y, np.asarray(feeds), steps.valid, depth, **more)
    arrays = Tool(np.asarray(tool.covered(gap)), tool.own, tool.nearest)
    return arrays, case, np.s_[beyond:-beyond, beyond:-beyond]
