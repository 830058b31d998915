"""Readers of what has come so far of a recording: bytes in, samples and gaps out."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from procmodel.errors import InputError
from procmodel.io.record_clock import rounding
from procmodel.io.record_csv import rate_of_rows
from procmodel.io.record_source import (
    Channel,
    Source,
    agreed_rate,
    numbered,
    picked_channels,
)
from procmodel.io.record_table import RecordHeader, decoded, parse_rows, read_header
from procmodel.io.record_units import si_unit, split_heading
from procmodel.io.record_wav import WavHeader, read_wav_header, wav_samples

_LONGEST_HEADER = 1 << 20
# So many rows tell the rate to within the rounding of printed times.
_ROWS_FOR_CHECK, _ROWS_FOR_RATE = 32, 1024


class Block(NamedTuple):
    """Samples as they came.

    Attributes
    ----------
    first : int
        Number of the first of them since the beginning, those that are missing included.
    samples : numpy.ndarray, shape (k, c)
        In the units of the follower.
    """

    first: int
    samples: np.ndarray


class Gap(NamedTuple):
    """Samples that never came.

    Attributes
    ----------
    first : int
        Number of the first of them.
    missing : int or None
        How many there are; None after the source has started anew.
    sentence : str
        What happened.
    """

    first: int
    missing: int | None
    sentence: str


@dataclass
class Counts:
    """What a follower has seen so far.

    Attributes
    ----------
    samples : int
        Samples handed over.
    gaps, missing : int
        Gaps, and the samples missing in them.
    repeated_blocks, repeated : int
        Stretches that came twice, and the samples in them, which were dropped.
    restarts : int
        How often the clock went back to start anew.
    faulty : int
        Rows that held no numbers, which were dropped.
    """

    samples: int = 0
    gaps: int = 0
    missing: int = 0
    repeated_blocks: int = 0
    repeated: int = 0
    restarts: int = 0
    faulty: int = 0


@dataclass(frozen=True)
class Wanted:
    """What a follower was asked for; see `follow`.

    Attributes
    ----------
    path : pathlib.Path
        The file, for errors.
    rate : float or None [Hz]
        Sampling rate as given.
    channels : str, sequence of str or None
        Names of the channels.
    raw : sequence of str or None
        Headings of bare floats.
    longest_repeat : float [s]
        By how much a clock may go back before it counts as started anew.
    file_size : callable () -> int, or None
        Bytes in the file by now; None for a stream.
    """

    path: Path
    rate: float | None
    channels: str | Sequence[str] | None
    raw: Sequence[str] | None
    longest_repeat: float
    file_size: Callable[[], int] | None


class Reader(Protocol):
    """Takes bytes as they come and gives what is complete.

    Attributes
    ----------
    rate : float [Hz]
        Sampling rate.
    picked : tuple of Channel
        Channels that are handed over.
    clocked : bool
        Whether a clock shows gaps and repetitions.
    counts : Counts
        Where they are counted.
    """

    rate: float
    picked: tuple[Channel, ...]
    clocked: bool
    counts: Counts

    def add(self, content: bytes) -> None:
        """Take what has come."""

    def items(self) -> Iterator[Block | Gap]:
        """What is complete and was not given before."""


def reader_for(wanted: Wanted, content: bytes, ended: bool, counts: Counts) -> Reader | None:
    """Reader for what the beginning of a recording shows it to be.

    Parameters
    ----------
    wanted : Wanted
        What was asked for.
    content : bytes
        What has come so far.
    ended : bool
        Whether no more will come.
    counts : Counts
        Where the reader shall count.

    Returns
    -------
    Reader or None
        None where the content does not tell enough yet.

    Raises
    ------
    InputError
        If the recording cannot be followed or its header is faulty, a channel is missing, or the
        rate unknown or contradicted.
    """
    if wanted.raw is not None:
        return _FloatReader(wanted, wanted.raw, content, counts)
    if len(content) < 12 and not ended:
        return None
    if content[:4] in (b"RIFF", b"RF64"):
        header = read_wav_header(io.BytesIO(content), wanted.path)
        if header is None:
            return None
        return _WavReader(wanted, header, content, counts)
    if content[:4] == b"TDSm" or content[:8] == b"\x89HDF\r\n\x1a\n" or content[:6] == b"MATLAB":
        raise InputError(
            f"{wanted.path}: only tables of text and WAV can be followed while they are "
            "written: record to one of these, or read the file once it is closed"
        )
    return _TableReader.started(wanted, content, ended, counts)


class _FloatReader:
    """Bare 32-bit floats."""

    clocked = False

    def __init__(self, wanted: Wanted, raw: Sequence[str], content: bytes, counts: Counts) -> None:
        described, factors = [], []
        for heading in raw:
            name, unit = split_heading(heading)
            if not unit:
                raise InputError(
                    f"raw channel '{heading}' has no unit: write '{name} [m/s^2]', or "
                    f"'{name} [1]' for a plain number"
                )
            factor, si = si_unit(unit)
            described.append(Channel(name, si))
            factors.append(factor)
        self.picked = picked_channels(_described(wanted.path, described), wanted.channels)
        self.rate = agreed_rate(wanted.path, wanted.rate, None, 0.0)
        self.counts = counts
        self._columns = [described.index(channel) for channel in self.picked]
        self._factors = np.array(factors)[self._columns]
        self._count, self._content, self._first = len(described), content, 0

    def add(self, content: bytes) -> None:
        self._content += content

    def items(self) -> Iterator[Block | Gap]:
        whole = len(self._content) - len(self._content) % (4 * self._count)
        if whole:
            values = np.frombuffer(self._content[:whole], "<f4").reshape(-1, self._count)
            self._content = self._content[whole:]
            with np.errstate(invalid="ignore"):
                samples = values[:, self._columns].astype(np.float64) * self._factors
            yield Block(self._first, samples)
            self._first += len(values)


class _WavReader:
    """A WAV file whose header may not say yet how long it will be."""

    clocked = False

    def __init__(self, wanted: Wanted, header: WavHeader, content: bytes, counts: Counts) -> None:
        described = [Channel(name, "1") for name in numbered("data", header.count)]
        self.picked = picked_channels(_described(wanted.path, described), wanted.channels)
        self.rate = agreed_rate(wanted.path, wanted.rate, header.rate, 1e-6)
        self.counts = counts
        self._path, self._header, self._file_size = wanted.path, header, wanted.file_size
        self._columns = [described.index(channel) for channel in self.picked]
        self._content, self._first = content[header.begin :], 0

    def add(self, content: bytes) -> None:
        self._content += content

    def items(self) -> Iterator[Block | Gap]:
        frame = self._header.frame
        end = self._end()
        there = len(self._content)
        if end is not None:
            there = max(min(there, end - self._first * frame), 0)
        whole = there - there % frame
        if whole:
            values = wav_samples(self._content[:whole], self._header)[:, self._columns]
            self._content = self._content[whole:]
            yield Block(self._first, values)
            self._first += len(values)

    def _end(self) -> int | None:
        """Bytes of samples once the header is final; remarks may follow them in the file."""
        if self._file_size is None:
            return self._header.size or None
        with self._path.open("rb") as file:
            header = read_wav_header(file, self._path)
        # Writers set the sizes when they close the file; before that they do not fit it.
        final = header is not None and header.size and header.total == self._file_size()
        return header.size if header is not None and final else None


class _TableReader:
    """A table of text, with or without a clock."""

    def __init__(
        self,
        path: Path,
        head: RecordHeader,
        picked: tuple[Channel, ...],
        rate: float,
        clocked: bool,
        longest_repeat: float,
        counts: Counts,
    ) -> None:
        self.rate, self.picked, self.clocked, self.counts = rate, picked, clocked, counts
        self._longest_back = longest_repeat * rate
        self._path, self._head = path, head
        self._lines: list[tuple[int, str]] = []
        self._rest, self._row = b"", 0
        self._first = 0
        self._latest: float | None = None
        self._repeating = False

    @classmethod
    def started(
        cls, wanted: Wanted, content: bytes, ended: bool, counts: Counts
    ) -> _TableReader | None:
        """Reader, once header and enough rows to tell or to check the rate are there."""
        path, rate = wanted.path, wanted.rate
        complete, _, _ = content.rpartition(b"\n")
        lines = [
            (row, decoded(path, row, line) if row == 1 else line.decode(errors="replace"))
            for row, line in enumerate(complete.split(b"\n"), start=1)
        ]
        if not any(line.strip() and not line.lstrip().startswith("#") for _, line in lines):
            if len(content) > _LONGEST_HEADER:
                decoded(path, 1, content[:_LONGEST_HEADER])
                raise InputError(f"{path}: no header in the first MiB: write one line with units")
            return None
        head = read_header(path, iter(lines))
        below = [line for line in lines if line[0] > head.header.row]
        names = [] if head.time is None else [head.time]
        rows = parse_rows(path, head, names, below, skip_faulty=True)
        found, tolerance = None, 1e-3
        if names:
            count = len(rows.values)
            if count < _ROWS_FOR_CHECK and not ended:
                return None
            try:
                found, tolerance = rate_of_rows(path, head, rows, rate)
            except InputError:
                # Where the rate is given, gaps at the very start are the clock's affair.
                if rate is None:
                    raise
            if rate is None and tolerance > 1e-4 and count < _ROWS_FOR_RATE and not ended:
                return None
        used = agreed_rate(path, rate, found, max(tolerance, 1e-3))
        coarse = False
        if head.clock == "time":
            coarse = rounding(used, rows.resolution * head.factors["time"]) > 0.5 / used
        picked = picked_channels(_described(path, head.channels), wanted.channels)
        clocked = head.clock is not None and not coarse
        reader = cls(path, head, picked, used, clocked, wanted.longest_repeat, counts)
        reader.add(content)
        return reader

    def add(self, content: bytes) -> None:
        complete, mark, rest = (self._rest + content).rpartition(b"\n")
        self._rest = rest
        if not mark:
            return
        for line in complete.split(b"\n"):
            self._row += 1
            if self._row > self._head.header.row:
                self._lines.append((self._row, line.decode(errors="replace")))

    def items(self) -> Iterator[Block | Gap]:
        lines, self._lines = self._lines, []
        names = [channel.name for channel in self.picked]
        clocks = [self._head.clock] if self.clocked and self._head.clock else []
        rows = parse_rows(self._path, self._head, [*clocks, *names], lines, skip_faulty=True)
        self.counts.faulty += rows.faulty
        if not len(rows.values):
            return
        samples = rows.values[:, len(clocks) :] * [self._head.factors[name] for name in names]
        if not clocks:
            yield Block(self._first, samples)
            self._first += len(samples)
            return
        beat = 1.0 if clocks[0] == "sample" else self._head.factors["time"] * self.rate
        yield from self._placed(rows.values[:, 0] * beat, samples)

    def _placed(self, places: np.ndarray, samples: np.ndarray) -> Iterator[Block | Gap]:
        """Samples in the order of the clock, whose readings are in sampling intervals."""
        while len(places):
            if self._latest is None:
                self._latest = float(places[0]) - 1.0
            reached = np.maximum.accumulate(np.concatenate([[self._latest], places[:-1]]))
            anew = np.flatnonzero(places < reached - self._longest_back)
            end = int(anew[0]) if len(anew) else len(places)
            yield from self._fresh(places[:end], samples[:end], reached[:end])
            if end < len(places):
                back = (float(reached[end]) - float(places[end])) / self.rate
                self.counts.restarts += 1
                self.counts.gaps += 1
                yield Gap(
                    self._first, None, f"the clock went back by {back:g} s: the source started anew"
                )
                self._latest, self._repeating = None, False
            places, samples = places[end:], samples[end:]

    def _fresh(
        self, places: np.ndarray, samples: np.ndarray, reached: np.ndarray
    ) -> Iterator[Block | Gap]:
        """What did not come before, with the gaps in it."""
        fresh = places > reached + 0.5
        again = np.concatenate([[self._repeating], ~fresh])
        self.counts.repeated += int(np.sum(~fresh))
        self.counts.repeated_blocks += int(np.sum(again[1:] & ~again[:-1]))
        self._repeating = bool(again[-1])
        places, samples = places[fresh], samples[fresh]
        if not len(places):
            return
        assert self._latest is not None
        steps = np.rint(np.diff(places, prepend=self._latest)).astype(np.int64)
        self._latest = float(places[-1])
        cuts = sorted({0, *np.flatnonzero(steps > 1).tolist(), len(places)})
        for start, end in pairwise(cuts):
            missing = int(steps[start]) - 1
            if missing > 0:
                self.counts.gaps += 1
                self.counts.missing += missing
                plural = "s are" if missing > 1 else " is"
                at = self._first / self.rate
                yield Gap(self._first, missing, f"{missing} sample{plural} missing at {at:.6g} s")
                self._first += missing
            yield Block(self._first, samples[start:end])
            self._first += end - start


def _described(path: Path, channels: Sequence[Channel]) -> Source:
    def blocks(*_: object) -> Iterator[np.ndarray]:
        return iter(())

    return Source(path, tuple(channels), None, blocks)
