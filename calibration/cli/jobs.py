"""Job files: a command and its options as TOML."""

import inspect
import tomllib
import typing
from pathlib import Path
from typing import Any

from typer.core import TyperArgument

from procmodel.errors import InputError, nearest
from procmodel.io.textfile import read_utf8


def arguments_of_job(path: Path, root: Any) -> list[str]:
    """The command line that a job file stands for.

    The file holds ``command = "wear fit"`` and one key for each option, spelt like the option
    with - or _; true switches a flag on, a list repeats the option. Files named in it are taken
    from the folder of the job file.

    Parameters
    ----------
    path : Path
        The job file.
    root : command object of the option parser
        The root command, which knows every option.

    Returns
    -------
    list of str
        Arguments for the root command.

    Raises
    ------
    InputError
        If the file is not TOML or names an unknown command or option.
    """
    try:
        job = tomllib.loads(read_utf8(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path.name} is not valid TOML ({error}): correct that line.") from None
    words = str(job.pop("command", "")).split()
    command = root
    for word in words:
        known = getattr(command, "commands", {})
        if word not in known:
            raise InputError(
                f"{path.name}: command {' '.join(words)!r} is unknown{nearest(word, list(known))}"
            )
        command = known[word]
    if not words or getattr(command, "commands", None) or words[0] == "run":
        raise InputError(f'{path.name}: write a command first, such as command = "wear fit".')
    known = {parameter.name.replace("_", "-"): parameter for parameter in command.params}
    known |= {o.lstrip("-"): p for p in command.params for o in p.opts if o.startswith("--")}
    hints = typing.get_type_hints(inspect.unwrap(command.callback), include_extras=True)
    options: list[str] = []
    positional: list[str] = []
    for key, value in job.items():
        name = key.replace("_", "-")
        if name not in known:
            raise InputError(f"{path.name}: unknown key {key!r}{nearest(name, list(known))}")
        parameter = known[name]
        is_path = _takes_path(hints[parameter.name])
        texts = [_as_text(path, key, item, is_path) for item in _listed(value)]
        if isinstance(parameter, TyperArgument):
            positional += texts
        elif isinstance(value, bool):
            options += _flag(path, key, value, parameter)
        elif getattr(parameter, "is_flag", False):
            raise InputError(f"{path.name}: key {key!r} is a switch: write true or false.")
        elif getattr(parameter, "nargs", 1) > 1:
            options += [parameter.opts[0], *texts]
        else:
            options += [part for text in texts for part in (parameter.opts[0], text)]
    return [*words, *options, "--", *positional] if positional else [*words, *options]


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _takes_path(hint: Any) -> bool:
    """Whether an annotation such as ``Annotated[Path | None, ...]`` is for a file."""
    return hint is Path or any(_takes_path(part) for part in typing.get_args(hint))


def _as_text(path: Path, key: str, value: Any, is_path: bool) -> str:
    if isinstance(value, dict):
        raise InputError(f"{path.name}: key {key!r} is a table, but must be a single value.")
    if is_path:
        return str(path.parent / str(value))
    return str(value)


def _flag(path: Path, key: str, value: bool, parameter: Any) -> list[str]:
    if not getattr(parameter, "is_flag", False):
        raise InputError(f"{path.name}: key {key!r} needs a value, not true or false.")
    return [parameter.opts[0]] if value else []
