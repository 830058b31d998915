"""The true rotation frequency: found where the nominal one is off, and not where there is none."""

import numpy as np
import pytest

from procmodel.chatter.mask import rotation_lines
from procmodel.chatter.rotation import FOUND, NOT_FOUND, STATUS, refined_rotation, rotation_of
from procmodel.chatter.spectrum import Windowing, power_spectra, taper, windows_of
from procmodel.errors import InputError
from tests.procmodel.chatter.shapes import RATE, ROTATION, forced, noise, windowing


def mean_spectrum(samples, cut):
    windows = windows_of(samples, cut.length, cut.step)
    return power_spectra(windows, taper(cut.taper, cut.length, np), np).mean(axis=0)


@pytest.mark.parametrize("slip", [-0.008, -0.0013, 0.0, 0.004])
@pytest.mark.parametrize("kind", ["hann", "rectangular"])
def test_a_slipping_spindle_is_found(slip, kind):
    true = ROTATION * (1.0 + slip)
    samples = noise(3.0, 0)
    samples = samples + forced(samples, true, 0.2)
    cut = windowing(taper=kind)
    found = refined_rotation(mean_spectrum(samples, cut), cut, ROTATION)
    assert found.status == FOUND and len(found.orders) > 20
    # A hundredth of a bin at the highest order.
    assert abs(found.frequency - true) * max(found.orders) < 0.1 * cut.resolution
    assert abs(found.frequency - true) < 4.0 * found.uncertainty


def test_the_uncertainty_covers_the_error():
    cut, off = windowing(), []
    for seed in range(40):
        true = ROTATION * (1.0 + 0.005 * np.sin(seed))
        samples = noise(1.5, seed)
        samples = samples + forced(samples, true, 0.15)
        found = refined_rotation(mean_spectrum(samples, cut), cut, ROTATION)
        off.append(abs(found.frequency - true) / found.uncertainty)
    assert np.mean(np.array(off) < 2.0) > 0.9


def test_the_nominal_speed_does_not_mask_the_high_orders():
    cut = windowing()
    true, order = ROTATION * 1.004, 40
    samples = noise(3.0, 0)
    samples = samples + forced(samples, true, 0.2)
    found = refined_rotation(mean_spectrum(samples, cut), cut, ROTATION)
    bin_of = round(order * true / cut.resolution)
    width = 2.0 * cut.resolution
    assert not rotation_lines(cut.frequencies, ROTATION, width, 0.0, np)[bin_of]
    masked = rotation_lines(cut.frequencies, found.frequency, width, found.uncertainty, np)
    assert masked[bin_of]


def test_noise_has_no_rotation():
    cut = windowing()
    for seed in range(20):
        found = refined_rotation(mean_spectrum(noise(2.0, seed), cut), cut, ROTATION)
        assert found.status == NOT_FOUND and found.status in STATUS
        assert found.frequency == ROTATION
        assert found.uncertainty == pytest.approx(0.002 * ROTATION)


def test_long_windows_where_those_of_the_detector_are_too_short():
    true = 25.0 * 1.003
    samples = noise(12.0, 3)
    samples = samples + forced(samples, true, 0.2, range(1, 200))
    short = Windowing(RATE, 512)
    with pytest.raises(InputError, match="longer window"):
        refined_rotation(mean_spectrum(samples, short), short, 25.0)
    found = rotation_of(samples, RATE, 25.0)
    assert found.status == FOUND
    assert found.frequency == pytest.approx(true, rel=1e-4)


def test_several_channels_are_searched_together():
    samples = noise(3.0, 0, channels=2)
    samples[:, 1:] += forced(samples, ROTATION * 0.997, 0.2)
    cut = windowing()
    found = refined_rotation(mean_spectrum(samples, cut), cut, ROTATION)
    assert found.frequency == pytest.approx(ROTATION * 0.997, rel=1e-5)


def test_a_tolerance_out_of_range_is_refused():
    with pytest.raises(InputError, match="tolerance"):
        refined_rotation(np.ones(2049), windowing(), ROTATION, 0.5)
