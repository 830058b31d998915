"""What a loop saw and did, row by row, and the file it is written to."""

import csv
import io
import math
import os
from collections.abc import Sequence
from typing import NamedTuple

from procmodel.io import write_text

HEADINGS = (
    "time [s]",
    "override [%]",
    "spindle speed [1/min]",
    "score [1]",
    "chatter frequency [Hz]",
    "engagement",
    "outcome",
    "decision",
)


class LogRow(NamedTuple):
    """One window, and what was decided on it.

    Attributes
    ----------
    time : float [s]
        End of the window.
    override : float
        At which the tool cut.
    rotation : float [rev/s]
        Speed of the spindle.
    score : float
        Distance from air cutting; NaN where the window was not scored.
    frequency : float [Hz]
        Of the largest distance; NaN where the window was not scored.
    engagement : str
        State of engagement.
    outcome : str
        "stable", "marginal", "chatter", or "" where the window was not judged.
    decision : str
        As a sentence; "" where the override stayed and there was nothing to say.
    """

    time: float
    override: float
    rotation: float
    score: float
    frequency: float
    engagement: str
    outcome: str
    decision: str


def format_log(rows: Sequence[LogRow]) -> str:
    """A log as text.

    Parameters
    ----------
    rows : sequence of LogRow
        In the order of time.

    Returns
    -------
    str
        CSV under `HEADINGS`; a cell is empty where there is no number.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADINGS)
    for row in rows:
        writer.writerow(
            [
                f"{row.time:.4f}",
                f"{100.0 * row.override:.2f}",
                f"{60.0 * row.rotation:.1f}",
                "" if math.isnan(row.score) else f"{row.score:.4g}",
                "" if math.isnan(row.frequency) else f"{row.frequency:.2f}",
                row.engagement,
                row.outcome,
                row.decision,
            ]
        )
    return text.getvalue()


def write_log(path: str | os.PathLike[str], rows: Sequence[LogRow]) -> None:
    """Write a log to a file, completely or not at all.

    Parameters
    ----------
    path : path-like
        The file; one already there is replaced.
    rows : sequence of LogRow
        In the order of time.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    write_text(path, format_log(rows))
