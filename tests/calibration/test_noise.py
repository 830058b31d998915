"""Noise models against SciPy's distributions, likelihoods written anew, and simulation."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
import scipy.special
import scipy.stats

from calibration import AR1, Gaussian, Parameter, Problem, Relative, Robust, StudentT, fit

N = 120
X = np.linspace(0.5, 5.0, N)
DESIGN = np.stack([np.ones(N), X], axis=1)
TRUTH = {"a": 1.0, "b": 2.0, "s": 0.3, "share": 0.08, "nu": 5.0, "phi": 0.5}
MEAN = TRUTH["a"] + TRUTH["b"] * X
POSITIVE = {"bounds": (0.0, math.inf), "transform": "log"}
PARAMETERS = {
    "a": Parameter(0.5),
    "b": Parameter(1.5),
    "s": Parameter(0.5, **POSITIVE),
    "share": Parameter(0.2, **POSITIVE),
    "nu": Parameter(3.0, **POSITIVE),
    "phi": Parameter(0.0, bounds=(-1.0, 1.0)),
}


def line(params, x):
    return params["a"] + params["b"] * x


def ar1_covariance(sigma, correlation):
    lags = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    return sigma**2 * correlation**lags


def huber_integral(k):
    return math.sqrt(2 * math.pi) * math.erf(k / math.sqrt(2)) + 2 / k * math.exp(-(k**2) / 2)


def log_huber(z, k):
    rho = np.where(abs(z) <= k, 0.5 * z**2, k * abs(z) - 0.5 * k**2)
    return -rho - math.log(huber_integral(k))


def log_soft_l1(z, k):
    # The integral of exp(-k^2 (sqrt(1 + u^2) - 1)) is that of the Bessel function K1.
    rho = k**2 * (np.sqrt(1 + (z / k) ** 2) - 1)
    return -rho - math.log(2 * k * scipy.special.k1e(k**2))


def log_cauchy(z, k):
    freedom = k**2 - 1
    return scipy.stats.t.logpdf(z, freedom, scale=k / math.sqrt(freedom))


def gaussian(v, e):
    return scipy.stats.norm.logpdf(e, scale=v["s"]).sum()


def relative(v, e):
    scale = np.sqrt(0.1**2 + (v["share"] * (v["a"] + v["b"] * X)) ** 2)
    return scipy.stats.norm.logpdf(e, scale=scale).sum()


def student(v, e):
    return scipy.stats.t.logpdf(e, v.get("nu", 4.0), scale=v["s"]).sum()


def ar1(v, e):
    factor = np.linalg.cholesky(ar1_covariance(v.get("s", 0.3), v.get("phi", 0.5)))
    covariance = scipy.stats.Covariance.from_cholesky(factor)
    return scipy.stats.multivariate_normal.logpdf(e, cov=covariance)


def robust(log_density, k):
    return lambda v, e: log_density(e / 0.3, k).sum() - N * math.log(0.3)


# Of each: the noise, sigma, the parameters fitted along, and its log-likelihood written anew.
CASES = {
    "sigma": (Gaussian(), "s", ("s",), gaussian),
    "relative": (Relative("share"), 0.1, ("share",), relative),
    "t": (StudentT(4.0), "s", ("s",), student),
    "t, freedom": (StudentT("nu"), "s", ("s", "nu"), student),
    "AR1 known": (AR1(0.5), 0.3, (), ar1),
    "AR1": (AR1("phi"), "s", ("s", "phi"), ar1),
    "huber": (Robust("huber"), 0.3, (), robust(log_huber, 1.345)),
    "soft_l1": (Robust("soft_l1", 0.8), 0.3, (), robust(log_soft_l1, 0.8)),
    "cauchy": (Robust("cauchy"), 0.3, (), robust(log_cauchy, 2.385)),
}


def problem(name, y):
    noise, sigma, further, _ = CASES[name]
    parameters = {n: PARAMETERS[n] for n in ("a", "b", *further)}
    return Problem.from_function(line, parameters, X, y, sigma, noise=noise)


def simulated(name, rng, count):
    """Readings by NumPy, shape (count, n)."""
    if name.startswith("t"):
        freedom = 5.0 if "freedom" in name else 4.0
        return MEAN + 0.3 * rng.standard_t(freedom, (count, N))
    if name.startswith("AR1"):
        factor = np.linalg.cholesky(ar1_covariance(0.3, 0.5))
        return MEAN + rng.normal(size=(count, N)) @ factor.T
    scale = np.sqrt(0.1**2 + (0.08 * MEAN) ** 2) if name == "relative" else 0.3
    return MEAN + scale * rng.normal(size=(count, N))


def contaminated(rng, count, share=0.1):
    """Normal readings, some of them with ten times the spread."""
    wide = np.where(rng.uniform(size=(count, N)) < share, 10.0, 1.0)
    return MEAN + 0.3 * wide * rng.normal(size=(count, N))


@functools.partial(jax.jit, static_argnums=0)
def pieces(structure, vector, fixed, data, readings):
    """J'r, J'J and the gradient of the cost of many sets of readings at one point."""

    def of(y):
        (x, _, inverse, x_sigma) = data[0]
        arguments = (fixed, ((x, y, inverse, x_sigma),))
        rows = structure(vector, arguments)
        jacobian = jax.jacfwd(structure)(vector, arguments)
        gradient = jax.grad(structure.cost)(vector, arguments)
        return jacobian.T @ rows, jacobian.T @ jacobian, gradient

    return jax.lax.map(of, readings, batch_size=512)


PIECES = [name for name in CASES if name != "AR1 known"]


@functools.cache
def pieces_at(name, changed=()):
    """`pieces` at the truth, or where some parameters are changed, over simulated readings."""
    free = problem(name, MEAN).layout.free
    values = {n: TRUTH[n] for n in free} | dict(changed)
    start = problem(name, MEAN)
    vector = start.layout.internal(np.array([values[n] for n in free]))
    many = 8 if isinstance(CASES[name][0], Robust) else 4096
    readings = simulated(name, np.random.default_rng(7), many)
    found = pieces(start.structure, vector, np.zeros(0), start.data(), readings)
    return tuple(map(np.asarray, found))


GENERIC = (("a", 1.2), ("b", 1.9))


@pytest.mark.parametrize("name", PIECES)
def test_the_rows_times_their_derivative_are_the_gradient_of_the_cost(name):
    by_rows, _, gradient = pieces_at(name, GENERIC)
    np.testing.assert_allclose(by_rows, gradient, rtol=1e-8, atol=1e-8 * np.abs(gradient).max())


@pytest.mark.parametrize("name", CASES)
def test_the_densities_are_those_of_scipy(name):
    noise, sigma, _, log_likelihood = CASES[name]
    values = TRUTH | dict(GENERIC)
    at = values["a"] + values["b"] * X
    level = np.full(N, values.get(sigma, sigma))
    for y in simulated(name, np.random.default_rng(8), 3):
        found = float(np.sum(noise.log_likelihood(at, y, level, values)))
        named = values if "known" not in name and name != "t" else {"s": values["s"]}
        expected = log_likelihood(named | {"a": values["a"], "b": values["b"]}, y - at)
        assert found == pytest.approx(expected, rel=1e-10)
        assert found == pytest.approx(-float(noise.cost(at, y, level, values)), rel=1e-14)


@pytest.mark.parametrize("name", ["sigma", "relative", "t", "t, freedom", "AR1"])
def test_the_rows_information_is_the_variance_of_the_score(name):
    # Their standard error is sqrt(2 / 4096) = 2.2 % on the diagonal.
    _, information, score = pieces_at(name)
    unit = 1.0 / np.sqrt(np.diag(information.mean(axis=0)))
    expected = np.cov(score, rowvar=False) * np.outer(unit, unit)
    found = information.mean(axis=0) * np.outer(unit, unit)
    np.testing.assert_allclose(found, expected, atol=0.09)
    # At a noise level a fifth higher the rows say something else.
    changed = ("share", 0.1) if name == "relative" else ("s", 0.36)
    _, information, _ = pieces_at(name, (changed,))
    assert np.max(np.abs(information.mean(axis=0) * np.outer(unit, unit) - expected)) > 0.2


def optimum(name, y, start):
    """Parameters where the likelihood written anew is greatest, positive ones by their log."""
    names = list(start)
    logs = np.array([n in ("s", "share", "nu") for n in names])

    def values(vector):
        return dict(
            zip(names, np.where(logs, np.exp(np.where(logs, vector, 0)), vector), strict=True)
        )

    def cost(vector):
        v = values(vector)
        return -CASES[name][3](v, y - v["a"] - v["b"] * X)

    first = np.array(
        [math.log(v) if log else v for v, log in zip(start.values(), logs, strict=True)]
    )
    found = scipy.optimize.minimize(cost, first, jac="3-point", options={"gtol": 1e-6})
    return values(found.x)


@functools.cache
def fitted(name):
    rng = np.random.default_rng(3)
    robust_one = isinstance(CASES[name][0], Robust)
    y = contaminated(rng, 1)[0] if robust_one else simulated(name, rng, 1)[0]
    return y, fit(problem(name, y))


@pytest.mark.parametrize("name", PIECES)
def test_a_fit_finds_the_optimum_of_the_likelihood(name):
    y, result = fitted(name)
    assert result.converged, result.status
    expected = optimum(name, y, {n: TRUTH[n] for n in result.free})
    for n, estimate in result.parameters.items():
        assert estimate.value == pytest.approx(expected[n], abs=2e-5 * estimate.std)


def test_a_fitted_sigma_is_the_rms_and_its_error_that_of_the_textbook():
    y, result = fitted("sigma")
    beta = np.linalg.lstsq(DESIGN, y)[0]
    rms = math.sqrt(np.mean((y - DESIGN @ beta) ** 2))
    std = rms * np.sqrt(np.diag(np.linalg.inv(DESIGN.T @ DESIGN)))
    found = result.parameters
    assert [found[n].value for n in "abs"] == pytest.approx([*beta, rms], rel=1e-7)
    assert [found[n].std for n in "abs"] == pytest.approx([*std, rms / math.sqrt(2 * N)], rel=1e-6)


def normal_information(slope_of_mean, covariance, slopes_of_covariance):
    """Fisher information of a normal vector: its mean's part and its covariance's."""
    inverse = np.linalg.inv(covariance)
    parts = [inverse @ slope for slope in slopes_of_covariance]
    spread = [[0.5 * np.trace(one @ other) for other in parts] for one in parts]
    return slope_of_mean.T @ inverse @ slope_of_mean, np.array(spread)


def test_ar1_errors_are_those_of_the_normal_vector():
    _, result = fitted("AR1")
    s, phi = (result.parameters[n].value for n in ("s", "phi"))
    covariance = ar1_covariance(s, phi)
    lags = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))
    by_phi = s**2 * lags * phi ** np.maximum(lags - 1, 0)
    mean, spread = normal_information(DESIGN, covariance, [2 * covariance / s, by_phi])
    np.testing.assert_allclose(result.covariance[:2, :2], np.linalg.inv(mean), rtol=1e-8)
    np.testing.assert_allclose(result.covariance[2:, 2:], np.linalg.inv(spread), rtol=1e-8)


def test_relative_errors_are_those_of_the_normal_vector():
    _, result = fitted("relative")
    a, b, share = (result.parameters[n].value for n in ("a", "b", "share"))
    mean = a + b * X
    variance = 0.1**2 + (share * mean) ** 2
    by_mean = 2 * share**2 * mean
    slopes = [by_mean, by_mean * X, 2 * share * mean**2]
    both, spread = normal_information(DESIGN, np.diag(variance), [np.diag(d) for d in slopes])
    spread[:2, :2] += both
    np.testing.assert_allclose(result.covariance, np.linalg.inv(spread), rtol=1e-7)


@pytest.mark.parametrize("freedom", [0.6, 4.0, 49.0, 51.0, 300.0])
def test_students_information_about_scale_and_freedom_by_quadrature(freedom):
    digamma = scipy.special.digamma
    half = 0.5 * (digamma(0.5 * (freedom + 1)) - digamma(0.5 * freedom) - 1 / freedom)

    def integrand(u, i, j):
        z = np.sinh(u)
        pull = (freedom + 1) * z**2 / (freedom + z**2)
        scores = pull - 1, half - 0.5 * np.log1p(z**2 / freedom) + 0.5 * pull / freedom
        return scipy.stats.t.pdf(z, freedom) * np.cosh(u) * scores[i] * scores[j]

    grid = np.linspace(-60.0, 60.0, 4001)
    found = student_information(freedom)
    for i, j in ((0, 0), (0, 1), (1, 1)):
        expected = (grid[1] - grid[0]) * np.sum(integrand(grid, i, j))
        assert found[i, j] == pytest.approx(expected, rel=1e-6)


def student_information(freedom):
    """J'J of one reading, by the log of sigma and the degrees of freedom."""

    def rows(v):
        values = {"nu": v[1]}
        sigma = jnp.exp(v[:1])
        return jnp.concatenate(StudentT("nu").rows(jnp.zeros(1), jnp.array([0.7]), sigma, values))

    jacobian = np.asarray(jax.jit(jax.jacfwd(rows))(jnp.array([0.0, freedom])))
    return jacobian.T @ jacobian


