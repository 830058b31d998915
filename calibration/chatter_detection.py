"""From recordings to what the detector says of them; baselines to their files and back.

file -> `AirCut` -> `Detector` -> `RecordDetection`, block by block with constant memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.chatter_tally import Tally
from calibration.chatter_trace import Trace
from calibration.progress import ProgressOption, reporting
from procmodel.chatter import (
    AirCut,
    BadWindows,
    Baseline,
    Detector,
    DetectorSettings,
    DetectorState,
    Event,
    Windowing,
    air_cut,
    null_threshold,
    observed,
    prepare,
    require_matching,
    restarted,
    start,
)
from procmodel.errors import InputError, nearest
from procmodel.io.baselines import OverrideBaseline, StoredBaseline
from procmodel.io.record_checks import STUCK, flags, held_samples
from procmodel.io.records import Record, RecordStream

# So much of a recording tells whether its values are held, or its first samples outliers.
_HEAD = 1 << 17
# Air cutting is steady; a window this many times louder than half of them holds something else.
_LOUD = 4.0
_ALARM = 1e-3
_FEW_WINDOWS = 10


def air_cut_of_record(
    record: Record, windowing: Windowing, rotation: float
) -> tuple[AirCut, list[str]]:
    """Baseline of a recording of air cutting, and what is to be said against it.

    Parameters
    ----------
    record : Record
        Air cutting at one spindle speed.
    windowing : Windowing
        How it is cut into windows.
    rotation : float [Hz]
        Rotation frequency of the spindle.

    Returns
    -------
    air : AirCut
        The baseline.
    warnings : list of str
        Faults by name: outlier at the start, stuck, clipped, values repeated; a part that is much
        louder than the rest, few windows.

    Raises
    ------
    InputError
        As `air_cut`, and if a channel stands still throughout.
    """
    findings = flags(record.samples, record.channels)
    for name, values in zip(record.channels, record.samples.T, strict=True):
        if (values == values[0]).all():
            raise InputError(
                f"{record.path}: channel '{name}' is {STUCK} at {values[0]:g} throughout; check "
                "sensor and cable, or pick another channel."
            )
    air = air_cut(record.samples, windowing, rotation, record.channels)
    warnings = [f"{each.name}: {each.sentence}" for each in findings]
    whole = len(record.samples) // windowing.length
    parts = record.samples[: whole * windowing.length].reshape(whole, windowing.length, -1)
    power = parts.var(axis=1)
    loud = power > _LOUD * np.median(power, axis=0)
    if loud.any():
        first = int(np.flatnonzero(loud.any(axis=1))[0])
        begin = record.start + first * windowing.length / windowing.rate
        end = begin + windowing.length / windowing.rate
        warnings.append(
            f"not steady: from {begin:.3f} to {end:.3f} s the power is more than {_LOUD:g} times "
            "that of half the stretch: leave out by start and stop what is no air cutting"
        )
    if air.baseline.count < _FEW_WINDOWS:
        warnings.append(
            f"few windows: the baseline is of {air.baseline.count} spectra, so that its deviations "
            "are rough: record 25 or more"
        )
    return air, warnings


def stored(air: AirCut, units: Sequence[str], override: float = 100.0) -> StoredBaseline:
    """A baseline as it is written to a file.

    Parameters
    ----------
    air : AirCut
        The baseline.
    units : sequence of str
        Unit of each channel.
    override : float [%]
        Of spindle speed and feed.

    Returns
    -------
    StoredBaseline
        With this override alone.
    """
    one = OverrideBaseline(
        override,
        60.0 * air.rotation,
        int(air.baseline.count),
        np.asarray(air.baseline.mean),
        np.asarray(air.baseline.squares),
    )
    made = air.windowing
    return StoredBaseline(
        made.rate, made.length, made.step, made.taper, air.channels, tuple(units), (one,)
    )


def with_override(first: StoredBaseline, more: StoredBaseline) -> StoredBaseline:
    """Baselines of two files of one set-up together.

    Raises
    ------
    InputError
        If rate, window length, hop, taper, channels or units differ, which is named, or an override
        stands in both.
    """
    names = {
        "rate": "rate",
        "window_length": "window length",
        "hop": "hop",
        "taper": "taper",
        "channels": "channels",
        "units": "units",
    }
    for attribute, name in names.items():
        before, now = getattr(first, attribute), getattr(more, attribute)
        if before != now:
            raise InputError(
                f"the file of baselines has the {name} {_listed(before)}, the new one has "
                f"{_listed(now)}; one file holds one set-up, write another."
            )
    there = {each.override for each in first.overrides}
    for each in more.overrides:
        if each.override in there:
            raise InputError(
                f"the file already holds a baseline at override {each.override:g} %; name another "
                "override, or write a new file."
            )
    both = (*first.overrides, *more.overrides)
    return StoredBaseline(
        first.rate,
        first.window_length,
        first.hop,
        first.taper,
        first.channels,
        first.units,
        both,
    )


def air_cut_at(
    baselines: StoredBaseline,
    spindle_speed: float,
    override: float | None = None,
    channels: Sequence[str] | None = None,
) -> AirCut:
    """The baseline of a file for one spindle speed.

    Parameters
    ----------
    baselines : StoredBaseline
        From a file.
    spindle_speed : float [1/min]
        The baseline nearest to it is taken; whether it is near enough is for
        `require_matching` to say.
    override : float, optional [%]
        Takes the baseline of that override instead.
    channels : sequence of str, optional
        Some of its channels, in the order wanted; by default all.

    Returns
    -------
    AirCut
        The baseline.

    Raises
    ------
    InputError
        If there is no such override or channel.
    """
    held = {each.override: each for each in baselines.overrides}
    if override is not None and override not in held:
        known = ", ".join(f"{each:g}" for each in held)
        raise InputError(
            f"there is no baseline at override {override:g} %, only at {known}; choose one of them "
            "or add it."
        )
    if override is None:
        override = min(held, key=lambda each: abs(held[each].spindle_speed - spindle_speed))
    chosen, names = held[override], baselines.channels
    wanted = names if channels is None else tuple(channels)
    for name in wanted:
        if name not in names:
            raise InputError(f"the baseline has no channel '{name}'{nearest(name, names)}.")
    rows = [names.index(name) for name in wanted]
    windowing = Windowing(baselines.rate, baselines.window_length, baselines.hop, baselines.taper)
    moments = Baseline(chosen.count, chosen.mean[rows], chosen.squares[rows])
    return AirCut(windowing, chosen.spindle_speed / 60.0, wanted, moments)


@dataclass(frozen=True)
class Source:
    """What of a recording has to fit a baseline.

    Attributes
    ----------
    rate : float [Hz]
        Sampling rate.
    channels, units : tuple of str
        Names of the channels and their units.
    """

    rate: float
    channels: tuple[str, ...]
    units: tuple[str, ...]


def detector_for(
    baselines: StoredBaseline,
    source: Source,
    spindle_speed: float,
    *,
    override: float | None = None,
    window: int | None = None,
    **settings: Any,
) -> tuple[Detector, list[str]]:
    """Detector for a recording, and what is to be said against its baseline.

    Parameters
    ----------
    baselines : StoredBaseline
        Air cutting.
    source : Source
        Of the recording.
    spindle_speed : float [1/min]
        Of the recording.
    override : float, optional [%]
        Which baseline; by default the nearest in speed.
    window : int, optional
        Window length that is expected.
    **settings
        Of `DetectorSettings`, the windowing excepted.

    Returns
    -------
    detector : Detector
        Ready for the stream.
    warnings : list of str
        A threshold that noise alone passes; a unit that one side does not name; mains lines that
        hide those of the cut.

    Raises
    ------
    InputError
        If the baseline was made at another rate, window length, speed, on other channels or in
        another unit, or a setting is out of its range.
    """
    air = air_cut_at(baselines, spindle_speed, override, source.channels)
    made = air.windowing
    windowing = Windowing(source.rate, window or made.length, made.hop, made.taper)
    require_matching(air, windowing, rotation=spindle_speed / 60.0, channels=source.channels)
    warnings = _about_units(baselines, source)
    detector = prepare(DetectorSettings(windowing, **settings), air)
    warnings += _about_lines(detector)
    noise = noise_score(detector, air)
    if detector.settings.threshold < noise:
        warnings.append(
            f"low threshold: noise alone passes {noise:.4g} in about one of {1 / _ALARM:.0f} "
            f"windows with a baseline of {air.baseline.count} spectra, and the threshold is "
            f"{detector.settings.threshold:g}: raise it or record more air cutting"
        )
    return detector, warnings


def noise_score(detector: Detector, air: AirCut) -> float:
    """Distance that Gaussian noise passes in about one of 1000 windows (`null_threshold`)."""
    searched = int(np.isfinite(detector.scorer.offset).sum())
    return null_threshold(int(air.baseline.count), searched, _ALARM) - 1.0


def after_gap(detector: Detector, state: DetectorState, missing: int | None) -> DetectorState:
    """The state after samples that never came.

    Parameters
    ----------
    detector : Detector
        The detector.
    state : DetectorState
        At the end of the last block before the gap.
    missing : int or None
        How many they are; None where nobody knows.

    Returns
    -------
    DetectorState
        Windows begin anew behind the gap, so that none holds samples of both sides. The votes are
        remembered over a gap no longer than the windows they are of.
    """
    settings = detector.settings
    received = state.received + (missing or 0)
    short = missing is not None and missing <= settings.of * settings.windowing.step
    fresh = restarted(state)
    return fresh._replace(received=received, next=received, cut=state.cut if short else fresh.cut)


@dataclass(frozen=True)
class RecordDetection:
    """What the detector says of a recording.

    Attributes
    ----------
    detector : Detector
        That said it.
    tally : Tally
        What the windows came to.
    events : tuple of Event
        In the order of time.
    bad : BadWindows
        Windows that were not scored.
    warnings : tuple of str
        Faults of the recording by name.
    """

    detector: Detector
    tally: Tally
    events: tuple[Event, ...]
    bad: BadWindows
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON: `windows`, `score_max`, `events`, `rotation_hz` and more."""
        return {
            **self.tally.as_dict(),
            "events": [event_as_dict(event) for event in self.events],
            "threshold": self.detector.settings.threshold,
            "rotation_hz": self.detector.rotation.frequency,
            "bad_windows": self.bad._asdict(),
            "warnings": list(self.warnings),
        }


