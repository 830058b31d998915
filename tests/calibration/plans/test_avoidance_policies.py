"""Policies of avoidance: closed forms, what they remember, that nothing is changed in place."""

import math

import numpy as np
import pytest

from calibration.plans.avoidance_cost import (
    CostState,
    LeastCost,
    Tried,
    in_phase_chance,
    probability_of,
)
from calibration.plans.avoidance_policies import (
    PAPERS_OVERRIDES,
    FixedSteps,
    FromFrequency,
    Hold,
    Seen,
    in_phase,
)
from calibration.plans.threshold_cost import Choice
from procmodel.chatter import CHATTER, CUTTING, MARGINAL, STABLE, Observation
from procmodel.chatter.lobes import largest_multiplier
from procmodel.errors import InputError
from tests.procmodel.chatter.shapes_plant import COEFFICIENTS, MODE, SLOT, SPEED, TOOL

ROTATION = 250.0


def window(score=500.0, outcome=CHATTER, frequency=1900.0, time=1.0, engagement=CUTTING, fault=""):
    return Observation(
        time, score, frequency, 5.0, 0, engagement, outcome, None, None, fault
    )  # fmt: skip


def seen(*windows, override=1.0, time=1.0):
    return Seen(time, override, override * ROTATION, windows)


def walked(policy, observation, steps):
    """Overrides that a policy goes through while every window looks the same."""
    state, override, found = policy.start(), 1.0, []
    for i in range(steps):
        state, decision = policy.decide(state, seen(observation, override=override, time=float(i)))
        override = decision.override
        found.append(override)
    return found, decision.reason


def test_the_papers_steps():
    found, reason = walked(FixedSteps(), window(), 7)
    assert found == [0.9, 0.8, 0.7, 0.6, 0.5, 0.5, 0.5]
    assert reason == "chatter at 1900.0 Hz, score 500, but 50 % is the least override allowed."


@pytest.mark.parametrize("outcome", [STABLE, MARGINAL, ""])
@pytest.mark.parametrize("policy", [FixedSteps(), FromFrequency(2, ROTATION)])
def test_without_chatter_the_override_stays(policy, outcome):
    assert walked(policy, window(outcome=outcome), 3) == ([1.0] * 3, "")


def test_the_last_judged_window_counts():
    over = seen(window(), window(outcome=STABLE), window(outcome="", score=math.nan))
    assert FixedSteps().decide(None, over)[1].override == 1.0
    still = seen(window(outcome=STABLE), window(), window(outcome=""))
    assert FixedSteps().decide(None, still)[1].override == 0.9


def test_hold_holds():
    assert walked(Hold(), window(), 2) == ([1.0, 1.0], "")


def test_every_order_within_the_range():
    found = in_phase(1234.5, 3, 100.0, (0.5, 1.2), continuous=True)
    # All k with 0.5 <= f / (3 k 100) <= 1.2: 4.115 / k.
    assert found == {1234.5 / (300.0 * k): k for k in (4, 5, 6, 7, 8)}


def test_the_nearest_allowed_override_stands_for_one_in_phase():
    allowed = np.round(np.arange(0.5, 1.21, 0.05), 2)
    found = in_phase(1234.5, 3, 100.0, allowed, off=0.1)
    off = {o: 1234.5 / (300.0 * o) % 1.0 for o in allowed}
    assert set(found) == {o for o, x in off.items() if min(x, 1.0 - x) <= 0.1}
    assert 0 < len(found) < len(allowed)


def test_chatter_below_the_tooth_passing_has_no_order():
    assert in_phase(200.0, 3, 100.0, (0.8, 1.0)) == {}
    assert in_phase(math.nan, 3, 100.0, (0.8, 1.0)) == {}


