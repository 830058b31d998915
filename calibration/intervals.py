"""`compare_intervals`: Wald, profile-likelihood and posterior intervals of a fit side by side."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray

from calibration.noise import Robust
from calibration.profiling import ParameterProfile, ProfileLikelihood
from calibration.result import FitResult, ParameterEstimate
from calibration.text import aligned, sections
from procmodel.errors import InputError

METHODS = ("Wald", "profile", "posterior")
NOT_ASKED = "not asked for"
# Difference of two methods' ends, as a share of the profile's width, that is worth a remark.
_DIFFERENT = 0.1
# A combination names changes down to this share of the largest, and at most so many.
_NAMED, _MOST_NAMED = 0.05, 4


@dataclass(frozen=True)
class Interval:
    """An interval of one parameter by one method.

    Attributes
    ----------
    low, high : float or None
        Ends in natural units; None where open or missing.
    reason : str
        Why an end is missing or only a bound, as half a sentence.
    """

    low: float | None = None
    high: float | None = None
    reason: str = ""

    @property
    def missing(self) -> bool:
        """Whether there is neither end."""
        return self.low is None and self.high is None

    def in_words(self) -> str:
        """``low to high``, or a dash."""
        if self.missing:
            return "-"
        ends = ("open" if end is None else f"{end:.6g}" for end in (self.low, self.high))
        return " to ".join(ends)

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain JSON types."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class IntervalRow:
    """What is said of one parameter.

    Attributes
    ----------
    value : float
        Best value, in `unit`.
    unit : str
        Its unit.
    verdict : str
        "identified", "one-sided", "flat" or "fixed", by the profile where there is one.
    wald, profile, posterior : Interval
        By the three methods.
    remark : str
        Where the methods differ, as a sentence without its full stop.
    """

    value: float
    unit: str
    verdict: str
    wald: Interval
    profile: Interval
    posterior: Interval
    remark: str = ""

    @property
    def intervals(self) -> dict[str, Interval]:
        """The three by the names in `METHODS`."""
        return dict(zip(METHODS, (self.wald, self.profile, self.posterior), strict=True))

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain JSON types."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class IntervalTable:
    """Intervals of all parameters by three methods, and what the data tell apart.

    Attributes
    ----------
    model, data_hash : str
        What was fitted, and to which data.
    level : float
        Probability of the intervals.
    rows : dict of str to IntervalRow
        Every parameter of the problem.
    directions, trades : tuple of str
        What the data cannot tell, and strong correlations, as sentences.
    combinations : tuple of str
        The best- and the worst-known combination of parameters, as sentences.
    warnings : tuple of str
        What the user should know before trusting the table.
    """

    model: str
    data_hash: str
    level: float
    rows: dict[str, IntervalRow]
    directions: tuple[str, ...] = ()
    trades: tuple[str, ...] = ()
    combinations: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def report(self) -> str:
        """The table as text, with the reason of whatever is missing.

        Returns
        -------
        str
            Several lines.
        """
        # A method that nobody asked for gets a line, not a column of dashes.
        asked = [
            m for m in METHODS if any(self._interval(n, m).reason != NOT_ASKED for n in self.rows)
        ]
        table = [["", "best", *asked, "verdict"]]
        for name, row in self.rows.items():
            words = [row.intervals[method].in_words() for method in asked]
            best = f"{row.value:.6g}" + (f" {row.unit}" if row.unit else "")
            table.append([name, best, *words, row.verdict])
        lines = [f"{100 * self.level:g} % intervals of {self.model}, data {self.data_hash}"]
        lines += aligned(table, "  ")
        lines += [f"  {method}: {NOT_ASKED}" for method in METHODS if method not in asked]
        lines += sections(
            (
                ("reasons", self._reasons(asked)),
                ("combinations", self.combinations),
                ("the data cannot tell", self.directions),
                ("trade-offs", self.trades),
                ("warnings", self.warnings),
            )
        )
        return "\n".join(lines)

    def _interval(self, name: str, method: str) -> Interval:
        return self.rows[name].intervals[method]

    def _reasons(self, asked: list[str]) -> list[str]:
        """Each reason once, with the parameters and methods that it holds for."""
        where: dict[tuple[str, str], list[str]] = {}
        for method in asked:
            for name, row in self.rows.items():
                reason = row.intervals[method].reason
                if reason and row.verdict != "fixed":
                    where.setdefault((method, reason), []).append(name)
        sentences = [f"{', '.join(n)}, {m}: {reason}" for (m, reason), n in where.items()]
        return sentences + [f"{n}: {row.remark}" for n, row in self.rows.items() if row.remark]

    def as_dict(self) -> dict[str, Any]:
        """The table as plain JSON types; the keys are part of the interface."""
        return {
            "model": self.model,
            "data_hash": self.data_hash,
            "level": self.level,
            "parameters": {name: row.as_dict() for name, row in self.rows.items()},
            "cannot_tell": list(self.directions),
            "trades": list(self.trades),
            "combinations": list(self.combinations),
            "warnings": list(self.warnings),
        }

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> "IntervalTable":
        """The table that `as_dict` made these plain types of."""
        rows = {}
        for name, row in plain["parameters"].items():
            three = {m: Interval(**row[m]) for m in ("wald", "profile", "posterior")}
            rows[name] = IntervalRow(**{**row, **three})
        return cls(
            model=plain["model"],
            data_hash=plain["data_hash"],
            level=plain["level"],
            rows=rows,
            directions=tuple(plain["cannot_tell"]),
            trades=tuple(plain["trades"]),
            combinations=tuple(plain["combinations"]),
            warnings=tuple(plain["warnings"]),
        )


def compare_intervals(
    result: FitResult,
    profile: ProfileLikelihood | None = None,
    posterior: xarray.DataTree | None = None,
    level: float = 0.95,
) -> IntervalTable:
    """Wald, profile-likelihood and posterior intervals side by side.

    Parameters
    ----------
    result : FitResult
        The fit; its covariance gives the Wald intervals.
    profile : ProfileLikelihood, optional
        From `calibration.profiling.profile`, at the same level.
    posterior : xarray.DataTree, optional
        From `calibration.sample`; the intervals are quantiles with equal tails.
    level : float
        Probability of the intervals, between 0 and 1.

    Returns
    -------
    IntervalTable
        One row for each parameter, with the reason of whatever is missing.

    Raises
    ------
    InputError
        If the level is not between 0 and 1 or not the profile's, or profile or posterior are of
        other data.
    """
    if not 0.0 < level < 1.0:
        raise InputError(f"level is {level!r}, but must be between 0 and 1, such as 0.95.")
    problem, data_hash = result.problem, result.problem.data_hash
    if profile is not None and not math.isclose(profile.level, level):
        raise InputError(
            f"the profile was made for level {profile.level:g}, not {level:g}: make both the same."
        )
    hashes = {
        "profile": profile.data_hash if profile is not None else data_hash,
        "posterior": posterior.attrs.get("data_hash", data_hash) if posterior else data_hash,
    }
    for what, found in hashes.items():
        if found != data_hash:
            raise InputError(f"the {what} is of data {found}, the fit of {data_hash}: redo one.")
    # A robust loss is no likelihood: there the Wald interval is the sounder of the two.
    robust = any(isinstance(dataset.noise, Robust) for dataset in problem.datasets.values())
    rows = {}
    for name, estimate in result.parameters.items():
        curve = None if profile is None else profile.parameters.get(name)
        wald, by_profile = _wald(result, name, level), _profile(curve)
        rows[name] = IntervalRow(
            value=estimate.value,
            unit=estimate.unit,
            verdict=_verdict(estimate, curve),
            wald=wald,
            profile=by_profile,
            posterior=_posterior(posterior, name, level),
            remark="" if robust else _remark(wald, curve),
        )
    return IntervalTable(
        model=problem.name,
        data_hash=data_hash,
        level=level,
        rows=rows,
        directions=result.directions,
        trades=result.trades,
        combinations=combinations_in_words(result),
        warnings=result.warnings + (profile.warnings if profile is not None else ()),
    )


def combinations_in_words(result: FitResult) -> tuple[str, ...]:
    """The best- and the worst-known combination of the free parameters, as sentences.

    They are the directions of least and greatest variance of relative changes, each told by the
    change of the parameter that moves most along it.

    Parameters
    ----------
    result : FitResult
        The fit.

    Returns
    -------
    tuple of str
        Such as "best known: +1 % in wear_ratio with -0.3 % in gap, to 0.1 %"; empty unless at
        least two parameters other than 0 have a standard deviation.
    """
    values = np.array([result.parameters[name].value for name in result.free])
    known = np.isfinite(np.diag(result.covariance)) & (np.diag(result.covariance) > 0)
    known &= values != 0
    if np.sum(known) < 2:
        return ()
    names = [name for name, k in zip(result.free, known, strict=True) if k]
    size = np.abs(values[known])
    relative = result.covariance[np.ix_(known, known)] / np.outer(size, size)
    variances, vectors = np.linalg.eigh(relative)
    sentences = []
    for title, k in (("best known", 0), ("worst known", -1)):
        direction = vectors[:, k]
        order = np.argsort(-np.abs(direction), kind="stable")
        # Along the direction scaled to +1 % in its first parameter, this is one deviation.
        step = math.sqrt(max(float(variances[k]), 0.0)) * abs(direction[order[0]])
        changes = direction / direction[order[0]]
        told = [i for i in order if abs(changes[i]) >= _NAMED]
        moves = " with ".join(f"{changes[i]:+.2g} % in {names[i]}" for i in told[:_MOST_NAMED])
        if len(told) > _MOST_NAMED:
            moves += f" and smaller ones in {len(told) - _MOST_NAMED} more"
        sentences.append(f"{title}: {moves}, to {100 * step:.2g} % (one standard deviation)")
    return tuple(sentences)


def _wald(result: FitResult, name: str, level: float) -> Interval:
    estimate = result.parameters[name]
    if estimate.verdict == "fixed":
        return Interval(reason="fixed")
    if estimate.std is None:
        ends = estimate.interval95 if math.isclose(level, 0.95) else None
        reason = estimate.reason.removesuffix(", see below").removeprefix("but ")
        return Interval(*ends, reason=reason) if ends else Interval(reason=reason)
    if math.isclose(level, 0.95) and estimate.interval95 is not None:
        low, high = estimate.interval95
    else:
        low, high = result.quantiles(name, np.array([0.5 - 0.5 * level, 0.5 + 0.5 * level]))
        if name in result.free:
            bounds = result.problem.layout.bounds[result.free.index(name)]
            low, high = max(low, bounds[0]), min(high, bounds[1])
    return Interval(float(low), float(high), estimate.reason)


def _profile(curve: ParameterProfile | None) -> Interval:
    if curve is None:
        return Interval(reason=NOT_ASKED)
    if curve.low is None or curve.high is None:
        return Interval(reason=curve.reason)
    reasons = [
        f"{side} {end.reason}"
        for side, end in (("below", curve.low), ("above", curve.high))
        if end.reason
    ]
    return Interval(curve.low.value, curve.high.value, "; ".join(reasons))


def _posterior(posterior: xarray.DataTree | None, name: str, level: float) -> Interval:
    if posterior is None:
        return Interval(reason=NOT_ASKED)
    draws = posterior["posterior"]
    if name not in draws:
        return Interval(reason="not among the draws")
    if not posterior.attrs.get("converged", 1):
        status = str(posterior.attrs.get("status", "")).removeprefix("not converged: ")
        return Interval(reason=f"the run has not converged: {status}".removesuffix(": "))
    values = np.ravel(np.asarray(draws[name]))
    low, high = np.quantile(values, [0.5 - 0.5 * level, 0.5 + 0.5 * level])
    return Interval(float(low), float(high))


def _verdict(estimate: ParameterEstimate, curve: ParameterProfile | None) -> str:
    """The fit's verdict, or the profile's, which need not take the model for a straight one."""
    if curve is None or curve.low is None or curve.high is None:
        return estimate.verdict
    ends = (curve.low.status, curve.high.status)
    by_prior_alone = estimate.verdict == "flat" and "prior" in estimate.reason
    if "failed" in ends or by_prior_alone:
        return estimate.verdict
    return ("flat", "one-sided", "identified")[ends.count("closed")]


def _remark(wald: Interval, curve: ParameterProfile | None) -> str:
    """Where the Wald interval differs from a closed profile by more than a tenth of its width."""
    if curve is None or not curve.closed or curve.low is None or curve.high is None:
        return ""
    if curve.low.value is None or curve.high.value is None or wald.missing:
        return ""
    width = curve.high.value - curve.low.value
    misses = []
    for side, ours, theirs in (
        ("lower", wald.low, curve.low.value),
        ("upper", wald.high, curve.high.value),
    ):
        if ours is not None and abs(ours - theirs) > _DIFFERENT * width:
            misses.append(f"{side} end by {100 * abs(ours - theirs) / width:.0f} %")
    if not misses:
        return ""
    return f"Wald misses the {' and the '.join(misses)} of the profile's width; take the profile"
