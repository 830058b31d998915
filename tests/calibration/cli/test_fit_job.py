"""Faults in a job: each is one line on stderr naming place and remedy; nothing is written."""

import numpy as np
import pytest
import xarray

from calibration import Parameter, Problem, fit, save_result

MODEL = """
import jax.numpy as jnp

def decay(params, t):
    return params["u0"] * jnp.exp(-t / params["tau"])
"""
JOB = """
model = "models.py:decay"

[parameters]
u0 = { value = 1.0, unit = "V", bounds = [0.0, 10.0] }
tau = { value = 1.0, unit = "s", bounds = [0.1, 10.0] }

[data]
file = "decay.csv"
x = "t [s]"
y = "u [V]"
sigma = 0.01
"""
TABLE = "t [ms],u [mV]\n0,2000\n500,1430\n1000,1030\n1500,735\n2000,520\n"
U0 = '{ value = 1.0, unit = "V", bounds = [0.0, 10.0] }'


@pytest.fixture
def refused(tmp_path, run):
    """Run a faulty job; what it says."""

    def refused(job=JOB, model=MODEL, table=TABLE, arguments=()):
        for name, text in (("job.toml", job), ("models.py", model), ("decay.csv", table)):
            if text is not None:
                (tmp_path / name).write_text(text)
        before = contents(tmp_path)
        code, out, err = run("fit", tmp_path / "job.toml", "--json", *arguments)
        assert code == 2, (out, err)
        assert out == ""
        assert err.startswith("procmodel: ") and err.count("\n") == 1, err
        assert "Traceback" not in err
        assert contents(tmp_path) == before
        return err

    return refused


def contents(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.name != "__pycache__"}


def without(key):
    return "\n".join(line for line in JOB.splitlines() if not line.startswith(key))


def with_u0(text):
    return JOB.replace(U0, text)


