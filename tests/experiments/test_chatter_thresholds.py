"""Cuts of known truth, and what is made of their tallies."""

import math

import numpy as np
import pytest

from calibration.plans.threshold_check import Tally
from experiments.chatter_thresholds import cuts, run
from experiments.comparison import read_expected


def tally(alarms, hours, detected, chatter):
    return Tally(10, 0, chatter, detected, 0, alarms, hours, (0.1,) * detected, 0.99)


class Stated:
    """A plan of which only the stated rate is asked."""

    class false_alarms_per_hour:
        value = 100.0


def results(tallies):
    return run.Results([], {400.0: Stated()}, {}, tallies, {})


@pytest.mark.slow
def test_labels_follow_the_depth_and_scores_rise_with_it():
    found = [cuts.scored(cuts.LEARNT, share, cuts.SPEEDS[0], 1.0, 3) for share in (0.5, 1.0, 1.5)]
    assert [cut.label for cut in found] == ["stable", "marginal", "chatter"]
    middle = [np.median(cut.scores) for cut in found]
    assert middle[0] < middle[1] < middle[2]
    assert all(20 <= len(cut.scores) <= 30 for cut in found)
    again = cuts.scored(cuts.LEARNT, 0.5, cuts.SPEEDS[0], 1.0, 3)
    np.testing.assert_array_equal(again.scores, found[0].scores)
    other = cuts.scored(cuts.LEARNT, 0.5, cuts.SPEEDS[0], 1.0, 4)
    assert not np.array_equal(other.scores, found[0].scores)


def test_shares_lie_on_their_sides_of_the_limit():
    found = cuts.shares(30, 5, 20, seed=1)
    assert found[:30].max() < 0.9 and found[35:].min() > 1.1
    assert np.all(np.abs(found[30:35] - 1.0) <= 0.02)


def test_rates_are_compared_by_their_logarithm():
    numbers = run.key_numbers(results({("a second mode", 400.0): tally(8, 0.02, 9, 10)}))
    assert numbers["a second mode: false alarms at 400 an hour"] == pytest.approx(2.0)
    assert numbers["a second mode: chatter found at 400 an hour"] == 0.9
    assert set(numbers) <= set(read_expected(run.HERE))
    assert run.broken(numbers)


def test_no_alarm_counts_as_half_of_one():
    numbers = run.key_numbers(results({("all three", 400.0): tally(0, 0.02, 10, 10)}))
    assert numbers["all three: false alarms at 400 an hour"] == pytest.approx(math.log2(0.25))
    assert not run.broken(numbers)