@pytest.mark.parametrize("freedom", [1e4, 1e5])
def test_students_information_keeps_its_digits_near_the_normal(freedom):
    # Limits: 7/2 and -2 over the fourth and second power of the freedom.
    found = student_information(freedom)
    assert found[1, 1] * freedom**4 == pytest.approx(3.5, rel=10 / freedom)
    assert found[0, 1] * freedom**2 == pytest.approx(-2.0, rel=10 / freedom)


def test_readings_without_tails_end_at_the_normal_fit():
    y = MEAN + np.random.default_rng(2).uniform(-0.5, 0.5, N)
    result = fit(problem("t, freedom", y))
    assert result.converged
    beta = np.linalg.lstsq(DESIGN, y)[0]
    rms = math.sqrt(np.mean((y - DESIGN @ beta) ** 2))
    found = [result.parameters[n] for n in ("a", "b", "s")]
    assert [p.value for p in found] == pytest.approx([*beta, rms], rel=1e-5)
    assert found[2].std == pytest.approx(rms / math.sqrt(2 * N), rel=1e-4)
    assert result.parameters["nu"].verdict == "flat" and result.parameters["nu"].value > 1e4


def threshold(noise):
    return noise.threshold or {"huber": 1.345, "cauchy": 2.385}[noise.loss]