def test_up_as_well_as_down_and_not_twice():
    policy = FromFrequency(2, ROTATION, (0.5, 1.2), continuous=True)
    # f / (N Omega) = 4.2: 1.05 with k = 4, then 0.84, 0.7, 0.6, 0.525.
    chatters = window(frequency=2100.0)
    found, reason = walked(policy, chatters, 6)
    np.testing.assert_allclose(found[:5], [1.05, 0.84, 0.7, 0.6, 0.525], rtol=1e-12)
    # Then nothing is left but the least override.
    assert found[5] == 0.5 and "from 52.5 to 50 %" in reason
    near = FromFrequency(2, ROTATION, (0.5, 1.2), continuous=True, prefer="nearest")
    assert walked(near, window(frequency=2600.0), 1)[0] == [pytest.approx(1.04)]
    assert walked(policy, window(frequency=2300.0), 1)[0] == [pytest.approx(1.15)]


def test_a_quarter_beyond_the_multiple_is_more_stable_than_a_quarter_before():
    # The reference case chatters at 945 Hz at 5000 1/min and 0.5 mm.
    growth = {}
    for phase in (0.25, -0.25):
        found = in_phase(945.0, 2, SPEED, (0.9, 1.6), continuous=True, phase=phase)
        law = [largest_multiplier(MODE, TOOL, SLOT, COEFFICIENTS, SPEED * o, 0.5e-3) for o in found]
        growth[phase] = [float(mu) for mu in law]
    assert len(growth[0.25]) == len(growth[-0.25]) == 3
    assert max(growth[0.25]) < 1.0 < min(growth[-0.25])


def test_the_phase_is_kept():
    found = in_phase(1234.5, 3, 100.0, (0.5, 1.2), continuous=True, phase=0.3)
    for override, order in found.items():
        assert 1234.5 / (300.0 * override) == pytest.approx(order + 0.3)
        assert in_phase_chance(1234.5, 3, 100.0 * override, 0.3) == pytest.approx(0.0, abs=1e-20)
        assert in_phase_chance(1234.5, 3, 100.0 * override, -0.2) == pytest.approx(1.0)


def test_probability_is_the_share_of_thresholds_below():
    probability = probability_of(np.array([100.0, 50.0, 200.0, 80.0]))
    assert probability(np.array([10.0, 60.0, 100.5, 1e4])).tolist() == [0.0, 0.25, 0.75, 1.0]


def cheap(**changes):
    return LeastCost(
        **{
            "probability": probability_of(np.linspace(50.0, 150.0, 101)),
            "teeth": 2,
            "rotation": ROTATION,
            "windows": 1,
            **changes,
        }
    )


def test_the_cost_by_hand():
    policy = cheap(chatter_cost=4.0, unknown=0.6, least=0.2, trust=3.0)
    state = CostState(((1.0, Tried(0.0, (0.8, 0.6))),), 1900.0)
    phase = math.sin(math.pi * 1900.0 / (2 * ROTATION * 0.5)) ** 2
    rule = 0.2 + 0.4 * phase
    chance = (3.0 * rule + 0.7) / 4.0
    assert policy.chance(state, 0.5, 9.0) == pytest.approx(chance)
    assert policy.cost(state, 0.5, 9.0) == pytest.approx(1.0 + 4.0 * chance / 0.5)
    assert policy.cost(state, 1.0, 9.0) == pytest.approx(4.0 * 0.7)


def test_where_chatter_costs_nothing_the_fastest_is_taken():
    free = cheap(chatter_cost=0.0, overrides=(0.5, 1.0, 1.2))
    assert walked(free, window(score=1e4), 3)[0] == [1.2] * 3
    assert walked(cheap(chatter_cost=0.0), window(score=1e4), 3)[0] == [1.0] * 3


def test_faint_chatter_is_borne_and_loud_chatter_left():
    # P = 0.2 and 1: at C = 1 the first costs less than any other override may.
    faint, loud = window(score=69.5), window(score=1e4)
    assert walked(cheap(chatter_cost=1.0), faint, 2)[0] == [1.0, 1.0]
    left, reason = walked(cheap(chatter_cost=1.0), loud, 1)
    assert left[0] < 1.0 and reason.startswith("P(chatter) is 1.00 at 100 %")