FAULTY_JOBS = {
    "not TOML": ("model = = 3", ("job.toml", "not valid TOML", "line 1")),
    "empty": ("", ("'model' is missing",)),
    "no model": (without("model"), ("'model' is missing",)),
    "no parameters": (
        JOB.split("[parameters]")[0] + "[data]" + JOB.split("[data]")[1],
        ("'parameters' is missing",),
    ),
    "no data": (JOB.split("[data]")[0], ("'data' is missing",)),
    "no file": (without("file"), ("data has no 'file'",)),
    "no data sets": ("data = []\n" + JOB.split("[data]")[0], ("datasets is empty",)),
    "unknown key": ("modell = 3\n" + JOB, ("unknown key 'modell'; did you mean 'model'?",)),
    "unknown key of a parameter": (
        JOB.replace("unit", "units"),
        ("unknown key 'units' in parameters.u0; did you mean 'unit'?",),
    ),
    "unknown key of data": (
        JOB + "sigmaa = 3\n",
        ("unknown key 'sigmaa' in data; did you mean 'sigma'?",),
    ),
    "unknown key of the fit": (
        JOB + "[fit]\nmax_step = 3\n",
        ("unknown key 'max_step' in fit; did you mean 'max_steps'?",),
    ),
    "problem as an option": (JOB + "[fit]\nproblem = 3\n", ("unknown key 'problem' in fit",)),
    "unknown key of the profile": (
        JOB + "[profile]\nlevels = 0.9\n",
        ("unknown key 'levels' in profile; did you mean 'level'?",),
    ),
    "unknown key of sampling": (
        JOB + "[sample]\ndraw = 9\n",
        ("unknown key 'draw' in sample; did you mean 'draws'?",),
    ),
    "model without colon": (
        JOB.replace("models.py:decay", "models.py"),
        ("'models.py'", '"file.py:function"'),
    ),
    "no such model file": (JOB.replace("models.py:", "model.py:"), ("no file 'model.py'",)),
    "no such module": (
        JOB.replace("models.py:", "no_such_module_of_mine:"),
        ("ModuleNotFoundError", "no_such_module_of_mine"),
    ),
    "no such function": (
        JOB.replace(":decay", ":decai"),
        ("no function 'decai'; did you mean 'decay'?",),
    ),
    "bounds the wrong way": (
        with_u0("{ value = 1, bounds = [3, 0] }"),
        ("parameter 'u0'", "low < high"),
    ),
    "one bound": (with_u0("{ value = 1, bounds = [0] }"), ("'u0'", "two numbers")),
    "start outside": (with_u0("{ value = 11, bounds = [0, 10] }"), ("'u0'", "outside its bounds")),
    "no value": (with_u0("{ bounds = [0, 10] }"), ("parameters.u0 has no value",)),
    "value in quotes": (with_u0('{ value = "1.0" }'), ("'value' in parameters.u0", "a number")),
    "fixed in quotes": (
        with_u0('{ value = 1, fixed = "no" }'),
        ("'fixed' in parameters.u0", "true or false"),
    ),
    "list as parameter": (with_u0("[1, 2]"), ("'parameters.u0' must be a table",)),
    "transform": (
        with_u0('{ value = 1, transform = "logg" }'),
        ("'logg' is unknown; did you mean 'log'?",),
    ),
    "tied to nothing": (with_u0('{ tied = "tauu" }'), ("'tauu'; did you mean 'tau'?",)),
    "prior with three numbers": (
        with_u0("{ value = 1, prior = { normal = [1, 2, 3] } }"),
        ("parameters.u0.prior has 3 numbers, not those of normal",),
    ),
    "prior unknown": (
        with_u0("{ value = 1, prior = { norml = [1, 2] } }"),
        ("prior 'norml' is unknown; did you mean 'normal'?",),
    ),
    "prior of words": (
        with_u0('{ value = 1, prior = { normal = ["a", 1] } }'),
        ("normal takes numbers",),
    ),
    "prior within one number": (
        with_u0("{ value = 1, prior = { normal = [1, 2], within = [0] } }"),
        ("parameters.u0.prior.within must be [low, high]",),
    ),
    "prior within nothing": (
        with_u0("{ value = 1, prior = { normal = [1, 2], within = [3, 2] } }"),
        ("is zero between 3 and 2",),
    ),
    "sigma zero": (JOB.replace("0.01", "0"), ("decay.csv", "sigma of reading 1 is not above 0")),
    "sigma a switch": (JOB.replace("0.01", "true"), ("'sigma' in data", "a number")),
    "sigma of no parameter": (
        JOB.replace("0.01", '"tauu"'),
        ("data.sigma is 'tauu'", "did you mean 'tau'?"),
    ),
    "x_sigma of no column": (JOB + 'x_sigma = "dx"\n', ("data.x_sigma is 'dx'", "[um]")),
    "noise unknown": (
        JOB + 'noise = "hubber"\n',
        ("noise 'hubber' is unknown; did you mean 'huber'?",),
    ),
    "noise without number": (JOB + 'noise = "relative"\n', ("{ relative = ... }",)),
    "noise of no parameter": (
        JOB + 'noise = { student_t = "nu" }\n',
        ("unknown parameter 'nu'",),
    ),
    "own of no parameter": (JOB + 'own = { u0 = "u1" }\n', ("unknown parameter 'u1'",)),
    "own number": (JOB + "own = { u0 = 3 }\n", ("'u0' in data.own", "text in quotes")),
    "column missing": (JOB.replace('"u [V]"', '"v [V]"'), ("decay.csv", "no column 'v'")),
    "column without unit": (JOB.replace('"u [V]"', '"u"'), ("data.y", "with its unit")),
    "x without unit": (JOB.replace('"t [s]"', '"t"'), ("column 't' has no unit",)),
    "no x": (JOB.replace('"t [s]"', "[]"), ("data.x is empty",)),
    "unit of another kind": (JOB.replace('"u [V]"', '"u [m]"'), ("'mV' measures", "not length")),
    "no such table": (JOB.replace("decay.csv", "decai.csv"), ("decai.csv", "no such file")),
    "solver": (JOB + '[fit]\nsolver = "box"\n', ("'box' is unknown; did you mean 'box_lm'?",)),
    "solver option of a kind": (
        JOB + '[fit]\nmax_steps = "many"\n',
        ("'max_steps' in fit is 'many', but must be a whole number",),
    ),
    "starts": (JOB + '[fit]\nstarts = "8"\n', ("'starts' in fit", "a whole number")),
    "sampler": (
        JOB + '[sample]\nsampler = "nut"\n',
        ("sampler 'nut' is unknown; did you mean 'nuts'?",),
    ),
    "half a draw": (JOB + "[sample]\ndraws = 99.5\n", ("'draws' in sample", "a whole number")),
    "level": (JOB + '[profile]\nlevel = "high"\n', ("'level' in profile", "a number")),
    "level above 1": (JOB + "[profile]\nlevel = 95\n", ("level is 95", "between 0 and 1")),
    "out in another format": ('out = "fit.json"\n' + JOB, ("fit.json", "ends in .nc")),
    "out nowhere": ('out = "nowhere/fit.nc"\n' + JOB, ("nowhere",)),
    "all fixed": (with_u0("1.0").replace('unit = "s"', "fixed = true"), ("no parameter is free",)),
}


@pytest.mark.parametrize("fault", FAULTY_JOBS)
def test_faulty_job(fault, refused):
    job, words = FAULTY_JOBS[fault]
    said = refused(job)
    assert all(word in said for word in words), said


