"""The exact posterior of the gap: closed forms, independent integrals, updates, calibration."""

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from calibration import sample
from calibration.electrode import GapData, GapPrior, gap_problem, measured_std
from calibration.electrode_gap import GapPosterior, NormalMixture, fit_gap
from calibration.ranks import uniformity
from procmodel.errors import InputError

HOLE_SIGMA = measured_std(1.0) / math.sqrt(2.0)
# Wide enough not to matter: the mean flat, the spread as 1 / spread.
OPEN = GapPrior(mean=15.0, mean_std=1e6, spread=2.0, spread_log_std=8.0)


def readings(count=10, seed=7):
    gaps = np.random.default_rng(seed).normal(14.75, 2.3, count)
    return GapData(gaps, HOLE_SIGMA)


def test_without_measuring_error_and_prior_it_is_students_t():
    data = readings()
    exact = GapData(data.gap, 1e-9)
    found = fit_gap(exact, OPEN)
    mean, std = np.mean(data.gap), np.std(data.gap, ddof=1)
    ahead = scipy.stats.t(9, mean, std * math.sqrt(1 + 1 / 10))
    of_mean = scipy.stats.t(9, mean, std / math.sqrt(10))
    np.testing.assert_allclose(found.next_gap().interval(0.9), ahead.interval(0.9), rtol=1e-4)
    np.testing.assert_allclose(found.mean.interval(0.95), of_mean.interval(0.95), rtol=1e-4)
    # The spread's square over 9 s^2 is one over a chi-square.
    level = np.array([0.05, 0.5, 0.95])
    spread = std * np.sqrt(9 / scipy.stats.chi2.ppf(1 - level, 9))
    np.testing.assert_allclose(found.spread_quantile(level), spread, rtol=2e-3)


def test_moments_agree_with_an_integral_over_both_unknowns():
    data = readings(6).joined(GapData([12.0, 16.0], 0.3, 2))
    prior = GapPrior()

    def density(log_spread, mean):
        scale = np.sqrt(data.sigma**2 + math.exp(2 * log_spread) / data.passes)
        off = (data.gap - mean) / scale
        logs = -0.5 * np.sum(off**2) - np.sum(np.log(scale)) - 0.5 * ((mean - 20) / 10) ** 2
        return math.exp(logs - 0.5 * (log_spread - math.log(prior.spread)) ** 2)

    def integral(of):
        return scipy.integrate.dblquad(
            lambda u, m: of(u, m) * density(u, m), 5.0, 25.0, -3.0, 4.0, epsabs=1e-12, epsrel=1e-8
        )[0]

    whole = integral(lambda u, m: 1.0)
    found = fit_gap(data)
    assert found.mean.mean == pytest.approx(integral(lambda u, m: m) / whole, rel=1e-6)
    variance = integral(lambda u, m: math.exp(2 * u)) / whole
    assert float(found.weight @ found.spread**2) == pytest.approx(variance, rel=1e-5)


def test_one_by_one_is_all_at_once():
    data = readings().joined(GapData([13.5], 0.2, 2))
    step = GapPosterior.before()
    for gap, sigma, passes in zip(data.gap, data.sigma, data.passes, strict=True):
        step = step.updated(GapData([gap], sigma, passes))
    whole = fit_gap(data)
    np.testing.assert_allclose(step.weight, whole.weight, rtol=1e-8, atol=1e-15)
    np.testing.assert_allclose(step.centre, whole.centre, rtol=1e-10)
    np.testing.assert_allclose(step.std, whole.std, rtol=1e-10)
    assert step.readings == whole.readings == 11


def test_after_updates_it_is_the_engines_posterior_of_all_data():
    holes = readings(5)
    electrodes = GapData.from_electrodes([165.0, 165.4], [100.9, 95.0], 100.0)
    found = fit_gap(holes)
    for i in range(2):
        found = found.updated(GapData(electrodes.gap[i : i + 1], electrodes.sigma[i]))
    tree = sample(gap_problem(holes.joined(electrodes)), seed=1, draws=48_000)
    assert tree.attrs["converged"], tree.attrs["status"]
    error = 4.0 / math.sqrt(tree.attrs["ess_bulk"])
    for name, middle in (
        ("gap_mean", found.mean.quantile(0.5)),
        ("gap_spread", found.spread_quantile(0.5)),
    ):
        draws = np.asarray(tree["posterior"][name]).ravel()
        assert np.mean(draws < middle) == pytest.approx(0.5, abs=0.5 * error)
    assert found.mean.mean == pytest.approx(
        float(tree["posterior"]["gap_mean"].mean()), abs=error * found.mean.deviation
    )


def test_more_readings_narrow_the_mean_but_not_the_gap_to_come():
    found = fit_gap(GapData(np.random.default_rng(0).normal(15.0, 2.0, 900), 0.1))
    assert found.mean.deviation == pytest.approx(2.0 / 30, rel=0.06)
    assert found.next_gap().deviation == pytest.approx(2.0, rel=0.08)


def test_a_gap_over_two_passes_scatters_less_and_a_reading_more():
    found = fit_gap(readings())
    one, two = found.next_gap().deviation ** 2, found.next_gap(2).deviation ** 2
    square = float(found.weight @ found.spread**2)
    assert one - two == pytest.approx(0.5 * square, rel=1e-12)
    assert found.next_gap(1, 0.3).deviation ** 2 - one == pytest.approx(0.09, rel=1e-10)
    with pytest.raises(InputError, match="passes is 0"):
        found.next_gap(0)


