"""Models outside JAX: the same answers as their twins in jax.numpy, and failures explained."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from calibration import BlackBox, Dataset, Parameter, Problem, fit, sample
from calibration.black_box import failures_explained
from procmodel.errors import InputError

X = np.linspace(0.0, 4.0, 15)
Y = 2.0 * np.exp(-0.7 * X) + 0.5 + 0.03 * np.random.default_rng(2).normal(size=15)
FREE = {"h": Parameter(1.0), "k": Parameter(1.0), "c": Parameter(0.0)}
EVALUATED = []


def decay_by_numpy(params, x):
    EVALUATED.append(params)
    assert isinstance(params["h"], float) and isinstance(x, np.ndarray)
    return params["h"] * np.exp(-params["k"] * x) + params["c"]


def decay(params, x):
    return params["h"] * jnp.exp(-params["k"] * x) + params["c"]


BOX = BlackBox(decay_by_numpy)


@pytest.fixture(scope="module")
def twin():
    return fit(Problem.from_function(decay, FREE, X, Y))


@pytest.mark.parametrize("solver", ["box_lm", "optimistix"])
def test_a_fit_is_that_of_its_twin(twin, solver):
    result = fit(Problem.from_function(BOX, FREE, X, Y), solver)
    assert result.converged, result.status
    assert result.problem.name == "decay_by_numpy"
    for name, estimate in twin.parameters.items():
        found = result.parameters[name]
        assert found.value == pytest.approx(estimate.value, abs=1e-6 * estimate.std)
        assert found.std == pytest.approx(estimate.std, rel=1e-6)


# Of ordinary size, on the way through zero, and small because of its unit.
POINTS = {"ordinary": (2.0, 0.7, 0.5), "zero": (2.0, 0.0, 0.0), "small": (2e-9, 1e-7, 3e-9)}


def waves(model, point):
    return jnp.sum(jnp.sin(model(point, X)))


@functools.partial(jax.jit, static_argnums=0)
def derivatives(model, point):
    return jax.jacfwd(model)(point, X), jax.grad(waves, argnums=1)(model, point)


@pytest.mark.parametrize("name", POINTS)
def test_derivatives_are_those_of_its_twin(name):
    point = dict(zip("hkc", map(jnp.asarray, POINTS[name]), strict=True))
    (forward, backward), (by_columns, by_grad) = derivatives(BOX, point), derivatives(decay, point)
    for key in "hkc":
        np.testing.assert_allclose(forward[key], by_columns[key], rtol=1e-6, atol=2e-9)
        assert float(backward[key]) == pytest.approx(float(by_grad[key]), rel=1e-6, abs=1e-8)


def arrhenius(params, x):
    # Not defined below zero, where a step that knows nothing of the unit would end.
    return params["h"] * np.sqrt(params["d"] * x)


def test_a_parameter_in_a_small_unit_is_fitted():
    y = 3.0 * np.sqrt(1e-9 * X) + 1e-7 * np.random.default_rng(0).normal(size=15)
    parameters = {"h": 3.0, "d": Parameter(5e-9, bounds=(1e-12, 1.0))}
    with np.errstate(invalid="raise"):
        found = fit(Problem.from_function(BlackBox(arrhenius), parameters, X, y)).parameters["d"]
    # In h sqrt(d) it is a straight line through the origin.
    slope = np.sqrt(X) @ y / np.sum(X)
    rms = np.sqrt(np.sum((y - slope * np.sqrt(X)) ** 2) / 14)
    assert found.value == pytest.approx((slope / 3.0) ** 2, rel=1e-8)
    assert found.std == pytest.approx(2 * slope / 9.0 * rms / np.sqrt(np.sum(X)), rel=1e-6)


def test_fixed_parameters_cost_no_evaluations():
    fixed = {"h": jnp.array(2.0), "c": jnp.array(0.5)}
    EVALUATED.clear()
    jax.jacfwd(lambda k: BOX({**fixed, "k": k}, X))(jnp.array(0.7)).block_until_ready()
    assert sorted(p["k"] for p in EVALUATED) == pytest.approx(
        [0.7 * (1 - 1e-5), 0.7, 0.7 * (1 + 1e-5)]
    )


def in_a_dictionary(params, x):
    assert x["ambient"] == 3.0
    return params["a"] + params["b"] * x["time"] + params["b"] * x["load"][:, 0] + x["ambient"]


def test_x_may_be_a_dictionary_of_arrays_and_numbers():
    rng = np.random.default_rng(1)
    x = {"ambient": 3.0, "load": rng.uniform(size=(15, 2)), "time": X}
    y = rng.normal(size=15)
    parameters = {"a": Parameter(0.0), "b": Parameter(0.0)}
    found = fit(Problem(parameters, {"data": Dataset(x, y, 0.5)}, BlackBox(in_a_dictionary)))
    design = np.stack([np.ones(15), X + x["load"][:, 0]], axis=1)
    expected = np.linalg.lstsq(design, y - 3.0)[0]
    assert [p.value for p in found.parameters.values()] == pytest.approx(list(expected), rel=1e-6)


def line_by_numpy(params, x):
    return params["a"] + params["b"] * x


def test_sampling_takes_emcee_and_agrees_with_the_closed_form():
    y = 1.0 + 0.5 * X + 0.3 * np.random.default_rng(0).normal(size=15)
    parameters = {"a": Parameter(0.0), "b": Parameter(0.0)}
    problem = Problem.from_function(BlackBox(line_by_numpy), parameters, X, y, 0.3)
    tree = sample(problem, seed=1, draws=16 * 150, ensembles=2, warmup=40)
    assert tree.attrs["sampler"] == "emcee"
    assert "black box" in tree.attrs["sampler_reason"]
    design = np.stack([np.ones(15), X], axis=1)
    covariance = np.linalg.inv(design.T @ design) * 0.3**2
    mean = covariance @ design.T @ y / 0.3**2
    count = 2 * 16 * 150 / tree.attrs["autocorrelation_steps"]
    assert count > 100
    for i, name in enumerate("ab"):
        draws, std = tree.posterior[name].values, np.sqrt(covariance[i, i])
        assert abs(draws.mean() - mean[i]) < 4 * std / np.sqrt(count)
        assert abs(draws.std() / std - 1) < 4 / np.sqrt(2 * count)


def broken(params, x):
    raise LookupError(f"no row\nfor k = {params['k']:g}")


def short(params, x):
    return x[1:]


def single(params, x):
    return 1.0


def misspelt(params, x):
    return params["kk"] * x


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (broken, ["'broken' stopped at c = 0, h = 1, k = 1 with LookupError: no row for k = 1"]),
        (short, ["'short' returned shape (14,) for 15 readings", "one value for each"]),
        (single, ["'single' returned shape () for 15 readings"]),
        (misspelt, ["parameter 'kk'", "did you mean 'k'?"]),
    ],
)
def test_a_model_that_fails_is_explained(model, words):
    box = BlackBox(model)

    def call():
        box({"c": 0.0, "h": 1.0, "k": 1.0}, X).block_until_ready()

    # An equal black box, as a second problem makes it, shares what was compiled.
    with pytest.raises(InputError) as told, failures_explained([decay, BlackBox(model)]):
        call()
    assert "\n" not in str(told.value)
    for word in words:
        assert word in str(told.value)
    with pytest.raises(jax.errors.JaxRuntimeError), failures_explained([decay]):
        call()


def test_a_failing_black_box_ends_a_fit_in_a_sentence():
    parameters = {"k": Parameter(1.0), "c": 0.0, "h": 1.0}
    with pytest.raises(InputError, match="stopped at") as told:
        fit(Problem.from_function(BlackBox(broken), parameters, X, X, 1.0))
    assert "LookupError: no row" in str(told.value)


def test_what_cannot_be_a_black_box_is_refused():
    with pytest.raises(InputError, match="black box 3 cannot be called: give a function"):
        BlackBox(3)
    with pytest.raises(InputError, match=r"step of a black box is 0\.0"):
        BlackBox(line_by_numpy, 0.0)
    with pytest.raises(InputError, match="'line_by_numpy' needs an array in x"):
        BlackBox(line_by_numpy)({"a": 1.0, "b": 2.0}, 2.0)


def test_errors_in_x_need_a_derivative_that_it_does_not_have():
    with pytest.raises(InputError, match="'decay_by_numpy' has no derivative over x: leave x_sig"):
        fit(Problem.from_function(BOX, FREE, X, Y, 0.1, x_sigma=0.1))
