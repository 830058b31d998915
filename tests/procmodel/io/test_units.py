"""Factors between units, and the shortcut that spares the loading of pint."""

import contextlib
import subprocess
import sys

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from procmodel.errors import InputError
from procmodel.io import conversion_factor
from procmodel.io import units as units_module
from procmodel.io.units import COMMON_UNITS, is_unit

LENGTHS = [unit for unit, (quantity, _) in COMMON_UNITS.items() if quantity == "length"]
AREAS = [unit for unit, (quantity, _) in COMMON_UNITS.items() if quantity == "area"]


@pytest.mark.parametrize(
    ("unit", "target", "factor"),
    [
        ("mm", "um", 1000.0),
        ("nm", "um", 1e-3),
        ("m", "um", 1e6),
        ("\u00b5m", "um", 1.0),
        ("\u03bcm", "um", 1.0),
        ("mm^2", "um^2", 1e6),
        ("um2", "um^2", 1.0),
        ("\u00b5m\u00b2", "um^2", 1.0),
        ("nm", "mm", 1e-6),
        (" mm ", "um", 1000.0),
        ("-", "1", 1.0),
    ],
)
def test_common_units_convert_exactly(unit, target, factor):
    assert conversion_factor(unit, target) == factor


@pytest.mark.parametrize(
    ("unit", "target", "factor"),
    [("inch", "um", 25400.0), ("cm", "um", 1e4), ("1/min", "Hz", 1 / 60), ("%", "-", 0.01)],
)
def test_other_units_convert_by_pint(unit, target, factor):
    assert conversion_factor(unit, target) == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize("units", [LENGTHS, AREAS], ids=["lengths", "areas"])
def test_the_shortcut_agrees_with_pint(units):
    for unit in units:
        for target in units:
            by_pint = units_module._factor_by_pint(unit, target)
            assert conversion_factor(unit, target) == pytest.approx(by_pint, rel=1e-13)


def test_neither_importing_io_nor_common_units_load_pint():
    program = (
        "import sys; from procmodel.io import conversion_factor;"
        "conversion_factor('mm', 'um');"
        "assert not {'pint', 'jax', 'shapely'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


@pytest.mark.parametrize(
    ("unit", "target", "sentence"),
    [
        ("s", "um", "unit 's' measures time, not length: give the values in 'um'"),
        ("mm^2", "um", "unit 'mm^2' measures area, not length"),
        ("cm^2", "um", "unit 'cm^2' measures area, not length"),
        ("%", "um", "unit '%' measures a plain number, not length"),
        ("UM", "um", "unknown unit 'UM': write 'um'"),
        ("furlow", "um", "unknown unit 'furlow': write 'um'"),
        ("2 mm", "um", "unknown unit '2 mm': write 'um'"),
        ("", "um", "unknown unit '': write 'um'"),
        ("degC", "K", "unit 'degC' is not proportional to 'K': use 'K' itself"),
    ],
)
def test_wrong_units_are_refused(unit, target, sentence):
    with pytest.raises(InputError) as raised:
        conversion_factor(unit, target)
    assert sentence in str(raised.value)


@settings(deadline=None)
@given(st.text(alphabet="umµ²^*/()[]{}\"' \\x.-+%#a", max_size=8))
@example('"')
@example("um**x")
@example("um)")
def test_any_text_is_a_unit_or_refused(text):
    if is_unit(text):
        with contextlib.suppress(InputError):
            assert conversion_factor(text, "um") > 0
    else:
        with pytest.raises(InputError):
            conversion_factor(text, "um")
