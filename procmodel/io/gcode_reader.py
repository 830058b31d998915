"""Contours from G-code: the paths along which a milling program cuts.

Understood are G0 to G3 in the plane XY (G17) with centres by I and J (incremental, or absolute
after G90.1) or radius by R, G20/G21, G90/G91 and comments. Words that move nothing (F, S, T, M, N,
tool length and its like) are passed over. What would change the path in a way that is not followed
(cutter compensation, cycles, shifted zero points, sub-programs, macros) is refused by name.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.gcode_words import Block, parse_block
from procmodel.io.polyline import (
    JOIN_TOLERANCE,
    BulgePolyline,
    arc_bulge,
    arc_middle,
    checked,
    half_bulge,
)
from procmodel.io.textfile import read_bytes
from procmodel.io.units import conversion_factor

# How much further from the centre the end of an arc may be than its start, for programs in mm and
# in inches: what rounding to three and to four decimals can do.
ARC_TOLERANCE = {1.0: 2e-3, 25.4: 5e-3}

# Closer than this, in mm, two places are the same: sums of increments are not exact, and no
# control resolves less.
SAME_PLACE = 1e-6

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class GcodeProgram:
    """What a program cuts.

    Attributes
    ----------
    moves : tuple of BulgePolyline [mm]
        One for each uninterrupted run of cutting moves at constant Z, in their order; closed
        where the end meets the start. At least one.
    depths : tuple of float [mm]
        Z of each run; nan where the program has not yet named a Z.
    feeds : tuple of numpy.ndarray, shape (number of pieces,) [mm/min]
        Feed rate of each piece of each run; nan where the program has not yet named one.
    lines : tuple of numpy.ndarray, shape (number of pieces,), int
        Line of the file from which each piece of each run comes.
    ramps : int
        Number of cutting moves that change Z together with X or Y; they end a run and are not
        part of one.
    notes : tuple of str
        Sentences on what was assumed.
    """

    moves: tuple[BulgePolyline, ...]
    depths: tuple[float, ...]
    feeds: tuple[np.ndarray, ...]
    lines: tuple[np.ndarray, ...]
    ramps: int
    notes: tuple[str, ...]


def read_gcode(path: str | os.PathLike[str], units: str | None = None) -> GcodeProgram:
    """Read the cutting moves of a program.

    Parameters
    ----------
    path : path-like
        The file. Bytes that are not UTF-8, as in old comments, are read as Latin-1.
    units : {'mm', 'inch'}, optional
        Unit of a program that has neither G21 nor G20; without it, such a program is taken to be
        in millimetres and a note says so.

    Returns
    -------
    GcodeProgram
        The runs of cutting moves, in mm.

    Raises
    ------
    InputError
        If the file cannot be read, holds a word that is not supported, an arc whose end is not on
        its circle, a cut from an unknown position, or no cut at constant Z, or if it states
        another unit than `units`. The text names the file, the line and the remedy.

    Notes
    -----
    Blocks that begin with `/` are executed, as with the control's switch off; a note says so.
    """
    path = Path(path)
    reader = _Reader(path, _assumed_unit(path, units), units is not None)
    for line, text in _program_lines(path):
        try:
            block = parse_block(line, text)
            if block is None:
                continue
            reader.execute(block)
        except InputError as error:
            raise InputError(f"{path}, line {line}: {error}") from error
        if block.ends:
            break
    reader.end_run()
    return reader.program()


def _program_lines(path: Path) -> list[tuple[int, str]]:
    content = read_bytes(path)
    if b"\0" in content:
        raise InputError(f"{path}: this is a binary file, not G-code: give the program as text")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(text.replace("\r\n", "\n").replace("\r", "\n").split("\n"), 1):
        # The first % begins a program, what stands behind the second is not part of it.
        if line.strip().startswith("%"):
            if lines:
                break
        elif line.strip():
            lines.append((number, line))
    return lines


def _assumed_unit(path: Path, units: str | None) -> float:
    if units is None:
        return 1.0
    factor = conversion_factor(units, "mm")
    for known in ARC_TOLERANCE:
        if math.isclose(factor, known):
            return known
    raise InputError(f"{path}: units is '{units}', but G-code is in mm or inch: give one of these")


@dataclass
class _Run:
    """Cutting moves at one depth, while they are gathered."""

    depth: float
    points: list[Point]
    bulges: list[float] = field(default_factory=list)
    feeds: list[float] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)


class _Reader:
    """The control: its position and modes, and the runs gathered so far."""

    def __init__(self, path: Path, unit: float, unit_given: bool) -> None:
        self.path = path
        self.unit = unit
        self.unit_given = unit_given
        self.unit_stated = False
        self.motion: int | None = None
        self.absolute = True
        self.absolute_centres = False
        # nan until the program says where the tool is.
        self.position = {"X": math.nan, "Y": math.nan, "Z": math.nan}
        self.feed = math.nan
        self.run: _Run | None = None
        self.runs: list[_Run] = []
        self.ramps = 0
        self.notes: dict[str, str] = {}

    def execute(self, block: Block) -> None:
        """Set the modes of a block, then make its move."""
        if block.deletable:
            self._note(
                "deletable",
                f"line {block.line} begins with '/': it is executed, as with the switch for "
                "deletable blocks off",
            )
        if 54 in block.codes:
            self._note(
                "zero",
                f"line {block.line} chooses the zero point G54: X and Y are taken as written",
            )
        self._set_modes(block)
        words = block.words
        if words.keys() - {"F"} and not (self.unit_stated or self.unit_given):
            self._note(
                "unit", f"neither G21 nor G20 stands before line {block.line}: mm are assumed"
            )
        if "F" in words:
            self.feed = words["F"] * self.unit
        if words.keys() & set("XYZIJR"):
            self._move(block)

    def end_run(self) -> None:
        """Close the run of cutting moves, if there is one."""
        if self.run is not None:
            self.runs.append(self.run)
        self.run = None

    def program(self) -> GcodeProgram:
        """What was read."""
        if not self.runs:
            ramps = f" ({self.ramps} moves change Z while they cut)" if self.ramps else ""
            raise InputError(
                f"{self.path}: no cutting move G1, G2 or G3 in X and Y at constant Z{ramps}: "
                "give a program that cuts a contour at one depth"
            )
        runs = [_closed_where_it_ends(run) for run in self.runs]
        name = self.path.name
        moves = [
            BulgePolyline(
                np.array(run.points),
                np.array(run.bulges),
                closed,
                f"{name}, lines {run.lines[0]} to {run.lines[-1]}"
                if run.lines[0] != run.lines[-1]
                else f"{name}, line {run.lines[0]}",
            )
            for run, closed in runs
        ]
        return GcodeProgram(
            moves=tuple(checked(move) for move in moves),
            depths=tuple(run.depth for run, _ in runs),
            feeds=tuple(np.array(run.feeds) for run, _ in runs),
            lines=tuple(np.array(run.lines, dtype=np.int64) for run, _ in runs),
            ramps=self.ramps,
            notes=tuple(f"{name}: {note}" for note in self.notes.values()),
        )

    def _note(self, subject: str, sentence: str) -> None:
        """Keep a sentence, the first on each subject."""
        self.notes.setdefault(subject, sentence)

    def _set_modes(self, block: Block) -> None:
        codes = block.codes
        for one, other in ((20, 21), (90, 91), (90.1, 91.1)):
            if {one, other} <= codes:
                raise InputError(f"G{one} and G{other} stand in one block: delete one of the two")
        if codes & {20, 21}:
            stated = 25.4 if 20 in codes else 1.0
            if self.unit_given and stated != self.unit:
                raise InputError(
                    f"G{20 if 20 in codes else 21} contradicts the unit that was given for the "
                    "program: leave units out, or correct the block"
                )
            self.unit, self.unit_stated = stated, True
        if codes & {90, 91}:
            self.absolute = 90 in codes
        if codes & {90.1, 91.1}:
            self.absolute_centres = 90.1 in codes
        if block.motion is not None:
            self.motion = block.motion
        elif 80 in codes:
            self.motion = None

    def _move(self, block: Block) -> None:
        words = block.words
        if self.motion is None:
            raise InputError(
                f"{next(iter(words))} stands before any of G0, G1, G2 and G3: begin the block "
                "with one of them"
            )
        if self.motion < 2 and words.keys() & set("IJR"):
            word = next(letter for letter in "IJR" if letter in words)
            raise InputError(f"{word} stands without G2 or G3: write one of them, or delete it")
        start = self.position
        end = {axis: self._target(axis, words) for axis in "XYZ"}
        self.position = end
        begin, finish = (start["X"], start["Y"]), (end["X"], end["Y"])
        in_plane = bool(words.keys() & set("XYIJR"))
        if self.motion < 2 and math.dist(begin, finish) <= SAME_PLACE:
            in_plane = False
        if self.motion == 0 or ("Z" in words and not abs(end["Z"] - start["Z"]) <= SAME_PLACE):
            self.end_run()
            self.ramps += self.motion > 0 and in_plane
            return
        if not in_plane:
            return
        unknown = [axis for axis in "XY" if math.isnan(start[axis]) or math.isnan(end[axis])]
        if unknown:
            raise InputError(
                f"the cut begins at an unknown {' and '.join(unknown)}: write a G0 with X and Y "
                "in G90 before it"
            )
        if self.motion == 1:
            self._cut(block.line, begin, [(finish, 0.0)])
        else:
            self._cut(block.line, begin, self._arc(words, begin, finish))

    def _target(self, axis: str, words: dict[str, float]) -> float:
        if axis not in words:
            return self.position[axis]
        value = words[axis] * self.unit
        return value if self.absolute else self.position[axis] + value

    def _cut(self, line: int, begin: Point, pieces: list[tuple[Point, float]]) -> None:
        if self.run is None:
            self.run = _Run(self.position["Z"], [begin])
        for end, bulge in pieces:
            self.run.points.append(end)
            self.run.bulges.append(bulge)
            self.run.feeds.append(self.feed)
            self.run.lines.append(line)

    def _arc(self, words: dict[str, float], begin: Point, end: Point) -> list[tuple[Point, float]]:
        """Pieces of an arc, none longer than half a circle."""
        clockwise = self.motion == 2
        if "R" in words:
            bulge = self._bulge_by_radius(words, math.dist(begin, end), clockwise)
            return _halved(begin, end, bulge)
        centre = self._centre(words, begin)
        radius, radius_at_end = math.dist(centre, begin), math.dist(centre, end)
        if radius == 0:
            raise InputError("the centre of the arc is its start: correct I and J")
        if abs(radius_at_end - radius) > ARC_TOLERANCE[self.unit]:
            raise InputError(
                f"the end of the arc is {radius_at_end:.6g} mm from its centre but the start "
                f"{radius:.6g} mm, {abs(radius_at_end - radius):.3g} mm apart: correct X, Y, I or "
                f"J{self._other_centres(words, begin, end)}"
            )
        if math.dist(begin, end) <= SAME_PLACE:
            opposite = (2 * centre[0] - begin[0], 2 * centre[1] - begin[1])
            half = -1.0 if clockwise else 1.0
            return [(opposite, half), (end, half)]
        return _halved(begin, end, arc_bulge(begin, end, centre, clockwise))

    def _centre(self, words: dict[str, float], begin: Point) -> Point:
        if not words.keys() & {"I", "J"}:
            raise InputError("the arc has neither I and J nor R: add its centre or radius")
        if not self.absolute_centres:
            return (
                begin[0] + words.get("I", 0.0) * self.unit,
                begin[1] + words.get("J", 0.0) * self.unit,
            )
        if not words.keys() >= {"I", "J"}:
            raise InputError("an arc with an absolute centre (G90.1) needs both I and J: add both")
        return words["I"] * self.unit, words["J"] * self.unit

    def _other_centres(self, words: dict[str, float], begin: Point, end: Point) -> str:
        """Hint, where the other reading of I and J would put the end on the circle."""
        if self.absolute_centres or not words.keys() >= {"I", "J"}:
            return ""
        centre = (words["I"] * self.unit, words["J"] * self.unit)
        difference = abs(math.dist(centre, end) - math.dist(centre, begin))
        fits = difference <= ARC_TOLERANCE[self.unit]
        return ", or write G90.1 if they are absolute" if fits else ""

    def _bulge_by_radius(self, words: dict[str, float], chord: float, clockwise: bool) -> float:
        if words.keys() & {"I", "J"}:
            raise InputError("the arc has both R and a centre: delete one of the two")
        radius = words["R"] * self.unit
        if radius == 0:
            raise InputError("the radius of the arc is zero: correct R")
        if chord <= SAME_PLACE:
            raise InputError("a full circle cannot be written with R: write I and J")
        if chord / 2 - abs(radius) > ARC_TOLERANCE[self.unit]:
            raise InputError(
                f"the radius {abs(radius):.6g} mm is too small for an arc whose ends are "
                f"{chord:.6g} mm apart: correct R, or X and Y"
            )
        sine = min(chord / (2 * abs(radius)), 1.0)
        bulge = sine / (1 + math.sqrt(1 - sine**2))
        # A negative radius asks for the larger of the two arcs.
        if radius < 0:
            bulge = 1 / bulge
        return -bulge if clockwise else bulge


def _halved(begin: Point, end: Point, bulge: float) -> list[tuple[Point, float]]:
    if abs(bulge) <= 1:
        return [(end, bulge)]
    x, y = arc_middle(begin, end, bulge).tolist()
    half = float(half_bulge(bulge))
    return [((x, y), half), (end, half)]


def _closed_where_it_ends(run: _Run) -> tuple[_Run, bool]:
    """The run without the last point where that is the first one, and whether it is."""
    pieces = len(run.bulges)
    if math.dist(run.points[0], run.points[-1]) > JOIN_TOLERANCE:
        return run, False
    # There and back along one line encloses nothing.
    if pieces < 2 or (pieces == 2 and not any(run.bulges)):
        return run, False
    run.points.pop()
    if math.dist(run.points[-1], run.points[0]) <= SAME_PLACE:
        run.points.pop()
        del run.bulges[-1], run.feeds[-1], run.lines[-1]
    return run, True
