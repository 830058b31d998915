"""From a table of labelled cuts to the scores of their windows.

LABELS.csv -> `LabelledCut` -> recording and baseline -> detector -> `CutScores`
"""

import csv
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calibration.chatter_detection import Source, air_cut_at, detector_for
from procmodel.chatter import CHATTER, CUTTING, MARGINAL, STABLE, Detector, detect
from procmodel.chatter.scoring import measured
from procmodel.chatter.spectrum import windows_of
from procmodel.errors import InputError, nearest
from procmodel.io.baselines import StoredBaseline
from procmodel.io.header import Column, Header, locate, parse_header
from procmodel.io.records import Record, read_record
from procmodel.io.tables import place
from procmodel.io.textfile import read_utf8

LABELS = (STABLE, MARGINAL, CHATTER)
# No largest distance of several bins is lower; the logarithm needs a floor all the same.
_LOWEST = -0.9
_TEXTS = ("file", "label", "tool")
_NUMBERS = (
    Column("spindle speed", "1/min", positive=True),
    Column("start", "s", required=False),
    Column("stop", "s", required=False),
    Column("rate", "Hz", required=False, positive=True),
)
_HEADER = "file,label,spindle speed [1/min],tool"


@dataclass(frozen=True, eq=False)
class CutScores:
    """Scores of the windows of one labelled cut.

    Attributes
    ----------
    label : str
        "stable", "marginal" or "chatter".
    tool : str
        Name of the tool.
    spindle_speed : float [1/min]
        Spindle speed.
    scores : ndarray, shape (w,)
        Score D of every window, in the order of time.
    step : float [s]
        From the beginning of a window to that of the next.
    length : float [s]
        From the beginning of a window to the instant at which its score is known.
    name : str
        What errors call it, such as "labels.csv, row 3".
    distances : ndarray or None, shape (w, bins)
        Largest distance over the channels in every bin, `nan` where a bin is left out.
    frequencies : ndarray or None, shape (bins,) [Hz]
        Of the bins.

    Raises
    ------
    InputError
        If the label is unknown, there is no window, or a score is not finite.
    """

    label: str
    tool: str
    spindle_speed: float
    scores: np.ndarray
    step: float
    length: float
    name: str = ""
    distances: np.ndarray | None = None
    frequencies: np.ndarray | None = None

    def __post_init__(self) -> None:
        where = f"{self.name}: " if self.name else ""
        if self.label not in LABELS:
            raise InputError(f"{where}label {self.label!r} is unknown{nearest(self.label, LABELS)}")
        scores = np.asarray(self.scores, float)
        if scores.ndim != 1 or not len(scores):
            raise InputError(f"{where}there is no score: take a longer part of the cut")
        if not np.isfinite(scores).all():
            raise InputError(f"{where}score {int(np.argmin(np.isfinite(scores))) + 1} is no number")
        if not (self.step > 0.0 and self.length > 0.0):
            raise InputError(f"{where}step and length of a window must be above 0")
        object.__setattr__(self, "scores", scores)

    @property
    def log_scores(self) -> np.ndarray:
        """Logarithms y = log(1 + D), shape (w,): the logarithm of power over that of air."""
        return np.log1p(np.maximum(self.scores, _LOWEST))


@dataclass(frozen=True)
class LabelledCut:
    """A row of a table of labelled cuts.

    Attributes
    ----------
    file : pathlib.Path
        The recording.
    label, tool : str
        As written.
    spindle_speed : float [1/min]
        Spindle speed.
    start, stop : float or None [s]
        Part of the recording.
    rate : float or None [Hz]
        Sampling rate, where the file does not hold it.
    name : str
        File and row, for errors.
    """

    file: Path
    label: str
    tool: str
    spindle_speed: float
    start: float | None
    stop: float | None
    rate: float | None
    name: str


