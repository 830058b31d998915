"""Distances: by hand, the soft maximum and its limit, the null law against Monte Carlo."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from procmodel.chatter.baseline import Baseline, of_spectra
from procmodel.chatter.distance import distance, null_threshold, score, soft_score, vertex
from procmodel.chatter.spectrum import averaged, power_spectra, taper, windows_of
from procmodel.errors import InputError


def test_distance_by_hand():
    spectra = np.array([[[1.0, 4.0, 7.0]], [[3.0, 4.0, 1.0]]])
    baseline = of_spectra(spectra, np)
    # Means 2, 4, 4; deviations sqrt(2), 0, sqrt(18).
    found = distance(np.array([[5.0, 9.0, 1.0]]), baseline, np)
    np.testing.assert_allclose(found, [[3.0 / math.sqrt(2.0), 0.0, -3.0 / math.sqrt(18.0)]])
    assert score(found, np.array([False, True, True]), np) == 0.0


def test_the_gradient_survives_a_bin_that_does_not_vary():
    baseline = Baseline(3, jnp.array([[1.0, 2.0]]), jnp.array([[2.0, 0.0]]))
    slope = jax.grad(lambda m: jnp.sum(distance(jnp.ones((1, 2)), baseline._replace(squares=m))))(
        baseline.squares
    )
    assert np.isfinite(np.asarray(slope)).all()


@pytest.fixture(scope="module")
def distances():
    return jnp.asarray(np.random.default_rng(0).exponential(10.0, size=(3, 50)))


def test_the_soft_score_tends_to_the_score(distances):
    free = jnp.arange(50) % 3 != 0
    largest = score(distances, free)
    for temperature in (3.0, 0.3, 0.03):
        soft = soft_score(distances, free.astype(float), temperature)
        assert (soft >= largest).all()
        assert (soft <= largest + temperature * math.log(int(free.sum()))).all()
    np.testing.assert_allclose(soft_score(distances, 1.0 * free, 1e-6), largest, atol=1e-12)
    soft = soft_score(np.asarray(distances), np.asarray(free) * 1.0, 3.0, np)
    np.testing.assert_allclose(soft, soft_score(distances, 1.0 * free, 3.0), rtol=1e-12)


def test_the_soft_score_does_not_overflow(distances):
    assert np.isfinite(soft_score(1e6 * distances, jnp.ones(50), 1.0)).all()


def test_gradients_of_the_soft_score(distances):
    weights = jnp.linspace(0.0, 1.0, 50)

    def total(d, w, t):
        return jnp.sum(soft_score(d, w, t))

    slopes = jax.jit(jax.grad(total, argnums=(0, 1, 2)))(distances, weights, 20.0)
    assert all(np.isfinite(np.asarray(s)).all() for s in slopes)
    assert (slopes[0][:, 0] == 0.0).all()
    # It moves with the distances when all of them move.
    np.testing.assert_allclose(slopes[0].sum(axis=1), 1.0, rtol=1e-12)
    step, e = 1e-5, jnp.zeros(50).at[7].set(1e-5)
    up, down = total(distances, weights + e, 20.0), total(distances, weights - e, 20.0)
    assert slopes[1][7] == pytest.approx(float(up - down) / (2 * step), rel=1e-6)
    up, down = total(distances, weights, 20.0 + step), total(distances, weights, 20.0 - step)
    assert slopes[2] == pytest.approx(float(up - down) / (2 * step), rel=1e-6)


@pytest.mark.parametrize("kind", ["hann", "rectangular"])
def test_the_vertex_finds_a_line_between_bins(kind):
    n = 1024
    # The parabola's known bias: of the Hann lobe a fiftieth of a bin, of the rectangular a sixth.
    bound = 0.02 if kind == "hann" else 0.17
    for place in np.linspace(100.0, 101.0, 21):
        wave = np.cos(2.0 * np.pi * place * np.arange(n) / n)
        spectrum = power_spectra(wave, taper(kind, n, np), np)
        k = int(np.argmax(spectrum))
        off = vertex(spectrum[k - 1], spectrum[k], spectrum[k + 1], np)
        assert abs(k + off - place) < bound


def test_the_vertex_beside_something_larger_stays_in_its_bin():
    assert vertex(1.0, 2.0, 50.0, np) == 0.5
    assert vertex(50.0, 2.0, 1.0, np) == -0.5
    assert vertex(0.0, 2.0, 1.0, np) == 0.0


def test_the_null_threshold_of_the_notes():
    assert null_threshold(25, 616, 0.01) == pytest.approx(13.9, abs=0.05)
    assert null_threshold(25, 616, 0.001) == pytest.approx(17.6, abs=0.05)


@pytest.mark.parametrize("alpha", [0.5, 1e-3, 1e-12])
@pytest.mark.parametrize("m", [1, 5])
def test_the_null_threshold_against_the_quantile_of_f(alpha, m):
    found = null_threshold(25, 616, alpha, m)
    per_bin = scipy.stats.f.sf(found, 2 * m, 50)
    assert -math.expm1(616 * math.log1p(-per_bin)) == pytest.approx(alpha, rel=1e-9)
    # Of a baseline known exactly the law is the exponential's.
    known = null_threshold(10**9, 616, alpha)
    assert known == pytest.approx(-math.log(-math.expm1(math.log1p(-alpha) / 616)), rel=1e-6)


@pytest.fixture(scope="module")
def exceedances():
    """Rates at which noise passes thresholds: trials of 25 spectra of air and 5 of the same noise.

    The record goes the whole way: white noise, windows of 1234 samples, spectra, 616 free bins.
    """
    rng = np.random.default_rng(5)
    n, count, m, trials = 1234, 25, 5, 3000
    weights = taper("rectangular", n, np)
    ones, means = [], []
    for _ in range(trials):
        samples = rng.standard_normal(((count + m) * n, 1))
        spectra = power_spectra(windows_of(samples, n, n), weights, np)[:, 0, 1:617]
        air = spectra[:count].mean(axis=0)
        ones.append((spectra[count] / air).max())
        means.append((averaged(spectra[count:], m, np)[0] / air).max())
    return np.array(ones), np.array(means)


def within(rate, alpha, trials=3000):
    """Four standard deviations of the binomial."""
    return abs(rate - alpha) < 4.0 * math.sqrt(alpha * (1.0 - alpha) / trials)


@pytest.mark.parametrize("alpha", [0.5, 0.1, 0.01])
def test_noise_passes_the_null_threshold_as_often_as_stated(exceedances, alpha):
    ones, means = exceedances
    assert within((ones > null_threshold(25, 616, alpha)).mean(), alpha)
    assert within((means > null_threshold(25, 616, alpha, 5)).mean(), alpha)


def test_wrong_null_laws_are_told_apart(exceedances):
    ones, means = exceedances
    # A baseline taken for exact, a tenth of the bins, one spectrum instead of five.
    assert not within((ones > null_threshold(10**6, 616, 0.01)).mean(), 0.01)
    assert not within((ones > null_threshold(25, 62, 0.01)).mean(), 0.01)
    assert not within((means > null_threshold(25, 616, 0.01)).mean(), 0.01)


@pytest.mark.parametrize("values", [(0, 616, 0.01), (25, 0, 0.01), (25, 616, 0.0), (25, 616, 1.0)])
def test_a_null_threshold_without_sense_is_refused(values):
    with pytest.raises(InputError):
        null_threshold(*values)
