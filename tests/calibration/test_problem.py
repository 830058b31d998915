"""Problems: what they refuse, several data sets, and what identifies the data."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import AR1, Dataset, Gaussian, Parameter, Problem, Relative, Robust, StudentT, fit
from procmodel.errors import InputError

X = np.linspace(0.0, 5.0, 8)
Y = 2.0 - 0.5 * X
FREE = {"a": Parameter(1.0), "b": Parameter(0.0)}


def in_numpy(params, x):
    return np.asarray(params["a"]) + np.asarray(params["b"]) * x


def misspelt(params, x):
    return params["a"] + params["bb"] * x


def one_short(params, x):
    return (params["a"] + params["b"] * x)[1:]


def scalar(params, x):
    return params["a"] + 0.0 * jnp.sum(x)


def column(params, x):
    return (params["a"] + params["b"] * x)[:, None]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"y": [1.0, np.nan, np.nan]}, "y has 2 values that are NaN or infinite.* reading 2"),
        ({"y": [np.nan] * 3}, "y has 3 values that are NaN .* the first at reading 1: remove them"),
        ({"sigma": -1.0}, "sigma of reading 1 is not above 0: correct it, or leave sigma out"),
        ({"y": [np.inf, 1.0, 2.0]}, "y has 1 values .* reading 1: remove them"),
        ({"x": np.array([0.0, 1.0, np.nan])}, "x has 1 values .* reading 3"),
        ({"x": {"z": np.array([0.0, np.inf, 1.0])}}, "x has 1 values .* reading 2"),
        ({"y": []}, "must be a list of readings, not an array of shape"),
        ({"y": [[1.0, 2.0, 3.0]]}, r"shape \(1, 3\)"),
        ({"sigma": 0.0}, "sigma of reading 1 is not above 0"),
        ({"sigma": [1.0, 0.0, 1.0]}, "sigma of reading 2 is not above 0"),
        ({"sigma": [1.0, 1.0, -2.0]}, "sigma of reading 3 .* leave sigma out"),
        ({"sigma": [1.0, np.nan, 1.0]}, "sigma has 1 values that are NaN"),
        ({"sigma": [1.0, 1.0]}, "sigma has shape .2,. for 3 readings"),
    ],
)
def test_a_dataset_refuses(arguments, sentence):
    with pytest.raises(InputError, match=sentence) as found:
        Dataset(**({"x": [0.0, 1.0, 2.0], "y": [1.0, 2.0, 3.0], "sigma": 1.0} | arguments))
    assert "\n" not in str(found.value) and str(found.value).endswith(".")


def test_a_problem_refuses(models):
    data = Dataset(X, Y)
    with pytest.raises(InputError, match="datasets is empty"):
        Problem(FREE, {}, models.line)
    with pytest.raises(InputError, match="'depth' has no model: give function"):
        Problem(FREE, {"depth": data})
    with pytest.raises(InputError, match="'data' uses unknown parameter 'bb'; did you mean 'b'"):
        Problem(FREE, {"data": Dataset(X, Y, own={"b": "bb"})}, models.line)
    with pytest.raises(InputError, match="parameter 'a' is 'two': give a"):
        Problem({"a": "two", "b": Parameter(1.0)}, {"data": data}, models.line)
    with pytest.raises(InputError, match="parameter 'a' is nan"):
        Problem({"a": np.nan, "b": Parameter(1.0)}, {"data": data}, models.line)


@pytest.mark.parametrize(
    ("model", "sentence"),
    [
        (in_numpy, r"model in_numpy .*NumPy.* write it with jax\.numpy"),
        (misspelt, "parameter 'bb' .*did you mean 'b'"),
        (one_short, r"model 'one_short' returned shape \(7,\) for 8 readings"),
        (scalar, r"model 'scalar' returned shape \(\) for 8 readings"),
        (column, r"model 'column' returned shape \(8, 1\) for 8 readings: .* one value for each"),
    ],
)
@pytest.mark.parametrize("solver", ["box_lm", "scipy"])
def test_a_wrong_model_is_explained_in_a_sentence(model, sentence, solver):
    with pytest.raises(InputError, match=sentence) as refusal:
        fit(Problem.from_function(model, FREE, X, Y), solver)
    assert "\n" not in str(refusal.value)


def test_fewer_readings_than_parameters_are_refused(models):
    with pytest.raises(InputError, match=r"1 readings cannot fit 2 free parameters \(a, b\)"):
        fit(Problem.from_function(models.line, FREE, X[:1], Y[:1]))


def test_as_many_readings_as_parameters_leave_no_interval(models):
    result = fit(Problem.from_function(models.line, FREE, X[:2], Y[:2]))
    assert result.parameters["a"].value == pytest.approx(2.0)
    assert result.parameters["b"].interval95 is None
    assert "no reading is left over" in result.parameters["b"].reason
    assert any("as many parameters as readings" in w for w in result.warnings)
    # With a known noise the interval is known all the same.
    known = fit(Problem.from_function(models.line, FREE, X[:2], Y[:2], 0.1))
    assert known.parameters["a"].std == pytest.approx(0.1)


def test_a_plain_number_is_a_fixed_parameter(models):
    result = fit(Problem.from_function(models.line, {"a": 2.0, "b": Parameter(0.0)}, X, Y))
    assert result.parameters["a"].verdict == "fixed" and result.parameters["a"].std is None
    assert result.free == ("b",)
    assert result.parameters["b"].value == pytest.approx(-0.5)


def test_readings_and_places_may_be_plain_lists(models):
    result = fit(Problem.from_function(models.line, FREE, X.tolist(), Y.tolist(), 0.1))
    assert result.parameters["b"].value == pytest.approx(-0.5)


def test_an_exact_model_is_said_to_pass_through_every_reading(models):
    start = {"a": Parameter(2.0), "b": Parameter(-0.5)}
    result = fit(
        Problem.from_function(models.line, start, np.arange(8.0), 2.0 - 0.5 * np.arange(8))
    )
    assert result.status == "converged: the model passes through every reading"
    assert result.residual_rms == 0.0


def test_readings_that_are_all_zero_can_be_fitted(models):
    result = fit(Problem.from_function(models.line, FREE, X, np.zeros(8)))
    assert result.converged
    np.testing.assert_allclose([p.value for p in result.parameters.values()], 0.0, atol=1e-9)


RNG = np.random.default_rng(11)
SETS = {
    "first": (np.linspace(0.0, 3.0, 7), 0.2),
    "second": (np.linspace(1.0, 6.0, 12), 0.5),
}
READINGS = {
    name: 1.0 + 2.0 * (name == "second") + 0.8 * x + sigma * RNG.normal(size=len(x))
    for name, (x, sigma) in SETS.items()
}


def shifted_line(params, x):
    return params["own_offset"] + params["slope"] * x


def test_data_sets_share_a_slope_and_keep_their_own_offsets():
    parameters = {name: Parameter(0.0) for name in ("slope", "offset_1", "offset_2")}
    datasets = {
        "first": Dataset(SETS["first"][0], READINGS["first"], 0.2, own={"own_offset": "offset_1"}),
        "second": Dataset(
            SETS["second"][0], READINGS["second"], 0.5, own={"own_offset": "offset_2"}
        ),
    }
    result = fit(Problem(parameters, datasets, shifted_line))
    rows = [
        np.stack([x, np.full(len(x), name == "first"), np.full(len(x), name == "second")], 1) / s
        for name, (x, s) in SETS.items()
    ]
    design = np.concatenate(rows)
    right = np.concatenate([READINGS[name] / s for name, (_, s) in SETS.items()])
    covariance = np.linalg.inv(design.T @ design)
    expected = covariance @ design.T @ right
    found = [result.parameters[name].value for name in parameters]
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    np.testing.assert_allclose(result.covariance, covariance, rtol=1e-8, atol=1e-12)
    # Residuals are reading less model, in the readings' unit, set by set.
    for (name, (x, _)), offset in zip(SETS.items(), expected[1:], strict=True):
        by_hand = READINGS[name] - offset - expected[0] * x
        np.testing.assert_allclose(result.residuals[name], by_hand, atol=1e-7)


def test_data_sets_have_fitted_noise_levels_of_their_own(models):
    level = Parameter(1.0, bounds=(0.0, np.inf), transform="log")
    parameters = {"a": Parameter(0.0), "b": Parameter(0.0), "fine": level, "coarse": level}
    rng = np.random.default_rng(4)
    sets = {
        name: (np.linspace(0.0, 5.0, size), noise)
        for name, size, noise in (("fine", 40, 0.1), ("coarse", 60, 1.0))
    }
    readings = {n: 1.0 + 0.5 * x + s * rng.normal(size=len(x)) for n, (x, s) in sets.items()}
    datasets = {n: Dataset(x, readings[n], "s", own={"s": n}) for n, (x, _) in sets.items()}
    result = fit(Problem(parameters, datasets, models.line))
    # The greatest likelihood by turns: weighted least squares, then the rms of each set.
    design = np.concatenate([np.stack([np.ones(len(x)), x], 1) for x, _ in sets.values()])
    y, sizes = np.concatenate(list(readings.values())), [40, 60]
    levels = np.ones(2)
    for _ in range(200):
        weights = np.repeat(1.0 / levels, sizes)
        beta = np.linalg.lstsq(design * weights[:, None], y * weights)[0]
        parts = np.split(y - design @ beta, [40])
        levels = np.array([np.sqrt(np.mean(part**2)) for part in parts])
    found = [result.parameters[n].value for n in ("a", "b", "fine", "coarse")]
    assert found == pytest.approx([*beta, *levels], rel=1e-6)
    stds = [result.parameters[n].std for n in ("fine", "coarse")]
    assert stds == pytest.approx(levels / np.sqrt(2.0 * np.array(sizes)), rel=1e-6)


def parabola(params, x):
    return params["b"] * x["first"] ** 2 + 0.0 * x["second"][0]


def test_data_sets_may_have_models_and_inputs_of_their_own(models):
    x2 = {"first": np.array([1.0, 2.0, 3.0]), "second": (np.arange(3),)}
    datasets = {
        "line": Dataset(X, Y, 1.0),
        "parabola": Dataset(x2, [1.0, 4.0, 9.0], 1.0, function=parabola),
    }
    result = fit(Problem({"a": Parameter(0.0), "b": Parameter(0.0)}, datasets, models.line))
    design = np.concatenate([np.stack([np.ones(8), X], 1), [[0.0, 1.0], [0.0, 4.0], [0.0, 9.0]]])
    expected = np.linalg.lstsq(design, np.concatenate([Y, [1.0, 4.0, 9.0]]))[0]
    found = [p.value for p in result.parameters.values()]
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_data_hash_tells_readings_apart(models):
    def digest(x=X, y=Y, sigma=None, name="data"):
        return Problem(FREE, {name: Dataset(x, y, sigma)}, models.line).data_hash

    same = digest()
    assert digest(y=Y.copy()) == same and len(same) == 12
    changed = Y.copy()
    changed[3] += 1e-12
    others = [digest(y=changed), digest(x=X + 1e-9), digest(sigma=1.0), digest(name="other")]
    assert len({same, *others}) == 5


def test_bounds_belong_to_the_problem_and_not_to_what_was_compiled(models):
    def slope(lowest):
        parameters = {"a": Parameter(2.0), "b": Parameter(0.5, bounds=(lowest, 1.0))}
        return fit(Problem.from_function(models.line, parameters, X, Y, 1.0)).parameters["b"]

    assert slope(0.0).value == 0.0
    assert slope(-9.0).value == pytest.approx(-0.5)
    assert slope(-0.25).value == -0.25


def test_size_slices_and_start(models):
    parameters = {"a": Parameter(2.0, bounds=(0.0, 9.0), transform="log"), "b": Parameter(0.5)}
    datasets = {"first": Dataset(X, Y), "second": Dataset(X[:3], Y[:3], 1.0)}
    problem = Problem(parameters, datasets, models.line)
    assert problem.size == 11 and problem.slices == [slice(0, 8), slice(8, 11)]
    np.testing.assert_allclose(problem.start, [np.log(2.0), 0.5])
    assert not problem.noise_known
    assert problem.name == "line"


def refusal(make):
    with pytest.raises(InputError) as caught:
        make()
    sentence = str(caught.value)
    assert "\n" not in sentence and sentence.endswith(".") and len(sentence) < 250
    return sentence


def with_noise(noise, level, **parameters):
    free = {"own_offset": Parameter(0.0), "slope": Parameter(0.0)} | parameters
    return lambda: Problem.from_function(shifted_line, free, X, Y, level, noise=noise)


SCALE = Parameter(0.3, bounds=(0.0, math.inf))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (with_noise(Gaussian(), "sgima", sigma=SCALE), ["'sgima'", "did you mean 'sigma'?"]),
        (with_noise(StudentT("freedm"), 0.3, freedom=SCALE), ["'freedm'", "'freedom'?"]),
        (with_noise(AR1("ph"), 0.3, phi=Parameter(0.0)), ["'ph'", "'phi'?"]),
        (with_noise(Gaussian(), "s", s=Parameter(0.3)), ["'s'", "between 0 and inf"]),
        (with_noise(AR1("phi"), 0.3, phi=Parameter(0.1)), ["'phi'", "between -1 and 1"]),
        (
            with_noise(AR1("phi"), 0.3, phi=Parameter(0.1, bounds=(-1.0, 1.5))),
            ["'phi'", "between -1 and 1"],
        ),
        (
            with_noise(Relative("share"), 0.3, share=Parameter(0.0, bounds=(0.0, 1.0))),
            ["'share'", "between 0 and inf"],
        ),
        (with_noise(StudentT(), None), ["StudentT", "sigma estimated", "give it as a number"]),
        (with_noise(AR1(0.5), None), ["AR1", "sigma estimated", "name of a parameter"]),
        (with_noise(Robust(), "s", s=SCALE), ["Robust", "sigma parameter", "leave it out"]),
        (with_noise("student", 0.3), ["noise 'student'", "such as StudentT"]),
        (lambda: Robust("hubber"), ["'hubber'", "did you mean 'huber'?"]),
        (lambda: Robust(["huber"]), ["['huber'] is unknown"]),
        (lambda: Robust("cauchy", 1.0), ["threshold is 1.0", "above 1"]),
        (lambda: Robust("huber", -1.0), ["threshold is -1.0", "above 0"]),
        (lambda: StudentT(0.0), ["freedom is 0.0", "above 0", "name of a parameter"]),
        (lambda: StudentT(math.nan), ["freedom is nan"]),
        (lambda: StudentT(None), ["freedom is None"]),
        (lambda: AR1(1.0), ["correlation is 1.0", "between -1 and 1"]),
        (lambda: Relative(-0.1), ["share is -0.1", "above 0"]),
    ],
)
def test_what_a_noise_model_cannot_use_is_named_in_a_sentence(make, words):
    sentence = refusal(make)
    for word in words:
        assert word in sentence
