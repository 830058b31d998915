"""The override of least expected cost, by what is believed of the threshold.

Notation: o override, 1 at the programmed speed; P probability of chatter; C seconds of lost time
that a second of chatter is worth; f_c chatter frequency; N teeth.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from calibration.plans.avoidance_policies import PAPERS_OVERRIDES, Decision, FromFrequency, Seen
from procmodel.chatter import CUTTING, Observation
from procmodel.errors import InputError


class Tried(NamedTuple):
    """What is known of an override where the tool has cut.

    Attributes
    ----------
    time : float [s]
        When the last window was seen.
    chances : tuple of float
        P(chatter | score) of its last windows.
    """

    time: float
    chances: tuple[float, ...]


class CostState(NamedTuple):
    """What `LeastCost` remembers.

    Attributes
    ----------
    tried : tuple of (float, Tried)
        Overrides where the tool has cut, and what is known of them.
    frequency : float or None [Hz]
        Of the last window that most likely chattered.
    """

    tried: tuple[tuple[float, Tried], ...] = ()
    frequency: float | None = None


@dataclass(frozen=True)
class LeastCost:
    """The override of least expected cost, by what is believed of the threshold.

    A second of programmed cutting costs (1 / o - 1) of lost time and C P(o) / o of chatter. P is
    the mean of P(chatter | score) over the last windows at an override where the tool has cut. Of
    one where it has not, a rule of phase tells, from `least` to `unknown` by `in_phase_chance`, and
    the overrides that were tried: the rule counts as much as `trust` of them. So the policy goes
    down before a threshold is passed where chatter costs much, may stay in faint chatter where time
    does, and goes up where the time to win is worth the risk.

    Parameters
    ----------
    probability : callable
        P(chatter | score) of an array of scores, such as `chatter_probability` of a
        `threshold_cost.Choice`, or `probability_of(samples of the threshold)`.
    teeth, rotation, phase
        As for `FromFrequency`.
    chatter_cost : float
        C [s/s].
    overrides : tuple of float
        Those allowed.
    windows : int
        Windows at an override before it is judged, and over which P is averaged.
    gain : float
        By how much, in seconds a second, another override has to be cheaper.
    unknown : float
        P of an override never tried, where no frequency is known or the phase is at its worst.
    least : float
        The same where the phase is at its best, 0 to `unknown`.
    trust : float
        How many overrides tried the rule of phase counts for, above 0.
    forget : float [s]
        Time after which what was seen at an override counts for 1/e of itself; for cuts whose depth
        changes.

    Raises
    ------
    InputError
        If a parameter is out of its range.
    """

    probability: Callable[[np.ndarray], np.ndarray]
    teeth: int
    rotation: float
    chatter_cost: float = 3.0
    overrides: tuple[float, ...] = PAPERS_OVERRIDES
    phase: float = 0.0
    windows: int = 2
    gain: float = 0.05
    unknown: float = 0.5
    least: float = 0.1
    trust: float = 2.0
    forget: float = math.inf

    def __post_init__(self) -> None:
        FromFrequency(self.teeth, self.rotation, self.overrides, phase=self.phase)
        if isinstance(self.windows, bool) or not isinstance(self.windows, int) or self.windows < 1:
            raise InputError(f"windows is {self.windows!r}, but must be a whole number, 1 or more.")
        for name in ("chatter_cost", "gain"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name.replace('_', ' ')} is {value:g}, but must be 0 or more.")
        if not 0.0 < self.unknown < 1.0:
            raise InputError(f"unknown is {self.unknown:g}, but must be between 0 and 1.")
        if not 0.0 <= self.least <= self.unknown:
            raise InputError(
                f"least is {self.least:g}, but must be from 0 to unknown, {self.unknown:g}."
            )
        if not (math.isfinite(self.trust) and self.trust > 0.0):
            raise InputError(f"trust is {self.trust:g}, but must be above 0.")
        if not self.forget > 0.0:
            raise InputError(f"forget is {self.forget:g} s, but must be above 0.")

    def start(self) -> CostState:
        """State before the first window."""
        return CostState()

    def decide(self, state: CostState, seen: Seen) -> tuple[CostState, Decision]:
        """The cheapest override, once enough windows were seen at the present one."""
        judged = [o for o in seen.observations if o.engagement == CUTTING and not o.fault]
        if not judged:
            return state, Decision(seen.override)
        state = self._learnt(state, seen, judged)
        known = dict(state.tried)[seen.override]
        if len(known.chances) < self.windows:
            return state, Decision(seen.override)
        costs = {o: self.cost(state, o, seen.time) for o in {*self.overrides, seen.override}}
        best = min(costs, key=lambda o: (costs[o], -o))
        if costs[seen.override] - costs[best] <= self.gain:
            return state, Decision(seen.override)
        now, then = (self.chance(state, o, seen.time) for o in (seen.override, best))
        reason = (
            f"P(chatter) is {now:.2f} at {100 * seen.override:.3g} %, which costs "
            f"{costs[seen.override]:.2f} s a second; {100 * best:.3g} % at {then:.2f} is expected "
            f"to cost {costs[best]:.2f}."
        )
        return state, Decision(best, reason)

    def chance(self, state: CostState, override: float, time: float) -> float:
        """P(chatter) at an override, by what is remembered."""
        opposite = 1.0
        if state.frequency is not None:
            turning = self.rotation * override
            opposite = in_phase_chance(state.frequency, self.teeth, turning, self.phase)
        rule = self.least + (self.unknown - self.least) * opposite
        others = [float(np.mean(known.chances)) for o, known in state.tried if o != override]
        prior = (self.trust * rule + sum(others)) / (self.trust + len(others))
        here = dict(state.tried).get(override)
        if here is None:
            return prior
        kept = 1.0 if math.isinf(self.forget) else math.exp((here.time - time) / self.forget)
        return kept * float(np.mean(here.chances)) + (1.0 - kept) * prior

    def cost(self, state: CostState, override: float, time: float) -> float:
        """Expected cost of a second of programmed cutting [s/s]."""
        risk = self.chatter_cost * self.chance(state, override, time)
        return (1.0 / override - 1.0) + risk / override

    def _learnt(self, state: CostState, seen: Seen, judged: Sequence[Observation]) -> CostState:
        chances = np.asarray(self.probability(np.array([o.score for o in judged])), float)
        tried = dict(state.tried)
        before = tried.get(seen.override, Tried(seen.time, ()))
        # Windows of an earlier visit say less than those of this one.
        together = (*before.chances, *(float(p) for p in chances))[-self.windows :]
        tried[seen.override] = Tried(seen.time, together)
        frequency = state.frequency
        worst = int(np.argmax(chances))
        if chances[worst] > 0.5:
            frequency = judged[worst].frequency
        return CostState(tuple(tried.items()), frequency)


def in_phase_chance(frequency: float, teeth: int, rotation: float, phase: float = 0.0) -> float:
    """How much of the risk of chatter is left at a speed, by the phase between teeth.

    Parameters
    ----------
    frequency : float [Hz]
        f_c.
    teeth : int
        N.
    rotation : float [rev/s]
        Speed of the spindle.
    phase : float
        As for `FromFrequency`.

    Returns
    -------
    float
        sin(pi (f_c / (N rotation) - phase))^2, with a phase of 0 the power of the difference
        between the waves of two teeth: 0 where they are in phase, 1 where they are opposite. A rule
        of thumb: it knows nothing of damping, nor of how far from the limit the cut is.
    """
    return math.sin(math.pi * (frequency / (teeth * rotation) - phase)) ** 2


def probability_of(thresholds: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """P(chatter | score) from samples of the threshold.

    Parameters
    ----------
    thresholds : ndarray, shape (m,)
        Samples of the threshold's posterior.

    Returns
    -------
    callable
        Share of the samples that a score exceeds, of the shape of the scores.

    Raises
    ------
    InputError
        If there are none, or one is not finite.
    """
    samples = np.sort(np.ravel(np.asarray(thresholds, float)))
    if not len(samples) or not np.isfinite(samples).all():
        raise InputError("the samples of the threshold must be finite numbers, one at least.")

    def probability(scores: np.ndarray) -> np.ndarray:
        return np.searchsorted(samples, np.asarray(scores, float)) / len(samples)

    return probability