FAULTY_MODELS = {
    "fails on import": ("x = 1 / 0\n", ("'models.py'", "ZeroDivisionError: division by zero")),
    "leaves on import": ("import sys\nsys.exit(3)\n", ("'models.py'", "SystemExit: 3")),
    "is not Python": ("def decay(params, t)\n", ("'models.py'", "SyntaxError")),
    "says much": ('raise ValueError("""one\ntwo\nthree""")\n', ("one two three",)),
    "is a number": ("decay = 3\n", ("no function 'decay'",)),
    "takes no x": ("def decay(params):\n    return 1.0\n", ("TypeError", "'decay'")),
    "adds text": ("def decay(p, t):\n    return t + 'a'\n", ("TypeError", "'decay'")),
    "is too short": (
        "def decay(p, t):\n    return p['u0'] * t[:3]\n",
        ("'decay' returned shape (3,) for 5 readings",),
    ),
    "returns nothing": ("def decay(p, t):\n    pass\n", ("'decay'", "None")),
    "asks for another parameter": (
        "def decay(p, t):\n    return p['tauu'] * t\n",
        ("'tauu' is asked for", "did you mean 'tau'?"),
    ),
}
NUMPY = "import numpy as np\ndef decay(p, t):\n    return np.exp(-t / p['tau'])\n"


@pytest.mark.parametrize("black_box", [False, True])
@pytest.mark.parametrize("fault", FAULTY_MODELS)
def test_faulty_model(fault, black_box, refused):
    model, words = FAULTY_MODELS[fault]
    said = refused("black_box = true\n" + JOB if black_box else JOB, model)
    if fault == "returns nothing" and black_box:
        words = ("'decay' returned shape () for 5 readings",)
    assert all(word in said for word in words), said


def test_numpy_without_black_box(refused):
    said = refused(model=NUMPY)
    assert "jax.numpy" in said and "black_box = true" in said


def test_a_black_box_that_fails_later(refused):
    """At the start it works; the differences of its derivative then leave where it does."""
    model = "def decay(p, t):\n    assert p['u0'] == 1.0, 'only one'\n    return p['u0'] * t\n"
    said = refused("black_box = true\n" + JOB, model)
    assert "'decay'" in said and "only one" in said


FAULTY_TABLES = {
    "all NaN": ("t [s],u [V]\n" + "1,nan\n" * 5, ("row 2", "'u'", "nan")),
    "no unit": ("t,u\n1,2\n", ("'t'", "no unit")),
    "header alone": ("t [s],u [V]\n", ("no reading",)),
    "too few": ("t [s],u [V]\n1,2\n", ("1 readings cannot fit 2 free parameters",)),
    "empty": ("", ("empty",)),
}


@pytest.mark.parametrize("fault", FAULTY_TABLES)
def test_faulty_table(fault, refused):
    table, words = FAULTY_TABLES[fault]
    said = refused(table=table)
    assert all(word in said for word in words), said


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--draws", "100"], ("--draws", "--sample")),
        (["--draws", "0"], ("--draws", "--sample")),
        (["--seed", "0"], ("--seed", "--sample")),
        (["--resume"], ("--resume", "--sample")),
        (["--sample", "--resume"], ("resume needs the checkpoint",)),
        (["--sample", "--draws", "5"], ("draws at least 16",)),
        (["--sample", "--checkpoint", "run.txt"], ("run.txt", "ends in .h5")),
        (["--starts", "0"], ("starts must be at least 2",)),
        (["--starts", "many"], ("--starts",)),
        (["--out", "fit.json"], ("fit.json", "ends in .nc")),
        (["--out", "nowhere/fit.nc"], ("nowhere",)),
        (["--plot", "fit.docx"], ("fit.docx", ".png")),
        (["--plott", "fit.png"], ("--plott",)),
    ],
)
def test_faulty_option(arguments, words, refused):
    said = refused(arguments=arguments)
    assert all(word in said for word in words), said


@pytest.mark.parametrize("name", ["nothing.toml", "."])
def test_no_such_job(name, tmp_path, run):
    code, out, err = run("fit", tmp_path / name)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and ("no such file" in err or "folder" in err)


def line(params, x):
    return params["a"] + 0.0 * x


@pytest.fixture
def results(tmp_path):
    """Results of two different data sets."""
    for name, y in (("one", 1.0), ("two", 2.0)):
        readings = y + np.array([0.1, -0.1, 0.0])
        problem = Problem.from_function(line, {"a": Parameter(0.0)}, np.arange(3.0), readings, 0.1)
        save_result(tmp_path / f"{name}.nc", fit(problem))
    xarray.Dataset({"v": ("n", np.arange(3.0))}).to_netcdf(tmp_path / "alien.nc", engine="h5netcdf")
    (tmp_path / "text.nc").write_text("text")
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["report", "none.nc"], ("none.nc", "no such file")),
        (["report", "text.nc"], ("text.nc is not a result",)),
        (["report", "alien.nc"], ("alien.nc is not a result",)),
        (["report"], ("--help",)),
        (["compare", "one.nc"], ("at least two",)),
        (["compare", "one.nc", "two.nc"], ("one is of readings", "two of", "the same readings")),
        (["compare", "one.nc", "one.nc"], ("named twice",)),
        (["compare", "one.nc", "alien.nc"], ("alien.nc is not a result",)),
    ],
)
@pytest.mark.parametrize("as_json", [[], ["--json"]])
def test_faulty_results(arguments, words, as_json, results, run):
    paths = [str(results / a) if a.endswith(".nc") else a for a in arguments]
    code, out, err = run(*paths, *as_json)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and "Traceback" not in err
    assert all(word in err for word in words), err
