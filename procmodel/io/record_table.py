"""Recordings as text: their header with units, and their rows, one per sample."""

from __future__ import annotations

import codecs
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from procmodel.errors import InputError
from procmodel.io.header import Column, Header, locate, parse_header
from procmodel.io.record_clock import printed_resolution
from procmodel.io.record_source import Channel
from procmodel.io.record_units import si_unit, split_heading
from procmodel.io.tables import is_number, place

_TIME, _COUNT = Column("time", "s", required=False), Column("sample", "1", required=False)
_EXAMPLE = "'time [s], acceleration y [m/s^2]'"


class Rows(NamedTuple):
    """Rows of numbers.

    Attributes
    ----------
    values : numpy.ndarray, shape (k, columns)
        Numbers of the wanted columns, in the unit of the file.
    rows : numpy.ndarray, shape (k,), int
        Line number in the file of each, from 1.
    resolution : float
        Unit of the last printed digit of the time; 0 where that is not read.
    faulty : int
        Rows that were passed over because they hold something else than numbers.
    """

    values: np.ndarray
    rows: np.ndarray
    resolution: float
    faulty: int


NO_ROWS = Rows(np.empty((0, 0)), np.empty(0, np.int64), 0.0, 0)


@dataclass(frozen=True)
class RecordHeader:
    """What the header of a text recording says.

    Attributes
    ----------
    header : Header
        The line itself.
    positions : dict of str to int
        Column of each channel, the clock among them.
    factors : dict of str to float
        From the unit of the file to SI.
    channels : tuple of Channel
        The signals.
    clock : str or None
        Name of the column that tells where a sample belongs: the count, else the time.
    time : str or None
        Name of the column of times.
    """

    header: Header
    positions: dict[str, int]
    factors: dict[str, float]
    channels: tuple[Channel, ...]
    clock: str | None
    time: str | None


def read_header(path: Path, lines: Iterator[tuple[int, str]]) -> RecordHeader:
    """Header of a text recording, from numbered lines that are consumed up to the first row.

    Raises
    ------
    InputError
        As for `open_csv`.
    """
    remarks: list[tuple[int, str]] = []
    for row, line in lines:
        if not is_blank_or_remark(line):
            break
        if line.strip():
            remarks.append((row, line))
    else:
        raise InputError(f"{path}: there are no samples: begin the file with {_EXAMPLE}")
    header = parse_header(row, line, ())
    if is_number(header.cells[0].replace(",", ".")):
        candidates = [parse_header(*remark, ()) for remark in remarks]
        known = [each for each in candidates if any(split_heading(c)[1] for c in each.cells)]
        if not known:
            raise InputError(
                f"{place(path, row)}: the recording starts with numbers instead of a header: "
                f"write {_EXAMPLE} above them"
            )
        header = known[-1]
    try:
        return _understood(path, header)
    except InputError as error:
        raise InputError(f"{place(path, header.row)}: {error}") from error


def _understood(path: Path, header: Header) -> RecordHeader:
    positions: dict[str, int] = {}
    factors: dict[str, float] = {}
    for column in (_TIME, _COUNT):
        located = locate(header, column)
        if located is not None:
            positions[column.name], factors[column.name] = located
    time, count = ("time" if "time" in positions else None), "sample" in positions
    channels = []
    for position, cell in enumerate(header.cells):
        if position in positions.values():
            continue
        name, unit = split_heading(cell)
        if not name:
            raise InputError(f"column {position + 1} has no name: write it, as in {_EXAMPLE}")
        if not unit:
            raise InputError(
                f"column '{name}' has no unit: write '{name} [m/s^2]', or '{name} [1]' for a plain "
                "number"
            )
        if name in positions:
            raise InputError(f"column '{name}' stands twice: keep one of them")
        try:
            factors[name], si = si_unit(unit)
        except InputError as error:
            raise InputError(f"column '{name}': {error}") from error
        positions[name] = position
        channels.append(Channel(name, si))
    if not channels:
        raise InputError("there is no signal: add a column such as 'acceleration y [m/s^2]'")
    return RecordHeader(
        header, positions, factors, tuple(channels), "sample" if count else time, time
    )


