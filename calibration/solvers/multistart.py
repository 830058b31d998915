"""`multistart`: the fit from many starts, and whether its optimum can be trusted to be the best.

All starts are solved in one compiled loop. The sorted costs, with the number of starts that ended
in each distinct optimum, are the waterfall; an optimum that only one start reached is a sign that
there may be a better one.

References
----------
.. [1] A. Raue et al., "Lessons learned from quantitative dynamical modeling in systems biology",
   PLoS ONE 8(9), 2013 (waterfall).
.. [2] I. M. Sobol', "On the distribution of points in a cube", 1967; scrambling by A. B. Owen.
"""

import copy
import dataclasses
import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax import Array
from scipy.stats import qmc

from calibration.black_box import failures_explained
from calibration.fitting import first_noise_levels, fit
from calibration.priors import Prior
from calibration.problem import Problem
from calibration.progress import ProgressOption, reporting
from calibration.result import FitResult
from calibration.solvers import box_lm
from calibration.structure import ProblemStructure
from calibration.text import aligned, sections
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

# Two ends are the same optimum when twice their cost differs by less than this, in units of the
# noise variance.
_SAME = 1e-3
# Ends of one optimum whose values differ by more than this of the range drawn from are remarked.
_ELSEWHERE = 1e-2
# Share of a prior on either side that starts leave out, and draws to find that from.
_PRIOR_TAIL, _PRIOR_DRAWS = 2e-3, 4096
_ROWS = 12


@dataclass(frozen=True)
class Multistart:
    """Outcome of `multistart`. All arrays are sorted by cost, the best first.

    Attributes
    ----------
    best : FitResult
        The fit from the best end, as `calibration.fit` returns it.
    names : tuple of str
        The free parameters, in the order of the columns.
    numbers : ndarray of int, shape (k,)
        Number of each start; 1 is the problem's own.
    starts, values : ndarray, shape (k, p)
        Where each began and ended, natural values.
    costs : ndarray, shape (k,)
        Cost of each end; infinite where the model was not finite.
    optimum : ndarray of int, shape (k,)
        Number of the distinct optimum, 1 the best; 0 where the solver did not converge.
    statuses : tuple of str
        Why each stopped.
    steps : ndarray of int, shape (k,)
        Steps of each.
    status : str
        What came of it, as a sentence.
    warnings : tuple of str
        What the user should know before trusting the best.
    """

    best: FitResult
    names: tuple[str, ...]
    numbers: np.ndarray
    starts: np.ndarray
    values: np.ndarray
    costs: np.ndarray
    optimum: np.ndarray
    statuses: tuple[str, ...]
    steps: np.ndarray
    status: str
    warnings: tuple[str, ...] = ()

    @property
    def optima(self) -> int:
        """Number of distinct optima met."""
        return int(np.max(self.optimum, initial=0))

    @property
    def share(self) -> float:
        """Share of the starts that reached the best optimum."""
        return float(np.mean(self.optimum == 1))

    def report(self) -> str:
        """The waterfall as text: one line for each optimum, then what else happened.

        Returns
        -------
        str
            Several lines.
        """
        lines = [f"multistart of {self.best.problem.name}, {len(self.costs)} starts"]
        lines += [f"status  {self.status}", ""]
        table = [["optimum", "starts", "cost", "above best", *self.names, "status"]]
        lowest = float(self.costs[0])
        for number in range(1, min(self.optima, _ROWS) + 1):
            members = np.flatnonzero(self.optimum == number)
            table.append([str(number), *self._cells(members, lowest)])
        kinds = [s for i, s in enumerate(self.statuses) if self.optimum[i] == 0]
        for kind in dict.fromkeys(kinds):
            members = np.array(
                [i for i, s in enumerate(self.statuses) if s == kind and self.optimum[i] == 0]
            )
            table.append(["-", *self._cells(members, lowest)])
        lines += aligned(table)
        if self.optima > _ROWS:
            lines.append(f"and {self.optima - _ROWS} optima more")
        return "\n".join([*lines, *sections([("warnings", self.warnings)])])

    def _cells(self, members: np.ndarray, lowest: float) -> list[str]:
        """Count, cost, values and status of the best of some ends."""
        first = members[0]
        cost = self.costs[first]
        if not np.isfinite(cost):
            return [str(len(members)), "-", "-", *("-" for _ in self.names), self.statuses[first]]
        values = [f"{value:.5g}" for value in self.values[first]]
        rise = f"{cost - lowest:.3g}"
        return [str(len(members)), f"{cost:.6g}", rise, *values, self.statuses[first]]

    def as_dict(self) -> dict[str, Any]:
        """The result as plain JSON types; the keys are part of the interface."""
        return {
            "best": self.best.as_dict(),
            "names": list(self.names),
            "numbers": self.numbers.tolist(),
            "starts": self.starts.tolist(),
            "values": [[v if math.isfinite(v) else None for v in row] for row in self.values],
            "costs": [c if math.isfinite(c) else None for c in self.costs.tolist()],
            "optimum": self.optimum.tolist(),
            "statuses": list(self.statuses),
            "share": self.share,
            "status": self.status,
            "warnings": list(self.warnings),
        }


