"""Blocks of a G-code program split into words, and what the words that are refused mean."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from procmodel.errors import InputError

_MOTIONS = (0, 1, 2, 3)
_MODES = (4, 17, 20, 21, 80, 90, 90.1, 91, 91.1)
# Exact stop, tool length, the first zero point, feed in mm/min and the end of what is refused
# below: none of them moves the tool in X and Y.
_WITHOUT_EFFECT = (9, 15, 40, 43, 44, 49, 50, 54, 61, 61.1, 64, 69, 94, 98, 99)

_CYCLES = {
    73: "high-speed drilling cycle",
    74: "left-hand tapping cycle",
    76: "fine boring cycle",
    81: "drilling cycle",
    82: "drilling cycle with dwell",
    83: "deep-hole drilling cycle",
    84: "tapping cycle",
    85: "boring cycle",
    86: "boring cycle",
    87: "back boring cycle",
    88: "boring cycle",
    89: "boring cycle",
}

# What a refused word means, and what to do about it.
_REFUSED: dict[str, tuple[str, str]] = {
    "G5": ("spline", "write it as G1, G2 and G3"),
    "G10": ("setting of offsets", "delete the block, contours are read in one zero point"),
    "G16": ("polar coordinates", "write X and Y"),
    "G18": ("plane ZX", "write the contour in the plane XY, G17"),
    "G19": ("plane YZ", "write the contour in the plane XY, G17"),
    "G28": ("return to the reference point", "delete the block, or retract by G0"),
    "G30": ("return to the reference point", "delete the block, or retract by G0"),
    "G33": ("thread cutting", "delete the block"),
    "G41": (
        "cutter compensation left",
        "the path of the tool centre is not in the program: write it with G40, or give the "
        "contour as DXF",
    ),
    "G42": (
        "cutter compensation right",
        "the path of the tool centre is not in the program: write it with G40, or give the "
        "contour as DXF",
    ),
    "G51": ("scaling", "write the scaled coordinates"),
    "G52": ("shift of the zero point", "write all coordinates in one zero point"),
    "G53": ("machine coordinates", "write all coordinates in one zero point"),
    **{
        f"G{code}": ("another zero point", "write all coordinates in one zero point, G54")
        for code in (55, 56, 57, 58, 59)
    },
    "G65": ("macro call", "write the moves themselves"),
    "G66": ("macro call", "write the moves themselves"),
    "G68": ("rotated coordinates", "write the rotated coordinates"),
    "G92": ("shift of the zero point", "write all coordinates in one zero point"),
    "G93": ("inverse-time feed", "write the feed in mm/min, G94"),
    "G95": ("feed per revolution", "write the feed in mm/min, G94"),
    **{f"G{code}": (name, "write its moves as G0 and G1") for code, name in _CYCLES.items()},
    "M96": ("sub-program", "write its blocks in the program itself"),
    "M97": ("sub-program", "write its blocks in the program itself"),
    "M98": ("sub-program", "write its blocks in the program itself"),
    "M99": ("end of a sub-program", "end the program with M30"),
    **{axis: ("another axis", "contours have X, Y and Z only: delete it") for axis in "ABCUVW"},
    "K": ("centre in Z", "arcs lie in the plane XY: delete it"),
}

_KNOWN_CODES = {*_MOTIONS, *_MODES, *_WITHOUT_EFFECT}
_KNOWN_LETTERS = "GXYZIJRFSTMDHPQL"
_WORD = re.compile(r"([A-Z])([+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+))")


@dataclass(frozen=True)
class Block:
    """One line of a program.

    Attributes
    ----------
    line : int
        Its number in the file, from 1.
    motion : int or None
        0 to 3 for G0 to G3; None where it names none.
    codes : frozenset of float
        The other G codes, 90.1 for G90.1.
    words : dict of str to float
        Values of X, Y, Z, I, J, R and F, as written.
    deletable : bool
        Whether it begins with `/`.
    ends : bool
        Whether it ends the program (M2 or M30).
    """

    line: int
    motion: int | None
    codes: frozenset[float]
    words: dict[str, float]
    deletable: bool
    ends: bool


def parse_block(line: int, text: str) -> Block | None:
    """Words of one line.

    Parameters
    ----------
    line : int
        Its number in the file.
    text : str
        The line.

    Returns
    -------
    Block or None
        None where it holds nothing but comments, a block number or a program number.

    Raises
    ------
    InputError
        If it holds something unreadable or unsupported. The text leaves it to the caller to name
        the file and line.
    """
    code = re.sub(r"\s+", "", _without_comments(text)).upper()
    deletable = code.startswith("/")
    # A digit behind the slash chooses one of several switches.
    code = re.sub(r"^/[1-9]?(?=[^0-9]|$)", "", code)
    _refuse_expressions(code)
    if re.fullmatch(r"[O:][0-9]+", code):
        return None
    pairs = [(letter, value) for letter, value in _words(code) if letter != "N"]
    if not pairs:
        return None
    return _block(line, pairs, deletable)


def _without_comments(text: str) -> str:
    """The line without what stands in parentheses or behind a semicolon."""
    kept, depth = [], 0
    for character in text:
        if character == ";" and depth == 0:
            break
        depth += (character == "(") - (character == ")")
        if depth < 0:
            raise InputError("')' closes a comment that '(' has not opened: delete it")
        if depth == 0 and character != ")":
            kept.append(character)
    if depth > 0:
        raise InputError("a comment is not closed: write ')' at its end")
    return "".join(kept)


def _refuse_expressions(code: str) -> None:
    found = re.search(r"[#\[\]=]", code)
    if found or re.match(r"(?:N[0-9]+)?(?:IF|WHILE|GOTO|END[0-9]|DO[0-9])", code):
        raise InputError(
            f"'{code}' (macro expression) is not supported: write the numbers themselves"
        )
    if re.match(r"O(?:<|[0-9]+[A-Z])", code):
        raise InputError(
            f"'{code}' (sub-program or loop) is not supported: write its blocks in the program "
            "itself"
        )


def _words(code: str) -> list[tuple[str, float]]:
    words, position = [], 0
    while position < len(code):
        match = _WORD.match(code, position)
        if match is None:
            rest = code[position:]
            if rest.startswith(","):
                raise InputError(
                    f"',' in '{code}' is not supported: write decimal points, and roundings and "
                    "chamfers as moves"
                )
            problem = (
                f"'{rest[0]}' has no number" if rest[0].isalpha() else f"'{rest}' is no G-code word"
            )
            raise InputError(f"{problem}: correct or delete it")
        value = float(match[2])
        if not math.isfinite(value):
            raise InputError(f"{match[1]} is not a finite number: correct it")
        words.append((match[1], value))
        position = match.end()
    return words


def _block(line: int, pairs: list[tuple[str, float]], deletable: bool) -> Block:
    codes = {value for letter, value in pairs if letter == "G"}
    _refuse(pairs)
    words: dict[str, float] = {}
    for letter, value in pairs:
        if letter in "XYZIJRF":
            if letter in words:
                raise InputError(f"{letter} stands twice in the block: delete one of the two")
            words[letter] = value
    if 4 in codes:
        # X or F of a dwell is a time, not a place or a feed rate.
        words = {}
    motions = sorted(codes & set(_MOTIONS))
    if len(motions) > 1:
        raise InputError(
            f"G{motions[0]:g} and G{motions[1]:g} stand in one block: delete one of the two"
        )
    return Block(
        line=line,
        motion=int(motions[0]) if motions else None,
        codes=frozenset(codes - set(_MOTIONS)),
        words=words,
        deletable=deletable,
        ends=any(letter == "M" and value in (2, 30) for letter, value in pairs),
    )


def _refuse(pairs: list[tuple[str, float]]) -> None:
    for letter, value in pairs:
        number = f"{value:g}"
        # G59.1 is one of the family of G59, but G90.1 is not G90.
        for word in (letter, f"{letter}{number}", f"{letter}{int(value)}"):
            if word in _REFUSED:
                meaning, remedy = _REFUSED[word]
                raise InputError(f"{letter}{number} ({meaning}) is not supported: {remedy}")
        if letter == "G" and value not in _KNOWN_CODES:
            raise InputError(
                f"G{number} is not supported: write the contour with G0, G1, G2 and G3"
            )
        if letter not in _KNOWN_LETTERS:
            raise InputError(f"{letter}{number} is not supported: delete the word")