def test_mixture_of_one_part_is_the_normal_distribution():
    mixture = NormalMixture(np.ones(1), np.array([3.0]), np.array([2.0]))
    normal = scipy.stats.norm(3.0, 2.0)
    level = np.array([1e-6, 0.05, 0.5, 0.9])
    np.testing.assert_allclose(mixture.quantile(level), normal.ppf(level), rtol=1e-10)
    np.testing.assert_allclose(mixture.density(level), normal.pdf(level), rtol=1e-12)
    np.testing.assert_allclose(mixture.below([1.0, 4.0]), normal.cdf([1.0, 4.0]), rtol=1e-12)


def test_draws_follow_their_distributions():
    found = fit_gap(readings())
    mean, spread = found.draws(4000, seed=1)
    assert scipy.stats.kstest(mean, found.mean.below).pvalue > 1e-3
    assert scipy.stats.kstest(spread, found.spread_below).pvalue > 1e-3
    ahead = found.next_gap().draws(4000, np.random.default_rng(2))
    assert scipy.stats.kstest(ahead, found.next_gap().below).pvalue > 1e-3
    # And not another's.
    assert scipy.stats.kstest(mean, found.next_gap().below).pvalue < 1e-6
    tree = found.as_tree(100)
    assert tree["posterior"]["gap_mean"].shape == (4, 100)
    assert tree["posterior"]["gap_spread"].attrs["unit"] == "um"


def test_gaps_hit_together_more_often_than_by_the_product():
    found = fit_gap(readings(3))
    one = found.chance([(13.0, 17.0, 1)])
    assert one == pytest.approx(float(np.diff(found.next_gap().below([13.0, 17.0]))[0]), rel=1e-6)
    both = found.chance([(13.0, 17.0, 1), (13.0, 17.0, 1)])
    mean, spread = found.draws(200_000)
    each = scipy.stats.norm.cdf((17 - mean) / spread) - scipy.stats.norm.cdf((13 - mean) / spread)
    assert both == pytest.approx(float(np.mean(each**2)), abs=4 * float(np.std(each**2)) / 447)
    assert both > one**2
    assert found.chance([(17.0, 13.0, 1)]) == 0.0


def ranks(repeats, told_sigma, error, seed):
    """Where the truth lies in the posterior: mean, spread, next gap; errors truly uniform."""
    rng, prior = np.random.default_rng(seed), GapPrior(mean=40.0, mean_std=5.0)
    found = np.empty((repeats, 3))
    for row in found:
        mean = rng.normal(prior.mean, prior.mean_std)
        spread = prior.spread * math.exp(prior.spread_log_std * rng.normal())
        errors = rng.uniform(-error, error, (2, 10))
        gaps = np.abs(rng.normal(mean, spread, 10) + 0.5 * (errors[0] - errors[1]))
        posterior = fit_gap(GapData(gaps, told_sigma), prior)
        ahead = rng.normal(mean, spread)
        row[:] = (
            posterior.mean.below(mean),
            posterior.spread_below(spread),
            posterior.next_gap().below(ahead),
        )
    return found


def test_the_posterior_is_calibrated_and_its_intervals_cover():
    found = ranks(800, HOLE_SIGMA, 1.0, seed=0)
    for column in found.T:
        assert uniformity((1000 * column).astype(int).clip(0, 999), 999) > 0.01 / 3
    # 90 +- 3 %, the standard error of 800 repeats being 1.1 %.
    assert np.all(np.abs(np.mean(np.abs(found - 0.5) < 0.45, axis=0) - 0.9) < 0.03)


def test_ignoring_the_measuring_error_is_found_out():
    found = ranks(800, 1e-3, 1.0, seed=0)
    assert uniformity((1000 * found[:, 1]).astype(int).clip(0, 999), 999) < 0.001
    assert np.mean(np.abs(found[:, 1] - 0.5) < 0.45) < 0.87


@pytest.mark.parametrize("count", [3, 10])
def test_intervals_of_the_next_gap_cover_for_the_papers_scatter_too(count):
    rng, covered = np.random.default_rng(count), []
    for _ in range(600):
        errors = rng.uniform(-1.0, 1.0, (2, count))
        gaps = rng.normal(14.75, 2.3, count) + 0.5 * (errors[0] - errors[1])
        low, high = fit_gap(GapData(np.abs(gaps), HOLE_SIGMA)).next_gap().interval(0.9)
        covered.append(np.diff(scipy.stats.norm.cdf([low, high], 14.75, 2.3))[0])
    assert np.mean(covered) == pytest.approx(0.9, abs=0.03)


def test_taking_the_estimate_for_the_truth_does_not_cover():
    rng, covered = np.random.default_rng(3), []
    for _ in range(600):
        gaps = rng.normal(14.75, 2.3, 3)
        ends = np.mean(gaps) + np.array([-1.645, 1.645]) * np.std(gaps, ddof=1)
        covered.append(np.diff(scipy.stats.norm.cdf(ends, 14.75, 2.3))[0])
    assert np.mean(covered) < 0.8
