"""The bounded Levenberg-Marquardt: known minima, active bounds, and honest statuses."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from hypothesis import example, given, settings
from hypothesis import strategies as st

from calibration.solvers import box_lm


def linear(v, arguments):
    matrix, right = arguments
    return matrix @ v - right


def rosenbrock(v, _):
    return jnp.stack([10.0 * (v[1] - v[0] ** 2), 1.0 - v[0]])


def powell(v, _):
    """Powell's singular function: the Jacobian loses rank at the minimum."""
    return jnp.stack(
        [
            v[0] + 10.0 * v[1],
            np.sqrt(5.0) * (v[2] - v[3]),
            (v[1] - 2.0 * v[2]) ** 2,
            np.sqrt(10.0) * (v[0] - v[3]) ** 2,
        ]
    )


def broken_left(v, cliff):
    """Not a number below the cliff."""
    return jnp.where(v > cliff, v - 1.0, jnp.nan) * jnp.array([1.0, 2.0])


def logarithm(v, _):
    return jnp.log(v) - jnp.log(jnp.array([0.02]))


def square_root(v, x):
    """Not a number where v[1] passes the first reading."""
    return v[0] * jnp.sqrt(x - v[1]) - 2.0 * jnp.sqrt(x - 0.9)


def log_of_difference(v, x):
    return jnp.log(v[0] * x - v[1]) - jnp.log(3.0 * x - 2.5)


def bent_valley(v, _):
    """Rosenbrock's valley, steeper and bent more: crept along without the curvature."""
    return jnp.stack([1e3 * (v[1] - v[0] ** 3), 1.0 - v[0]])


def solve(residuals, start, lower=None, upper=None, arguments=None, **options):
    start = np.asarray(start, float)
    lower = np.full(start.shape, -np.inf) if lower is None else np.asarray(lower, float)
    upper = np.full(start.shape, np.inf) if upper is None else np.asarray(upper, float)
    return box_lm.solve_compiled(
        residuals, start, lower, upper, arguments, box_lm.BoxLMOptions(**options)
    )


def projected_gradient(end, lower, upper):
    """Gradient of the misfit, less what a bound holds, over the lengths of its factors."""
    jacobian, residuals, v = (np.asarray(a) for a in (end.jacobian, end.residuals, end.vector))
    gradient = jacobian.T @ residuals
    held = ((v <= lower) & (gradient > 0)) | ((v >= upper) & (gradient < 0))
    scale = np.linalg.norm(jacobian, axis=0) * np.linalg.norm(residuals)
    return np.where(held, 0.0, gradient / scale)


@settings(max_examples=60)
@given(seed=st.integers(0, 2**32 - 1), correlated=st.booleans())
# Corners where a parameter that lands on its bound by rounding must not stop the others.
@example(seed=870206, correlated=False)
@example(seed=283, correlated=False)
@example(seed=351, correlated=False)
def test_bounded_linear_least_squares(seed, correlated):
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(12, 5)) * 10.0 ** rng.uniform(-2.0, 2.0, 5)
    if correlated:
        matrix[:, 1] = matrix[:, 0] + 1e-2 * matrix[:, 1]
    right = rng.normal(size=12)
    width = 10.0 ** rng.uniform(-1.5, 1.0, 5) / np.linalg.norm(matrix, axis=0)
    lower, upper = -width * rng.uniform(0.0, 1.0, 5), width
    lower[rng.integers(5)] = -np.inf
    start = np.clip(rng.normal(size=5), lower, upper)
    end = solve(linear, start, lower, upper, (matrix, right))
    assert int(end.status) in box_lm.CONVERGED
    best = scipy.optimize.lsq_linear(matrix, right, (lower, upper), method="bvls", tol=1e-14)
    vector = np.asarray(end.vector)
    assert np.all((vector >= lower) & (vector <= upper))
    cost = 0.5 * float(np.sum(np.asarray(end.residuals) ** 2))
    assert cost == pytest.approx(best.cost, rel=1e-6, abs=1e-12)
    assert np.max(np.abs(projected_gradient(end, lower, upper))) < 1e-5
    # Every bound that scipy finds active is met to the last digit.
    np.testing.assert_array_equal(vector[best.active_mask == -1], lower[best.active_mask == -1])
    np.testing.assert_array_equal(vector[best.active_mask == 1], upper[best.active_mask == 1])


