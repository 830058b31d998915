"""Pieces that reports are put together from."""

from collections.abc import Iterable, Sequence


def aligned(table: Sequence[Sequence[str]], indent: str = "") -> list[str]:
    """Rows of cells as lines with their columns under each other.

    Parameters
    ----------
    table : sequence of sequence of str
        Rows of equal length.
    indent : str
        What every line begins with.

    Returns
    -------
    list of str
        One line for each row.
    """
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    rows = ("  ".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)) for row in table)
    return [f"{indent}{row}".rstrip() for row in rows]


def sections(titled: Iterable[tuple[str, Sequence[str]]]) -> list[str]:
    """Sentences under their titles, each section after an empty line; none for an empty one.

    Parameters
    ----------
    titled : iterable of (str, sequence of str)
        Titles and sentences without their full stop.

    Returns
    -------
    list of str
        The lines.
    """
    lines: list[str] = []
    for title, sentences in titled:
        if sentences:
            lines += ["", title, *(f"  {sentence}." for sentence in sentences)]
    return lines
