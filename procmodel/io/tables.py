"""Tables of numbers from text files, with their units in the header.

A table is plain text in UTF-8, its columns separated by commas, semicolons or tabs. One line names
the columns and their units, `x [um], z [um]` (also `x (um)` or `x_um`; names in any case). It may
begin with `#`. Blank lines and further lines that begin with `#` are skipped.
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.header import Column, Header, locate, parse_header, wanted_columns_named
from procmodel.io.textfile import read_utf8

__all__ = ["Column", "Table", "place", "read_table"]

Line = tuple[int, str]


@dataclass(frozen=True)
class Table:
    """The wanted columns of a file, in the wanted units.

    Attributes
    ----------
    values : dict of str to numpy.ndarray, shape (n,), float64
        One array per column found, under the name it was asked for.
    rows : numpy.ndarray, shape (n,), int
        Line number in the file of each reading, from 1, so that later errors can name it.
    path : pathlib.Path
        The file.
    """

    values: dict[str, np.ndarray]
    rows: np.ndarray
    path: Path


def read_table(path: str | os.PathLike[str], columns: Sequence[Column]) -> Table:
    """Read the wanted columns of a text file.

    Parameters
    ----------
    path : path-like
        The file; the module's docstring says what it may look like.
    columns : sequence of Column
        What to read. Other columns of the file are ignored.

    Returns
    -------
    Table
        Every value finite, at least one row.

    Raises
    ------
    InputError
        If the file cannot be read, a column or its unit is missing or wrong, or a row does not
        hold a number in each wanted column. The text names the file, the row and the remedy.

    Notes
    -----
    The header is the first line that is not a comment, if it names a wanted column. If it does
    not, the header is the comment above it that names most of them, the first among equals.
    """
    path = Path(path)
    header, data = _header_and_data(path, _numbered_lines(read_utf8(path)), columns)
    positions: dict[str, int] = {}
    factors: dict[str, float] = {}
    for column in columns:
        try:
            located = locate(header, column)
        except InputError as error:
            raise InputError(f"{place(path, header.row)}: {error}") from error
        if located is not None:
            positions[column.name], factors[column.name] = located
    if not data:
        raise InputError(
            f"{path}: there is a header in row {header.row} but no reading below it: "
            "add at least one row of numbers"
        )
    texts = _wanted_texts(path, header, data, positions)
    if header.separator != ",":
        texts = _with_decimal_points(path, data, texts)
    values = {
        column.name: _converted(path, column, data, texts[column.name], factors[column.name])
        for column in columns
        if column.name in positions
    }
    return Table(values, np.array([row for row, _ in data], dtype=np.int64), path)


def place(path: Path, *rows: int) -> str:
    """Where something stands, as errors begin: `profile.csv, row 7`."""
    if not rows:
        return str(path)
    return f"{path}, {'row' if len(rows) == 1 else 'rows'} {' and '.join(map(str, rows))}"


def _numbered_lines(text: str) -> list[Line]:
    """Lines that are not blank, with the line numbers an editor shows."""
    # `str.splitlines` also breaks at form feeds and other signs at which no editor does.
    lines = re.split(r"\r\n|\r|\n", text)
    return [(number, line) for number, line in enumerate(lines, start=1) if line.strip()]


def _header_and_data(
    path: Path, lines: list[Line], columns: Sequence[Column]
) -> tuple[Header, list[Line]]:
    """Find the header by the rule of `read_table`, and the rows of numbers below it."""
    if not lines:
        raise InputError(f"{path}: the file is empty: begin it with a header, {_example(columns)}")
    comments = list(_leading_comments(lines))
    remarks = [parse_header(row, line, columns) for row, line in comments]
    best_remark = max(
        remarks, key=lambda remark: wanted_columns_named(remark, columns), default=None
    )
    data = [line for line in lines[len(comments) :] if not _is_comment(line)]
    if not data:
        if best_remark is None or not any(wanted_columns_named(best_remark, columns)):
            raise InputError(
                f"{path}: the file holds only comments: begin it with a header, {_example(columns)}"
            )
        return best_remark, []

    first = parse_header(*data[0], columns)
    if any(wanted_columns_named(first, columns)):
        return first, data[1:]
    if best_remark is not None and any(wanted_columns_named(best_remark, columns)):
        return best_remark, data
    if any(is_number(cell.replace(",", ".")) for cell in first.cells):
        raise InputError(
            f"{place(path, first.row)}: the table starts with numbers instead of a header: "
            f"write {_example(columns)} above them"
        )
    return first, data[1:]


def _leading_comments(lines: Iterable[Line]) -> Iterable[Line]:
    for line in lines:
        if not _is_comment(line):
            return
        yield line


def _is_comment(line: Line) -> bool:
    return line[1].lstrip().startswith("#")


def _example(columns: Sequence[Column]) -> str:
    """The header that the wanted columns should have."""
    return f"'{', '.join(column.heading for column in columns if column.required)}'"


def _wanted_texts(
    path: Path, header: Header, data: list[Line], positions: dict[str, int]
) -> dict[str, list[str]]:
    """Cells of the wanted columns as text, after checking that each row fits the header."""
    texts: dict[str, list[str]] = {name: [] for name in positions}
    last = max(positions.values(), default=0)
    for row, line in data:
        cells = _cells(line, header.separator)
        if len(cells) <= last:
            raise InputError(
                f"{place(path, row)}: {len(cells)} of the {len(header.cells)} cells that the "
                "header names: complete the row or delete it"
            )
        # A decimal comma in a table separated by commas shows itself by too many cells.
        if any(cell for cell in cells[len(header.cells) :]):
            decimal_comma = "write decimal points, or separate the columns by semicolons"
            raise InputError(
                f"{place(path, row)}: {len(cells)} cells where the header names "
                f"{len(header.cells)}: "
                f"{decimal_comma if header.separator == ',' else 'delete those that have no name'}"
            )
        for name, position in positions.items():
            texts[name].append(cells[position])
    return texts


def _cells(line: str, separator: str) -> list[str]:
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator))]
    return [cell.strip() for cell in line.split(separator)]


def _with_decimal_points(
    path: Path, data: list[Line], texts: dict[str, list[str]]
) -> dict[str, list[str]]:
    """Decimal commas turned into points, unless commas may be meant to group the thousands."""
    row_with: dict[str, int] = {}
    for cells in texts.values():
        for (row, _), cell in zip(data, cells, strict=True):
            for mark in ",.":
                if mark in cell:
                    row_with[mark] = min(row, row_with.get(mark, row))
    if len(row_with) == 2:
        raise InputError(
            f"{place(path, *sorted(set(row_with.values())))}: decimal commas and decimal points "
            "in one table: use one of them throughout, and nothing to group thousands"
        )
    if "," not in row_with:
        return texts
    return {name: [cell.replace(",", ".") for cell in cells] for name, cells in texts.items()}


def _converted(
    path: Path, column: Column, data: list[Line], texts: list[str], factor: float
) -> np.ndarray:
    """Values of a column in its wanted unit, each checked to be a finite number."""
    values = np.empty(len(texts))
    for index, ((row, _), text) in enumerate(zip(data, texts, strict=True)):
        if not is_number(text):
            problem = f"holds '{text}', which is not a number" if text else "is empty"
            raise InputError(
                f"{place(path, row)}: column '{column.name}' {problem}: "
                "write a number such as 12.5, or delete the row"
            )
        value = values[index] = float(text) * factor
        if not math.isfinite(value):
            raise InputError(
                f"{place(path, row)}: column '{column.name}' holds '{text}', not a finite number: "
                "write the reading, or delete the row"
            )
        if column.positive and value <= 0:
            sign = "negative" if value < 0 else "zero"
            raise InputError(
                f"{place(path, row)}: {sign} {column.name} ({text}): correct it to a value "
                "greater than zero, or delete the row"
            )
    return values


def is_number(text: str) -> bool:
    """Whether a cell holds a number."""
    # Python also takes `1_000` for a number; in a table it is a slip.
    if "_" in text:
        return False
    try:
        float(text)
    except ValueError:
        return False
    return True
