"""Feed schedules: exact and optimised, beside what scipy makes of the same cost."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks import measure, peers
from benchmarks.cases import depths_case
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from calibration import FitResult, fit
from calibration.plans.belief import believed_values
from calibration.plans.schedule import Machine, exact_schedule, optimised_schedule
from procmodel.wear import TargetLayers, pyramid, slice_solid

DEPTH = 250.0
WEAR_RATIO = 0.3
# A finer axis than any layer, so that nobody is held by it.
MACHINE = Machine(resolution=0.01)
# Share of the greatest exact feed that a layer may be fed: about half the layers are held.
LIMIT = 0.4
# A cost this close to the least found counts as reached.
REACHED = 1e-6
# SLSQP's dense updates and finite differences take it tens of seconds beyond this many numbers
# (feeds times believed wear ratios), so it is left out there.
MOST_FOR_SLSQP = 125


@dataclass(frozen=True)
class _Plan:
    """One wanted cavity with what is believed of the wear ratio."""

    title: str
    layers: TargetLayers
    wear_ratio: float | FitResult

    @property
    def exact(self) -> np.ndarray:
        thickness, area = np.asarray(self.layers.thickness), np.asarray(self.layers.area)
        return peers.exact_feeds(thickness, area, self.middle)

    @property
    def believed(self) -> np.ndarray:
        return believed_values(self.wear_ratio, "wear_ratio")

    @property
    def middle(self) -> float:
        return float(self.believed[len(self.believed) // 2])

    @property
    def bounds(self) -> tuple[float, float]:
        # A whole number of steps of the feed axis, to which the plan would take it.
        step = MACHINE.resolution
        return step, step * math.floor(LIMIT * float(np.max(self.exact)) / step)

    def problem(self) -> peers.PlanProblem:
        bottom, area = np.asarray(self.layers.bottom), np.asarray(self.layers.area)
        return peers.PlanProblem(bottom, area, self.believed, self.bounds, self.exact)

    def ours(self) -> np.ndarray:
        plan = optimised_schedule(
            self.layers, self.wear_ratio, peers.ELECTRODE_AREA, MACHINE, feed_bounds=self.bounds
        )
        return plan.feeds


def run(section: Section, sizes: Sizes) -> None:
    section.text(
        "Pyramid of 45°, half width 250 µm, round electrode of 100 µm diameter, wear ratio 0.3. "
        "The optimised feeds minimise the mean square wall error with every feed at most "
        f"{100 * LIMIT:.0f} % of the greatest exact one. scipy gets a NumPy cost without gradient "
        "(minimize) or the matrix of the linear least-squares problem (lsq_linear). Ours includes "
        "everything else the schedule says: rounding, spread, electrode changes, touch-offs."
    )
    fitted = fit(depths_case().problem(depths_case().readings(1)))
    for count in sizes.plan_layers:
        layers = slice_solid(pyramid(DEPTH, math.pi / 4), DEPTH / count)
        _exact(section, layers, sizes.plan_repeats)
        _optimised(section, _Plan(f"{count} layers, known wear ratio", layers, WEAR_RATIO), sizes)
    layers = slice_solid(pyramid(DEPTH, math.pi / 4), DEPTH / sizes.plan_layers[0])
    plan = _Plan(f"{sizes.plan_layers[0]} layers, fitted wear ratio", layers, fitted)
    _optimised(section, plan, sizes)


def _exact(section: Section, layers: TargetLayers, repeats: int) -> None:
    thickness, area = np.asarray(layers.thickness), np.asarray(layers.area)
    calls: dict[str, Callable[[], object]] = {
        "ours": lambda: exact_schedule(layers, WEAR_RATIO, peers.ELECTRODE_AREA, MACHINE),
        "one line of NumPy": lambda: peers.exact_feeds(thickness, area, WEAR_RATIO),
    }
    feeds = exact_schedule(layers, WEAR_RATIO, peers.ELECTRODE_AREA, MACHINE).feeds
    worst = float(np.max(np.abs(feeds / peers.exact_feeds(thickness, area, WEAR_RATIO) - 1.0)))
    seconds = measure.interleaved(calls, repeats).seconds
    section.heading(f"{len(thickness)} layers, exact")
    section.text(
        f"Ours {measure.time_spread(seconds['ours'])}; one line of NumPy, which gives the feeds "
        f"and nothing else, {measure.time_spread(seconds['one line of NumPy'])}. Greatest relative "
        f"difference of a feed {worst:.1e}."
    )


def _optimised(section: Section, plan: _Plan, sizes: Sizes) -> None:
    problem = plan.problem()
    calls: dict[str, Callable[[], np.ndarray]] = {
        "ours": plan.ours,
        "lsq_linear": problem.lsq_linear,
        "minimize, L-BFGS-B": lambda: problem.minimize("L-BFGS-B"),
    }
    slsqp = problem.share.size <= MOST_FOR_SLSQP
    if slsqp:
        calls["minimize, SLSQP"] = lambda: problem.minimize("SLSQP")
    first, _ = measure.first_call(plan.ours)
    turns = measure.interleaved(calls, sizes.plan_repeats)
    seconds, feeds = turns.seconds, turns.outcomes
    costs = {name: problem.cost(found) for name, found in feeds.items()}
    least = min(costs.values())
    held = int(np.sum(feeds["ours"] >= plan.bounds[1] * (1 - 1e-9)))
    section.heading(f"{plan.title}, optimised")
    section.table(
        ["contestant", "time", "time / ours", "cost reached [µm²]", "above the least by"],
        [
            [
                name,
                measure.time_spread(seconds[name]),
                measure.ratio(seconds[name], seconds["ours"]),
                f"{costs[name]:.9g}",
                f"{costs[name] / least - 1.0:.1e}",
            ]
            for name in calls
        ],
    )
    section.text(
        f"Values of the wear ratio that the cost averages over: {len(plan.believed)}. Layers held "
        f"at the greatest feed: {held}. First call of ours, nothing compiled: {first:.2f} s."
    )
    if not slsqp:
        section.text("SLSQP is left out at this size, where it takes tens of seconds.")
    section.target(
        f"cost of the optimised schedule, {plan.title}",
        f"within a share of {REACHED:g} of the least found",
        f"above it by {costs['ours'] / least - 1.0:.1e}",
        costs["ours"] <= least * (1.0 + REACHED),
    )
