"""The table of intervals: what each method says, and why one is missing."""

import dataclasses
import json
import math

import arviz_base
import numpy as np
import pytest
import scipy.stats

from calibration import Parameter, Problem, fit
from calibration.intervals import combinations_in_words, compare_intervals
from calibration.noise import Robust
from calibration.profiling import profile
from procmodel.errors import InputError

X = np.linspace(0.0, 5.0, 10)


def product(params, x):
    return params["a"] * params["b"] * x


def power(params, x):
    """A law whose relative changes are those of its logarithm."""
    return params["scale"] * x ** params["exponent"]


def line_fit(models, **changed):
    parameters = {"a": Parameter(1.0, "um"), "b": Parameter(0.5)} | changed
    y = 1.0 + 0.5 * X + 0.1 * np.random.default_rng(0).normal(size=10)
    return fit(Problem.from_function(models.line, parameters, X, y, 0.1))


def draws(result, converged=1, **values):
    """A posterior like the one of `sample`, with known draws."""
    tree = arviz_base.from_dict({"posterior": values})
    tree.attrs = {
        "data_hash": result.problem.data_hash,
        "converged": converged,
        "status": "converged" if converged else "not converged: 3 autocorrelation times long",
    }
    return tree


def test_the_three_agree_on_a_straight_line(models):
    result = line_fit(models, idle=7.0)
    normal = scipy.stats.norm.ppf(np.linspace(0.0005, 0.9995, 1000))
    values = {
        name: (result.parameters[name].value + result.parameters[name].std * normal).reshape(4, 250)
        for name in "ab"
    }
    for level in (0.95, 0.8):
        table = compare_intervals(
            result, profile(result, level=level), draws(result, **values), level
        )
        for name in "ab":
            row, estimate = table.rows[name], result.parameters[name]
            reach = scipy.stats.norm.ppf(0.5 + level / 2) * estimate.std
            for interval in row.intervals.values():
                assert interval.low == pytest.approx(estimate.value - reach, abs=0.01 * reach)
                assert interval.high == pytest.approx(estimate.value + reach, abs=0.01 * reach)
                assert not interval.reason
            assert row.verdict == "identified" and not row.remark
        assert table.rows["idle"].verdict == "fixed"
    report = table.report()
    assert report.startswith("80 % intervals of line, data ")
    head = report.splitlines()[1].split()
    assert head == ["best", "Wald", "profile", "posterior", "verdict"]
    row = next(line for line in report.splitlines() if line.lstrip().startswith("a "))
    assert " um " in row and row.count(" to ") == 3 and row.endswith("identified")
    assert "reasons" not in report
    data = json.loads(json.dumps(table.as_dict(), allow_nan=False))
    assert data["parameters"]["a"]["profile"]["low"] == table.rows["a"].profile.low


def test_what_nobody_asked_for_is_a_line_and_not_a_column(models):
    result = line_fit(models)
    table = compare_intervals(result)
    assert table.rows["a"].profile.reason == table.rows["a"].posterior.reason == "not asked for"
    report = table.report()
    assert "  profile: not asked for" in report and "  posterior: not asked for" in report
    assert "-" not in report.splitlines()[2].split()
    part = compare_intervals(result, profile(result, "b"))
    assert part.rows["a"].profile.reason == "not asked for"
    assert "a, profile: not asked for" in part.report()


def test_a_run_that_has_not_converged_gives_no_interval(models):
    result = line_fit(models)
    posterior = draws(result, converged=0, a=np.zeros((4, 10)), b=np.zeros((4, 10)))
    table = compare_intervals(result, posterior=posterior)
    interval = table.rows["a"].posterior
    assert interval.missing
    expected = "the run has not converged: 3 autocorrelation times long"
    assert interval.reason == expected
    assert f"a, b, posterior: {expected}" in table.report()


def test_a_bound_is_named(models):
    result = line_fit(models, a=Parameter(2.0, "um", (1.5, 9.0)))
    table = compare_intervals(result, profile(result))
    row = table.rows["a"]
    assert row.verdict == "one-sided"
    assert row.wald.reason == "held at its lower bound 1.5"
    assert row.profile.low == 1.5 and "held at its lower bound 1.5" in row.profile.reason
    assert "a, Wald: held at its lower bound 1.5" in table.report()
    # The limit of a parameter at its bound is known for 95 % alone.
    assert compare_intervals(result, level=0.9).rows["a"].wald.missing


