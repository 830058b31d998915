"""The next measurement: known optimal designs, brute force, and refits with the readings added."""

import itertools
import json
import math

import jax.numpy as jnp
import numpy as np
import pytest

from calibration import Dataset, Normal, Parameter, Problem, fit
from calibration.design import next_measurement
from calibration.design_search import Information, Search
from procmodel.errors import InputError


def line(p, x):
    return p["a"] + p["b"] * x


def decay(p, x):
    return p["a"] * jnp.exp(-p["b"] * x)


def parabola(p, x):
    return p["a"] + p["b"] * x + p["c"] * x**2


def ratio(p, x):
    return p["a"] / p["b"] * x["one"] + p["b"] * x["two"] * x.get("twice", 1.0)


def fitted(model, truth, x, sigma=1.0, noise=0.0, seed=0, **changes):
    """Fit of readings of the model at x."""
    x = np.asarray(x, float) if not isinstance(x, dict) else x
    y = np.asarray(model(truth, x), float)
    y = y + noise * np.random.default_rng(seed).normal(size=y.shape)
    parameters = {n: Parameter(v) for n, v in truth.items()} | changes
    return fit(Problem.from_function(model, parameters, x, y, sigma))


# So vague that it does not count beside the readings to be chosen.
VAGUE = 1e4


