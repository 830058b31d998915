"""Electrode and cavity wearing each other: cells per second, gradients, memory, and peers."""

import importlib.util
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import measure
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from benchmarks.zmap_peers import Case, Tool, numba_simulation, numpy_simulation
from procmodel.wear.feed_law import layer_feeds
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.path_steps import PathSteps, path_steps
from procmodel.wear.zmap import Simulated, simulate
from procmodel.wear.zmap_maps import ElectrodeMap, WorkpieceMap
from procmodel.wear.zmap_run import overhang
from procmodel.wear.zmap_wear import WearMode

# A cavity of 300 x 300 um with an electrode of 50 um.
SIZE, WAY, RATIO, FEED = 50.0, 250.0, 0.3, 2.0
FEW, MANY = 5, 50
AGREEMENT = 1e-9
NUMPY_WANTED, NUMBA_WANTED, GRADIENT_WANTED, SECONDS_WANTED = 5.0, 1.0, 8.0, 5.0
# Depth and loss are read and written, the shares of the section and of the open part are read.
BYTES = 6 * 8


class Setting(NamedTuple):
    """One cavity to cut."""

    title: str
    shape: Any = "square"
    mode: WearMode = "local"
    gap: float = 0.0
    apart: float = 40.0
    cell: float = 1.0


SETTINGS = (
    Setting("square, on the grid"),
    Setting("square, on the grid, even wear", mode="uniform"),
    Setting("square, side gap, between cells", gap=3.0, apart=41.3),
    Setting("round, side gap", "round", gap=3.0),
)
OURS_ONLY = (
    Setting("round, rotating, side gap", "round", "rotating", gap=3.0),
    Setting("square, spread, side gap", mode="spread", gap=3.0),
)


