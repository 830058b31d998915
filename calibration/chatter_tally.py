"""What the windows of a recording came to, counted as they come: states, scores, frequency."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from procmodel.chatter import (
    AIR,
    CHATTER,
    CUTTING,
    ENTRY,
    EXIT,
    MARGINAL,
    STABLE,
    Event,
    Observation,
)

NOT_SCORED = "not scored"

# From the mildest to the most severe.
STATES = (AIR, EXIT, ENTRY, CUTTING, NOT_SCORED, STABLE, MARGINAL, CHATTER)

# A window may be chatter by another rule than the distance, and then have one below 0.
_LEAST = 1e-9


def state_of(observation: Observation) -> str:
    """Outcome of a window, else its engagement; `NOT_SCORED` where it has a fault."""
    if observation.fault:
        return NOT_SCORED
    return observation.outcome or observation.engagement


@dataclass
class Tally:
    """What the windows of a recording came to, counted as they come.

    Attributes
    ----------
    resolution : float [Hz]
        Width of a bin.
    windows : int
        How many there were.
    states : dict of str to int
        How many of them in each state of `state_of`.
    score_max, frequency, time : float or None
        Largest distance of a window that was judged, the frequency of its maximum [Hz], its end
        [s].
    channel : int
        Channel of that.
    score_max_air : float or None
        Largest distance in air.
    events, alarms : int
        Events, and those of chatter among them.
    first : Event or None
        The first event of chatter.
    """

    resolution: float
    windows: int = 0
    states: dict[str, int] = field(default_factory=dict)
    score_max: float | None = None
    frequency: float | None = None
    time: float | None = None
    channel: int = 0
    score_max_air: float | None = None
    events: int = 0
    alarms: int = 0
    first: Event | None = None
    _lines: dict[int, tuple[float, float]] = field(default_factory=dict)

    def add(self, observations: Iterable[Observation], events: Iterable[Event]) -> None:
        """Count some more."""
        for each in observations:
            self.windows += 1
            state = state_of(each)
            self.states[state] = self.states.get(state, 0) + 1
            if each.outcome and (self.score_max is None or each.score > self.score_max):
                self.score_max, self.frequency = each.score, each.frequency
                self.time, self.channel = each.time, each.channel
            if state == CHATTER:
                bin = round(each.frequency / self.resolution)
                weight, moment = self._lines.get(bin, (0.0, 0.0))
                score = max(each.score, _LEAST)
                self._lines[bin] = weight + score, moment + score * each.frequency
            if state == AIR:
                self.score_max_air = max(each.score, self.score_max_air or each.score)
        for event in events:
            self.events += 1
            if event.state == CHATTER:
                self.alarms += 1
                self.first = self.first or event

    @property
    def chatter_frequency(self) -> float | None:
        """Where the chatter is [Hz]; None without.

        Mean of the frequencies of the windows of chatter, weighted by their scores, over those
        within a tenth of the weighted median: a line drifts as chatter grows, and other windows may
        have another line.
        """
        left = 0.5 * sum(weight for weight, _ in self._lines.values())
        middle = None
        for bin in sorted(self._lines):
            left -= self._lines[bin][0]
            if left <= 0.0:
                middle = bin
                break
        if middle is None:
            return None
        near = [self._lines[bin] for bin in self._lines if abs(bin - middle) <= 0.1 * middle]
        return sum(moment for _, moment in near) / sum(weight for weight, _ in near)

    @property
    def status(self) -> str:
        """A sentence on the whole."""
        if self.first is not None:
            return f"chatter from {self.first.time_s:.3f} s on, {counted(self.alarms, 'event')}"
        if self.score_max is None:
            return "not judged: the tool did not cut, or for less than a few windows"
        if self.states.get(MARGINAL):
            return f"marginal in {counted(self.states[MARGINAL], 'window')}, no chatter"
        return "stable: no chatter"

    def as_dict(self) -> dict[str, Any]:
        """For JSON: `windows`, `score_max` and more."""
        return {
            "windows": self.windows,
            "states": dict(sorted(self.states.items())),
            "score_max": self.score_max,
            "score_max_time_s": self.time,
            "score_max_frequency_hz": self.frequency,
            "score_max_air": self.score_max_air,
            "chatter_frequency_hz": self.chatter_frequency,
            "status": self.status,
        }


def counted(number: int, what: str) -> str:
    """`1 event`, `2 events`."""
    return f"{number} {what}{'' if number == 1 else 's'}"
