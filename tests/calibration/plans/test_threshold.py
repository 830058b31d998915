"""Thresholds of least cost, what is predicted of them, and cuts that were left out."""

import dataclasses

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from calibration.chatter_scores import fit_scores
from calibration.plans.alarm_rule import AlarmRule
from calibration.plans.threshold import plan_threshold
from calibration.plans.threshold_check import check_threshold, dealt, tallied
from calibration.plans.threshold_cost import Choice, Costs, chosen_threshold
from calibration.plans.window_law import window_law
from procmodel.errors import InputError
from tests.calibration import labelled_cuts as shapes

TRUTH = shapes.Truth(2.0, 1.2, 0.4, 0.2, 8.0, 0.3)
COSTS = Costs(3.0, 1.0)


def workshop(seed, shift=0.0):
    """Twelve cuts of tool A, and three of tool B, whose scores are higher by a factor."""
    rng = np.random.default_rng(seed)
    old = shapes.cuts(rng, 6, 6, count=24, truth=TRUTH)
    new = [
        shapes.cut(rng, label, TRUTH, 24, "B", shift=shift, name=f"new {label}")
        for label in ("stable", "stable", "chatter")
    ]
    return [*old, *new]


@pytest.fixture(scope="module")
def posterior():
    return fit_scores(workshop(1, 0.5), seed=1)


def test_the_threshold_is_where_an_alarm_begins_to_pay(posterior):
    """P(chatter | D) there is C_false / (C_false + C_miss), and no other threshold costs less."""
    plan = plan_threshold(posterior, COSTS, tool="A")
    assert COSTS.probability == 0.25
    assert plan.choice.chatter_probability(plan.threshold.value) == pytest.approx(0.25, abs=0.02)
    scores = np.linspace(0.1, 200.0, 500)
    probability = plan.choice.chatter_probability(scores)
    assert (np.diff(probability) >= 0.0).all()
    assert probability[0] < 0.1 and probability[-1] > 0.9
    law = {label: window_law(posterior, label, "A") for label in ("stable", "chatter")}

    def cost(y):
        above = {label: each.above(np.array([y])).mean() for label, each in law.items()}
        return 0.5 * (1.0 * above["stable"] + 3.0 * (1.0 - above["chatter"]))

    best = scipy.optimize.minimize_scalar(cost, (2.0, 2.5, 3.0)).fun
    assert cost(np.log1p(plan.threshold.value)) == pytest.approx(best, rel=1e-3)
    assert plan.cost == pytest.approx(best, rel=1e-3)
    low, high = plan.threshold.interval90
    assert low < plan.threshold.value < high


def test_the_law_of_windows_is_that_of_simulated_cuts(posterior):
    """Against windows drawn from every draw of the posterior, cut by cut."""
    rng = np.random.default_rng(0)
    law = window_law(posterior, "stable", "A")
    size = len(law.level)
    picked = np.unique(np.linspace(0, len(posterior.levels) - 1, size).round().astype(int))
    level = posterior.level("stable", "A", 12000.0)[picked][:, None]
    tau = posterior.draws("stable_cut_spread")[picked][:, None]
    v = level + tau * rng.normal(size=(size, 400))
    noise = rng.standard_t(np.broadcast_to(law.freedom, v.shape))
    y = v + law.spread * noise
    grid = np.quantile(y, [0.1, 0.5, 0.9, 0.99])
    np.testing.assert_allclose(
        law.above(grid).mean(axis=0), [np.mean(y > g) for g in grid], atol=0.006
    )
    width = 0.05
    near = [np.mean(np.abs(y - g) < width) / (2.0 * width) for g in grid]
    np.testing.assert_allclose(law.density(grid), near, rtol=0.1, atol=0.01)


def test_costs_move_the_threshold_the_right_way(posterior):
    dear_miss, even, dear_alarm = (
        chosen_threshold(posterior, Costs(*costs), tool="A").threshold
        for costs in ((20.0, 1.0), (1.0, 1.0), (1.0, 20.0))
    )
    assert dear_miss < even < dear_alarm
    rare = chosen_threshold(posterior, Costs(1.0, 1.0, 0.05), tool="A").threshold
    assert rare > even
    of_cut = chosen_threshold(posterior, Costs(3.0, 1.0, per="cut"), tool="A").threshold
    assert of_cut > chosen_threshold(posterior, COSTS, tool="A").threshold


def realised(truth, threshold, rule, label, cuts=1500, count=24):
    """Alarms per cut, share of cuts with one, and median delay in windows, simulated."""
    rng = np.random.default_rng(8)
    alarms, delays = 0, []
    for _ in range(cuts):
        level = truth.level(label) + truth.cut_spread * rng.normal()
        said = rule.spoken(np.expm1(shapes.windows(rng, level, truth, count)) > threshold)
        alarms += np.count_nonzero(np.diff(said, prepend=False) & said)
        delays += [said.argmax()] if said.any() else []
    return alarms / cuts, len(delays) / cuts, float(np.median(delays))


