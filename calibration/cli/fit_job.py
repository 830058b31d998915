"""Job files of `procmodel fit`: a model of the user's own, its parameters and data, as TOML."""

import importlib
import importlib.util
import re
import sys
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procmodel.errors import InputError, nearest
from procmodel.io.textfile import read_utf8

if TYPE_CHECKING:
    from calibration.noise import Noise
    from calibration.priors import Prior
    from calibration.problem import Dataset, Problem

# What the value of a key may be, as errors say it; None where something else looks at it.
_TEXT = ("text in quotes", (str,))
_NUMBER = ("a number", (int, float))
_COUNT = ("a whole number", (int,))
_SWITCH = ("true or false", (bool,))
_SIGMA = ("a number or text in quotes", (int, float, str))
_Kind = tuple[str, tuple[type, ...]]
_Kinds = Mapping[str, _Kind | None]
_TOP: _Kinds = {
    **dict.fromkeys(("model", "name", "out"), _TEXT),
    "black_box": _SWITCH,
    **dict.fromkeys(("parameters", "data", "fit", "profile", "sample")),
}
_PARAMETER: _Kinds = {
    "value": _NUMBER,
    **dict.fromkeys(("unit", "transform", "tied"), _TEXT),
    "fixed": _SWITCH,
    **dict.fromkeys(("bounds", "prior")),
}
_DATA: _Kinds = {
    **dict.fromkeys(("name", "file", "model"), _TEXT),
    **dict.fromkeys(("sigma", "x_sigma"), _SIGMA),
    **dict.fromkeys(("x", "y", "noise", "own")),
}
_SAMPLE: _Kinds = {
    **dict.fromkeys(("draws", "seed", "ensembles", "walkers", "warmup"), _COUNT),
    **dict.fromkeys(("sampler", "checkpoint"), _TEXT),
}


@dataclass(frozen=True)
class FitJob:
    """What a job file asks for.

    Attributes
    ----------
    problem : Problem
        Model, parameters and readings.
    fit : dict
        Options of `calibration.fit`, and ``starts`` of a multistart.
    profile : dict or None
        Options of the profile likelihood; None when not asked for.
    sample : dict or None
        Options of `calibration.sample`; None when not asked for.
    out : Path or None
        Where to save the result.
    """

    problem: "Problem"
    fit: dict[str, Any] = field(default_factory=dict)
    profile: dict[str, Any] | None = None
    sample: dict[str, Any] | None = None
    out: Path | None = None


