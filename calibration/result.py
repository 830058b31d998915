"""The result of a fit: values, intervals, verdicts, and a report that says what is missing."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri, stdtrit

from calibration.text import sections

if TYPE_CHECKING:
    from calibration.problem import Problem


@dataclass(frozen=True)
class ParameterEstimate:
    """What a fit found of one parameter.

    Attributes
    ----------
    value : float
        Best value.
    std : float or None
        Standard deviation; None when the data leave the parameter open or a bound holds it.
    interval95 : (float, float) or None
        95 % interval; None when the data leave the parameter open.
    unit : str
        Unit of all of them.
    verdict : str
        "identified", "one-sided", "flat", or "fixed".
    reason : str
        Why the verdict is not "identified" or an interval is missing, as half a sentence.
    freedom : float
        Degrees of freedom of the standard deviation; infinite where the noise is known.
    """

    value: float
    std: float | None
    interval95: tuple[float, float] | None
    unit: str
    verdict: str
    reason: str = ""
    freedom: float = math.inf

    def as_dict(self) -> dict[str, Any]:
        """The fields as plain JSON types."""
        return {
            "value": self.value,
            "std": self.std,
            "interval95": None if self.interval95 is None else list(self.interval95),
            "unit": self.unit,
            "verdict": self.verdict,
            "reason": self.reason,
            "degrees_of_freedom": self.freedom if math.isfinite(self.freedom) else None,
        }

    def in_words(self) -> str:
        """``value +- std [95 %: low, high] unit``, or why a part is missing."""
        value = f"{self.value:.6g}"
        if self.std is not None:
            value += f" +- {self.std:.2g}"
        if self.interval95 is not None and self.verdict != "fixed":
            value += f" [95 %: {self.interval95[0]:.6g}, {self.interval95[1]:.6g}]"
        if self.unit:
            value += f" {self.unit}"
        return value + f"  {self.verdict}" + (f": {self.reason}" if self.reason else "")


@dataclass(frozen=True)
class FitResult:
    """Outcome of `calibration.fit`.

    Attributes
    ----------
    problem : Problem
        What was fitted.
    parameters : dict of str to ParameterEstimate
        Every parameter of the problem, fixed and tied ones too.
    status : str
        Why the solver stopped, as a sentence.
    converged : bool
        Whether that is an optimum.
    solver : str
        Which solver.
    steps : int
        Steps it made.
    vector : ndarray, shape (p,)
        Solution in internal coordinates.
    covariance : ndarray, shape (p, p)
        Covariance of the free parameters in natural units; NaN rows where none exists.
    seen_covariance : ndarray, shape (p, p)
        The same on the directions that the data see, 0 on the others: finite always, for what
        follows from parameters that are flat one by one.
    residuals : dict of str to ndarray
        Reading less model for every data set.
    noise : dict of str to float or None
        Noise level estimated for every data set; None where sigma was given.
    degrees_of_freedom : int
        Readings and priors less parameters determined.
    reduced_chi2 : float or None
        Weighted squared misfit per degree of freedom; None when the noise was estimated.
    condition : float
        Condition number of the column-normalised Jacobian.
    directions : tuple of str
        What the data cannot tell, as sentences.
    trades : tuple of str
        Strong correlations, as sentences.
    warnings : tuple of str
        What the user should know before trusting the result.
    """

    problem: "Problem"
    parameters: dict[str, ParameterEstimate]
    status: str
    converged: bool
    solver: str
    steps: int
    vector: np.ndarray
    covariance: np.ndarray
    seen_covariance: np.ndarray
    residuals: dict[str, np.ndarray]
    noise: dict[str, float | None]
    degrees_of_freedom: int
    reduced_chi2: float | None
    condition: float
    directions: tuple[str, ...] = ()
    trades: tuple[str, ...] = ()
    warnings: tuple[str, ...] = field(default=())

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of `covariance`."""
        return self.problem.layout.free

    @property
    def residual_rms(self) -> float:
        """Root mean square of all residuals, in the unit of the readings."""
        return float(np.sqrt(np.mean(np.concatenate(list(self.residuals.values())) ** 2)))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation matrix of the free parameters, shape (p, p)."""
        return correlation_of(self.covariance)

    def quantiles(self, name: str, levels: np.ndarray) -> np.ndarray:
        """Quantiles of what the fit says of a parameter, in its transform's coordinate.

        Parameters
        ----------
        name : str
            A parameter that has a standard deviation.
        levels : ndarray
            Probabilities.

        Returns
        -------
        ndarray
            Natural values: of the normal distribution, or of Student's t where the noise was
            estimated.
        """
        estimate = self.parameters[name]
        if estimate.std is None:
            raise ValueError(f"{name} has no standard deviation")
        standard = student_quantile(levels, estimate.freedom)
        if name not in self.free:
            return estimate.value + standard * estimate.std
        return self.problem.layout.around(self.vector, name, standard * estimate.std)

    def report(self) -> str:
        """The result as text: what was fitted, how well, and what the data cannot tell.

        Returns
        -------
        str
            Several lines.
        """
        counts = ", ".join(f"{name} {len(r)}" for name, r in self.residuals.items())
        lines = [
            f"model     {self.problem.name}",
            f"data      {self.problem.data_hash} ({counts} readings)",
            f"solver    {self.solver}, {self.steps} steps",
            f"status    {self.status}",
        ]
        misfit = f"misfit    rms {self.residual_rms:.4g}"
        if self.degrees_of_freedom == 0:
            misfit += "; no reading left over to judge it by"
        elif self.reduced_chi2 is None and not any(s is not None for s in self.noise.values()):
            models = ", ".join(dict.fromkeys(str(d.noise) for d in self.problem.datasets.values()))
            misfit += f"; noise fitted along: {models}"
        elif self.reduced_chi2 is None:
            levels = ", ".join(f"{n} {s:.4g}" for n, s in self.noise.items() if s is not None)
            misfit += f"; noise estimated from the residuals: {levels}"
        else:
            misfit += f"; reduced chi-square {self.reduced_chi2:.4g}"
        lines += [misfit + f" ({self.degrees_of_freedom} degrees of freedom)", "", "parameters"]
        width = max(len(name) for name in self.parameters)
        lines += [f"  {name:<{width}}  {p.in_words()}" for name, p in self.parameters.items()]
        lines += self._bounds_lines() + self._correlation_lines()
        lines.append(f"condition number {self.condition:.3g}")
        lines += sections(
            (
                ("the data cannot tell", self.directions),
                ("trade-offs", self.trades),
                ("warnings", self.warnings),
            )
        )
        return "\n".join(lines)

    def _bounds_lines(self) -> list[str]:
        held = [n for n, p in self.parameters.items() if p.reason.startswith("held at")]
        return ["", f"bounds hit  {', '.join(held) if held else 'none'}"]

    def _correlation_lines(self) -> list[str]:
        pairs = []
        matrix = self.correlation
        for i, first in enumerate(self.free):
            for j in range(i + 1, len(self.free)):
                if np.isfinite(matrix[i, j]):
                    pairs.append(f"{first}, {self.free[j]} {matrix[i, j]:+.3f}")
        return [f"correlations  {'; '.join(pairs)}"] if pairs else []

    def as_dict(self) -> dict[str, Any]:
        """The result as plain JSON types; the keys are part of the interface."""
        return {
            "model": self.problem.name,
            "data_hash": self.problem.data_hash,
            "solver": self.solver,
            "status": self.status,
            "converged": self.converged,
            "parameters": {name: p.as_dict() for name, p in self.parameters.items()},
            "residual_rms": self.residual_rms,
            "noise": self.noise,
            "degrees_of_freedom": self.degrees_of_freedom,
            "reduced_chi2": self.reduced_chi2,
            "condition": self.condition if np.isfinite(self.condition) else None,
            "correlations": {
                f"{first},{self.free[j]}": float(self.correlation[i, j])
                for i, first in enumerate(self.free)
                for j in range(i + 1, len(self.free))
                if np.isfinite(self.correlation[i, j])
            },
            "cannot_tell": list(self.directions),
            "warnings": [*self.trades, *self.warnings],
        }


def correlation_of(covariance: np.ndarray) -> np.ndarray:
    """Correlation matrix of a covariance matrix; NaN where a variance is missing or 0."""
    std = np.sqrt(np.diag(covariance))
    std = np.where(std > 0, std, np.nan)
    return covariance / np.outer(std, std)


def student_quantile(level: Any, freedom: float) -> Any:
    """Quantile of Student's t, or of the normal distribution for infinite degrees of freedom.

    Parameters
    ----------
    level : array_like
        Probability.
    freedom : float
        Degrees of freedom, > 0.

    Returns
    -------
    array_like
        The quantile; NaN where there is no degree of freedom.
    """
    if math.isinf(freedom):
        return ndtri(level)
    return stdtrit(freedom, level) if freedom > 0 else np.full_like(level, np.nan, dtype=float)
