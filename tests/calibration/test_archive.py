"""Results in files: what was written is read back, elsewhere and without the model."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest
import scipy.stats
import xarray

from calibration import (
    Dataset,
    Parameter,
    Problem,
    fit,
    load_result,
    profile,
    sample,
    save_result,
    with_predictions,
)
from calibration.archive import information
from procmodel.errors import InputError

N = 12
X = np.linspace(0.0, 4.0, N)
Y = 1.0 + 0.5 * X + 0.3 * np.random.default_rng(0).normal(size=N)
DESIGN = np.stack([np.ones(N), X], axis=1)


def problem(models, sigma=0.3, y=Y):
    parameters = {"a": Parameter(0.0, "um"), "b": Parameter(0.0)}
    return Problem(parameters, {"data": Dataset(X, y, sigma)}, models.line)


@pytest.fixture(scope="module")
def parts(models):
    """Fit, profile and draws of a line."""
    result = fit(problem(models))
    tree = sample(problem(models), seed=1, draws=36_000, ensembles=2, start=result)
    return result, profile(result), with_predictions(problem(models), tree, draws=100)


@pytest.fixture(scope="module")
def saved(parts, tmp_path_factory):
    path = tmp_path_factory.mktemp("archive") / "line.nc"
    save_result(path, *parts)
    return path


READS = """
import sys
from calibration.archive import load_result
saved = load_result(sys.argv[1])
assert not any(name.startswith("tests") for name in sys.modules)
b = saved.tree["posterior"]["b"].values
print(repr([saved.fit["parameters"]["b"]["value"], b.sum(), saved.information["aic"],
            saved.intervals.rows["b"].profile.low, saved.has_draws]))
