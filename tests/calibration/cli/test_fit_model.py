"""`procmodel fit`, `report` and `compare` on a model of the user's own."""

import json
import math
import sys

import h5py
import numpy as np
import pytest
import scipy.optimize
import xarray

from calibration import AR1, Gaussian, Relative, Robust, StudentT
from calibration.cli.fit_job import read_job

MODELS = """
import jax.numpy as jnp
import numpy as np

def decay(params, t):
    return params["u0"] * jnp.exp(-t / params["tau"])

def numpy_decay(params, t):
    assert isinstance(params["tau"], float)
    return params["u0"] * np.exp(-t / params["tau"])

def line(params, t):
    return params["u0"] - params["u0"] / params["tau"] * t

def both(params, x):
    return params["u0"] * jnp.exp(-x["t"] / params["tau"]) + 0.0 * x["u"]

def half_life(params):
    return params["tau"] * jnp.log(2.0)
"""
PARAMETERS = """
[parameters]
u0 = { value = 1.0, unit = "V", bounds = [0.0, 10.0] }
tau = { value = 1.0, unit = "s", bounds = [0.1, 10.0] }
"""
DATA = """
[data]
file = "decay.csv"
x = "t [s]"
y = "u [V]"
sigma = 0.01
"""
# A module that is imported once, so that its functions are compiled once for all tests.
MODULE = "models_of_a_user"
JOB = f'model = "{MODULE}:decay"\n' + PARAMETERS + DATA
T = np.linspace(0.0, 4.0, 25)
NOISE = 0.01 * np.random.default_rng(0).normal(size=25)
U = 2.0 * np.exp(-T / 1.5) + NOISE


def exact_fit(sigma=0.01, u=U):
    """Values and standard deviations by SciPy."""
    best, covariance = scipy.optimize.curve_fit(
        lambda t, u0, tau: u0 * np.exp(-t / tau),
        T, u, [1.0, 1.0], np.broadcast_to(sigma, 25), absolute_sigma=True,
    )  # fmt: skip
    return best, np.sqrt(np.diag(covariance))


@pytest.fixture(scope="module", autouse=True)
def module(tmp_path_factory):
    """The models as a module on Python's path."""
    place = tmp_path_factory.mktemp("installed")
    (place / f"{MODULE}.py").write_text(MODELS)
    before = list(sys.path)
    sys.path.insert(0, str(place))
    yield
    sys.path[:] = before
    sys.modules.pop(MODULE, None)


@pytest.fixture
def folder(tmp_path):
    """Models and data, in milliseconds and millivolts."""
    (tmp_path / "models.py").write_text(MODELS)
    sigma = np.where(T < 2, 0.01, 0.02)
    rows = [f"{1e3 * t!r},{1e3 * u!r},{1e3 * s!r}" for t, u, s in zip(T, U, sigma, strict=True)]
    rows = [row.replace("np.float64(", "").replace(")", "") for row in rows]
    (tmp_path / "decay.csv").write_text("t [ms],u [mV],du [mV]\n" + "\n".join(rows) + "\n")
    return tmp_path


@pytest.fixture
def job(folder):
    def job(text=JOB, name="job.toml"):
        path = folder / name
        path.write_text(text)
        return path

    return job


def assert_fitted(answer, best, std, rel=1e-4):
    for i, name in enumerate(("u0", "tau")):
        found = answer["parameters"][name]
        assert found["value"] == pytest.approx(best[i], abs=rel * std[i])
        assert found["std"] == pytest.approx(std[i], rel=1e-3)


def test_a_fit_in_the_units_of_the_job(job, run_json):
    answer = run_json("fit", job(JOB.replace(MODULE, "models.py")))
    assert_fitted(answer, *exact_fit())
    assert answer["converged"] is True and answer["model"] == "decay"
    assert answer["parameters"]["tau"]["unit"] == "s"
    assert answer["information"]["readings"] == 25 and answer["information"]["parameters"] == 2
    assert set(answer["intervals"]["parameters"]["tau"]) >= {"wald", "profile", "posterior"}
    assert "posterior" not in answer


