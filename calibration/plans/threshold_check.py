"""A threshold on cuts that it was not chosen on, beside those that it was.

Cuts are left out whole, a share of every label and tool at a time: windows of one cut are alike,
and a split among them would let the model see what it is then asked about.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.stats

from calibration.chatter_arrays import NullLaw
from calibration.chatter_cuts import CutScores
from calibration.chatter_scores import ScorePosterior, fit_scores
from calibration.plans.alarm_rule import AlarmRule
from calibration.plans.threshold import HIGH, LOW, Figure
from calibration.plans.threshold_cost import TWO_OF_FIVE, Choice, Costs, chosen_threshold
from calibration.progress import ProgressOption, reporting
from procmodel.chatter import CHATTER, MARGINAL, STABLE
from procmodel.errors import InputError

# Folds converge to less than what is published: their draws only choose a threshold.
_FOLD_DRAWS = 250
_RHAT_OF_FOLDS = 1.05


@dataclass(frozen=True)
class Tally:
    """What a rule did with labelled cuts.

    Attributes
    ----------
    stable, marginal, chatter : int
        Cuts of each label.
    detected : int
        Chattering cuts in which it spoke.
    marginal_alarms : int
        Marginal cuts in which it spoke.
    false_alarms : int
        Alarms that began in stable cuts.
    hours : float
        Of stable cutting.
    delays : tuple of float [s]
        From the beginning of a chattering cut to the alarm, where there was one.
    auc : float or None
        Probability that a window of a chattering cut has a higher P(chatter | D) than one of a
        stable cut; None where a label is missing.
    """

    stable: int
    marginal: int
    chatter: int
    detected: int
    marginal_alarms: int
    false_alarms: int
    hours: float
    delays: tuple[float, ...]
    auc: float | None

    @property
    def detection_probability(self) -> Figure | None:
        """Share of chattering cuts, with Jeffreys' interval; None without any."""
        if not self.chatter:
            return None
        share = scipy.stats.beta(self.detected + 0.5, self.chatter - self.detected + 0.5)
        interval = float(share.ppf(LOW)), float(share.ppf(HIGH))
        return Figure(self.detected / self.chatter, interval)

    @property
    def false_alarms_per_hour(self) -> Figure | None:
        """Rate, with Jeffreys' interval of a count; None without stable cutting."""
        if not self.hours:
            return None
        count = scipy.stats.gamma(self.false_alarms + 0.5)
        interval = float(count.ppf(LOW)) / self.hours, float(count.ppf(HIGH)) / self.hours
        return Figure(self.false_alarms / self.hours, interval)

    def as_dict(self) -> dict[str, Any]:
        """The tally as plain JSON types, of the names that a plan has."""
        found: dict[str, Any] = {
            "cuts": {STABLE: self.stable, MARGINAL: self.marginal, CHATTER: self.chatter},
            "hours_stable": self.hours,
            "auc": self.auc,
            "delay_s": float(np.median(self.delays)) if self.delays else None,
        }
        for name in ("false_alarms_per_hour", "detection_probability"):
            figure = getattr(self, name)
            found[name] = None if figure is None else figure.value
            found[f"{name}_interval90"] = None if figure is None else list(figure.interval90)
        share = self.marginal_alarms / self.marginal if self.marginal else None
        return found | {"marginal_alarm_probability": share}


