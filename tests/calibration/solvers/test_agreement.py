"""All solvers on the wear problem, and what `fit` refuses."""

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

from calibration import Parameter, Problem, fit
from procmodel.errors import InputError


@pytest.fixture(scope="module")
def wear_problem(wear):
    parameters = wear.parameters("wear_ratio", "gap")
    return Problem.from_function(
        wear.depths, parameters, wear.half_widths, wear.readings(seed=4, gap=2.0), 1.0
    )


@pytest.fixture(scope="module")
def reference(wear_problem):
    return fit(wear_problem, "scipy")


@pytest.mark.parametrize("solver", ["box_lm", "optimistix", "jaxopt"])
def test_solvers_agree_on_the_wear_problem(wear_problem, reference, solver):
    result = fit(wear_problem, solver)
    assert result.converged, result.status
    assert result.solver == solver and solver in result.report()
    for name in ("wear_ratio", "gap", "wear_per_area"):
        one, other = result.parameters[name], reference.parameters[name]
        assert one.value == pytest.approx(other.value, rel=1e-6)
        assert one.std == pytest.approx(other.std, rel=1e-6)
        assert one.interval95 == pytest.approx(other.interval95, rel=1e-6)
    assert result.residual_rms == pytest.approx(reference.residual_rms, rel=1e-9)


@pytest.mark.parametrize(
    ("solver", "options", "sentence"),
    [
        ("box-lm", {}, "solver 'box-lm' is unknown; did you mean 'box_lm'"),
        ("newton", {}, "solver 'newton' is unknown; known are box_lm, optimistix, scipy, jaxopt"),
        ("box_lm", {"max_step": 3}, "'box_lm' has no option 'max_step'; did you mean 'max_steps'"),
        ("scipy", {"ftol": 1e-3}, "'scipy' has no option 'ftol'; "),
        ("optimistix", {"lower": 0.0}, "'optimistix' has no option 'lower'; known are method,"),
        ("jaxopt", {"tol": 1e-3}, "'jaxopt' has no option 'tol'"),
        ("optimistix", {"method": "lm"}, "optimistix method 'lm' is unknown"),
        ("optimistix", {"method": "dog_leg"}, "did you mean 'dogleg'"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest_right_one(
    wear_problem, solver, options, sentence
):
    with pytest.raises(InputError, match=sentence):
        fit(wear_problem, solver, **options)


@pytest.mark.parametrize(
    ("solver", "options", "words"),
    [
        ("scipy", {"max_steps": 2}, "not converged: the maximum number of function evaluations"),
    ],
)
def test_out_of_steps_is_said_and_warned_about(wear_problem, solver, options, words):
    result = fit(wear_problem, solver, **options)
    assert not result.converged
    assert result.status.startswith("not converged") and words in result.status
    assert any("did not converge" in w for w in result.warnings)
    assert "did not converge" in result.report()


def root(params, x):
    return params["a"] * jnp.sqrt(params["b"] - x)


@pytest.mark.parametrize("solver", ["box_lm", "optimistix", "scipy"])
def test_not_a_number_at_the_start(solver):
    x = np.linspace(0.0, 2.0, 6)
    parameters = {"a": Parameter(1.0), "b": Parameter(1.0)}
    result = fit(Problem.from_function(root, parameters, x, np.sqrt(3.0 - x), 0.1), solver)
    assert not result.converged
    assert result.status.startswith("not ")
    assert any("did not converge" in w for w in result.warnings)
    assert result.report()


def two_lines(params, x):
    return params["a"] * x[:, 0] + params["b"] * x[:, 1]


BOUNDED_X = np.random.default_rng(2).normal(size=(20, 2)) @ np.array([[1.0, 0.6], [0.0, 0.8]])
BOUNDED_Y = BOUNDED_X @ [2.0, -0.3] + 0.1 * np.random.default_rng(3).normal(size=20)


def bounded(**upper):
    parameters = {name: Parameter(0.1, bounds=(0.0, most)) for name, most in upper.items()}
    return Problem.from_function(two_lines, parameters, BOUNDED_X, BOUNDED_Y, 0.1)


@pytest.mark.parametrize("solver", ["box_lm", "scipy"])
def test_active_bounds_are_found_and_named(solver):
    result = fit(bounded(a=9.0, b=9.0), solver)
    column = BOUNDED_X[:, 0]
    a, b = result.parameters["a"], result.parameters["b"]
    assert a.value == pytest.approx(column @ BOUNDED_Y / (column @ column), rel=1e-6)
    assert b.value == pytest.approx(0.0, abs=1e-6)
    assert b.verdict == "one-sided" and b.reason == "held at its lower bound 0"
    assert "bounds hit  b" in result.report()
    # The other's covariance is that of the problem without the held parameter.
    assert a.std == pytest.approx(0.1 / np.linalg.norm(column), rel=1e-6)
    assert np.isnan(result.covariance[1, 1]) and np.isnan(result.correlation[0, 1])


def test_two_active_bounds():
    result = fit(bounded(a=0.8, b=0.2))
    best = scipy.optimize.lsq_linear(BOUNDED_X, BOUNDED_Y, (0.0, [0.8, 0.2]), method="bvls")
    assert list(best.active_mask) == [1, 1]
    assert [p.value for p in result.parameters.values()] == [0.8, 0.2]
    assert "bounds hit  a, b" in result.report()
    assert result.parameters["a"].reason == "held at its upper bound 0.8"
    assert result.degrees_of_freedom == 20


def test_a_solver_without_bounds_refuses_an_answer_outside():
    result = fit(bounded(a=9.0, b=9.0), "optimistix")
    assert not result.converged
    assert "keeps no bounds and left them; use solver 'box_lm'" in result.status


def test_every_step_can_be_watched(wear_problem):
    seen = []

    def watch(step, cost, values):
        seen.append((step, cost, values))

    result = fit(wear_problem, watch=watch)
    assert [step for step, _, _ in seen] == list(range(1, result.steps + 1))
    costs = [cost for _, cost, _ in seen]
    assert costs == sorted(costs, reverse=True)
    assert seen[-1][2] == {n: result.parameters[n].value for n in result.free}
    with pytest.raises(InputError, match="solver 'scipy' has no option 'watch'"):
        fit(wear_problem, solver="scipy", watch=watch)