print(saved.report())
"""


def test_round_trip_in_another_process_without_the_model(saved, parts, tmp_path):
    result, curves, tree = parts
    # Outside the repository there is no `tests` to import the model from.
    done = subprocess.run(
        [sys.executable, "-c", READS, str(saved)],
        cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    first, report = done.stdout.split("\n", 1)
    value, total, aic, low, has_draws = eval(first.replace("np.float64", "float"))
    assert value == result.parameters["b"].value
    assert total == float(tree["posterior"]["b"].values.sum())
    assert aic == information(result)["aic"]
    assert low == curves.parameters["b"].low.value
    assert has_draws is True
    assert report.strip() == load_result(saved).report().strip()


def test_everything_is_in_the_file(saved, parts):
    result, _, tree = parts
    loaded = load_result(saved)
    assert loaded.fit == json.loads(json.dumps(result.as_dict()))
    for group in ("posterior", "sample_stats", "observed_data", "posterior_predictive",
                  "predictions_mean", "log_likelihood"):  # fmt: skip
        for name in tree[group].dataset:
            np.testing.assert_array_equal(loaded.tree[group][name], tree[group][name])
    np.testing.assert_array_equal(loaded.tree["residuals"]["data"], result.residuals["data"])
    np.testing.assert_array_equal(loaded.tree["fit"]["covariance"], result.covariance)
    assert list(loaded.tree["fit"]["unit"].values) == ["um", ""]
    for name in ("data_hash", "sampler", "seed", "status", "converged"):
        assert loaded.tree.attrs[name] == tree.attrs[name]
    assert loaded.tree.attrs["data_hash"] == result.problem.data_hash


def test_report_has_three_intervals_and_verdicts(saved):
    text = load_result(saved).report()
    words = [
        "Wald",
        "profile",
        "posterior",
        "verdict",
        "identified",
        "AIC",
        "BIC",
        "log-likelihood",
        "stretch",
    ]
    for word in (*words, "converged: ", "seed 1", "written by procmodel"):
        assert word in text, word
    assert "not asked for" not in text
    row = next(line for line in text.splitlines() if line.strip().startswith("b ") and "to" in line)
    assert row.count(" to ") == 3
    # The three by the closed form, where they are the same.
    covariance = 0.3**2 * np.linalg.inv(DESIGN.T @ DESIGN)
    best, std = np.linalg.lstsq(DESIGN, Y)[0][1], math.sqrt(covariance[1, 1])
    intervals = load_result(saved).intervals.rows["b"].intervals
    assert set(intervals) == {"Wald", "profile", "posterior"}
    for method, interval in intervals.items():
        # A quantile of 36,000 draws of twenty steps each errs by 0.06 deviations.
        within = 0.25 * std if method == "posterior" else 1e-3 * std
        assert interval.low == pytest.approx(best - 1.959964 * std, abs=within), method
        assert interval.high == pytest.approx(best + 1.959964 * std, abs=within), method


def test_a_fit_alone(parts, tmp_path):
    save_result(tmp_path / "fit.nc", parts[0])
    loaded = load_result(tmp_path / "fit.nc")
    assert not loaded.has_draws
    assert "profile: not asked for" in loaded.report()
    assert loaded.intervals.rows["b"].posterior.missing
    assert [p.name for p in tmp_path.iterdir()] == ["fit.nc"]


def test_a_result_is_replaced_as_a_whole(parts, tmp_path):
    path = tmp_path / "fit.nc"
    save_result(path, *parts)
    save_result(path, parts[0])
    assert not load_result(path).has_draws


def test_a_failing_write_leaves_nothing_or_what_was_there(parts, tmp_path, monkeypatch):
    path = tmp_path / "fit.nc"

    def half(self, draft, **_):
        draft.write_bytes(b"half a file")
        raise OSError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr(xarray.DataTree, "to_netcdf", half)
        with pytest.raises(OSError, match="no space left"):
            save_result(path, parts[0])
        assert list(tmp_path.iterdir()) == []
    save_result(path, parts[0])
    before = path.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(xarray.DataTree, "to_netcdf", half)
        with pytest.raises(OSError, match="no space left"):
            save_result(path, *parts)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["fit.nc"]


def test_refused_to_write(models, parts, tmp_path):
    with pytest.raises(InputError, match=r"fit\.json: a result ends in \.nc"):
        save_result(tmp_path / "fit.json", parts[0])
    with pytest.raises(InputError, match="nowhere"):
        save_result(tmp_path / "nowhere" / "fit.nc", parts[0])
    other = fit(problem(models, y=Y + 0.1))
    with pytest.raises(InputError, match="the profile is of data"):
        save_result(tmp_path / "fit.nc", other, parts[1])
    with pytest.raises(InputError, match="the posterior is of data"):
        save_result(tmp_path / "fit.nc", other, None, parts[2])
    assert list(tmp_path.iterdir()) == []


def not_ours(path):
    xarray.Dataset({"v": ("n", np.arange(3.0))}).to_netcdf(path, engine="h5netcdf")


def of_another_version(path):
    tree = xarray.DataTree()
    tree.attrs = {"format": "procmodel result 99"}
    tree.to_netcdf(path, engine="h5netcdf")


def damaged(path):
    tree = xarray.DataTree()
    tree.attrs = {"format": "procmodel result 1", "fit": "{}", "intervals": "{}",
                  "information": "{}"}  # fmt: skip
    tree.to_netcdf(path, engine="h5netcdf")


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (lambda path: None, "there is no such file"),
        (lambda path: path.mkdir(), "there is no such file"),
        (lambda path: path.write_text("value, std\n1, 2\n"), "is not a result of this library"),
        (lambda path: path.write_bytes(b""), "is not a result of this library"),
        (not_ours, "is not a result of this library"),
        (of_another_version, "read it with the version that wrote it"),
        (damaged, "is not a result of this library"),
    ],
)
def test_refused_to_read(tmp_path, write, words):
    path = tmp_path / "other.nc"
    write(path)
    with pytest.raises(InputError, match=words) as refused:
        load_result(path)
    assert "other.nc" in str(refused.value) and "\n" not in str(refused.value)


def test_a_truncated_result_is_refused(saved, tmp_path):
    path = tmp_path / "cut.nc"
    path.write_bytes(saved.read_bytes()[:2000])
    with pytest.raises(InputError, match="is not a result of this library"):
        load_result(path)


def criteria(log_likelihood, count, readings):
    return {
        "log_likelihood": log_likelihood,
        "parameters": count,
        "readings": readings,
        "aic": 2 * count - 2 * log_likelihood,
        "aicc": 2 * count - 2 * log_likelihood + 2 * count * (count + 1) / (readings - count - 1),
        "bic": count * math.log(readings) - 2 * log_likelihood,
    }


def test_criteria_with_known_and_estimated_noise(models, parts):
    residuals = Y - DESIGN @ np.linalg.lstsq(DESIGN, Y)[0]
    known = float(np.sum(scipy.stats.norm.logpdf(residuals, scale=0.3)))
    assert information(parts[0]) == pytest.approx(criteria(known, 2, N), rel=1e-9)
    # The noise of greatest likelihood divides by n, and counts as a parameter.
    level = math.sqrt(np.mean(residuals**2))
    estimated = float(np.sum(scipy.stats.norm.logpdf(residuals, scale=level)))
    found = information(fit(problem(models, None)))
    assert found == pytest.approx(criteria(estimated, 3, N), rel=1e-9)


def test_criteria_that_need_more_readings_are_left_out(models):
    few = Problem(
        {"a": Parameter(0.0), "b": Parameter(0.0)},
        {"data": Dataset(X[:3], Y[:3], 0.3)},
        models.line,
    )
    found = information(fit(few))
    assert found["aicc"] is None and math.isfinite(found["aic"])
