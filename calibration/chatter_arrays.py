"""Scores of labelled cuts as arrays, and the law of noise that they begin from."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.chatter_cuts import LABELS, CutScores
from procmodel.chatter import null_threshold

# Columns of a cut's label, as in `LABELS`.
STABLE_COLUMN, MARGINAL_COLUMN, CHATTER_COLUMN = range(3)
# Windows of a cut that are used: pieces spread over it, each of successive windows.
PIECES, PIECE = 4, 16


@dataclass(frozen=True)
class NullLaw:
    """What the scores of noise alone are.

    Attributes
    ----------
    count : int
        Spectra of the baseline.
    free_bins : int
        Bins of the search, of all channels together.
    averaged : int
        Spectra averaged before the distance.
    """

    count: int
    free_bins: int
    averaged: int = 1

    def quantile(self, share: float) -> float:
        """Quantile of y = log(1 + D) of noise, by `null_threshold`."""
        ratio = null_threshold(self.count, self.free_bins, 1.0 - share, self.averaged)
        return math.log(ratio)


def tools_of(cuts: Sequence[CutScores]) -> tuple[str, ...]:
    """Tools of cuts, in the order in which they first appear."""
    return tuple(dict.fromkeys(cut.tool for cut in cuts))


def speeds_of(cuts: Sequence[CutScores]) -> tuple[float, ...]:
    """Spindle speeds of cuts, rising [1/min]."""
    return tuple(sorted({cut.spindle_speed for cut in cuts}))


def arranged(cuts: Sequence[CutScores], left_out: Sequence[int] = ()) -> dict[str, np.ndarray]:
    """Cuts as arrays of one row each.

    Parameters
    ----------
    cuts : sequence of CutScores
        Labelled cuts.
    left_out : sequence of int
        Cuts of weight 0.

    Returns
    -------
    dict of str to ndarray
        `windows`, shape (c, w), y of the windows used, of pieces spread over a long cut; `used`
        and `first` (of a piece), of bool; `centre`, `weight`, shape (c,); `share`, `tool`,
        `speed`, whose columns tell label, tool and speed.
    """
    picked = [_picked(len(cut.scores)) for cut in cuts]
    width = max(len(places) for places, _ in picked)
    windows, used = np.zeros((len(cuts), width)), np.zeros((len(cuts), width), bool)
    first = np.zeros((len(cuts), width), bool)
    for i, (cut, (places, starts)) in enumerate(zip(cuts, picked, strict=True)):
        windows[i, : len(places)] = cut.log_scores[places]
        used[i, : len(places)] = True
        first[i, starts] = True
    weight = np.ones(len(cuts))
    weight[list(left_out)] = 0.0
    tools, speeds = tools_of(cuts), speeds_of(cuts)

    def columns(values: list[Any], known: Sequence[Any]) -> np.ndarray:
        return np.array([[float(value == each) for each in known] for value in values])

    return {
        "windows": windows,
        "used": used,
        "first": first,
        "centre": np.array([_centre(w[u]) for w, u in zip(windows, used, strict=True)]),
        "weight": weight,
        "share": columns([cut.label for cut in cuts], LABELS),
        "tool": columns([cut.tool for cut in cuts], tools),
        "speed": columns([cut.spindle_speed for cut in cuts], speeds),
    }


def _picked(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Windows to use of a cut of so many, and which of those begin a piece."""
    if count <= PIECES * PIECE:
        return np.arange(count), np.array([0])
    begins = np.linspace(0, count - PIECE, PIECES).round().astype(int)
    places = (begins[:, None] + np.arange(PIECE)).ravel()
    return places, np.arange(PIECES) * PIECE


def _centre(values: np.ndarray, freedom: float = 5.0) -> float:
    """Location of Student's t, by reweighting from the median."""
    centre = float(np.median(values))
    scale = 1.4826 * float(np.median(np.abs(values - centre)))
    scale = scale if scale > 0.0 else 1.0
    for _ in range(20):
        weights = (freedom + 1.0) / (freedom + ((values - centre) / scale) ** 2)
        centre = float(np.sum(weights * values) / np.sum(weights))
    return centre
