"""From a solver's last point to a `FitResult`: covariance, intervals, verdicts, warnings."""

import functools
from dataclasses import dataclass
from functools import cached_property

import jax
import numpy as np
import scipy.special
from jax import Array

from calibration.identify import Identifiability, analyse, trades_in_words, unseen_in_words
from calibration.parameters import ParameterLayout
from calibration.problem import Problem
from calibration.result import (
    FitResult,
    ParameterEstimate,
    correlation_of,
    student_quantile,
)
from calibration.solvers.outcome import Outcome
from calibration.structure import ProblemStructure


@dataclass(frozen=True)
class Solution:
    """A solver's last point with the noise found there.

    Attributes
    ----------
    problem : Problem
        What was solved.
    outcome : Outcome
        Where the solver stopped; its residuals are in units of `assumed_noise`.
    held : ndarray of bool, shape (p,)
        Parameters that a bound holds back.
    assumed_noise, noise : tuple of float
        Noise level of each data set as the solver took it, and as the residuals show it.
    sound : bool
        Whether the model and its derivative were finite there; if not, there is a point but
        nothing to say about it.
    """

    problem: Problem
    outcome: Outcome
    held: np.ndarray
    assumed_noise: tuple[float, ...]
    noise: tuple[float, ...]
    sound: bool = True

    def result(self, solver: str) -> FitResult:
        """Everything there is to say about the solution."""
        problem, free = self.problem, self.problem.layout.free
        covariance = self.analysis.covariance.copy()
        without = self.held | np.array([self.analysis.is_flat(row) for row in np.eye(len(free))])
        covariance[without, :] = covariance[:, without] = np.nan
        return FitResult(
            problem=problem,
            parameters={name: self._estimate(name) for name in problem.layout.names},
            status=self.outcome.status,
            converged=self.outcome.converged,
            solver=solver,
            steps=self.outcome.steps,
            vector=self.outcome.vector,
            covariance=covariance,
            seen_covariance=self.analysis.covariance,
            residuals=self._raw_residuals(),
            noise={
                name: None if dataset.sigma is not None else level
                for (name, dataset), level in zip(problem.datasets.items(), self.noise, strict=True)
            },
            degrees_of_freedom=self.freedom,
            reduced_chi2=self._reduced_chi2,
            condition=self._condition,
            directions=self._directions(),
            trades=trades_in_words(correlation_of(covariance), free),
            warnings=self._warnings(),
        )

    @cached_property
    def standardised(self) -> np.ndarray:
        """Residuals in units of the noise found, priors included."""
        return self.outcome.residuals * self._rescaling

    @cached_property
    def jacobian(self) -> np.ndarray:
        """Derivative of `standardised` by the natural free parameters, shape (n, p)."""
        scaled = self.outcome.jacobian * self._rescaling[:, None]
        return np.divide(scaled, self.slopes, out=np.zeros_like(scaled), where=self.slopes > 0)

    @cached_property
    def slopes(self) -> np.ndarray:
        """Derivative of natural by internal parameter, shape (p,)."""
        return self.problem.layout.slopes(self.outcome.vector)

    @cached_property
    def analysis(self) -> Identifiability:
        """Rank and covariance of the parameters that no bound holds."""
        return analyse(np.where(self.held, 0.0, self.jacobian))

    @cached_property
    def analysis_of_data(self) -> Identifiability:
        """The same without priors: what the readings alone tell."""
        if not self.problem.layout.priors:
            return self.analysis
        return analyse(np.where(self.held, 0.0, self.jacobian[self._of_data]))

    @property
    def _of_data(self) -> slice:
        """The rows of readings and their noise, without those of priors."""
        return slice(0, len(self.outcome.residuals) - len(self.problem.layout.priors))

    @cached_property
    def freedom(self) -> int:
        """Readings and informative priors less parameters determined."""
        return self.problem.size + self.problem.informing_priors - self.analysis.rank

    def freedom_of(self, gradient: np.ndarray) -> float:
        """Degrees of freedom of a quantity's standard deviation (Welch and Satterthwaite).

        Parameters
        ----------
        gradient : ndarray, shape (p,)
            Derivative of the quantity by the natural free parameters.

        Returns
        -------
        float
            Of Student's t; infinite where all the noise that matters is known.
        """
        shares = (self.jacobian @ (self.analysis.covariance @ gradient)) ** 2
        unknown = 0.0
        for part, dataset in zip(self.problem.slices, self.problem.datasets.values(), strict=True):
            if dataset.sigma is None:
                own = len(dataset.y) - float(np.sum(self.analysis.leverage[part]))
                square = float(np.sum(shares[part])) ** 2
                if square > 0:
                    unknown += square / own if own > 1e-9 else np.inf
        total = float(np.sum(shares)) ** 2
        return total / unknown if unknown > 0 else np.inf

    @cached_property
    def _rescaling(self) -> np.ndarray:
        scale = np.ones_like(self.outcome.residuals)
        for part, assumed, found in zip(
            self.problem.slices, self.assumed_noise, self.noise, strict=True
        ):
            scale[part] = assumed / found
        return scale

    @cached_property
    def _natural(self) -> dict[str, float]:
        layout = self.problem.layout
        found = layout.natural(self.outcome.vector, self.problem.fixed_values)
        values = {name: float(value) for name, value in found.items()}
        # A transform returns a bound only to rounding, and just outside is outside.
        for name, (low, high) in zip(layout.free, layout.bounds, strict=True):
            values[name] = min(max(values[name], low), high)
        return values

    @property
    def _reduced_chi2(self) -> float | None:
        given = all(d.sigma_kind == "given" for d in self.problem.datasets.values())
        if not given or not self.problem.structure.least_squares or self.freedom == 0:
            return None
        return float(np.sum(self.standardised**2)) / self.freedom

    @property
    def _condition(self) -> float:
        return self._unheld.condition if not all(self.held) else 1.0

    @cached_property
    def _unheld(self) -> Identifiability:
        """The analysis without the columns of parameters that a bound holds."""
        return analyse(self.jacobian[:, ~self.held]) if np.any(self.held) else self.analysis

    def _raw_residuals(self) -> dict[str, np.ndarray]:
        residuals = {}
        if not self.problem.structure.least_squares or any(
            dataset.x_sigma is not None for dataset in self.problem.datasets.values()
        ):
            predictions = _predictions(
                self.problem.structure,
                self.outcome.vector,
                self.problem.fixed_values,
                self.problem.data(),
            )
            return {
                name: dataset.y - np.asarray(prediction)
                for (name, dataset), prediction in zip(
                    self.problem.datasets.items(), predictions, strict=True
                )
            }
        for (name, dataset), part, level in zip(
            self.problem.datasets.items(), self.problem.slices, self.assumed_noise, strict=True
        ):
            sigma = level if dataset.sigma is None else dataset.sigma
            residuals[name] = -self.outcome.residuals[part] * sigma
        return residuals

    @cached_property
    def _tied_gradients(self) -> dict[str, np.ndarray]:
        """Derivative of every parameter by the internal vector, each of shape (p,)."""
        layout, fixed = self.problem.layout, self.problem.fixed_values
        gradients = _gradients_of_all(layout, self.outcome.vector, fixed)
        return {name: np.asarray(gradient) for name, gradient in gradients.items()}

    def _gradient(self, name: str) -> np.ndarray:
        """Derivative of a parameter by the natural free ones, shape (p,)."""
        layout = self.problem.layout
        if name in layout.free:
            return np.eye(len(layout.free))[layout.free.index(name)]
        target = dict(layout.tied).get(name)
        if target is None:
            return np.zeros(len(layout.free))
        if isinstance(target, str):
            return self._gradient(target)
        tied = self._tied_gradients[name]
        return np.divide(tied, self.slopes, out=np.zeros_like(tied), where=self.slopes > 0)

    def _estimate(self, name: str) -> ParameterEstimate:
        unit, value = self.problem.parameters[name].unit, self._natural[name]
        gradient = self._gradient(name)

        def estimate(
            verdict: str,
            reason: str = "",
            std: float | None = None,
            interval: tuple[float, float] | None = None,
            freedom: float = np.inf,
        ) -> ParameterEstimate:
            return ParameterEstimate(value, std, interval, unit, verdict, reason, freedom)

        if not np.any(gradient):
            return estimate("fixed")
        if not self.sound:
            return estimate("flat", "the model is not finite there")
        if np.any(gradient[self.held]):
            return self._estimate_held(name, value, unit)
        if self.analysis.is_flat(gradient):
            return estimate("flat", "the data leave it open, see below")
        freedom = self.freedom_of(gradient)
        if freedom == 0:
            return estimate("identified", "but no reading is left over to show its error")
        std = float(np.sqrt(gradient @ self.analysis.covariance @ gradient))
        interval = self._interval(name, value, std, freedom)
        if self.analysis_of_data.is_flat(gradient):
            reason = "its interval comes from the prior alone"
            return estimate("flat", reason, std, interval, freedom)
        below, above = self._reaches_bounds(name, interval, std)
        lower, upper = self._bounds(name)
        cut = (max(interval[0], lower), min(interval[1], upper))
        if below and above:
            reason = f"its 95 % interval is as wide as its bounds ({lower:g}, {upper:g})"
            return estimate("flat", reason, std, cut, freedom)
        if below or above:
            side, bound = ("lower", lower) if below else ("upper", upper)
            reason = f"its 95 % interval reaches the {side} bound {bound:g}"
            return estimate("one-sided", reason, std, cut, freedom)
        return estimate("identified", "", std, interval, freedom)

    def _bounds(self, name: str) -> tuple[float, float]:
        """Bounds of a parameter, cut to where its prior is not zero."""
        layout = self.problem.layout
        return layout.bounds[layout.free.index(name)] if name in layout.free else (-np.inf, np.inf)

    def _reaches_bounds(
        self, name: str, interval: tuple[float, float], std: float
    ) -> tuple[bool, bool]:
        """Whether an interval reaches the lower and the upper bound.

        A transform keeps its interval inside the bounds by construction: there, being as good
        as at the bound is what counts.
        """
        lower, upper = self._bounds(name)
        layout = self.problem.layout
        transform = "identity"
        if name in layout.free:
            transform = layout.transforms[layout.free.index(name)]
        if transform == "logit":
            margin = 0.025 * (upper - lower)
            return interval[0] < lower + margin, interval[1] > upper - margin
        if transform == "log":
            # Past a factor of e per standard deviation nothing but an upper limit is known.
            return std > self._natural[name] or interval[0] < lower, interval[1] > upper
        return interval[0] < lower, interval[1] > upper

    def _interval(self, name: str, value: float, std: float, freedom: float) -> tuple[float, float]:
        """95 % interval, symmetric in the coordinate that the solver works in."""
        reach = student_quantile(0.975, freedom) * std
        if name not in self.problem.layout.free:
            return value - reach, value + reach
        ends = self.problem.layout.around(self.outcome.vector, name, np.array([-reach, reach]))
        return float(ends[0]), float(ends[1])

    def _estimate_held(self, name: str, value: float, unit: str) -> ParameterEstimate:
        """A parameter at its bound, with the one-sided limit where the misfit has risen enough."""
        layout = self.problem.layout
        if name not in layout.free:
            reason = "it follows a parameter that is held at a bound"
            return ParameterEstimate(value, None, None, unit, "one-sided", reason)
        index = layout.free.index(name)
        lower, upper = layout.bounds[index]
        at_lower = abs(value - lower) <= abs(value - upper)
        side, bound = ("lower", lower) if at_lower else ("upper", upper)
        reason = f"held at its {side} bound {bound:g}"
        others = self.held.copy()
        others[index] = False
        released = analyse(np.where(others, 0.0, self.jacobian))
        unit_vector = np.eye(len(layout.free))[index]
        if released.is_flat(unit_vector):
            return ParameterEstimate(value, None, None, unit, "flat", reason)
        freedom = float(self.freedom) if not self.problem.noise_known else np.inf
        slope = abs(float(self.jacobian[:, index] @ self.standardised))
        curvature = 1.0 / released.covariance[index, index]
        threshold = student_quantile(0.95, freedom) ** 2
        reach = (np.sqrt(slope**2 + curvature * threshold) - slope) / curvature
        limit = float(value + reach if at_lower else value - reach)
        interval = (value, min(limit, upper)) if at_lower else (max(limit, lower), value)
        if not np.isfinite(limit):
            return ParameterEstimate(value, None, None, unit, "one-sided", reason)
        return ParameterEstimate(value, None, interval, unit, "one-sided", reason, freedom)

    def _directions(self) -> tuple[str, ...]:
        seen = ~self.held
        if not self.sound or not np.any(seen):
            return ()
        free = self.problem.layout.free
        names = tuple(n for n, s in zip(free, seen, strict=True) if s)
        values = np.array([self._natural[n] for n in names])
        by_data = self._unheld
        if self.problem.layout.priors:
            by_data = analyse(self.jacobian[self._of_data][:, seen])
        return unseen_in_words(by_data, names, values)

    def _warnings(self) -> tuple[str, ...]:
        warnings = []
        if not self.outcome.converged:
            warnings.append("the fit did not converge: do not use the intervals")
        if self.sound and self.freedom == 0:
            warnings.append(
                "as many parameters as readings: the misfit says nothing about the model"
            )
        chi2 = self._reduced_chi2
        if chi2 is not None and scipy.special.chdtrc(self.freedom, chi2 * self.freedom) < 1e-3:
            warnings.append(
                f"the misfit is {np.sqrt(chi2):.2g} times what sigma allows: the model or sigma "
                "is wrong, and the intervals are too narrow"
            )
        return tuple(warnings)


@functools.partial(jax.jit, static_argnames="layout")
def _gradients_of_all(layout: ParameterLayout, vector: Array, fixed: Array) -> dict[str, Array]:
    return jax.jacfwd(layout.natural)(vector, fixed)


@functools.partial(jax.jit, static_argnames="structure")
def _predictions(
    structure: ProblemStructure, vector: Array, fixed: Array, data: tuple
) -> tuple[Array, ...]:
    return structure.predictions(vector, fixed, data)
