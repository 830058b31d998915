"""Profile likelihood against closed forms, an independent profile, and simulated coverage."""

import dataclasses
import json
import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from calibration import Normal, Parameter, Problem, fit
from calibration.profiling import profile
from procmodel.errors import InputError

NORMAL95 = scipy.stats.norm.ppf(0.975)


def hyperbola(params, x):
    """Michaelis-Menten rate."""
    return params["v"] * x / (params["k"] + x)


def cubic_slope(params, x):
    return params["a"] + params["c"] ** 3 * x


def saturation(params, x):
    return params["height"] * (1.0 - jnp.exp(-params["rate"] * x))


def product(params, x):
    return params["a"] * params["b"] * x


def constant(params, x):
    return params["mean"] + x


def sine(params, x):
    return params["a"] * jnp.sin(params["w"] * x)


def root(params, x):
    """Not a number below c = 0."""
    return jnp.sqrt(params["c"]) + 0.0 * x


def doubled(params):
    return 2.0 * params["a"]


# Rates of the reaction with puromycin: D. M. Bates and D. G. Watts, "Nonlinear Regression Analysis
# and Its Applications", 1988, table A1.3 (treated).
CONCENTRATION = np.repeat([0.02, 0.06, 0.11, 0.22, 0.56, 1.10], 2)
RATE = np.array([76, 47, 97, 107, 123, 139, 159, 152, 191, 201, 207, 200], float)


def puromycin(transform="identity", sigma=None):
    low = 0.0 if transform == "log" else -math.inf
    parameters = {
        "v": Parameter(200.0, "counts/min^2", (low, math.inf), transform=transform),
        "k": Parameter(0.1, "ppm", (low, math.inf), transform=transform),
    }
    return fit(Problem.from_function(hyperbola, parameters, CONCENTRATION, RATE, sigma))


@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
@pytest.mark.parametrize("sigma", [None, 0.4], ids=["estimated noise", "known noise"])
def test_a_linear_model_has_the_wald_interval(models, sigma, level):
    x = np.linspace(-2.0, 7.0, 10)
    y = 4.0 - 0.3 * x + 0.4 * np.random.default_rng(5).normal(size=10)
    parameters = {"a": Parameter(0.0), "b": Parameter(0.0)}
    result = fit(Problem.from_function(models.line, parameters, x, y, sigma))
    found = profile(result, level=level)
    for name in "ab":
        curve, estimate = found.parameters[name], result.parameters[name]
        low, high = result.quantiles(name, np.array([0.5 - level / 2, 0.5 + level / 2]))
        reach = high - estimate.value
        assert curve.interval == pytest.approx((low, high), abs=1e-6 * reach)
        assert (curve.low.status, curve.high.status) == ("closed", "closed")
        assert curve.skew == pytest.approx(0.0, abs=1e-6)
        # The curve is the straight line through the optimum with slope 1/std.
        expected = (curve.values - estimate.value) / estimate.std
        np.testing.assert_allclose(curve.zeta, expected, atol=1e-5)
        assert np.all(np.diff(curve.values) > 0) and len(curve.values) >= 9
    assert found.better is None and not found.warnings


def test_a_prior_counts_like_a_reading(models):
    x, y = np.array([0.0, 1.0, 2.0]), np.array([1.0, 2.1, 2.9])
    parameters = {"a": Parameter(0.0), "b": Parameter(0.5, prior=Normal(0.5, 0.05))}
    result = fit(Problem.from_function(models.line, parameters, x, y, 0.2))
    found = profile(result)
    for name in "ab":
        expected = result.parameters[name].interval95
        assert found.parameters[name].interval == pytest.approx(expected, rel=1e-6)


def test_a_fitted_noise_level_has_its_closed_form():
    # Mean m and level s of normal readings: twice the cost rises by n log(1 + (v - m)^2 / s^2) at a
    # mean v, and by n (2 log(v / s) + s^2 / v^2 - 1) at a level v.
    y = 1.0 + 0.3 * np.random.default_rng(2).normal(size=12)
    parameters = {"mean": Parameter(0.5), "level": Parameter(0.5, bounds=(1e-6, 1e3))}
    found = profile(fit(Problem.from_function(constant, parameters, np.zeros(12), y, "level")))
    best, level = np.mean(y), np.std(y)
    reach = level * math.sqrt(math.exp(NORMAL95**2 / 12) - 1.0)
    assert found.parameters["mean"].interval == pytest.approx(
        (best - reach, best + reach), rel=1e-6
    )

    def beyond(v):
        return 12.0 * (2.0 * math.log(v / level) + (level / v) ** 2 - 1.0) - NORMAL95**2

    ends = [scipy.optimize.brentq(beyond, 0.3 * level, level)]
    ends += [scipy.optimize.brentq(beyond, level, 5.0 * level)]
    assert found.parameters["level"].interval == pytest.approx(ends, rel=1e-6)
    # Negative control: the sum of squared deviations over a level held fixed gives another mean.
    assert reach > 1.05 * NORMAL95 * level / math.sqrt(12)