def detect_record(
    stream: RecordStream,
    detector: Detector,
    trace: Trace | None = None,
    progress: ProgressOption = None,
) -> RecordDetection:
    """The detector over a recording, block by block.

    Parameters
    ----------
    stream : RecordStream
        The recording.
    detector : Detector
        Of its channels.
    trace : Trace, optional
        Is handed every window, for a picture.
    progress : bool or callable, optional
        As for `calibration.progress.reporting`.

    Returns
    -------
    RecordDetection
        The same as of the recording as a whole; of a file that is cut off, what it says as far as
        the file is sound, with a warning.

    Raises
    ------
    InputError
        If the recording holds less than a window, or none that can be scored.
    """
    state, events = start(stream.start), list[Event]()
    tally = Tally(detector.settings.windowing.resolution)
    head: list[np.ndarray] = []
    done, total = 0, stream.length or 0
    with reporting(progress) as report:
        for block in stream:
            if done < _HEAD:
                head.append(block)
            done += len(block)
            state, found, seen = observed(detector, state, block)
            tally.add(seen, found)
            events += found
            if trace is not None:
                trace.add(block, seen)
            report.running("samples", done, total)
    length = detector.settings.windowing.length
    if not tally.windows:
        raise InputError(
            f"{stream.path}: {done} samples are there, fewer than one window of {length}; take a "
            "longer part."
        )
    if sum(state.bad) == tally.windows:
        raise InputError(
            f"{stream.path}: {' '.join(state.bad.sentences)[:-1]}, and none is left; check sensor "
            "and cable."
        )
    warnings = _about_head(np.concatenate(head)[:_HEAD], detector)
    warnings += list(state.bad.sentences)
    if stream.fault is not None and not stream.status.startswith("read to the end"):
        warnings.append(f"truncated: {stream.status}")
    return RecordDetection(detector, tally, tuple(events), state.bad, tuple(warnings))


