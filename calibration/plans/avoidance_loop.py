"""The loop: block of samples, detector, policy, override of spindle speed and feed together.

`step` is pure and knows nothing of where its blocks come from, so that it drives a machine as well
as the plant of `calibration.plans.avoidance`. Every override has its own baseline of air cutting;
while the spindle changes its speed nothing is judged, for then there is no baseline.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from calibration.plans.avoidance_log import LogRow
from calibration.plans.avoidance_policies import Policy, Seen
from procmodel.chatter import (
    AirCut,
    Baseline,
    Detector,
    DetectorSettings,
    DetectorState,
    Event,
    Rotation,
    Windowing,
    detector,
    prepare,
)
from procmodel.errors import InputError
from procmodel.io.baselines import StoredBaseline

# What the speed at an override may differ by from that of its baseline, as a fraction.
_NEAR = 0.02


@dataclass(frozen=True)
class Spindle:
    """The spindle as the loop knows it.

    Parameters
    ----------
    rotation : float [rev/s]
        Programmed speed, at an override of 1.
    acceleration : float [rev/s^2]
        Limit of its acceleration.
    settling : float [s]
        Time after a change of speed during which vibration of the old one dies out.

    Raises
    ------
    InputError
        If a number is out of its range.
    """

    rotation: float
    acceleration: float
    settling: float = 0.05

    def __post_init__(self) -> None:
        for name, unit in (("rotation", "rev/s"), ("acceleration", "rev/s^2")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} of the spindle is {value:g} {unit}, but must be above 0.")
        if not (math.isfinite(self.settling) and self.settling >= 0.0):
            raise InputError(f"settling is {self.settling:g} s, but must be 0 or more.")

    def change(self, before: float, after: float) -> float:
        """Time that a change of override takes, settling included [s]."""
        return abs(after - before) * self.rotation / self.acceleration + self.settling


@dataclass(frozen=True)
class Loop:
    """What a loop is made of.

    Parameters
    ----------
    settings : DetectorSettings
        Of the detector, the same at every override.
    baselines : mapping of float to AirCut
        Air cutting at every override.
    spindle : Spindle
        The spindle.
    policy : Policy
        What is decided.

    Raises
    ------
    InputError
        If there is no baseline at the programmed speed, or one was made at another speed than its
        override says.
    """

    settings: DetectorSettings
    baselines: Mapping[float, AirCut]
    spindle: Spindle
    policy: Policy

    def __post_init__(self) -> None:
        for override, air in self.baselines.items():
            wanted = override * self.spindle.rotation
            if not abs(air.rotation / wanted - 1.0) <= _NEAR:
                raise InputError(
                    f"the baseline of the override {100 * override:g} % was made at "
                    f"{60 * air.rotation:g} 1/min, but the spindle then turns at {60 * wanted:g}; "
                    "record air cutting at that speed."
                )
        self.detector_at(1.0)

    def detector_at(self, override: float) -> Detector:
        """The detector for an override.

        Parameters
        ----------
        override : float
            One with a baseline, or within 2 % of one.

        Returns
        -------
        Detector
            Its lines are left out at the speed of the override.

        Raises
        ------
        InputError
            If no baseline is near.
        """
        if override in self.baselines:
            return prepare(self.settings, self.baselines[override])
        if not self.baselines:
            raise InputError("the loop has no baseline; record air cutting at every override.")
        near = min(self.baselines, key=lambda o: abs(o / override - 1.0))
        if abs(near / override - 1.0) > _NEAR:
            raise InputError(
                f"no baseline is within 2 % of the override {100 * override:.4g} %; the nearest is "
                f"that of {100 * near:.4g} %. Record air cutting there, or do not allow it."
            )
        turning = Rotation(override * self.spindle.rotation, 0.0)
        return prepare(self.settings, self.baselines[near], turning)


class LoopState(NamedTuple):
    """All that a loop knows between two blocks.

    Attributes
    ----------
    override : float
        Wanted of the machine, for speed and feed.
    detector : Detector
        For this override.
    seen : DetectorState
        What the detector knows.
    policy : Any
        What the policy knows.
    changes : int
        Changes of the override so far.
    """

    override: float
    detector: Detector
    seen: DetectorState
    policy: Any
    changes: int


def start(loop: Loop, origin: float = 0.0) -> LoopState:
    """The loop before the first sample, at the programmed speed.

    Parameters
    ----------
    loop : Loop
        The loop.
    origin : float [s]
        Time of the first sample.

    Returns
    -------
    LoopState
        For `step`.
    """
    return LoopState(1.0, loop.detector_at(1.0), detector.start(origin), loop.policy.start(), 0)


def step(
    loop: Loop, state: LoopState, block: np.ndarray
) -> tuple[LoopState, tuple[LogRow, ...], tuple[Event, ...]]:
    """One more block of samples.

    Parameters
    ----------
    loop : Loop
        The loop.
    state : LoopState
        From `start` or the step before.
    block : ndarray, shape (k, c) [unit]
        The next samples.

    Returns
    -------
    state : LoopState
        Its override is to be taken by the machine now. What comes until the spindle has got there,
        by its acceleration and settling, is passed over.
    rows : tuple of LogRow
        One for each window; the last one says what was decided.
    events : tuple of Event
        Of the detector.

    Raises
    ------
    InputError
        If the policy wants an override without a baseline, or the channels are not the baseline's.
    """
    seen, events, observations = detector.observed(state.detector, state.seen, block)
    state = state._replace(seen=seen)
    if not observations:
        return state, (), events
    windowing = loop.settings.windowing
    now = seen.origin + seen.received / windowing.rate
    turning = state.override * loop.spindle.rotation
    known, decision = loop.policy.decide(
        state.policy, Seen(now, state.override, turning, observations)
    )
    said = [""] * (len(observations) - 1) + [decision.reason]
    rows = tuple(
        LogRow(
            o.time, state.override, turning, o.score, o.frequency, o.engagement, o.outcome, words
        )
        for o, words in zip(observations, said, strict=True)
    )
    state = state._replace(policy=known)
    if decision.override != state.override:
        skipped = math.ceil(loop.spindle.change(state.override, decision.override) * windowing.rate)
        state = state._replace(
            override=decision.override,
            detector=loop.detector_at(decision.override),
            seen=detector.restarted(seen, skipped),
            changes=state.changes + 1,
        )
    return state, rows, events


def baselines_of(stored: StoredBaseline) -> dict[float, AirCut]:
    """Baselines from a file, by override.

    Parameters
    ----------
    stored : StoredBaseline
        As of `procmodel.io.load_baselines`.

    Returns
    -------
    dict of float to AirCut
        For `Loop`, with the override as a fraction.
    """
    windowing = Windowing(stored.rate, stored.window_length, stored.hop, stored.taper)
    return {
        each.override / 100.0: AirCut(
            windowing,
            each.spindle_speed / 60.0,
            stored.channels,
            Baseline(each.count, each.mean, each.squares),
        )
        for each in stored.overrides
    }