@pytest.mark.slow
def test_everything_at_once_then_report_and_compare(job, folder, run, run_json):
    out, picture = folder / "decay.nc", folder / "fit.png"
    arguments = ("fit", job(), "--profile", "--sample", "--draws", "32000", "--seed", "3",
                 "--starts", "8", "--out", out, "--plot", picture)  # fmt: skip
    answer = run_json(*arguments)
    best, std = exact_fit()
    assert_fitted(answer, best, std)
    assert picture.read_bytes().startswith(b"\x89PNG")
    row = answer["intervals"]["parameters"]["tau"]
    # The model is nearly straight within its errors: three intervals, hardly different.
    for method, within in (("wald", 0.01), ("profile", 0.1), ("posterior", 0.3)):
        assert row[method]["low"] == pytest.approx(best[1] - 1.96 * std[1], abs=within * std[1])
        assert row[method]["high"] == pytest.approx(best[1] + 1.96 * std[1], abs=within * std[1])
    posterior = answer["posterior"]
    assert posterior["converged"] is True and posterior["sampler"] == "stretch"
    assert posterior["sampler_reason"].startswith("auto: 2 free parameters, fewer than")
    assert posterior["tau"]["mean"] == pytest.approx(best[1], abs=0.15 * std[1])
    assert posterior["tau"]["std"] == pytest.approx(std[1], rel=0.1)
    assert xarray.load_datatree(out, engine="h5netcdf").attrs["seed"] == 3

    read = run_json("report", out)
    assert read == answer
    code, text, err = run("report", out)
    assert (code, err) == (0, "")
    for word in ("Wald", "profile", "posterior", "identified", "converged: ", "AIC"):
        assert word in text

    straight = job(JOB.replace(":decay", ":line"), "line.toml")
    run_json("fit", straight, "--sample", "--draws", "32000", "--out", folder / "line.nc")
    found = run_json("compare", out, folder / "line.nc")
    assert list(found["models"]) == ["decay", "line"]
    assert found["verdict"] == "decay predicts new readings better than line"
    assert found["models"]["line"]["behind"] > 100
    code, text, err = run("compare", folder / "line.nc", out)
    assert (code, err) == (0, "")
    assert text.strip().splitlines()[-1] == found["verdict"]


def test_text_for_people(job, run):
    code, out, err = run("fit", job(), "--starts", "8")
    assert (code, err) == (0, "")
    assert "multistart of decay, 8 starts" in out and "8 of 8 starts" in out
    assert "tau" in out and "identified" in out


def test_exit_code_of_a_fit_and_of_draws_that_have_not_converged(job, folder, run):
    code, out, _ = run("fit", job(JOB + "[fit]\nmax_steps = 1\n"), "--json", "--sample")
    assert code == 1
    answer = json.loads(out)
    assert answer["converged"] is False and "posterior" not in answer
    out_file = folder / "short.nc"
    code, out, _ = run("fit", job(), "--sample", "--draws", "320", "--json", "--out", out_file)
    assert code == 1
    answer = json.loads(out)
    assert answer["converged"] is True and answer["posterior"]["converged"] is False
    assert "raise draws to" in answer["posterior"]["status"]
    # Saved all the same; the intervals say why they are not there.
    assert out_file.exists()
    assert "has not converged" in answer["intervals"]["parameters"]["tau"]["posterior"]["reason"]


def test_options_in_the_job_and_its_own_out(job, folder, run_json):
    text = 'out = "saved.nc"\nname = "discharge"\nprofile = true\n' + JOB
    answer = run_json(
        "fit", job(text + '[fit]\nsolver = "scipy"\n[sample]\ndraws = 32000\nseed = 5\n')
    )
    assert answer["model"] == "discharge" and answer["solver"] == "scipy"
    assert_fitted(answer, *exact_fit(), rel=1e-2)
    assert answer["intervals"]["parameters"]["tau"]["profile"]["low"] is not None
    assert answer["posterior"]["converged"] is True
    assert run_json("report", folder / "saved.nc") == answer


def test_checkpoint_and_resume(job, folder, run, run_json):
    path = folder / "run.h5"
    draws = ("fit", job(), "--sample", "--draws", "32000")
    whole = run_json(*draws)
    first = run_json(*draws, "--checkpoint", path)
    with h5py.File(path) as file:
        assert len(file["log_density"]) == 2000
    assert run_json(*draws, "--checkpoint", path, "--resume") == first == whole
    code, out, err = run(*draws, "--checkpoint", path)
    assert (code, out) == (2, "")
    assert "run.h5 exists: resume the run" in err and err.count("\n") == 1
    code, out, err = run(*draws, "--seed", "9", "--checkpoint", path, "--resume")
    assert (code, out) == (2, "")
    assert "belongs to a run with seed 0, this one has 9" in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("sigma", "exact"),
    [("0.02", 0.02), ('"du [V]"', np.where(T < 2, 0.01, 0.02))],
)
def test_sigma_as_a_number_or_a_column(job, run_json, sigma, exact):
    answer = run_json("fit", job(JOB.replace("sigma = 0.01", f"sigma = {sigma}")))
    assert_fitted(answer, *exact_fit(exact))


def test_sigma_as_a_parameter_or_left_out(job, run_json):
    text = JOB.replace("sigma = 0.01", 'sigma = "s"')
    text = text.replace("[data]", 's = { value = 0.1, bounds = [1e-6, 1.0], unit = "V" }\n[data]')
    answer = run_json("fit", job(text))
    best, _ = exact_fit()
    misfit = U - best[0] * np.exp(-T / best[1])
    # Of greatest likelihood, and without bias.
    assert answer["parameters"]["s"]["value"] == pytest.approx(
        math.sqrt(np.mean(misfit**2)), rel=1e-5
    )
    answer = run_json("fit", job(JOB.replace("sigma = 0.01", "")))
    assert answer["noise"]["data"] == pytest.approx(math.sqrt(np.sum(misfit**2) / 23), rel=1e-5)


