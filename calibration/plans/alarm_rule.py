"""What a rule of votes comes to: how often it errs, how surely and how soon it speaks.

A rule speaks when the score has exceeded a threshold in at least k of the last n windows. Windows
that follow each other exceed it together, which is described by two numbers: the probability p that
a window exceeds, and the probability r that it does where the one before did (a Markov chain of
two states).
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np
import scipy.special

from procmodel.errors import InputError

MOST_WINDOWS = 10
_TAIL_NODES = 16


@dataclass(frozen=True)
class AlarmRule:
    """When an alarm is given.

    Attributes
    ----------
    votes, of : int
        When the threshold is exceeded in at least `votes` of the last `of` windows.

    Raises
    ------
    InputError
        If they are not 1 <= votes <= of <= 10.
    """

    votes: int = 2
    of: int = 5

    def __post_init__(self) -> None:
        if not 1 <= self.votes <= self.of <= MOST_WINDOWS:
            raise InputError(
                f"the rule takes {self.votes} of {self.of} windows, but must take at least 1, and "
                f"not more than there are, which are at most {MOST_WINDOWS}."
            )

    def __str__(self) -> str:
        return f"{self.votes} of {self.of} windows"

    def spoken(self, exceeded: np.ndarray) -> np.ndarray:
        """Whether the rule speaks at every window of a cut.

        Parameters
        ----------
        exceeded : ndarray, shape (w,) of bool
            Whether each window exceeds the threshold.

        Returns
        -------
        ndarray, shape (w,) of bool
            With no window before the first.
        """
        counts = np.concatenate([[0], np.cumsum(exceeded)])
        since = np.maximum(np.arange(1, len(exceeded) + 1) - self.of, 0)
        return counts[1:] - counts[since] >= self.votes


def exceedance(
    threshold: np.ndarray,
    level: np.ndarray,
    spread: np.ndarray,
    freedom: np.ndarray,
    correlation: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """How often windows of a cut exceed a threshold, and how often two together.

    Parameters
    ----------
    threshold : ndarray
        Of y = log(1 + D).
    level : ndarray
        v, level of the cut.
    spread, freedom, correlation : ndarray
        s, nu and phi of its windows; all shapes are broadcast.

    Returns
    -------
    p : ndarray
        P(y > threshold), with y = v + s t(nu).
    r : ndarray
        P(y_i > threshold | y_{i-1} > threshold), by quadrature over the tail.
    """
    shape = np.broadcast_shapes(*map(np.shape, (threshold, level, spread, freedom, correlation)))
    far = np.broadcast_to((threshold - level) / spread, shape)
    nu, phi = (np.broadcast_to(a, shape) for a in (freedom, correlation))
    p = np.asarray(scipy.special.stdtr(nu, -far))
    share = np.sqrt(1.0 - phi**2)
    # z = far + c x / (1 - x) for x from 0 to 1, c the length on which the tail falls.
    c = np.sqrt(1.0 + np.maximum(far, 0.0) ** 2 / nu)
    nodes, weights = np.polynomial.legendre.leggauss(_TAIL_NODES)
    both, alone = np.zeros(shape), np.zeros(shape)
    for node, weight in zip(0.5 * (1.0 + nodes), weights, strict=True):
        z = far + c * node / (1.0 - node)
        # Relative to its value at the beginning, where it is largest, unless that lies below 0.
        start = np.maximum(far, 0.0) ** 2
        density = np.exp(-0.5 * (nu + 1.0) * np.log((nu + z**2) / (nu + start)))
        density *= weight / (1.0 - node) ** 2
        both += density * scipy.special.stdtr(nu, (phi * z - far) / share)
        alone += density
    return p, np.clip(both / alone, 0.0, 1.0)


def alarm_rate(rule: AlarmRule, p: np.ndarray, r: np.ndarray) -> np.ndarray:
    """How often a rule begins to speak, per window.

    Parameters
    ----------
    rule : AlarmRule
        The rule.
    p, r : ndarray
        From `exceedance`.

    Returns
    -------
    ndarray
        P(it speaks now and did not before), of the shape of p; exact for the Markov chain.
    """
    total = np.zeros(np.shape(p))
    chain = _Chain(p, r)
    for pattern in itertools.product((0, 1), repeat=rule.of + 1):
        if sum(pattern[:-1]) < rule.votes <= sum(pattern[1:]):
            total = total + chain.probability(pattern)
    return total


def alarms_in_cut(rule: AlarmRule, p: np.ndarray, r: np.ndarray, windows: int) -> np.ndarray:
    """Number of alarms that begin in a cut.

    Parameters
    ----------
    rule : AlarmRule
        The rule.
    p, r : ndarray
        From `exceedance`.
    windows : int
        Of the cut.

    Returns
    -------
    ndarray
        Expected number, of the shape of p. In the first n windows none leaves the rule's view, so
        that one begins there or none; from then on they begin at `alarm_rate`.
    """
    chain, early = _Chain(p, r), min(rule.of, windows)
    total = np.zeros(np.shape(p))
    for pattern in itertools.product((0, 1), repeat=early):
        if sum(pattern) >= rule.votes:
            total = total + chain.probability(pattern)
    return total + (windows - early) * alarm_rate(rule, p, r)


def first_alarm(rule: AlarmRule, p: np.ndarray, r: np.ndarray, windows: int) -> np.ndarray:
    """When a rule first speaks.

    Parameters
    ----------
    rule : AlarmRule
        The rule.
    p, r : ndarray, shape (...)
        From `exceedance`.
    windows : int
        How many are followed.

    Returns
    -------
    ndarray, shape (..., windows)
        Probability that it has spoken by every window, none having exceeded before the first.
    """
    chain = _Chain(np.asarray(p, float), np.asarray(r, float))
    kept = max(rule.of - 1, 1)
    states = [s for s in itertools.product((0, 1), repeat=kept) if sum(s[-kept:]) < rule.votes]
    place = {s: i for i, s in enumerate(states)}
    # Probability of every history that has not spoken; the first window has its own law.
    quiet = np.zeros((len(states), *np.shape(p)))
    silent = (0,) * kept
    quiet[place[silent]] = 1.0 - chain.p
    started = (*silent[1:], 1)
    if rule.votes > 1:
        quiet[place[started]] = chain.p
    spoken = [1.0 - quiet.sum(axis=0)]
    for _ in range(windows - 1):
        after = np.zeros_like(quiet)
        for state, i in place.items():
            for now in (0, 1):
                # The window that leaves the rule's view is the oldest of `of` with this one.
                within = (*state, now)[-rule.of :]
                if sum(within) < rule.votes:
                    after[place[(*state, now)[1:]]] += quiet[i] * chain.step(state[-1], now)
        quiet = after
        spoken.append(1.0 - quiet.sum(axis=0))
    return np.stack(spoken, axis=-1)


class _Chain:
    """Two states, exceeded or not, with the probabilities of one after the other."""

    def __init__(self, p: np.ndarray, r: np.ndarray):
        self.p, self.r = p, r
        rest = 1.0 - p
        # Stationary: as many ways in as out.
        self.into = np.where(rest > 0.0, p * (1.0 - r) / np.where(rest > 0.0, rest, 1.0), 1.0)
        self.into = np.minimum(self.into, 1.0)

    def step(self, before: int, now: int) -> np.ndarray:
        """Probability of a state after another."""
        up = self.r if before else self.into
        return up if now else 1.0 - up

    def probability(self, pattern: tuple[int, ...]) -> np.ndarray:
        """Probability of successive states."""
        total = self.p if pattern[0] else 1.0 - self.p
        for before, now in itertools.pairwise(pattern):
            total = total * self.step(before, now)
        return total


def windows_within(seconds: float, step: float, length: float) -> int:
    """Whole windows in a time, at least 1."""
    return max(1, 1 + math.floor((seconds - length) / step + 1e-9))
