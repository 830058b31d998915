"""The walk along one side of a profile: hold a parameter, fit the others, find where it ends.

The root of twice the rise in cost is nearly straight in the distance from the optimum, so a
bracketed search finds the threshold in a few fits. Each fit starts from its neighbours.

References
----------
.. [1] T. R. Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a
   nonlinear function without using derivatives", Adv. Eng. Software 28, 145-149, 1997.
"""

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.solvers import box_lm
from calibration.solvers.outcome import cost_at
from calibration.structure import ProblemStructure

# The end is where the root meets the threshold to this share of it.
_TOLERANCE = 1e-6
_MOST_FITS = 80
# Most that one step of the search may multiply the distance by.
_GROWTH = 8.0
# Twice the cost must fall by this much to be another optimum and not rounding.
_LOWER = 1e-3
# Shares of the way to the end that are fitted too: for the curve, and to meet what lies between.
_BETWEEN = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Lower:
    """A vector with a lower cost than the optimum that the profile started from."""

    vector: np.ndarray
    cost: float


@dataclass(frozen=True)
class Point:
    """The best fit with one parameter held.

    Attributes
    ----------
    distance : float
        Of the held parameter from the optimum, internal coordinate, >= 0.
    root : float
        Root of twice the rise in cost; NaN where the model is not finite.
    vector : ndarray, shape (p,)
        The fit.
    cost : float
        Its cost.
    status : int
        Key into `box_lm.STATUS`.
    """

    distance: float
    root: float
    vector: np.ndarray
    cost: float
    status: int

    @property
    def converged(self) -> bool:
        """Whether the others are at their best."""
        return self.status in box_lm.CONVERGED

    @property
    def finite(self) -> bool:
        """Whether the model could be evaluated."""
        return self.status != box_lm.BAD_START and bool(np.isfinite(self.root))


@dataclass(frozen=True)
class Side:
    """How the walk to one side ended.

    Attributes
    ----------
    status : str
        "closed", "at bound", "open" or "failed".
    reason : str
        Half a sentence, where there is something to explain.
    vector : ndarray, shape (p,)
        Where it ended.
    points : tuple of Point
        All finite points met, without the optimum.
    lower : Lower or None
        A place with a lower cost than the optimum, if one was met.
    """

    status: str
    reason: str
    vector: np.ndarray
    points: tuple[Point, ...]
    lower: Lower | None = None


@dataclass(frozen=True)
class Neighbourhood:
    """The cost of a problem around its optimum.

    Attributes
    ----------
    structure : ProblemStructure
        What is minimised.
    vector : ndarray, shape (p,)
        The optimum, internal coordinates.
    cost : float
        Cost there.
    bounds : (ndarray, ndarray)
        Lower and upper bounds of the vector.
    arguments : pytree
        Fixed values and data of the structure.
    fitted_cost : float
        Cost of the fit handed in, before it was made sure of.
    lower : Lower or None
        The optimum, where it is well below the fit handed in.
    """

    structure: ProblemStructure
    vector: np.ndarray
    cost: float
    bounds: tuple[np.ndarray, np.ndarray]
    arguments: Any
    fitted_cost: float
    lower: Lower | None = None

    @classmethod
    def around(
        cls,
        structure: ProblemStructure,
        vector: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        arguments: Any,
    ) -> "Neighbourhood":
        """The neighbourhood of a fit, which another solver may have left a little short."""
        vector = np.asarray(vector, float)
        cost = float(cost_at(structure, vector, arguments))
        given = cls(structure, vector, cost, (lower, upper), arguments, cost)
        end = given.settled(Lower(vector, cost))
        much = 2.0 * (cost - end.cost) > given.noise
        return cls(
            structure,
            end.vector,
            end.cost,
            (lower, upper),
            arguments,
            cost,
            end if much else None,
        )

    @property
    def noise(self) -> float:
        """Fall of twice the cost that does not count."""
        return max(_LOWER, 1e-9 * abs(self.cost))

    def settled(self, start: Lower) -> Lower:
        """The optimum that is reached from a vector with all parameters free."""
        end = self._solve(start.vector, *self.bounds)
        cost = self.cost_at(np.asarray(end.vector))
        return Lower(np.asarray(end.vector), cost) if cost < start.cost else start

    def cost_at(self, vector: np.ndarray) -> float:
        """Cost of a vector."""
        return float(cost_at(self.structure, vector, self.arguments))

    def held(self, index: int, value: float, distance: float, start: np.ndarray) -> Point:
        """Fit of all parameters but one, which is held at a value."""
        lower, upper = (bound.copy() for bound in self.bounds)
        lower[index] = upper[index] = value
        end = self._solve(start, lower, upper)
        vector = np.asarray(end.vector)
        cost = self.cost_at(vector)
        root = float(np.sqrt(2.0 * max(cost - self.cost, 0.0))) if np.isfinite(cost) else np.nan
        return Point(distance, root, vector, cost, int(end.status))

    def _solve(
        self, start: np.ndarray, lower: np.ndarray, upper: np.ndarray
    ) -> box_lm.BoxLMOutcome:
        options = box_lm.BoxLMOptions()
        return box_lm.solve_compiled(self.structure, start, lower, upper, self.arguments, options)


