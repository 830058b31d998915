"""What the commands share: one-sentence errors, JSON on stdout, messages on stderr."""

import json
import math
import sys
from typing import Any

from procmodel.errors import InputError

BAD_INPUT = 2
NOT_CONVERGED = 1


def say(message: str) -> None:
    """Write a message for the reader, to stderr, so that stdout stays for results.

    Parameters
    ----------
    message : str
        One line or more.
    """
    print(message, file=sys.stderr, flush=True)


def show(result: dict[str, Any], text: str, as_json: bool) -> None:
    """Print a result on stdout: one JSON object, or the text.

    Parameters
    ----------
    result : dict
        For JSON; numbers that are not finite become null.
    text : str
        For people.
    as_json : bool
        Which of the two.
    """
    print(json_text(result) if as_json else text, flush=True)


def json_text(result: dict[str, Any]) -> str:
    """A result as one line of strict JSON.

    Parameters
    ----------
    result : dict
        Plain types, NumPy numbers allowed.

    Returns
    -------
    str
        The JSON.
    """
    return json.dumps(_plain(result), allow_nan=False, ensure_ascii=False)


def electrode_area(diameter: float | None, area: float | None, prefix: str = "electrode") -> float:
    """Cross-section from the one of two options that was given.

    Parameters
    ----------
    diameter : float, optional [um]
        Of a round electrode.
    area : float, optional [um^2]
        Of any electrode.
    prefix : str
        Start of the options' names, for the error.

    Returns
    -------
    float [um^2]
        The area.

    Raises
    ------
    InputError
        If none or both are given, or it is not above 0.
    """
    if (diameter is None) == (area is None):
        raise InputError(f"give either --{prefix}-diameter or --{prefix}-area, one of the two.")
    name, value = ("diameter", diameter) if area is None else ("area", area)
    if not (value is not None and math.isfinite(value) and value > 0):
        raise InputError(f"--{prefix}-{name} is {value:g}, but must be above 0.")
    return value if name == "area" else math.pi * value**2 / 4.0


def required(value: Any, option: str, reason: str) -> Any:
    """The value of an option that another option makes necessary.

    Parameters
    ----------
    value : object
        What was given, None when nothing.
    option : str
        Such as "--radius".
    reason : str
        Such as "a hemisphere".

    Returns
    -------
    object
        The value.

    Raises
    ------
    InputError
        If nothing was given.
    """
    if value is None:
        raise InputError(f"{option} is missing: {reason} needs it.")
    return value


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
