"""Interpolated lines and arcs: known answers, properties for any input, gradients, bad input."""

import math
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from procmodel.electrode import (
    arc_points,
    arc_steps,
    arc_through,
    axis_speeds,
    chord_error,
    interpolate_arc,
    interpolate_line,
    line_points,
    line_steps,
    step_angle,
    step_for_tolerance,
)
from procmodel.errors import InputError

KNOWN = tomllib.loads(
    (Path(__file__).parents[2] / "reference" / "electrode_paths.toml").read_text()
)
QUARTER = math.pi / 2
# A whole number of steps is told from the next one to this share of a step.
SHARE = 1e-9

coordinate = st.floats(-300.0, 300.0)
steps = st.floats(0.2, 40.0)
grids = st.sampled_from([0.1, 0.05, 0.2, 0.01, 0.13])


def lengths_of(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1)


def test_known_line():
    known = KNOWN["line"]
    arguments = known["start"], known["end"], known["step"]
    exact = interpolate_line(*arguments)
    rounded = interpolate_line(*arguments, known["resolution"])
    length = math.dist(known["start"], known["end"])
    assert length == pytest.approx(known["length"], abs=5e-7)
    assert len(exact) - 1 == len(rounded) - 1 == known["steps"]
    count, last = line_steps(length, known["step"])
    assert (count, last) == (known["steps"], pytest.approx(known["last_step"], abs=5e-7))
    assert lengths_of(exact)[-1] == pytest.approx(known["last_step"], abs=5e-7)
    off = np.linalg.norm(rounded - exact, axis=1).max()
    assert off == pytest.approx(known["greatest_rounding"], abs=5e-5)
    np.testing.assert_array_equal(rounded[-1], known["end"])


def test_rounded_increments_would_miss_the_end():
    """The trap that absolute rounding avoids, and the size of it."""
    known = KNOWN["line"]
    exact = interpolate_line(known["start"], known["end"], known["step"])
    moves = np.round(np.diff(exact, axis=0) / known["resolution"]) * known["resolution"]
    missed = moves.sum(axis=0) - known["end"]
    np.testing.assert_allclose(missed, known["incremental_miss"], atol=0.051)


@pytest.mark.parametrize("i", range(5))
def test_known_quarter_turns(i):
    known = KNOWN["quarter_turns"]
    radius, step = known["radius"][i], known["step"]
    assert arc_steps(radius, QUARTER, step)[0] == known["steps"][i]
    points = interpolate_arc((0.0, 0.0), radius, 0.0, QUARTER, step)
    assert len(points) - 1 == known["steps"][i]
    middles = 0.5 * (points[1:-1] + points[:-2])
    sagitta = radius - np.hypot(*middles.T)
    # Three digits are known; the middle of a chord is a difference of lengths near the radius.
    np.testing.assert_allclose(sagitta, known["chord_error"][i], rtol=1e-3)
    assert float(chord_error(radius, step)) == pytest.approx(known["chord_error"][i], rel=1e-3)
    assert float(chord_error(radius, step)) == pytest.approx(step**2 / (8 * radius), rel=1e-3)


def test_radius_does_not_grow_as_in_a_recurrence():
    known = KNOWN["recurrence"]
    radius = known["radius"]
    point = np.array([radius, 0.0])
    theta = step_angle(radius, 0.3)
    for _ in range(262):
        point = point + theta * np.array([-point[1], point[0]])
    assert np.hypot(*point) - radius == pytest.approx(known["growth"], abs=5e-4)
    ours = interpolate_arc((0.0, 0.0), radius, 0.0, QUARTER, 0.3)
    np.testing.assert_allclose(np.hypot(*ours.T), radius, rtol=1e-14)


@given(
    st.integers(2, 3).flatmap(
        lambda d: st.tuples(*[st.lists(coordinate, min_size=d, max_size=d)] * 2)
    ),
    steps,
)
def test_any_line(line, step):
    start, end = line
    points = interpolate_line(start, end, step)
    count, length = len(points) - 1, math.dist(start, end)
    np.testing.assert_array_equal(points[0], start)
    np.testing.assert_array_equal(points[-1], end)
    taken = lengths_of(points)
    assert np.all(taken <= step * (1.0 + 2.0 * SHARE) + 1e-12)
    # One step less would not do, and only the last one is shorter.
    assert max(count - 1, 0) * step <= length
    np.testing.assert_allclose(taken[:-1], step, rtol=1e-9, atol=1e-12)
    assert taken.sum() == pytest.approx(length, rel=1e-12, abs=1e-12)


