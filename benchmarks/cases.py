"""The problems that the fits are timed on: ours and the NumPy model of the same readings."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks import peers
from calibration import FitResult, Parameter, Problem, fit
from calibration.wear import TestCavity, fit_cavity
from procmodel.wear import cavity_depths

HALF_WIDTH = 250.0
WEAR_RATIO = 0.3
NOISE = 1.0
START = 0.1
# Not 0: a start at its bound is a known trap of lmfit's transform, and nobody's choice.
START_GAP = 1.0


@dataclass(frozen=True)
class Case:
    """One problem for all contestants.

    Attributes
    ----------
    title : str
        For the report.
    names : tuple of str
        Free parameters.
    true, start, lower, upper : ndarray, shape (p,)
        What the readings are made with, and what every contestant is given.
    x : ndarray, shape (n,)
        Where the readings are taken.
    model : callable
        NumPy model of the alternatives.
    problem : callable
        Our problem for a list of readings.
    """

    title: str
    names: tuple[str, ...]
    true: np.ndarray
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    x: np.ndarray
    model: peers.NumpyModel
    problem: Callable[[np.ndarray], Problem]

    def readings(self, seed: int) -> np.ndarray:
        """Readings with noise of 1 um."""
        noise = np.random.default_rng(seed).normal(0.0, NOISE, len(self.x))
        return self.model(self.x, *self.true) + noise

    def fitters(self) -> dict[str, Callable[[np.ndarray], Any]]:
        """Every contestant as a function of the readings alone."""
        lmfit_fit = peers.LmfitFit(self.model, self.names)
        box = (self.start, self.lower, self.upper)
        return {
            "ours": lambda y: fit(self.problem(y)),
            "curve_fit": lambda y: peers.scipy_fit(self.model, self.x, y, *box),
            "lmfit": lambda y: lmfit_fit(self.x, y, *box),
        }

    def estimate(self, outcome: Any) -> peers.Estimate:
        """Values and standard deviations of any contestant's outcome."""
        if not isinstance(outcome, FitResult):
            return outcome
        found = [outcome.parameters[name] for name in self.names]
        stds = [float("nan") if p.std is None else p.std for p in found]
        return peers.Estimate(np.array([p.value for p in found]), np.array(stds))

    def misfit(self, values: np.ndarray, y: np.ndarray) -> float:
        """Squared misfit [um^2]."""
        return float(np.sum((self.model(self.x, *values) - y) ** 2))

    def require_same_model(self) -> None:
        """Ours and the NumPy model have to agree before anything is compared."""
        exact = self.model(self.x, *self.true)
        problem = self.problem(exact)
        vector = problem.layout.internal(self.true)
        (ours,) = problem.structure.predictions(vector, problem.fixed_values, problem.data())
        worst = float(np.max(np.abs(np.asarray(ours) - exact)))
        if worst > 1e-10:
            raise RuntimeError(f"{self.title}: the two models differ by {worst:.2g} um")


def depths_case(layers: int = 100, step: float = 2.0) -> Case:
    """Wear ratio from the depth after every layer."""
    half_widths = HALF_WIDTH - step * np.arange(layers)
    return Case(
        title=f"wear ratio from {layers} depths",
        names=("wear_ratio",),
        true=np.array([WEAR_RATIO]),
        start=np.array([START]),
        lower=np.array([0.0]),
        upper=np.array([1e3]),
        x=half_widths,
        model=peers.depths_model(half_widths, step),
        problem=_DepthsProblem(step),
    )


@dataclass(frozen=True)
class _DepthsProblem:
    feed: float

    def __call__(self, y: np.ndarray) -> Problem:
        x = {"half_widths": HALF_WIDTH - self.feed * np.arange(len(y)), "feed": self.feed}
        parameters = {"wear_ratio": Parameter(START, bounds=(0.0, 1e3))}
        return Problem.from_function(square_depths, parameters, x, y)


def square_depths(params: dict[str, Any], x: dict[str, Any]) -> Any:
    """Depths of a square cavity; the gap, if there is one, as in eq. (5) widened."""
    area = 4.0 * (x["half_widths"] + params.get("gap", 0.0)) ** 2
    return cavity_depths(x["feed"], area, params["wear_ratio"], jnp.asarray(peers.ELECTRODE_AREA))


def wall_case(readings: int = 100, layers: int = 100, step: float = 2.0) -> Case:
    """Wear ratio and gap from one wall, read from the centre out to the upper edge."""
    return _profile_case(
        "wear ratio and gap from {} readings of one wall",
        np.linspace(0.0, HALF_WIDTH, readings),
        TestCavity("square", HALF_WIDTH, step, step, peers.ELECTRODE_AREA, layers=layers),
        {"wear_ratio": WEAR_RATIO, "gap": 3.0},
    )


def full_case(readings: int = 201) -> Case:
    """The same and the instrument's centre, zero and tilt, from a full section."""
    return _profile_case(
        "wear ratio, gap, centre, zero and tilt from {} readings of a full section",
        np.linspace(-300.0, 300.0, readings),
        TestCavity("square", HALF_WIDTH, 2.0, 2.0, peers.ELECTRODE_AREA, layers=100),
        {"wear_ratio": WEAR_RATIO, "gap": 3.0, "centre": 1.5, "zero": 0.7, "tilt": 0.002},
    )


def _profile_case(title: str, x: np.ndarray, cavity: TestCavity, true: dict[str, float]) -> Case:
    walls = cavity.half_widths[: cavity.layers]
    model = peers.wall_model(walls, cavity.feed, edge_width=float(np.median(np.diff(x))))
    y = model(x, *true.values()) + np.random.default_rng(0).normal(0.0, NOISE, len(x))
    reach = "full" if "centre" in true else "half"
    found = fit_cavity(x, y, cavity, gap=START_GAP, fit_gap=True, reach=reach)
    template = found.result.problem
    data, names = template.datasets["data"], template.layout.free
    # Readings beside the upper edge were left out; everyone gets the same ones.
    x = found.position
    model = peers.wall_model(walls, cavity.feed, float(data.x["edge_width"]))
    function = template.structure.functions[0]
    parameters = {name: template.parameters[name] for name in names}

    def problem(readings: np.ndarray) -> Problem:
        return Problem.from_function(function, template.parameters, data.x, readings)

    return Case(
        title=title.format(len(x)),
        names=names,
        true=np.array([true[name] for name in names]),
        start=np.array([p.value for p in parameters.values()]),
        lower=np.array([p.bounds[0] for p in parameters.values()]),
        upper=np.array([p.bounds[1] for p in parameters.values()]),
        x=x,
        model=model,
        problem=problem,
    )
