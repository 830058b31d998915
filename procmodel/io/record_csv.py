"""Recordings as text: a header with units, then one row per sample.

`time [s], acceleration y [m/s^2]`: cells separated by commas, semicolons or tabs as in other
tables. A column `time` gives the rate and shows gaps; so does a column `sample [1]` that counts the
samples, if the rate is known. Every other column needs a unit. Signals may hold `nan`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from procmodel.errors import InputError
from procmodel.io.record_clock import first_flaw, rate_of_clock, rounding
from procmodel.io.record_source import Blocks, Channel, Source, reblocked
from procmodel.io.record_table import (
    NO_ROWS,
    RecordHeader,
    Rows,
    decoded,
    is_blank_or_remark,
    parse_rows,
    read_header,
)
from procmodel.io.tables import place

_BYTES_AT_ONCE = 1 << 20


def open_csv(path: Path, rate: float | None = None) -> Source:
    """Open a text recording; see `Source`.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    rate : float, optional [Hz]
        Sampling rate, where the file does not tell it.

    Raises
    ------
    InputError
        If there is no header, a unit is missing or unknown, or the times do not tell the rate.
    """
    with path.open("rb") as file:
        head = read_header(path, _numbered_lines(path, file))
        file.seek(0)
        lines = _numbered_lines(path, file)
        beginning = _first_rows(path, head, lines)
        cut_off = _is_cut_off(file, head)
    found, tolerance = rate_of_rows(path, head, beginning, rate)

    def blocks(picked: Sequence[Channel], first: int, last: int | None, size: int) -> Blocks:
        names = [channel.name for channel in picked]
        pieces = _pieces(path, head, names, rate or found, first, last, cut_off)
        return reblocked(pieces, 0, None, size)

    fault = "the file is cut off within its last row" if cut_off else None
    return Source(path, head.channels, found, blocks, fault, tolerance)


def rate_of_rows(
    path: Path, head: RecordHeader, beginning: Rows, rate: float | None
) -> tuple[float | None, float]:
    """Rate in Hz as the times tell it, and the relative accuracy of that.

    Parameters
    ----------
    path : pathlib.Path
        For errors.
    head : RecordHeader
        The header.
    beginning : Rows
        First rows of the column of times, if there is one.
    rate : float or None [Hz]
        The rate as given.
    """
    if head.time is None or len(beginning.values) == 0:
        return None, 1e-6
    factor = head.factors[head.time]
    times = beginning.values[:, 0] * factor
    resolution = beginning.resolution * factor
    if rate is not None and (rounding(rate, resolution) > 0.5 / rate or len(times) == 1):
        # Times this coarse cannot contradict the rate.
        return None, 1e-6
    try:
        found = rate_of_clock(times, resolution)
        if rounding(found, resolution) > 0.5 / found:
            raise InputError(
                f"'time' is written in steps of {resolution:g} s, too coarse for {found:g} Hz: "
                "write more digits, or give the rate"
            )
    except InputError as error:
        raise InputError(f"{place(path, int(beginning.rows[0]))}: {error}") from error
    return found, max(1e-6, rounding(found, resolution) / float(np.ptp(times)))


def _is_cut_off(file: BinaryIO, head: RecordHeader) -> bool:
    """Whether the last row has no end and fewer cells than the header names."""
    size = file.seek(0, 2)
    file.seek(max(size - _BYTES_AT_ONCE, 0))
    last = file.read().rpartition(b"\n")[2].strip()
    separators = last.count(head.header.separator.encode())
    return bool(last) and not last.startswith(b"#") and separators < len(head.header.cells) - 1


def _pieces(
    path: Path,
    head: RecordHeader,
    names: list[str],
    rate: float | None,
    first: int,
    last: int | None,
    cut_off: bool,
) -> Iterator[np.ndarray]:
    """Samples `first` to `last` as the file is read, their clock checked on the way."""
    clocks = [] if head.clock is None or rate is None else [head.clock]
    factors = np.array([head.factors[name] for name in names])
    clock = _Clock(path, head, rate) if clocks and rate is not None else None
    reached = 0
    with path.open("rb") as file:
        lines = _numbered_lines(path, file)
        for row, _ in lines:
            if row >= head.header.row:
                break
        while batch := _batch(lines):
            if cut_off and not batch[-1][1].endswith("\n"):
                batch.pop()
            rows = parse_rows(path, head, [*clocks, *names], batch)
            if clock is None:
                places = reached + np.arange(len(rows.values))
                reached += len(rows.values)
            else:
                places = clock.places(rows)
            behind = places >= last if last is not None else np.zeros(len(places), bool)
            end = int(np.argmax(behind)) if behind.any() else len(places)
            begin = int(np.argmax(places[:end] >= first)) if (places[:end] >= first).any() else end
            if clock is not None:
                clock.check(rows, begin, end, first, last if behind.any() else None)
            yield rows.values[begin:end, len(clocks) :] * factors
            if behind.any():
                return


class _Clock:
    """Where the rows of a recording belong, and whether those that are read follow evenly."""

    def __init__(self, path: Path, head: RecordHeader, rate: float) -> None:
        assert head.clock is not None
        self._path, self._name = path, head.clock
        counting = head.clock == "sample"
        self._rate, self._unit = (1.0, "samples") if counting else (rate, "s")
        self._factor = 1.0 if counting else head.factors[head.clock]
        self._readings = np.empty(0)
        self._places = np.empty(0, np.int64)
        self._checked: np.ndarray = np.empty(0)
        self._latest = -1

    def places(self, rows: Rows) -> np.ndarray:
        """Number of each row's sample since the beginning, those that are missing included."""
        readings = rows.values[:, 0] * self._factor
        rounded = rounding(self._rate, rows.resolution * self._factor)
        if not len(readings):
            return np.empty(0, np.int64)
        if self._unit == "s" and rounded > 0.5 / self._rate:
            # Such times tell nothing from row to row.
            steps = np.ones(len(readings))
        else:
            before = self._readings[-1:] if len(self._readings) else readings[:1] - 1 / self._rate
            steps = np.rint(np.diff(readings, prepend=before) * self._rate)
        start = int(self._places[-1]) if len(self._places) else -1
        self._readings, self._places = readings, start + np.cumsum(steps).astype(np.int64)
        return self._places

    def check(self, rows: Rows, begin: int, end: int, first: int, last: int | None) -> None:
        """Refuse rows `begin` to `end`, or a part `first` to `last`, that are not even."""
        resolution = rounding(self._rate, rows.resolution * self._factor)
        if self._unit == "s" and resolution > 0.5 / self._rate:
            return
        latest = int(self._places[end - 1]) if end > begin else self._latest
        # Where the part is not complete, the reading behind it shows the gap.
        beyond = end + (last is not None and latest != last - 1)
        self._latest = latest
        if begin < beyond and not len(self._checked) and int(self._places[begin]) != first:
            missing = int(self._places[begin]) - first
            raise self._flaw(rows, begin, f"{missing} samples are missing behind the start")
        readings = np.concatenate([self._checked, self._readings[begin:beyond]])
        flaw = first_flaw(readings, self._rate, resolution, self._unit)
        if flaw is not None:
            raise self._flaw(rows, begin + flaw.at - len(self._checked), flaw.sentence)
        self._checked = readings[-1:]

    def _flaw(self, rows: Rows, at: int, sentence: str) -> InputError:
        row = int(rows.rows[at])
        return InputError(f"{place(self._path, row)}: column '{self._name}': {sentence}")


def _first_rows(path: Path, head: RecordHeader, lines: Iterator[tuple[int, str]]) -> Rows:
    for row, _ in lines:
        if row >= head.header.row:
            break
    names = [] if head.time is None else [head.time]
    batch = _batch(lines)
    while batch and all(is_blank_or_remark(line) for _, line in batch):
        batch = _batch(lines)
    if not batch:
        raise InputError(
            f"{path}: there is a header in row {head.header.row} but no sample below it: add at "
            "least one row of numbers"
        )
    if not batch[-1][1].endswith("\n") and len(batch) > 1:
        # The last row of a file, which may be cut off.
        batch.pop()
    return parse_rows(path, head, names, batch) if names else NO_ROWS


def _batch(lines: Iterator[tuple[int, str]]) -> list[tuple[int, str]]:
    batch, length = [], 0
    for line in lines:
        batch.append(line)
        length += len(line[1])
        if length >= _BYTES_AT_ONCE:
            break
    return batch


def _numbered_lines(path: Path, file: BinaryIO) -> Iterator[tuple[int, str]]:
    for row, content in enumerate(file, start=1):
        yield row, decoded(path, row, content)
