"""Many fits at once, against closed forms, scipy and the single fit."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import curve_fit, least_squares

from calibration import Normal, Parameter, Problem, fit
from calibration.many import fit_many, fit_stream
from calibration.many_result import FEW_READINGS, NO_NOISE, NO_READINGS, OPEN, STATUS
from calibration.solvers import box_lm
from procmodel.errors import InputError

X = np.linspace(0.0, 5.0, 30)
TRUE = np.array([2.0, 1.0, 0.5])


def decay(params, x):
    return params["a"] * jnp.exp(-params["b"] * x) + params["c"]


def numpy_decay(x, a, b, c):
    return a * np.exp(-b * x) + c


def line(params, x):
    return params["a"] + params["b"] * x


def doubled(params, x):
    return params["a"] + params["twin"] * x + 0.0 * params["b"]


def pair(params, x):
    """Two exponentials, nearly the same for a small shift."""
    return params["a"] * jnp.exp(-x) + params["b"] * jnp.exp(-(1.0 + params["shift"]) * x)


def two_inputs(params, x):
    return params["a"] * x["time"] + params["b"] * x["load"] + x["offset"]


def waves(params, x):
    return sum(params[f"w{k}"] * jnp.cos(k * x) for k in range(9))


def parameters(**changed):
    given = {
        "a": Parameter(1.0, bounds=(0.0, 10.0)),
        "b": Parameter(1.5, bounds=(0.0, 10.0)),
        "c": Parameter(0.1, bounds=(0.0, 10.0)),
    }
    return given | changed


def open_line():
    return {"a": Parameter(0.0), "b": Parameter(0.0)}


def open_pair(shift):
    return {"a": Parameter(1.0), "b": Parameter(1.0), "shift": shift}


def decays(n, seed=0, noise=0.02):
    rng = np.random.default_rng(seed)
    true = TRUE * rng.uniform(0.7, 1.3, (n, 3))
    return true, numpy_decay(X, *true.T[..., None]) + rng.normal(0.0, noise, (n, len(X)))


def scipy_fit(y, upper=(10.0, 10.0, 10.0), x=X, sigma=None):
    tight = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15}
    values, covariance = curve_fit(
        numpy_decay, x, y, TRUE * 0.9, sigma, sigma is not None, bounds=((0.0,) * 3, upper), **tight
    )
    return values, covariance


def test_bounded_fits_equal_scipys():
    _, y = decays(50)
    many = fit_many(decay, parameters(), X, y)
    assert many.converged.all() and not many.refitted.any()
    assert many.names == ("a", "b", "c")
    for i in range(50):
        value, covariance = scipy_fit(y[i])
        np.testing.assert_allclose(many.value[i], value, rtol=1e-7)
        # scipy's Jacobian is a finite difference.
        np.testing.assert_allclose(many.covariance[i], covariance, rtol=1e-5)
        rest = y[i] - numpy_decay(X, *value)
        assert many.noise[i] == pytest.approx(np.sqrt(rest @ rest / 27), rel=1e-9)
        assert many.residual_rms[i] == pytest.approx(np.sqrt(rest @ rest / 30), rel=1e-9)


def test_intervals_cover_what_the_readings_were_made_with():
    true, y = decays(4000, seed=5)
    many = fit_many(decay, parameters(), X, y)
    distance = np.abs(many.value - true) / many.std
    # Student's t with 27 degrees of freedom: 2.0518; three binomial standard deviations.
    inside = np.mean(distance < 2.0518, axis=0)
    np.testing.assert_allclose(inside, 0.95, atol=3 * np.sqrt(0.95 * 0.05 / 4000))
    assert not np.allclose(np.mean(distance < 2.0518 / 1.3, axis=0), 0.95, atol=0.02)


def test_a_bound_that_is_active():
    true, y = decays(30, seed=1)
    limit = 0.9 * true[:, 2].min()
    bounded = parameters(c=Parameter(0.1, bounds=(0.0, limit)))
    many = fit_many(decay, bounded, X, y)
    assert many.converged.all() and many.held[:, 2].sum() >= 25
    for i in np.flatnonzero(many.held[:, 2]):
        assert many.value[i, 2] == limit
        assert np.isnan(many.std[i, 2]) and np.isnan(many.covariance[i, 2]).all()
        assert many.degrees_of_freedom[i] == 28
        assert "c at a bound" in many.status_sentence(i)
        rest = curve_fit(
            lambda x, a, b: numpy_decay(x, a, b, limit),
            X,
            y[i],
            TRUE[:2],
            ftol=1e-15,
            xtol=1e-15,
            gtol=1e-15,
        )
        np.testing.assert_allclose(many.value[i, :2], rest[0], rtol=1e-7)
        np.testing.assert_allclose(many.covariance[i, :2, :2], rest[1], rtol=1e-5)


def test_two_bounds_crossed_at_once_equal_scipys():
    _, y = decays(40, seed=2)
    bounded = parameters(a=Parameter(1.0, bounds=(0.9, 1.8)), b=Parameter(1.5, bounds=(1.05, 10.0)))
    many = fit_many(decay, bounded, X, y)
    assert many.converged.all() and (many.held.sum(axis=1) == 2).any()
    for i in range(40):
        best = least_squares(
            lambda v, i=i: numpy_decay(X, *v) - y[i],
            (1.5, 1.2, 0.5),
            bounds=((0.9, 1.05, 0.0), (1.8, 10.0, 10.0)),
            ftol=1e-15,
            xtol=1e-15,
            gtol=1e-15,
        )
        assert many.chi2[i] <= 2 * best.cost * (1 + 1e-9)
        # scipy stays inside the bounds by a little.
        np.testing.assert_allclose(many.value[i], best.x, rtol=1e-5)


def test_linear_fits_have_their_closed_form():
    rng = np.random.default_rng(3)
    sigma = rng.uniform(0.5, 2.0, (20, len(X)))
    y = 3.0 - 2.0 * X + sigma * rng.normal(size=sigma.shape)
    many = fit_many(line, open_line(), X, y, sigma)
    design = np.stack([np.ones_like(X), X], axis=1)
    for i in range(20):
        weighted = design / sigma[i][:, None]
        inverse = np.linalg.inv(weighted.T @ weighted)
        np.testing.assert_allclose(
            many.value[i], inverse @ weighted.T @ (y[i] / sigma[i]), rtol=1e-9
        )
        np.testing.assert_allclose(many.covariance[i], inverse, rtol=1e-9)
    assert np.isnan(many.noise).all() and (many.degrees_of_freedom == 28).all()


def test_more_parameters_than_are_written_out():
    rng = np.random.default_rng(4)
    x = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    given = {f"w{k}": Parameter(0.0, bounds=(-5.0, 0.8)) for k in range(9)}
    basis = np.cos(np.outer(x, np.arange(9)))
    y = rng.uniform(-1.0, 1.0, (20, 9)) @ basis.T + rng.normal(0.0, 0.05, (20, 40))
    many = fit_many(waves, given, x, y)
    # The basis is orthogonal, so that a bound does not move the other weights.
    best = np.minimum(np.linalg.lstsq(basis, y.T)[0].T, 0.8)
    assert many.converged.all() and not many.refitted.any()
    np.testing.assert_allclose(many.value, best, atol=1e-9)
    np.testing.assert_array_equal(many.held, best == 0.8)


def test_transforms_priors_and_given_sigma_as_in_the_single_fit():
    _, y = decays(6, seed=6)
    sigma = np.linspace(0.01, 0.1, len(X))
    given = {
        "a": Parameter(1.0, bounds=(0.0, 10.0), transform="log"),
        "b": Parameter(1.5, bounds=(0.0, 10.0), transform="logit"),
        "c": Parameter(0.3, prior=Normal(0.5, 0.01)),
    }
    many = fit_many(decay, given, X, y, sigma)
    for i in range(6):
        single = fit(Problem.from_function(decay, given, X, y[i], sigma))
        values = [single.parameters[name].value for name in many.names]
        np.testing.assert_allclose(many.value[i], values, rtol=1e-8)
        np.testing.assert_allclose(many.covariance[i], single.covariance, rtol=1e-6)
        assert many.degrees_of_freedom[i] == single.degrees_of_freedom


def test_tied_and_fixed_parameters_have_their_closed_form():
    given = {"a": Parameter(0.0), "b": 7.0, "twin": Parameter(0.0, tied="a")}
    y = np.random.default_rng(6).normal(size=(3, 30))
    many = fit_many(doubled, given, X, y, 0.5)
    assert many.names == ("a",)
    column = 1.0 + X
    np.testing.assert_allclose(many.value[:, 0], y @ column / (column @ column), rtol=1e-9)
    np.testing.assert_allclose(many.std[:, 0], 0.5 / np.sqrt(column @ column), rtol=1e-9)


def test_starts_of_each_fit_are_taken():
    _, y = decays(3, seed=7)
    given = parameters(b=Parameter(1.0, bounds=(0.0, 10.0), transform="logit"))
    default = fit_many(decay, given, X, y)
    near = fit_many(decay, given, X, y, starts=default.value)
    np.testing.assert_allclose(near.value, default.value, rtol=1e-8)
    assert (near.steps < default.steps).all()
    with pytest.raises(InputError, match=r"starts\[1\]: b starts at 11, outside"):
        fit_many(decay, given, X, y, starts=TRUE + np.array([[0, 0, 0], [0, 10, 0], [0, 0, 0]]))


def test_different_lengths_equal_each_fitted_alone():
    rng = np.random.default_rng(8)
    lengths = [6, 9, 8, 12, 11, 7]
    xs = [np.sort(rng.uniform(0.0, 5.0, length)) for length in lengths]
    ys = [numpy_decay(x, *TRUE) + rng.normal(0.0, 0.02, len(x)) for x in xs]
    sigmas = [rng.uniform(0.01, 0.04, length) for length in lengths]
    for given in (None, sigmas):
        many = fit_many(decay, parameters(), xs, ys, given)
        assert many.converged.all() and list(many.readings) == lengths
        for i, (x, y) in enumerate(zip(xs, ys, strict=True)):
            value, covariance = scipy_fit(y, x=x, sigma=None if given is None else given[i])
            std = np.sqrt(np.diag(covariance))
            np.testing.assert_allclose(many.value[i], value, rtol=1e-7, atol=1e-6 * std.max())
            if not many.held[i].any():
                np.testing.assert_allclose(many.covariance[i], covariance, rtol=1e-5)
                assert many.degrees_of_freedom[i] == lengths[i] - 3
    few = fit_many(decay, parameters(), [*xs, X[:2]], [*ys, X[:2]])
    assert few.status[-1] == FEW_READINGS and not few.converged[-1]
    assert few.converged[:-1].all() and np.isnan(few.value[-1]).all()


def test_readings_that_are_not_finite_stop_their_own_fit_only():
    _, y = decays(5, seed=9)
    clean = fit_many(decay, parameters(), X, y)
    y[1, 4], y[3, 7] = np.nan, np.inf
    many = fit_many(decay, parameters(), X, y)
    np.testing.assert_array_equal(many.converged, [True, False, True, False, True])
    np.testing.assert_array_equal(many.value[::2], clean.value[::2])
    for i in (1, 3):
        assert many.status[i] == NO_READINGS
        assert many.status_sentence(i).startswith("not started: readings")
        assert np.isnan(many.value[i]).all() and np.isnan(many.std[i]).all()
        assert np.isnan(many.covariance[i]).all() and np.isnan(many.noise[i])
    assert many.status_counts[STATUS[NO_READINGS]] == 2
    own_x = np.tile(X, (5, 1))
    own_x[0, 0] = np.nan
    assert fit_many(decay, parameters(), own_x, y).status[0] == NO_READINGS


def test_parameters_that_the_readings_cannot_tell_apart():
    y = 3.0 * np.exp(-X) + np.random.default_rng(1).normal(0.0, 0.1, (4, 30))
    many = fit_many(pair, open_pair(0.0), X, y)
    assert many.refitted.all() and (many.status == OPEN).all() and many.converged.all()
    assert "leave some parameters open" in many.status_sentence(0)
    assert np.isnan(many.std).all() and (many.degrees_of_freedom == 29).all()
    column = np.exp(-X)
    best = y @ column / (column @ column)
    np.testing.assert_allclose(many.value.sum(axis=1), best, rtol=1e-9)
    noise = np.sqrt(np.sum((y - np.outer(best, column)) ** 2, axis=1) / 29)
    np.testing.assert_allclose(many.noise, noise, rtol=1e-9)


def test_a_parameter_without_effect_is_open_and_the_others_are_not():
    x = X + 1.0
    y = 3.0 * np.exp(-x) + np.random.default_rng(1).normal(0.0, 0.01, (4, 30))
    many = fit_many(pair, open_pair(1e6), x, y, 0.01)
    assert (many.status == OPEN).all() and not many.held.any()
    column = np.exp(-x)
    np.testing.assert_allclose(many.value[:, 0], y @ column / (column @ column), rtol=1e-9)
    np.testing.assert_allclose(many.std[:, 0], 0.01 / np.sqrt(column @ column), rtol=1e-9)
    assert np.isnan(many.std[:, 1]).all()


def test_ill_conditioned_fits_are_made_again_with_qr():
    y = 3.0 * np.exp(-X) + np.random.default_rng(2).normal(0.0, 0.1, (4, 30))
    many = fit_many(pair, open_pair(1e-6), X, y, 0.1)
    assert many.converged.all() and many.refitted.all()
    design = np.stack([np.exp(-X), np.exp(-(1.0 + 1e-6) * X)], axis=1) / 0.1
    for i in range(4):
        _, triangle = np.linalg.qr(design)
        inverse = np.linalg.inv(triangle)
        best = np.linalg.lstsq(design, y[i] / 0.1)[0]
        std = np.sqrt(np.diag(inverse @ inverse.T))
        np.testing.assert_allclose(many.std[i], std, rtol=1e-6)
        np.testing.assert_allclose(many.value[i], best, atol=1e-6 * std[0])


def test_a_start_where_the_model_is_not_finite_says_so():
    many = fit_many(pair, open_pair(-1e6), X, np.ones((2, 30)))
    assert (many.status == box_lm.BAD_START).all() and not many.converged.any()
    assert np.isnan(many.value).all() and np.isnan(many.std).all() and np.isnan(many.noise).all()


def test_as_many_readings_as_parameters_leave_the_noise_open():
    y = np.array([[1.0, 3.0], [2.0, 2.5]])
    many = fit_many(line, open_line(), np.array([0.0, 1.0]), y)
    np.testing.assert_allclose(many.value, [[1.0, 2.0], [2.0, 0.5]], rtol=1e-12)
    assert (many.status == NO_NOISE).all() and np.isnan(many.std).all() and many.converged.all()
    known = fit_many(line, open_line(), np.array([0.0, 1.0]), y, 0.1)
    np.testing.assert_allclose(known.std, [[0.1, 0.1 * np.sqrt(2.0)]] * 2, rtol=1e-9)


def test_exact_readings_are_met_to_the_last_digits():
    true, _ = decays(20)
    many = fit_many(decay, parameters(), X, numpy_decay(X, *true.T[..., None]))
    assert many.converged.all()
    np.testing.assert_allclose(many.value, true, rtol=1e-12)


def test_x_may_be_a_dictionary_with_shared_and_own_parts():
    rng = np.random.default_rng(11)
    load, offset = rng.uniform(0.0, 1.0, (6, 30)), rng.uniform(0.0, 1.0, (6, 1))
    true = rng.uniform(1.0, 2.0, (6, 2))
    y = true[:, :1] * X + true[:, 1:] * load + offset
    x = {"time": X, "load": load, "offset": offset}
    many = fit_many(two_inputs, open_line(), x, y)
    np.testing.assert_allclose(many.value, true, rtol=1e-10)
    listed = fit_many(two_inputs, open_line(), x | {"load": list(load)}, list(y))
    np.testing.assert_array_equal(listed.value, many.value)


@pytest.mark.parametrize("n", [1, 33, 1500])
def test_any_number_of_fits_and_blocks_give_the_same_bits(n):
    _, y = decays(1500, seed=12)
    whole = fit_many(decay, parameters(), X, y)
    part = fit_many(decay, parameters(), X, y[:n])
    for field in ("value", "covariance", "status", "steps", "noise"):
        np.testing.assert_array_equal(getattr(part, field), getattr(whole, field)[:n])


def test_a_stream_equals_everything_at_once_to_the_bit():
    _, y = decays(1500, seed=12)
    whole = fit_many(decay, parameters(), X, y)
    done = []
    blocks = ((X, y[i : i + 400]) for i in range(0, 1500, 400))
    stream = list(fit_stream(decay, parameters(), blocks, progress=lambda *seen: done.append(seen)))
    assert [len(part) for part in stream] == [400, 400, 400, 300]
    assert done[0] == ("fits", None, 0)
    assert [count for _, count, _ in done[1:]] == [400, 800, 1200, 1500]
    for field in ("value", "std", "covariance", "status", "chi2", "steps"):
        joined = np.concatenate([getattr(part, field) for part in stream])
        np.testing.assert_array_equal(joined, getattr(whole, field))


def test_a_block_without_usable_readings_does_not_end_the_stream():
    _, y = decays(3, seed=12)
    empty, full = fit_stream(decay, parameters(), [(X, y + np.nan), (X, y)])
    assert (empty.status == NO_READINGS).all() and np.isnan(empty.value).all()
    np.testing.assert_array_equal(full.value, fit_many(decay, parameters(), X, y).value)


def test_progress_counts_every_fit():
    _, y = decays(1500, seed=13)
    y[10, 0] = np.nan
    calls = []
    fit_many(decay, parameters(), X, y, progress=lambda *seen: calls.append(seen))
    assert calls[0] == ("fits", None, 0)
    done = [count for _, count, _ in calls[1:]]
    assert done == sorted(done) and calls[-1] == ("fits", 1500, 1500)


SHARDED = """
import json, sys
sys.path.insert(0, sys.argv[1])
import jax
jax.config.update("jax_enable_x64", True)
import numpy as np
from test_many import X, decay, decays, parameters
from calibration.many import fit_many
_, y = decays(300, seed=14)
many = fit_many(decay, parameters(), X, y, 0.02 * np.ones_like(y))
print(json.dumps([len(jax.devices()), many.value.tolist(), many.covariance.tolist()]))
"""


def test_lanes_are_shared_by_several_devices():
    here = Path(__file__).parent
    flags = "--xla_force_host_platform_device_count=4"
    environment = os.environ | {"XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    done = subprocess.run(
        [sys.executable, "-c", SHARDED, str(here)],
        env=environment,
        cwd=here.parents[1],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    devices, value, covariance = json.loads(done.stdout)
    assert devices == 4
    _, y = decays(300, seed=14)
    many = fit_many(decay, parameters(), X, y, 0.02 * np.ones_like(y))
    np.testing.assert_allclose(value, many.value, rtol=1e-9)
    np.testing.assert_allclose(covariance, many.covariance, rtol=1e-9)


Y = np.ones((3, 30))


@pytest.mark.parametrize(
    ("xs", "ys", "sigmas", "words"),
    [
        (X, np.full((3, 30), np.nan), None, "no fit has enough readings"),
        (X, np.zeros((0, 30)), None, "ys is empty"),
        (X, [], None, "give \\(fits, readings\\)"),
        (X, Y[0], None, "give \\(fits, readings\\)"),
        (X[:29], Y, None, "xs has 29 values for 30 readings"),
        (np.ones((2, 30)), Y, None, "xs has 2 rows for 3 fits"),
        ([X, X], Y, None, "xs has 2 arrays for 3 fits"),
        (np.append(X[1:], np.nan), Y, None, "xs is NaN or infinite at reading 30"),
        (X[:2], Y[:, :2], None, "2 readings cannot fit 3 free parameters"),
        (X, [X, X[1:]], None, "give xs as a list"),
        ([X, X], [X, X[1:]], None, r"xs\[1\] has shape \(30,\) for 29 readings"),
        (X, Y, np.ones(3), r"sigmas has shape \(3,\)"),
        (("x",), Y, None, "xs holds something that is not a number"),
        (X, Y, [], "sigmas has 0 entries"),
        (X, Y, 0.0, "sigmas is 0, not a number above 0"),
        (X, Y, np.where(np.eye(3, 30), -1.0, 1.0), r"sigmas\[0\]\[0\] is -1"),
        ([X, X[1:]], [X, X[1:]], [1.0, -2.0], r"sigmas\[1\] is -2"),
        ([X, X[1:]], [X, X[1:]], [X + 1, X + 1], r"sigmas\[1\] has 30 values for 29"),
    ],
)
def test_what_does_not_go_together_is_refused(xs, ys, sigmas, words):
    with pytest.raises(InputError, match=words):
        fit_many(decay, parameters(), xs, ys, sigmas)


def test_other_refusals():
    with pytest.raises(InputError, match="informative prior"):
        fit_many(decay, parameters(c=Parameter(0.1, prior=Normal(0.0, 1.0))), X, Y)
    with pytest.raises(InputError, match="did you mean 'b'"):
        fit_many(decay, parameters() | {"bb": Parameter(0.0, tied="b1")}, X, Y)
    with pytest.raises(InputError, match="returned shape"):
        fit_many(lambda p, x: p["a"], {"a": Parameter(1.0)}, X, Y)
    with pytest.raises(InputError, match=r"write it with jax\.numpy"):
        fit_many(lambda p, x: float(p["a"]) * x, {"a": Parameter(1.0)}, X, Y)
    with pytest.raises(InputError, match="block 2: give a tuple"):
        list(fit_stream(decay, parameters(), [(X, Y), X]))
    with pytest.raises(InputError, match="block 1: ys is empty"):
        list(fit_stream(decay, parameters(), [(X, Y[:0])]))
