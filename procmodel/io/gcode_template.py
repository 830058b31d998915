"""Templates that give a program the words of the user's own control."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from string import Formatter

from procmodel.errors import InputError
from procmodel.io.textfile import read_utf8

_WHOLE_NUMBERS = ("number", "layer_count", "pass_count", "quarter_turns")
_WORDS = ("shape", "passes", "name", "moves")


@dataclass(frozen=True)
class TemplateKind:
    """What the templates of one kind of program look like.

    Attributes
    ----------
    generic : str
        File in this package that holds the generic texts.
    allowed : mapping of str to tuple of str
        The entries, and the fields that each may hold.
    needed : mapping of str to tuple of str
        Fields without which a program would move elsewhere than planned.
    """

    generic: str
    allowed: Mapping[str, tuple[str, ...]]
    needed: Mapping[str, tuple[str, ...]]


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

SCANNING = TemplateKind(
    generic="generic_iso.toml",
    allowed={
        "header": _EVERYWHERE,
        "layer": (*_EVERYWHERE, *_OF_LAYER, "passes"),
        "plunge": (*_EVERYWHERE, *_OF_LAYER),
        "line": (*_EVERYWHERE, "x", "y"),
        "turn": (*_EVERYWHERE, "number", "quarter_turns"),
        "clockwise_arc": (*_EVERYWHERE, "x", "y", "i", "j"),
        "counterclockwise_arc": (*_EVERYWHERE, "x", "y", "i", "j"),
        "footer": _EVERYWHERE,
    },
    # The arcs are full circles, which end where they begin.
    needed={
        "layer": ("z", "start_x", "start_y", "passes"),
        "line": ("x", "y"),
        "turn": ("quarter_turns",),
        "clockwise_arc": ("i", "j"),
        "counterclockwise_arc": ("i", "j"),
    },
)


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

    `SCANNING` lists the fields of each; lengths are filled in as mm, feed rates as mm/min.

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
    turn : str
        Turn of the electrode about its axis before a layer.
    clockwise_arc, counterclockwise_arc : str
        One full circle.
    """

    header: str
    layer: str
    plunge: str
    line: str
    turn: str
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
    return GcodeTemplate(**read_texts(SCANNING, path))


def read_texts(kind: TemplateKind, path: str | os.PathLike[str] | None = None) -> dict[str, str]:
    """Texts of a template of any kind, by entry; see `read_template`."""
    with resources.as_file(resources.files("procmodel.io") / kind.generic) as generic:
        texts = _read_entries(kind, generic)
    if path is not None:
        texts |= _read_entries(kind, Path(path))
    return texts


def _read_entries(kind: TemplateKind, path: Path) -> dict[str, str]:
    try:
        entries = tomllib.loads(read_utf8(path))
    except tomllib.TOMLDecodeError as error:
        raise InputError(
            f"{path}: this is not TOML ({error}): correct it, or begin from {kind.generic}"
        ) from error
    return {name: _checked_text(kind, path, name, text) for name, text in entries.items()}


def _checked_text(kind: TemplateKind, path: Path, name: str, text: object) -> str:
    if name not in kind.allowed:
        raise InputError(f"{path}: unknown entry '{name}': {_choose(name, tuple(kind.allowed))}")
    if not isinstance(text, str):
        raise InputError(f"{path}: entry '{name}' is not text: put it in quotes")
    _check_fields(kind, path, name, text)
    return text.strip("\n")


def _check_fields(kind: TemplateKind, path: Path, name: str, text: str) -> None:
    """Refuse fields that cannot be filled in, now rather than in the middle of a program."""
    try:
        parts = list(Formatter().parse(text))
    except ValueError as error:
        raise InputError(
            f"{path}: entry '{name}' has unbalanced braces ({error}): "
            "double a brace that shall stand in the program"
        ) from error
    used = [(field, form or "") for _, field, form, _ in parts if field is not None]
    allowed = kind.allowed[name]
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
    for needed in kind.needed.get(name, ()):
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


def _choose(given: str, allowed: tuple[str, ...]) -> str:
    """Advice that lists what may be written, the likeliest meant first."""
    nearest = get_close_matches(given, allowed, n=1)
    meant = f"did you mean '{nearest[0]}'? " if nearest else ""
    return f"{meant}allowed are {', '.join(allowed)}"
