"""Speed along a path: closed forms, limits that hold, and nothing faster."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from procmodel.electrode import (
    FeedProfile,
    feed_along,
    interpolate_arc,
    interpolate_line,
    travel_time,
)
from procmodel.errors import InputError


@pytest.mark.parametrize(
    ("length", "expected"),
    [(100.0, 10.0 + 0.2), (2.0, 0.2 + 0.2), (0.5, 2.0 * math.sqrt(0.01)), (0.0, 0.0)],
)
def test_travel_time(length, expected):
    assert travel_time(length, 10.0, 50.0) == pytest.approx(expected)


@pytest.mark.parametrize("length", [0.3, 1.7, 2.0, 100.0])
def test_a_line_takes_the_time_of_its_closed_form(length):
    points = interpolate_line((0.0, 0.0), (0.6 * length, 0.8 * length), 0.01)
    found = feed_along(points, 10.0, 50.0)
    # Where the limit changes within a step, its speed is taken as even.
    assert found.duration == pytest.approx(travel_time(length, 10.0, 50.0), rel=2e-3)
    assert found.way[-1] == pytest.approx(length)
    assert (found.speed[0], found.speed[-1]) == (0.0, 0.0)


def test_a_single_step_is_a_line():
    assert feed_along([[0.0, 0.0], [3.0, 4.0]], 10.0, 50.0).duration == pytest.approx(0.7)


def test_speed_on_an_arc():
    points = interpolate_arc((0.0, 0.0), 8.0, 0.0, 2.0 * math.pi, 0.05)
    found = feed_along(points, 1e3, 50.0)
    # v^2 / r = a, within the square of the step's angle.
    assert found.speed.max() == pytest.approx(math.sqrt(50.0 * 8.0), rel=1e-4)


def test_a_path_that_turns_back_stops_there():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    found = feed_along(points, 10.0, 50.0)
    assert found.speed[2] == 0.0
    assert found.duration == pytest.approx(2.0 * travel_time(2.0, 10.0, 50.0), rel=1e-12)
    twice = feed_along(points[[0, 1, 2, 2, 3, 4]], 10.0, 50.0)
    assert twice.duration == pytest.approx(found.duration)
    assert feed_along(points[[1, 1, 1]], 10.0, 50.0).duration == 0.0
    zigzag = feed_along(points[[0, 1, 0, 1]], 10.0, 50.0)
    assert zigzag.duration == pytest.approx(3.0 * travel_time(1.0, 10.0, 50.0))


# Coarse, so that positions repeat and paths turn straight back.
tenth = st.integers(-90, 90).map(lambda n: n / 10)


@given(
    st.lists(st.tuples(tenth, tenth), min_size=2, max_size=25),
    st.floats(0.5, 50.0), st.floats(1.0, 500.0),
)  # fmt: skip
def test_limits_hold_and_are_used(points, feed, acceleration):
    given_points = np.array(points)
    found = feed_along(given_points, feed, acceleration)
    # A position that stands twice changes nothing.
    kept = [0] + [i for i in range(1, len(points)) if points[i] != points[i - 1]]
    points = given_points[kept]
    moves = np.diff(points, axis=0)
    steps = np.hypot(*moves.T)
    repeated = np.delete(np.arange(len(found.way)), kept)
    np.testing.assert_array_equal(found.time[repeated], found.time[repeated - 1])
    found = FeedProfile(found.way[kept], found.speed[kept], found.time[kept])
    change = np.abs(np.diff(found.speed**2))
    slack = 1e-9 * (feed**2 + acceleration * 500.0)
    assert np.all(change <= 2.0 * acceleration * steps + slack)
    allowed = np.full(len(points), feed**2)
    allowed[[0, -1]] = 0.0
    for i in range(1, len(points) - 1):
        a, b = moves[i - 1], moves[i]
        turn = abs(math.atan2(a[0] * b[1] - a[1] * b[0], a @ b))
        if turn > 1e-9:
            mean = 0.5 * (steps[i - 1] + steps[i])
            radius = mean / (2.0 * math.tan(0.5 * turn))
            allowed[i] = min(feed**2, acceleration * max(radius, 0.0))
    assert np.all(found.speed**2 <= allowed + slack)
    # Nothing faster is allowed: at every position a limit or a neighbour holds the speed.
    square = found.speed**2
    before = np.append(np.inf, square[:-1] + 2.0 * acceleration * steps)
    after = np.append(square[1:] + 2.0 * acceleration * steps, np.inf)
    np.testing.assert_allclose(square, np.minimum(allowed, np.minimum(before, after)), atol=slack)
    assert np.all(np.diff(found.time) >= 0.0) and math.isfinite(found.duration)
    assert found.duration >= found.way[-1] / feed * (1.0 - 1e-12)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: feed_along([[0, 0]], 1.0, 1.0), ("two positions",)),
        (lambda: feed_along([[0, 0], [1, math.nan]], 1.0, 1.0), ("position 2", "finite")),
        (lambda: feed_along([[0, 0], [1, 1]], 0.0, 1.0), ("feed", "above 0")),
        (lambda: feed_along([[0, 0], [1, 1]], 1.0, -1.0), ("acceleration", "-1")),
        (lambda: travel_time(-1.0, 1.0, 1.0), ("length", "-1")),
    ],
)
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(InputError) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert all(word in str(caught.value) for word in words), caught.value