@pytest.mark.parametrize("n", [2, 6])
def test_line_is_measured_at_both_ends(n):
    result = fitted(line, {"a": 1.0, "b": 2.0}, [-1.0, -0.3, 0.3, 1.0], VAGUE)
    grid = np.linspace(-1.0, 1.0, 41)
    design = next_measurement(result, grid, n, sigma=1.0)
    assert {grid[i]: k for i, k in design.chosen.items()} == {-1.0: n // 2, 1.0: n // 2}


def test_decay_is_measured_at_zero_and_at_its_time_constant():
    result = fitted(decay, {"a": 3.0, "b": 0.5}, [0.1, 1.0, 3.0, 6.0], VAGUE)
    grid = np.linspace(0.0, 10.0, 101)
    design = next_measurement(result, grid, 4, sigma=0.1)
    assert {float(grid[i]): k for i, k in design.chosen.items()} == {0.0: 2, 2.0: 2}


@pytest.mark.parametrize("n", [3, 9])
def test_parabola_is_measured_at_its_ends_and_middle(n):
    result = fitted(parabola, {"a": 1.0, "b": 2.0, "c": 1.0}, [-1.0, -0.5, 0.4, 0.9], VAGUE)
    grid = np.linspace(-1.0, 1.0, 41)
    design = next_measurement(result, grid, n, sigma=1.0)
    assert {grid[i]: k for i, k in design.chosen.items()} == {
        -1.0: n // 3,
        0.0: n // 3,
        1.0: n // 3,
    }


def brute_force(model_rows, base, n, value, repeats):
    choose = itertools.combinations_with_replacement if repeats else itertools.combinations
    return max(
        (value(np.linalg.inv(base + sum(np.outer(r, r) for r in model_rows[list(c)]))), c)
        for c in choose(range(len(model_rows)), n)
    )


VALUES = {
    "D": lambda c: -np.linalg.slogdet(c)[1],
    "A": lambda c: -float(np.sum(np.diag(c) / np.array([3.0, 0.5]) ** 2)),
    "b": lambda c: -float(c[1, 1]),
}


@pytest.mark.parametrize("repeats", [True, False])
@pytest.mark.parametrize("criterion", VALUES)
def test_greedy_and_exchange_find_what_enumeration_finds(criterion, repeats):
    truth = {"a": 3.0, "b": 0.5}
    x = np.array([0.2, 0.4, 0.6, 5.0])
    result = fitted(decay, truth, x, 0.3)
    grid = np.array([0.0, 0.5, 1.1, 1.9, 2.7, 3.6, 5.2, 7.0])
    sigma = np.linspace(0.1, 0.3, 8)

    def rows(at, sigma):
        decayed = np.exp(-0.5 * at)
        return np.stack([decayed, -3.0 * at * decayed], 1) / np.reshape(sigma, (-1, 1))

    base = rows(x, 0.3).T @ rows(x, 0.3)
    best, _ = brute_force(rows(grid, sigma), base, 4, VALUES[criterion], repeats)
    design = next_measurement(result, grid, 4, sigma, criterion, repeats=repeats)
    picked = [i for i, k in design.chosen.items() for _ in range(k)]
    assert len(picked) == 4 and (repeats or len(set(picked)) == 4)
    added = rows(grid, sigma)[picked]
    covariance = np.linalg.inv(base + added.T @ added)
    assert VALUES[criterion](covariance) == pytest.approx(best, rel=1e-6)
    assert list(design.std_after.values()) == pytest.approx(
        list(np.sqrt(np.diag(covariance))), rel=1e-6
    )
    # And what each does alone, by rank-one updates, equals inverting afresh.
    before = np.linalg.inv(base)
    for i, row in enumerate(rows(grid, sigma)):
        alone = np.linalg.inv(base + np.outer(row, row))
        expected = VALUES[criterion](alone) - VALUES[criterion](before)
        assert design.gain[i] == pytest.approx(expected, rel=1e-6)
        shrunk = np.sqrt(np.diag(before) / np.diag(alone))
        assert [design.shrinks[n][i] for n in "ab"] == pytest.approx(list(shrunk), rel=1e-6)
    assert np.all(np.diff(design.gain[design.ranking]) <= 1e-12)


def test_expected_deviations_are_those_of_a_refit():
    truth = {"a": 1.0, "b": 2.0}
    x, grid = np.array([0.0, 0.3, 0.5, 1.0]), np.linspace(0.0, 2.0, 5)
    result = fitted(line, truth, x, 0.2, noise=0.2)
    design = next_measurement(result, grid, 3)
    assert np.ptp(result.problem.datasets["data"].sigma) == 0.0  # hence none needs to be given
    added = np.repeat(grid[list(design.chosen)], list(design.chosen.values()))
    again = fitted(line, truth, np.concatenate([x, added]), 0.2, noise=0.2, seed=1)
    for name in truth:
        assert design.std_before[name] == pytest.approx(result.parameters[name].std, rel=1e-9)
        assert design.std_after[name] == pytest.approx(again.parameters[name].std, rel=1e-9)


def test_expected_deviations_of_a_curved_model_with_unknown_noise_hold_on_average():
    truth = {"a": 3.0, "b": 0.5}
    x = np.linspace(0.0, 6.0, 12)
    result = fitted(decay, truth, x, None, noise=0.05, seed=2)
    design = next_measurement(result, np.linspace(0.0, 8.0, 33), 12)
    grid = np.linspace(0.0, 8.0, 33)
    added = np.repeat(grid[list(design.chosen)], list(design.chosen.values()))
    both = np.concatenate([x, added])
    found = [
        fitted(decay, truth, both, None, noise=result.noise["data"], seed=s).parameters
        for s in range(40)
    ]
    for name in truth:
        # The refits' noise has 22 degrees of freedom: 40 of them average to 15 % / sqrt(40).
        mean = np.mean([f[name].std for f in found])
        assert design.std_after[name] == pytest.approx(mean, rel=0.08)
        assert design.std_before[name] > 1.1 * mean
        scatter = np.std([f[name].value for f in found])
        assert scatter == pytest.approx(design.std_after[name], rel=0.35)


def test_a_named_parameter_has_a_design_of_its_own():
    result = fitted(line, {"a": 1.0, "b": 2.0}, [-1.0, -1.0, 1.0, 1.0], VAGUE)
    # The intercept is best known where it is read off.
    design = next_measurement(result, np.linspace(-0.5, 2.0, 26), 1, 1.0, "a")
    assert design.setting(next(iter(design.chosen))) == "x = 0."
    assert design.std_after["a"] == pytest.approx(1.0, rel=1e-3)


def two_settings():
    """Only a / b is seen so far; only candidates with two > 0 tell b."""
    x = {"one": np.array([1.0, 2.0, 3.0]), "two": np.zeros(3)}
    result = fitted(ratio, {"a": 2.0, "b": 4.0}, x, 0.1, noise=0.1)
    assert result.parameters["a"].verdict == "flat"
    candidates = {"one": [100.0, 1.0, 0.0, 0.0], "two": [0.0, 0.01, 0.0, 0.02]}
    return result, {name: np.array(values) for name, values in candidates.items()}


@pytest.mark.parametrize("criterion", ["D", "A", "a", "b"])
def test_what_makes_an_open_parameter_identifiable_is_better_than_anything(criterion):
    result, candidates = two_settings()
    design = next_measurement(result, candidates, 1, criterion=criterion)
    assert set(design.chosen) <= {1, 3}
    assert design.std_before == {"a": None, "b": None}
    assert all(std is not None for std in design.std_after.values())
    assert list(np.isinf(design.gain)) == [False, True, False, True]
    assert set(design.ranking[:2]) == {1, 3}
    assert np.all(np.isinf(design.shrinks["b"][[1, 3]]))
    assert np.all(np.isnan(design.shrinks["b"][[0, 2]]))
    # One reading of b * 0.02 and the ratio: b to 0.1 / 0.02 when candidate 3 is chosen.
    if 3 in design.chosen:
        assert design.std_after["b"] == pytest.approx(5.0, rel=1e-6)
    assert "b is open so far; 2 of 4 candidates make it identifiable" in design.report()
    json.dumps(design.as_dict(), allow_nan=False)


@pytest.mark.parametrize("rank", [0, 1, 3, 4])
def test_rank_one_updates_equal_a_fresh_analysis(rank):
    rng = np.random.default_rng(rank)
    base = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, 4))
    rows = rng.normal(size=(9, 4)) * 10.0 ** rng.uniform(-1.0, 1.0, size=(9, 1))
    rows[:2] = rng.normal(size=(2, 6)) @ base  # nothing new
    rows[2] = [0.0, 0.0, 1.0, 0.0]
    search = Search(base, rows, None, None, True)
    scores = search.score(Information.of(base))
    for i, row in enumerate(rows):
        fresh = Information.of(np.concatenate([base, row[None]]))
        assert scores.first[i] == fresh.rank == np.linalg.matrix_rank(np.vstack([base, row]))
        assert scores.second[i] == pytest.approx(fresh.log_determinant, abs=1e-9)
        np.testing.assert_array_equal(scores.open[i], fresh.open)
        expected = np.where(fresh.open, np.nan, np.diag(fresh.inverse))
        np.testing.assert_allclose(scores.variances[i], expected, rtol=1e-8)
        information = base.T @ base + np.outer(row, row)
        inverse = np.linalg.pinv(information, rcond=1e-12, hermitian=True)
        np.testing.assert_allclose(fresh.inverse, inverse, atol=1e-8 * np.max(np.abs(inverse)))


