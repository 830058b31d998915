"""What the chatter commands share: options, the detector they make, events as rows of a table."""

import csv
import io
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from procmodel.errors import InputError

if TYPE_CHECKING:
    from calibration.chatter_detection import Source
    from procmodel.chatter import Detector, Event
    from procmodel.io.baselines import StoredBaseline

# Of the averaged rule over that of the distance, where it is not given: the detector's own.
_AVERAGED_SHARE = 0.5

Record = Annotated[
    Path,
    typer.Argument(
        help="Recording: TDMS, WAV, HDF5, MAT, or CSV with a header such as "
        "'time [s], acceleration y [m/s^2]'."
    ),
]
Rate = Annotated[
    float | None,
    typer.Option("--rate", help="Sampling rate [Hz], where the file does not hold it."),
]
SpindleSpeed = Annotated[
    float, typer.Option("--spindle-speed", help="Spindle speed of the recording [1/min].")
]
Channel = Annotated[
    list[str] | None,
    typer.Option(
        "--channel",
        help="Channel by name; repeat for more. Left out: all, or those of the baseline.",
    ),
]
BaselineFile = Annotated[
    Path, typer.Option("--baseline", help="Air cutting, written by 'chatter baseline'.")
]
Override = Annotated[
    float | None,
    typer.Option(
        "--override", help="Take the baseline of this override [%]; else the nearest in speed."
    ),
]
Window = Annotated[
    int | None,
    typer.Option("--window", help="Window length [samples], to check that of the baseline."),
]
Threshold = Annotated[
    float | None,
    typer.Option("--threshold", help="Of the distance from air cutting; 100 if left out."),
]
AveragedThreshold = Annotated[
    float | None,
    typer.Option(
        "--averaged-threshold",
        help="Of the distance of the averaged spectrum; half of --threshold if left out, 0 for "
        "without, as with --tuned.",
    ),
]
Tuned = Annotated[
    Path | None,
    typer.Option(
        "--tuned",
        help="JSON of 'chatter tune': take its threshold, and draw its interval.",
    ),
]
Band = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--band", help="Lowest and highest frequency of the search [Hz].", metavar="LO HI"
    ),
]
Teeth = Annotated[
    int | None,
    typer.Option("--teeth", help="Teeth of the tool, to search for period doubling too."),
]
Votes = Annotated[
    int, typer.Option("--votes", help="Windows above the threshold that make chatter ...")
]
Of = Annotated[int, typer.Option("--of", help="... out of so many in a row.")]
Mains = Annotated[
    float | None, typer.Option("--mains", help="Mains frequency to leave out, with multiples [Hz].")
]
Ignore = Annotated[
    list[float] | None,
    typer.Option("--ignore", help="Line of the machine to leave out [Hz]; repeat for more."),
]
Limit = Annotated[
    float | None,
    typer.Option("--limit", help="Range of the sensor, at which it clips [unit of the channel]."),
]
Marginal = Annotated[
    bool, typer.Option("--report-marginal", help="Events for cuts that come near, too.")
]

EVENT_HEADINGS = (
    "time [s]",
    "frequency [Hz]",
    "score [-]",
    "state",
    "statistic",
    "growth rate [1/s]",
    "channel",
)


def require_speed(spindle_speed: float) -> None:
    """Refuse a spindle speed that is not above 0."""
    if not 0.0 < spindle_speed < math.inf:
        raise InputError(f"--spindle-speed is {spindle_speed:g}, but must be above 0.")


def chosen_threshold(
    threshold: float | None, tuned: Path | None
) -> tuple[float, tuple[float, float] | None]:
    """Threshold and its interval, from the options.

    Parameters
    ----------
    threshold : float, optional
        As given.
    tuned : Path, optional
        JSON of `chatter tune`.

    Returns
    -------
    value : float
        The threshold; 100 where nothing is given.
    interval : tuple of float, optional
        Of the tuned one.

    Raises
    ------
    InputError
        If both are given, the file holds no threshold, or it is not above 0.
    """
    interval = None
    if tuned is not None:
        if threshold is not None:
            raise InputError("--threshold and --tuned both give a threshold: give one of them.")
        threshold, interval = _read_tuned(tuned)
    value = 100.0 if threshold is None else threshold
    if not 0.0 < value < math.inf:
        raise InputError(f"--threshold is {value:g}, but must be above 0.")
    return value, interval


