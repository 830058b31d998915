"""Feeds found through the simulator, against surfaces whose feeds are known."""

import itertools
import math

import numpy as np
import pytest

from calibration.plans.schedule import Machine, exact_schedule
from calibration.plans.simulated_outlook import Belief, electrode_changes, touch_offs
from calibration.plans.simulated_schedule import SimulationSettings, simulated_schedule
from calibration.plans.simulated_search import search_feeds
from calibration.wear_surface_model import CavityModel
from procmodel.errors import InputError
from procmodel.wear import Hemisphere
from procmodel.wear.feed_law import layer_feeds
from procmodel.wear.layer_path import ElectrodeSection, LayerPath
from procmodel.wear.scanning import scan_layers
from procmodel.wear.slicing import slices_of_solid
from procmodel.wear.surface_error import cleared_cells, surface_error
from procmodel.wear.zmap import simulate

SQUARE = ElectrodeSection("square", 6.0)
BOUNDS = (0.1, 50.0)


def stairs(layers=4):
    """Lines that get shorter from layer to layer: every layer leaves its own step."""
    paths = []
    for n in range(layers):
        half = 12.0 - 3.0 * n
        points = np.array([(-half, 0.0), (half, 0.0), (-half, 0.0)])
        paths.append(LayerPath(points, np.ones(2, bool)))
    return paths


def staircase():
    return CavityModel.of(stairs(), SQUARE, 1.0, wear_mode="uniform")


@pytest.mark.slow
def test_the_feeds_that_made_a_surface_are_found_again():
    model, feeds = staircase(), np.array([3.0, 4.0, 2.0, 5.0])
    target = np.asarray(model.depth(feeds, 0.3))
    seen = []
    found = search_feeds(
        model, {}, target, np.array([0.3]), np.full(4, 3.0), BOUNDS, 0.0, 60,
        lambda count, rms: seen.append((count, rms)),
    )  # fmt: skip
    before = surface_error(model.depth(np.full(4, 3.0), 0.3), target)
    after = surface_error(model.depth(found.feeds, 0.3), target)
    assert after.rms < 0.02 * before.rms
    np.testing.assert_allclose(np.sum(found.feeds), np.sum(feeds), atol=0.1)
    assert [count for count, _ in seen] == list(range(1, found.evaluations + 1))
    assert seen[0][1] == pytest.approx(before.rms, rel=1e-9)


@pytest.mark.parametrize("stay", [0.0, 4.0])
def test_a_plunge_for_all_that_is_believed_has_a_closed_form(stay):
    # The depth of a plunge is f / (1 + R): the best feed follows from the means of two powers.
    path = LayerPath(np.zeros((1, 2)), np.zeros(0, bool))
    model = CavityModel.of([path], SQUARE, 1.0, wear_mode="uniform")
    ratios, wanted, begin = np.array([0.05, 0.1, 2.0]), 10.0, 8.0
    target = np.where(np.asarray(model.depth(np.ones(1), 0.0)) > 0, wanted, 0.0)
    found = search_feeds(
        model, {}, target, ratios, np.array([begin]), BOUNDS, stay, 60, None
    )  # fmt: skip
    share = 1.0 / (1.0 + ratios)
    weight = (stay / begin) ** 2
    best = (wanted * share.mean() + weight * begin) / (np.mean(share**2) + weight)
    assert found.converged
    assert found.feeds[0] == pytest.approx(best, rel=2e-3)
    # Negative control: that is neither the feed for the middle of the belief nor for its mean.
    assert abs(best / (wanted * 1.1) - 1.0) > 0.01
    assert abs(best / (wanted / share.mean()) - 1.0) > 0.01


@pytest.mark.slow
def test_an_interrupt_keeps_the_best_feeds_so_far():
    model = staircase()
    target = np.asarray(model.depth(np.array([3.0, 4.0, 2.0, 5.0]), 0.3))
    heard = []

    def progress(count, rms):
        heard.append(rms)
        if count == 4:
            raise KeyboardInterrupt

    found = search_feeds(
        model, {}, target, np.array([0.3]), np.full(4, 3.0), BOUNDS, 0.0, 60, progress
    )  # fmt: skip
    assert not found.converged
    assert found.why == "stopped by hand after 4 evaluations"
    reached = surface_error(model.depth(found.feeds, 0.3), target).rms
    assert reached == pytest.approx(min(heard), rel=1e-9)


@pytest.fixture(scope="module")
def bowl():
    """A hemisphere of 24 um radius in layers of 3 um, and its exact schedule."""
    electrode = ElectrodeSection("round", 10.0)
    slices = slices_of_solid(Hemisphere(24.0), np.arange(3.0, 22.0, 3.0))
    paths = scan_layers(slices, electrode)
    schedule = exact_schedule(slices.target_layers(electrode), 0.1, electrode.area)
    return paths, electrode, schedule


