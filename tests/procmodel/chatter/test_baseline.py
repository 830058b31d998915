"""Baselines: one pass equals two passes, in any order of parts."""

import jax
import numpy as np
import pytest

from procmodel.chatter.baseline import (
    Baseline,
    air_cut,
    deviation,
    empty,
    merged,
    of_spectra,
    updated,
)
from procmodel.chatter.spectrum import Windowing, power_spectra, taper, windows_of
from procmodel.errors import InputError


@pytest.fixture(scope="module")
def spectra():
    # A mean far above the deviation is where sums of squares would lose their digits.
    return 1e6 + np.random.default_rng(0).exponential(size=(41, 3, 17))


def check(baseline, spectra):
    assert baseline.count == len(spectra)
    np.testing.assert_allclose(baseline.mean, spectra.mean(axis=0), rtol=1e-14)
    # Rounding of samples of 1e6 leaves 1e-9 of deviations of 1.
    np.testing.assert_allclose(deviation(baseline, np), spectra.std(axis=0, ddof=1), rtol=1e-8)


def test_one_at_a_time_equals_two_passes(spectra):
    baseline = empty(3, 17, np)
    for spectrum in spectra:
        baseline = updated(baseline, spectrum)
    check(baseline, spectra)


def test_the_naive_sum_of_squares_would_not(spectra):
    n = len(spectra)
    variance = ((spectra**2).sum(axis=0) - n * spectra.mean(axis=0) ** 2) / (n - 1)
    off = np.abs(variance / spectra.var(axis=0, ddof=1) - 1.0)
    assert off.max() > 1e-5


@pytest.mark.parametrize("cuts", [(0,), (1,), (40,), (5, 20), (3, 3, 17)])
def test_merged_parts_equal_the_whole(spectra, cuts):
    baseline = empty(3, 17, np)
    for part in np.split(spectra, cuts):
        if len(part):
            baseline = merged(baseline, of_spectra(part, np))
    check(merged(empty(3, 17, np), baseline), spectra)
    check(merged(baseline, empty(3, 17, np)), spectra)


def test_under_scan(spectra):
    first = Baseline(0.0, np.zeros((3, 17)), np.zeros((3, 17)))
    baseline, _ = jax.lax.scan(lambda b, x: (updated(b, x), None), first, spectra)
    check(baseline, spectra)


def test_air_cut_of_a_record():
    windowing = Windowing(1000.0, 64, 24)
    samples = np.random.default_rng(1).normal(size=(70000, 2))
    air = air_cut(samples, windowing, 30.0, ("x", "y"))
    windows = windows_of(samples, 64, 24)
    check(air.baseline, power_spectra(windows, taper("hann", 64, np), np))
    assert air.channels == ("x", "y")
    assert air_cut(samples[:, 0], windowing, 30.0).channels == ("channel 1",)


@pytest.mark.parametrize(
    ("samples", "rotation", "channels", "named"),
    [
        (np.ones((64, 1)), 30.0, None, "two windows"),
        (np.where(np.arange(200) == 150, np.nan, 1.0), 30.0, None, "sample 151"),
        (np.ones((200, 2)), 30.0, ("x",), "1 names are given for 2 channels"),
        (np.ones((200, 1)), 0.0, None, "rotation"),
    ],
)
def test_what_gives_no_baseline_is_refused(samples, rotation, channels, named):
    with pytest.raises(InputError, match=named):
        air_cut(samples, Windowing(1000.0, 64), rotation, channels)


def test_one_spectrum_has_no_deviation():
    with pytest.raises(InputError, match="at least 2"):
        deviation(of_spectra(np.ones((1, 1, 4)), np), np)