def read_job(path: Path) -> FitJob:
    """Read a job file and everything it names.

    Parameters
    ----------
    path : Path
        The file. Other files named in it are taken from its folder.

    Returns
    -------
    FitJob
        The job.

    Raises
    ------
    InputError
        If the file is not TOML, a key is unknown or of the wrong kind, or model or data cannot be
        read.
    """
    try:
        job = tomllib.loads(read_utf8(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path.name} is not valid TOML ({error}): correct that line.") from None
    _check_keys(path, "", job, _TOP)
    for key in ("model", "parameters", "data"):
        if key not in job:
            raise InputError(f"{path.name}: key {key!r} is missing; a job needs it.")
    black_box = job.get("black_box", False)
    function = _model(path, job["model"], black_box)
    tables = job["data"] if isinstance(job["data"], list) else [job["data"]]
    parameters = {
        name: _parameter(path, name, given)
        for name, given in _table(path, "parameters", job["parameters"]).items()
    }
    datasets: dict[str, Dataset] = {}
    for number, given in enumerate(tables, start=1):
        where = "data" if len(tables) == 1 else f"data {number}"
        table = _table(path, where, given)
        _check_keys(path, where, table, _DATA)
        name = str(table.get("name", "data" if len(tables) == 1 else f"data{number}"))
        if name in datasets:
            raise InputError(f"{path.name}: two data sets are called {name!r}: rename one.")
        datasets[name] = _dataset(path, where, table, list(parameters), black_box)
    from calibration.problem import Problem

    problem = Problem(parameters, datasets, function, job.get("name"))
    _require_sound_model(problem)
    fitting = _fitting(path, _table(path, "fit", job.get("fit", {})))
    sampling = _asked(path, "sample", job.get("sample"), _SAMPLE)
    if sampling and "checkpoint" in sampling:
        sampling["checkpoint"] = path.parent / str(sampling["checkpoint"])
    return FitJob(
        problem=problem,
        fit=fitting,
        profile=_asked(path, "profile", job.get("profile"), {"level": _NUMBER}),
        sample=sampling,
        out=path.parent / str(job["out"]) if "out" in job else None,
    )


def _fitting(path: Path, table: dict[str, Any]) -> dict[str, Any]:
    """Options of the fit, each of the kind that its solver wants."""
    from calibration.fitting import SOLVERS

    solver = table.get("solver", "box_lm")
    if solver not in SOLVERS:
        hint = nearest(str(solver), tuple(SOLVERS))
        raise InputError(f"{path.name}: solver {solver!r} is unknown{hint}.")
    module, options = SOLVERS[solver]
    by_type: dict[type, _Kind] = {bool: _SWITCH, int: _COUNT}
    kinds: dict[str, _Kind] = {"solver": _TEXT, "starts": _COUNT}
    for option in fields(getattr(importlib.import_module(module), options)):
        kinds[option.name] = by_type.get(type(option.default), _NUMBER)
    _check_keys(path, "fit", table, kinds)
    return dict(table)


def _asked(path: Path, key: str, given: Any, known: _Kinds) -> dict[str, Any] | None:
    """Options of a step that is switched on by true or by a table of its options."""
    if given is None or given is False:
        return None
    if given is True:
        return {}
    table = _table(path, key, given)
    _check_keys(path, key, table, known)
    return dict(table)


def _model(path: Path, given: Any, black_box: bool) -> Callable[..., Any]:
    """The function that ``module:function`` or ``file.py:function`` names."""
    place, _, name = str(given).rpartition(":")
    if not place or not name:
        raise InputError(
            f'{path.name}: model {given!r} must be "module:function" or "file.py:function".'
        )
    folder = str(path.parent.resolve())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        if place.endswith(".py"):
            file = path.parent / place
            if not file.is_file():
                raise InputError(f"{path.name}: there is no file {place!r} beside it.")
            spec = importlib.util.spec_from_file_location(file.stem, file)
            if spec is None or spec.loader is None:
                raise InputError(f"{path.name}: {place} cannot be imported as Python.")
            module = importlib.util.module_from_spec(spec)
            sys.modules.setdefault(file.stem, module)
            spec.loader.exec_module(module)
        else:
            module = importlib.import_module(place)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        # Whatever the user's own file raises is told in a sentence, not as a traceback.
        sys.modules.pop(Path(place).stem, None)
        raise InputError(
            f"{path.name}: importing {place!r} failed with {type(error).__name__}: "
            f"{_one_line(error)}; correct that file."
        ) from None
    function = getattr(module, name, None)
    if not callable(function):
        functions = [n for n, v in vars(module).items() if callable(v) and not n.startswith("_")]
        hint = nearest(name, functions) if functions else ": write it"
        raise InputError(f"{path.name}: {place} has no function {name!r}{hint}.")
    if black_box:
        from calibration.black_box import BlackBox

        return BlackBox(function)
    return function


def _parameter(path: Path, name: str, given: Any) -> Any:
    if isinstance(given, int | float) and not isinstance(given, bool):
        return float(given)
    from calibration.parameters import Parameter

    where = f"parameters.{name}"
    table = dict(_table(path, where, given))
    _check_keys(path, where, table, _PARAMETER)
    if "prior" in table:
        table["prior"] = _prior(path, where, table["prior"])
    if "bounds" in table:
        table["bounds"] = tuple(table["bounds"]) if isinstance(table["bounds"], list) else None
    if "tied" in table:
        table.setdefault("value", 0.0)
        if ":" in str(table["tied"]):
            table["tied"] = _model(path, table["tied"], black_box=False)
    if "value" not in table:
        raise InputError(f"{path.name}: {where} has no value: write value = ...")
    try:
        return Parameter(**table)
    except InputError as error:
        raise InputError(f"{path.name}: parameter {name!r}: {error}") from None


def _prior(path: Path, where: str, given: Any) -> "Prior":
    """A prior such as ``{ normal = [1.5, 0.3] }``, perhaps with ``within = [low, high]``."""
    from calibration import priors

    known = {
        "normal": priors.Normal,
        "lognormal": priors.LogNormal,
        "halfnormal": priors.HalfNormal,
        "uniform": priors.Uniform,
        "beta": priors.Beta,
    }
    table = dict(_table(path, f"{where}.prior", given))
    within = table.pop("within", None)
    if within is not None and not (
        isinstance(within, list) and len(within) == 2 and all(map(_is_number, within))
    ):
        raise InputError(f"{path.name}: {where}.prior.within must be [low, high].")
    if len(table) != 1:
        raise InputError(f"{path.name}: {where}.prior must name one of {', '.join(known)}.")
    ((kind, numbers),) = table.items()
    if kind not in known:
        raise InputError(f"{path.name}: prior {kind!r} is unknown{nearest(kind, tuple(known))}.")
    numbers = numbers if isinstance(numbers, list) else [numbers]
    if not all(map(_is_number, numbers)):
        raise InputError(f"{path.name}: {where}.prior: {kind} takes numbers, not {numbers!r}.")
    try:
        prior = known[kind](*map(float, numbers))
        return prior if within is None else priors.Truncated(prior, *map(float, within))
    except TypeError:
        raise InputError(
            f"{path.name}: {where}.prior has {len(numbers)} numbers, not those of {kind}."
        ) from None
    except (InputError, ValueError) as error:
        raise InputError(f"{path.name}: {where}.prior: {_one_line(error)}") from None


def _noise(path: Path, where: str, given: Any) -> "Noise":
    """A noise model such as ``"huber"`` or ``{ student_t = 4 }``."""
    from calibration import noise

    if isinstance(given, str):
        given = {given: None}
    table = _table(path, f"{where}.noise", given)
    known: dict[str, Callable[..., noise.Noise]] = {
        "normal": noise.Gaussian,
        "student_t": noise.StudentT,
        "relative": noise.Relative,
        "ar1": noise.AR1,
        **{
            loss: lambda threshold=None, loss=loss: noise.Robust(loss, threshold)
            for loss in ("huber", "soft_l1", "cauchy")
        },
    }
    if len(table) != 1:
        raise InputError(f"{path.name}: {where}.noise must name one of {', '.join(known)}.")
    ((kind, number),) = table.items()
    if kind not in known:
        raise InputError(f"{path.name}: noise {kind!r} is unknown{nearest(kind, tuple(known))}.")
    try:
        return known[kind]() if number is None else known[kind](number)
    except TypeError:
        raise InputError(
            f"{path.name}: {where}.noise = {{ {kind} = ... }} needs its number or the name of a "
            "parameter."
        ) from None


def _dataset(
    path: Path, where: str, table: dict[str, Any], parameters: list[str], black_box: bool
) -> "Dataset":
    from calibration.problem import Dataset
    from procmodel.io import read_table

    for key in ("file", "x", "y"):
        if key not in table:
            raise InputError(f"{path.name}: {where} has no {key!r}: write {key} = ...")
    xs = table["x"] if isinstance(table["x"], list) else [table["x"]]
    if not xs:
        raise InputError(f"{path.name}: {where}.x is empty: name one column or more.")
    headings = {key: table[key] for key in ("y", "sigma", "x_sigma") if _is_heading(table.get(key))}
    columns = [_column(path, where, heading) for heading in (*xs, *headings.values())]
    source = path.parent / str(table["file"])
    read = read_table(source, list({c.name: c for c in columns}.values()))
    by_key = {
        key: read.values[column.name]
        for key, column in zip(headings, columns[len(xs) :], strict=True)
    }
    if "y" not in by_key:
        raise InputError(f'{path.name}: {where}.y must name a column with its unit, "y [um]".')
    sigma = by_key.get("sigma", table.get("sigma"))
    if isinstance(sigma, str) and sigma not in parameters:
        raise InputError(
            f"{path.name}: {where}.sigma is {sigma!r}, which is neither a parameter nor a column "
            f'with its unit such as "sigma [um]"{nearest(sigma, parameters)}.'
        )
    if isinstance(table.get("x_sigma"), str) and "x_sigma" not in by_key:
        raise InputError(
            f"{path.name}: {where}.x_sigma is {table['x_sigma']!r}, but must be a number or a "
            'column with its unit such as "x_sigma [um]".'
        )
    own = _table(path, f"{where}.own", table.get("own", {}))
    _check_keys(path, f"{where}.own", own, dict.fromkeys(own, _TEXT))
    named = {column.name: read.values[column.name] for column in columns[: len(xs)]}
    options: dict[str, Any] = {}
    if "model" in table:
        options["function"] = _model(path, table["model"], black_box)
    if "noise" in table:
        options["noise"] = _noise(path, where, table["noise"])
    try:
        return Dataset(
            x=named if isinstance(table["x"], list) else next(iter(named.values())),
            y=by_key["y"],
            sigma=sigma,
            own=own,
            x_sigma=by_key.get("x_sigma", table.get("x_sigma")),
            **options,
        )
    except InputError as error:
        raise InputError(f"{source.name}: {error}") from None


def _is_heading(given: Any) -> bool:
    return isinstance(given, str) and "[" in given


def _column(path: Path, where: str, heading: Any) -> Any:
    from procmodel.io import Column

    parts = re.fullmatch(r"\s*([^\[\]]+?)\s*\[\s*([^\[\]]+?)\s*\]\s*", str(heading))
    if parts is None:
        raise InputError(
            f"{path.name}: {where}: column {heading!r} has no unit: write it as in the file's "
            'header, such as "x [um]", or "x [-]" for a plain number.'
        )
    return Column(parts[1], parts[2])


def _require_sound_model(problem: "Problem") -> None:
    """Call every model once, so that its own mistakes are told as such."""
    import jax

    try:
        jax.eval_shape(
            problem.structure.predictions, problem.start, problem.fixed_values, problem.data()
        )
        _call_black_boxes(problem)
    except InputError:
        raise
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError):
        raise InputError(
            f"model {problem.name!r} needs its parameters as plain numbers, as NumPy, math and "
            "'if' do: write it with jax.numpy (and jnp.where), or set black_box = true in the job."
        ) from None
    except Exception as error:
        raise InputError(
            f"model {problem.name!r} failed with {type(error).__name__}: {_one_line(error)}; "
            "correct the function."
        ) from None