def test_several_readings_after_the_open_direction_is_closed():
    result, candidates = two_settings()
    # What is the same for all candidates is handed on, and not part of a setting's name.
    design = next_measurement(result, candidates | {"twice": 1.0}, 3, criterion="D")
    assert "twice" not in design.report()
    # Information of (ratio, b) is diagonal but for candidate 1: by enumeration.
    rows = np.stack([candidates["one"], candidates["two"]], 1) / 0.1
    base = np.diag([14.0 / 0.01, 0.0])
    best = max(
        np.linalg.det(base + sum(np.outer(r, r) for r in rows[list(c)]))
        for c in itertools.combinations_with_replacement(range(4), 3)
    )
    picked = [i for i, k in design.chosen.items() for _ in range(k)]
    found = np.linalg.det(base + rows[picked].T @ rows[picked])
    assert found == pytest.approx(best, rel=1e-6)


def test_nothing_to_be_gained_is_said():
    result, _ = two_settings()
    blind = {"one": np.array([1.0, 5.0]), "two": np.zeros(2)}
    design = next_measurement(result, blind, 2)
    assert design.std_after == {"a": None, "b": None}
    assert "neither a single candidate nor the chosen set makes it identifiable" in design.report()


def test_a_prior_counts_as_information():
    x = np.array([1.0, 2.0])
    parameters = {"a": Parameter(1.0, prior=Normal(1.0, 0.5)), "b": Parameter(2.0)}
    result = fit(Problem.from_function(line, parameters, x, 1.0 + 2.0 * x, 1.0))
    design = next_measurement(result, [0.0, 3.0])
    base = np.array([[2.0 + 4.0, 3.0], [3.0, 5.0]])
    expected = np.sqrt(np.diag(np.linalg.inv(base)))
    assert list(design.std_before.values()) == pytest.approx(list(expected), rel=1e-9)