def settings_of(
    threshold: float,
    averaged_threshold: float | None,
    band: tuple[float, float] | None,
    teeth: int | None,
    votes: int,
    of: int,
    mains: float | None,
    ignore: list[float] | None,
    limit: float | None,
    report_marginal: bool,
    tuned: Path | None,
) -> dict[str, Any]:
    """Options as settings of the detector, the windowing excepted.

    Raises
    ------
    InputError
        If the band is not one; what else is out of range the settings say themselves.
    """
    low, high = band or (0.0, math.inf)
    if not 0.0 <= low < high:
        raise InputError(f"--band is {low:g} {high:g}, but must rise from 0 or more.")
    for line in ignore or ():
        if not 0.0 < line < math.inf:
            raise InputError(f"--ignore is {line:g}, but must be above 0.")
    if averaged_threshold is None and tuned is None:
        # What is promised of a tuned threshold is promised of its votes alone.
        averaged_threshold = _AVERAGED_SHARE * threshold
    return {
        "band": (low, high),
        "threshold": threshold,
        "averaged_threshold": averaged_threshold or None,
        "teeth": teeth,
        "votes": votes,
        "of": of,
        "mains": mains,
        "ignored": tuple(ignore or ()),
        "limit": limit,
        "report_marginal": report_marginal,
    }


def detector_from(
    path: Path,
    baselines: "StoredBaseline",
    source: "Source",
    spindle_speed: float,
    settings: dict[str, Any],
) -> "tuple[Detector, list[str]]":
    """`calibration.chatter_detection.detector_for`, its errors with the file of baselines."""
    from calibration.chatter_detection import detector_for

    try:
        return detector_for(baselines, source, spindle_speed, **settings)
    except InputError as error:
        if "baseline" not in str(error):
            raise
        raise InputError(f"{path}: {error}") from error


def event_rows(events: "Iterable[Event]") -> str:
    """Events as rows of a table under `EVENT_HEADINGS`, numbers with all their digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for event in events:
        writer.writerow("" if value is None else value for value in event)
    return text.getvalue()


def as_text(result: dict[str, Any], channels: Iterable[str], warnings: Iterable[str]) -> list[str]:
    """What a detection came to, in lines for people."""
    lines = [
        f"status       {result['status']}",
        f"windows      {result['windows']}: "
        + ", ".join(f"{count} {name}" for name, count in result["states"].items()),
        f"rotation     {result['rotation_hz']:.4f} Hz on {', '.join(channels)}",
    ]
    if result["score_max"] is not None:
        lines.append(
            f"score        at most {result['score_max']:.4g} at "
            f"{result['score_max_time_s']:.3f} s, threshold {result['threshold']:g}"
        )
    if result["score_max_air"] is not None:
        lines.append(f"in air       at most {result['score_max_air']:.4g}")
    if result["chatter_frequency_hz"] is not None:
        lines.append(
            f"chatter      {result['chatter_frequency_hz']:.1f} Hz over the cut, "
            f"{result['score_max_frequency_hz']:.1f} Hz at the highest score"
        )
    return [*lines, *(f"warning  {_ended(each)}" for each in warnings)]


def _ended(sentence: str) -> str:
    return sentence.rstrip(".") + "."


def _read_tuned(path: Path) -> tuple[float, tuple[float, float] | None]:
    from procmodel.io.textfile import read_utf8

    try:
        found = json.loads(read_utf8(path))["threshold"]
        value = float(found["value"])
        interval = found.get("interval90")
        return value, None if interval is None else (float(interval[0]), float(interval[1]))
    except (ValueError, LookupError, TypeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path}: there is no 'threshold' with a 'value' in it; write it with "
            "'procmodel chatter tune --json'."
        ) from error