@given(st.lists(coordinate, min_size=3, max_size=3), st.lists(coordinate, min_size=3, max_size=3),
       steps, grids)  # fmt: skip
def test_rounding_is_within_half_a_resolution(start, end, step, grid):
    exact = interpolate_line(start, end, step)
    rounded = interpolate_line(start, end, step, grid)
    assert rounded.shape == exact.shape
    assert np.all(np.abs(rounded - exact) <= 0.5 * grid * (1.0 + 1e-9))
    lines = rounded / grid
    np.testing.assert_allclose(lines, np.round(lines), atol=1e-9)
    assert np.all(lengths_of(rounded) <= step + math.sqrt(3.0) * grid * (1.0 + 1e-9))


@pytest.mark.parametrize("step", [0.3, 0.1, 1.0 / 3.0, 7e-4, 123.456, 0.7])
@pytest.mark.parametrize("direction", [(1, 0), (0, -1), (0.6, 0.8), (2 / 3, 1 / 3, -2 / 3)])
def test_whole_multiples_take_no_further_step(step, direction):
    for count in (1, 2, 3, 7, 10, 29, 100, 333, 1000, 99_999):
        assert line_steps(count * step, step)[0] == count
        assert line_steps(sum([step] * min(count, 1000)), step)[0] == min(count, 1000)
        end = count * step * np.array(direction)
        for start in (np.zeros(len(end)), np.full(len(end), 0.1)):
            assert len(interpolate_line(start, start + end, step)) - 1 == count
        radius = 50.0 * step
        assert arc_steps(radius, count * step_angle(radius, step), step)[0] == count
    # Less than nothing of a step beyond is one more, a little less than a multiple is not fewer.
    assert line_steps(5.000001 * step, step)[0] == 6
    assert line_steps(4.999999 * step, step)[0] == 5


@given(
    st.tuples(coordinate, coordinate), st.floats(0.05, 200.0), st.floats(-10.0, 10.0),
    st.floats(-15.0, 15.0), steps,
)  # fmt: skip
def test_any_arc(centre, radius, start, sweep, step):
    points = interpolate_arc(centre, radius, start, sweep, step)
    count, theta = len(points) - 1, 2.0 * math.asin(min(1.0, step / (2.0 * radius)))
    assert max(count - 1, 0) * theta <= abs(sweep) <= (count + SHARE) * theta * (1 + SHARE)
    # Positions by sine and cosine of the angle itself; a few roundings of the size of the numbers.
    angles = start + np.sign(sweep) * theta * np.arange(count + 1)
    angles[-1] = start + sweep
    expected = centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    # Angles of up to 25 rad carry their own rounding.
    np.testing.assert_allclose(points, expected, atol=2e-14 * (radius + 300.0), rtol=0)
    assert np.all(lengths_of(points) <= step * (1.0 + 2.0 * SHARE) + 1e-12)


@given(st.floats(0.5, 200.0), st.floats(-7.0, 7.0), st.floats(-7.0, 7.0), steps, grids)
def test_rounded_arc(radius, start, sweep, step, grid):
    exact = interpolate_arc((3.0, -4.0), radius, start, sweep, step)
    rounded = interpolate_arc((3.0, -4.0), radius, start, sweep, step, grid)
    assert np.all(np.abs(rounded - exact) <= 0.5 * grid * (1.0 + 1e-9))
    np.testing.assert_allclose(rounded / grid, np.round(rounded / grid), atol=1e-9)


@pytest.mark.parametrize("turns", [1, -1, 3])
@pytest.mark.parametrize("resolution", [None, 0.1])
def test_whole_turns_end_where_they_start(turns, resolution):
    points = interpolate_arc((1.0, 2.0), 25.0, 0.7, turns * 2.0 * math.pi, 0.3, resolution)
    np.testing.assert_array_equal(points[0], points[-1])
    area = 0.5 * np.sum(points[:-1, 0] * points[1:, 1] - points[1:, 0] * points[:-1, 1])
    # Shoelace: the sense of turning, and the circle's area up to chords and rounding.
    assert area == pytest.approx(turns * math.pi * 25.0**2, rel=1e-3)


