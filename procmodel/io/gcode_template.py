"""Templates that give a program the words of the user's own control."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from string import Formatter

from procmodel.errors import InputError
from procmodel.io.textfile import read_utf8

_EVERYWHERE = (
    "shape",
    "layer_count",
    "electrode_radius",
    "side_gap",
    "safe_z",
    "scan_feed",
    "plunge_feed",
)
_OF_LAYER = ("number", "cumulative_feed", "half_width", "z", "start_x", "start_y")

ALLOWED_FIELDS: dict[str, tuple[str, ...]] = {
    "header": _EVERYWHERE,
    "layer": (*_EVERYWHERE, *_OF_LAYER, "passes"),
    "plunge": (*_EVERYWHERE, *_OF_LAYER),
    "line": (*_EVERYWHERE, "x", "y"),
    "clockwise_arc": (*_EVERYWHERE, "x", "y", "i", "j"),
    "counterclockwise_arc": (*_EVERYWHERE, "x", "y", "i", "j"),
    "footer": _EVERYWHERE,
}

# Without these the program would move elsewhere than planned.
_NEEDED_FIELDS: dict[str, tuple[str, ...]] = {
    "layer": ("z", "start_x", "start_y", "passes"),
    "line": ("x", "y"),
    "clockwise_arc": ("i", "j"),
    "counterclockwise_arc": ("i", "j"),
}

_WHOLE_NUMBERS = ("number", "layer_count")
_WORDS = ("shape", "passes")


class Millimetres(float):
    """A number that a template writes with four decimals (0.1 um), unless it asks for others."""

    def __format__(self, specification: str) -> str:
        # The z writes zero without a sign: a control may refuse -0.0000.
        return super().__format__(specification or "z.4f")


class FeedRate(float):
    """A feed rate in mm/min that a template writes with as many decimals as it has, up to 4."""

    def __format__(self, specification: str) -> str:
        if specification:
            return super().__format__(specification)
        return super().__format__(".4f").rstrip("0").rstrip(".")


@dataclass(frozen=True)
class GcodeTemplate:
    """Texts of a program, with fields in braces as in `str.format`.

    `ALLOWED_FIELDS` lists the fields of each; lengths are filled in as mm, feed rates as mm/min.

    Attributes
    ----------
    header, footer : str
        Begin and end of the program.
    layer : str
        One layer: start above, feed in Z, `{passes}`, retract.
    plunge : str
        What stands for the passes in a layer that the electrode fills alone.
    line : str
        One straight move.
    clockwise_arc, counterclockwise_arc : str
        One full circle.
    """

    header: str
    layer: str
    plunge: str
    line: str
    clockwise_arc: str
    counterclockwise_arc: str
    footer: str


def read_template(path: str | os.PathLike[str] | None = None) -> GcodeTemplate:
    """Read a template from a TOML file.

    Parameters
    ----------
    path : path-like, optional
        A changed copy of `generic_iso.toml`; entries it leaves out keep their generic text.
        Without a path, the generic template itself.

    Returns
    -------
    GcodeTemplate
        The texts, every field in them checked.

    Raises
    ------
    InputError
        If the file is not TOML, an entry is unknown or not text, or a text holds an unknown
        field, lacks a needed one, or formats one in a way that it cannot be written.
    """
    with resources.as_file(resources.files("procmodel.io") / "generic_iso.toml") as generic:
        texts = _read_texts(generic)
    if path is not None:
        texts |= _read_texts(Path(path))
    return GcodeTemplate(**texts)


def _read_texts(path: Path) -> dict[str, str]:
    try:
        entries = tomllib.loads(read_utf8(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            f"{path}: this is not TOML ({error}): correct it, or begin from generic_iso.toml"
        ) from error
    return {name: _checked_text(path, name, text) for name, text in entries.items()}


def _checked_text(path: Path, name: str, text: object) -> str:
    known = [field.name for field in fields(GcodeTemplate)]
    if name not in known:
        raise InputError(f"{path}: unknown entry '{name}': {_choose(name, known)}")
    if not isinstance(text, str):
        raise InputError(f"{path}: entry '{name}' is not text: put it in quotes")
    _check_fields(path, name, text)
    return text.strip("\n")


def _check_fields(path: Path, name: str, text: str) -> None:
    """Refuse fields that cannot be filled in, now rather than in the middle of a program."""
    try:
        parts = list(Formatter().parse(text))
    except ValueError as error:
        raise InputError(
            f"{path}: entry '{name}' has unbalanced braces ({error}): "
            "double a brace that shall stand in the program"
        ) from error
    used = [(field, form or "") for _, field, form, _ in parts if field is not None]
    allowed = ALLOWED_FIELDS[name]
    for field, form in used:
        if field not in allowed:
            raise InputError(
                f"{path}: unknown field '{{{field}}}' in entry '{name}': {_choose(field, allowed)}"
            )
        if "{" in form:
            raise InputError(
                f"{path}: field '{{{field}}}' in entry '{name}' has braces in its format: "
                "write the number of decimals itself, as in {z:.3f}"
            )
    present = {field for field, _ in used}
    for needed in _NEEDED_FIELDS.get(name, ()):
        if needed not in present:
            raise InputError(
                f"{path}: entry '{name}' lacks '{{{needed}}}': add it where it belongs"
            )
    try:
        text.format_map(_sample_values(allowed))
    except (ValueError, KeyError, IndexError, AttributeError) as error:
        raise InputError(
            f"{path}: entry '{name}' cannot be filled in ({error}): "
            "write fields as {z} or {z:.3f}"
        ) from error


def _sample_values(names: tuple[str, ...]) -> Mapping[str, object]:
    return {
        name: 1 if name in _WHOLE_NUMBERS else "text" if name in _WORDS else Millimetres(1.0)
        for name in names
    }


def _choose(given: str, allowed: list[str] | tuple[str, ...]) -> str:
    """Advice that lists what may be written, the likeliest meant first."""
    nearest = get_close_matches(given, allowed, n=1)
    meant = f"did you mean '{nearest[0]}'? " if nearest else ""
    return f"{meant}allowed are {', '.join(allowed)}"