def test_what_the_data_leave_open_is_said():
    parameters = {name: Parameter(2.0) for name in "ab"}
    result = fit(Problem.from_function(product, parameters, X[1:], 3.0 * X[1:], 0.1))
    table = compare_intervals(result, profile(result))
    row = table.rows["a"]
    assert row.verdict == "flat"
    assert row.wald.missing and row.wald.reason == "the data leave it open"
    assert row.profile.missing and "is excluded" in row.profile.reason
    report = table.report()
    assert "the data cannot tell\n  a and b cannot be told apart" in report
    assert "a, b, Wald: the data leave it open" in report
    assert not table.combinations


def test_the_profile_decides_the_verdict_and_a_difference_is_remarked():
    # A power law with much noise: by its standard deviation the scale could be 0, which it cannot.
    x = np.linspace(1.0, 3.0, 10)
    y = 0.5 * x**1.5 + 0.8 * np.random.default_rng(5).normal(size=10)
    parameters = {
        "scale": Parameter(1.0, bounds=(0.0, math.inf)),
        "exponent": Parameter(1.0),
    }
    result = fit(Problem.from_function(power, parameters, x, y, 0.8))
    assert result.parameters["scale"].verdict == "one-sided"
    table = compare_intervals(result, profile(result))
    row = table.rows["scale"]
    assert row.verdict == "identified" and row.wald.low == 0.0 < row.profile.low
    assert "Wald misses the" in row.remark and "take the profile" in row.remark
    assert f"scale: {row.remark}" in table.report()
    assert compare_intervals(result).rows["scale"].verdict == "one-sided"


def test_combinations_are_the_eigenvectors_of_the_relative_covariance(models):
    result = line_fit(models)
    # One per cent of a is 0.01 um, one of b 0.005: covariance made by hand.
    best = np.array([0.6, 0.8])  # b moves most, a three quarters as much
    worst = np.array([0.8, -0.6])
    relative = 0.001**2 * np.outer(best, best) + 0.2**2 * np.outer(worst, worst)
    size = np.array([result.parameters[name].value for name in "ab"])
    made = dataclasses.replace(result, covariance=relative * np.outer(size, size))
    assert combinations_in_words(made) == (
        "best known: +1 % in b with +0.75 % in a, to 0.08 % (one standard deviation)",
        "worst known: +1 % in a with -0.75 % in b, to 16 % (one standard deviation)",
    )
    # One parameter alone makes no combination.
    covariance = made.covariance.copy()
    covariance[0, :] = covariance[:, 0] = np.nan
    assert combinations_in_words(dataclasses.replace(result, covariance=covariance)) == ()


def many(params, x):
    return sum(params[f"c{i}"] * x**i for i in range(6))


def test_a_long_combination_is_cut_short():
    x = np.linspace(-1.0, 1.0, 10)
    parameters = {f"c{i}": Parameter(1.0) for i in range(6)}
    y = sum(x**i for i in range(6))
    result = fit(Problem.from_function(many, parameters, x, y, 0.1))
    alike = dataclasses.replace(result, covariance=0.01 * (np.eye(6) + np.ones((6, 6))))
    worst = combinations_in_words(alike)[1]
    assert worst.count("% in c") == 4 and " and smaller ones in 2 more, to " in worst


def test_under_a_robust_loss_the_wald_interval_stands(models):
    # The readings scatter less than sigma allows: Huber's interval sees that, a profile cannot.
    y = 1.0 + 0.5 * X + 0.1 * np.random.default_rng(0).normal(size=10)
    parameters = {"a": Parameter(1.0), "b": Parameter(0.5)}
    result = fit(Problem.from_function(models.line, parameters, X, y, 0.3, noise=Robust()))
    table = compare_intervals(result, profile(result))
    row = table.rows["a"]
    assert row.wald.high - row.wald.low < 0.8 * (row.profile.high - row.profile.low)
    assert not table.rows["a"].remark
    assert any("robust loss is not a likelihood" in warning for warning in table.warnings)


def test_things_that_do_not_belong_together_are_errors(models):
    result = line_fit(models)
    curves = profile(result)
    with pytest.raises(InputError, match=r"made for level 0\.95, not 0\.9"):
        compare_intervals(result, curves, level=0.9)
    with pytest.raises(InputError, match="level is 95"):
        compare_intervals(result, level=95)
    with pytest.raises(InputError, match="the profile is of data 0000, the fit of"):
        compare_intervals(result, dataclasses.replace(curves, data_hash="0000"))
    foreign = draws(result, a=np.zeros((4, 10)))
    foreign.attrs["data_hash"] = "0000"
    with pytest.raises(InputError, match="the posterior is of data 0000"):
        compare_intervals(result, posterior=foreign)