class Job(NamedTuple):
    """A cavity with its arguments."""

    setting: Setting
    steps: PathSteps
    feeds: jax.Array
    tool: ElectrodeMap
    workpiece: WorkpieceMap

    @property
    def updates(self) -> int:
        """Cells under the electrode's section and gap, over all steps."""
        return int(self.steps.counts.sum()) * self.tool.width**2

    def run(self, ratio: Any, feeds: Any, gap: Any) -> Simulated:
        mode = self.setting.mode
        return simulate(
            self.steps, feeds, self.tool, self.workpiece, ratio, side_gap=gap, wear_mode=mode,
            spread_width=SIZE / 2 if mode == "spread" else None,
        )  # fmt: skip

    @property
    def arguments(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        return jnp.asarray(RATIO), self.feeds, jnp.asarray(self.setting.gap)


def run(section: Section, sizes: Sizes) -> None:
    repeats = min(sizes.electrode_repeats, 5)
    section.text(
        f"A cavity of {WAY + SIZE:g} × {WAY + SIZE:g} µm, electrode {SIZE:g} µm, cells of 1 µm, "
        f"raster to and fro in steps of 1 µm. A cell update is one cell of the electrode's map at "
        "one step. NumPy takes whole windows, numba loops over cells; both are the same simulation "
        "written again, one thread, and find out as ours does that a layer covers what the one "
        "before covered."
    )
    _peers(section, repeats)
    _gradients(section, repeats)
    _growth(section, repeats)


def job(setting: Setting, layers: int) -> Job:
    points: list[tuple[float, float]] = []
    for number, y in enumerate(np.arange(0.0, WAY + 1e-9, setting.apart)):
        points += [(0.0, y), (WAY, y)][:: 1 if number % 2 == 0 else -1]
    path = LayerPath(np.array(points), np.ones(len(points) - 1, bool))
    steps = path_steps([path.reversed() if n % 2 else path for n in range(layers)], 1.0)
    section = ElectrodeSection(setting.shape, SIZE)
    tool = ElectrodeMap(section, setting.cell, reach=setting.gap)
    return Job(setting, steps, layer_feeds(steps, FEED), tool, WorkpieceMap.around(steps, tool))


def for_peers(work: Job) -> tuple[Tool, Case, tuple[slice, slice]]:
    """The job in the peers' arrays, and the map's own part of theirs."""
    beyond, flat = overhang(work.tool), work.workpiece
    x, y = (
        (values - origin) / flat.cell + beyond
        for values, origin in zip((work.steps.x, work.steps.y), flat.origin, strict=True)
    )
    case = Case(
        x, y, np.asarray(work.feeds), work.steps.valid,
        np.pad(np.asarray(flat.depth), beyond, mode="edge"), RATIO,
        even=work.setting.mode == "uniform",
    )  # fmt: skip
    tool = Tool(np.asarray(work.tool.covered(work.setting.gap)), work.tool.own, work.tool.nearest)
    return tool, case, np.s_[beyond:-beyond, beyond:-beyond]


def _forward(work: Job) -> Callable[[], np.ndarray]:
    compiled = jax.jit(lambda *arguments: work.run(*arguments).depth)
    return lambda: np.asarray(compiled(*work.arguments))


def _mean_square(work: Job) -> Callable[..., jax.Array]:
    return lambda *arguments: jnp.mean(work.run(*arguments).depth ** 2)


def _gradient(work: Job) -> Callable[[], Any]:
    """The gradient with respect to wear ratio, every feed and gap."""
    compiled = jax.jit(jax.grad(_mean_square(work), (0, 1, 2)))
    return lambda: jax.block_until_ready(compiled(*work.arguments))


def _peer(
    simulation: Callable[[Tool, Case], tuple[np.ndarray, np.ndarray]], work: Job
) -> Callable[[], np.ndarray]:
    tool, case, part = for_peers(work)
    return lambda: simulation(tool, case)[0][part]


def _peers(section: Section, repeats: int) -> None:
    section.heading(f"forward, {FEW} layers, cell updates per second")
    rows = []
    with_numba = importlib.util.find_spec("numba") is not None
    in_loops = numba_simulation() if with_numba else None
    for setting in SETTINGS:
        work = job(setting, FEW)
        calls = {"ours": _forward(work), "NumPy": _peer(numpy_simulation, work)}
        if in_loops is not None:
            calls["numba"] = _peer(in_loops, work)
        turns = measure.interleaved(calls, repeats)
        for name in calls:
            seconds = turns.seconds[name]
            off = float(np.max(np.abs(turns.outcomes[name] - turns.outcomes["ours"])))
            rows.append(
                [setting.title, name, measure.time_spread(seconds),
                 f"{work.updates / np.median(seconds) / 1e6:.0f} M/s",
                 measure.ratio(seconds, turns.seconds["ours"]), f"{off:.1e}"]
            )  # fmt: skip
            if name != "ours":
                ratio = float(np.median(seconds / turns.seconds["ours"]))
                wanted = NUMPY_WANTED if name == "NumPy" else NUMBA_WANTED
                section.target(
                    f"z-map, {setting.title}, {name}", f"{wanted:g} × ours", f"{ratio:.3g} ×",
                    ratio >= wanted,
                )  # fmt: skip
                section.target(
                    f"z-map, {setting.title}, {name}: same depths", f"within {AGREEMENT:g} µm",
                    f"{off:.1e} µm", off <= AGREEMENT,
                )  # fmt: skip
    section.table(
        ["cavity", "contestant", "time", "cell updates", "time / ours", "greatest difference [µm]"],
        rows,
    )
    if not with_numba:
        section.text("numba is not installed: that column is missing.")


def _gradients(section: Section, repeats: int) -> None:
    section.heading(f"with reverse gradient, {FEW} layers: wear ratio, every feed, side gap")
    rows = []
    for setting in (*SETTINGS, *OURS_ONLY):
        work = job(setting, FEW)
        turns = measure.interleaved(
            {"forward": _forward(work), "gradient": _gradient(work)}, repeats
        )
        forward, gradient = turns.seconds["forward"], turns.seconds["gradient"]
        ratio = float(np.median(gradient / forward))
        rows.append(
            [setting.title, measure.time_spread(forward), measure.time_spread(gradient),
             f"{work.updates / np.median(gradient) / 1e6:.0f} M/s", f"{ratio:.3g}"]
        )  # fmt: skip
        section.target(
            f"z-map gradient, {setting.title}", f"at most {GRADIENT_WANTED:g} × forward",
            f"{ratio:.3g} ×", ratio <= GRADIENT_WANTED,
        )  # fmt: skip
    section.table(["cavity", "forward", "gradient", "cell updates", "gradient / forward"], rows)
    section.text(
        "The peers have no gradient: central differences take two runs for every number, "
        f"{2 * (FEW + 2)} for the feed of every layer, the wear ratio and the gap of these."
    )


def _growth(section: Section, repeats: int) -> None:
    section.heading("growth with layers and cells, memory, and bandwidth")
    small, tall = job(SETTINGS[0], FEW), job(SETTINGS[0], MANY)
    coarse = job(Setting("coarse", cell=SIZE / 16), FEW)
    works = {f"{FEW} layers": small, f"{MANY} layers": tall, "a tenth of the cells": coarse}
    seconds = measure.interleaved({n: _forward(w) for n, w in works.items()}, repeats).seconds
    memory, maps = _memory(), _memory(2**17)
    rows = []
    for name, work in works.items():
        rate = work.updates / np.median(seconds[name])
        lowered = jax.jit(jax.grad(_mean_square(work), (0, 1, 2))).lower(*work.arguments)
        kept = lowered.compile().memory_analysis()
        rows.append(
            [name, f"{work.updates:,}", measure.time_spread(seconds[name]), f"{rate / 1e6:.0f} M/s",
             f"{BYTES * rate / memory:.0%}", f"{BYTES * rate / maps:.0%}",
             f"{kept.temp_size_in_bytes / 2**20:.0f} MiB" if kept else "unknown"]
        )  # fmt: skip
    section.table(
        ["cavity", "cell updates", "forward", "per second", "of memory's bandwidth",
         "of bandwidth in cache", "kept for the gradient"],
        rows,
    )  # fmt: skip
    every = int(tall.steps.counts.sum()) * tall.workpiece.depth.size * 8 / 2**20
    section.text(
        f"{BYTES} bytes are touched per cell update. Bandwidth: a triad in NumPy in the same run, "
        f"{memory / 1e9:.1f} GB/s from memory, {maps / 1e9:.1f} GB/s on arrays of 1 MiB. The "
        "window stays in the cache from step to step, so that more than memory's is possible. To "
        f"keep the map of every step of the {MANY} layers would take {every:,.0f} MiB."
    )
    median = float(np.median(seconds[f"{MANY} layers"]))
    section.target(
        f"z-map, {MANY} layers", f"at most {SECONDS_WANTED:g} s", f"{median:.2f} s",
        median <= SECONDS_WANTED,
    )  # fmt: skip
    growth = float(np.median(seconds[f"{MANY} layers"] / seconds[f"{FEW} layers"]))
    section.target(
        "z-map, ten times the layers", "at most 12 × the time", f"{growth:.3g} ×", growth <= 12.0
    )


def _memory(count: int = 2**23) -> float:
    """Bytes per second of a triad on arrays of so many numbers."""
    one, other, out = np.ones(count), np.ones(count), np.empty(count)

    def triad() -> None:
        np.multiply(other, 1.5, out=out)
        np.add(out, one, out=out)

    turns = measure.interleaved({"triad": triad}, 5)
    # Read and written twice each, and one more read.
    return 5 * 8 * count / float(np.min(turns.seconds["triad"]))
