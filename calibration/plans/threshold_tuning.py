"""Band, averaging and threshold tuned by gradients on a smooth likeness of the expected cost.

The score of a window is a largest value over a band, of a mean over a whole number of windows, held
against a threshold: nothing of it has a useful derivative. A soft maximum over a band with soft
edges, weights that fade over the windows, and a sigmoid for the alarm have; what they come to is
then judged by the hard score again, on cuts that were left out too.

Notation: D distance, m windows averaged, t threshold of y = log(1 + D); w, T, s widths of the
edges, of the maximum and of the alarm, which shrink as the search goes on.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jax import Array

from calibration.chatter_cuts import CutScores
from calibration.plans.threshold_check import dealt
from calibration.plans.threshold_cost import WINDOW, Costs
from procmodel.chatter import CHATTER, STABLE, soft_band, soft_score
from procmodel.errors import InputError
from procmodel.precision import require_float64

# Windows of a cut that are used, so that long cuts do not count for more work than they tell.
_MOST_WINDOWS = 64
# Narrowest band, in bins, that the search may end with.
_NARROWEST = 6.0
# Widths around the frequency of chatter from which the search begins too.
_AROUND = (0.1, 0.3)


class Softness(NamedTuple):
    """Widths of what is hard in the detector.

    Attributes
    ----------
    edge : float [bins]
        w, of the band's edges.
    temperature : float
        T of the soft maximum, as a share of the median score of stable cuts.
    windows : float
        Over which the weight of a window fades.
    alarm : float
        s, in units of y.
    """

    edge: float = 4.0
    temperature: float = 0.1
    windows: float = 0.4
    alarm: float = 0.3


_STAGES = (Softness(8.0, 0.2, 0.5, 0.4), Softness(), Softness(2.0, 0.05, 0.25, 0.15))


class Setting(NamedTuple):
    """What is tuned.

    Attributes
    ----------
    low, high : float [Hz]
        Edges of the band.
    averaged : float
        Windows m that are averaged before the distance; whole where it is used.
    threshold : float
        Of the score D.
    """

    low: float
    high: float
    averaged: float
    threshold: float


class Spectra(NamedTuple):
    """Distances of labelled cuts, padded to the same number of windows.

    Attributes
    ----------
    distances : ndarray, shape (c, w, bins)
        D; 0 where a bin is left out or a window is not there.
    there : ndarray, shape (c, w) of bool
        Which windows are.
    free : ndarray, shape (bins,)
        1 for a bin that counts.
    frequencies : ndarray, shape (bins,) [Hz]
        Of the bins.
    share : ndarray, shape (c, 2)
        Weight of every cut among the stable and the chattering ones.
    scale : float
        Median score of stable cuts.
    """

    distances: Any
    there: Any
    free: Any
    frequencies: Any
    share: Any
    scale: Any


@dataclass(frozen=True)
class Tuning:
    """What tuning came to.

    Attributes
    ----------
    start, tuned : Setting
        Before, with the best threshold for it, and after.
    cost_start, cost_tuned : float
        Expected cost of a window by the hard score, on the cuts tuned on.
    held_out_start, held_out_tuned : float
        The same on cuts left out, settings and thresholds chosen without them.
    error : float
        Standard error, over cuts, of the difference held out.
    warnings : tuple of str
        What to know.
    """

    start: Setting
    tuned: Setting
    cost_start: float
    cost_tuned: float
    held_out_start: float
    held_out_tuned: float
    error: float
    warnings: tuple[str, ...] = ()

    @property
    def helps(self) -> bool:
        """Whether cuts left out cost less, by more than twice the error of that."""
        return self.held_out_start - self.held_out_tuned > 2.0 * self.error

    @property
    def status(self) -> str:
        """What came of it, as a sentence."""
        costs = f"{self.held_out_start:.3g} to {self.held_out_tuned:.3g} (+- {self.error:.2g})"
        if self.helps:
            return f"tuning helps: the cost of cuts left out falls from {costs}"
        return (
            f"tuning does not help: the cost of cuts left out goes from {costs}, and the settings "
            "given are kept"
        )

    @property
    def chosen(self) -> Setting:
        """The tuned setting if that helps, else the one given."""
        return self.tuned if self.helps else self.start

    def as_dict(self) -> dict[str, Any]:
        """The result as plain JSON types."""
        return {
            **{name: getattr(self, name)._asdict() for name in ("start", "tuned")},
            "cost": {"start": self.cost_start, "tuned": self.cost_tuned},
            "held_out": {
                "start": self.held_out_start,
                "tuned": self.held_out_tuned,
                "error": self.error,
            },
            "helps": self.helps,
            "status": self.status,
        }


def tune_setting(
    cuts: Sequence[CutScores],
    costs: Costs,
    band: tuple[float, float],
    *,
    averaged: int = 1,
    most_averaged: int = 8,
    folds: int = 4,
    seed: int = 0,
) -> Tuning:
    """Tune band, averaging and threshold, and say whether cuts left out gain by it.

    Parameters
    ----------
    cuts : sequence of CutScores
        With their distances in every bin (`keep_distances`); marginal ones are not used.
    costs : Costs
        What errors cost, per window.
    band : tuple of float [Hz]
        Band that the search begins with; no bin outside that of the distances is found.
    averaged : int
        Averaging that it begins with.
    most_averaged : int
        Most windows averaged.
    folds : int
        Shares in which cuts are left out.
    seed : int
        Of the shares.

    Returns
    -------
    Tuning
        Settings and costs.

    Raises
    ------
    InputError
        If a label is missing, distances were not kept, costs are not per window, or a cut is
        shorter than the averaging.
    """
    require_float64("Tuning")
    if costs.per != WINDOW:
        raise InputError("tuning takes the costs of a window: give them per window.")
    used = [cut for cut in cuts if cut.label in (STABLE, CHATTER)]
    for label in (STABLE, CHATTER):
        if sum(cut.label == label for cut in used) < 2:
            raise InputError(
                f"tuning takes two cuts labelled {label}, so that one can be left out: label more."
            )
    shortest = min(len(_kept(cut)) for cut in used)
    most = max(1, min(most_averaged, shortest // 2))
    if not 1 <= averaged <= most:
        raise InputError(
            f"averaged spectra are {averaged}, but must be 1 to {most}, half of the shortest cut."
        )
    start = _start(used, band, averaged)
    tuned = _tuned(used, costs, start, most)
    began = _with_threshold(used, costs, start)
    places = dealt(used, folds, seed)
    before, after = np.zeros(len(used)), np.zeros(len(used))
    for share in sorted(set(places.tolist())):
        inside = [cut for cut, place in zip(used, places, strict=True) if place != share]
        for costs_of, setting in (
            (before, _with_threshold(inside, costs, start)),
            (after, _tuned(inside, costs, start, most)),
        ):
            for i in np.flatnonzero(places == share):
                costs_of[i] = _errors(used[i], setting)
    weights = _weights(used, costs)
    gain = weights * (before - after)
    return Tuning(
        start=began,
        tuned=tuned,
        cost_start=hard_cost(used, costs, began),
        cost_tuned=hard_cost(used, costs, tuned),
        held_out_start=float(weights @ before),
        held_out_tuned=float(weights @ after),
        error=_standard_error(gain, used),
    )


def spectra(cuts: Sequence[CutScores]) -> Spectra:
    """Distances of cuts as arrays.

    Raises
    ------
    InputError
        If a cut came without them, or with other bins than the first.
    """
    kept = [_kept(cut) for cut in cuts]
    first = cuts[0].frequencies
    for cut, distances in zip(cuts, kept, strict=True):
        if first is None or cut.frequencies is None or len(cut.frequencies) != distances.shape[1]:
            raise InputError(f"{cut.name}: distances have no frequencies: keep both.")
        if not np.array_equal(cut.frequencies, first):
            raise InputError(
                f"{cut.name}: its bins are not those of {cuts[0].name}: score all cuts with one "
                "rate, window length and band."
            )
    width = max(map(len, kept))
    bins = kept[0].shape[1]
    distances = np.zeros((len(cuts), width, bins))
    there = np.zeros((len(cuts), width), bool)
    # A bin that some speed leaves out would be worth more in the cuts of another.
    free = np.all([np.isfinite(each).all(axis=0) for each in kept], axis=0)
    for i, each in enumerate(kept):
        distances[i, : len(each)] = np.where(free, np.nan_to_num(each), 0.0)
        there[i, : len(each)] = True
    share = np.array([[cut.label == label for label in (STABLE, CHATTER)] for cut in cuts], float)
    share /= np.maximum(share.sum(axis=0), 1.0)
    tops = [
        np.median(each[:, free].max(axis=1)) for each, s in zip(kept, share, strict=True) if s[0]
    ]
    scale = max(float(np.median(tops)), 1.0) if tops else 1.0
    return Spectra(distances, there, free.astype(float), np.asarray(first), share, scale)


def surrogate(vector: Any, data: Spectra, costs: Costs, softness: Softness, most: int) -> Array:
    """Smooth likeness of the expected cost of a window.

    Parameters
    ----------
    vector : array, shape (4,)
        Logarithms of the band's edges, m, and t.
    data : Spectra
        Labelled cuts.
    costs : Costs
        What errors cost.
    softness : Softness
        Widths; the hard cost is the limit of small ones.
    most : int
        Most windows averaged; the first most - 1 windows of a cut are not judged.

    Returns
    -------
    Array
        A scalar, with a gradient in all four.
    """
    low, high, m, t = jnp.exp(vector[0]), jnp.exp(vector[1]), vector[2], vector[3]
    lags = jnp.arange(most)
    fading = jax.nn.sigmoid((m - lags - 0.5) / softness.windows)
    fading = fading / fading.sum()
    width = data.distances.shape[1]
    mean = sum(fading[j] * data.distances[:, most - 1 - j : width - j] for j in range(most))
    edge = softness.edge * (data.frequencies[1] - data.frequencies[0])
    weights = data.free * soft_band(data.frequencies, low, high, edge)
    score = soft_score(mean, weights, softness.temperature * data.scale)
    y = jnp.log1p(jnp.maximum(score, -0.9))
    alarm = jax.nn.sigmoid((y - t) / softness.alarm)
    judged = data.there[:, most - 1 :]
    of_cut = jnp.where(judged, alarm, 0.0).sum(axis=1) / judged.sum(axis=1)
    false, found = data.share.T @ of_cut
    return costs.expected(false, 1.0 - found)


_value_and_slope = jax.jit(jax.value_and_grad(surrogate), static_argnames=("costs", "most"))


def hard_cost(cuts: Sequence[CutScores], costs: Costs, setting: Setting) -> float:
    """Expected cost of a window by the score as the detector takes it.

    Parameters
    ----------
    cuts : sequence of CutScores
        With their distances.
    costs : Costs
        What errors cost.
    setting : Setting
        Its averaging is rounded to whole windows.

    Returns
    -------
    float
        Every cut counting the same among those of its label.
    """
    return float(_weights(cuts, costs) @ [_errors(cut, setting) for cut in cuts])


def hard_scores(cut: CutScores, setting: Setting) -> np.ndarray:
    """Largest distance in the band of every averaged spectrum, shape (w - m + 1,)."""
    distances, m = _kept(cut), max(1, round(setting.averaged))
    assert cut.frequencies is not None
    inside = (cut.frequencies >= setting.low) & (cut.frequencies <= setting.high)
    inside &= np.isfinite(distances).all(axis=0)
    if not inside.any():
        return np.full(len(distances) - m + 1, -1.0)
    total = np.cumsum(np.concatenate([np.zeros((1, int(inside.sum()))), distances[:, inside]]), 0)
    return ((total[m:] - total[:-m]) / m).max(axis=1)


def _kept(cut: CutScores) -> np.ndarray:
    if cut.distances is None:
        raise InputError(f"{cut.name}: distances in every bin were not kept: score it with them.")
    return cut.distances[:_MOST_WINDOWS]


def _errors(cut: CutScores, setting: Setting) -> float:
    """Share of the windows of a cut that are judged wrongly."""
    above = float(np.mean(hard_scores(cut, setting) > setting.threshold))
    return above if cut.label == STABLE else 1.0 - above


def _weights(cuts: Sequence[CutScores], costs: Costs) -> np.ndarray:
    """What the errors of every cut cost."""
    stable = np.array([cut.label == STABLE for cut in cuts])
    each = np.where(stable, costs.expected(1.0, 0.0), costs.expected(0.0, 1.0))
    return each / np.where(stable, max(stable.sum(), 1), max((~stable).sum(), 1))


def _standard_error(gain: np.ndarray, cuts: Sequence[CutScores]) -> float:
    """Of the sum of gains, from how the cuts of a label differ."""
    labels = np.array([cut.label for cut in cuts])
    square = 0.0
    for label in set(labels.tolist()):
        part = gain[labels == label]
        square += len(part) * float(np.var(part, ddof=1)) if len(part) > 1 else 0.0
    return math.sqrt(square)


def _start(cuts: Sequence[CutScores], band: tuple[float, float], averaged: int) -> Setting:
    """The band given, cut to the bins that there are."""
    data = spectra(cuts)
    counted = data.frequencies[data.free > 0.0]
    if not len(counted):
        raise InputError("no bin is free at all spindle speeds: take a wider band.")
    low, high = max(band[0], float(counted[0])), min(band[1], float(counted[-1]))
    if not low < high:
        raise InputError(f"the band {band[0]:g} to {band[1]:g} Hz holds no bin of the distances.")
    return Setting(low, high, float(averaged), math.nan)


def _with_threshold(cuts: Sequence[CutScores], costs: Costs, setting: Setting) -> Setting:
    """A setting with the threshold of least hard cost, in the middle of its range."""
    scores = [hard_scores(cut, setting) for cut in cuts]
    sizes = np.repeat([1.0 / len(each) for each in scores], list(map(len, scores)))
    weights = np.repeat(_weights(cuts, costs), list(map(len, scores))) * sizes
    stable = np.repeat([cut.label == STABLE for cut in cuts], list(map(len, scores)))
    values = np.concatenate(scores)
    order = np.argsort(values)
    # Cost of a threshold above the first k scores.
    missed = np.concatenate([[0.0], np.cumsum(np.where(stable, 0.0, weights)[order])])
    false = np.where(stable, weights, 0.0)[order]
    cost = missed + false.sum() - np.concatenate([[0.0], np.cumsum(false)])
    best = np.flatnonzero(cost <= cost.min() + 1e-12)
    ends = np.concatenate([[max(values.min() - 1.0, -0.5)], values[order], [2.0 * values.max()]])
    y = [math.log1p(max(float(ends[k]), -0.9)) for k in (best[0], best[-1] + 1)]
    return setting._replace(threshold=math.expm1(0.5 * (y[0] + y[1])))


def _tuned(cuts: Sequence[CutScores], costs: Costs, start: Setting, most: int) -> Setting:
    """The best, by hard cost, of what the search ends with from several bands."""
    data = spectra(cuts)
    candidates = [_with_threshold(cuts, costs, start)]
    for low, high in _bands(data, start):
        began = _with_threshold(cuts, costs, start._replace(low=low, high=high))
        candidates.append(began)
        vector = np.array(
            [math.log(low), math.log(high), began.averaged, math.log1p(began.threshold)]
        )
        for softness in _STAGES:
            vector = _descended(vector, data, costs, softness, most, start)
            low, high = math.exp(vector[0]), math.exp(vector[1])
            found = Setting(low, high, float(round(vector[2])), 0.0)
            candidates.append(_with_threshold(cuts, costs, found))
    return min(candidates, key=lambda setting: hard_cost(cuts, costs, setting))


def _descended(
    vector: np.ndarray,
    data: Spectra,
    costs: Costs,
    softness: Softness,
    most: int,
    start: Setting,
) -> np.ndarray:
    """End of a bounded quasi-Newton descent."""
    gap = _NARROWEST * float(data.frequencies[1] - data.frequencies[0])
    middle = math.sqrt(math.exp(vector[0]) * math.exp(vector[1]))
    ends = math.log(start.low), math.log(start.high)
    inner = (
        math.log(max(middle - 0.5 * gap, start.low)),
        math.log(min(middle + 0.5 * gap, start.high)),
    )
    bounds = [(ends[0], inner[0]), (inner[1], ends[1]), (1.0, float(most)), (None, None)]

    def cost(v: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = _value_and_slope(jnp.asarray(v), data, costs, softness, most)
        return float(value), np.asarray(slope)

    found = scipy.optimize.minimize(
        cost, vector, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 60}
    )
    return np.asarray(found.x)


def _bands(data: Spectra, start: Setting) -> list[tuple[float, float]]:
    """Bands to begin with: that given, and some around where chattering cuts are highest."""
    inside = (data.frequencies >= start.low) & (data.frequencies <= start.high) & (data.free > 0.0)
    y = np.log1p(np.maximum(data.distances[:, :, inside], -0.9))
    # A line that stable cuts have as well tells nothing.
    of_cuts = np.where(data.there[:, :, None], y, 0.0).sum(axis=1) / data.there.sum(axis=1)[:, None]
    higher = (data.share[:, 1] - data.share[:, 0]) @ of_cuts
    peak = float(data.frequencies[inside][higher.argmax()])
    bands = [(start.low, start.high)]
    least = _NARROWEST * float(data.frequencies[1] - data.frequencies[0])
    for part in _AROUND:
        reach = max(part * peak, least)
        bands.append((max(peak - reach, start.low), min(peak + reach, start.high)))
    return [(max(low, 1e-6), high) for low, high in bands]
