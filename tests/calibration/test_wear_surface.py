"""Fits of a simulated surface: known values found again, and what a map cannot tell."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binom

from calibration.wear_surface import SurfaceModel, fit_surface
from calibration.wear_surface_columns import one_by_one
from calibration.wear_surface_model import CavityModel
from procmodel.errors import InputError
from procmodel.io.height_maps import HeightMap
from procmodel.wear.layer_path import ElectrodeSection, LayerPath

TRUTH = {"wear_ratio": 0.15, "side_gap": 1.3, "bottom_gap": 0.0, "spread_width": 1.5}
NOISE = 0.05
UNKNOWN = ("wear_ratio", "side_gap", "spread_width")
SQUARE = ElectrodeSection("square", 6.0)


def raster(layers, half=(6.0, 3.0)):
    """Three lines, every layer the same way: the bottom stays tilted."""
    a, b = half
    points = np.array([(-a, -b), (a, -b), (a, 0.0), (-a, 0.0), (-a, b), (a, b)])
    return [LayerPath(points, np.ones(5, bool))] * layers


def model(mode, paths=None, feed=4.0, reach=2.0):
    paths = raster(5) if paths is None else paths
    cavity = CavityModel.of(paths, SQUARE, 1.0, reach=reach, wear_mode=mode)
    return SurfaceModel(cavity, np.full(len(paths), feed))


def surface(one, **changed):
    values = {name: jnp.asarray(v) for name, v in {**TRUTH, **changed}.items()}
    return np.asarray(jax.jit(one.depth)(values))


def height_map(one, depth, seed=None, sigma=None):
    x, y = np.meshgrid(one.cavity.workpiece.x, one.cavity.workpiece.y, indexing="ij")
    noise = 0.0 if seed is None else NOISE * np.random.default_rng(seed).normal(size=depth.shape)
    spread = None if sigma is None else np.full(depth.size, sigma)
    return HeightMap(x.ravel(), y.ravel(), (depth + noise).ravel(), spread)


@pytest.fixture(scope="module")
def spread():
    return model("spread")


@pytest.fixture(scope="module")
def clean(spread):
    return surface(spread)


@pytest.mark.slow
def test_values_come_back_from_a_noisy_map(spread, clean):
    measured = height_map(spread, clean, seed=1)
    found = fit_surface(measured, spread, UNKNOWN)
    assert found.result.converged
    assert found.told == UNKNOWN
    for name in UNKNOWN:
        estimate = found.result.parameters[name]
        low, high = estimate.interval95
        assert low < TRUTH[name] < high
        assert high - low < 0.2 * TRUTH[name]
    # The noise was not given.
    assert found.result.noise["data"] == pytest.approx(NOISE, rel=0.1)
    rho = found.result.parameters["wear_per_area"]
    assert rho.value == pytest.approx(found.result.parameters["wear_ratio"].value / 36.0)
    assert any("electrode area of 36 um^2" in note for note in found.notes)
    np.testing.assert_allclose(found.surface, clean, atol=0.1)


@pytest.mark.slow
def test_heights_upwards_in_any_order_with_gaps(spread, clean):
    whole = height_map(spread, clean, seed=2)
    # Some places left out, others read twice, two beyond the map.
    chosen = np.random.default_rng(3).integers(len(whole.x), size=len(whole.x))
    beyond = np.array([1e3, -1e3])
    part = HeightMap(
        np.append(whole.x[chosen], beyond),
        np.append(whole.y[chosen], beyond),
        -np.append(whole.z[chosen], beyond),
    )
    found = fit_surface(part, spread, UNKNOWN)
    assert found.flipped
    assert found.left_out == 2
    assert any("2 readings lie beyond" in note for note in found.notes)
    for name in UNKNOWN:
        estimate = found.result.parameters[name]
        assert abs(estimate.value - TRUTH[name]) < 5.0 * estimate.std


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(spread, clean):
    repeats = 24
    distances = []
    for seed in range(repeats):
        result = fit_surface(height_map(spread, clean, 100 + seed), spread, UNKNOWN).result
        assert result.converged
        for name in UNKNOWN:
            estimate = result.parameters[name]
            low, high = estimate.interval95
            middle = 0.5 * (low + high)
            distances.append(abs(TRUTH[name] - middle) / (0.5 * (high - low)))
    inside = np.array(distances) < 1.0
    least, most = binom.ppf([0.001, 0.999], len(distances), 0.95)
    assert least <= inside.sum() <= most
    # Negative control: intervals half as wide would not pass.
    assert np.sum(np.array(distances) < 0.5) < least


@pytest.mark.slow
def test_a_wrong_gap_shows_in_the_misfit(spread, clean):
    measured = height_map(spread, clean, seed=4, sigma=NOISE)
    start = {"spread_width": TRUTH["spread_width"]}
    wrong = fit_surface(measured, spread, ("wear_ratio",), {**start, "side_gap": 0.0}).result
    right = fit_surface(measured, spread, ("wear_ratio",), {**start, "side_gap": 1.3}).result
    assert wrong.reduced_chi2 > 100.0
    assert any("the model or sigma is wrong" in warning for warning in wrong.warnings)
    assert right.reduced_chi2 == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / len(measured.z)))
    assert not right.warnings
    # And the gap that was left out goes into the wear ratio.
    ratio = wrong.parameters["wear_ratio"]
    assert abs(ratio.value - TRUTH["wear_ratio"]) > 5.0 * ratio.std


@pytest.mark.slow
def test_derivatives_are_those_of_differences(spread):
    rng = np.random.default_rng(5)
    x = {"x": rng.uniform(-8.0, 8.0, 60), "y": rng.uniform(-5.0, 5.0, 60)}
    frame = {"zero": 0.1, "tilt_x": 1e-3, "tilt_y": -2e-3, "shift_x": 0.21, "shift_y": -0.13}
    names = [*TRUTH, *frame]
    point = np.array([*TRUTH.values(), *frame.values()])

    @jax.jit
    def at(vector):
        return spread(dict(zip(names, vector, strict=True)), x)

    columns = np.asarray(jax.jit(jax.jacfwd(at))(point))
    for column, name in enumerate(names):
        step = np.zeros(len(names))
        step[column] = 1e-6 * max(1.0, abs(point[column]))
        differences = (at(point + step) - at(point - step)) / (2.0 * step[column])
        scale = np.max(np.abs(differences))
        assert scale > 0, name
        np.testing.assert_allclose(columns[:, column], differences, atol=1e-5 * scale)


@pytest.mark.slow
def test_a_flat_bottom_does_not_tell_the_spread():
    # One plunge wears the bottom evenly, however it spreads.
    plunge = model("spread", [LayerPath(np.zeros((1, 2)), np.zeros(0, bool))], reach=0.0)
    measured = height_map(plunge, surface(plunge, side_gap=0.0), seed=6)
    found = fit_surface(measured, plunge, ("wear_ratio", "bottom_gap", "spread_width"))
    verdicts = {n: found.result.parameters[n].verdict for n in found.unknown}
    assert verdicts == dict.fromkeys(found.unknown, "flat")
    assert found.told == ()
    # depth = (feed - bottom gap) / (1 + R) holds both in one number.
    assert "wear_ratio and bottom_gap cannot be told apart" in found.result.directions[0]
    assert any("does not tell spread_width" in note for note in found.notes)


@pytest.mark.slow
def test_a_mode_without_spread_has_no_width():
    local = model("local")
    measured = height_map(local, surface(local), seed=7)
    found = fit_surface(measured, local, ("wear_ratio", "spread_width"), {"side_gap": 1.3})
    assert found.told == ("wear_ratio",)
    assert found.result.parameters["spread_width"].verdict == "flat"
    assert any("wear mode local has no spread width" in note for note in found.notes)


def test_directions_one_by_one_are_those_of_jax():
    def function(params):
        return jnp.sin(params["a"] * jnp.arange(4.0)) * params["b"] + params["c"] ** 2

    def through(vector, wrapped):
        params = {"a": vector[0], "b": vector[1], "c": jnp.asarray(2.0)}
        return one_by_one(function, params) if wrapped else function(params)

    point = jnp.array([0.7, -1.3])
    for transform in (jax.jacfwd, jax.jacrev):
        own = transform(lambda v: through(v, True))(point)
        np.testing.assert_allclose(own, jax.jacfwd(lambda v: through(v, False))(point), rtol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"unknown": ("wear_ration",)}, "'wear_ration' is not known"),
        ({"unknown": ()}, "nothing to fit"),
        ({"start": {"side_gap": 7.0}}, "start of side_gap is 7 um"),
        ({"start": {"wear_ratio": -0.1}}, "start of wear_ratio is -0.1"),
    ],
)
def test_bad_questions_are_named(spread, arguments, words):
    measured = height_map(spread, np.zeros(spread.cavity.workpiece.depth.shape))
    with pytest.raises(InputError, match=words):
        fit_surface(measured, spread, **arguments)


def test_bad_maps_and_models_are_named(spread):
    measured = height_map(spread, np.zeros(spread.cavity.workpiece.depth.shape))
    away = dataclasses.replace(measured, x=measured.x + 1e3)
    with pytest.raises(InputError, match=r"0 of .* readings lie on the simulated map"):
        fit_surface(away, spread)
    with pytest.raises(InputError, match="give the cavity's model a reach"):
        fit_surface(measured, model("local", reach=0.0), ("side_gap",))
    with pytest.raises(InputError, match="one finite feed for each of 5 layers"):
        SurfaceModel(spread.cavity, np.ones(3))