def multistart(
    problem: Problem,
    starts: int = 32,
    seed: int = 0,
    *,
    spread: float = 10.0,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    progress: ProgressOption = None,
    **options: Any,
) -> Multistart:
    """Fit from many starts and keep the best.

    Parameters
    ----------
    problem : Problem
        Model, parameters and readings. Its own start is the first.
    starts : int
        How many, at least 2.
    seed : int
        Same seed, same starts; more starts continue the sequence of fewer.
    spread : float
        Where a bound is infinite and there is no prior: a factor up and down for a log transform,
        else this many times the distance from the finite bound, or the size of the start value.
    ranges : mapping of str to (float, float), optional
        Natural values to draw a parameter between instead.
    progress : bool or callable, optional
        True for a bar on stderr, or a function of (stage, done, total).
    **options
        Settings of `calibration.solvers.box_lm`, such as ``max_steps``.

    Returns
    -------
    Multistart
        The best fit and the waterfall. Starts where the model is not finite are counted; if all
        are, the status says so.

    Raises
    ------
    InputError
        If a count, range or option cannot be used, or `calibration.fit` refuses the problem.
    RuntimeError
        If JAX makes 32-bit floats.

    Notes
    -----
    Starts are scrambled Sobol' points in the solver's coordinates, so a log transform spreads them
    over decades. Noise levels that are not known are taken as the spread of each data set for
    ranking the ends; the fit from the best one then finds them. With a single data set without
    priors they do not matter.
    """
    require_float64("A multistart fit")
    if starts < 2 or seed < 0 or not spread > 1.0:
        raise InputError("starts must be at least 2, the seed not below 0 and spread above 1.")
    settings = _settings(options)
    vectors = np.vstack([problem.start, draw_starts(problem, starts - 1, seed, spread, ranges)])
    lower, upper = problem.layout.internal_bounds()
    arguments = (problem.fixed_values, problem.data(first_noise_levels(problem)))
    with reporting(progress) as told, failures_explained(problem.structure.functions):
        told.compiling("starts")
        solved = _solve_all(problem.structure, vectors, lower, upper, arguments, settings)
        ends, costs, codes, steps = (np.asarray(part) for part in solved)
        told.running("starts", starts, starts)
    costs = np.where((codes == box_lm.BAD_START) | ~np.isfinite(costs), np.inf, costs)
    order = np.argsort(costs, kind="stable")
    found = _Ends(problem, vectors[order], ends[order], costs[order], codes[order], order + 1)
    best = _fit_from(problem, found, options)
    return found.result(best, steps[order])


def started_at(problem: Problem, vector: np.ndarray) -> Problem:
    """The same problem with its start moved.

    Parameters
    ----------
    problem : Problem
        The problem.
    vector : ndarray, shape (p,)
        Internal coordinates of the new start.

    Returns
    -------
    Problem
        It shares the data and what was compiled.
    """
    layout, values = problem.layout, problem.layout.free_values(vector)
    parameters = dict(problem.parameters)
    for i, (name, value, (low, high)) in enumerate(
        zip(layout.free, values, layout.bounds, strict=True)
    ):
        if layout.transforms[i] != "identity":
            # The ends of a transform's own range are no start; nor is what rounds to them.
            low, high = np.nextafter(low, math.inf), np.nextafter(high, -math.inf)
        inside = min(max(float(value), float(low)), float(high))
        parameters[name] = dataclasses.replace(parameters[name], value=inside)
    moved = copy.copy(problem)
    moved.parameters = parameters
    return moved


@functools.partial(jax.jit, static_argnames=("structure", "options"))
def _solve_all(
    structure: ProblemStructure,
    starts: Array,
    lower: Array,
    upper: Array,
    arguments: Any,
    options: box_lm.BoxLMOptions,
) -> tuple[Array, Array, Array, Array]:
    def from_one(start: Array) -> tuple[Array, Array, Array, Array]:
        end = box_lm.solve(structure, start, lower, upper, arguments, options)
        return end.vector, structure.cost(end.vector, arguments), end.status, end.steps

    return jax.lax.map(from_one, starts)