def parse_rows(
    path: Path,
    head: RecordHeader,
    names: Sequence[str],
    lines: Sequence[tuple[int, str]],
    skip_faulty: bool = False,
) -> Rows:
    """Numbers of some columns.

    Parameters
    ----------
    path : pathlib.Path
        For errors.
    head : RecordHeader
        The header.
    names : sequence of str
        Columns to read.
    lines : sequence of (int, str)
        Lines with their numbers; blank ones and remarks are passed over.
    skip_faulty : bool
        Pass over rows that do not hold numbers, and count them, rather than refuse them.

    Raises
    ------
    InputError
        If a row does not hold a number in each wanted column.
    """
    kept = [(row, line) for row, line in lines if not is_blank_or_remark(line)]
    separator, positions = head.header.separator, [head.positions[name] for name in names]
    texts = [line.strip(" \r\n").replace('"', "") for _, line in kept]
    if separator != ",":
        _require_one_decimal_sign(path, kept)
        texts = [text.replace(",", ".") for text in texts]
    rows = np.array([row for row, _ in kept], np.int64)
    resolution = 0.0
    if head.time in names:
        last = [text.split(separator) for text in texts[-201:]]
        at = head.positions["time"]
        resolution = printed_resolution([cells[at] for cells in last if len(cells) > at])
    wanted = len(head.header.cells) - 1
    try:
        if any(text.count(separator) != wanted for text in texts):
            raise ValueError
        values = (
            np.loadtxt(
                texts,
                delimiter=separator,
                usecols=positions,
                ndmin=2,
                comments=None,
                quotechar=None,
            )
            if texts
            else np.empty((0, len(names)))
        )
        clocks = [index for index, name in enumerate(names) if name in ("time", "sample")]
        if not np.isfinite(values[:, clocks]).all():
            raise ValueError
        return Rows(values, rows, resolution, 0)
    except ValueError:
        # One by one, to find the row that is at fault.
        parsed, sound = [], []
        for index, ((row, _), text) in enumerate(zip(kept, texts, strict=True)):
            try:
                parsed.append(_parsed_row(path, head, names, row, text))
                sound.append(index)
            except InputError:
                if not skip_faulty:
                    raise
        values = np.array(parsed, np.float64).reshape(-1, len(names))
        return Rows(values, rows[sound], resolution, len(kept) - len(sound))


def _parsed_row(
    path: Path, head: RecordHeader, names: Sequence[str], row: int, text: str
) -> list[float]:
    separator = head.header.separator
    cells = [cell.strip() for cell in text.split(separator)]
    named = len(head.header.cells)
    if len(cells) < named:
        raise InputError(
            f"{place(path, row)}: {len(cells)} of the {named} cells that the header names: "
            "complete the row or delete it"
        )
    if any(cells[named:]):
        remedy = "write decimal points, or separate the columns by semicolons"
        raise InputError(
            f"{place(path, row)}: {len(cells)} cells where the header names {named}: "
            f"{remedy if separator == ',' else 'delete those that have no name'}"
        )
    values = []
    for name in names:
        cell = cells[head.positions[name]]
        finite = name not in ("time", "sample")
        if not is_number(cell) or not (finite or np.isfinite(float(cell))):
            problem = f"holds '{cell}', which is not a number" if cell else "is empty"
            raise InputError(
                f"{place(path, row)}: column '{name}' {problem}: write a number such as 12.5, or "
                "nan for a sample of a signal that was lost"
            )
        values.append(float(cell))
    return values


def decoded(path: Path, row: int, content: bytes) -> str:
    """Text of a line.

    Raises
    ------
    InputError
        If it is not UTF-8.
    """
    if row == 1:
        if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or b"\0" in content:
            raise InputError(
                f"{path}: this is binary or UTF-16, not a recording that can be read: save it as "
                "TDMS, WAV, HDF5, MAT or CSV UTF-8"
            )
        content = content.removeprefix(codecs.BOM_UTF8)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{place(path, row)}: byte 0x{content[error.start]:02x} is not UTF-8 text: save it as "
            "CSV UTF-8"
        ) from error


def _require_one_decimal_sign(path: Path, lines: Sequence[tuple[int, str]]) -> None:
    commas = next((row for row, line in lines if "," in line), None)
    points = next((row for row, line in lines if "." in line), None)
    if commas is not None and points is not None:
        raise InputError(
            f"{place(path, *sorted({commas, points}))}: decimal commas and decimal points in one "
            "table: use one of them throughout, and nothing to group thousands"
        )


def is_blank_or_remark(line: str) -> bool:
    """Whether a line holds no numbers by design."""
    text = line.strip()
    return not text or text.startswith("#")
