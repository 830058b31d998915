"""Job files of `procmodel fit`: a model of the user's own, its parameters and data, as TOML."""

import importlib
import importlib.util
import re
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procmodel.errors import InputError, nearest
from procmodel.io.textfile import read_utf8

if TYPE_CHECKING:
    from calibration.noise import Noise
    from calibration.priors import Prior
    from calibration.problem import Dataset, Problem

_TOP = ("model", "name", "black_box", "parameters", "data", "fit", "profile", "sample", "out")
_PARAMETER = ("value", "unit", "bounds", "prior", "transform", "fixed", "tied")
_DATA = ("name", "file", "x", "y", "sigma", "x_sigma", "noise", "own", "model")
_SAMPLE = ("draws", "seed", "sampler", "ensembles", "walkers", "warmup", "checkpoint")


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
    function = _model(path, job["model"], bool(job.get("black_box", False)))
    tables = job["data"] if isinstance(job["data"], list) else [job["data"]]
    parameters = {
        name: _parameter(path, name, given, function)
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
        datasets[name] = _dataset(path, where, table, list(parameters))
    from calibration.problem import Problem

    problem = Problem(parameters, datasets, function, job.get("name"))
    _require_sound_model(problem)
    fitting = _table(path, "fit", job.get("fit", {}))
    sampling = _asked(path, "sample", job.get("sample"), _SAMPLE)
    if sampling and "checkpoint" in sampling:
        sampling["checkpoint"] = path.parent / str(sampling["checkpoint"])
    return FitJob(
        problem=problem,
        fit=fitting,
        profile=_asked(path, "profile", job.get("profile"), ("level",)),
        sample=sampling,
        out=path.parent / str(job["out"]) if "out" in job else None,
    )


def _asked(path: Path, key: str, given: Any, known: tuple[str, ...]) -> dict[str, Any] | None:
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
    except Exception as error:
        # Whatever the user's own file raises is told in a sentence, not as a traceback.
        raise InputError(
            f"{path.name}: importing {place!r} failed with {type(error).__name__}: "
            f"{_one_line(error)}; correct that file."
        ) from None
    function = getattr(module, name, None)
    if not callable(function):
        functions = [n for n, v in vars(module).items() if callable(v) and not n.startswith("_")]
        raise InputError(
            f"{path.name}: {place} has no function {name!r}{nearest(name, functions)}."
        )
    if black_box:
        from calibration.black_box import BlackBox

        return BlackBox(function)
    return function


def _parameter(path: Path, name: str, given: Any, function: Callable[..., Any]) -> Any:
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
    if len(table) != 1:
        raise InputError(f"{path.name}: {where}.prior must name one of {', '.join(known)}.")
    ((kind, numbers),) = table.items()
    if kind not in known:
        raise InputError(f"{path.name}: prior {kind!r} is unknown{nearest(kind, tuple(known))}.")
    numbers = numbers if isinstance(numbers, list) else [numbers]
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


def _dataset(path: Path, where: str, table: dict[str, Any], parameters: list[str]) -> "Dataset":
    from calibration.problem import Dataset
    from procmodel.io import read_table

    for key in ("file", "x", "y"):
        if key not in table:
            raise InputError(f"{path.name}: {where} has no {key!r}: write {key} = ...")
    xs = table["x"] if isinstance(table["x"], list) else [table["x"]]
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
    named = {column.name: read.values[column.name] for column in columns[: len(xs)]}
    own_model = table.get("model")
    options: dict[str, Any] = {}
    if "noise" in table:
        options["noise"] = _noise(path, where, table["noise"])
    try:
        return Dataset(
            x=named if isinstance(table["x"], list) else next(iter(named.values())),
            y=by_key["y"],
            sigma=sigma,
            function=None if own_model is None else _model(path, own_model, black_box=False),
            own=_table(path, f"{where}.own", table.get("own", {})),
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
    except InputError:
        raise
    except (jax.errors.TracerArrayConversionError, jax.errors.ConcretizationTypeError):
        return  # the fit says what to do about it
    except Exception as error:
        raise InputError(
            f"model {problem.name!r} failed with {type(error).__name__}: {_one_line(error)}; "
            "correct the function."
        ) from None


def _table(path: Path, key: str, given: Any) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise InputError(f"{path.name}: {key!r} must be a table, not {given!r}.")
    return given


def _check_keys(path: Path, where: str, table: dict[str, Any], known: tuple[str, ...]) -> None:
    for key in table:
        if key not in known:
            place = f"in {where} " if where else ""
            raise InputError(f"{path.name}: unknown key {key!r} {place}{nearest(key, known)}.")


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split()).rstrip(".")
    return text if len(text) <= 200 else text[:197] + "..."
