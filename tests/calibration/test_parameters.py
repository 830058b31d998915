"""Parameters: what they refuse, their coordinates, and ties."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from calibration import HalfNormal, Normal, Parameter, Problem, Uniform, fit
from calibration.parameters import ParameterLayout
from procmodel.errors import InputError

NO_FIXED = np.zeros(0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"value": math.nan}, "value nan is not a finite number"),
        ({"value": math.inf}, "value inf is not a finite number"),
        ({"value": 1.0, "bounds": (2.0, 1.0)}, r"bounds \(2, 1\) must be \(low, high\)"),
        ({"value": 1.0, "bounds": (1.0, 1.0)}, "low < high"),
        ({"value": 1.0, "bounds": (math.nan, 2.0)}, "low < high"),
        ({"value": 1.0, "bounds": 3.0}, "must be two numbers"),
        ({"value": 1.0, "bounds": (0.0, 1.0, 2.0)}, "must be two numbers"),
        ({"value": 1.0, "bounds": (0.0, "wide")}, "must be two numbers"),
        ({"value": 5.0, "bounds": (0.0, 1.0)}, "value 5 is outside its bounds .* widen the bounds"),
        ({"value": 1.0, "transform": "logg"}, "transform 'logg' is unknown; did you mean 'log'"),
        ({"value": 1.0, "transform": "square"}, "known are identity, log, logit"),
        ({"value": 1.0, "transform": "log"}, "'log' needs a lower bound of 0 or more"),
        ({"value": 0.0, "bounds": (0, 1), "transform": "log"}, "value above 0"),
        ({"value": 1.0, "bounds": (0, math.inf), "transform": "logit"}, "needs finite bounds"),
        ({"value": 0.0, "bounds": (0, 1), "transform": "logit"}, "a value between them"),
    ],
)
def test_a_parameter_refuses(arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        Parameter(**arguments)


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"a": Parameter(1.0, fixed=True)}, "no parameter is free"),
        (
            {"gap": Parameter(1.0), "b": Parameter(1.0, tied="gapp")},
            "parameter 'b' is tied to unknown 'gapp'; did you mean 'gap'",
        ),
        (
            {"a": Parameter(1.0), "b": Parameter(1.0, tied="a"), "c": Parameter(1.0, tied="b")},
            "'c' is tied to 'b', which is tied itself",
        ),
        (
            {"a": Parameter(1.0), "b": Parameter(1.0, fixed=True, prior=Normal(0.0, 1.0))},
            "'b' is fixed and has a prior",
        ),
        (
            {"a": Parameter(-1.0, prior=HalfNormal(1.0))},
            r"'a' starts at -1, where its prior HalfNormal\(std=1.0\) is zero: start between 0 and",
        ),
        (
            {"a": Parameter(3.0, prior=Uniform(4.0, 5.0))},
            "'a' starts at 3, .* start between 4 and 5",
        ),
    ],
)
def test_a_layout_refuses(parameters, sentence):
    with pytest.raises(InputError, match=sentence):
        ParameterLayout.of(parameters)


def test_a_prior_that_shares_nothing_with_the_bounds_is_explained():
    parameter = Parameter(0.5, bounds=(0.0, 1.0), prior=Uniform(2.0, 3.0))
    with pytest.raises(InputError) as refusal:
        ParameterLayout.of({"a": parameter})
    # "between 2 and 1" would send the user in a circle.
    assert "between 2 and 1" not in str(refusal.value)


TRANSFORMED = {
    "plain": Parameter(0.3),
    "log": Parameter(2.0, bounds=(0.5, 80.0), transform="log"),
    "open log": Parameter(2.0, bounds=(0.0, math.inf), transform="log"),
    "logit": Parameter(4.0, bounds=(-1.0, 9.0), transform="logit"),
}
LAYOUT = ParameterLayout.of(TRANSFORMED)


@given(
    plain=st.floats(-1e3, 1e3),
    log=st.floats(0.5, 80.0),
    open_log=st.floats(1e-9, 1e9),
    logit=st.floats(-0.999, 8.999),
)
def test_transforms_round_trip(plain, log, open_log, logit):
    natural = np.array([plain, log, open_log, logit])
    internal = LAYOUT.internal(natural)
    np.testing.assert_allclose(LAYOUT.free_values(internal), natural, rtol=1e-12, atol=1e-12)
    by_name = LAYOUT.natural(jnp.asarray(internal), NO_FIXED)
    np.testing.assert_allclose(list(by_name.values()), natural, rtol=1e-12, atol=1e-12)
    assert tuple(by_name) == tuple(TRANSFORMED)


@given(st.lists(st.floats(-6.0, 6.0), min_size=4, max_size=4))
def test_any_internal_vector_is_inside_the_bounds_of_a_logit_and_positive_for_a_log(vector):
    values = LAYOUT.free_values(np.array(vector))
    assert values[1] > 0 and values[2] > 0
    assert -1.0 < values[3] < 9.0
    np.testing.assert_allclose(LAYOUT.internal(values), vector, rtol=1e-9, atol=1e-12)


def test_slopes_are_the_derivatives():
    vector = np.array([0.3, 1.1, -2.0, 0.7])

    def natural(v):
        return jnp.stack(list(LAYOUT.natural(v, NO_FIXED).values()))

    np.testing.assert_allclose(
        np.diag(jax.jacfwd(natural)(jnp.asarray(vector))), LAYOUT.slopes(vector), rtol=1e-12
    )


def test_internal_bounds():
    lower, upper = LAYOUT.internal_bounds()
    np.testing.assert_allclose(lower, [-np.inf, math.log(0.5), -np.inf, -np.inf])
    np.testing.assert_allclose(upper, [np.inf, math.log(80.0), np.inf, np.inf])


def test_around_is_symmetric_in_the_solvers_coordinate():
    vector = LAYOUT.internal(np.array([1.0, 5.0, 3.0, 2.0]))
    low, middle, high = LAYOUT.around(vector, "log", np.array([-0.5, 0.0, 0.5]))
    assert middle == pytest.approx(5.0)
    # Along the tangent: 0.5 away from 5 is 0.1 in the logarithm.
    assert high == pytest.approx(5.0 * math.exp(0.1))
    assert low == pytest.approx(5.0 * math.exp(-0.1))
    np.testing.assert_allclose(LAYOUT.around(vector, "plain", np.array([-2.0, 2.0])), [-1.0, 3.0])
    ends = LAYOUT.around(vector, "logit", np.array([-100.0, 100.0]))
    assert -1.0 <= ends[0] < ends[1] <= 9.0


def test_ties_by_name_and_by_function_follow_free_and_fixed_parameters():
    layout = ParameterLayout.of(
        {
            "twin": Parameter(0.0, tied="a"),
            "a": Parameter(2.0),
            "area": Parameter(4.0, fixed=True),
            "ratio": Parameter(0.0, tied=lambda p: p["a"] / p["area"]),
        }
    )
    values = layout.natural(jnp.array([10.0]), np.array([4.0]))
    assert list(values) == ["twin", "a", "area", "ratio"]
    assert [float(v) for v in values.values()] == [10.0, 10.0, 4.0, 2.5]
    assert layout.free == ("a",) and layout.fixed == ("area",)


def test_prior_support_narrows_the_bounds():
    layout = ParameterLayout.of(
        {
            "a": Parameter(1.0, bounds=(-5.0, 9.0), prior=HalfNormal(2.0)),
            "b": Parameter(1.0, bounds=(0.5, 9.0), prior=Uniform(0.0, 2.0)),
            "c": Parameter(1.0, bounds=(0.5, 9.0), prior=Normal(0.0, 2.0)),
        }
    )
    assert layout.bounds == ((0.0, 9.0), (0.5, 2.0), (0.5, 9.0))


def test_a_prior_narrower_than_a_logits_range_bounds_it():
    # The transform keeps the range of the bounds; the solver must not leave the prior's support.
    parameter = Parameter(0.5, bounds=(0.0, 1.0), transform="logit", prior=Uniform(0.25, 0.5))
    layout = ParameterLayout.of({"a": parameter})
    assert layout.internal(np.array([0.5])) == pytest.approx(0.0)
    lower, upper = layout.internal_bounds()
    assert lower[0] == pytest.approx(math.log(0.25 / 0.75)) and upper[0] == pytest.approx(0.0)


def test_layouts_of_equal_parameters_are_equal_and_hashable():
    def layout(value, highest=9.0, transform="logit"):
        a = Parameter(value, bounds=(0.0, highest), transform=transform)
        return ParameterLayout.of({"a": a, "b": Parameter(1.0)})

    assert layout(1.0) == layout(2.0)
    assert hash(layout(1.0)) == hash(layout(2.0))
    # The range of a logit and the transform change what is compiled.
    assert layout(1.0) != layout(1.0, highest=8.0)
    assert layout(1.0) != layout(1.0, transform="log")


@given(
    low=st.floats(-1e6, 1e6),
    width=st.floats(1e-6, 1e9),
    share=st.floats(1e-9, 1.0 - 1e-9),
)
def test_a_logit_takes_any_value_between_any_bounds_there_and_back(low, width, share):
    high, value = low + width, low + share * width
    assume(low < value < high)
    parameter = Parameter(value, bounds=(low, high), transform="logit")
    layout = ParameterLayout.of({"a": parameter})
    back = layout.free_values(layout.internal(np.array([value])))[0]
    # The internal coordinate is good to some roundings of its own size, below 40 here.
    slope = (value - low) * (high - value) / width
    assert back == pytest.approx(value, rel=1e-14, abs=1e-14 * (40 * slope + abs(low) + width))
    assert low <= back <= high
    assert [ends[0] for ends in layout.internal_bounds()] == [-np.inf, np.inf]


@given(value=st.floats(1e-300, 1e300), down=st.floats(1e-3, 1.0), up=st.floats(1.001, 1e3))
def test_a_log_takes_any_positive_value_there_and_back(value, down, up):
    bounds = (down * value, up * value)
    layout = ParameterLayout.of({"a": Parameter(value, bounds=bounds, transform="log")})
    # A relative error of the value is an absolute one of its log, which is up to 700.
    back = layout.free_values(layout.internal(np.array([value])))[0]
    assert back == pytest.approx(value, rel=1e-12)
    ends = [layout.free_values(end)[0] for end in layout.internal_bounds()]
    np.testing.assert_allclose(ends, bounds, rtol=1e-12)
    lower, upper = layout.internal_bounds()
    assert lower[0] <= layout.internal(np.array([value]))[0] <= upper[0]


@given(vector=st.lists(st.floats(-20.0, 20.0), min_size=4, max_size=4))
def test_slopes_are_those_of_finite_differences(vector):
    vector, step = np.array(vector), 1e-5
    above, below = LAYOUT.free_values(vector + step), LAYOUT.free_values(vector - step)
    # The logit's values are near 9 at most, so that their differences round at 1e-15 / 1e-5.
    np.testing.assert_allclose(
        LAYOUT.slopes(vector), (above - below) / (2 * step), rtol=1e-8, atol=1e-9
    )


def product(params):
    return params["a"] * params["area"] + params["b"]


@given(a=st.floats(-5.0, 5.0), b=st.floats(-5.0, 5.0), area=st.floats(-1e3, 1e3))
def test_tied_parameters_follow_wherever_the_others_go(a, b, area):
    layout = ParameterLayout.of(
        {
            "twin": Parameter(0.0, tied="b"),
            "a": Parameter(1.0, bounds=(0.0, math.inf), transform="log"),
            "of fixed": Parameter(0.0, tied="area"),
            "area": Parameter(area, fixed=True),
            "b": Parameter(0.0),
            "product": Parameter(0.0, tied=product),
        }
    )
    values = layout.natural(np.array([a, b]), np.array([area]))
    assert float(values["twin"]) == b and float(values["of fixed"]) == area
    assert float(values["product"]) == pytest.approx(math.exp(a) * area + b, rel=1e-12, abs=1e-12)
    assert layout.free == ("a", "b")


def saturating(params, x):
    return params["h"] * x / (params["k"] + x)


def test_a_fit_ends_at_the_same_optimum_in_any_coordinate():
    x = np.linspace(0.2, 9.0, 20)
    y = 3.0 * x / (1.4 + x) + 0.05 * np.random.default_rng(6).normal(size=20)
    found = {}
    for transform in ("identity", "log", "logit"):
        k = Parameter(4.0, bounds=(0.0, 20.0), transform=transform)
        found[transform] = fit(
            Problem.from_function(saturating, {"h": Parameter(1.0), "k": k}, x, y)
        )
        assert found[transform].converged, found[transform].status
    for name in ("h", "k"):
        plain = found["identity"].parameters[name]
        for transform in ("log", "logit"):
            other = found[transform].parameters[name]
            assert other.value == pytest.approx(plain.value, abs=1e-6 * plain.std)
            assert other.std == pytest.approx(plain.std, rel=1e-6)
    # Only the interval knows of the coordinate: symmetric about the log of k, not about k.
    low, high = found["log"].parameters["k"].interval95
    value = found["log"].parameters["k"].value
    assert low * high == pytest.approx(value**2, rel=1e-9)
    assert low + high > 2.01 * value


def test_the_curvature_of_a_tie_is_in_its_error():
    # The error of exp(b) by the chain rule, and none for a tie to what is fixed.
    parameters = {
        "h": Parameter(3.0),
        "k": Parameter(1.0, tied=lambda p: jnp.exp(p["log_k"])),
        "log_k": Parameter(0.5),
    }
    x = np.linspace(0.2, 9.0, 20)
    y = 3.0 * x / (1.4 + x) + 0.05 * np.random.default_rng(6).normal(size=20)
    result = fit(Problem.from_function(saturating, parameters, x, y))
    k, log_k = result.parameters["k"], result.parameters["log_k"]
    assert k.value == pytest.approx(math.exp(log_k.value), rel=1e-12)
    assert k.std == pytest.approx(k.value * log_k.std, rel=1e-9)


def test_a_prior_that_is_zero_between_the_bounds_names_the_parameter():
    with pytest.raises(
        InputError, match=r"parameter 'gap': its prior .* \(0, 1\): change"
    ) as found:
        ParameterLayout.of({"gap": Parameter(0.5, bounds=(0.0, 1.0), prior=Uniform(2.0, 3.0))})
    assert "\n" not in str(found.value)