@pytest.mark.parametrize("name", ["huber", "soft_l1", "cauchy"])
def test_a_robust_fit_is_that_of_scipy(name):
    y, result = fitted(name)
    options = {"loss": name, "f_scale": threshold(CASES[name][0])}
    options |= {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-13}
    expected = scipy.optimize.least_squares(lambda v: (DESIGN @ v - y) / 0.3, [1.0, 2.0], **options)
    for estimate, value in zip(result.parameters.values(), expected.x, strict=True):
        assert estimate.value == pytest.approx(value, abs=1e-5 * estimate.std)


ROBUST = {
    "given": (Robust("huber"), 0.3),
    "estimated": (Robust("cauchy"), None),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBUST)
def test_robust_errors_are_the_scatter_of_contaminated_fits(name):
    noise, sigma = ROBUST[name]
    free = {n: PARAMETERS[n] for n in "ab"}
    sets = contaminated(np.random.default_rng(11), 150)
    values, stds, covered = [], [], []
    for y in sets:
        result = fit(Problem.from_function(line, free, X, y, sigma, noise=noise))
        assert result.converged, result.status
        b = result.parameters["b"]
        values.append(b.value)
        stds.append(b.std)
        covered.append(b.interval95[0] <= 2.0 <= b.interval95[1])
        if sigma is None and len(values) == 1:
            # The scale is what the median says, with n - p in place of n.
            spread = 1.4826 * np.median(np.abs(result.residuals["data"]))
            assert result.noise["data"] == pytest.approx(spread * math.sqrt(N / (N - 2)), rel=1e-6)
    # The scatter of 150 is known to 6 %.
    assert np.mean(stds) == pytest.approx(np.std(values), rel=0.2)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.06)
    assert abs(np.mean(values) - 2.0) < 4 * np.std(values) / math.sqrt(150)
    # Least squares scatters more than twice as far.
    assert np.std(np.linalg.lstsq(DESIGN, sets.T)[0][1]) > 2 * np.std(values)


