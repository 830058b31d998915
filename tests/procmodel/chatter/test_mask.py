"""Bins left out: by hand on a small spectrum, and the soft band in its limit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from procmodel.chatter.mask import (
    free_bins,
    in_band,
    listed_lines,
    mains_lines,
    rotation_lines,
    soft_band,
)
from procmodel.errors import InputError

FREQUENCIES = np.arange(0.0, 501.0)


def test_lines_of_the_rotation_by_hand():
    masked = rotation_lines(FREQUENCIES, 100.0, 2.0, 0.0, np)
    near = [f for k in range(6) for f in range(100 * k - 2, 100 * k + 3) if 0 <= f <= 500]
    np.testing.assert_array_equal(np.flatnonzero(masked), near)


def test_lines_widen_with_their_order():
    masked = rotation_lines(FREQUENCIES, 100.0, 2.0, 1.0, np)
    for order in range(1, 5):
        around = slice(100 * order - 50, 100 * order + 50)
        assert masked[around].sum() == 2 * (2 + order) + 1
    np.testing.assert_array_equal(masked, rotation_lines(jnp.asarray(FREQUENCIES), 100.0, 2.0, 1.0))


def test_lists_and_mains():
    np.testing.assert_array_equal(mains_lines(60.0, 250.0), [60.0, 120.0, 180.0, 240.0])
    masked = listed_lines(FREQUENCIES, [33.3, 400.0], 1.0)
    np.testing.assert_array_equal(np.flatnonzero(masked), [33, 34, 399, 400, 401])
    assert not listed_lines(FREQUENCIES, [], 1.0).any()


def test_free_bins_are_in_the_band_and_on_no_line():
    free = free_bins(
        FREQUENCIES, (90.0, 310.0), 100.0, 2.0, uncertainty=0.5, ignored=[250.0], mains=60.0
    )
    for f in FREQUENCIES:
        order = round(f / 100.0)
        near = abs(f - 100.0 * order) <= 2.0 + 0.5 * order
        near |= abs(f - 250.0) <= 2.0 or min(abs(f - 60.0 * k) for k in range(1, 9)) <= 2.0
        assert free[int(f)] == (90.0 <= f <= 310.0 and not near)


def test_nothing_left_is_refused():
    with pytest.raises(InputError, match="longer window"):
        free_bins(FREQUENCIES, (98.0, 102.0), 100.0, 2.0)


def test_the_soft_band_is_the_band_in_the_limit_and_has_gradients():
    hard = in_band(FREQUENCIES, 100.5, 300.5)
    np.testing.assert_allclose(soft_band(FREQUENCIES, 100.5, 300.5, 0.01, np), hard, atol=1e-12)

    def held(low):
        return jnp.sum(soft_band(jnp.asarray(FREQUENCIES), low, 300.0, 5.0))

    # Raising the edge by 1 Hz takes one bin of 1 Hz away.
    assert jax.grad(held)(100.2) == pytest.approx(-1.0, abs=1e-6)
    step = 1e-4
    slope = (held(100.2 + step) - held(100.2 - step)) / (2 * step)
    assert jax.grad(held)(100.2) == pytest.approx(float(slope), rel=1e-6)