def test_long_paths_cross_blocks_without_a_seam():
    count = 20_000  # several blocks
    line = interpolate_line((0.1, 0.2), (0.1 + 0.6 * count, 0.2 + 0.8 * count), 1.0)
    np.testing.assert_allclose(line[:, 0], 0.1 + 0.6 * np.arange(count + 1), rtol=1e-14)
    arc = interpolate_arc((0.0, 0.0), 1e4, 0.0, 2.0, 1.0)
    theta = 2.0 * math.asin(0.5e-4)
    np.testing.assert_allclose(
        np.unwrap(np.arctan2(arc[:-1, 1], arc[:-1, 0])), theta * np.arange(len(arc) - 1), atol=1e-14
    )


def test_nothing_to_move_is_one_position():
    np.testing.assert_array_equal(interpolate_line((1.04, 2.0, 3.0), (1.04, 2.0, 3.0), 0.3, 0.1),
                                  [[1.0, 2.0, 3.0]])  # fmt: skip
    np.testing.assert_array_equal(interpolate_arc((0.0, 0.0), 5.0, 0.0, 0.0, 0.3), [[5.0, 0.0]])
    assert line_steps(0.0, 0.3) == (0, 0.0)


def test_the_shortest_line_there_is_has_both_its_ends():
    points = interpolate_line((0.0, 0.0), (0.0, 5e-324), 2.0)
    np.testing.assert_array_equal(points, [[0.0, 0.0], [0.0, 5e-324]])


def test_a_circle_smaller_than_the_step():
    points = interpolate_arc((0.0, 0.0), 0.1, 0.0, 2.0 * math.pi, 0.3)
    np.testing.assert_allclose(points, [[0.1, 0.0], [-0.1, 0.0], [0.1, 0.0]], atol=1e-15)


@given(st.floats(0.1, 1e4), st.floats(0.01, 1.99))
def test_step_for_tolerance_inverts_the_chord_error(radius, share):
    step = share * radius
    assert float(step_for_tolerance(radius, chord_error(radius, step))) == pytest.approx(
        step, rel=1e-12
    )
    exact = radius * (1.0 - math.cos(0.5 * step_angle(radius, step)))
    # 1 - cos loses digits where it is small.
    assert float(chord_error(radius, step)) == pytest.approx(exact, rel=1e-9, abs=1e-15 * radius)


def test_step_for_a_coarse_tolerance_is_the_diameter():
    assert float(step_for_tolerance(5.0, 9.0)) == 10.0


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("sweep", [0.3, 2.0, 4.0, 6.2])
def test_arc_through_its_ends(sweep, clockwise):
    turn = -sweep if clockwise else sweep
    points = interpolate_arc((7.0, -3.0), 20.0, 2.9, turn, 0.5)
    radius, start, found = arc_through((7.0, -3.0), points[0], points[-1], clockwise)
    assert (radius, found) == (pytest.approx(20.0), pytest.approx(turn))
    assert start == pytest.approx(2.9)


def test_equal_ends_are_a_full_circle():
    for clockwise, sweep in ((False, 2 * math.pi), (True, -2 * math.pi)):
        assert arc_through((0, 0), (3, 4), (3, 4), clockwise)[2] == pytest.approx(sweep)


def test_points_for_a_count_are_the_same():
    start, end = np.array([1.0, -2.0, 3.0]), np.array([40.0, 20.0, -5.0])
    expected = interpolate_line(start, end, 0.7)
    np.testing.assert_allclose(
        line_points(start, end, 0.7, len(expected) - 1), expected, atol=1e-12
    )
    expected = interpolate_arc((1.0, 2.0), 30.0, 0.4, -2.2, 0.7)
    got = arc_points(np.array([1.0, 2.0]), 30.0, 0.4, -2.2, 0.7, len(expected) - 1)
    np.testing.assert_allclose(got, expected, atol=1e-12)
    assert line_points(start, start, 0.7, 0).shape == (1, 3)
    assert arc_points(np.zeros(2), 30.0, 0.4, 0.0, 0.7, 0).shape == (1, 2)


def differences(function, value, h=1e-5):
    """Central differences of a function of a vector."""
    columns = []
    for i in range(len(value)):
        step = np.zeros(len(value))
        step[i] = h
        columns.append((np.asarray(function(value + step)) - function(value - step)) / (2 * h))
    return np.stack(columns, axis=-1)


def test_gradient_in_the_ends_of_a_line():
    def points(ends):
        return line_points(ends[:3], ends[3:], 0.7, 9)

    ends = np.array([1.0, -2.0, 3.0, 4.0, 2.0, 6.0])
    assert line_steps(math.dist(ends[:3], ends[3:]), 0.7)[0] == 9
    slopes = jax.jit(jax.jacfwd(points))(ends)
    # Curvature over the difference step and rounding over it, both about 1e-10.
    np.testing.assert_allclose(slopes, differences(points, ends), atol=1e-8)
    assert np.all(np.isfinite(jax.jacrev(lambda e: line_points(e, e, 0.7, 1))(ends[:3])))


