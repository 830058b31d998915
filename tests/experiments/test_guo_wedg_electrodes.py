"""The shaped micro-electrodes: key numbers, their independent sums, the command.

What is not a known answer is computed here again without the library: plain integrals, products
and draws.
"""

import json
import math

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from experiments.comparison import deviations
from experiments.guo_wedg_electrodes import gaps, run
from experiments.guo_wedg_electrodes.conditions import PAPER

SIGMA = 1 / math.sqrt(6)


@pytest.fixture(scope="module")
def results():
    return run.compute()


@pytest.fixture(scope="module")
def expected():
    return run.expected_numbers()


@pytest.fixture(scope="module")
def plain(results):
    """Posterior of the simulated gaps on a plain grid of mean and spread."""
    mean = np.linspace(8.0, 23.0, 601)[:, None]
    logs = np.linspace(math.log(0.3), math.log(20.0), 501)[None, :]
    scale = np.sqrt(np.exp(2 * logs) + SIGMA**2)
    density = sum(scipy.stats.norm.logpdf(g, mean, scale) for g in results.readings.gap)
    density = density + scipy.stats.norm.logpdf(mean, 20, 10)
    density = density + scipy.stats.norm.logpdf(logs, math.log(2.0), 1.0)
    weight = np.exp(density - density.max())
    return mean, np.exp(logs), weight / weight.sum()


def test_every_key_number_is_as_expected(results, expected):
    off = deviations(run.key_numbers(results), expected)
    assert {name: value for name, value in off.items() if value > 1} == {}
    assert set(off) == set(expected)


def test_a_gap_that_scatters_half_as_much_is_rejected(expected):
    low, high = 14.75 - 0.25 * 7.1, 14.75 + 0.25 * 7.1
    narrow = run.Conditions(lowest_gap=low, highest_gap=high)
    known = gaps.posterior(narrow)
    assert abs(float(known.spread_quantile(0.5)) - 2.35) > 10 * 0.01
    spread = (high - low) / narrow.range_constant
    assert abs(spread - expected["known: spread from the range"]["value"]) > 1


def test_the_simulated_gaps_have_the_papers_range_and_follow_its_law():
    several = np.array([gaps.simulated_gaps(PAPER, seed) for seed in range(300)])
    assert several.shape == (300, 10)
    assert np.all(several.min(axis=1) == 11.2) and np.all(several.max(axis=1) == 18.3)
    between = np.sort(several, axis=1)[:, 1:-1].ravel()
    spread = 7.1 / 3.0775
    cut = scipy.stats.truncnorm(-3.55 / spread, 3.55 / spread, 14.75, spread)
    assert scipy.stats.kstest(between, cut.cdf).pvalue > 1e-3
    assert scipy.stats.kstest(between, scipy.stats.uniform(11.2, 7.1).cdf).pvalue < 1e-6


def test_the_posterior_agrees_with_a_plain_grid(results, expected, plain):
    mean, spread, weight = plain
    assert np.sum(weight * mean) == pytest.approx(
        expected["simulated gaps: mean"]["value"], abs=0.007
    )
    middle = np.interp(0.5, np.cumsum(weight.sum(axis=0)), spread[0])
    assert middle == pytest.approx(expected["simulated gaps: spread"]["value"], abs=0.02)
    ends = expected["simulated gaps: next, 90 %"]["value"]
    for level, end in zip((0.05, 0.95), ends, strict=True):
        below = np.sum(weight * scipy.stats.norm.cdf(end, mean, spread))
        assert below == pytest.approx(level, abs=0.001)


def test_the_range_alone_agrees_with_extremes_that_are_drawn():
    # Importance of draws from the prior's middle: normal readings whose extremes come out near.
    rng = np.random.default_rng(0)
    mean, spread = rng.uniform(11.5, 18.0, 400_000), np.exp(rng.uniform(0.0, 1.9, 400_000))
    scale = np.sqrt(spread**2 + SIGMA**2)[:, None]
    drawn = mean[:, None] + scale * rng.normal(size=(400_000, 10))
    near = (abs(drawn.min(axis=1) - 11.2) < 0.3) & (abs(drawn.max(axis=1) - 18.3) < 0.3)
    prior = scipy.stats.norm.pdf(mean[near], 20, 10)
    prior *= scipy.stats.norm.pdf(np.log(spread[near]), math.log(2.0), 1.0)
    found = gaps.from_range(PAPER)
    assert near.sum() > 1000
    assert np.average(mean[near], weights=prior) == pytest.approx(found.mean_mean, abs=0.06)
    order = np.argsort(spread[near])
    shares = np.cumsum(prior[order]) / prior.sum()
    middle = spread[near][order][np.searchsorted(shares, 0.5)]
    assert middle == pytest.approx(found.spread_median, abs=0.06)


