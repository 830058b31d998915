"""Which override to take next, from what the detector has seen.

A policy is a pure rule: `decide(state, seen)` gives the state after it and a decision, and knows
nothing of where its windows come from. Speed and feed go together by the override, so that the
feed per tooth stays.

Notation: o override, 1 at the programmed speed; Omega rotation at o = 1 [rev/s]; f_c chatter
frequency; N teeth.

References
----------
.. [1] T. Nishikawa, K. Kikuta, H. Yamashita, S. Uchida, S. Abe, system for preventing chatter in
   end milling (in Japanese): steps of 10 points of override.
.. [2] S. Smith, J. Tlusty, "Stabilizing chatter by automatic spindle speed regulation", CIRP Annals
   41, 433-436, 1992: a tooth-passing frequency, or a multiple of it, on the chatter frequency.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from procmodel.chatter import CHATTER, Observation
from procmodel.errors import InputError

PAPERS_OVERRIDES = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
# Overrides closer than this are the same.
_SAME = 1e-6
_MOST_ORDERS = 400


class Seen(NamedTuple):
    """What a policy is told.

    Attributes
    ----------
    time : float [s]
        Now.
    override : float
        At which the tool cuts.
    rotation : float [rev/s]
        Speed of the spindle at this override.
    observations : tuple of Observation
        Windows since the last decision, all of them at this override.
    """

    time: float
    override: float
    rotation: float
    observations: tuple[Observation, ...]


class Decision(NamedTuple):
    """What a policy wants.

    Attributes
    ----------
    override : float
        To take from now on.
    reason : str
        As a sentence; "" where there is nothing to say.
    """

    override: float
    reason: str = ""


class Policy(Protocol):
    """What the loop asks of a policy."""

    def start(self) -> Any:
        """State before the first window."""

    def decide(self, state: Any, seen: Seen) -> tuple[Any, Decision]:
        """State after the windows seen, and the override to take; nothing is changed in place."""


@dataclass(frozen=True)
class Hold:
    """Whatever happens, the override stays: the cut without the loop."""

    def start(self) -> None:
        """State before the first window."""

    def decide(self, state: None, seen: Seen) -> tuple[None, Decision]:
        """The override at which the tool cuts."""
        return state, Decision(seen.override)


@dataclass(frozen=True)
class FixedSteps:
    """The paper's policy: at chatter the next lower override, never up again [1]_.

    Parameters
    ----------
    overrides : tuple of float
        Those allowed.

    Raises
    ------
    InputError
        If there is none, or one is not above 0.
    """

    overrides: tuple[float, ...] = PAPERS_OVERRIDES

    def __post_init__(self) -> None:
        require_overrides(self.overrides)

    def start(self) -> None:
        """State before the first window."""

    def decide(self, state: None, seen: Seen) -> tuple[None, Decision]:
        """The next lower override if a window chatters."""
        found = chattering(seen.observations)
        if found is None:
            return state, Decision(seen.override)
        return state, _step_down(self.overrides, seen, _said(found))


@dataclass(frozen=True)
class FromFrequency:
    """The override at which a multiple of the tooth passing lies on the chatter frequency [2]_.

    There the waves of successive teeth are in phase, beside the pockets between the lobes of
    stability. With the order k the override is f_c / (N (k + phase) Omega), up as well as down.

    Parameters
    ----------
    teeth : int
        N.
    rotation : float [rev/s]
        Omega.
    overrides : tuple of float
        Those allowed; with `continuous` only the least and the greatest count.
    continuous : bool
        Whether every override between them is allowed.
    prefer : {"fastest", "nearest"}
        Which of several: the greatest, whose pocket is widest too, or the nearest.
    phase : float
        Where f_c is wanted above a multiple, in tooth-passing frequencies, -0.5 to 0.5. A cut that
        chatters above its mode's own frequency is most stable at 0.1 to 0.3, where the mode is on
        the multiple or a little above it; 0 is the rule of [2]_, which gets there step by step.
    off : float
        How far f_c may be from there, in tooth-passing frequencies, where the nearest allowed
        override stands for a better one; 0.5 would be anywhere.
    same : float
        Overrides within this fraction of one that chattered are not tried again.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Notes
    -----
    Where no such override is left, the next lower one is taken, as by `FixedSteps`.
    """

    teeth: int
    rotation: float
    overrides: tuple[float, ...] = PAPERS_OVERRIDES
    continuous: bool = False
    prefer: str = "fastest"
    phase: float = 0.0
    off: float = 0.15
    same: float = 0.02

    def __post_init__(self) -> None:
        require_overrides(self.overrides)
        if isinstance(self.teeth, bool) or not isinstance(self.teeth, int) or self.teeth < 1:
            raise InputError(f"teeth is {self.teeth!r}, but must be a whole number, 1 or more.")
        if not (math.isfinite(self.rotation) and self.rotation > 0.0):
            raise InputError(f"rotation is {self.rotation:g} rev/s, but must be above 0.")
        if self.prefer not in ("fastest", "nearest"):
            raise InputError(f"prefer is {self.prefer!r}, but must be 'fastest' or 'nearest'.")
        if not -0.5 <= self.phase <= 0.5:
            raise InputError(f"phase is {self.phase:g}, but must be from -0.5 to 0.5.")
        if not 0.0 < self.off <= 0.5:
            raise InputError(f"off is {self.off:g}, but must be above 0 and at most 0.5.")
        if not 0.0 <= self.same < 0.5:
            raise InputError(f"same is {self.same:g}, but must be from 0 to 0.5.")

    def start(self) -> tuple[float, ...]:
        """State before the first window: no override has chattered yet."""
        return ()

    def decide(self, state: tuple[float, ...], seen: Seen) -> tuple[tuple[float, ...], Decision]:
        """An override in phase with the chatter, if a window chatters."""
        found = chattering(seen.observations)
        if found is None:
            return state, Decision(seen.override)
        tried = (*state, seen.override)
        fitting = in_phase(
            found.frequency,
            self.teeth,
            self.rotation,
            self.overrides,
            continuous=self.continuous,
            phase=self.phase,
            off=self.off,
        )
        left = {
            o: k for o, k in fitting.items() if all(abs(o / t - 1.0) > self.same for t in tried)
        }
        if not left:
            down = _step_down(self.overrides, seen, _said(found))
            return tried, down
        if self.prefer == "fastest":
            chosen = max(left)
        else:
            chosen = min(left, key=lambda o: (abs(o - seen.override), -o))
        reason = (
            f"{_said(found)}: from {100 * seen.override:.3g} to {100 * chosen:.3g} %, where the "
            f"tooth passing times {left[chosen]} is {_off(found.frequency, self, chosen)}."
        )
        return tried, Decision(chosen, reason)


def chattering(observations: Sequence[Observation]) -> Observation | None:
    """The last window that chatters, if one does and the last one is not past it.

    Parameters
    ----------
    observations : sequence of Observation
        Windows in the order of time.

    Returns
    -------
    Observation or None
        Of the outcome `CHATTER`.
    """
    for seen in reversed(observations):
        if seen.outcome:
            return seen if seen.outcome == CHATTER else None
    return None


def in_phase(
    frequency: float,
    teeth: int,
    rotation: float,
    overrides: Sequence[float],
    *,
    continuous: bool = False,
    phase: float = 0.0,
    off: float = 0.15,
) -> dict[float, int]:
    """Overrides at which a multiple of the tooth passing lies on the chatter frequency.

    Parameters
    ----------
    frequency : float [Hz]
        f_c.
    teeth : int
        N.
    rotation : float [rev/s]
        Omega.
    overrides : sequence of float
        Those allowed; with `continuous` all between the least and the greatest.
    continuous : bool
        Whether others between these are allowed.
    phase : float
        Where f_c is wanted above the multiple, in tooth-passing frequencies.
    off : float
        How far f_c may be from there, in tooth-passing frequencies.

    Returns
    -------
    dict of float to int
        Override, and order k, falling.
    """
    low, high = min(overrides), max(overrides)
    passing = teeth * rotation
    if not (math.isfinite(frequency) and frequency > 0.0):
        return {}
    if not continuous:
        found = {}
        for o in sorted(set(overrides), reverse=True):
            cycles = frequency / (passing * o) - phase
            if round(cycles) >= 1 and abs(cycles - round(cycles)) <= off:
                found[o] = round(cycles)
        return found
    first = max(1, math.ceil(frequency / (passing * high) - phase - 1e-12))
    last = math.floor(frequency / (passing * low) - phase + 1e-12)
    orders = range(first, min(first + _MOST_ORDERS, last + 1))
    return {frequency / (passing * (k + phase)): k for k in orders}


def require_overrides(overrides: Sequence[float]) -> None:
    """Refuse overrides that are none.

    Raises
    ------
    InputError
        If there is none, or one is not above 0.
    """
    if not len(overrides):
        raise InputError("no override is allowed; give one at least, 1 for the programmed speed.")
    for o in overrides:
        if not (math.isfinite(o) and o > 0.0):
            raise InputError(f"an override is {o:g}, but must be above 0.")


def _step_down(overrides: Sequence[float], seen: Seen, said: str) -> Decision:
    lower = [o for o in overrides if o < seen.override - _SAME]
    if not lower:
        reason = f"{said}, but {100 * seen.override:.3g} % is the least override allowed."
        return Decision(seen.override, reason)
    reason = f"{said}: from {100 * seen.override:.3g} to {100 * max(lower):.3g} %."
    return Decision(max(lower), reason)


def _said(seen: Observation) -> str:
    return f"chatter at {seen.frequency:.1f} Hz, score {seen.score:.3g}"


def _off(frequency: float, policy: FromFrequency, override: float) -> str:
    passing = policy.teeth * policy.rotation * override
    away = frequency - round(frequency / passing) * passing
    return "there" if abs(away) < 1.0 else f"{abs(away):.0f} Hz off it"
