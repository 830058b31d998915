"""Rules of votes: against simulated windows, against binomials, at their limits."""

import itertools

import numpy as np
import pytest
import scipy.integrate
import scipy.stats

from calibration.plans.alarm_rule import (
    AlarmRule,
    alarm_rate,
    alarms_in_cut,
    exceedance,
    first_alarm,
    windows_within,
)
from procmodel.errors import InputError
from tests.calibration import labelled_cuts as shapes

RULES = (AlarmRule(1, 1), AlarmRule(2, 5), AlarmRule(3, 5))


def spoken(rule, exceeded):
    """The rule over rows of windows, by counting."""
    said = np.zeros(exceeded.shape, bool)
    for i in range(exceeded.shape[1]):
        said[:, i] = exceeded[:, max(0, i - rule.of + 1) : i + 1].sum(axis=1) >= rule.votes
    return said


def simulated(correlation, threshold, count=60, cuts=4000):
    rng = np.random.default_rng(0)
    truth = shapes.Truth(spread=1.0, freedom=5.0, correlation=correlation)
    burnt = [shapes.windows(rng, 0.0, truth, count + 20)[20:] for _ in range(cuts)]
    return np.array(burnt) > threshold


@pytest.mark.parametrize(("correlation", "threshold"), [(0.0, 1.5), (0.4, 1.0), (0.4, 2.0)])
@pytest.mark.parametrize("rule", RULES, ids=str)
def test_rates_and_delays_are_those_of_simulated_windows(rule, correlation, threshold):
    exceeded = simulated(correlation, threshold)
    p, r = exceedance(threshold, 0.0, 1.0, 5.0, correlation)
    said = spoken(rule, exceeded)
    begun = said & ~np.concatenate([np.zeros((len(said), 1), bool), said[:, :-1]], axis=1)
    expected = begun.sum(axis=1)
    error = expected.std() / np.sqrt(len(said))
    # The chain remembers one window only: true to about a seventh at such correlations.
    found = alarms_in_cut(rule, p, r, said.shape[1])
    assert found == pytest.approx(expected.mean(), abs=4.0 * error + 0.15 * expected.mean())
    by = np.maximum.accumulate(said, axis=1).mean(axis=0)
    np.testing.assert_allclose(first_alarm(rule, p, r, said.shape[1]), by, atol=0.06)


def test_windows_that_do_not_follow_each_other_are_binomial():
    p, rule = np.array([0.01, 0.2, 0.6]), AlarmRule(2, 5)
    # The rule is silent before and speaks now: one of four middle windows, not the oldest, and now.
    expected = (1.0 - p) * scipy.stats.binom.pmf(1, 4, p) * p
    np.testing.assert_allclose(alarm_rate(rule, p, p), expected, rtol=1e-12)
    early = first_alarm(rule, p, p, 5)
    for windows in range(1, 6):
        np.testing.assert_allclose(
            early[:, windows - 1], scipy.stats.binom.sf(1, windows, p), atol=1e-12
        )
    # One alarm or none in the first five, then the rate.
    few = scipy.stats.binom.sf(1, 5, p) + 7 * expected
    np.testing.assert_allclose(alarms_in_cut(rule, p, p, 12), few, rtol=1e-12)


def test_all_histories_of_a_short_cut_add_up():
    """Every sequence of seven windows by itself, weighted by the chain."""
    p, r, rule = 0.3, 0.55, AlarmRule(2, 3)
    into = p * (1.0 - r) / (1.0 - p)
    by, alarms = np.zeros(7), 0.0
    for sequence in itertools.product((0, 1), repeat=7):
        weight = p if sequence[0] else 1.0 - p
        for before, now in itertools.pairwise(sequence):
            up = r if before else into
            weight *= up if now else 1.0 - up
        said = rule.spoken(np.array(sequence, bool))
        by += weight * np.maximum.accumulate(said)
        alarms += weight * np.count_nonzero(np.diff(said, prepend=False) & said)
    np.testing.assert_allclose(first_alarm(rule, np.array(p), np.array(r), 7), by, rtol=1e-12)
    assert alarms_in_cut(rule, np.array(p), np.array(r), 7) == pytest.approx(alarms, rel=1e-12)


@pytest.mark.parametrize("far", [-3.0, 0.0, 2.0, 6.0])
@pytest.mark.parametrize(("freedom", "correlation"), [(3.0, 0.5), (8.0, -0.3), (30.0, 0.2)])
def test_two_windows_together_by_quadrature(far, freedom, correlation):
    law = scipy.stats.t(freedom)
    share = np.sqrt(1.0 - correlation**2)

    def both(z):
        return law.pdf(z) * law.sf((far - correlation * z) / share)

    ends = ((far, far + 5.0), (far + 5.0, far + 50.0), (far + 50.0, np.inf))
    expected = sum(scipy.integrate.quad(both, *e, epsabs=0.0, limit=200)[0] for e in ends)
    p, r = exceedance(2.0 + 0.5 * far, 2.0, 0.5, freedom, correlation)
    assert p == pytest.approx(law.sf(far), rel=1e-9)
    assert r == pytest.approx(expected / law.sf(far), rel=0.02)


def test_rules_count_from_the_first_window_of_a_cut():
    said = AlarmRule(2, 3).spoken(np.array([1, 0, 0, 1, 1, 0, 0, 0], bool))
    np.testing.assert_array_equal(said, np.array([0, 0, 0, 0, 1, 1, 0, 0], bool))
    assert windows_within(1.0, 0.1, 0.2) == 9
    assert windows_within(0.1, 0.1, 0.2) == 1


@pytest.mark.parametrize("rule", [(0, 5), (3, 2), (1, 11)])
def test_impossible_rules_are_refused(rule):
    with pytest.raises(InputError, match=f"the rule takes {rule[0]} of {rule[1]} windows"):
        AlarmRule(*rule)