def test_a_bent_parameter_has_its_closed_form():
    # a + c^3 x is linear in c^3: the ends are the cube roots of the ends of a straight slope.
    x = np.linspace(0.0, 1.0, 9)
    y = 1.0 + 0.5**3 * x + 0.02 * np.random.default_rng(0).normal(size=9)
    line = scipy.stats.linregress(x, y)
    reach = scipy.stats.t.ppf(0.975, 7) * line.stderr
    result = fit(
        Problem.from_function(cubic_slope, {"a": Parameter(0.5), "c": Parameter(1.0)}, x, y)
    )
    curve = profile(result, "c").parameters["c"]
    expected = np.cbrt([line.slope - reach, line.slope + reach])
    assert curve.interval == pytest.approx(expected, rel=1e-6)
    best = np.cbrt(line.slope)
    skew = (expected[1] + expected[0] - 2.0 * best) / (expected[1] - expected[0])
    assert curve.skew == pytest.approx(skew, abs=1e-5) and skew < -0.02
    assert curve.zeta == pytest.approx((curve.values**3 - line.slope) / line.stderr, abs=1e-5)
    # Negative control: the Wald interval is another one.
    assert result.parameters["c"].interval95 != pytest.approx(expected, rel=1e-3)


def independent_interval(held):
    """Profile interval of one parameter of the puromycin data by SciPy alone."""

    def residuals(v, k):
        return v * CONCENTRATION / (k + CONCENTRATION) - RATE

    settings = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "x_scale": "jac"}
    best = scipy.optimize.least_squares(lambda p: residuals(*p), [200.0, 0.1], **settings)
    variance = 2.0 * best.cost / (len(RATE) - 2)
    threshold = scipy.stats.t.ppf(0.975, len(RATE) - 2) ** 2

    def beyond(value):
        def others(p):
            return residuals(value, p[0]) if held == 0 else residuals(p[0], value)

        start = best.x[1 - held]
        fitted = scipy.optimize.least_squares(others, [start], **settings)
        return 2.0 * (fitted.cost - best.cost) / variance - threshold

    centre = best.x[held]
    return tuple(
        scipy.optimize.brentq(beyond, *sorted((centre, factor * centre)), xtol=1e-12)
        for factor in (0.5, 2.0)
    )


@pytest.mark.parametrize("transform", ["identity", "log"])
def test_puromycin_against_an_independent_profile(transform):
    result = puromycin(transform)
    assert result.parameters["v"].value == pytest.approx(212.7, abs=0.05)  # Bates and Watts
    assert result.parameters["k"].value == pytest.approx(0.06412, abs=5e-6)
    found = profile(result)
    for held, name in enumerate(("v", "k")):
        expected = independent_interval(held)
        assert found.parameters[name].interval == pytest.approx(expected, rel=1e-6)
    # R's confint() on the same fit, which interpolates its profile by a spline.
    assert found.parameters["v"].interval == pytest.approx((197.30213, 229.29006), rel=2e-5)
    assert found.parameters["k"].interval == pytest.approx((0.04692517, 0.08615995), rel=2e-4)


def test_the_interval_does_not_depend_on_the_transform():
    x = np.linspace(0.2, 3.0, 8)
    y = 5.0 * (1.0 - np.exp(-0.8 * x)) + 0.3 * np.random.default_rng(3).normal(size=8)

    def intervals(transform):
        parameters = {
            "height": Parameter(3.0, bounds=(1e-3, 1e3), transform=transform),
            "rate": Parameter(0.5, bounds=(1e-3, 1e2), transform=transform),
        }
        result = fit(Problem.from_function(saturation, parameters, x, y, 0.3))
        found = profile(result)
        return [found.parameters[n].interval for n in found.parameters], result

    plain, of_plain = intervals("identity")
    other, of_other = intervals("logit")
    np.testing.assert_allclose(other, plain, rtol=1e-5)
    # Negative control: the Wald interval does depend on it.
    ours, theirs = (r.parameters["rate"].interval95 for r in (of_plain, of_other))
    assert ours[0] != pytest.approx(theirs[0], rel=0.02)


