"""`profile`: profile-likelihood intervals, which need neither a straight model nor symmetry.

One parameter is held at a value and all others are fitted again; the misfit's rise over the
optimum says how far that value can be believed. Followed is its signed root
``zeta = sign(value - best) * sqrt(2 * rise)``: a straight line where the model is linear, and
bent or levelling off where a standard deviation misleads.

References
----------
.. [1] D. M. Bates and D. G. Watts, "Nonlinear Regression Analysis and Its Applications", 1988,
   chapter 6 (profile t).
.. [2] A. Raue et al., "Structural and practical identifiability analysis of partially observed
   dynamical models by exploiting the profile likelihood", Bioinformatics 25(15), 2009.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from calibration.black_box import failures_explained
from calibration.noise import Robust
from calibration.profile_walk import Lower, Neighbourhood, Side, walk
from calibration.progress import ProgressOption, reporting
from calibration.result import FitResult, ParameterEstimate, student_quantile
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

# How far the search goes before an end counts as open: as a multiple of the Wald reach, of a mere
# guess of the scale, and (log and logit) in the logarithm, where it is a factor of 1e15.
_FAR, _FAR_FROM_A_GUESS, _FAR_IN_LOGARITHM = 1e4, 1e6, 34.5
# Largest first step in a logarithm, however wide the Wald interval is.
_FIRST_IN_LOGARITHM = 3.0


@dataclass(frozen=True)
class ProfileEnd:
    """One end of a profile-likelihood interval.

    Attributes
    ----------
    value : float or None
        Where it is, in natural units; None when open or failed.
    status : str
        "closed", "at bound" (the bound comes before the misfit has risen enough), "open" (the
        misfit never rises enough) or "failed".
    reason : str
        Why it is not simply closed, as half a sentence.
    """

    value: float | None
    status: str
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain JSON types."""
        return {"value": self.value, "status": self.status, "reason": self.reason}