def test_gradient_in_everything_of_an_arc():
    def points(values):
        return arc_points(values[:2], values[2], values[3], values[4], values[5], 12)

    values = np.array([1.0, 2.0, 20.0, 0.3, -0.4, 0.7])
    assert arc_steps(20.0, -0.4, 0.7)[0] == 12
    np.testing.assert_allclose(
        jax.jit(jax.jacfwd(points))(values), differences(points, values), atol=1e-7
    )


def test_axis_speeds():
    points = interpolate_line((0, 0, 0), (30.0, -40.0, 0.0), 0.3)
    np.testing.assert_allclose(axis_speeds(points, 50.0), [[30.0, -40.0, 0.0]] * 167, atol=1e-9)
    arc = interpolate_arc((0, 0), 50.0, 0.0, QUARTER, 0.3)
    speeds = axis_speeds(arc, 20.0)
    np.testing.assert_allclose(np.hypot(*speeds.T), 20.0)
    # A chord lies across the middle of its angle.
    middles = (np.arange(261) + 0.5) * step_angle(50.0, 0.3)
    np.testing.assert_allclose(speeds[:-1, 0], -20.0 * np.sin(middles), atol=1e-9)
    np.testing.assert_array_equal(axis_speeds([[1.0, 1.0], [1.0, 1.0]], 5.0), [[0.0, 0.0]])


NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: interpolate_line((0, 0), (1, 1), 0.05, 0.1), ("step of 0.05", "of 0.1")),
        (lambda: interpolate_line((0, 0), (1, 1), 0.0), ("step", "above 0")),
        (lambda: interpolate_line((0, 0), (1, 1), -0.3), ("step", "-0.3")),
        (lambda: interpolate_line((0, 0), (1, 1), NAN), ("step", "nan")),
        (lambda: interpolate_line((0, 0), (1, 1), 0.3, 0.0), ("resolution", "above 0")),
        (lambda: interpolate_line((0, NAN), (1, 1), 0.3), ("start", "finite")),
        (lambda: interpolate_line((0, 0), (1, INF), 0.3), ("end", "finite")),
        (lambda: interpolate_line((0, 0), (1, 1, 1), 0.3), ("2", "3")),
        (lambda: interpolate_line((0,), (1,), 0.3), ("start", "2 or 3")),
        (lambda: interpolate_line("here", (1, 1), 0.3), ("start", "point")),
        (lambda: interpolate_line((0, 0), (1e9, 0), 0.3), ("steps", "larger step")),
        (lambda: interpolate_arc((0, 0), 0.0, 0, 1, 0.3), ("radius", "above 0")),
        (lambda: interpolate_arc((0, 0), -5.0, 0, 1, 0.3), ("radius", "-5")),
        (lambda: interpolate_arc((0, 0), 5.0, NAN, 1, 0.3), ("start angle", "finite")),
        (lambda: interpolate_arc((0, 0), 5.0, 0, INF, 0.3), ("sweep", "finite")),
        (lambda: interpolate_arc((0, 0, 0), 5.0, 0, 1, 0.3), ("centre", "2 numbers")),
        (lambda: interpolate_arc((0, 0), None, 0, 1, 0.3), ("radius", "None")),
        (lambda: arc_through((0, 0), (3, 4), (0, 6.5)), ("1.5 um outside", "circle of radius 5")),
        (lambda: arc_through((0, 0), (3, 4), (0, 4)), ("1 um inside", "end")),
        (lambda: arc_through((1, 1), (1, 1), (2, 2)), ("radius", "above 0")),
        (lambda: line_steps(-1.0, 0.3), ("length", "-1")),
        (lambda: axis_speeds([[0, 0], [1, 1]], 0.0), ("feed", "above 0")),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(call, words):
    with pytest.raises(InputError) as caught:
        call()
    text = str(caught.value)
    assert "\n" not in text and text.endswith(".")
    assert all(word in text for word in words), text


def test_a_traced_argument_is_sent_to_the_function_for_it():
    with pytest.raises(TypeError, match="line_points or arc_points"):
        jax.grad(lambda r: interpolate_arc((0, 0), r, 0.0, 1.0, 0.3).sum())(5.0)