def test_what_is_predicted_of_new_cuts_is_what_new_cuts_do(posterior):
    """Tool A, whose truth is known; the posterior of 12 cuts may be off as far as it says."""
    rule = AlarmRule(2, 5)
    plan = plan_threshold(posterior, Costs(3.0, 1.0, per="cut"), rule, tool="A")
    alarms, _, _ = realised(TRUTH, plan.threshold.value, rule, "stable")
    _, found, delay = realised(TRUTH, plan.threshold.value, rule, "chatter")
    low, high = plan.false_alarms_per_hour.interval90
    assert 0.7 * low < alarms * 3600.0 / (24 * shapes.STEP) < 1.3 * high
    low, high = plan.detection_probability.interval90
    assert low - 0.03 < found < high + 0.03
    assert plan.within == pytest.approx(24 * shapes.STEP)
    assert plan.delay.value == pytest.approx((1 + delay) * shapes.STEP, abs=shapes.STEP)


def test_a_rate_of_false_alarms_lifts_the_threshold_and_is_kept(posterior):
    free = plan_threshold(posterior, COSTS, tool="A")
    held = plan_threshold(posterior, COSTS, tool="A", false_alarms_per_hour=40.0)
    assert not free.choice.raised and held.choice.raised
    assert held.threshold.value > free.threshold.value
    assert held.false_alarms_per_hour.value == pytest.approx(40.0, rel=0.01)
    low, high = held.threshold.interval90
    assert low <= held.threshold.value <= high
    assert "the false-alarm rate asked for" in held.status
    of_cuts = Costs(3.0, 1.0, per="cut")
    rarer = plan_threshold(posterior, of_cuts, tool="A", false_alarms_per_hour=40.0)
    assert rarer.threshold.value >= held.threshold.value - 1e-6
    loose = plan_threshold(posterior, COSTS, tool="A", false_alarms_per_hour=20_000.0)
    assert not loose.choice.raised
    assert loose.threshold.value == pytest.approx(free.threshold.value)


def test_what_the_cuts_cannot_support_is_said_with_the_number_needed(posterior):
    """6 stable cuts of 24 windows: 144 windows promise no less than one in 145."""
    within_reach = 3600.0 / shapes.STEP / 144.0
    words = "144 stable windows of 6 cuts can promise no less than one in 145"
    asked = plan_threshold(posterior, COSTS, tool="A", false_alarms_per_hour=1.0)
    (sentence,) = (w for w in asked.warnings if words in w)
    assert "1 false alarms per hour are one in 22500 windows" in sentence
    # 22499 windows are 938 cuts of 24.
    assert "22499 stable windows (1 h of stable cutting, about 938 cuts like these)" in sentence
    fine = plan_threshold(posterior, COSTS, tool="A", false_alarms_per_hour=within_reach)
    assert not any("can promise" in w for w in fine.warnings)
    few = plan_threshold(posterior, COSTS, tool="B")
    assert any("only 2 stable and 1 chatter cuts are there of tool B" in w for w in few.warnings)


def test_one_threshold_for_both_tools_lies_between_theirs(posterior):
    a, b, both = (
        plan_threshold(posterior, COSTS, tool=tool).threshold.value
        for tool in ("A", "B", ("A", "B"))
    )
    assert a < both < b


def test_wrong_wishes_are_refused(posterior):
    for wish, words in (
        ({"tool": "C"}, "no cut is of the tool 'C'; known are A, B"),
        ({"false_alarms_per_hour": 0.0}, "false alarms per hour are 0, but must be above 0"),
        ({"within": 0.01}, "chatter cannot be found within 0.01 s: a window takes 0.16"),
    ):
        with pytest.raises(InputError, match=words):
            plan_threshold(posterior, COSTS, **({"tool": "A"} | wish))
    for costs, words in (
        ((0.0, 1.0), "cost of a miss is 0"),
        ((1.0, -1.0), "cost of a false alarm is -1"),
        ((1.0, 1.0, 1.0), "share of chatter is 1"),
        ((1.0, 1.0, 0.5, "hour"), "costs are per 'hour'"),
    ):
        with pytest.raises(InputError, match=words):
            Costs(*costs)
    cuts = list(posterior.cuts)
    cuts[1] = dataclasses.replace(cuts[1], step=0.08)
    with pytest.raises(
        InputError, match=r"cut 2: a window lasts 0\.16 s and the next begins 0\.08"
    ):
        plan_threshold(dataclasses.replace(posterior, cuts=tuple(cuts)), COSTS, tool="A")


def test_cuts_are_dealt_whole_and_evenly():
    cuts = shapes.cuts(np.random.default_rng(0), 7, 5, 3)
    places = dealt(cuts, 3, seed=1)
    for label in ("stable", "chatter", "marginal"):
        counts = np.bincount([p for p, c in zip(places, cuts, strict=True) if c.label == label])
        assert counts.max() - counts.min() <= 1
    lonely = dealt(shapes.cuts(np.random.default_rng(0), 4, 1), 4)
    assert lonely[-1] == -1 and (lonely[:-1] >= 0).all()
    two = dealt(shapes.cuts(np.random.default_rng(0), 3, 2), 3)
    assert two[3] != two[4]


