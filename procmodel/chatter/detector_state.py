"""What the detector says, and what it knows between two blocks."""

from typing import NamedTuple

import numpy as np

from procmodel.chatter.detector_rules import BadWindows
from procmodel.chatter.engagement_state import Engagement
from procmodel.chatter.subharmonic import CuttingReference


class Event(NamedTuple):
    """What the detector says.

    Attributes
    ----------
    time_s : float [s]
        End of the window with which it is known.
    frequency_hz : float [Hz]
        Of the line.
    score : float
        Value of the statistic.
    state : str
        Outcome, "chatter" or "marginal".
    statistic : str
        Which rule spoke: "distance", "averaged distance" or "subharmonic".
    growth_rate : float or None [1/s]
        Of the line's amplitude over the last windows; None where too few show it.
    channel : str
        Name of the channel.
    """

    time_s: float
    frequency_hz: float
    score: float
    state: str
    statistic: str
    growth_rate: float | None
    channel: str

    @property
    def sentence(self) -> str:
        """The event in words."""
        grows = "" if self.growth_rate is None else f", growing at {self.growth_rate:.3g} 1/s"
        return (
            f"{self.state} at {self.time_s:.3f} s: {self.frequency_hz:.1f} Hz on {self.channel}, "
            f"{self.statistic} {self.score:.4g}{grows}."
        )


class Observation(NamedTuple):
    """What one window came to.

    Attributes
    ----------
    time : float [s]
        End of the window.
    score, frequency, level : float
        As in `Scores`; the first two NaN where the window has a fault.
    channel : int
        Channel of the score.
    engagement : str
        State of engagement after it.
    outcome : str
        Key into `OUTCOMES`, "" where it is not judged.
    averaged, subharmonic : float or None
        Second and third statistic, None where they cannot be told.
    fault : str
        Key into `FAULTS`, or "".
    """

    time: float
    score: float
    frequency: float
    level: float
    channel: int
    engagement: str
    outcome: str
    averaged: float | None
    subharmonic: float | None
    fault: str


class Peak(NamedTuple):
    """The largest value of a statistic in a window.

    Attributes
    ----------
    score : float
        The value.
    frequency : float [Hz]
        Its line.
    channel, place : int
        Its channel, and bin of the band.
    """

    score: float
    frequency: float
    channel: int
    place: int


class Cut(NamedTuple):
    """What is remembered of the present cut.

    Attributes
    ----------
    peaks, doubled : tuple of Peak
        Of the last windows, by distance and by the lines of period doubling.
    spectra : tuple of (float, ndarray)
        End and raw power of the last windows.
    reference : CuttingReference or None
        Lines of period doubling in the first windows of the cut.
    outcome : str
        Of the last window.
    reported : float
        Severity of the last event, as a multiple of its threshold.
    """

    peaks: tuple[Peak, ...] = ()
    doubled: tuple[Peak, ...] = ()
    spectra: tuple[tuple[float, np.ndarray], ...] = ()
    reference: CuttingReference | None = None
    outcome: str = ""
    reported: float = 0.0


class DetectorState(NamedTuple):
    """All that the detector knows between two blocks.

    Attributes
    ----------
    origin : float [s]
        Time of the first sample.
    received : int
        Samples so far.
    next : int
        Sample at which the next window begins.
    pending : tuple of ndarray, shape (k, c)
        The last samples, which are of windows not yet whole.
    held : int
        How many they are.
    windows : int
        Windows so far.
    bad : BadWindows
        Those of them that were not scored.
    engagement : Engagement
        Whether the tool cuts.
    cut : Cut
        What is remembered of the present cut.
    """

    origin: float = 0.0
    received: int = 0
    next: int = 0
    pending: tuple[np.ndarray, ...] = ()
    held: int = 0
    windows: int = 0
    bad: BadWindows = BadWindows()
    engagement: Engagement = Engagement()
    cut: Cut = Cut()


class Detection(NamedTuple):
    """What a whole record came to.

    Attributes
    ----------
    events : tuple of Event
        In the order of time.
    observations : tuple of Observation
        One for each window.
    state : DetectorState
        At the end.
    """

    events: tuple[Event, ...]
    observations: tuple[Observation, ...]
    state: DetectorState

    @property
    def score_max(self) -> float | None:
        """Largest distance in windows that were judged, None if there are none."""
        return max((o.score for o in self.observations if o.outcome), default=None)