def test_two_data_sets_share_one_parameter(job, folder, run_json):
    second = 3.0 * np.exp(-T / 1.5) + 0.01 * np.random.default_rng(1).normal(size=25)
    rows = "\n".join(f"{t:.17g};{u:.17g}" for t, u in zip(T, second, strict=True))
    (folder / "second.csv").write_text("t [s];u [V]\n" + rows + "\n")
    data = DATA.replace("[data]", "[[data]]")
    text = f'model = "{MODULE}:decay"\n' + PARAMETERS
    text += 'other = { value = 1.0, unit = "V" }\n' + data + 'name = "first"\n'
    text += data.replace("decay.csv", "second.csv") + 'own = { u0 = "other" }\n'
    answer = run_json("fit", job(text))
    both, covariance = scipy.optimize.curve_fit(
        lambda t, u0, tau, other: np.concatenate([u0 * np.exp(-T / tau), other * np.exp(-T / tau)]),
        np.tile(T, 2), np.concatenate([U, second]), [1, 1, 1], np.full(50, 0.01),
        absolute_sigma=True,
    )  # fmt: skip
    for i, name in enumerate(("u0", "tau", "other")):
        std = math.sqrt(covariance[i, i])
        assert answer["parameters"][name]["value"] == pytest.approx(both[i], abs=1e-3 * std)
        assert answer["parameters"][name]["std"] == pytest.approx(std, rel=1e-3)
    assert set(answer["noise"]) == {"first", "data2"}


@pytest.mark.parametrize("black_box", [True, False])
def test_a_data_set_with_a_model_of_its_own(job, folder, run_json, black_box):
    """It takes the place of the job's, and is a black box where the job says so."""
    name = "numpy_decay" if black_box else "decay"
    first = name if black_box else "line"
    text = f'model = "{MODULE}:{first}"\n' + PARAMETERS + DATA + f'model = "{MODULE}:{name}"\n'
    text = "black_box = true\n" + text if black_box else text
    assert_fitted(run_json("fit", job(text)), *exact_fit(), rel=1e-2)


def test_several_columns_of_x(job, run_json):
    text = JOB.replace(":decay", ":both").replace('x = "t [s]"', 'x = ["t [s]", "u [V]"]')
    assert_fitted(run_json("fit", job(text)), *exact_fit())


@pytest.mark.parametrize("noise", ['"huber"', "{ student_t = 4 }"])
def test_noise_withstands_an_outlier(job, folder, run_json, noise):
    lines = (folder / "decay.csv").read_text().splitlines()
    cells = lines[10].split(",")
    lines[10] = f"{cells[0]},{float(cells[1]) + 300.0},{cells[2]}"
    (folder / "decay.csv").write_text("\n".join(lines) + "\n")
    _, std = exact_fit()
    found = run_json("fit", job(JOB + f"noise = {noise}\n"))["parameters"]["tau"]["value"]
    least_squares = run_json("fit", job())["parameters"]["tau"]["value"]
    assert abs(found - 1.5) < 4 * std[1] < abs(least_squares - 1.5)


@pytest.mark.parametrize(
    ("text", "noise"),
    [
        ('"normal"', Gaussian()),
        ('"student_t"', StudentT()),
        ("{ student_t = 3 }", StudentT(3)),
        ("{ relative = 0.1 }", Relative(0.1)),
        ('{ ar1 = "tau" }', AR1("tau")),
        ('"soft_l1"', Robust("soft_l1")),
        ("{ cauchy = 2.5 }", Robust("cauchy", 2.5)),
    ],
)
def test_noise_models_by_name(job, text, noise):
    asked = JOB.replace("bounds = [0.1, 10.0]", "bounds = [0.1, 0.9]").replace(
        "tau = { value = 1.0", "tau = { value = 0.5"
    )
    assert read_job(job(asked + f"noise = {text}\n")).problem.datasets["data"].noise == noise


def test_priors_ties_and_fixed_numbers(job, run_json):
    text = (
        """
model = "models_of_a_user:decay"
[parameters]
u0 = { value = 1.9, unit = "V", prior = { normal = [1.9, 0.001], within = [1.8, 2.0] } }
tau = { value = 1.0, prior = { lognormal = [1.5, 0.5] }, bounds = [0.1, 10] }
same = { tied = "tau" }
half = { tied = "models.py:half_life" }
idle = 7
"""
        + DATA
    )
    answer = run_json("fit", job(text))["parameters"]

    def cost(p):
        misfit = (U - p[0] * np.exp(-T / p[1])) / 0.01
        return np.concatenate([misfit, [(p[0] - 1.9) / 0.001, math.log(p[1] / 1.5) / 0.5]])

    best = scipy.optimize.least_squares(cost, [1.9, 1.5], xtol=1e-14, ftol=1e-14).x
    assert answer["u0"]["value"] == pytest.approx(best[0], rel=1e-7)
    assert answer["tau"]["value"] == pytest.approx(best[1], rel=1e-6)
    assert answer["same"]["value"] == answer["tau"]["value"]
    assert answer["half"]["value"] == pytest.approx(math.log(2) * best[1], rel=1e-6)
    assert answer["idle"]["value"] == 7.0 and answer["idle"]["verdict"] == "fixed"
