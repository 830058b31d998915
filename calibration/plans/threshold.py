"""A threshold for a tool, and what to expect of it in a new cut.

The threshold is that of least expected cost (`threshold_cost`), lifted where a rate of false alarms
is asked for. What a rule of votes does with it follows from the law of a cut's windows
(`window_law`, `alarm_rule`): its own level, tails and correlation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from calibration.chatter_scores import ScorePosterior
from calibration.plans.alarm_rule import AlarmRule
from calibration.plans.threshold_cost import (
    CUT,
    TWO_OF_FIVE,
    Choice,
    Costs,
    alarms_of_cut,
    choice,
    cut_lengths,
    drawn_for,
    expected_costs,
    for_rate,
    spoken_by,
)
from calibration.plans.window_law import window_law, windows_in_common
from procmodel.chatter import CHATTER, MARGINAL, STABLE

LOW, HIGH = 0.05, 0.95
# Cuts of a label below which a tool is said to have few, and false alarms per hour that are many.
_FEW_CUTS, _MANY_ALARMS = 3, 60.0
# A share of chattering cuts found below which a threshold is said to be of little use.
_SELDOM = 0.5


@dataclass(frozen=True)
class Figure:
    """A number with its interval.

    Attributes
    ----------
    value : float
        Mean or median.
    interval90 : tuple of float
        From the 5 % to the 95 % quantile.
    """

    value: float
    interval90: tuple[float, float]


@dataclass(frozen=True)
class ThresholdPlan:
    """A threshold, and what to expect of it in a new cut of the tool.

    Attributes
    ----------
    tool : str, sequence of str, or None
        The tool, or tools; None for one that was never seen.
    costs : Costs
        What it was planned for.
    rule : AlarmRule
        How it is used.
    threshold : Figure
        Of the score D.
    false_alarms_per_hour : Figure
        Alarms that begin in an hour of stable cutting, in cuts as long as those at hand.
    detection_probability : Figure
        Share of chattering cuts in which the rule speaks within `within` seconds.
    delay : Figure [s]
        From the beginning of chatter to the alarm, median and range over cuts that are detected.
    marginal_alarms : Figure
        The share of detections for marginal cuts.
    cost : float
        Expected cost of a window, or of a cut.
    within : float [s]
        See above.
    choice : Choice
        The threshold with P(chatter | D).
    warnings : tuple of str
        What to know before using it.
    """

    tool: str | Sequence[str] | None
    costs: Costs
    rule: AlarmRule
    threshold: Figure
    false_alarms_per_hour: Figure
    detection_probability: Figure
    delay: Figure
    marginal_alarms: Figure
    cost: float
    within: float
    choice: Choice
    warnings: tuple[str, ...] = field(default=())

    @cached_property
    def status(self) -> str:
        """The plan as a sentence."""
        why = "the false-alarm rate asked for" if self.choice.raised else "least expected cost"
        low, high = self.threshold.interval90
        return (
            f"threshold {self.threshold.value:.4g} ({low:.4g} to {high:.4g}) by {why}, for "
            f"{self.rule} of {named(self.tool)}"
        )

    def as_dict(self) -> dict[str, Any]:
        """The plan as plain JSON types."""
        figures = {
            "false_alarms_per_hour": self.false_alarms_per_hour,
            "detection_probability": self.detection_probability,
            "delay_s": self.delay,
            "marginal_alarm_probability": self.marginal_alarms,
        }
        found: dict[str, Any] = {
            "tool": self.tool,
            "threshold": _figure(self.threshold),
            "alarm_from_probability": self.costs.probability,
        }
        for name, each in figures.items():
            found |= {name: each.value, f"{name}_interval90": list(each.interval90)}
        return found | {
            "detection_within_s": self.within,
            f"expected_cost_per_{self.costs.per}": self.cost,
            "raised_for_false_alarms": self.choice.raised,
            "status": self.status,
        }


def _figure(figure: Figure) -> dict[str, Any]:
    return {"value": figure.value, "interval90": list(figure.interval90)}


def plan_threshold(
    posterior: ScorePosterior,
    costs: Costs,
    rule: AlarmRule = TWO_OF_FIVE,
    *,
    tool: str | Sequence[str] | None = None,
    false_alarms_per_hour: float | None = None,
    within: float | None = None,
    seed: int = 0,
) -> ThresholdPlan:
    """The threshold of least expected cost for one tool.

    Parameters
    ----------
    posterior : ScorePosterior
        From `calibration.chatter_scores.fit_scores`.
    costs : Costs
        What errors cost.
    rule : AlarmRule
        How the threshold is used.
    tool : str or sequence of str, optional
        One of its tools, or several that are to share a threshold; one that was never seen when
        left out.
    false_alarms_per_hour : float, optional
        Rate that the threshold has to keep as well, in expectation.
    within : float, optional [s]
        Time in which chatter has to be found; the median length of the chattering cuts when left
        out.
    seed : int
        Of what is drawn for an unseen tool.

    Returns
    -------
    ThresholdPlan
        With warnings where the cuts cannot support what is asked for.

    Raises
    ------
    InputError
        If the tool is unknown, a number is out of its range, or the cuts differ in their windows.
    """
    step, length = windows_in_common(posterior)
    lengths = cut_lengths(posterior, within)
    stable, marginal, chatter = (
        window_law(posterior, label, tool, seed) for label in (STABLE, MARGINAL, CHATTER)
    )
    warnings = list(posterior.warnings)
    chosen, least = choice(stable, chatter, costs, rule, lengths, false_alarms_per_hour)
    at, of_draws = math.log1p(chosen.threshold), least.of_draws
    if least.at_end:
        warnings.append(
            "the least cost lies at the end of all scores: at these costs it pays to give an alarm "
            "always, or never"
        )
    if false_alarms_per_hour is not None:
        of_law = drawn_for(stable, costs)
        rare = for_rate(of_law, rule, false_alarms_per_hour, lengths, pooled=False)
        of_draws = np.maximum(of_draws, rare)
        warnings += unsupported(posterior, tool, false_alarms_per_hour)
    per_hour = alarms_of_cut(stable, rule, at, lengths) / lengths.hours
    spoken = spoken_by(chatter, rule, at, lengths.chatter)
    near = spoken_by(marginal, rule, at, lengths.chatter)[:, -1]
    # A few draws of heavy tails lift the mean rate, and the threshold over those of most draws.
    low, high = _interval(np.expm1(of_draws))
    return ThresholdPlan(
        tool=tool,
        costs=costs,
        rule=rule,
        threshold=Figure(
            chosen.threshold, (min(low, chosen.threshold), max(high, chosen.threshold))
        ),
        false_alarms_per_hour=Figure(float(per_hour.mean()), _interval(per_hour)),
        detection_probability=Figure(float(spoken[:, -1].mean()), _interval(spoken[:, -1])),
        delay=_delay(spoken.mean(axis=0), step, length),
        marginal_alarms=Figure(float(near.mean()), _interval(near)),
        cost=float(expected_costs(stable, chatter, costs, rule, lengths, np.array([at])).mean()),
        within=length + (lengths.chatter - 1) * step,
        choice=chosen,
        warnings=(
            *warnings,
            *_about_cuts(posterior, tool),
            *_about_rate(costs, per_hour, chosen.raised),
        ),
    )


def unsupported(
    posterior: ScorePosterior, tool: str | Sequence[str] | None, false_alarms_per_hour: float
) -> list[str]:
    """What the stable cuts cannot promise.

    Parameters
    ----------
    posterior : ScorePosterior
        What was learnt from.
    tool : str, optional
        The tool.
    false_alarms_per_hour : float
        What is asked for.

    Returns
    -------
    list of str
        A sentence if there are so few windows n that even without any alarm among them they could
        not promise it: a rate is never promised below 1 / (n + 1).
    """
    step, _ = windows_in_common(posterior)
    sizes = [len(cut.scores) for cut in posterior.learnt_from(STABLE, tool)]
    total, windows = sum(sizes), 3600.0 / step / false_alarms_per_hour
    if total + 1.0 >= windows:
        return []
    needed = math.ceil(windows - 1.0)
    like = f", about {math.ceil(needed * len(sizes) / total)} cuts like these" if total else ""
    return [
        f"{false_alarms_per_hour:g} false alarms per hour are one in {windows:.0f} windows, but "
        f"{total} stable windows of {len(sizes)} cuts can promise no less than one in {total + 1}: "
        f"what goes beyond rests on the tails of the model, and {needed} stable windows "
        f"({needed * step / 3600.0:.2g} h of stable cutting{like}) would support it"
    ]


def named(tool: str | Sequence[str] | None) -> str:
    """A tool, or tools, in a sentence."""
    if tool is None:
        return "an unseen tool"
    return f"tool {tool}" if isinstance(tool, str) else f"the tools {' and '.join(tool)}"


def _about_cuts(posterior: ScorePosterior, tool: str | Sequence[str] | None) -> list[str]:
    """Too few cuts to tell how much cuts differ, and labels that the scores do not tell apart."""
    found = []
    counts = {label: len(posterior.learnt_from(label, tool)) for label in (STABLE, CHATTER)}
    said = " and ".join(f"{n} {label}" for label, n in counts.items() if n < _FEW_CUTS)
    if said:
        whose = "in all" if tool is None else f"of {named(tool)}"
        found.append(
            f"only {said} cuts are there {whose}: the rest comes from other tools and the priors"
        )
    tools = (tool,) if tool is None or isinstance(tool, str) else tool
    apart = [
        posterior.level(CHATTER, each, None) - posterior.level(STABLE, each, None) for each in tools
    ]
    if max(float(np.mean(each <= 0.0)) for each in apart) > LOW:
        found.append(
            "the scores do not tell chattering cuts from stable ones: look whether the labels are "
            "right, and whether the band holds the chatter"
        )
    return found


def _about_rate(costs: Costs, per_hour: np.ndarray, raised: bool) -> list[str]:
    rate = float(per_hour.mean())
    if raised or costs.per == CUT or rate <= _MANY_ALARMS:
        return []
    return [
        f"{rate:.0f} false alarms per hour are what these costs of a window come to: name the rate "
        "that is wanted, or give the costs per cut"
    ]


def _delay(spoken: np.ndarray, step: float, length: float) -> Figure:
    """Median and range of the time to the alarm where there is one."""
    shares = spoken / spoken[-1] if spoken[-1] > 0.0 else spoken
    at = [int(np.argmax(shares >= q - 1e-12)) for q in (0.5, LOW, HIGH)]
    middle, low, high = (length + step * i for i in at)
    return Figure(middle, (low, high))


def _interval(values: np.ndarray) -> tuple[float, float]:
    low, high = np.quantile(values, (LOW, HIGH))
    return float(low), float(high)
