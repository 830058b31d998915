"""Chatter: scores of recordings beside bare transforms and plain NumPy, the stream, its memory."""

import time
from functools import partial

import numpy as np
import scipy.fft

from benchmarks import chatter_plant, measure
from benchmarks.report import Section
from benchmarks.sizes import Sizes
from procmodel.chatter import (
    AirCut,
    Detector,
    DetectorSettings,
    Windowing,
    air_cut,
    observed,
    prepare,
    scores,
    start,
    windows_of,
)

RATE, LENGTH, CHANNELS = 51_200.0, 4096, 4
ROTATION, TEETH = 250.0, 2
# Bands of the search [Hz]: a mode of a slender tool, of a short one, everything the sensor sees.
BANDS = ((200.0, 5000.0), (200.0, 10_000.0), (200.0, 25_000.0))
# The paper's sampling for the long replay: 25.6 kHz, head acceleration and holder displacement.
REPLAY_RATE, REPLAY_CHANNELS = 25_600.0, 2
AGREEMENT = 1e-9


def run(section: Section, sizes: Sizes) -> None:
    _batch(section, sizes)
    _recordings(section, sizes)
    _stream(section, sizes)
    _replay(section, sizes)
    chatter_plant.run(section, sizes)


def vibration(rate: float, seconds: float, channels: int, lines: float, seed: int) -> np.ndarray:
    """Noise with forced lines of a given amplitude, shape (k, channels)."""
    random = np.random.default_rng(seed)
    at = np.arange(int(rate * seconds)) / rate
    forced = sum(np.sin(2 * np.pi * k * ROTATION * at + k) for k in range(1, 9))
    return random.normal(size=(len(at), channels)) + lines * forced[:, None]


def _air(rate: float, channels: int, hop: int | None = None) -> AirCut:
    windowing = Windowing(rate, LENGTH, hop=hop)
    return air_cut(vibration(rate, 6.0, channels, 0.5, 0), windowing, ROTATION)


def by_numpy(windows: np.ndarray, air: AirCut, free: np.ndarray) -> np.ndarray:
    """Scores as a user would write them: taper, spectrum, distance, largest over free bins."""
    taper = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(LENGTH) / LENGTH)
    power = np.abs(np.fft.rfft(windows * taper, axis=-1)) ** 2
    power *= 2.0 / (LENGTH * np.sum(taper**2))
    sigma = np.sqrt(np.asarray(air.baseline.squares) / (air.baseline.count - 1))
    distance = (power - np.asarray(air.baseline.mean)) / sigma
    return distance[..., free].max(axis=(1, 2))


def _batch(section: Section, sizes: Sizes) -> None:
    section.heading("Scores of a recording")
    section.text(
        f"Windows of {LENGTH} samples, Hann taper, {RATE / 1e3:g} kHz, one after the other, "
        f"{sizes.chatter_seconds:g} s for each channel. The fraction is the time of a bare "
        "`scipy.fft.rfft` of the same windows in one call over that of the whole score."
    )
    rows = []
    for channels in (1, CHANNELS):
        air = _air(RATE, channels, hop=LENGTH)
        samples = vibration(RATE, sizes.chatter_seconds, channels, 1.0, 1)
        windows = windows_of(samples, LENGTH, LENGTH)
        for band in BANDS:
            settings = DetectorSettings(air.windowing, band, teeth=TEETH)
            searched = prepare(settings, air).scorer
            free = np.zeros(air.windowing.bins, bool)
            free[searched.low : searched.low + searched.bins] = searched.gain[0] > 0.0
            turns = measure.interleaved(
                {
                    "ours": partial(scores, samples, air, settings),
                    "rfft": partial(scipy.fft.rfft, windows, axis=-1, workers=1),
                    "NumPy": partial(by_numpy, windows, air, free),
                },
                sizes.chatter_repeats,
            )
            mine = turns.seconds["ours"]
            fraction = turns.seconds["rfft"] / mine
            found = turns.outcomes["ours"].score
            worst = float(np.max(np.abs(found / turns.outcomes["NumPy"] - 1.0)))
            name = f"{channels} channel{'s' if channels > 1 else ''}, to {band[1] / 1e3:g} kHz"
            rows.append(
                [
                    name, measure.time_spread(mine / len(windows)), measure.spread(fraction),
                    measure.ratio(turns.seconds["NumPy"], mine), f"{worst:.0e}",
                ]
            )  # fmt: skip
            section.target(
                f"fraction of a bare transform, {name}", "at least 0.8",
                measure.spread(fraction), bool(np.median(fraction) >= 0.8),
            )  # fmt: skip
            section.target(
                f"scores as plain NumPy has them, {name}", f"at most {AGREEMENT:g} apart",
                f"{worst:.0e}", worst <= AGREEMENT,
            )  # fmt: skip
    section.table(
        ["recording", "time per window", "fraction of rfft", "NumPy / ours", "apart"], rows
    )


