"""The threshold of least expected cost: where it lies for what is known of the scores.

An alarm pays where P(chatter | D) > C_false / (C_false + C_miss). For scores that speak for chatter
the more the higher they are, that is a threshold T, and the one at which the expected cost of a
window,

    C_false (1 - pi) P(D > T | stable) + C_miss pi P(D < T | chatter),

is least (pi the share of windows that chatter). Where errors cost per cut instead, it is that of

    C_false (1 - pi) E(alarms in a stable cut) + C_miss pi P(no alarm in a chattering cut).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calibration.chatter_scores import ScorePosterior
from calibration.plans.alarm_rule import (
    AlarmRule,
    alarms_in_cut,
    first_alarm,
    windows_within,
)
from calibration.plans.window_law import WindowLaw, window_law, windows_in_common
from procmodel.chatter import CHATTER, STABLE
from procmodel.errors import InputError, nearest

WINDOW, CUT = "window", "cut"
TWO_OF_FIVE = AlarmRule(2, 5)
_GRID, _BISECTIONS = 300, 22
# The same where whole cuts are gone through for every threshold.
_GRID_OF_CUTS, _DRAWS_OF_CUTS = 40, 60
# Beyond all scores of cuts, so far as a search for a rare enough false alarm may have to go.
_BEYOND = 14.0


@dataclass(frozen=True)
class Costs:
    """What errors cost, in any one unit.

    Attributes
    ----------
    miss : float
        Of a window that chatters without an alarm.
    false_alarm : float
        Of an alarm in a window that does not.
    chatter_share : float
        Share of cutting windows (or of cuts) that chatter, the base rate pi.
    per : {"window", "cut"}
        What is missed or given a false alarm: a window by itself, or a cut by the rule.

    Raises
    ------
    InputError
        If a cost is not above 0, the share not between 0 and 1, or `per` neither of the two.
    """

    miss: float
    false_alarm: float
    chatter_share: float = 0.5
    per: str = "window"

    def __post_init__(self) -> None:
        for name in ("miss", "false_alarm"):
            cost = getattr(self, name)
            if not (math.isfinite(cost) and cost > 0.0):
                raise InputError(
                    f"the cost of a {name.replace('_', ' ')} is {cost:g}, but must be above 0."
                )
        if self.per not in (WINDOW, CUT):
            raise InputError(f"costs are per {self.per!r}{nearest(self.per, (WINDOW, CUT))}.")
        if not 0.0 < self.chatter_share < 1.0:
            raise InputError(
                f"the share of chatter is {self.chatter_share:g}, but must be between 0 and 1."
            )

    @property
    def probability(self) -> float:
        """P(chatter | D) from which on an alarm pays."""
        return self.false_alarm / (self.false_alarm + self.miss)

    def expected(self, false: Any, missed: Any) -> Any:
        """Expected cost of a window, or of a cut.

        Parameters
        ----------
        false, missed : array_like
            False alarms in a stable one, and probability of a miss in one that chatters.
        """
        pi = self.chatter_share
        return self.false_alarm * (1.0 - pi) * false + self.miss * pi * missed


@dataclass(frozen=True)
class Choice:
    """A threshold, and P(chatter | D).

    Attributes
    ----------
    threshold : float
        Of the score D.
    raised : bool
        Whether the false-alarm rate asked for lifted it above that of least cost.
    grid, probability : ndarray, shape (k,)
        Scores D, and P(chatter | D) for them.
    """

    threshold: float
    raised: bool
    grid: np.ndarray
    probability: np.ndarray

    def chatter_probability(self, scores: np.ndarray) -> np.ndarray:
        """P(chatter | D) of single windows, of the shape of the scores."""
        return np.interp(np.log1p(np.maximum(scores, -0.9)), np.log1p(self.grid), self.probability)


class CutLengths(NamedTuple):
    """How long new cuts last.

    Attributes
    ----------
    stable : int
        Windows of a stable cut.
    chatter : int
        Windows of a chattering cut in which it has to be found.
    step : float [s]
        From window to window.
    """

    stable: int
    chatter: int
    step: float

    @property
    def hours(self) -> float:
        """Of a stable cut."""
        return self.stable * self.step / 3600.0


class Least(NamedTuple):
    """Thresholds of y at which the cost is least.

    Attributes
    ----------
    pooled : float
        Of the mean cost over all that is known.
    of_draws : ndarray, shape (m,)
        Of every draw.
    at_end : bool
        Whether it is at the end of all scores.
    """

    pooled: float
    of_draws: np.ndarray
    at_end: bool


def chosen_threshold(
    posterior: ScorePosterior,
    costs: Costs,
    rule: AlarmRule = TWO_OF_FIVE,
    *,
    tool: str | Sequence[str] | None = None,
    false_alarms_per_hour: float | None = None,
    within: float | None = None,
    seed: int = 0,
) -> Choice:
    """The threshold of `plan_threshold` alone, without what to expect of it.

    Parameters
    ----------
    posterior, costs, rule, tool, false_alarms_per_hour, within, seed
        As for `plan_threshold`.

    Returns
    -------
    Choice
        The threshold.

    Raises
    ------
    InputError
        As for `plan_threshold`.
    """
    lengths = cut_lengths(posterior, within)
    stable, chatter = (window_law(posterior, label, tool, seed) for label in (STABLE, CHATTER))
    return choice(stable, chatter, costs, rule, lengths, false_alarms_per_hour)[0]


def choice(
    stable: WindowLaw,
    chatter: WindowLaw,
    costs: Costs,
    rule: AlarmRule,
    lengths: CutLengths,
    false_alarms_per_hour: float | None,
) -> tuple[Choice, Least]:
    """Threshold of least cost, lifted where the rate of false alarms has to be lower.

    Parameters
    ----------
    stable, chatter : WindowLaw
        Windows of new cuts.
    costs, rule, false_alarms_per_hour
        As for `plan_threshold`.
    lengths : CutLengths
        Of new cuts.

    Returns
    -------
    Choice
        The threshold.
    Least
        Those of least cost, before any lifting.

    Raises
    ------
    InputError
        If the rate is not above 0, or more than there are windows.
    """
    least = _cheapest(stable, chatter, costs, rule, lengths)
    at, raised = least.pooled, False
    if false_alarms_per_hour is not None:
        most = 3600.0 / lengths.step
        if not 0.0 < false_alarms_per_hour < most:
            raise InputError(
                f"false alarms per hour are {false_alarms_per_hour:g}, but must be above 0 and "
                f"fewer than the {most:g} windows of an hour."
            )
        rare = float(for_rate(stable, rule, false_alarms_per_hour, lengths, pooled=True)[0])
        at, raised = max(at, rare), rare > at
    grid, probability = _probabilities(stable, chatter, costs)
    return Choice(math.expm1(at), raised, grid, probability), least


def cut_lengths(posterior: ScorePosterior, within: float | None) -> CutLengths:
    """Lengths of new cuts: the medians of those at hand, and a time to find chatter in if given.

    Raises
    ------
    InputError
        If that time [s] is shorter than a window.
    """
    step, length = windows_in_common(posterior)
    sizes = {
        label: [len(cut.scores) for cut in posterior.cuts if cut.label == label]
        for label in (STABLE, CHATTER)
    }
    found = int(np.median(sizes[CHATTER]))
    if within is not None:
        if not (math.isfinite(within) and within >= length):
            raise InputError(
                f"chatter cannot be found within {within:g} s: a window takes {length:g}."
            )
        found = windows_within(within, step, length)
    return CutLengths(int(np.median(sizes[STABLE] or sizes[CHATTER])), found, step)


def drawn_for(law: WindowLaw, costs: Costs) -> WindowLaw:
    """The draws for which a threshold of least cost is found one by one."""
    return law if costs.per == WINDOW else law.thinned(_DRAWS_OF_CUTS)


def _cheapest(
    stable: WindowLaw, chatter: WindowLaw, costs: Costs, rule: AlarmRule, lengths: CutLengths
) -> Least:
    low, high = np.quantile(stable.level, 0.02), np.quantile(chatter.level, 0.98)
    high = max(high, low) + 4.0 * float(np.median(chatter.spread))
    stable, chatter = drawn_for(stable, costs), drawn_for(chatter, costs)
    grid = np.linspace(low, high, _GRID if costs.per == WINDOW else _GRID_OF_CUTS)
    cost = expected_costs(stable, chatter, costs, rule, lengths, grid)
    pooled, ends = _least(grid, cost.mean(axis=0)[None])
    return Least(float(pooled[0]), _least(grid, cost)[0], bool(ends[0]))


def expected_costs(
    stable: WindowLaw,
    chatter: WindowLaw,
    costs: Costs,
    rule: AlarmRule,
    lengths: CutLengths,
    grid: np.ndarray,
) -> np.ndarray:
    """Expected cost for every draw and threshold, shape (m, k)."""
    if costs.per == WINDOW:
        return costs.expected(stable.above(grid), 1.0 - chatter.above(grid))
    columns = []
    for threshold in grid:
        false = alarms_of_cut(stable, rule, threshold, lengths)
        missed = 1.0 - spoken_by(chatter, rule, threshold, lengths.chatter)[:, -1]
        columns.append(costs.expected(false, missed))
    return np.stack(columns, axis=1)


def _least(grid: np.ndarray, cost: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rows of costs are least, by the parabola through three points."""
    at = cost.argmin(axis=1)
    ends = (at == 0) | (at == len(grid) - 1)
    inner = np.clip(at, 1, len(grid) - 2)
    rows = np.arange(len(cost))
    low, mid, high = (cost[rows, inner + k] for k in (-1, 0, 1))
    bend = low - 2.0 * mid + high
    off = np.where(bend > 0.0, 0.5 * (low - high) / np.where(bend > 0.0, bend, 1.0), 0.0)
    off = np.where(ends, 0.0, np.clip(off, -0.5, 0.5))
    return grid[at] + off * (grid[1] - grid[0]), ends