@dataclass
class _Search:
    """The points of one side so far; grows while the walk goes on."""

    around: Neighbourhood
    index: int
    direction: float
    tangent: np.ndarray
    points: list[Point] = field(default_factory=list)

    def __post_init__(self) -> None:
        here = self.around
        self.points.append(Point(0.0, 0.0, here.vector, here.cost, box_lm.GRADIENT))

    @property
    def room(self) -> float:
        """Distance to the bound."""
        bound = self.around.bounds[0 if self.direction < 0 else 1][self.index]
        return float(abs(bound - self.around.vector[self.index]))

    def fit_at(self, distance: float) -> Point:
        """The fit at a distance, from the more promising of two starts; kept where finite."""
        lower, upper = self.around.bounds
        value = self.around.vector[self.index] + self.direction * distance
        if distance == self.room:
            value = (lower if self.direction < 0 else upper)[self.index]
        starts = []
        for guess in (self._guess(distance), self._near(distance)[0].vector):
            start = np.clip(guess, lower, upper)
            start[self.index] = value
            starts.append(start)
        costs = [self.around.cost_at(start) for start in starts]
        if not costs[0] <= costs[1] and np.isfinite(costs[1]):
            starts.reverse()
        best = self.around.held(self.index, float(value), distance, starts[0])
        if not best.converged:
            other = self.around.held(self.index, float(value), distance, starts[1])
            if not best.finite or other.cost < best.cost:
                best = other
        if best.finite:
            self.points.append(best)
        return best

    def _near(self, distance: float) -> list[Point]:
        """The points by their nearness to a distance."""
        return sorted(self.points, key=lambda p: abs(p.distance - distance))

    def _guess(self, distance: float) -> np.ndarray:
        """The vector at a distance, along the straight line through its two nearest points."""
        if len(self.points) == 1:
            return self.around.vector + distance * self.tangent
        first, second = self._near(distance)[:2]
        share = (distance - first.distance) / (second.distance - first.distance)
        return first.vector + share * (second.vector - first.vector)

    def ended(self, status: str, reason: str, at: Point) -> Side:
        """The outcome, with a few more points on the way to a definite end."""
        lower = None
        if status in ("closed", "at bound") and at.distance > 0:
            known = {p.distance for p in self.points}
            for distance in (share * at.distance for share in _BETWEEN):
                if distance not in known:
                    point = self.fit_at(distance)
                    lower = self.lower_at(point)
                    if lower is not None:
                        status, reason, at = "failed", _ON_THE_WAY, point
                        break
        points = tuple(sorted(self.points[1:], key=lambda p: p.distance))
        return Side(status, reason, at.vector, points, lower)

    def lower_at(self, point: Point) -> Lower | None:
        """The point as a better optimum, if it is one."""
        if point.finite and 2.0 * (point.cost - self.around.cost) < -self.around.noise:
            return Lower(point.vector, point.cost)
        return None


_ON_THE_WAY = "the misfit is lower than at the fit"


