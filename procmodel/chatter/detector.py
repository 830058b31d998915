"""The streaming detector: blocks of samples in, events out, by a pure step.

Every window is compared with air cutting (`distance`); the level against air tells whether the tool
cuts (`engagement_state`), and only then the detector speaks. Three rules may speak: the distance
exceeds its threshold in some of the last windows (2 of 5 above 100 in [1]_), the distance of their
averaged spectrum exceeds its own, or the lines of period doubling have outgrown those of a stable
cut (`subharmonic`). The result does not depend, to the bit, on how a record is cut into blocks:
every window is measured alone, by the same operations.

References
----------
.. [1] T. Nishikawa, K. Kikuta, H. Yamashita, S. Uchida, S. Abe, system for preventing chatter in
   end milling (in Japanese).
"""

from typing import Any

import numpy as np

from procmodel.chatter import subharmonic
from procmodel.chatter.baseline import AirCut
from procmodel.chatter.detector_rules import (
    AVERAGED,
    CHATTER,
    DISTANCE,
    MARGINAL,
    SUBHARMONIC,
    fault_of,
    growth_rate,
    outcome_after,
    passed,
)
from procmodel.chatter.detector_setup import Detector, DetectorSettings, prepare
from procmodel.chatter.detector_state import (
    Cut,
    Detection,
    DetectorState,
    Event,
    Observation,
    Peak,
)
from procmodel.chatter.engagement_state import AIR, CUTTING, EXIT, engaged
from procmodel.chatter.rotation import Rotation
from procmodel.chatter.scoring import Measured, Scores, around, frequency_of, measured, scored
from procmodel.errors import InputError

# A reference of fewer windows than this says too little to speak on.
_FEWEST = 4


def start(origin: float = 0.0) -> DetectorState:
    """The state before the first sample, whose time [s] may be given."""
    return DetectorState(origin=origin)


def restarted(state: DetectorState, skip: int = 0) -> DetectorState:
    """The state after a change of the spindle speed.

    Parameters
    ----------
    state : DetectorState
        At the end of the last block at the old speed.
    skip : int
        Samples to pass over, until the new speed is reached.

    Returns
    -------
    DetectorState
        For the detector of the new speed: the engagement and all counts go on; samples, scores and
        spectra of the old speed are forgotten.
    """
    return state._replace(next=state.received + skip, pending=(), held=0, cut=Cut())


def step(
    detector: Detector, state: DetectorState, block: np.ndarray
) -> tuple[DetectorState, tuple[Event, ...]]:
    """One more block.

    Parameters
    ----------
    detector : Detector
        From `prepare`.
    state : DetectorState
        From `start` or the step before.
    block : ndarray, shape (k, c) or (k,) [unit]
        The next samples, of any number.

    Returns
    -------
    state : DetectorState
        After the block.
    events : tuple of Event
        What was found in it.

    Raises
    ------
    InputError
        If the block has another number of channels than the detector.
    """
    state, events, _ = observed(detector, state, block)
    return state, events


def observed(
    detector: Detector, state: DetectorState, block: np.ndarray
) -> tuple[DetectorState, tuple[Event, ...], tuple[Observation, ...]]:
    """`step`, with what every window came to as well."""
    windowing = detector.scorer.windowing
    samples = _samples(detector, block)
    received, held = state.received + len(samples), state.held + len(samples)
    state = state._replace(received=received, held=held, pending=(*state.pending, samples))
    if received < state.next + windowing.length:
        return state, (), ()
    joined = np.concatenate(state.pending)
    first = received - held
    events: list[Event] = []
    observations: list[Observation] = []
    while received >= state.next + windowing.length:
        begin = state.next - first
        state, event, observation = _window(
            detector, state, joined[begin : begin + windowing.length]
        )
        observations.append(observation)
        events.extend([event] if event else [])
    # A copy, since a view would hold on to the whole block.
    rest = joined[min(state.next, received) - first :].copy()
    return state._replace(pending=(rest,), held=len(rest)), tuple(events), tuple(observations)


