"""Models of the same data side by side, against leave-one-out by fitting anew without each."""

import json

import numpy as np
import pytest
import scipy.stats

from calibration import (
    Dataset,
    Parameter,
    Problem,
    compare_models,
    fit,
    load_result,
    sample,
    save_result,
    with_predictions,
)
from procmodel.errors import InputError

N = 24
# Close together at the ends, where a reading would else move the fit so much that importance
# weights are doubtful.
X = 1.0 - 1.5 * np.cos(np.pi * (np.arange(N) + 0.5) / N)
SIGMA = 0.3
Y = 1.0 + 0.5 * X + 0.5 * X**2 + SIGMA * np.random.default_rng(4).normal(size=N)
DESIGNS = {
    "line": np.stack([np.ones(N), X], axis=1),
    "parabola": np.stack([np.ones(N), X, X**2], axis=1),
}


def parabola(params, x):
    return params["a"] + params["b"] * x + params["c"] * x**2


def problem(models, name, y=Y):
    parameters = {n: Parameter(0.0) for n in ("ab" if name == "line" else "abc")}
    function = models.line if name == "line" else parabola
    return Problem(parameters, {"data": Dataset(X, y, SIGMA)}, function)


@pytest.fixture(scope="module")
def results(models, tmp_path_factory):
    """Line and parabola, with draws and without, and the parabola with other draws."""
    folder = tmp_path_factory.mktemp("comparison")
    found = {}
    for name, kind, seed in (
        ("line", "line", 1),
        ("parabola", "parabola", 1),
        ("again", "parabola", 2),
    ):
        asked = problem(models, kind)
        result = fit(asked)
        tree = sample(asked, seed=seed, draws=32_000, ensembles=2, start=result)
        save_result(folder / f"{name}.nc", result, None, with_predictions(asked, tree, draws=4000))
        save_result(folder / f"{name} alone.nc", result)
    for path in folder.iterdir():
        found[path.stem] = load_result(path)
    return found


def chosen(results, *names):
    return compare_models({name: results[name] for name in names})


def left_out(design):
    """Log density of each reading given the others: prediction of a fit without it, exactly."""
    densities = []
    for i in range(N):
        kept = np.arange(N) != i
        covariance = SIGMA**2 * np.linalg.inv(design[kept].T @ design[kept])
        best = np.linalg.lstsq(design[kept], Y[kept])[0]
        spread = np.sqrt(SIGMA**2 + design[i] @ covariance @ design[i])
        densities.append(scipy.stats.norm.logpdf(Y[i], design[i] @ best, spread))
    return np.array(densities)


def test_the_right_model_wins(results):
    found = chosen(results, "line", "parabola")
    assert list(found.scores) == ["parabola", "line"]
    assert found.verdict == "parabola predicts new readings better than line"
    parabola_score, line_score = found.scores.values()
    assert line_score.behind > 2 * line_score.behind_error > 0
    assert parabola_score.behind == parabola_score.behind_error == 0.0
    assert parabola_score.aic < line_score.aic and parabola_score.bic < line_score.bic
    assert parabola_score.aic_weight + line_score.aic_weight == pytest.approx(1.0)
    assert found.report().splitlines()[-1] == found.verdict


@pytest.mark.parametrize("name", DESIGNS)
def test_cross_validation_is_that_of_fits_without_each_reading(results, name):
    expected = left_out(DESIGNS[name])
    score = chosen(results, "line", "parabola").scores[name]
    # 8000 draws: importance weights leave a few hundredths.
    assert score.elpd == pytest.approx(np.sum(expected), abs=0.08)
    assert score.elpd_error == pytest.approx(np.sqrt(N * np.var(expected)), rel=0.1)
    # The density of readings that were fitted along, which looks better than it is, would be seen.
    fitted = DESIGNS[name] @ np.linalg.lstsq(DESIGNS[name], Y)[0]
    assert abs(score.elpd - np.sum(scipy.stats.norm.logpdf(Y, fitted, SIGMA))) > 0.5


def test_differences_are_taken_reading_by_reading(results):
    difference = left_out(DESIGNS["parabola"]) - left_out(DESIGNS["line"])
    score = chosen(results, "line", "parabola").scores["line"]
    assert score.behind == pytest.approx(np.sum(difference), abs=0.12)
    assert score.behind_error == pytest.approx(np.sqrt(N * np.var(difference)), rel=0.1)


