"""Power spectra: Parseval, an independent implementation, white noise, both array modules."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from procmodel.chatter.spectrum import (
    TAPERS,
    Windowing,
    averaged,
    frequencies,
    power_spectra,
    taper,
    windows_of,
)
from procmodel.errors import InputError


@pytest.mark.parametrize("name", TAPERS)
@pytest.mark.parametrize("n", [8, 9, 1000, 4096])
def test_parseval(name, n):
    windows = np.random.default_rng(n).normal(3.0, 1.0, size=(4, 2, n))
    weights = taper(name, n, np)
    powers = power_spectra(windows, weights, np).sum(axis=-1)
    mean_squares = ((windows * weights) ** 2).sum(axis=-1) / (weights**2).sum()
    np.testing.assert_allclose(powers, mean_squares, rtol=1e-13)


@pytest.mark.parametrize("name", TAPERS)
@pytest.mark.parametrize("n", [255, 256])
def test_against_scipy(name, n):
    window = np.random.default_rng(0).normal(size=n)
    weights = taper(name, n, np)
    np.testing.assert_allclose(
        weights, scipy.signal.get_window("boxcar" if name == "rectangular" else name, n), atol=1e-15
    )
    found, density = scipy.signal.periodogram(window, 1000.0, window=weights, detrend=False)
    np.testing.assert_allclose(frequencies(n, 1000.0, np), found)
    expected = density * 1000.0 / n
    np.testing.assert_allclose(power_spectra(window, weights, np), expected, rtol=1e-10)
    np.testing.assert_allclose(power_spectra(jnp.asarray(window), weights), expected, rtol=1e-9)


def test_a_line_on_a_bin_holds_half_its_squared_amplitude():
    n, amplitude = 512, 3.0
    wave = amplitude * np.cos(2.0 * np.pi * 37 * np.arange(n) / n + 0.3)
    spectrum = power_spectra(wave, taper("rectangular", n, np), np)
    assert spectrum[37] == pytest.approx(0.5 * amplitude**2)
    assert np.delete(spectrum, 37).max() < 1e-25
    # The Hann taper spreads it over three bins as 1 : 4 : 1.
    spread = power_spectra(wave, taper("hann", n, np), np)
    np.testing.assert_allclose(spread[36:39], np.array([1, 4, 1]) / 6 * 0.5 * amplitude**2)


def test_gradient_against_finite_differences():
    window = jnp.asarray(np.random.default_rng(1).normal(size=32))
    weights = taper("hann", 32)

    def power(x):
        return power_spectra(x, weights)[5]

    slope = jax.jit(jax.grad(power))(window)
    step = 1e-6
    for i in (0, 7, 31):
        e = jnp.zeros(32).at[i].set(step)
        assert slope[i] == pytest.approx(
            float(power(window + e) - power(window - e)) / (2 * step), rel=1e-6, abs=1e-10
        )


@pytest.mark.parametrize(("n", "hop"), [(16, 16), (16, 8), (16, 5), (16, 40)])
def test_windows_are_the_samples_one_after_the_other(n, hop):
    samples = np.arange(2 * 103.0).reshape(-1, 2)
    windows = windows_of(samples, n, hop)
    assert len(windows) == Windowing(1.0, n, hop).count(len(samples))
    for i, window in enumerate(windows):
        np.testing.assert_array_equal(window.T, samples[i * hop : i * hop + n])
    assert (len(windows) - 1) * hop + n <= len(samples) < len(windows) * hop + n
    assert windows_of(samples[: n - 1], n, hop).shape == (0, 2, n)


def test_averages_are_means_of_successive_spectra():
    spectra = np.random.default_rng(2).normal(size=(7, 2, 5))
    expected = [spectra[i : i + 3].mean(axis=0) for i in range(5)]
    np.testing.assert_allclose(averaged(spectra, 3, np), expected, rtol=1e-13)
    assert averaged(spectra, 8, np).shape == (0, 2, 5)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"rate": 0.0}, "rate"),
        ({"rate": np.nan}, "rate"),
        ({"length": 4}, "window"),
        ({"hop": 0}, "hop"),
        ({"taper": "han"}, "did you mean 'hann'"),
    ],
)
def test_a_bad_windowing_is_refused(changes, named):
    with pytest.raises(InputError, match=named):
        Windowing(**{"rate": 1000.0, "length": 64, **changes})