@dataclass(frozen=True)
class _Ends:
    """Where all starts ended, sorted by cost; vectors are internal."""

    problem: Problem
    starts: np.ndarray
    vectors: np.ndarray
    costs: np.ndarray
    codes: np.ndarray
    numbers: np.ndarray

    @property
    def finite(self) -> np.ndarray:
        return np.isfinite(self.costs)

    @functools.cached_property
    def optimum(self) -> np.ndarray:
        """Number of the distinct optimum of each end; 0 without convergence."""
        converged = np.isin(self.codes, box_lm.CONVERGED) & self.finite
        clusters, number, first = np.zeros(len(self.costs), int), 0, -np.inf
        for i in np.flatnonzero(converged):
            if 2.0 * (self.costs[i] - first) > self._same_within:
                number, first = number + 1, self.costs[i]
            clusters[i] = number
        return clusters

    @property
    def _same_within(self) -> float:
        """Difference of twice the cost below which two ends are the same optimum."""
        lowest = float(self.costs[0])
        unit = 1.0
        if not self.problem.noise_known and self.problem.structure.least_squares:
            unit = 2.0 * abs(lowest) / max(self.problem.size - len(self.problem.layout.free), 1)
        # A perfect fit leaves no noise to compare with: rounding of the readings is the least.
        square = sum(float(np.sum((d[1] * d[2]) ** 2)) for d in self.problem.data())
        return max(_SAME * unit, 1e-9 * abs(lowest), 1e-20 * square)

    def result(self, best: FitResult, steps: np.ndarray) -> Multistart:
        natural = self.problem.layout.free_values
        return Multistart(
            best=best,
            names=self.problem.layout.free,
            numbers=self.numbers,
            starts=np.array([natural(v) for v in self.starts]),
            values=np.array([natural(v) for v in self.vectors]),
            costs=self.costs,
            optimum=self.optimum,
            statuses=tuple(box_lm.STATUS[int(code)] for code in self.codes),
            steps=steps,
            status=self._status(),
            warnings=self._warnings(best),
        )

    def _status(self) -> str:
        count, finite = len(self.costs), int(np.sum(self.finite))
        if finite == 0:
            return (
                f"failed: the model or its derivative is not finite at any of {count} starts; "
                "check the model, or draw nearer with ranges or spread"
            )
        reached, optima = int(np.sum(self.optimum == 1)), int(np.max(self.optimum))
        if optima == 0:
            return f"not converged: none of {count} starts came to an optimum; raise max_steps"
        return (
            f"converged: {reached} of {count} starts reached the best of {optima} "
            f"{'optima' if optima > 1 else 'optimum'}"
        )

    def _warnings(self, best: FitResult) -> tuple[str, ...]:
        warnings = []
        bad = np.sort(self.numbers[~self.finite])
        if 0 < len(bad) < len(self.costs):
            named = ", ".join(str(number) for number in bad[:8]) + (" ..." if len(bad) > 8 else "")
            warnings.append(
                f"the model or its derivative was not finite at {len(bad)} of {len(self.costs)} "
                f"starts (number {named})"
            )
        stopped = int(np.sum(self.finite & (self.optimum == 0)))
        if stopped:
            warnings.append(f"{stopped} starts stopped before they came to an optimum")
        members = np.flatnonzero(self.optimum == 1)
        if len(members) == 1:
            warnings.append(
                "the best optimum was found only once, so that there may be a better one: "
                f"raise starts to {4 * len(self.costs)}"
            )
        if len(members) and self.optimum[0] == 0:
            warnings.append("the lowest cost belongs to a start that did not converge")
        warnings += self._elsewhere(members)
        if np.any(self.finite) and not best.converged:
            warnings.append(f"the fit from the best end did not converge ({best.status})")
        return tuple(warnings)

    def _elsewhere(self, members: np.ndarray) -> list[str]:
        """A sentence when the best cost is reached at values that differ."""
        if len(members) < 2:
            return []
        extent = np.ptp(self.starts, axis=0)
        apart = np.ptp(self.vectors[members], axis=0) > _ELSEWHERE * extent
        names = [n for n, a in zip(self.problem.layout.free, apart, strict=True) if a]
        if not names:
            return []
        return [
            f"the best optimum is reached with different values of {', '.join(names)}: the data "
            "leave them open, or parameters can change places"
        ]


