"""Period doubling: frequencies, statistic, and flip chatter that the distance cannot see."""

import numpy as np
import pytest

from procmodel.chatter import CHATTER, MARGINAL, STABLE, detect
from procmodel.chatter.subharmonic import (
    CuttingReference,
    added,
    growth_over_reference,
    half_tooth_frequencies,
    line_powers,
    lines_in,
    tooth_frequencies,
)
from tests.procmodel.chatter.shapes import ROTATION, air, detector, line, noise, stable_cut

ONSET, SECONDS = 4.0, 8.0
FLIP = 5 * ROTATION


def test_frequencies_of_two_and_of_three_teeth():
    np.testing.assert_allclose(half_tooth_frequencies(10.0, 2, 15.0, 75.0), [30.0, 50.0, 70.0])
    np.testing.assert_allclose(tooth_frequencies(10.0, 2, 15.0, 75.0), [20.0, 40.0, 60.0])
    # Of an odd number of teeth they lie between the multiples of the rotation.
    np.testing.assert_allclose(half_tooth_frequencies(10.0, 3, 0.0, 80.0), [15.0, 45.0, 75.0])


def test_power_of_lines_by_hand():
    frequencies = np.arange(20.0)
    usable = frequencies != 16
    lines = lines_in(frequencies, np.array([5.0, 15.0, 10.5]), 1.0, 0.0, usable)
    np.testing.assert_array_equal(lines.frequencies, [5.0, 10.5])
    spectrum = frequencies**2
    np.testing.assert_allclose(line_powers(spectrum, lines, np), [16 + 25 + 36, 100 + 121])
    wider = lines_in(frequencies, np.array([10.0]), 1.0, 0.1)
    assert line_powers(np.ones(20), wider) == 5.0


def test_the_reference_is_the_mean():
    rng = np.random.default_rng(0)
    half, tooth = rng.random((6, 2, 3)), rng.random((6, 2))
    reference = None
    for h, t in zip(half, tooth, strict=True):
        reference = added(reference, h, t)
    np.testing.assert_allclose(reference.half, half.mean(axis=0))
    np.testing.assert_allclose(reference.tooth, tooth.mean(axis=0))
    assert reference.windows == 6


def test_the_statistic_by_hand():
    reference = CuttingReference(8, np.array([[2.0, 1.0, 0.0]]), np.array([10.0]))
    floor = np.array([[0.0, 4.0, 0.0]])
    half = np.array([[8.0, 8.0, 8.0]])
    found = growth_over_reference(half, np.array([10.0]), reference, floor, np)
    np.testing.assert_allclose(found, [[4.0, 2.0, 0.0]])
    # A deeper cut raises all lines; a shallower one does not make the rest look larger.
    deeper = growth_over_reference(4 * half, np.array([40.0]), reference, floor)
    np.testing.assert_allclose(deeper, found)
    shallower = growth_over_reference(half, np.array([1.0]), reference, floor)
    np.testing.assert_allclose(shallower, found)


def grown(amplitude=2.0, rate=8.0, start=0.005):
    """Nothing before the onset, then growth from almost nothing to what the cut can hold."""

    def height(time):
        since = np.maximum(time - ONSET, 0.0)
        return np.where(time < ONSET, 0.0, np.minimum(start * np.exp(rate * since), amplitude))

    return height


@pytest.fixture(scope="module")
def baseline():
    return air()


@pytest.fixture(scope="module")
def flip():
    samples = stable_cut(SECONDS, 7)
    return samples + line(samples, FLIP, grown())


def test_the_distance_does_not_see_flip_chatter(baseline, flip):
    found = detect(detector(baseline), flip)
    assert found.events == ()
    assert {o.outcome for o in found.observations[2:]} == {STABLE}


def test_the_second_statistic_does(baseline, flip):
    found = detect(detector(baseline, teeth=2), flip)
    assert len(found.events) == 1
    (event,) = found.events
    assert (event.statistic, event.state) == ("subharmonic", CHATTER)
    assert event.frequency_hz == pytest.approx(FLIP, rel=1e-4)
    # Visible when it passes the runout's third of the amplitude 1, after 0.5 s; full after 0.75 s.
    assert ONSET + 0.5 < event.time_s < ONSET + 1.0
    assert event.growth_rate > 2.0
    judged = [o for o in found.observations if o.outcome]
    assert {o.outcome for o in judged if o.time < ONSET} == {STABLE}
    assert {o.outcome for o in judged if o.time > ONSET + 1.0} == {CHATTER}


def test_a_given_stable_cut_finds_what_was_there_from_the_beginning(baseline):
    samples = stable_cut(SECONDS, 8)
    from_the_start = samples + line(samples, FLIP, 2.0)
    alone = detect(detector(baseline, teeth=2), from_the_start)
    assert alone.events == ()
    stable = air(seed=9, amplitude=1.0)
    known = detect(detector(baseline, stable, teeth=2), from_the_start)
    assert known.events[0].statistic == "subharmonic"
    assert known.events[0].time_s < 1.0
    # The same cut without it is stable.
    assert detect(detector(baseline, stable, teeth=2), samples).events == ()


@pytest.mark.parametrize("seed", range(3))
def test_steady_runout_is_not_flagged(baseline, seed):
    found = detect(detector(baseline, teeth=2), stable_cut(SECONDS, 20 + seed))
    assert found.events == ()
    assert not {o.outcome for o in found.observations} & {CHATTER, MARGINAL}


def test_runout_in_a_cut_that_deepens_is_not_flagged(baseline):
    samples = noise(SECONDS, 11)
    deepening = np.linspace(1.0, 6.0, len(samples))[:, None]
    samples = samples + deepening * (stable_cut(SECONDS, 11) - samples)
    settings = {"threshold": 1e9, "averaged_threshold": None, "teeth": 2}
    found = detect(detector(baseline, **settings), samples)
    assert found.events == ()
    # The lines themselves grow to 36 times their power, which without their like would be flagged.
    largest = max(o.subharmonic for o in found.observations if o.subharmonic is not None)
    assert largest < 10.0


def test_an_odd_number_of_teeth_hides_nothing(baseline):
    samples = stable_cut(SECONDS, 12)
    samples = samples + line(samples, 4.5 * ROTATION, grown())
    found = detect(detector(baseline), samples)
    assert found.events[0].statistic in ("distance", "averaged distance")
    assert found.events[0].frequency_hz == pytest.approx(4.5 * ROTATION, rel=1e-2)