@pytest.mark.parametrize("start", [(-1.2, 1.0), (5.0, -9.0), (0.0, 0.0)])
def test_rosenbrock(start):
    end = solve(rosenbrock, start)
    assert int(end.status) in box_lm.CONVERGED
    np.testing.assert_allclose(end.vector, 1.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [
        # Moré, Garbow, Hillstrom's box: the minimum lies on the bound of the first parameter.
        ((-np.inf, -np.inf), (0.5, np.inf), (0.5, 0.25)),
        # On y = 1.5 the misfit's derivative by x is 400 x^3 - 598 x - 2, halved.
        ((0.0, 1.5), (np.inf, np.inf), (np.max(np.roots([400.0, 0.0, -598.0, -2.0])), 1.5)),
        ((1.2, -np.inf), (3.0, 1.0), (1.2, 1.0)),
    ],
)
def test_rosenbrock_in_a_box(lower, upper, expected):
    end = solve(rosenbrock, (-1.2, 1.0), lower, upper)
    assert int(end.status) in box_lm.CONVERGED
    np.testing.assert_allclose(end.vector, expected, rtol=1e-6)
    assert np.max(np.abs(projected_gradient(end, np.array(lower), np.array(upper)))) < 1e-6


def test_rank_lost_at_the_minimum():
    # Convergence is linear there, whatever status it ends with.
    end = solve(powell, (3.0, -1.0, 0.0, 1.0))
    np.testing.assert_allclose(end.vector, 0.0, atol=1e-6)
    assert float(jnp.sum(end.residuals**2)) < 1e-24


def test_a_start_on_a_bound_leaves_it_when_the_minimum_is_inside():
    matrix = np.array([[1.0, 0.5], [0.0, 1.0], [1.0, 1.0]])
    right = matrix @ [2.0, 3.0]
    end = solve(linear, (0.0, 0.0), (0.0, 0.0), (10.0, 10.0), (matrix, right))
    np.testing.assert_allclose(end.vector, [2.0, 3.0], rtol=1e-9)


def test_a_start_outside_is_moved_into_the_box():
    matrix, right = np.eye(3)[:, :2], np.array([2.0, -3.0, 1.0])
    end = solve(linear, (50.0, -50.0), (0.0, 0.0), (1.0, 1.0), (matrix, right))
    np.testing.assert_array_equal(end.vector, [1.0, 0.0])
    assert int(end.status) in box_lm.CONVERGED


def test_a_start_at_the_corner_of_the_optimum_stops_at_once():
    matrix, right = np.eye(3)[:, :2], np.array([2.0, -3.0, 1.0])
    end = solve(linear, (1.0, 0.0), (0.0, 0.0), (1.0, 1.0), (matrix, right))
    assert int(end.steps) == 0 and int(end.status) == box_lm.GRADIENT


def test_not_finite_at_the_start_is_its_own_status():
    end = solve(broken_left, np.array([-1.0]), arguments=0.0)
    assert int(end.status) == box_lm.BAD_START
    assert int(end.status) not in box_lm.CONVERGED
    assert "move the start values" in box_lm.STATUS[int(end.status)]


def test_a_region_without_numbers_on_the_way_is_stepped_around():
    # The full Gauss-Newton step from 3 for log(v) = log(0.02) lands below 0.
    end = solve(logarithm, np.array([3.0]))
    assert 3.0 + 3.0 * (np.log(0.02) - np.log(3.0)) < 0.0
    assert int(end.status) in box_lm.CONVERGED
    assert float(end.vector[0]) == pytest.approx(0.02, rel=1e-9)


