"""Factors between units, so that every reader hands over one unit per quantity."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from procmodel.errors import InputError

if TYPE_CHECKING:
    import pint

_LENGTH, _AREA, _PLAIN_NUMBER = "length", "area", "a plain number"

# The units of nearly every file, as (dimension, power of ten of its SI unit). They spare the
# reader the loading of pint, which takes longer than most commands that read a table.
COMMON_UNITS: dict[str, tuple[str, int]] = {
    "m": (_LENGTH, 0),
    "mm": (_LENGTH, -3),
    "um": (_LENGTH, -6),
    "\N{MICRO SIGN}m": (_LENGTH, -6),
    "\N{GREEK SMALL LETTER MU}m": (_LENGTH, -6),
    "nm": (_LENGTH, -9),
    "m^2": (_AREA, 0),
    "mm^2": (_AREA, -6),
    "mm2": (_AREA, -6),
    "mm\N{SUPERSCRIPT TWO}": (_AREA, -6),
    "um^2": (_AREA, -12),
    "um2": (_AREA, -12),
    "um\N{SUPERSCRIPT TWO}": (_AREA, -12),
    "\N{MICRO SIGN}m^2": (_AREA, -12),
    "\N{MICRO SIGN}m\N{SUPERSCRIPT TWO}": (_AREA, -12),
    "\N{GREEK SMALL LETTER MU}m^2": (_AREA, -12),
    "\N{GREEK SMALL LETTER MU}m\N{SUPERSCRIPT TWO}": (_AREA, -12),
    "1": (_PLAIN_NUMBER, 0),
    "-": (_PLAIN_NUMBER, 0),
}


def conversion_factor(unit: str, target: str) -> float:
    """Factor that turns a value in `unit` into a value in `target`.

    Parameters
    ----------
    unit, target : str
        Units as written in a header: `um`, `mm^2`, `1/min`; `-` or `1` for a plain number.
        Upper and lower case differ (`mm` is a millimetre, `Mm` a megametre).

    Returns
    -------
    float
        The factor; exact to the last digit between the units of `COMMON_UNITS`.

    Raises
    ------
    InputError
        If a unit is unknown, measures another quantity than `target`, or is not proportional to
        it (a temperature in degrees Celsius).
    """
    unit, target = unit.strip(), target.strip()
    if unit in COMMON_UNITS and target in COMMON_UNITS:
        (quantity, power), (wanted_quantity, wanted_power) = (
            COMMON_UNITS[unit],
            COMMON_UNITS[target],
        )
        if quantity != wanted_quantity:
            raise _wrong_quantity(unit, quantity, target, wanted_quantity)
        return _power_of_ten(power - wanted_power)
    return _factor_by_pint(unit, target)


def is_unit(text: str) -> bool:
    """Whether `text` is a unit that `conversion_factor` knows."""
    text = text.strip()
    return text in COMMON_UNITS or _parse(text) is not None


def _power_of_ten(exponent: int) -> float:
    # A quotient of integers is rounded once; 10.0**-6 need not be the nearest number.
    return float(10**exponent) if exponent >= 0 else 1 / 10**-exponent


@cache
def _registry() -> pint.UnitRegistry:
    import pint

    return pint.UnitRegistry()


@cache
def _parse(text: str) -> pint.Unit | None:
    """Unit meant by `text`, or None where it is not a unit."""
    if text == "-":
        text = "1"
    # pint writes areas of the shop floor (`mm2`) only with the power sign.
    if text in COMMON_UNITS and text.endswith("2") and "^" not in text:
        text = f"{text[:-1]}^2"
    if not text:
        return None
    try:
        return _registry().parse_units(text)
    except Exception:
        # Text that is no unit reaches pint's tokeniser and its arithmetic, which raise errors of
        # a dozen unrelated types; each of them means the same here.
        return None


def _factor_by_pint(unit: str, target: str) -> float:
    parsed, wanted = _parse(unit), _parse(target)
    for text, meaning in ((unit, parsed), (target, wanted)):
        if meaning is None:
            raise InputError(f"unknown unit '{text}': {_remedy(text, target)}")
    assert parsed is not None and wanted is not None
    if parsed.dimensionality != wanted.dimensionality:
        raise _wrong_quantity(unit, _quantity(parsed), target, _quantity(wanted))
    quantity = _registry().Quantity
    if quantity(0.0, parsed).to(wanted).magnitude != 0.0:
        raise InputError(f"unit '{unit}' is not proportional to '{target}': use '{target}' itself")
    return float(quantity(1.0, parsed).to(wanted).magnitude)


def _remedy(text: str, target: str) -> str:
    """Advice for an unknown unit: the same letters in lower case, or the wanted unit."""
    lower = text.lower()
    return f"write '{lower if lower != text and is_unit(lower) else target}'"


def _quantity(unit: pint.Unit) -> str:
    """What a unit measures, in words as far as pint has them: `time`, `length / time`."""
    words = str(unit.dimensionality).replace("[", "").replace("]", "")
    return {"length ** 2": _AREA, "dimensionless": _PLAIN_NUMBER}.get(words, words)


def _wrong_quantity(unit: str, quantity: str, target: str, wanted_quantity: str) -> InputError:
    return InputError(
        f"unit '{unit}' measures {quantity}, not {wanted_quantity}: "
        f"give the values in '{target}' or a multiple of it"
    )