def test_the_chance_of_two_per_cent_is_that_of_plain_draws(results, expected, plain):
    mean, spread, weight = plain
    rng = np.random.default_rng(1)
    cell = rng.choice(weight.size, 400_000, p=weight.ravel())
    m = np.broadcast_to(mean, weight.shape).ravel()[cell]
    s = np.broadcast_to(spread, weight.shape).ravel()[cell]
    cosine = math.cos(math.atan(0.2))
    counted = [made.plan.counted_gap for made in results.ground]
    cone = np.abs(rng.normal(m, s) - counted[0]) < 0.6 * cosine
    pairs = rng.normal(m, s, (2, 2, 400_000)).mean(axis=1) - counted[1]
    square = np.all(np.abs(pairs) < 0.6 * cosine, axis=0)
    # The hollow leaves the drawing at an angle at both ends; the tip is the tighter one.
    chord, turn = math.hypot(20, 150), math.atan2(20, 150)
    slope = abs(turn - math.asin(0.5 * chord / 150))
    hollow = np.abs(rng.normal(m, s) - counted[2]) < 0.8 * math.cos(slope)
    for name, within in (("cone frustum", cone), ("square frustum", square), ("curved", hollow)):
        assert np.mean(within) == pytest.approx(expected[f"2 %: {name}"]["value"], abs=0.004)
    together = np.mean(cone & square & hollow)
    assert together == pytest.approx(expected["2 %: all three"]["value"], abs=0.0006)


def test_even_odds_need_a_gap_four_times_steadier(expected):
    spread = expected["2 %: spread for even odds"]["value"]
    cosine = math.cos(math.atan(0.2))
    slope = abs(math.atan2(20, 150) - math.asin(0.5 * math.hypot(20, 150) / 150))
    z = np.array([0.6 * cosine, *[0.6 * cosine * math.sqrt(2)] * 2, 0.8 * math.cos(slope)]) / spread
    assert np.prod(2 * scipy.stats.norm.cdf(z) - 1) == pytest.approx(0.5, abs=0.002)
    assert expected["known: spread from the range"]["value"] > 4 * spread


def test_the_first_error_of_the_learning_follows_from_the_prior(expected):
    z = (20.0 - 14.75) / (7.1 / 3.0775)
    normal = scipy.stats.norm
    error = 2 * 7.1 / 3.0775 * (z * (2 * normal.cdf(z) - 1) + 2 * normal.pdf(z))
    first = expected["learning: error after 0, 2, 10 electrodes"]["value"][0]
    assert error == pytest.approx(first, abs=0.01)


def test_the_budget_is_the_gap(results):
    total = sum(cause.std**2 for cause in results.budget)
    assert sum(cause.std**2 for cause in results.budget[:2]) / total > 0.98
    assert [cause.std for cause in results.budget] == sorted(
        (cause.std for cause in results.budget), reverse=True
    )
    assert "gap: scatter" in run.budget_table(results)


def test_depths_follow_from_the_wear_ratios_range(results):
    plan = results.linked.plans["another, both blind"]
    area, nominal = np.asarray(plan.layers.area), PAPER.blind_area
    rng = np.random.default_rng(2)
    mean, spread = results.posterior.draws(400_000, seed=9)
    gaps_of_both = rng.normal(mean, spread, (2, 400_000))
    first, second = 100 + 2 * (results.posterior.mean.mean - gaps_of_both)
    # A plan looks at 33 equally likely wear ratios.
    ratio = np.quantile(0.17 * (first / second) ** 2, (np.arange(33) + 0.5) / 33)[:, None]
    depth = np.sum((nominal + 0.17 * area) / (nominal + ratio * area), axis=1)
    ends = np.quantile(depth, [0.025, 0.975], method="hazen")
    # The tails of 4000 draws of the plan are known to some per cent.
    assert plan.depth_spread[-1] == pytest.approx(0.5 * (ends[1] - ends[0]), rel=0.08)


@pytest.mark.slow
def test_the_command_writes_tables_numbers_and_pictures(results, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "compute", lambda: results)
    assert run.main(["--out", str(tmp_path / "new")]) == 0
    printed = capsys.readouterr().out
    assert "known: spread" in printed and "OFF" not in printed and "cause of error" in printed
    written = json.loads((tmp_path / "new" / "results.json").read_text(encoding="utf-8"))
    assert written["key_numbers"]["budget"]["as_expected"] is True
    assert len(written["simulated_gaps"]) == 10
    pictures = sorted((tmp_path / "new").glob("*.png"))
    assert len(pictures) == 3
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures)


def test_the_command_fails_when_a_number_is_off(results, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(run, "compute", lambda: results)
    monkeypatch.setattr("experiments.guo_wedg_electrodes.figures.draw_all", lambda *_: [])
    entries = run.expected_numbers()
    entries["known: spread from the range"]["value"] += 1.0
    monkeypatch.setattr(run, "expected_numbers", lambda: entries)
    assert run.main(["--out", str(tmp_path)]) == 1
    assert "OFF" in capsys.readouterr().out