@pytest.mark.parametrize(
    ("residuals", "start", "truth"),
    [
        (square_root, (0.3, 0.2), (2.0, 0.9)),
        (log_of_difference, (9.0, -9.0), (3.0, 2.5)),
    ],
)
@pytest.mark.parametrize("bend", [True, False])
def test_steps_into_a_region_without_numbers_are_shortened(residuals, start, truth, bend):
    x, start = np.linspace(1.0, 4.0, 9), np.array(start)
    # The full Gauss-Newton step does land there.
    jacobian = np.asarray(jax.jacfwd(residuals)(start, x))
    full = start - np.linalg.lstsq(jacobian, np.asarray(residuals(start, x)))[0]
    assert np.all(np.isfinite(jacobian)) and np.any(np.isnan(residuals(full, x)))
    end = solve(residuals, start, arguments=x, bend=bend)
    assert int(end.status) in box_lm.CONVERGED
    np.testing.assert_allclose(end.vector, truth, rtol=1e-6)


def test_a_derivative_that_is_not_finite_at_the_start_is_no_start():
    # sqrt(0) is a number, its slope is not.
    x = np.linspace(1.0, 4.0, 9)
    assert np.all(np.isfinite(square_root(np.array([1.0, 1.0]), x)))
    end = solve(square_root, (1.0, 1.0), arguments=x)
    assert int(end.status) == box_lm.BAD_START and int(end.steps) == 0


def test_the_bend_saves_steps_in_a_bent_valley():
    bent = solve(bent_valley, (-1.0, -1.0))
    straight = solve(bent_valley, (-1.0, -1.0), bend=False)
    for end in (bent, straight):
        assert int(end.status) in box_lm.CONVERGED
        np.testing.assert_allclose(end.vector, 1.0, rtol=1e-9)
    assert 2 * int(bent.steps) < int(straight.steps)


def test_a_bent_step_stays_in_the_box():
    lower, upper = np.array([-2.0, -1.5]), np.array([0.5, 0.4])
    end = solve(bent_valley, (-1.0, -1.0), lower, upper)
    assert int(end.status) in box_lm.CONVERGED
    np.testing.assert_allclose(end.vector, (0.5, 0.125), rtol=1e-6)


def test_a_minimum_behind_a_cliff_is_not_called_converged():
    # The way down ends at 2, where the model stops being a number.
    end = solve(broken_left, np.array([5.0]), arguments=2.0)
    assert int(end.status) not in box_lm.CONVERGED
    assert float(end.vector[0]) > 2.0 and np.all(np.isfinite(end.residuals))


def test_out_of_steps_is_a_status():
    end = solve(rosenbrock, (-1.2, 1.0), max_steps=3)
    assert int(end.steps) == 3
    assert int(end.status) == box_lm.OUT_OF_STEPS
    assert "raise max_steps" in box_lm.STATUS[int(end.status)]


def test_an_exact_minimum_is_its_own_status():
    end = solve(linear, (3.0, 4.0), arguments=(np.eye(3)[:, :2], np.array([3.0, 4.0, 0.0])))
    assert int(end.status) == box_lm.EXACT


def test_parameters_of_very_different_size_do_not_matter():
    matrix = np.random.default_rng(4).normal(size=(12, 5))
    right = np.random.default_rng(5).normal(size=12)
    units = np.array([1e-9, 1e6, 1.0, 1e-3, 1e9])
    wide = np.full(5, np.inf)
    plain = solve(linear, np.ones(5), -wide, wide, (matrix, right))
    scaled = solve(linear, np.ones(5) * units, -wide, wide, (matrix / units, right))
    np.testing.assert_allclose(np.asarray(scaled.vector) / units, plain.vector, rtol=1e-6)


def test_can_be_mapped_over_right_sides():
    rng = np.random.default_rng(6)
    matrix, rights = rng.normal(size=(6, 2)), rng.normal(size=(9, 6))
    bounds = jnp.array([-0.2, -0.2]), jnp.array([0.2, 0.2])

    def one(right):
        return box_lm.solve(linear, jnp.zeros(2), *bounds, (jnp.asarray(matrix), right)).vector

    found = np.asarray(jax.jit(jax.vmap(one))(rights))
    for vector, right in zip(found, rights, strict=True):
        best = scipy.optimize.lsq_linear(matrix, right, (-0.2, 0.2), method="bvls")
        np.testing.assert_allclose(vector, best.x, atol=1e-6)