def covers(result, name):
    low, high = result.parameters[name].interval95
    return low <= TRUTH[name] <= high


@pytest.mark.parametrize(("name", "names"), [("t", "abs"), ("AR1", ("a", "b", "phi"))])
def test_intervals_cover(name, names):
    sets = simulated(name, np.random.default_rng(5), 300)
    results = [fit(problem(name, y)) for y in sets]
    for n in names:
        assert np.mean([covers(r, n) for r in results]) == pytest.approx(0.95, abs=0.04), n
    if name == "AR1":
        # Negative control: as white noise, the same readings are taken for far too sure.
        white = [fit(problem("sigma", y)) for y in sets]
        assert np.mean([covers(r, "b") for r in white]) < 0.85


FLAT = np.zeros(20_000)
DRAWN = {
    "normal": (Gaussian(), scipy.stats.norm.cdf),
    "t": (StudentT(3.0), lambda z: scipy.stats.t.cdf(z, 3.0)),
    "t by name": (StudentT("nu"), lambda z: scipy.stats.t.cdf(z, 5.0)),
    "huber": (Robust("huber"), log_huber),
    "soft_l1": (Robust("soft_l1", 0.8), log_soft_l1),
    "cauchy": (Robust("cauchy"), log_cauchy),
    # Tails that no table could hold: Student's t with 0.44 degrees of freedom.
    "heavy": (Robust("cauchy", 1.2), log_cauchy),
}