def test_going_up_is_a_matter_of_cost():
    # At 120 % in phase, 1800 = 2 * 300 * 3, and opposite, 2100 = 2 * 300 * 3.5.
    policy = cheap(overrides=(0.8, 1.0, 1.2), least=0.02, trust=50.0, chatter_cost=10.0)
    assert walked(policy, window(frequency=1800.0), 1)[0] == [1.2]
    assert walked(policy, window(frequency=2100.0), 1)[0] == [0.8]


def test_it_waits_for_its_windows_and_ignores_others():
    policy = cheap(windows=3)
    found, _ = walked(policy, window(score=1e4), 3)
    assert found[:2] == [1.0, 1.0] and found[2] != 1.0
    for other in (window(engagement="air"), window(fault="stuck", score=math.nan)):
        assert walked(cheap(), other, 3)[0] == [1.0] * 3


def test_what_was_seen_is_forgotten():
    policy = cheap(forget=2.0, unknown=0.4)
    state = CostState(((1.0, Tried(1.0, (1.0,))),))
    assert policy.chance(state, 1.0, 1.0) == pytest.approx(1.0)
    assert policy.chance(state, 1.0, 3.0) == pytest.approx(math.exp(-1) + (1 - math.exp(-1)) * 0.4)
    assert cheap().chance(state, 1.0, 1e6) == pytest.approx(1.0)


def test_a_planned_threshold_can_be_used():
    grid = np.array([10.0, 100.0, 1000.0])
    choice = Choice(100.0, False, grid, np.array([0.0, 0.5, 1.0]))
    policy = cheap(probability=choice.chatter_probability)
    state, _ = policy.decide(policy.start(), seen(window(score=100.0)))
    assert dict(state.tried)[1.0].chances == (0.5,)


@pytest.mark.parametrize(
    "policy", [FixedSteps(), FromFrequency(2, ROTATION), cheap(overrides=(0.5, 0.8, 1.0, 1.2))]
)
def test_decisions_are_pure(policy):
    first = policy.start()
    state, decision = policy.decide(first, seen(window(score=1e4)))
    again, same = policy.decide(first, seen(window(score=1e4)))
    assert (state, decision) == (again, same)
    assert first == policy.start()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: FixedSteps(()), "no override is allowed"),
        (lambda: FixedSteps((1.0, 0.0)), "an override is 0,"),
        (lambda: FromFrequency(0, ROTATION), "teeth is 0,"),
        (lambda: FromFrequency(2, -1.0), "rotation is -1 rev/s"),
        (lambda: FromFrequency(2, 1.0, prefer="slowest"), "prefer is 'slowest'"),
        (lambda: FromFrequency(2, 1.0, off=0.6), "off is 0.6,"),
        (lambda: FromFrequency(2, 1.0, phase=0.6), "phase is 0.6,"),
        (lambda: FromFrequency(2, 1.0, same=0.5), "same is 0.5,"),
        (lambda: cheap(windows=0), "windows is 0,"),
        (lambda: cheap(chatter_cost=-1.0), "chatter cost is -1,"),
        (lambda: cheap(gain=math.nan), "gain is nan,"),
        (lambda: cheap(unknown=1.0), "unknown is 1,"),
        (lambda: cheap(least=0.7), "least is 0.7,"),
        (lambda: cheap(trust=0.0), "trust is 0,"),
        (lambda: cheap(forget=0.0), "forget is 0 s"),
        (lambda: probability_of(np.array([])), "the samples of the threshold"),
        (lambda: probability_of(np.array([np.nan])), "the samples of the threshold"),
    ],
)
def test_nonsense_is_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


def test_the_papers_overrides():
    assert PAPERS_OVERRIDES == (1.0, 0.9, 0.8, 0.7, 0.6, 0.5)