@pytest.mark.slow
def test_a_bowl_comes_out_nearer_than_by_the_exact_schedule(bowl):
    paths, electrode, schedule = bowl
    draws = np.random.default_rng(0).normal(0.1, 0.005, 2000)
    settings = SimulationSettings(1.0, 2.0, step=2.0, wear_mode="uniform")
    machine = Machine(resolution=0.5, usable_length=15.0)
    bounds = (1.0, 12.0)
    plan = simulated_schedule(
        paths, Hemisphere(24.0), electrode, draws, schedule, settings, machine, feed_bounds=bounds
    )
    assert plan.after.expected_rms < 0.9 * plan.before.expected_rms
    np.testing.assert_allclose(plan.cumulative_feed % 0.5, 0.0, atol=1e-9)
    told = np.diff(plan.cumulative_feed, prepend=0.0)
    assert np.all((told >= bounds[0] - 1e-9) & (told <= bounds[1] + 1e-9))
    assert np.all(np.diff(plan.wear_ratios) > 0)
    assert len(plan.wear_ratios) == 3
    # The target ends with the schedule's last layer.
    assert np.max(plan.target) == 21.0
    # What is said of the start comes out of simulations by hand.
    model = settings.model(paths, electrode, 1.0)
    rounded = np.diff(0.5 * np.round(np.cumsum(schedule.feeds) / 0.5), prepend=0.0)
    runs = [
        simulate(
            model.steps, layer_feeds(model.steps, rounded), model.electrode, model.workpiece, ratio,
            wear_mode="uniform",
        )
        for ratio in plan.wear_ratios
    ]  # fmt: skip
    region = cleared_cells(np.max([run.depth for run in runs], axis=0), plan.target)
    errors = [surface_error(run.depth, plan.target, region) for run in runs]
    by_hand = math.sqrt(np.mean([e.rms**2 for e in errors]))
    assert plan.before.expected_rms == pytest.approx(by_hand, rel=1e-9)
    assert plan.before.middle.max == pytest.approx(errors[1].max, rel=1e-9)
    assert plan.before.rms_limit >= max(e.rms for e in errors)
    np.testing.assert_allclose(plan.before.tip_loss, runs[1].greatest_loss, rtol=1e-9)
    # The tip loses more than one usable length, and less than three.
    assert plan.electrodes == math.ceil(plan.after.tip_loss_limit[-1] / 15.0)
    assert plan.electrodes in (2, 3)
    figures = plan.as_dict()
    assert figures["after"]["error_rms"] == plan.after.expected_rms
    assert figures["electrodes"] == plan.electrodes
    assert "cells of 2 um, judged with 1 um" in plan.status


def test_a_belief_is_its_quantiles():
    draws = np.random.default_rng(1).uniform(0.0, 1.0, 200_000)
    belief = Belief.of(draws, 3)
    np.testing.assert_allclose(belief.nodes, [1 / 6, 0.5, 5 / 6], atol=5e-3)
    np.testing.assert_allclose(belief.ends, [0.025, 0.975], atol=5e-3)
    certain = Belief.of(np.array([0.2]), 3)
    assert certain.nodes.tolist() == [0.2]
    assert certain.median == 0.2


def test_touch_offs_are_the_fewest_that_keep_the_tolerance():
    rng = np.random.default_rng(2)
    for _ in range(20):
        gap = np.cumsum(rng.uniform(0.0, 1.0, 9))
        ends, tolerance = np.stack([0.0 * gap, gap]), 0.8
        found = touch_offs(ends, tolerance)

        def kept(chosen, gap=gap, tolerance=tolerance):
            known = np.concatenate([[0.0], gap])
            last = [max([0, *(c for c in chosen if c < n)]) for n in range(1, 10)]
            return np.all(0.5 * (gap - known[last]) <= tolerance)

        assert kept(found)
        fewer = itertools.combinations(range(1, 10), max(len(found) - 1, 0))
        assert not found or not any(kept(chosen) for chosen in fewer)
    assert touch_offs(np.zeros((2, 5)), 0.1) == ()


def test_electrodes_are_changed_before_the_layer_that_would_use_them_up():
    loss = np.array([4.0, 7.0, 12.0, 15.0])
    assert electrode_changes(loss, 8.0) == (3,)
    assert electrode_changes(loss, 15.0) == ()
    assert electrode_changes(loss, None) == ()
    with pytest.raises(InputError, match="layer 3 alone may wear 5 um"):
        electrode_changes(loss, 4.5)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"start": np.ones(3)}, r"shape \(3,\) for 7 paths"),
        ({"start": np.array([1.0, 0.0, 1, 1, 1, 1, 1])}, "feed of layer 2 must be"),
        ({"wear_ratio": -0.1}, "wear ratio -0.1 is below 0"),
        ({"feed_bounds": (5.0, 2.0)}, "feed bounds"),
        ({"target_depth": -1.0}, "depth -1 um"),
        ({"settings": SimulationSettings(2.0, wear_mode="spread")}, "needs a spread width"),
        ({"settings": SimulationSettings(8.0)}, "cell 8 um is larger than half"),
    ],
)
def test_bad_plans_are_named(bowl, changed, words):
    paths, electrode, schedule = bowl
    arguments = {
        "wear_ratio": 0.1,
        "start": schedule,
        "settings": SimulationSettings(2.0),
        **changed,
    }
    with pytest.raises(InputError, match=words):
        simulated_schedule(paths, Hemisphere(24.0), electrode, **arguments)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"cell": 0.0}, "cell 0 um"),
        ({"cell": 1.0, "plan_cell": -1.0}, "plan cell -1 um"),
        ({"cell": 1.0, "side_gap": -1.0}, "side gap -1 um"),
        ({"cell": 1.0, "nodes": 4}, "nodes is 4"),
        ({"cell": 1.0, "stay": -1.0}, "stay -1 um"),
        ({"cell": 1.0, "evaluations": 0}, "evaluations is 0"),
    ],
)
def test_bad_settings_are_named(values, words):
    with pytest.raises(InputError, match=words):
        SimulationSettings(**values)