def test_tallies_count_what_is_there():
    def cut(label, scores):
        return dataclasses.replace(
            shapes.cut(np.random.default_rng(0), label), scores=np.array(scores, float)
        )

    choice = Choice(10.0, False, np.array([1.0, 10.0, 30.0]), np.array([0.0, 0.5, 1.0]))
    used = [
        (cut("stable", [1, 20, 20, 1, 1, 1, 1, 1, 20, 20]), choice),  # two alarms
        (cut("stable", [1] * 10), choice),
        (cut("chatter", [1, 1, 20, 1, 20, 20]), choice),  # at the fifth window
        (cut("chatter", [1, 1, 1, 1, 1, 20]), choice),
        (cut("marginal", [20, 20]), choice),
    ]
    tally = tallied(used, AlarmRule(2, 5))
    assert (tally.stable, tally.chatter, tally.marginal) == (2, 2, 1)
    assert (tally.false_alarms, tally.detected, tally.marginal_alarms) == (2, 1, 1)
    assert tally.delays == (pytest.approx(5 * shapes.STEP),)
    assert tally.hours == pytest.approx(20 * shapes.STEP / 3600.0)
    # 12 windows of chatter, 4 of them high; 20 stable ones, 4 of them high.
    pairs = (4 * 16 + 0.5 * (4 * 4 + 8 * 16)) / (12 * 20)
    assert tally.auc == pytest.approx(pairs)
    assert tally.detection_probability.value == 0.5
    exact = scipy.stats.chi2.ppf([0.05, 0.95], 2 * 2.5) / 2.0 / tally.hours
    np.testing.assert_allclose(tally.false_alarms_per_hour.interval90, exact)


def test_held_out_figures_stand_beside_those_in_sample(posterior):
    check = check_threshold(posterior, COSTS, tool="A", folds=3, seed=1)
    assert check.folds == 3
    held, seen = check.held_out, check.in_sample
    for tally in (held, seen):
        assert (tally.stable, tally.chatter) == (6, 6)
    assert 0.7 < held.auc <= 1.0
    found = check.as_dict()
    assert found["in_sample"]["auc"] == seen.auc
    assert set(found["in_sample"]) < set(found)
    with pytest.raises(InputError, match="folds are 1"):
        check_threshold(posterior, COSTS, folds=1)


APART = shapes.Truth(2.0, 1.5, 0.5, 0.2, 8.0, 0.3)
EVEN = Costs(1.0, 1.0)


def cost_of(threshold, shift, drawn):
    """True cost of a window at a threshold, of a tool whose scores are shifted."""
    y = np.log1p(threshold) - shift - APART.stable
    return EVEN.expected(np.mean(drawn > y), np.mean(APART.gap + drawn < y))


def by_counting(cuts):
    """The threshold of least cost on the windows at hand, in the middle of its range."""
    grid = np.linspace(0.0, 8.0, 2000)
    above = {
        label: np.mean(
            [[np.mean(c.log_scores > g) for g in grid] for c in cuts if c.label == label], axis=0
        )
        for label in ("stable", "chatter")
    }
    cost = EVEN.expected(above["stable"], 1.0 - above["chatter"])
    return np.expm1(grid[cost <= cost.min() + 1e-12].mean())


@pytest.mark.slow
def test_new_tools_with_three_cuts_borrow_from_the_old_ones():
    """True costs of 36 new tools beside four old ones, tools differing by a spread of 0.6.

    Partial pooling costs less than the old tools' threshold and less than the best threshold on a
    tool's own three cuts, each by more than two standard errors of the difference over tools.
    """
    rng = np.random.default_rng(99)
    drawn = APART.cut_spread * rng.normal(size=100_000)
    drawn += APART.spread * rng.standard_t(APART.freedom, 100_000)
    names = [f"T{i}" for i in range(10)]
    costs = []
    for seed in range(6):
        rng = np.random.default_rng(300 + seed)
        shifts = dict(zip(names, 0.6 * rng.normal(size=10), strict=True))
        labels = {n: ("stable", "stable", "chatter", "chatter")[: 4 if i < 4 else 3]
                  for i, n in enumerate(names)}  # fmt: skip
        cuts = [
            shapes.cut(rng, label, APART, 16, n, shift=shifts[n])
            for n in names
            for label in labels[n]
        ]
        posterior = fit_scores(cuts, seed=1, draws=120, warmup=150)
        old = chosen_threshold(posterior, EVEN, tool=names[:4]).threshold
        for name in names[4:]:
            own = by_counting([cut for cut in cuts if cut.tool == name])
            pooled = chosen_threshold(posterior, EVEN, tool=name).threshold
            costs.append([cost_of(t, shifts[name], drawn) for t in (pooled, old, own)])
    table = np.array(costs)
    gain = table[:, 1:] - table[:, :1]
    error = gain.std(axis=0, ddof=1) / np.sqrt(len(gain))
    assert (gain.mean(axis=0) > 2.0 * error).all(), (table.mean(axis=0), error)
