"""Tables of numbers written as text that `read_table` reads back."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from procmodel.io.atomic import write_text


def format_table(
    columns: Mapping[str, ArrayLike], decimals: int = 6, comments: Sequence[str] = ()
) -> str:
    """Table as text, separated by commas.

    Parameters
    ----------
    columns : mapping of str to array-like, shape (n,)
        Values under their headings with units, `feed [um]`. Integers stay integers.
    decimals : int
        Decimals of every other number, fixed so that a column reads straight down. The default
        keeps a length in um to the picometre.
    comments : sequence of str
        Lines that go before the header, each behind a `#`.

    Returns
    -------
    str
        The table, each line ended by a newline.

    Raises
    ------
    ValueError
        If the columns differ in length, a heading or a comment would break the table, or a value
        is not finite.
    """
    arrays = {heading: np.asarray(values) for heading, values in columns.items()}
    lengths = {heading: array.shape for heading, array in arrays.items()}
    if len(set(lengths.values())) > 1 or any(len(shape) != 1 for shape in lengths.values()):
        raise ValueError(f"columns of a table must be flat and equally long, not {lengths}")
    for heading in columns:
        if set(heading) & set(',;\t\r\n"') or heading.lstrip().startswith("#"):
            raise ValueError(f"heading {heading!r} holds a sign that has a meaning in a table")
    if any("\0" in comment for comment in comments):
        raise ValueError("a comment holds a null character, which text files must not")
    texts = [_format_column(heading, array, decimals) for heading, array in arrays.items()]
    remarks = [f"# {line}".rstrip() for comment in comments for line in comment.splitlines()]
    lines = [*remarks, ",".join(columns), *(",".join(cells) for cells in zip(*texts, strict=True))]
    return "\n".join(lines) + "\n"


def write_table(
    path: str | os.PathLike[str],
    columns: Mapping[str, ArrayLike],
    decimals: int = 6,
    comments: Sequence[str] = (),
) -> None:
    """Write a table to a file, completely or not at all.

    Parameters
    ----------
    path : path-like
        The file; one already there is replaced.
    columns, decimals, comments
        As for `format_table`.

    Raises
    ------
    InputError
        If the file cannot be written.
    ValueError
        As for `format_table`.
    """
    write_text(path, format_table(columns, decimals, comments))


def _format_column(heading: str, values: np.ndarray, decimals: int) -> list[str]:
    if np.issubdtype(values.dtype, np.integer):
        return [str(value) for value in values.tolist()]
    numbers = np.asarray(values, dtype=np.float64)
    if not np.all(np.isfinite(numbers)):
        raise ValueError(f"column {heading!r} holds a value that is not finite")
    # The z writes the zero that a small negative number rounds to without its sign.
    return [f"{number:z.{decimals}f}" for number in numbers.tolist()]
