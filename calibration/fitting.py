"""`fit`: the best parameters of a problem, their covariance, and what the data cannot tell."""

import dataclasses
import functools
import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jax import Array

from calibration.black_box import failures_explained
from calibration.identify import Identifiability, analyse
from calibration.noise import Robust
from calibration.parameters import ParameterLayout
from calibration.problem import Problem
from calibration.result import FitResult
from calibration.solution import Solution
from calibration.solvers import box_lm
from calibration.solvers.outcome import Outcome, held_at_bounds
from calibration.structure import ProblemStructure
from procmodel.errors import InputError, nearest
from procmodel.precision import require_float64

# Each solver: the module with its `solve`, and the class of its options.
SOLVERS = {
    "box_lm": ("calibration.solvers.box_lm", "BoxLMOptions"),
    "optimistix": ("calibration.solvers.optimistix_engine", "OptimistixOptions"),
    "scipy": ("calibration.solvers.scipy_trf", "ScipyTrfOptions"),
    "jaxopt": ("calibration.solvers.jaxopt_lbfgsb", "JaxoptOptions"),
}
_NOISE_ROUNDS = 50
# Of a normal distribution: its standard deviation over its median absolute deviation.
_MEDIAN_TO_STD = 1.4826


def fit(problem: Problem, solver: str = "box_lm", **options: Any) -> FitResult:
    """Fit the free parameters of a problem.

    Parameters
    ----------
    problem : Problem
        Model, parameters and readings.
    solver : {"box_lm", "optimistix", "scipy", "jaxopt"}
        Our bounded Levenberg-Marquardt, or one of the adapters.
    **options
        Settings of that solver, such as ``max_steps`` and ``tolerance``. With "box_lm",
        ``watch=function`` is called after every step with its number, the cost and a dictionary
        of the free parameters.

    Returns
    -------
    FitResult
        Values, intervals and verdicts. A fit that did not converge is returned too, with
        ``converged`` False and the reason in ``status``.

    Raises
    ------
    InputError
        If there are fewer readings than parameters, or solver or option names are unknown.
    RuntimeError
        If JAX makes 32-bit floats.

    Notes
    -----
    Where a data set has no sigma, one noise level is estimated for it from its residuals with
    n - p degrees of freedom, and intervals use Student's t. A sigma that is a parameter is fitted
    by maximum likelihood, with intervals from the expected information.
    """
    require_float64("A fit")
    if solver == "box_lm" and options.get("watch") is not None:
        options["watch"] = _Watch(options["watch"], problem.layout)
    run = _solver(solver, options)
    _require_readings_by_their_own_x(problem)
    evidence = problem.size + problem.informing_priors
    if evidence < len(problem.layout.free):
        raise InputError(
            f"{problem.size} readings cannot fit {len(problem.layout.free)} free parameters "
            f"({', '.join(problem.layout.free)}): add readings or fix parameters."
        )
    lower, upper = problem.layout.internal_bounds()
    alone = problem.noise_scales_all
    levels = first_noise_levels(problem)
    start, rounds, steps = problem.start, 1, 0
    while True:
        arguments = (problem.fixed_values, problem.data(levels))
        with failures_explained(problem.structure.functions):
            outcome = run(problem.structure, start, lower, upper, arguments)
        steps += outcome.steps
        sound = bool(np.all(np.isfinite(outcome.jacobian)))
        if not sound:
            outcome = dataclasses.replace(outcome, jacobian=np.zeros_like(outcome.jacobian))
        held = held_at_bounds(outcome.vector, outcome.residuals, outcome.jacobian, lower, upper)
        if rounds == 1 and sound and not alone:
            _require_readings_for_noise(problem, outcome)
        analysis = analyse(np.where(held, 0.0, outcome.jacobian))
        estimated = _noise_levels(problem, outcome, analysis, levels)
        settled = alone or np.allclose(estimated, levels, rtol=1e-9, atol=0.0)
        if settled or not outcome.converged or rounds == _NOISE_ROUNDS:
            break
        levels, start, rounds = estimated, outcome.vector, rounds + 1
    if outcome.converged and not settled:
        status = "not converged: the noise levels of the data sets do not settle; give their sigma"
        outcome = dataclasses.replace(outcome, status=status, converged=False)
    if sound:
        outcome = _informed(problem, outcome, estimated)
    solution = Solution(
        problem=problem,
        outcome=dataclasses.replace(outcome, steps=steps),
        held=held,
        assumed_noise=levels,
        noise=estimated,
        sound=sound,
    )
    return solution.result(solver)


@dataclass(frozen=True)
class _Watch:
    """Tells a caller's function of a step in natural units."""

    function: Callable[[int, float, dict[str, float]], object]
    layout: ParameterLayout

    def __call__(self, step: Any, cost: Any, vector: Any) -> None:
        # NumPy alone: a computation of JAX would wait for the one that is calling.
        values = self.layout.free_values(np.asarray(vector)).tolist()
        self.function(int(step), float(cost), dict(zip(self.layout.free, values, strict=True)))