def read_labels(path: str | os.PathLike[str]) -> list[LabelledCut]:
    """Read a table of labelled cuts.

    Parameters
    ----------
    path : path-like
        Columns `file`, `label` (stable, marginal, chatter), `spindle speed [1/min]`, `tool`, and
        `start [s]`, `stop [s]`, `rate [Hz]`, whose cells may be empty. Files are relative to the
        folder of the table.

    Returns
    -------
    list of LabelledCut
        In the order of the rows.

    Raises
    ------
    InputError
        If a column, cell or recording is missing or cannot be used; the text names file and row.
    """
    path = Path(path)
    lines = [
        (row, line)
        for row, line in enumerate(read_utf8(path).splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise InputError(f"{path}: the table is empty: begin it with a header, {_HEADER}")
    header = parse_header(*lines[0], _NUMBERS)
    texts = {name: _text_column(path, header, name) for name in _TEXTS}
    numbers = {}
    for column in _NUMBERS:
        try:
            found = locate(header, column)
        except InputError as error:
            raise InputError(f"{place(path, header.row)}: {error}") from error
        if found is not None:
            numbers[column.name] = (found, column)
    if len(lines) == 1:
        raise InputError(f"{path}: there is a header but no cut below it: add a row for each cut")
    return [_labelled(path, header, row, line, texts, numbers) for row, line in lines[1:]]


def _text_column(path: Path, header: Header, name: str) -> int:
    """Position of a column without a unit."""
    cells = [cell.lower() for cell in header.cells]
    if name in cells and cells.count(name) == 1:
        return cells.index(name)
    listed = ", ".join(f"'{cell}'" for cell in header.cells)
    fault = f"stands twice among {listed}: keep one of them"
    if name not in cells:
        fault = f"is missing among {listed}: begin the table with a header, {_HEADER}"
    raise InputError(f"{place(path, header.row)}: column '{name}' {fault}")


def _labelled(
    path: Path,
    header: Header,
    row: int,
    line: str,
    texts: dict[str, int],
    numbers: dict[str, tuple[tuple[int, float], Column]],
) -> LabelledCut:
    name = place(path, row)
    cells = [cell.strip() for cell in next(csv.reader([line], delimiter=header.separator))]
    cells += [""] * (len(header.cells) - len(cells))
    if any(cells[len(header.cells) :]):
        raise InputError(
            f"{name}: {len(cells)} cells where the header names {len(header.cells)}: write decimal "
            "points, and quote or rename a file with a separator in its name"
        )
    found: dict[str, str] = {}
    for key, at in texts.items():
        found[key] = cells[at]
        if not cells[at]:
            raise InputError(f"{name}: column '{key}' is empty: fill it in or delete the row")
    label = found["label"].lower()
    if label not in LABELS:
        raise InputError(f"{name}: label '{found['label']}' is unknown{nearest(label, LABELS)}")
    values: dict[str, float | None] = {}
    for key, ((at, factor), column) in numbers.items():
        cell = cells[at] if header.separator == "," else cells[at].replace(",", ".")
        values[key] = _number(name, cell, factor, column)
    start, stop = values.get("start"), values.get("stop")
    if start is not None and stop is not None and not start < stop:
        raise InputError(f"{name}: start {start:g} s is not before stop {stop:g} s: correct them")
    file = path.parent / found["file"]
    if not file.is_file():
        raise InputError(f"{name}: there is no file '{found['file']}' in {path.parent}: correct it")
    speed = values["spindle speed"] or math.nan
    return LabelledCut(file, label, found["tool"], speed, start, stop, values.get("rate"), name)


def _number(name: str, cell: str, factor: float, column: Column) -> float | None:
    """A cell as a number in its wanted unit; None where it is empty and may be."""
    if not cell and not column.required:
        return None
    try:
        value = float(cell) * factor
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or value < 0.0 or (column.positive and value == 0.0):
        least = "above 0" if column.positive else "of 0 or more"
        raise InputError(
            f"{name}: column '{column.name}' holds '{cell}': write a number {least} such as 12.5"
        )
    return value


def score_cuts(
    labelled: Sequence[LabelledCut],
    baselines: StoredBaseline,
    *,
    channels: Sequence[str] | None = None,
    window: int | None = None,
    averaged: int = 1,
    keep_distances: bool = False,
    **settings: Any,
) -> tuple[list[CutScores], Detector]:
    """Score the windows of labelled cuts in which the tool cuts, as the detector would.

    Parameters
    ----------
    labelled : sequence of LabelledCut
        From `read_labels`.
    baselines : StoredBaseline
        Air cutting, at the spindle speeds of all cuts.
    channels : sequence of str, optional
        Some of its channels; by default all.
    window : int, optional
        Window length that is expected.
    averaged : int
        Spectra averaged before the distance; 1 for single windows.
    keep_distances : bool
        Keep the distance in every bin too, for `calibration.plans.threshold_tuning`.
    **settings
        Of `DetectorSettings`, such as `band` and `mains`.

    Returns
    -------
    cuts : list of CutScores
        One for each row.
    detector : Detector
        Of the last one.

    Raises
    ------
    InputError
        If a recording cannot be read or does not fit a baseline, or the tool does not cut in it;
        the text names file and row.
    """
    if averaged < 1:
        raise InputError(f"averaged spectra are {averaged}, but must be at least 1.")
    wanted = baselines.channels if channels is None else tuple(channels)
    if averaged > 1:
        settings |= {"averaged": averaged, "averaged_threshold": 1.0}
    cuts, detector = [], None
    for each in labelled:
        try:
            record = read_record(each.file, each.rate, wanted, each.start, each.stop)
            source = Source(record.rate, record.channels, record.units)
            detector, _ = detector_for(
                baselines, source, each.spindle_speed, window=window, **settings
            )
            cuts.append(_scored(each, record, detector, averaged, keep_distances))
        except InputError as error:
            text = str(error)
            said = text if text.startswith(each.name) else f"{each.name}: {text}"
            raise InputError(said) from error
    if detector is None:
        raise InputError("there is no labelled cut: add a row for each.")
    return cuts, detector


def _scored(
    each: LabelledCut, record: Record, detector: Detector, averaged: int, keep_distances: bool
) -> CutScores:
    """Scores of the windows of one recording in which the tool cuts."""
    windowing = detector.settings.windowing
    seen = detect(detector, record.samples).observations
    cutting = np.array([o.engagement == CUTTING and not o.fault for o in seen], bool)
    cutting = _within(cutting, -(-windowing.length // windowing.step) + 1)
    if averaged > 1:
        scores = [
            o.averaged
            for o, cuts in zip(seen, cutting, strict=True)
            if cuts and o.averaged is not None
        ]
    else:
        scores = [o.score for o, cuts in zip(seen, cutting, strict=True) if cuts]
    if not len(scores):
        if seen and all(o.fault for o in seen):
            faults = ", ".join(sorted({o.fault for o in seen}))
            raise InputError(f"{each.file.name}: every window is {faults}: check the sensor")
        raise InputError(
            f"{each.file.name}: the tool cuts in none of {len(seen)} windows, or in fewer than are "
            "averaged: correct start and stop, or record the baseline again"
        )
    step, length = windowing.step / windowing.rate, windowing.length / windowing.rate
    length += (averaged - 1) * step
    distances = frequencies = None
    if keep_distances:
        windows = windows_of(record.samples, windowing.length, windowing.step)[: len(cutting)]
        distances = _distances(np.ascontiguousarray(windows[cutting]), detector)
        first, bins = detector.scorer.low, detector.scorer.bins
        frequencies = windowing.frequencies[first : first + bins]
    return CutScores(
        each.label,
        each.tool,
        each.spindle_speed,
        np.array(scores),
        step,
        length,
        each.name,
        distances,
        frequencies,
    )


def _within(cutting: np.ndarray, reach: int) -> np.ndarray:
    """Cutting windows without the last ones before an exit, which are partly of the air behind it.

    A cut so short that none would be left keeps all of them.
    """
    kept = cutting.copy()
    for end in np.flatnonzero(cutting[:-1] & ~cutting[1:]):
        kept[max(0, end + 1 - reach) : end + 1] = False
    return kept if kept.any() else cutting


def _distances(windows: np.ndarray, detector: Detector) -> np.ndarray:
    """Largest distance over the channels in every bin, shape (w, bins)."""
    scorer = detector.scorer
    raw = measured(windows, scorer).raw
    searched = np.isfinite(scorer.offset)
    offset = np.where(searched, scorer.offset, 0.0)
    distances = np.where(searched, raw * scorer.gain - offset, -np.inf).max(axis=1)
    return np.where(searched.any(axis=0), distances, np.nan)


def null_numbers(detector: Detector, baselines: StoredBaseline, speed: float) -> tuple[int, int]:
    """Spectra of a baseline, and free bins of all channels: what the law of noise takes."""
    air = air_cut_at(baselines, speed, channels=detector.channels)
    return int(air.baseline.count), int(np.isfinite(detector.scorer.offset).sum())