def event_as_dict(event: Event) -> dict[str, Any]:
    """An event for JSON."""
    return event._asdict()


def _about_head(head: np.ndarray, detector: Detector) -> list[str]:
    """Faults by name in the first part of a recording."""
    warnings = [f"{each.name}: {each.sentence}" for each in flags(head, detector.channels)]
    held = max(held_samples(values) for values in head.T)
    true_end = detector.settings.windowing.rate / (2.0 * held)
    # Up to half the rate the mask is open by default.
    highest = float(detector.settings.windowing.frequencies[detector.free].max())
    if held > 1 and highest > true_end:
        warnings.append(
            f"images: the search goes up to {highest:g} Hz, but above {true_end:g} Hz there are "
            "only images of what lies below: end the band there"
        )
    return warnings


def _about_units(baselines: StoredBaseline, source: Source) -> list[str]:
    """Refuse units that differ; say where only one side names one."""
    warnings = []
    for name, unit in zip(source.channels, source.units, strict=True):
        made = baselines.units[baselines.channels.index(name)]
        if unit == made:
            continue
        if "1" not in (unit, made):
            raise InputError(
                f"the baseline of channel '{name}' is in {made}, the record in {unit}; record air "
                "cutting again with the same sensor."
            )
        named = made if unit == "1" else unit
        warnings.append(
            f"unit: channel '{name}' is in {named} by the "
            f"{'baseline' if unit == '1' else 'record'} alone: see that both are scaled alike"
        )
    return warnings


def _about_lines(detector: Detector) -> list[str]:
    """Whether the lines of the machine hide those by which a cut is noticed."""
    scorer, windowing = detector.scorer, detector.settings.windowing
    counted = np.flatnonzero((scorer.weights > 0.0).any(axis=0)) + scorer.low
    low, high = scorer.low * windowing.resolution, (scorer.low + scorer.bins) * windowing.resolution
    turning = detector.rotation.frequency
    lines = turning * np.arange(np.ceil(low / turning), np.floor(high / turning) + 1)
    seen = np.isin(np.rint(lines / windowing.resolution), counted)
    if not len(lines) or seen.mean() > 0.5:
        return []
    return [
        f"hidden lines: {int((~seen).sum())} of {len(lines)} multiples of the rotation are left "
        "out as lines of the mains or the machine, and a cut may go unnoticed: leave them out of "
        "--mains or --ignore, or change the spindle speed a little"
    ]


def _listed(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, tuple) else str(value)