def _settings(options: dict[str, Any]) -> box_lm.BoxLMOptions:
    known = tuple(f.name for f in dataclasses.fields(box_lm.BoxLMOptions))
    for option in options:
        if option not in known:
            raise InputError(f"multistart has no option {option!r}{nearest(option, known)}.")
    return box_lm.BoxLMOptions(**options)


def _fit_from(problem: Problem, ends: _Ends, options: dict[str, Any]) -> FitResult:
    """`fit` from the best end; from the problem's own start where no end is finite."""
    start = started_at(problem, ends.vectors[0]) if ends.finite[0] else problem
    return dataclasses.replace(fit(start, **options), problem=problem)


def draw_starts(
    problem: Problem,
    count: int,
    seed: int = 0,
    spread: float = 10.0,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> np.ndarray:
    """Scrambled Sobol' points between the ends of each free parameter's range.

    Parameters
    ----------
    problem : Problem
        Gives bounds, priors and start values.
    count : int
        How many.
    seed, spread, ranges
        As for `multistart`.

    Returns
    -------
    ndarray, shape (count, p)
        Internal coordinates.
    """
    layout, ranges = problem.layout, ranges or {}
    for name in ranges:
        if name not in layout.free:
            raise InputError(f"ranges names {name!r}, not free{nearest(name, layout.free)}.")
    sobol = qmc.Sobol(len(layout.free), scramble=True, rng=np.random.default_rng(seed))
    # Whole powers of 2 are what the sequence is made in; the first of them serve as well.
    shares = sobol.random_base2(max(count - 1, 1).bit_length())[:count]
    lower, upper = layout.internal_bounds()
    low, high = np.zeros(len(layout.free)), np.zeros(len(layout.free))
    for i, name in enumerate(layout.free):
        between = (float(lower[i]), float(upper[i]))
        low[i], high[i] = _range(problem, name, between, spread, ranges.get(name))
    return low + shares * (high - low)


def _range(
    problem: Problem,
    name: str,
    between: tuple[float, float],
    spread: float,
    wanted: tuple[float, float] | None,
) -> tuple[float, float]:
    """Internal values to draw a parameter between, inside its internal bounds."""
    layout, parameter = problem.layout, problem.parameters[name]
    index = layout.free.index(name)

    def internal(value: float) -> float:
        values = np.array([problem.parameters[n].value for n in layout.free])
        values[index] = value
        return float(layout.internal(values)[index])

    natural_low, natural_high = layout.bounds[index]
    if wanted is not None:
        low, high = (float(w) for w in wanted)
        inside = natural_low <= low < high <= natural_high and math.isfinite(high - low)
        if not inside or (parameter.transform == "log" and low <= 0):
            raise InputError(
                f"range ({low:g}, {high:g}) of {name!r} must be finite, low < high, inside its "
                f"bounds ({natural_low:g}, {natural_high:g})"
                + (" and above 0." if parameter.transform == "log" else ".")
            )
        if parameter.transform == "logit":
            margin = 1e-9 * (natural_high - natural_low)
            low, high = max(low, natural_low + margin), min(high, natural_high - margin)
        return internal(low), internal(high)
    if all(math.isfinite(b) for b in between):
        return between
    if parameter.transform == "logit":
        # Uniform over most of the range in the logarithm of the odds: 1 to 99 per cent.
        return -math.log(99.0), math.log(99.0)
    of_prior = _prior_range(parameter.prior)
    if of_prior is not None:
        low, high = max(of_prior[0], natural_low), min(of_prior[1], natural_high)
        if low < high and (parameter.transform != "log" or low > 0):
            return internal(low), internal(high)
    centre = internal(parameter.value)
    if parameter.transform == "log":
        reach = math.log(spread)
    else:
        distances = [abs(centre - b) for b in between if math.isfinite(b) and b != centre]
        reach = spread * (min(distances, default=0.0) or abs(centre) or 1.0)
    return max(centre - reach, between[0]), min(centre + reach, between[1])


def _prior_range(prior: Prior | None) -> tuple[float, float] | None:
    """Natural values that nearly all of a prior lies between; None where it cannot be drawn."""
    if prior is None or not prior.informs:
        return None
    try:
        draws = prior.draw(np.random.default_rng(0), _PRIOR_DRAWS)
    except InputError:
        return None
    low, high = np.quantile(draws, [_PRIOR_TAIL, 1.0 - _PRIOR_TAIL])
    return float(low), float(high)