def alarms_of_cut(
    law: WindowLaw, rule: AlarmRule, threshold: np.ndarray | float, lengths: CutLengths
) -> np.ndarray:
    """Alarms that begin in a stable cut, for every draw, over new cuts; shape (m,)."""
    return alarms_in_cut(rule, *law.together(threshold), lengths.stable) @ law.weight


def for_rate(
    law: WindowLaw, rule: AlarmRule, per_hour: float, lengths: CutLengths, pooled: bool
) -> np.ndarray:
    """Least threshold of y from which on alarms are rare enough, in the mean or draw by draw."""
    wanted = per_hour * lengths.hours
    size = 1 if pooled else len(law.level)

    def rare(threshold: np.ndarray) -> np.ndarray:
        alarms = alarms_of_cut(law, rule, threshold, lengths)
        return np.array([alarms.mean()]) <= wanted if pooled else alarms <= wanted

    # From above: where nearly every window exceeds, alarms seldom begin, and never end.
    top = float(law.level.max()) + _BEYOND
    low, high = np.full(size, float(np.median(law.level))), np.full(size, top)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        enough = rare(middle)
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high


def spoken_by(law: WindowLaw, rule: AlarmRule, threshold: float, windows: int) -> np.ndarray:
    """Probability that the rule has spoken by every window, over new cuts, shape (m, windows)."""
    by = first_alarm(rule, *law.together(threshold), windows)
    return np.einsum("mqw,q->mw", by, law.weight)


def _probabilities(
    stable: WindowLaw, chatter: WindowLaw, costs: Costs
) -> tuple[np.ndarray, np.ndarray]:
    """Scores and P(chatter | D), which never falls with the score.

    Far out the tails of both laws decide, of which windows tell nothing: up and down from the
    middle of the stable ones the probability is held at the best that it has reached.
    """
    middle = float(np.median(stable.level))
    reach = 6.0 * float(np.median(chatter.spread))
    low, high = np.quantile(stable.level, 0.01), np.quantile(chatter.level, 0.99)
    y = np.linspace(min(low, middle) - reach, max(high, middle) + reach, _GRID)
    pi = costs.chatter_share
    for_chatter, for_stable = pi * chatter.density(y), (1.0 - pi) * stable.density(y)
    probability = for_chatter / (for_chatter + for_stable)
    at = int(np.searchsorted(y, middle))
    up = np.maximum.accumulate(probability[at:])
    down = np.minimum.accumulate(probability[: at + 1][::-1])[1:][::-1]
    return np.expm1(y), np.concatenate([down, up])