def test_a_bound_met_before_the_threshold(models):
    x = np.linspace(0.0, 1.0, 10)
    y = 0.05 + x + 0.2 * np.random.default_rng(1).normal(size=10)
    free = {"a": Parameter(0.1), "b": Parameter(1.0)}
    unbounded = profile(fit(Problem.from_function(models.line, free, x, y, 0.2)))
    bounded = free | {"a": Parameter(0.1, bounds=(0.0, 5.0))}
    found = profile(fit(Problem.from_function(models.line, bounded, x, y, 0.2)))
    a, b = found.parameters["a"], found.parameters["b"]
    assert unbounded.parameters["a"].low.value < 0.0
    assert (a.low.status, a.low.value) == ("at bound", 0.0)
    assert "lower bound 0 is not excluded" in a.low.reason
    assert a.high.value == pytest.approx(unbounded.parameters["a"].high.value, rel=1e-6)
    assert a.skew is None and not a.closed
    # With a held back at its bound, less is possible for b.
    assert b.high.value < unbounded.parameters["b"].high.value - 0.01


def test_a_parameter_held_at_its_bound_has_a_one_sided_interval(models):
    x = np.linspace(0.0, 1.0, 10)
    y = x - 0.3
    parameters = {"a": Parameter(0.1, bounds=(0.0, 5.0)), "b": Parameter(1.0)}
    result = fit(Problem.from_function(models.line, parameters, x, y, 0.2))
    assert result.parameters["a"].std is None
    a = profile(result).parameters["a"]
    assert a.low.value == 0.0 and "held at its lower bound 0" in a.low.reason

    def cost(value):
        slope = np.sum(x * (y - value)) / np.sum(x**2)
        return 0.5 * np.sum((y - value - slope * x) ** 2) / 0.2**2

    rise = scipy.optimize.brentq(
        lambda v: 2.0 * (cost(v) - cost(0.0)) - NORMAL95**2, 0.0, 5.0, xtol=1e-13
    )
    assert a.high.value == pytest.approx(rise, rel=1e-6)


@pytest.mark.parametrize("transform", ["identity", "log"])
def test_far_below_the_constant_the_upper_ends_are_open(transform):
    # As many readings as the reaction with puromycin, so that nothing new is compiled.
    x = np.linspace(0.01, 0.1, 12)
    y = 5.0 * x / (1.0 + x) + 0.02 * np.random.default_rng(1).normal(size=12)
    parameters = {
        name: Parameter(2.0, bounds=(0.0, math.inf), transform=transform) for name in "vk"
    }
    result = fit(Problem.from_function(hyperbola, parameters, x, y))
    found = profile(result)
    for name in "vk":
        curve = found.parameters[name]
        assert curve.low.status == "closed" and curve.low.value > 0.1
        assert (curve.high.status, curve.high.value) == ("open", None)
        assert "is excluded" in curve.high.reason
        # The root levels off at what a straight line through 0 costs more.
        slope = np.sum(x * y) / np.sum(x**2)
        rise = np.sum((y - slope * x) ** 2) - np.sum(result.residuals["data"] ** 2)
        level = result.noise["data"]
        assert curve.zeta[-1] == pytest.approx(math.sqrt(rise) / level, rel=1e-3)


def test_a_product_is_open_and_its_bounds_close_it():
    x = np.linspace(0.1, 1.0, 10)
    y = 3.0 * x

    def found(bounds):
        parameters = {name: Parameter(1.5, bounds=bounds) for name in "ab"}
        result = fit(Problem.from_function(product, parameters, x, y, 0.01))
        assert result.parameters["a"].std is None
        return profile(result, "a").parameters["a"]

    both = found((-math.inf, math.inf))
    assert (both.low.status, both.high.status) == ("open", "open")
    assert both.interval == (None, None)
    bounded = found((0.0, 100.0))
    # b <= 100 leaves a no less than what the product is known to be at least, over 100.
    least = 3.0 - NORMAL95 * 0.01 / math.sqrt(np.sum(x**2))
    assert bounded.low.value == pytest.approx(least / 100.0, rel=1e-5)
    assert (bounded.high.status, bounded.high.value) == ("at bound", 100.0)


