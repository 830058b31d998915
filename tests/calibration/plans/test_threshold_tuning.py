"""Tuning by gradients: their truth, the hard cost they lead to, and honesty where it is no help."""

import dataclasses
import math

import jax
import numpy as np
import pytest

from calibration.chatter_cuts import CutScores
from calibration.plans.threshold_cost import Costs
from calibration.plans.threshold_tuning import (
    Setting,
    Softness,
    hard_cost,
    hard_scores,
    spectra,
    surrogate,
    tune_setting,
)
from procmodel.errors import InputError

EVEN = Costs(1.0, 1.0)
FREQUENCIES = 100.0 + 10.0 * np.arange(200)
LINE = 100  # bin of chatter, 1100 Hz


def cuts(seed, each=5, windows=30, chatter=4.0, trouble=0.0):
    """Exponential powers, as noise has; chatter in one bin, trouble of all cuts in twenty."""
    rng = np.random.default_rng(seed)
    found = []
    for label in ["stable"] * each + ["chatter"] * each:
        power = rng.exponential(1.0, (windows, len(FREQUENCIES))) * np.exp(0.2 * rng.normal())
        power[:, 150:170] += trouble * rng.exponential(1.0, (windows, 20)) * rng.lognormal(0.0, 0.5)
        if label == "chatter":
            power[:, LINE] += chatter * rng.exponential(1.0, windows) * np.exp(0.3 * rng.normal())
        distances = power - 1.0
        distances[:, 40] = np.nan
        name = f"cut {len(found) + 1}"
        scores = np.nanmax(distances, axis=1)
        found.append(CutScores(label, "A", 6000.0, scores, 0.1, 0.1, name, distances, FREQUENCIES))
    return found


@pytest.mark.parametrize("softness", [Softness(), Softness(2.0, 0.05, 0.25, 0.15)])
@pytest.mark.parametrize("m", [1.0, 3.4])
def test_gradients_are_those_of_differences(softness, m):
    data = spectra(cuts(0))
    vector = np.array([math.log(700.0), math.log(1500.0), m, math.log1p(4.0)])

    def value(v):
        return float(surrogate(v, data, Costs(3.0, 1.0), softness, 6))

    slope = np.asarray(jax.grad(surrogate)(vector, data, Costs(3.0, 1.0), softness, 6))
    for i, step in enumerate((1e-5, 1e-5, 1e-5, 1e-5)):
        move = step * np.eye(4)[i]
        expected = (value(vector + move) - value(vector - move)) / (2.0 * step)
        assert slope[i] == pytest.approx(expected, rel=2e-5, abs=1e-9)
        assert slope[i] != 0.0


def test_the_likeness_becomes_the_hard_cost_as_its_widths_shrink():
    some = cuts(1)
    data = spectra(some)
    # Judged from the window on from which the soft one is, which waits for six.
    later = [dataclasses.replace(c, distances=c.distances[3:], scores=c.scores[3:]) for c in some]
    setting = Setting(702.0, 1503.0, 3.0, 3.3)
    vector = np.array([math.log(702.0), math.log(1503.0), 3.0, math.log1p(3.3)])
    hard = hard_cost(later, EVEN, setting)
    assert 0.05 < hard < 0.5
    gaps = [
        abs(float(surrogate(vector, data, EVEN, Softness(*(np.array(Softness()) * k)), 6)) - hard)
        for k in (1.0, 0.1, 0.003)
    ]
    assert gaps[2] < 0.01 < gaps[0]


def test_hard_scores_are_largest_means_in_the_band():
    cut = cuts(2)[-1]
    found = hard_scores(cut, Setting(1000.0, 1200.0, 3.0, 0.0))
    inside = (FREQUENCIES >= 1000.0) & (FREQUENCIES <= 1200.0)
    for i in (0, 7):
        assert found[i] == pytest.approx(cut.distances[i : i + 3, inside].mean(axis=0).max())
    assert len(found) == 28
    # A bin that is left out is never the largest.
    assert np.isfinite(hard_scores(cut, Setting(400.0, 600.0, 1.0, 0.0))).all()


def test_weak_chatter_is_found_by_a_narrow_band_and_averaging():
    """A line of four times the noise, among 200 bins: cuts left out gain as well."""
    tuning = tune_setting(cuts(3), EVEN, (100.0, 2090.0), folds=3)
    assert tuning.helps and "tuning helps" in tuning.status
    assert tuning.chosen == tuning.tuned
    assert tuning.held_out_start > 0.25
    assert tuning.held_out_tuned < 0.1
    low, high, averaged, _ = tuning.tuned
    assert 900.0 < low < FREQUENCIES[LINE] < high < 1300.0
    assert averaged >= 3
    # What is reported is the hard cost itself, also on cuts that nobody has seen.
    assert tuning.cost_tuned == hard_cost(cuts(3), EVEN, tuning.tuned)
    assert hard_cost(cuts(30), EVEN, tuning.tuned) < 0.1
    assert hard_cost(cuts(30), EVEN, tuning.start) > 0.25
    assert tuning.as_dict()["tuned"]["averaged"] == averaged


def test_lines_of_the_machine_are_left_out_by_the_edges():
    tuning = tune_setting(cuts(4, chatter=8.0, trouble=8.0), EVEN, (100.0, 2090.0), folds=3)
    assert tuning.helps
    assert tuning.tuned.high < FREQUENCIES[150]


def test_where_nothing_can_be_gained_it_says_so():
    """Without any chatter in the cuts that are called so, in-sample gains mean nothing."""
    tuning = tune_setting(cuts(5, chatter=0.0), EVEN, (100.0, 2090.0), folds=3)
    assert tuning.cost_tuned <= tuning.cost_start
    assert not tuning.helps and "tuning does not help" in tuning.status
    assert tuning.chosen == tuning.start


def test_wrong_wishes_are_refused():
    some = cuts(6, each=2, windows=8)
    for changed, words in (
        ({"cuts": some[:3]}, "two cuts labelled chatter"),
        ({"costs": Costs(1.0, 1.0, per="cut")}, "costs of a window"),
        ({"averaged": 5}, "averaged spectra are 5, but must be 1 to 4"),
        ({"band": (5000.0, 6000.0)}, "the band 5000 to 6000 Hz holds no bin"),
        ({"cuts": [dataclasses.replace(c, distances=None) for c in some]}, "were not kept"),
    ):
        given = {"cuts": some, "costs": EVEN, "band": (100.0, 2090.0)} | changed
        with pytest.raises(InputError, match=words):
            tune_setting(**given)
    other = dataclasses.replace(some[1], frequencies=FREQUENCIES + 1.0)
    with pytest.raises(InputError, match="cut 2: its bins are not those of cut 1"):
        spectra([some[0], other])
