"""The state of engagement: the level's law, and every way from state to state."""

import numpy as np
import pytest

from procmodel.chatter.engagement_state import (
    AIR,
    CUTTING,
    ENTRY,
    EXIT,
    STATES,
    Engagement,
    EngagementRule,
    engaged,
    level,
    require_rule,
)
from procmodel.errors import InputError


def run(levels, **rule):
    state, names = Engagement(), []
    for value in levels:
        state = engaged(state, value, EngagementRule(**rule))
        names.append(state.name)
        assert state.name in STATES
    return names


@pytest.mark.parametrize(
    ("levels", "rule", "names"),
    [
        # One cut from beginning to end.
        ([1, 3, 9, 9, 1, 1, 1], {}, [AIR, ENTRY, CUTTING, CUTTING, EXIT, EXIT, AIR]),
        # Between the two levels nothing changes.
        ([1.9, 1.9, 3, 1.6, 1.6, 1.6], {}, [AIR, AIR, ENTRY, CUTTING, CUTTING, CUTTING]),
        # A knock is an entry that comes to nothing.
        ([1, 8, 1, 1], {}, [AIR, ENTRY, AIR, AIR]),
        # A short gap does not end the cut, and between the levels the exit waits.
        ([3, 3, 1, 3], {}, [ENTRY, CUTTING, EXIT, CUTTING]),
        ([3, 3, 1, 1.7, 1.7, 1], {}, [ENTRY, CUTTING, EXIT, EXIT, EXIT, AIR]),
        ([3, 3, 3, 3], {"entry_windows": 2}, [ENTRY, ENTRY, CUTTING, CUTTING]),
        ([3, 1], {"entry_windows": 0, "exit_windows": 0}, [CUTTING, AIR]),
    ],
)
def test_the_ways_from_state_to_state(levels, rule, names):
    assert run(levels, **rule) == names


def test_without_hysteresis_the_state_would_chatter():
    levels = [3.0, 3.0, *(1.9, 2.1) * 10]
    assert set(run(levels)[2:]) == {CUTTING}
    changes = run(levels, leave=2.0)
    assert changes.count(EXIT) == 10


def test_level_by_hand():
    mean = np.array([[1.0, 2.0, 0.0], [4.0, 5.0, 6.0]])
    spectrum = np.array([[3.0, 2.0, 9.0], [4.0, 50.0, 12.0]])
    counted = np.array([True, False, True])
    # 3/1, 4/4, 12/6; the bin without power in air does not count.
    assert level(spectrum, mean, counted, np) == pytest.approx((3.0 + 1.0 + 2.0) / 3.0)
    assert level(mean, mean, counted) == 1.0


@pytest.mark.parametrize(
    "rule", [{"leave": 0.0}, {"enter": 1.0, "leave": 2.0}, {"exit_windows": -1}]
)
def test_a_rule_without_sense_is_refused(rule):
    with pytest.raises(InputError):
        require_rule(EngagementRule(**rule))
