"""Headings, units and rates as recordings write them, and what they mean in SI."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from procmodel.errors import InputError
from procmodel.io.units import conversion_factor, is_unit

_GRAVITY = 9.80665
# Nearly every recording keeps to these; they spare the loading of pint. A lone `g` on a sensor's
# channel is the acceleration of gravity, not the gram that pint takes it for.
_COMMON: dict[str, tuple[float, str]] = {
    "": (1.0, "1"),
    "1": (1.0, "1"),
    "-": (1.0, "1"),
    "m/s^2": (1.0, "m/s^2"),
    "mm/s^2": (1e-3, "m/s^2"),
    "g": (_GRAVITY, "m/s^2"),
    "mg": (_GRAVITY * 1e-3, "m/s^2"),
    "m": (1.0, "m"),
    "mm": (1e-3, "m"),
    "um": (1e-6, "m"),
    "nm": (1e-9, "m"),
    "m/s": (1.0, "m/s"),
    "mm/s": (1e-3, "m/s"),
    "N": (1.0, "N"),
    "kN": (1e3, "N"),
    "V": (1.0, "V"),
    "mV": (1e-3, "V"),
    "A": (1.0, "A"),
    "Pa": (1.0, "Pa"),
    "s": (1.0, "s"),
    "ms": (1e-3, "s"),
    "us": (1e-6, "s"),
}
_TARGETS = ("m/s^2", "m", "m/s", "N", "V", "A", "Pa", "N*m", "W", "Hz", "rad", "s", "1")
_SPELLINGS = str.maketrans(
    {
        "\N{SUPERSCRIPT TWO}": "^2",
        "\N{MICRO SIGN}": "u",
        "\N{GREEK SMALL LETTER MU}": "u",
        "\N{MIDDLE DOT}": "*",
    }
)
_RATE_NAMES = ("rate", "fs", "samplingrate", "samplerate", "samplingfrequency", "samplefrequency")
_STEP_NAMES = ("wfincrement", "dt", "samplinginterval", "sampleinterval", "timestep")


def si_unit(unit: str) -> tuple[float, str]:
    """Factor to the SI unit of a quantity, and that unit.

    Parameters
    ----------
    unit : str
        As written in the file: `mm/s^2`, `m/s2`, `g` (gravity, not gram), `um`, `mV`; `1`, `-` or
        nothing for a plain number.

    Returns
    -------
    tuple of (float, str)
        The factor, and one of m/s^2, m, m/s, N, V, A, Pa, N*m, W, Hz, rad, s, 1.

    Raises
    ------
    InputError
        If the unit is unknown, or measures none of these quantities.
    """
    text = unit.strip().translate(_SPELLINGS).replace("**", "^")
    text = re.sub(r"(?<=[A-Za-z])([23])(?![0-9])", r"^\1", text)
    if text in _COMMON:
        return _COMMON[text]
    for target in _TARGETS:
        try:
            return conversion_factor(text, target), target
        except InputError:
            continue
    if not is_unit(text):
        raise InputError(f"unknown unit '{unit}': write 'm/s^2', 'm', 'N', 'V' or a multiple of it")
    raise InputError(
        f"unit '{unit}' measures nothing that vibrates: write one of {', '.join(_TARGETS)} or a "
        "multiple of it"
    )


def si_or_as_written(unit: str) -> tuple[float, str]:
    """`si_unit`, for files that no editor can correct: a unit it does not know stays as it is."""
    try:
        return si_unit(unit)
    except InputError:
        return 1.0, unit.strip()


def split_heading(heading: str) -> tuple[str, str | None]:
    """Name and unit of `acceleration y [m/s^2]`; None where no unit is written.

    Round brackets count as well, `force x (N)`.
    """
    match = re.fullmatch(r"(.*?\S)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))\s*", heading.strip())
    if match is None:
        return heading.strip(), None
    return match[1], (match[2] if match[2] is not None else match[3]).strip()


def rate_among(entries: Mapping[str, object]) -> float | None:
    """Sampling rate in Hz that the properties of a file name, or None.

    Parameters
    ----------
    entries : mapping of str to object
        Properties by name: `rate`, `fs`, `sampling rate [kHz]`, or a step as `dt` and
        `wf_increment`; names in any case. Entries that are no positive number are passed over.
    """
    for names, is_step in ((_RATE_NAMES, False), (_STEP_NAMES, True)):
        for entry, value in entries.items():
            name, unit = split_heading(entry)
            if re.sub(r"[\s_\-]", "", name).lower() not in names:
                continue
            try:
                number = float(value)  # type: ignore[arg-type]
            except (TypeError, ValueError):
                continue
            if not math.isfinite(number) or number <= 0.0:
                continue
            if unit:
                number *= conversion_factor(unit, "s" if is_step else "Hz")
            return 1.0 / number if is_step else number
    return None
