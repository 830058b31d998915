"""The header line of a table: which columns there are, in which unit, and what separates them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches

from procmodel.errors import InputError
from procmodel.io.units import conversion_factor, is_unit

# A header of one cell fits each of them; the first, the comma, then stays the separator, so that
# a decimal comma or a forgotten column below it is refused instead of guessed at.
SEPARATORS = (",", ";", "\t")


@dataclass(frozen=True)
class Column:
    """A column that a reader asks for.

    Attributes
    ----------
    name : str
        Its name in the header, in any case; `spindle speed` also finds `spindle_speed`.
    unit : str
        The unit in which the values are handed over, whatever unit the file uses; `-` for a
        plain number.
    required : bool
        Whether a file without this column is an error.
    positive : bool
        Whether every value must be greater than zero.
    """

    name: str
    unit: str
    required: bool = True
    positive: bool = False

    @property
    def heading(self) -> str:
        """The column as it should stand in a header, `x [um]`."""
        return f"{self.name} [{self.unit}]"


@dataclass(frozen=True)
class Heading:
    """One cell of a header line, read as the heading of a wanted column.

    Attributes
    ----------
    position : int
        Which cell of its line it is, from 0.
    unit : str or None
        The unit as written; None where the name stands alone.
    """

    position: int
    unit: str | None


@dataclass(frozen=True)
class Header:
    """A line that names columns.

    Attributes
    ----------
    row : int
        Its line number in the file, from 1.
    separator : str
        What separates its cells.
    cells : tuple of str
        The names and units as written.
    """

    row: int
    separator: str
    cells: tuple[str, ...]


def parse_header(row: int, line: str, columns: Sequence[Column]) -> Header:
    """Split a header line at the separator under which it names most of the wanted columns."""
    text = line.lstrip().lstrip("#").strip()
    readings = [
        Header(row, separator, _split_outside_brackets(text, separator)) for separator in SEPARATORS
    ]
    return max(
        readings, key=lambda header: (*wanted_columns_named(header, columns), len(header.cells))
    )


def wanted_columns_named(header: Header, columns: Sequence[Column]) -> tuple[int, int]:
    """How many wanted columns the line names with a unit, and how many it names at all."""
    found = [_headings(header, column) for column in columns]
    with_unit = sum(any(heading.unit is not None for heading in each) for each in found)
    return with_unit, sum(bool(each) for each in found)


def locate(header: Header, column: Column) -> tuple[int, float] | None:
    """Position of a column, and the factor from its unit in the file to the wanted one.

    Returns
    -------
    tuple of (int, float) or None
        None where the file lacks a column that is not required.

    Raises
    ------
    InputError
        If a required column is missing, a column stands twice, or its unit is missing, unknown
        or one of another quantity. The text leaves it to the caller to name the file and row.
    """
    headings = _headings(header, column)
    if not headings and column.required:
        raise InputError(_missing(header, column))
    if not headings:
        return None
    if len(headings) > 1:
        places = " and ".join(f"'{header.cells[heading.position]}'" for heading in headings)
        raise InputError(f"column '{column.name}' stands twice ({places}): keep one of them")
    (heading,) = headings
    if heading.unit is None:
        raise InputError(f"column '{column.name}' has no unit: write '{column.heading}'")
    try:
        return heading.position, conversion_factor(heading.unit, column.unit)
    except InputError as error:
        raise InputError(f"column '{column.name}': {error}") from error


def _split_outside_brackets(text: str, separator: str) -> tuple[str, ...]:
    """Cells of a header; a separator inside brackets belongs to a remark, not to the table."""
    cells, depth, start = [], 0, 0
    for index, character in enumerate(text):
        if character in "([":
            depth += 1
        elif character in ")]":
            depth = max(depth - 1, 0)
        elif character == separator and depth == 0:
            cells.append(text[start:index])
            start = index + 1
    cells.append(text[start:])
    names = [cell.strip().strip('"').strip() for cell in cells]
    while len(names) > 1 and not names[-1]:
        names.pop()
    return tuple(names)


def _headings(header: Header, column: Column) -> list[Heading]:
    """Cells that name `column`, in any of the accepted forms."""
    certain, doubtful = [], []
    for position, cell in enumerate(header.cells):
        rest = _rest_after_name(cell, column.name)
        if rest is None:
            continue
        bracketed = re.match(r"\s*(?:\[([^\]]*)\]|\(([^)]*)\))(?![\w,;])", rest)
        appended = re.match(r"_([^\s(\[,;]+)(?=[\s(\[]|$)(.*)", rest)
        if bracketed:
            unit = bracketed.group(1) if bracketed.group(1) is not None else bracketed.group(2)
            certain.append(Heading(position, unit.strip() or None))
        elif appended and not is_unit(_leading_bracket(appended.group(2))):
            unit = appended.group(1)
            # `z_min` may be a depth in minutes or the lowest depth: it is taken for column z only
            # where the unit fits, or where nothing else in the line could be that column.
            if _fits(unit, column):
                certain.append(Heading(position, unit))
            elif is_unit(unit):
                doubtful.append(Heading(position, unit))
        elif _is_bare(rest, column):
            certain.append(Heading(position, None))
    return certain or doubtful[:1]


def _is_bare(rest: str, column: Column) -> bool:
    """Whether a name stands without a unit, or with one in no accepted form (`x um`)."""
    if not rest.strip() or rest.lstrip()[0] in "([":
        return True
    return rest[0].isspace() and len(rest.split()) == 1 and _fits(rest, column)


def _rest_after_name(cell: str, name: str) -> str | None:
    """What follows the column's name at the beginning of a cell, or None if it is not there."""
    words = r"[\s_]+".join(re.escape(word) for word in name.split())
    match = re.match(words + r"(?=[\s_(\[]|$)", cell, flags=re.IGNORECASE)
    return None if match is None else cell[match.end() :]


def _leading_bracket(text: str) -> str:
    """The word in a bracket that `text` begins with, else nothing."""
    match = re.match(r"\s*[\[(]([^\s\])]*)[\])]", text)
    return match.group(1) if match else ""


def _fits(unit: str, column: Column) -> bool:
    try:
        conversion_factor(unit, column.unit)
    except InputError:
        return False
    return True


def _missing(header: Header, column: Column) -> str:
    """Sentence for a column that is not there, with what is there instead."""
    found = [cell for cell in header.cells if cell]
    listed = ", ".join(f"'{cell}'" for cell in found)
    names = [re.split(r"[\[(]", cell)[0].strip().lower() for cell in found]
    nearest = get_close_matches(column.name.lower(), names, n=1)
    if nearest:
        remedy = f"rename '{found[names.index(nearest[0])]}' to '{column.heading}'"
    elif len(found) == 1:
        remedy = f"add '{column.heading}', with a comma, semicolon or tab between columns"
    else:
        remedy = f"name the column '{column.heading}'"
    return f"no column '{column.name}' among {listed}: {remedy}"