@dataclass(frozen=True)
class ThresholdCheck:
    """The same rule on cuts left out and on cuts learnt from.

    Attributes
    ----------
    held_out, in_sample : Tally
        What it did with them.
    folds : int
        How many times a share was left out.
    kept : tuple of str
        Cuts that were never left out, each the only one of its label.
    warnings : tuple of str
        What to know.
    """

    held_out: Tally
    in_sample: Tally
    folds: int
    kept: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Figures held out, and those in sample beside them."""
        return {
            **self.held_out.as_dict(),
            "folds": self.folds,
            "in_sample": self.in_sample.as_dict(),
        }


def check_threshold(
    posterior: ScorePosterior,
    costs: Costs,
    rule: AlarmRule = TWO_OF_FIVE,
    *,
    null: NullLaw | None = None,
    false_alarms_per_hour: float | None = None,
    tool: str | Sequence[str] | None = None,
    folds: int = 5,
    seed: int = 0,
    progress: ProgressOption = None,
) -> ThresholdCheck:
    """Choose thresholds anew without a share of the cuts, and use them on those.

    Parameters
    ----------
    posterior : ScorePosterior
        Learnt from all cuts.
    costs, rule, false_alarms_per_hour
        As for `plan_threshold`.
    null : NullLaw, optional
        As for `fit_scores`.
    tool : str or sequence of str, optional
        Tools whose cuts count and that have the threshold; all when left out, with that of an
        unseen tool.
    folds : int
        Shares that the cuts are dealt into, at least 2.
    seed : int
        Same seed, same shares and draws.
    progress : bool or callable, optional
        See `calibration.sample`.

    Returns
    -------
    ThresholdCheck
        Figures on cuts left out.

    Raises
    ------
    InputError
        If there are fewer than 2 folds.
    """
    if folds < 2:
        raise InputError(f"folds are {folds}, but must be at least 2.")
    cuts = posterior.cuts
    places = dealt(cuts, folds, seed)
    tools = posterior.tools if tool is None else (tool,) if isinstance(tool, str) else tuple(tool)
    counted = [i for i, cut in enumerate(cuts) if cut.tool in tools]
    here = [i for i in counted if places[i] >= 0]
    shares = sorted({int(places[i]) for i in here})
    used: list[tuple[CutScores, Choice]] = []
    rough = 0
    with reporting(progress) as told:
        for done, share in enumerate(shares):
            left_out = np.flatnonzero(places == share).tolist()
            part = fit_scores(
                cuts, null=null, left_out=left_out, seed=seed + share, draws=_FOLD_DRAWS
            )
            rough += float(part.tree.attrs["rhat"]) > _RHAT_OF_FOLDS
            choice = chosen_threshold(
                part, costs, rule, tool=tool, false_alarms_per_hour=false_alarms_per_hour
            )
            used += [(cuts[i], choice) for i in left_out if i in here]
            told.running("shares of cuts", done + 1, len(shares))
    warnings = []
    kept = tuple(cuts[i].name for i in counted if places[i] < 0)
    if kept:
        warnings.append(
            f"{', '.join(kept)}: the only cut of its label, so that it cannot be left out: label "
            "another for figures on cuts that were not learnt from"
        )
    if rough:
        warnings.append(
            f"{rough} of {len(shares)} posteriors without a share of the cuts did not converge: "
            "take their figures as rough"
        )
    whole = chosen_threshold(
        posterior, costs, rule, tool=tool, false_alarms_per_hour=false_alarms_per_hour
    )
    return ThresholdCheck(
        held_out=tallied(used, rule),
        in_sample=tallied([(cuts[i], whole) for i in counted], rule),
        folds=len(shares),
        kept=kept,
        warnings=tuple(warnings),
    )


def dealt(cuts: Sequence[CutScores], folds: int, seed: int = 0) -> np.ndarray:
    """Shares that cuts are dealt into, every label and tool evenly.

    Parameters
    ----------
    cuts : sequence of CutScores
        Labelled cuts.
    folds : int
        Number of shares.
    seed : int
        Of the order within label and tool.

    Returns
    -------
    ndarray, shape (c,) of int
        The share of every cut; -1 for stable or chattering cuts that are the only ones.
    """
    rng = np.random.default_rng(seed)
    labels = [cut.label for cut in cuts]
    order = sorted(range(len(cuts)), key=lambda i: (labels[i], cuts[i].tool, rng.uniform()))
    places = np.empty(len(cuts), int)
    places[order] = np.arange(len(cuts)) % folds
    for label in (STABLE, CHATTER):
        if labels.count(label) == 1:
            places[labels.index(label)] = -1
    for label in (STABLE, CHATTER):
        # Never all of a label at once.
        held = [i for i in range(len(cuts)) if labels[i] == label]
        if len(held) > 1 and len({int(places[i]) for i in held}) == 1:
            places[held[0]] = (places[held[0]] + 1) % folds
    return places


def tallied(used: Sequence[tuple[CutScores, Choice]], rule: AlarmRule) -> Tally:
    """What a rule does with cuts, each with the threshold that was chosen for it.

    Parameters
    ----------
    used : sequence of (CutScores, Choice)
        Cuts and thresholds.
    rule : AlarmRule
        The rule.

    Returns
    -------
    Tally
        Counts and delays.
    """
    spoken = [rule.spoken(cut.scores > choice.threshold) for cut, choice in used]
    pairs = [(cut, said) for (cut, _), said in zip(used, spoken, strict=True)]
    chatter = [(cut, said) for cut, said in pairs if cut.label == CHATTER]
    stable = [(cut, said) for cut, said in pairs if cut.label == STABLE]
    near = [said for cut, said in pairs if cut.label == MARGINAL]
    begun = [np.count_nonzero(np.diff(said, prepend=False) & said) for _, said in stable]
    return Tally(
        stable=len(stable),
        marginal=len(near),
        chatter=len(chatter),
        detected=sum(bool(said.any()) for _, said in chatter),
        marginal_alarms=sum(bool(said.any()) for said in near),
        false_alarms=int(sum(begun)),
        hours=sum(len(said) * cut.step for cut, said in stable) / 3600.0,
        delays=tuple(
            float(cut.length + int(said.argmax()) * cut.step) for cut, said in chatter if said.any()
        ),
        auc=_auc(used),
    )


def _auc(used: Sequence[tuple[CutScores, Choice]]) -> float | None:
    """Mann and Whitney's statistic of P(chatter | D) over windows."""
    values: dict[str, list[np.ndarray]] = {STABLE: [], CHATTER: []}
    for cut, choice in used:
        if cut.label in values:
            values[cut.label].append(choice.chatter_probability(cut.scores))
    if not all(values.values()):
        return None
    low, high = (np.concatenate(values[label]) for label in (STABLE, CHATTER))
    ranks = scipy.stats.rankdata(np.concatenate([high, low]))[: len(high)]
    return float((ranks.sum() - 0.5 * len(high) * (len(high) + 1)) / (len(high) * len(low)))