def detect(detector: Detector, samples: np.ndarray, origin: float = 0.0) -> Detection:
    """The detector over a whole record.

    Parameters
    ----------
    detector : Detector
        From `prepare`.
    samples : ndarray, shape (k, c) or (k,) [unit]
        The record.
    origin : float [s]
        Time of its first sample.

    Returns
    -------
    Detection
        The same, to the bit, as that of the record in blocks.

    Raises
    ------
    InputError
        If it has another number of channels than the detector.
    """
    state = start(origin)
    events: list[Event] = []
    observations: list[Observation] = []
    size = 64 * detector.scorer.windowing.length
    for i in range(0, len(samples), size):
        state, found, seen = observed(detector, state, samples[i : i + size])
        events += found
        observations += seen
    return Detection(tuple(events), tuple(observations), state)


def scores(
    samples: np.ndarray,
    baseline: AirCut,
    settings: DetectorSettings,
    rotation: Rotation | None = None,
) -> Scores:
    """Distances of all windows of a record, without the rules.

    Parameters
    ----------
    samples : ndarray, shape (k, c) or (k,) [unit]
        The record.
    baseline : AirCut
        Air cutting at its spindle speed, with as many channels.
    settings : DetectorSettings
        Band and lines to be left out; the thresholds are not used.
    rotation : Rotation, optional
        As for `prepare`.

    Returns
    -------
    Scores
        One entry for each whole window.

    Raises
    ------
    InputError
        As `prepare`, or if the channels are not as many.
    """
    detector = prepare(settings, baseline, rotation)
    return scored(_samples(detector, samples), detector.scorer)


def _samples(detector: Detector, block: np.ndarray) -> np.ndarray:
    """A block with an axis for the channels, of its own memory."""
    samples = np.array(block, dtype=np.float64, ndmin=1)
    samples = samples[:, None] if samples.ndim == 1 else samples
    channels = len(detector.channels)
    if samples.ndim != 2 or samples.shape[1] != channels:
        raise InputError(
            f"the block has the shape {samples.shape}, but the baseline has {channels} "
            f"channels ({', '.join(detector.channels)}); choose the same channels of the record."
        )
    return samples


def _window(
    detector: Detector, state: DetectorState, window: np.ndarray
) -> tuple[DetectorState, Event | None, Observation]:
    """One window: fault, engagement, cut, in this order."""
    settings, scorer = detector.settings, detector.scorer
    time = state.origin + (state.next + scorer.windowing.length) / scorer.windowing.rate
    state = state._replace(next=state.next + scorer.windowing.step, windows=state.windows + 1)
    with np.errstate(invalid="ignore", over="ignore"):
        part = measured(window.T[None], scorer)
    level = float(part.level[0])
    fault = fault_of(window, level, detector.stuck, settings.limit)
    if fault:
        state = state._replace(bad=state.bad.and_one(fault))
        seen = Observation(
            time, np.nan, np.nan, level, 0, state.engagement.name, "", None, None, fault
        )
        return state, None, seen
    engagement = engaged(state.engagement, level, settings.engagement)
    peak = _peak(detector, part)
    cut, event, averaged, doubled = state.cut, None, None, None
    if engagement.name == AIR:
        cut = Cut()
    elif engagement.name != EXIT:
        if engagement.name == CUTTING or settings.entry_votes:
            cut = _with_window(detector, cut, time, part.raw[0], peak)
        if engagement.name == CUTTING:
            averaged = _averaged(detector, cut)
            cut = _with_lines(detector, cut, part.raw[0])
            doubled = cut.doubled[-1] if cut.doubled else None
            cut, event = _judged(detector, cut, time, averaged)
    seen = Observation(
        time,
        peak.score,
        peak.frequency,
        level,
        peak.channel,
        engagement.name,
        cut.outcome if engagement.name == CUTTING else "",
        averaged.score if averaged else None,
        doubled.score if doubled else None,
        "",
    )
    return state._replace(engagement=engagement, cut=cut), event, seen


def _peak(detector: Detector, part: Measured) -> Peak:
    """The largest distance of the only window of a block."""
    where = part.where
    frequency = frequency_of(where, around(part.raw, where), detector.scorer)
    channel, place = divmod(int(where[0]), detector.scorer.bins)
    return Peak(float(part.score[0]), float(frequency[0]), channel, place)


def _with_window(detector: Detector, cut: Cut, time: float, raw: np.ndarray, peak: Peak) -> Cut:
    """A cut with the distances and the spectrum of one more window."""
    settings = detector.settings
    kept = max(settings.averaged, settings.growth_windows)
    return cut._replace(
        peaks=(*cut.peaks, peak)[-settings.of :], spectra=(*cut.spectra, (time, raw))[-kept:]
    )