def _call_black_boxes(problem: "Problem") -> None:
    """JAX does not look into a black box: called at the start, it shows what it returns."""
    import numpy as np

    from calibration.black_box import BlackBox
    from calibration.parameters import NamedParameters

    layout = problem.layout
    natural = layout.natural(problem.start, problem.fixed_values)
    values = {name: float(value) for name, value in natural.items()}
    for function, dataset in zip(
        problem.structure.functions, problem.datasets.values(), strict=True
    ):
        if not isinstance(function, BlackBox):
            continue
        renamed = values | {inner: values[outer] for inner, outer in dataset.own.items()}
        shape = np.shape(function.function(NamedParameters(renamed), dataset.x))
        if shape != dataset.y.shape:
            raise InputError(
                f"model {function.__name__!r} returned shape {shape} for {len(dataset.y)} "
                "readings: it must return one value for each."
            )


def _table(path: Path, key: str, given: Any) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise InputError(f"{path.name}: {key!r} must be a table, not {given!r}.")
    return given


def _check_keys(path: Path, where: str, table: dict[str, Any], known: _Kinds) -> None:
    """Refuse keys that are not known, and values of another kind than theirs."""
    place = f" in {where}" if where else ""
    for key, value in table.items():
        if key not in known:
            raise InputError(
                f"{path.name}: unknown key {key!r}{place}{nearest(key, tuple(known))}."
            )
        kind = known[key]
        # Python takes true for 1; in a job file it is a slip.
        if kind is not None and not (
            isinstance(value, kind[1]) and (bool in kind[1] or not isinstance(value, bool))
        ):
            raise InputError(
                f"{path.name}: key {key!r}{place} is {value!r}, but must be {kind[0]}."
            )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()).rstrip(".")
    return text if len(text) <= 200 else text[:197] + "..."