def test_a_lower_misfit_on_the_way_is_told():
    rng = np.random.default_rng(3)
    x = np.linspace(0.0, 10.0, 40)
    y = 2.0 * np.sin(2.7 * x) + 0.3 * rng.normal(size=40)
    bounds = {"a": Parameter(1.0, bounds=(0.0, 10.0)), "w": Parameter(3.3, bounds=(0.1, 6.0))}
    local = fit(Problem.from_function(sine, bounds, x, y, 2.0))
    assert local.converged and local.parameters["w"].value > 3.3
    found = profile(local)
    w = found.parameters["w"]
    assert w.low.status == "failed" and "lower than at the fit" in w.low.reason
    assert w.low.value is None
    assert found.better["w"] == pytest.approx(2.7, abs=0.05)
    assert found.better["a"] == pytest.approx(2.0, abs=0.3)
    (warning,) = found.warnings
    assert "the fit is a local optimum" in warning and "w = 2.7" in warning
    assert "local optimum" in found.report()
    # Negative control: from the better place there is nothing to warn of.
    moved = bounds | {"w": Parameter(found.better["w"], bounds=(0.1, 6.0))}
    again = profile(fit(Problem.from_function(sine, moved, x, y, 2.0)))
    assert again.better is None and not again.warnings
    assert again.parameters["w"].closed


def test_where_the_model_ends_before_the_threshold_the_end_fails():
    x = np.zeros(4)
    y = np.array([0.1, -0.1, 0.3, 0.2])
    result = fit(Problem.from_function(root, {"c": Parameter(0.5)}, x, y, 1.0))
    c = profile(result).parameters["c"]
    assert c.low.status == "failed" and "not finite further on" in c.low.reason
    mean = np.mean(y)
    assert c.high.value == pytest.approx((mean + NORMAL95 / 2.0) ** 2, rel=1e-6)


def test_a_parameter_without_effect_is_open_and_others_say_why_they_have_none(models):
    x = np.linspace(0.0, 1.0, 6)
    parameters = {
        "a": Parameter(0.0),
        "b": Parameter(0.0),
        "idle": Parameter(1.0),
        "c": 3.0,
        "twin": Parameter(0.0, tied="a"),
        "double": Parameter(0.0, tied=doubled),
    }
    result = fit(Problem.from_function(models.line, parameters, x, 1.0 + x + 0.1 * x**2))
    told = []
    found = profile(result, progress=lambda *seen: told.append(seen))
    reasons = {name: p.reason for name, p in found.parameters.items()}
    assert reasons == {
        "a": "",
        "b": "",
        "idle": "",
        "c": "it is fixed",
        "twin": "it follows a",
        "double": "it follows other parameters",
    }
    assert found.parameters["c"].interval is None
    idle = found.parameters["idle"]
    assert (idle.low.status, idle.high.status) == ("open", "open")
    assert np.all(np.abs(idle.zeta) < 1e-3)
    assert told == [("profiles", None, 0), *(("profiles", i, 6) for i in range(1, 7))]
    assert "no profile: it is fixed" in found.report()
    data = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    assert data["parameters"]["a"]["interval"] == list(found.parameters["a"].interval)
    assert data["parameters"]["c"]["interval"] is None
    assert len(data["parameters"]["b"]["curve"]["zeta"]) == len(found.parameters["b"].zeta)


def test_no_reading_left_over(models):
    x = np.array([0.0, 1.0])
    parameters = {"a": Parameter(0.0), "b": Parameter(0.0)}
    found = profile(fit(Problem.from_function(models.line, parameters, x, x)))
    assert "no reading is left over" in found.parameters["a"].reason


def test_what_cannot_be_profiled_is_an_error():
    result = puromycin()
    with pytest.raises(InputError, match="'vv' is unknown; did you mean 'v'"):
        profile(result, ["vv"])
    with pytest.raises(InputError, match="level is 95"):
        profile(result, level=95)
    unfinished = dataclasses.replace(result, converged=False, status="not converged: out of steps")
    with pytest.raises(InputError, match=r"did not converge.*out of steps"):
        profile(unfinished)


@pytest.mark.slow
def test_the_profile_covers_where_the_wald_interval_does_not():
    # A saturation that is hardly reached within the readings: a bent, weakly known rate.
    x = np.linspace(0.3, 3.0, 8)
    rng = np.random.default_rng(0)
    truth, sigma, runs = 5.0, 0.25, 400
    exact = truth * (1.0 - np.exp(-0.3 * x))
    start = {"height": Parameter(5.0, bounds=(0.0, 1e3)), "rate": Parameter(0.3, bounds=(0.0, 1e2))}
    covered = wald = 0
    for _ in range(runs):
        y = exact + sigma * rng.normal(size=8)
        result = fit(Problem.from_function(saturation, start, x, y, sigma))
        low, high = result.parameters["height"].interval95 or (-math.inf, math.inf)
        wald += low <= truth <= high
        low, high = profile(result, "height").parameters["height"].interval
        covered += low <= truth <= high
    assert covered / runs == pytest.approx(0.95, abs=0.02)
    assert wald / runs < 0.92