def test_a_parameter_at_its_bound_is_fixed_and_said_to_be():
    x = np.linspace(0.0, 1.0, 4)
    a = Parameter(1.0, "um", (0.0, 1.5))
    result = fitted(line, {"a": 2.0, "b": 1.0}, x, 0.1, a=a)
    design = next_measurement(result, [0.0, 0.5, 1.0])
    assert design.std_before["a"] is None and design.std_after["a"] is None
    assert "a is held at a bound and taken as fixed" in design.notes
    assert design.chosen == {2: 1}
    with pytest.raises(InputError, match="'a' is held at a bound"):
        next_measurement(result, [0.0, 1.0], criterion="a")


def test_transforms_do_not_change_the_design():
    x, truth = [0.1, 1.0, 3.0, 6.0], {"a": 3.0, "b": 0.5}
    log = {n: Parameter(v, "", (0.0, 10.0), transform="log") for n, v in truth.items()}
    plain, logs = fitted(decay, truth, x, 0.1), fitted(decay, truth, x, 0.1, **log)
    grid = np.linspace(0.0, 9.0, 10)
    one, other = next_measurement(plain, grid, 3), next_measurement(logs, grid, 3)
    assert one.chosen == other.chosen
    assert list(one.std_after.values()) == pytest.approx(list(other.std_after.values()), rel=1e-6)


def test_own_parameters_and_choice_of_data_set():
    x = np.linspace(0.0, 4.0, 6)
    parameters = {"first": Parameter(1.0), "second": Parameter(5.0), "b": Parameter(2.0)}
    datasets = {
        key: Dataset(x, start + 2.0 * x, 0.1, own={"a": key})
        for key, start in (("first", 1.0), ("second", 5.0))
    }
    result = fit(Problem(parameters, datasets, line))
    with pytest.raises(InputError, match="several data sets: name one"):
        next_measurement(result, x)
    with pytest.raises(InputError, match="'secnd' is unknown; did you mean 'second'"):
        next_measurement(result, x, dataset="secnd")
    design = next_measurement(result, x, 5, criterion="second", dataset="second")
    assert design.std_after["second"] < 0.8 * design.std_before["second"]
    assert design.std_after["first"] > 0.8 * design.std_before["first"]


def test_very_many_candidates():
    result = fitted(decay, {"a": 3.0, "b": 0.5}, [0.1, 1.0, 3.0, 6.0], VAGUE)
    grid = np.linspace(0.0, 10.0, 100_001)
    design = next_measurement(result, grid, 4, sigma=0.1)
    assert [float(grid[i]) for i in design.chosen] == pytest.approx([0.0, 2.0], abs=2e-4)
    assert len(design.report()) < 3000


def test_the_report_reads():
    result = fitted(decay, {"a": 3.0, "b": 0.5}, [0.1, 1.0, 3.0, 6.0], 0.1)
    design = next_measurement(result, [0.0, 2.0, 4.0], 3)
    report = design.report()
    for part in ("measure next (D: ", "2 x x = ", "expected standard deviations", "times smaller"):
        assert part in report
    assert math.isclose(design.as_dict()["std_after"]["a"], design.std_after["a"])


def test_bad_input_is_refused_in_words():
    truth, sigma = {"a": 1.0, "b": 2.0}, [0.1, 0.2, 0.3, 0.4]
    result = fitted(decay, truth, [0.0, 0.5, 1.0, 1.5], sigma)
    for arguments, words in (
        (
            {"sigma": 1.0, "candidates": [1.0, 2.0, -1e3]},
            r"not finite at the candidate of index 2: leave",
        ),
        ({}, "differs from reading to reading: give the sigma of the candidates"),
        ({"sigma": [1.0, 2.0]}, "sigma has 2 values for 3 candidates"),
        ({"sigma": 0.0}, "above 0 at every candidate"),
        ({"sigma": 1.0, "criterion": "bb"}, "criterion 'bb' is unknown; did you mean 'b'"),
        ({"sigma": 1.0, "criterion": "E"}, "known are D, A, a, b"),
        ({"sigma": 1.0, "n": 0}, "n is 0, but must be 1 or more"),
        ({"sigma": 1.0, "n": 4, "repeats": False}, "without repeats 3 at most"),
        ({"candidates": []}, "candidates is empty"),
        ({"candidates": {}}, "candidates is empty"),
        ({"candidates": 3.0}, "give an array of settings"),
    ):
        arguments = {"candidates": [1.0, 2.0, 4.0]} | arguments
        with pytest.raises(InputError, match=words):
            next_measurement(result, **arguments)