@dataclass(frozen=True)
class ParameterProfile:
    """Profile likelihood of one parameter.

    Attributes
    ----------
    value : float
        Best value, in `unit`.
    unit : str
        Its unit.
    low, high : ProfileEnd or None
        Ends of the interval; None when the parameter has no profile.
    reason : str
        Why it has none, as half a sentence.
    threshold : float
        Height of ``|zeta|`` that makes an end: Student's quantile.
    values, zeta : ndarray, shape (m,)
        The curve, by rising value, for plotting: natural values and signed root of twice the rise.
    """

    value: float
    unit: str
    low: ProfileEnd | None
    high: ProfileEnd | None
    reason: str
    threshold: float
    values: np.ndarray
    zeta: np.ndarray

    @property
    def interval(self) -> tuple[float | None, float | None] | None:
        """Low and high end, None for an end that is open or failed; None without a profile."""
        if self.low is None or self.high is None:
            return None
        return self.low.value, self.high.value

    @property
    def closed(self) -> bool:
        """Whether the misfit rises enough on both sides."""
        ends = (self.low, self.high)
        return all(end is not None and end.status == "closed" for end in ends)

    @property
    def skew(self) -> float | None:
        """(upper - lower reach) / (upper + lower reach), 0 when symmetric; None unless closed."""
        if not self.closed or self.low is None or self.high is None:
            return None
        if self.low.value is None or self.high.value is None:
            return None
        width = self.high.value - self.low.value
        return (self.high.value + self.low.value - 2.0 * self.value) / width if width > 0 else None

    def in_words(self) -> str:
        """``low to high unit`` and the reasons, or why there is no profile."""
        if self.low is None or self.high is None:
            return f"no profile: {self.reason}"
        words = [
            f"{end.value:.6g}" if end.value is not None else end.status
            for end in (self.low, self.high)
        ]
        text = " to ".join(words) + (f" {self.unit}" if self.unit else "")
        if self.skew is not None:
            text += f"  skew {self.skew:+.2f}"
        sides = (("below", self.low), ("above", self.high))
        reasons = [f"{side} {end.reason}" for side, end in sides if end.reason]
        return text + ("; " + "; ".join(reasons) if reasons else "")

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain JSON types."""
        return {
            "value": self.value,
            "unit": self.unit,
            "interval": None if self.interval is None else list(self.interval),
            "low": None if self.low is None else self.low.as_dict(),
            "high": None if self.high is None else self.high.as_dict(),
            "reason": self.reason,
            "skew": self.skew,
            "threshold": self.threshold if np.isfinite(self.threshold) else None,
            "curve": {"values": self.values.tolist(), "zeta": self.zeta.tolist()},
        }


@dataclass(frozen=True)
class ProfileLikelihood:
    """Profile-likelihood intervals of a fit.

    Attributes
    ----------
    model, data_hash : str
        What was fitted, and to which data.
    level : float
        Confidence level of the intervals.
    parameters : dict of str to ParameterProfile
        Those asked for; fixed and tied ones only say why they have none.
    better : dict of str to float or None
        Natural values of the free parameters where the misfit is lower than at the fit, which then
        was a local optimum; None when no such place was met.
    warnings : tuple of str
        What the user should know before trusting the intervals.
    """

    model: str
    data_hash: str
    level: float
    parameters: dict[str, ParameterProfile]
    better: dict[str, float] | None = None
    warnings: tuple[str, ...] = ()

    def report(self) -> str:
        """The intervals as text, one line for each parameter.

        Returns
        -------
        str
            Several lines.
        """
        width = max(len(name) for name in self.parameters)
        lines = [f"profile likelihood of {self.model}, {100 * self.level:g} %"]
        lines += [f"  {name:<{width}}  {p.in_words()}" for name, p in self.parameters.items()]
        if self.warnings:
            lines += ["", "warnings", *(f"  {warning}." for warning in self.warnings)]
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """The result as plain JSON types; the keys are part of the interface."""
        return {
            "model": self.model,
            "data_hash": self.data_hash,
            "level": self.level,
            "parameters": {name: p.as_dict() for name, p in self.parameters.items()},
            "better": self.better,
            "warnings": list(self.warnings),
        }


def profile(
    result: FitResult,
    names: Sequence[str] | str | None = None,
    level: float = 0.95,
    progress: ProgressOption = None,
) -> ProfileLikelihood:
    """Profile-likelihood intervals of parameters of a finished fit.

    Parameters
    ----------
    result : FitResult
        A converged fit.
    names : sequence of str, optional
        Which parameters; all when left out.
    level : float
        Confidence level, between 0 and 1.
    progress : bool or callable, optional
        True for a bar on stderr, or a function of (stage, done, total).

    Returns
    -------
    ProfileLikelihood
        Intervals, curves and reasons. An end that is open or failed is returned, not raised.

    Raises
    ------
    InputError
        If a name is unknown, the level is not between 0 and 1, or the fit did not converge.
    RuntimeError
        If JAX makes 32-bit floats.

    Notes
    -----
    The interval of a parameter is where twice the rise of the cost stays below t squared, t being
    Student's two-sided quantile with the degrees of freedom of the estimate; noise levels stay as
    the fit found them. It does not depend on the transform of the parameter. On either side the
    nearest end is taken, so a separate second optimum is met only where the rise in between stays
    below the threshold; `calibration.solvers.multistart` looks for others.
    """
    require_float64("A profile")
    wanted = _wanted(result, names)
    if not 0.0 < level < 1.0:
        raise InputError(f"level is {level!r}, but must be between 0 and 1, such as 0.95.")
    if not result.converged:
        raise InputError(f"the fit did not converge ({result.status}): profile one that did.")
    around = _neighbourhood(result)
    lows: list[Lower] = []
    profiles = {}
    with reporting(progress) as told, failures_explained(result.problem.structure.functions):
        told.compiling("profiles")
        for number, name in enumerate(wanted, start=1):
            profiles[name], found = _parameter_profile(result, name, around, level)
            lows += found
            told.running("profiles", number, len(wanted))
    better, warnings = _better(result, around, lows)
    problem = result.problem
    if any(isinstance(dataset.noise, Robust) for dataset in problem.datasets.values()):
        warnings += (
            "a robust loss is not a likelihood: how often its profile covers is not known",
        )
    return ProfileLikelihood(problem.name, problem.data_hash, level, profiles, better, warnings)


def _wanted(result: FitResult, names: Sequence[str] | str | None) -> tuple[str, ...]:
    known = result.problem.layout.names
    wanted = known if names is None else (names,) if isinstance(names, str) else tuple(names)
    for name in wanted:
        if name not in known:
            raise InputError(f"parameter {name!r} is unknown{nearest(name, known)}.")
    return wanted


def _neighbourhood(result: FitResult) -> Neighbourhood:
    """The cost around the fit, with the noise levels that it found."""
    problem = result.problem
    levels = tuple(result.noise[name] or 1.0 for name in problem.datasets)
    lower, upper = problem.layout.internal_bounds()
    arguments = jax.device_put((problem.fixed_values, problem.data(levels)))
    return Neighbourhood.around(problem.structure, result.vector, lower, upper, arguments)


def _parameter_profile(
    result: FitResult, name: str, around: Neighbourhood, level: float
) -> tuple[ParameterProfile, list[Lower]]:
    problem, estimate = result.problem, result.parameters[name]
    freedom = _freedom(result, estimate)
    reason = _why_no_profile(result, name, freedom)
    if reason:
        nothing = np.zeros(0)
        missing = (None, None, reason, np.nan, nothing, nothing)
        return ParameterProfile(estimate.value, estimate.unit, *missing), []
    index = problem.layout.free.index(name)
    threshold = float(student_quantile(0.5 + 0.5 * level, freedom))
    first, limit = _scale(result, index, threshold)
    tangent = _tangent(result, index)
    sides = [
        walk(around, index, direction, threshold, first, limit, direction * tangent)
        for direction in (-1.0, 1.0)
    ]
    values, zeta = [estimate.value], [0.0]
    for direction, side in zip((-1.0, 1.0), sides, strict=True):
        for point in side.points:
            values.append(float(problem.layout.free_values(point.vector)[index]))
            zeta.append(direction * point.root)
    order = np.argsort(values, kind="stable")
    found = ParameterProfile(
        value=estimate.value,
        unit=estimate.unit,
        low=_end(result, index, -1.0, sides[0]),
        high=_end(result, index, 1.0, sides[1]),
        reason="",
        threshold=threshold,
        values=np.array(values)[order],
        zeta=np.array(zeta)[order],
    )
    return found, [side.lower for side in sides if side.lower is not None]


def _freedom(result: FitResult, estimate: ParameterEstimate) -> float:
    """Degrees of freedom for the threshold, also where there is no standard deviation."""
    if estimate.std is not None or result.problem.noise_known:
        return estimate.freedom
    return float(result.degrees_of_freedom)


def _why_no_profile(result: FitResult, name: str, freedom: float) -> str:
    layout, estimate = result.problem.layout, result.parameters[name]
    if name in layout.fixed:
        return "it is fixed"
    target = dict(layout.tied).get(name)
    if isinstance(target, str):
        return f"it follows {target}"
    if target is not None:
        return "it follows other parameters"
    if freedom <= 0 or (estimate.verdict == "identified" and estimate.std is None):
        return "no reading is left over to show its error"
    return ""


def _scale(result: FitResult, index: int, threshold: float) -> tuple[float, float]:
    """First distance to try and the last, in the internal coordinate."""
    layout = result.problem.layout
    estimate = result.parameters[layout.free[index]]
    slope = float(layout.slopes(result.vector)[index])
    straight = layout.transforms[index] == "identity"
    if estimate.std is not None and estimate.std > 0 and slope > 0:
        first = threshold * estimate.std / slope
        if straight:
            return first, _FAR * first
        return min(first, _FIRST_IN_LOGARITHM), _FAR_IN_LOGARITHM
    if not straight:
        return 1.0, _FAR_IN_LOGARITHM
    lower, upper = layout.bounds[index]
    if estimate.interval95 is not None and estimate.interval95[1] > estimate.interval95[0]:
        first = estimate.interval95[1] - estimate.interval95[0]
    elif np.isfinite(upper - lower):
        first = 0.05 * (upper - lower)
    else:
        first = 0.1 * abs(estimate.value) or 1.0
    return first, _FAR_FROM_A_GUESS * first


def _tangent(result: FitResult, index: int) -> np.ndarray:
    """How the internal vector follows its own entry `index`, by the covariance; shape (p,)."""
    slopes = result.problem.layout.slopes(result.vector)
    own = np.eye(len(slopes))[index]
    column = result.covariance[:, index]
    if not (np.isfinite(column[index]) and column[index] > 0 and np.all(slopes > 0)):
        return own
    # Parameters without a covariance stay where they are: a first guess, mended by each fit.
    along = np.nan_to_num(column / slopes) / (column[index] / slopes[index])
    return np.where(own > 0, 1.0, along)


def _end(result: FitResult, index: int, direction: float, side: Side) -> ProfileEnd:
    layout = result.problem.layout
    bound = layout.bounds[index][0 if direction < 0 else 1]
    which = "lower" if direction < 0 else "upper"
    last = float(layout.free_values(side.vector)[index])
    if side.status == "open" and np.isfinite(bound):
        # The end of a log or logit transform's own range lies at infinity: as good as there.
        return ProfileEnd(bound, "at bound", f"its {which} bound {bound:g} is not excluded")
    if side.status == "at bound":
        held = f"it is held at its {which} bound {bound:g}"
        passed = f"its {which} bound {bound:g} is not excluded"
        return ProfileEnd(bound, "at bound", passed if side.points else held)
    if side.status == "open":
        return ProfileEnd(None, "open", f"no value as far as {last:.3g} is excluded")
    if side.status == "closed":
        return ProfileEnd(last, "closed", side.reason)
    return ProfileEnd(None, "failed", f"{side.reason} (at {last:.6g})")


def _better(
    result: FitResult, around: Neighbourhood, lows: list[Lower]
) -> tuple[dict[str, float] | None, tuple[str, ...]]:
    """Natural values at the lowest cost met, if that is lower than the fit's, and a warning."""
    lows = [*lows, *([around.lower] if around.lower is not None else [])]
    if not lows:
        return None, ()
    layout = result.problem.layout
    lowest = around.settled(min(lows, key=lambda low: low.cost))
    values = {
        n: float(v) for n, v in zip(layout.free, layout.free_values(lowest.vector), strict=True)
    }
    where = ", ".join(f"{name} = {value:.6g}" for name, value in values.items())
    return values, (
        f"the fit is a local optimum: at {where} twice the cost is lower by "
        f"{2.0 * (around.fitted_cost - lowest.cost):.3g}; fit again from there",
    )
