"""A recording in few rows, for pictures: score, state and spectrum over time, loudness by state."""

from collections.abc import Sequence

import numpy as np

from calibration.chatter_tally import STATES, state_of
from procmodel.chatter import Detector, Observation, power_spectra, taper

_MOST_LINES = 400


class Trace:
    """What the windows of a recording came to, in a number of rows that does not grow.

    Once the rows are full, neighbours are joined two by two and a row stands for twice as many
    windows.

    Parameters
    ----------
    detector : Detector
        Whose windows they are.
    origin : float [s]
        Time of the first sample.
    rows : int
        Most rows, an even number.

    Attributes
    ----------
    stride : int
        Windows of a row.
    frequencies : ndarray, shape (lines,) [Hz]
        Of the spectra's lines, which are means over neighbouring bins.
    """

    def __init__(self, detector: Detector, origin: float, rows: int = 2048) -> None:
        self._windowing = windowing = detector.settings.windowing
        self._origin = origin
        self._weights = taper(windowing.taper, windowing.length, np)
        scorer = detector.scorer
        self._band = slice(scorer.low, scorer.low + scorer.bins)
        self._air = np.maximum(detector.air * scorer.scale, np.finfo(float).tiny)
        joined = -(-scorer.bins // _MOST_LINES)
        self._starts = np.arange(0, scorer.bins, joined)
        self._joined = np.diff(self._starts, append=scorer.bins)
        bins = windowing.frequencies[self._band]
        self.frequencies = np.add.reduceat(bins, self._starts) / self._joined
        self.stride, self._count, self._windows = 1, 0, 0
        self._score = np.full(rows, np.nan)
        self._state = np.zeros(rows, int)
        self._over = np.zeros((rows, len(self._starts)))
        self._counts = np.zeros(len(STATES), int)
        self._squares = np.zeros((len(STATES), len(detector.channels)))
        self._heights = np.zeros_like(self._squares)
        self._held, self._first, self._next = np.empty((0, len(detector.channels))), 0, 0

    def add(self, block: np.ndarray, observations: Sequence[Observation]) -> None:
        """Take a block of samples, and what the windows that end in it came to."""
        self._held = np.concatenate([self._held, block])
        length, step = self._windowing.length, self._windowing.step
        for each in observations:
            begin = self._next - self._first
            self._window(self._held[begin : begin + length], each.score, state_of(each))
            self._next += step
        gone = min(max(self._next - self._first, 0), len(self._held))
        self._held, self._first = self._held[gone:].copy(), self._first + gone

    @property
    def ends(self) -> np.ndarray:
        """When the first window of each row is known, and one that would follow the last [s]."""
        first = self._origin + self._windowing.length / self._windowing.rate
        step = self._windowing.step / self._windowing.rate
        rows = np.append(np.arange(self.rows) * self.stride, self._windows)
        return first + rows * step

    @property
    def rows(self) -> int:
        """Rows in use, the last one perhaps of fewer windows."""
        return self._count

    @property
    def score(self) -> np.ndarray:
        """Largest distance of each row, NaN where no window was scored."""
        return self._score[: self._count]

    @property
    def state(self) -> list[str]:
        """Most severe state of each row."""
        return [STATES[code] for code in self._state[: self._count]]

    @property
    def over_air(self) -> np.ndarray:
        """Mean power over that of air cutting, the largest of the channels, (rows, lines)."""
        windows = np.full(self._count, self.stride)
        if self._count:
            windows[-1] = self._windows - self.stride * (self._count - 1)
        return self._over[: self._count] / windows[:, None]

    def loudness(self) -> dict[str, tuple[int, np.ndarray, np.ndarray]]:
        """Windows, root mean square and height from peak to valley of each channel, by state.

        As Rq and Rz of a profile: each window is a sampling length, the height the mean over them.
        """
        found = {}
        for name, count, square, height in zip(
            STATES, self._counts, self._squares, self._heights, strict=True
        ):
            if count:
                found[name] = int(count), np.sqrt(square / count), height / count
        return found

    def _window(self, window: np.ndarray, score: float, state: str) -> None:
        code = STATES.index(state)
        if np.isfinite(window).all():
            self._counts[code] += 1
            self._squares[code] += window.var(axis=0)
            self._heights[code] += np.ptp(window, axis=0)
        row = self._windows // self.stride
        if row == len(self._score):
            self._halve()
            row = self._windows // self.stride
        self._windows += 1
        self._count = row + 1
        self._score[row] = np.fmax(self._score[row], score)
        self._state[row] = max(self._state[row], code)
        if np.isfinite(score):
            power = power_spectra(window.T, self._weights, np)[:, self._band] / self._air
            largest = np.max(power, axis=0)
            self._over[row] += np.add.reduceat(largest, self._starts) / self._joined

    def _halve(self) -> None:
        """Join the rows two by two."""
        half = len(self._score) // 2
        pairs = self._score.reshape(half, 2)
        self._score = np.concatenate([np.fmax(*pairs.T), np.full(half, np.nan)])
        state = self._state.reshape(half, 2).max(axis=1)
        self._state = np.concatenate([state, np.zeros(half, int)])
        over = self._over.reshape(half, 2, -1).sum(axis=1)
        self._over = np.concatenate([over, np.zeros_like(over)])
        self.stride *= 2