def test_akaike_weights(results):
    found = chosen(results, "line", "parabola").scores
    aic = {
        name: 2 * design.shape[1]
        - 2 * np.sum(scipy.stats.norm.logpdf(Y, design @ np.linalg.lstsq(design, Y)[0], SIGMA))
        for name, design in DESIGNS.items()
    }
    for name, score in found.items():
        assert score.aic == pytest.approx(aic[name], rel=1e-8)
    odds = np.exp(-0.5 * (aic["line"] - aic["parabola"]))
    assert found["line"].aic_weight == pytest.approx(odds / (1 + odds), rel=1e-6)


def test_the_same_model_twice_cannot_be_told_apart(results):
    found = chosen(results, "parabola", "again")
    assert "cannot tell" in found.verdict and "prefer the simpler one" in found.verdict
    itself = compare_models({"one": results["parabola"], "two": results["parabola"]})
    assert "cannot tell one and two apart" in itself.verdict
    assert itself.scores["two"].behind == itself.scores["two"].behind_error == 0.0
    assert itself.scores["one"].aic_weight == pytest.approx(0.5)


@pytest.mark.parametrize("names", [("line", "parabola alone"), ("line alone", "parabola alone")])
def test_without_draws_by_akaike(results, names):
    found = chosen(results, *names)
    assert list(found.scores) == [names[1], names[0]]
    assert found.verdict.startswith("parabola alone is ahead by AIC (")
    assert found.scores["parabola alone"].elpd is None
    assert all(score.behind is None for score in found.scores.values())
    assert found.report().splitlines()[2].split()[-2:] == ["-", "-"]
    json.dumps(found.as_dict())


def test_a_reading_far_off_makes_cross_validation_doubtful(models, tmp_path):
    """One reading at the end of a long lever moves the fit so far that weights cannot follow."""
    x, y = X.copy(), Y.copy()
    x[-1], y[-1] = 60.0, 40.0
    asked = Problem(
        {"a": Parameter(0.0), "b": Parameter(0.0)}, {"data": Dataset(x, y, SIGMA)}, models.line
    )
    tree = sample(asked, seed=1, draws=16_000, ensembles=2)
    save_result(tmp_path / "lever.nc", fit(asked), None, with_predictions(asked, tree))
    saved = load_result(tmp_path / "lever.nc")
    found = compare_models({"one": saved, "two": saved})
    assert found.scores["one"].doubtful >= 1
    assert "doubtful for some readings" in found.report()


def test_doubtful_readings_are_not_seen_where_there_are_none(results):
    found = chosen(results, "line", "parabola")
    assert [score.doubtful for score in found.scores.values()] == [0, 0]
    assert "doubtful" not in found.report()


def test_refusals(models, results, tmp_path):
    with pytest.raises(InputError, match="at least two"):
        chosen(results, "line")
    save_result(tmp_path / "other.nc", fit(problem(models, "line", Y + 0.1)))
    other = load_result(tmp_path / "other.nc")
    with pytest.raises(InputError, match=r"line is of readings \w+, other of \w+: compare models"):
        compare_models({"line": results["line"], "other": other})


def test_models_of_the_same_readings_may_differ_in_their_noise(models, results, tmp_path):
    line = {"a": Parameter(0.0), "b": Parameter(0.0)}
    fitted = line | {"scatter": Parameter(0.5, bounds=(0.0, 5.0))}
    asked = Problem(fitted, {"data": Dataset(X, Y, "scatter")}, models.line)
    save_result(tmp_path / "fitted.nc", fit(asked))
    fitted_noise = load_result(tmp_path / "fitted.nc")
    found = compare_models({"given": results["line alone"], "fitted": fitted_noise})
    # The parabola's rest is scatter to the line: its greatest likelihood is the misfit itself.
    residuals = Y - DESIGNS["line"] @ np.linalg.lstsq(DESIGNS["line"], Y)[0]
    level = np.sqrt(np.mean(residuals**2))
    log_likelihood = scipy.stats.norm.logpdf(residuals, scale=level).sum()
    assert found.scores["fitted"].aic == pytest.approx(6.0 - 2.0 * log_likelihood, abs=1e-6)
    assert next(iter(found.scores)) == "fitted"