def _averaged(detector: Detector, cut: Cut) -> Peak | None:
    """The largest distance of the averaged spectrum of the last windows."""
    settings, scorer = detector.settings, detector.scorer
    if settings.averaged_threshold is None or len(cut.spectra) < settings.averaged:
        return None
    last = cut.spectra[-settings.averaged :]
    total = last[0][1].copy()
    for _, raw in last[1:]:
        total += raw
    total /= settings.averaged
    distances = total * scorer.gain - scorer.offset
    where = np.array([distances.argmax()])
    part = Measured(total[None], distances.ravel()[where], where, np.zeros(1))
    return _peak(detector, part)


def _with_lines(detector: Detector, cut: Cut, raw: np.ndarray) -> Cut:
    """A cut with the lines of period doubling of one more window."""
    lines, settings = detector.doubling, detector.settings
    if lines is None:
        return cut
    half = subharmonic.line_powers(raw, lines.half, np)
    tooth = subharmonic.line_powers(raw, lines.tooth, np).sum(axis=-1)
    known = lines.stable or cut.reference
    score, peak = 0.0, None
    if known is not None and (lines.stable or known.windows >= _FEWEST):
        over = subharmonic.growth_over_reference(half, tooth, known, lines.floor, np)
        channel, line = divmod(int(over.argmax()), over.shape[1])
        score = float(over[channel, line])
        middle = lines.half.bins[line, int(lines.half.weights[line].sum()) // 2]
        peak = Peak(score, float(lines.half.frequencies[line]), channel, int(middle))
    reference = cut.reference
    # What has outgrown the reference so far must not become part of it.
    if (
        lines.stable is None
        and (reference is None or reference.windows < settings.reference_windows)
        and score <= settings.subharmonic_threshold
    ):
        reference = subharmonic.added(reference, half, tooth)
    doubled = cut.doubled if peak is None else (*cut.doubled, peak)[-settings.of :]
    return cut._replace(reference=reference, doubled=doubled)


def _judged(
    detector: Detector, cut: Cut, time: float, averaged: Peak | None
) -> tuple[Cut, Event | None]:
    """Outcome of a cut after one more window, and what there is to say."""
    settings = detector.settings
    # Statistic, its peaks, its threshold, and how many of the peaks must pass it.
    rules: list[tuple[str, tuple[Peak, ...], float, int]] = [
        (DISTANCE, cut.peaks, settings.threshold, settings.votes)
    ]
    if averaged is not None and settings.averaged_threshold is not None:
        rules.append((AVERAGED, (averaged,), settings.averaged_threshold, 1))
    rules.append((SUBHARMONIC, cut.doubled, settings.subharmonic_threshold, settings.votes))
    over = [r for r in rules if passed([p.score for p in r[1]], r[2], r[3])]
    near = [r for r in rules if passed([p.score for p in r[1]], settings.margin * r[2], r[3])]
    outcome = outcome_after(cut.outcome, bool(over), bool(near))
    before, cut = cut.outcome, cut._replace(outcome=outcome)
    said = over or (near if outcome == MARGINAL and settings.report_marginal else [])
    if not said:
        return (cut if outcome == CHATTER else cut._replace(reported=0.0)), None
    statistic, peaks, threshold, _ = said[0]
    passing = [p for p in peaks if p.score > threshold * (1.0 if over else settings.margin)]
    peak = passing[-1]
    severity = peak.score / threshold
    if outcome == before and severity < settings.again * cut.reported:
        return cut, None
    event = Event(
        time,
        peak.frequency,
        peak.score,
        outcome,
        statistic,
        _growth(detector, cut, peak),
        detector.channels[peak.channel],
    )
    return cut._replace(reported=severity), event


def _growth(detector: Detector, cut: Cut, peak: Peak) -> float | None:
    """Growth rate of a line over the windows in which it stands above air cutting."""
    bins = slice(max(peak.place - 1, 0), peak.place + 2)
    air = float(detector.air[peak.channel, bins].sum())
    time: list[Any] = []
    power: list[Any] = []
    for when, raw in reversed(cut.spectra[-detector.settings.growth_windows :]):
        above = float(raw[peak.channel, bins].sum()) - air
        if above <= air:
            break
        time.append(when)
        power.append(above)
    return growth_rate(time, power)