def walk(
    around: Neighbourhood,
    index: int,
    direction: float,
    threshold: float,
    first: float,
    limit: float,
    tangent: np.ndarray,
) -> Side:
    """Follow a profile from the optimum to one side until the root meets the threshold.

    Parameters
    ----------
    around : Neighbourhood
        The cost and its optimum.
    index : int
        Which entry of the vector.
    direction : float
        -1 or 1.
    threshold : float
        Root of twice the rise that ends the walk.
    first, limit : float
        First distance to try, and the one from which on a side without bound counts as open.
    tangent : ndarray, shape (p,)
        First guess of how the vector moves per distance.

    Returns
    -------
    Side
        Where and why it ended.
    """
    search = _Search(around, index, direction, tangent)
    if search.room <= 0:
        return Side("at bound", "", around.vector, ())
    inside = third = search.points[0]
    outside: Point | None = None
    wall = np.inf
    last = search.room if np.isfinite(search.room) else limit
    distance = min(first, last)
    for number in range(_MOST_FITS):
        point = search.fit_at(distance)
        lower = search.lower_at(point)
        if lower is not None:
            side = search.ended("failed", _ON_THE_WAY, point)
            return dataclasses.replace(side, lower=lower)
        if not point.finite:
            wall = distance
            if wall - inside.distance <= 1e-3 * wall:
                reason = "the model is not finite further on, and the misfit has not risen enough"
                return search.ended("failed", reason, inside)
            distance = 0.5 * (inside.distance + wall)
            continue
        if abs(point.root - threshold) <= _TOLERANCE * threshold:
            return _closed(search, point, "")
        if point.root < threshold:
            if distance >= last:
                return search.ended("at bound" if last == search.room else "open", "", point)
            inside, third = point, inside
        else:
            outside, third = point, outside or third
        if outside is None:
            distance = min(_further(point, third, threshold, number), last)
            if distance >= wall:
                distance = 0.5 * (inside.distance + wall)
        elif outside.distance - inside.distance <= 1e-12 * outside.distance:
            return _jump(search, inside, outside)
        else:
            opposite = outside if point is inside else inside
            distance = _between(point, opposite, third, threshold)
    return search.ended("failed", f"the search did not end in {_MOST_FITS} fits", inside)


def _further(point: Point, before: Point, threshold: float, number: int) -> float:
    """Next distance while the threshold lies further out."""
    slope = (point.root - before.root) / (point.distance - before.distance)
    guess = point.distance + (threshold - point.root) / slope if slope > 0 else np.inf
    # Each try goes further than a mere secant would, or a root that levels off is never passed.
    least = (1.0 + 0.5 * number) * point.distance
    return float(np.clip(1.001 * guess, least, _GROWTH * point.distance))


def _between(newest: Point, opposite: Point, third: Point, threshold: float) -> float:
    """Next distance inside the bracket of `newest` and `opposite`, by Chandrupatla's rule.

    Inverse quadratic interpolation where the three points are bent little enough, else the middle.
    """
    one, two, three = (p.root - threshold for p in (newest, opposite, third))
    width = opposite.distance - newest.distance
    share = 0.5
    if third.distance != opposite.distance:
        along = -width / (third.distance - opposite.distance)
        bend = (one - two) / (three - two) if three != two else np.inf
        if bend**2 < along and (1.0 - bend) ** 2 < 1.0 - along and three != one:
            share = one / (two - one) * three / (two - three)
            share += (
                (third.distance - newest.distance)
                / width
                * one
                / (three - one)
                * two
                / (three - two)
            )
    else:
        share = one / (one - two)
    return newest.distance + float(np.clip(share, 1e-9, 1.0 - 1e-9)) * width


def _closed(search: _Search, point: Point, reason: str) -> Side:
    if point.converged:
        return search.ended("closed", reason, point)
    status = box_lm.STATUS[point.status]
    return search.ended("failed", f"the fit of the other parameters is {status}", point)


def _jump(search: _Search, inside: Point, outside: Point) -> Side:
    """The root leaps over the threshold between two neighbouring distances."""
    if outside.distance == search.room:
        return search.ended("at bound", "", outside)
    if not outside.converged:
        return _closed(search, outside, "")
    return search.ended("closed", "the misfit leaps there", inside)
