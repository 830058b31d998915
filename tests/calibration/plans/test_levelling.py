"""Levelling passes: the known feeds are found, better than neighbours, in the machine's steps."""

import jax.numpy as jnp
import numpy as np
import pytest

from calibration.plans.levelling import levelling_passes
from procmodel.errors import InputError
from procmodel.wear.tilt import tilted_layers


def bottom_after(feeds, u, layers=30, pieces=100):
    """Depth along the path, the layers before fed by 1."""
    all_feeds = np.concatenate([np.ones(layers), feeds])
    forward = np.arange(len(all_feeds)) % 2 == 0
    return tilted_layers(all_feeds, u, forward, pieces).depth[-1]


def test_the_known_feeds_are_found():
    plan = levelling_passes(2.0, 1.0, 4)
    np.testing.assert_allclose(plan.feeds / 2.0, [0.50, 0.20, 0.08, 0.03], atol=0.006)
    assert plan.tilt_before / 2.0 == pytest.approx(0.5, abs=0.01)
    assert plan.tilt / 2.0 < 0.02
    assert plan.tilt == pytest.approx(2.0 * float(np.ptp(bottom_after(plan.feeds / 2.0, 1.0))))
    assert np.ptp(plan.bottom) == pytest.approx(plan.tilt)
    assert np.ptp(plan.bottom_before) == pytest.approx(plan.tilt_before)


@pytest.mark.parametrize("u", [0.5, 2.0])
def test_other_feeds_level_worse(u):
    plan = levelling_passes(1.0, u, 3)
    best = float(jnp.var(bottom_after(plan.feeds, u)))
    rng = np.random.default_rng(1)
    for _ in range(30):
        other = plan.feeds * np.exp(0.1 * rng.normal(size=3))
        assert float(jnp.var(bottom_after(other, u))) > 0.999 * best


def test_equal_feeds_do_not_level():
    # The control: passes alone do nothing, falling feeds do.
    assert float(np.ptp(bottom_after(np.full(4, 1.0), 1.0))) > 0.45


def test_depth_added_is_that_of_the_bottom():
    plan = levelling_passes(1.0, 1.0, 4)
    before, after = bottom_after([], 1.0), bottom_after(plan.feeds, 1.0)
    assert plan.depth_added == pytest.approx(float(after.mean() - before.mean()), abs=1e-4)


def test_feeds_are_whole_steps_of_the_machine():
    plan = levelling_passes(2.0, 1.0, 4, resolution=0.1)
    steps = plan.feeds / 0.1
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.all(plan.feeds >= 0.1 - 1e-12)
    assert plan.tilt / 2.0 < 0.04


def test_uncertain_wear_widens_the_limit():
    draws = np.random.default_rng(2).normal(1.0, 0.15, 400)
    plan = levelling_passes(1.0, draws, 4)
    known = levelling_passes(1.0, 1.0, 4)
    assert plan.tilt_limit > 2.0 * known.tilt_limit
    # Levelled for all of them: worse at the middle, better on the whole.
    every = np.quantile(draws, np.linspace(0.05, 0.95, 10))
    whole = [
        np.mean([np.var(bottom_after(feeds, u)) for u in every])
        for feeds in (plan.feeds, known.feeds)
    ]
    assert whole[0] < whole[1]
    assert plan.tilt > known.tilt


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0.0, 1.0), "feed is 0 um"),
        ((1.0, 0.0), "relative wear is 0 to 0"),
        ((1.0, 50.0), "at most 20"),
        ((1.0, 1.0, 0), "levelling passes is 0"),
    ],
)
def test_refusals(arguments, words):
    with pytest.raises(InputError, match=words):
        levelling_passes(*arguments)
    with pytest.raises(InputError, match="resolution is 1 um"):
        levelling_passes(1.0, 1.0, resolution=1.0)