def _solver(name: str, options: dict[str, Any]) -> Callable[..., Outcome]:
    """The named solver as ``run(residuals, start, lower, upper, arguments) -> Outcome``."""
    if name not in SOLVERS:
        raise InputError(f"solver {name!r} is unknown{nearest(name, tuple(SOLVERS))}.")
    module_name, class_name = SOLVERS[name]
    module = importlib.import_module(module_name)
    options_class = getattr(module, class_name)
    known = tuple(f.name for f in dataclasses.fields(options_class))
    for option in options:
        if option not in known:
            raise InputError(f"solver {name!r} has no option {option!r}{nearest(option, known)}.")
    settings = options_class(**options)

    def run(
        residuals: box_lm.Residuals,
        start: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        arguments: Any,
    ) -> Outcome:
        if name != "box_lm":
            return module.solve(residuals, start, lower, upper, arguments, settings)
        end = box_lm.solve_compiled(residuals, start, lower, upper, arguments, settings)
        status = int(end.status)
        return Outcome(
            vector=np.asarray(end.vector),
            residuals=np.asarray(end.residuals),
            jacobian=np.asarray(end.jacobian),
            status=box_lm.STATUS[status],
            converged=status in box_lm.CONVERGED,
            steps=int(end.steps),
        )

    return run


def _require_readings_for_noise(problem: Problem, outcome: Outcome) -> None:
    """Refuse to estimate the noise of a data set that its own parameters can fit exactly."""
    for (name, dataset), part in zip(problem.datasets.items(), problem.slices, strict=True):
        if dataset.sigma is None and len(dataset.y) <= analyse(outcome.jacobian[part]).rank:
            raise InputError(
                f"data set {name!r} has {len(dataset.y)} readings, no more than the parameters "
                "they determine, so that its noise cannot be estimated: give its sigma or more "
                "readings."
            )


def _require_readings_by_their_own_x(problem: Problem) -> None:
    """Refuse errors in x for a model in which one reading depends on the x of another."""
    for i, (name, dataset) in enumerate(problem.datasets.items()):
        if dataset.x_sigma is None:
            continue
        signs = np.where(np.random.default_rng(0).uniform(size=len(dataset.y)) < 0.5, -1.0, 1.0)
        alone, mixed = _slopes_by_x(
            problem.structure, i, problem.start, problem.fixed_values, problem.data(), signs
        )
        if not np.allclose(signs * alone, mixed, rtol=1e-6, atol=1e-9 * np.max(np.abs(alone))):
            raise InputError(
                f"data set {name!r} has errors in x, but its model takes a reading from the x of "
                "others too: leave x_sigma out, or write the model point by point."
            )


@functools.partial(jax.jit, static_argnames=("structure", "index"))
def _slopes_by_x(
    structure: ProblemStructure,
    index: int,
    vector: Array,
    fixed: Array,
    data: tuple,
    signs: Array,
) -> tuple[Array, Array]:
    """Derivative of the predictions when every x moves alike, and when each has a sign."""

    def prediction(x: Array) -> Array:
        moved = (*data[:index], (x, *data[index][1:]), *data[index + 1 :])
        return structure.predictions(vector, fixed, moved)[index]

    x = data[index][0]
    alike = jax.jvp(prediction, (x,), (jax.numpy.ones_like(x),))[1]
    return alike, jax.jvp(prediction, (x,), (signs,))[1]


def _standardised(problem: Problem, outcome: Outcome, levels: tuple[float, ...]) -> np.ndarray:
    """Deviations of all readings in units of their noise, unweighted."""
    return np.concatenate(
        _deviations(problem.structure, outcome.vector, problem.fixed_values, problem.data(levels))
    )


@functools.partial(jax.jit, static_argnames="structure")
def _deviations(
    structure: ProblemStructure, vector: Array, fixed: Array, data: tuple
) -> tuple[Array, ...]:
    return structure.deviations(vector, fixed, data)


def _informed(problem: Problem, outcome: Outcome, levels: tuple[float, ...]) -> Outcome:
    """The outcome with J'J the inverse covariance where a robust loss weighs the readings."""
    factors = np.ones(len(outcome.residuals))
    for part, dataset in zip(problem.slices, problem.datasets.values(), strict=True):
        if isinstance(dataset.noise, Robust):
            factors[part] = dataset.noise.information(_standardised(problem, outcome, levels)[part])
    return dataclasses.replace(
        outcome,
        jacobian=outcome.jacobian * factors[:, None],
        residuals=outcome.residuals / factors,
    )


def first_noise_levels(problem: Problem) -> tuple[float, ...]:
    """Spread of the readings of each data set, to begin with where the noise is not known."""
    if problem.noise_scales_all:
        return (1.0,)
    spreads = (float(np.std(d.y)) for d in problem.datasets.values())
    return tuple(s if s > 0 else 1.0 for s in spreads)


def _noise_levels(
    problem: Problem, outcome: Outcome, analysis: Identifiability, levels: tuple[float, ...]
) -> tuple[float, ...]:
    """Noise of each data set from its residuals, less what the parameters absorbed there."""
    estimates = []
    for part, dataset, level in zip(problem.slices, problem.datasets.values(), levels, strict=True):
        if dataset.sigma is not None or not np.all(np.isfinite(outcome.residuals)):
            estimates.append(level)
            continue
        free = len(dataset.y) - float(np.sum(analysis.leverage[part]))
        if isinstance(dataset.noise, Robust):
            # Outliers must not set the scale either.
            distances = _standardised(problem, outcome, levels)[part]
            spread = _MEDIAN_TO_STD * level * float(np.median(np.abs(distances)))
            square = len(dataset.y) * spread**2
        else:
            square = float(np.sum(outcome.residuals[part] ** 2)) * level**2
        floor = np.finfo(float).eps * (float(np.max(np.abs(dataset.y))) or 1.0)
        estimates.append(max(float(np.sqrt(square / free)), floor) if free > 1e-6 else floor)
    return tuple(estimates)