def distribution(noise, given):
    """The distribution function, from the density where only that is given."""
    if not isinstance(noise, Robust):
        return given
    k = threshold(noise)
    if noise.loss == "cauchy":
        freedom = k**2 - 1
        return lambda z: scipy.stats.t.cdf(z, freedom, scale=k / math.sqrt(freedom))
    grid = np.linspace(-60.0, 60.0, 120_001)
    steps = scipy.integrate.cumulative_simpson(np.exp(given(grid, k)), x=grid, initial=0.0)
    assert steps[-1] == pytest.approx(1.0, abs=1e-9)
    return lambda z: np.interp(z, grid, steps)


@pytest.mark.parametrize("name", DRAWN)
def test_draws_follow_the_distribution(name):
    noise, given = DRAWN[name]
    level = np.full(FLAT.shape, 0.3)
    drawn = noise.draw(np.random.default_rng(9), FLAT + 2.0, level, TRUTH)
    z = (drawn - 2.0) / 0.3
    assert scipy.stats.kstest(z, distribution(noise, given)).pvalue > 1e-3
    # Negative control: a scale 5 % off is seen.
    assert scipy.stats.kstest(1.08 * z, distribution(noise, given)).pvalue < 1e-3


def test_relative_draws_grow_with_the_reading():
    at = np.repeat([1.0, 10.0], 20_000)
    drawn = Relative("share").draw(np.random.default_rng(1), at, np.full(at.shape, 0.1), TRUTH)
    z = (drawn - at) / np.sqrt(0.1**2 + (0.08 * at) ** 2)
    for half in (z[:20_000], z[20_000:]):
        assert scipy.stats.kstest(half, scipy.stats.norm.cdf).pvalue > 1e-3


def test_ar1_draws_are_white_once_their_correlation_is_taken_out():
    rng, z = np.random.default_rng(4), []
    for _ in range(200):
        z.append(AR1("phi").draw(rng, np.zeros(N), np.full(N, 0.3), TRUTH) / 0.3)
    factor = np.linalg.cholesky(ar1_covariance(1.0, 0.5))
    white = np.linalg.solve(factor, np.transpose(z)).ravel()
    assert scipy.stats.kstest(white, scipy.stats.norm.cdf).pvalue > 1e-3
    lag = np.mean(np.multiply(np.array(z)[:, 1:], np.array(z)[:, :-1]))
    assert lag == pytest.approx(0.5, abs=4 * math.sqrt(2.0 / 24_000))
    # Independent readings of the same spread would be seen.
    independent = np.linalg.solve(factor, rng.normal(size=(N, 200))).ravel()
    assert scipy.stats.kstest(independent, scipy.stats.norm.cdf).pvalue < 1e-3


@pytest.mark.parametrize("noise", [Robust("huber", 0.5), Robust("soft_l1"), Robust("cauchy", 1.5)])
def test_a_robust_density_integrates_to_one(noise):
    # By the trapezoidal rule in u, z = sinh(u), which converges fast for a smooth integrand.
    grid = np.linspace(-25.0, 25.0, 20_001)
    at, level = jnp.sinh(grid), jnp.full(grid.shape, 1.0)
    density = np.cosh(grid) * np.exp(noise.log_likelihood(0.0 * at, at, level, {}))
    assert (grid[1] - grid[0]) * density.sum() == pytest.approx(1.0, abs=1e-6)


def test_numbers_of_numpy_are_numbers():
    z = jnp.array([1.3])
    for number in (np.int64(4), np.float32(4.0), 4):
        found = StudentT(number).log_likelihood(0 * z, z, z / z, {})
        assert float(found[0]) == pytest.approx(scipy.stats.t.logpdf(1.3, 4), rel=1e-6)