def _recordings(section: Section, sizes: Sizes) -> None:
    section.heading("Growth with the recording")
    air = _air(RATE, 1)
    settings = DetectorSettings(air.windowing, BANDS[1], teeth=TEETH)
    rows, each = [], []
    for seconds in sizes.chatter_recordings:
        samples = vibration(RATE, seconds, 1, 1.0, 2)
        call = partial(scores, samples, air, settings)
        call()
        taken = np.array([measure.timed(call)[0] for _ in range(3)])
        each.append(float(np.median(taken)) / air.windowing.count(len(samples)))
        rows.append([f"{seconds:g} s", measure.time_spread(taken), f"{1e6 * each[-1]:.1f}"])
    section.table(["recording, half overlap", "time", "µs per window"], rows)
    section.target(
        f"time per window of {sizes.chatter_recordings[-1]:g} s over "
        f"{sizes.chatter_recordings[0]:g} s",
        "at most 1.5", f"{each[-1] / each[0]:.2f}", each[-1] <= 1.5 * each[0],
    )  # fmt: skip


def _detector(rate: float, channels: int) -> Detector:
    air = _air(rate, channels, hop=LENGTH)
    return prepare(DetectorSettings(air.windowing, (200.0, 0.4 * rate), teeth=TEETH), air)


def _stream(section: Section, sizes: Sizes) -> None:
    section.heading("The stream")
    detector = _detector(RATE, CHANNELS)
    # Air and cutting in turns, so that every rule has work to do.
    parts = [vibration(RATE, 4.0, CHANNELS, lines, 3) for lines in (0.5, 6.0)]
    blocks = np.concatenate(parts).reshape(-1, LENGTH, CHANNELS)
    state, taken = start(), np.empty(sizes.chatter_blocks)
    for i in range(-50, len(taken)):
        block = blocks[i % len(blocks)]
        begin = time.perf_counter()
        state, _, _ = observed(detector, state, block)
        if i >= 0:
            taken[i] = time.perf_counter() - begin
    middle, late, last = 1e3 * np.quantile(taken, [0.5, 0.99, 1.0])
    section.text(
        f"{len(taken)} blocks of {LENGTH} samples, {CHANNELS} channels at {RATE / 1e3:g} kHz, a "
        f"window each, all rules on: median {middle:.2f} ms, 99 % within {late:.2f} ms, the "
        f"longest {last:.1f} ms. A block lasts {1e3 * LENGTH / RATE:.0f} ms."
    )
    section.target("99 % of the windows of the stream", "below 2 ms", f"{late:.2f} ms", late < 2.0)


def _replay(section: Section, sizes: Sizes) -> None:
    section.heading("A long replay")
    detector = _detector(REPLAY_RATE, REPLAY_CHANNELS)
    parts = [vibration(REPLAY_RATE, 8.0, REPLAY_CHANNELS, lines, 4) for lines in (0.5, 6.0)]
    blocks = np.concatenate(parts).reshape(-1, LENGTH, REPLAY_CHANNELS)
    per_hour = round(3600.0 * REPLAY_RATE / LENGTH)
    state, held, number = start(), [], 0
    begin = time.perf_counter()
    for _ in range(sizes.chatter_hours):
        for _ in range(per_hour):
            state, _, _ = observed(detector, state, blocks[number % len(blocks)])
            number += 1
        held.append(measure.resident_memory())
    seconds = time.perf_counter() - begin
    grown = held[-1] - held[0]
    section.text(
        f"{sizes.chatter_hours} hours at {REPLAY_RATE / 1e3:g} kHz, {REPLAY_CHANNELS} channels, "
        f"{number} windows, took {seconds:.0f} s. Memory of the process after each hour: "
        f"{', '.join(f'{m:.1f}' for m in held)} MiB."
    )
    section.target(
        f"memory gained from the first to the last of {sizes.chatter_hours} hours",
        "below 2 MiB", f"{grown:.2f} MiB", grown < 2.0,
    )  # fmt: skip
