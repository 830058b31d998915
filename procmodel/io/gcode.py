"""Programs that scan a cavity layer by layer, as generic ISO G-code.

The words are those of ISO 6983 and come from a template, `generic_iso.toml`, that a user adapts to
a control (`procmodel.io.gcode_template`). They are no maker's dialect: check a program before
running it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor
from typing import Literal

import numpy as np

from procmodel.errors import InputError
from procmodel.io.atomic import write_text
from procmodel.io.gcode_template import FeedRate, GcodeTemplate, Millimetres

Shape = Literal["square", "circle"]

# Four decimals of a millimetre: what the program writes.
STEPS_PER_UM = 10

# Between the corners of two square contours a round electrode leaves an island unless the step
# is at most its radius times (1 + sqrt(1/2)); in terms of the overlap:
LEAST_OVERLAP_OF_SQUARES = 1 - (1 + 0.5**0.5) / 2


@dataclass(frozen=True)
class ProgramLayer:
    """One layer of a cavity.

    Attributes
    ----------
    number : int
        Number of the layer, for the remarks in the program.
    cumulative_feed : float, um
        Feed of the electrode from the workpiece top, all layers up to this one; a multiple of
        0.1 um, so that the program says exactly what was planned.
    half_width : float, um
        Half the width (square) or the radius (circle) that the electrode's side sweeps. The
        cavity becomes wider by the side gap.
    """

    number: int
    cumulative_feed: float
    half_width: float


@dataclass(frozen=True)
class Scanning:
    """How the layers are scanned.

    Attributes
    ----------
    shape : {'square', 'circle'}
        Section of the cavity.
    electrode_radius : float, um
        Radius of the round electrode.
    scan_feed : float, mm/min
        Feed rate along the passes.
    plunge_feed : float, mm/min
        Feed rate in Z.
    side_gap : float, um
        Expected gap beside the electrode; it stands in the header and moves nothing.
    overlap : float
        Share of the electrode's width by which neighbouring passes overlap, from 0 to below 1;
        for squares at least 0.147, below which islands stay between the corners of the contours.
    safe_height : float, um
        Height above the workpiece top for moves between the layers.

    Raises
    ------
    InputError
        If a value is out of its range; the text names it.
    """

    shape: Shape
    electrode_radius: float
    scan_feed: float
    plunge_feed: float
    side_gap: float = 0.0
    overlap: float = 0.2
    safe_height: float = 1000.0

    def __post_init__(self) -> None:
        if self.shape not in ("square", "circle"):
            raise InputError(f"shape '{self.shape}' is unknown: choose 'square' or 'circle'")
        _check_settings(self)
        least = LEAST_OVERLAP_OF_SQUARES if self.shape == "square" else 0.0
        if not least <= self.overlap < 1:
            raise InputError(
                f"overlap is {self.overlap:g}: give a share of the electrode's width from "
                f"{least:.3g} to below 1, so that a {self.shape} is swept without islands"
            )


@dataclass(frozen=True)
class PolylineLayer:
    """One layer of a cavity of any shape.

    Attributes
    ----------
    number, cumulative_feed, half_width
        As of a `ProgramLayer`.
    runs : sequence of numpy.ndarray, each of shape (n, 2), um
        Ways of the electrode's centre at depth, one after another; between them it is lifted. A
        run of one point is a plunge.
    quarter_turns : int
        Quarter turns of the electrode about its axis, from how it was mounted.
    """

    number: int
    cumulative_feed: float
    half_width: float
    runs: Sequence[np.ndarray]
    quarter_turns: int = 0


@dataclass(frozen=True)
class PolylineScanning:
    """How polylines are scanned; the fields are those of `Scanning`.

    Attributes
    ----------
    shape : str
        What the cavity is called in the header.
    electrode_radius : float, um
        Radius of a round electrode, half the side of a square one.
    scan_feed, plunge_feed : float, mm/min
        Feed rate along the passes and in Z.
    side_gap, safe_height : float, um
        Expected gap, and height for moves between the passes.

    Raises
    ------
    InputError
        If a value is out of its range; the text names it.
    """

    shape: str
    electrode_radius: float
    scan_feed: float
    plunge_feed: float
    side_gap: float = 0.0
    safe_height: float = 1000.0

    def __post_init__(self) -> None:
        _check_settings(self)


def write_program(
    path: str | os.PathLike[str],
    template: GcodeTemplate,
    layers: Sequence[ProgramLayer],
    scanning: Scanning,
) -> None:
    """Write the program to a file, completely or not at all; see `program_text`.

    Raises
    ------
    InputError
        As `program_text`, or if the file cannot be written.
    """
    write_text(path, program_text(template, layers, scanning))


def program_text(
    template: GcodeTemplate, layers: Sequence[ProgramLayer], scanning: Scanning
) -> str:
    """Program that scans each layer at its own Z and retracts after it.

    A layer is scanned along concentric contours from its edge inwards, until its centre is
    covered. The direction alternates from layer to layer (to-and-fro), which alternates the tilt
    of the layers. A layer narrower than the electrode becomes a single plunge at the centre.

    Parameters
    ----------
    template : GcodeTemplate
        The words of the program; `read_template()` gives the generic ones.
    layers : sequence of ProgramLayer
        From the top downwards.
    scanning : Scanning
        Electrode, overlap and feed rates.

    Returns
    -------
    str
        The program, in absolute millimetres with X and Y zero in the cavity's centre and Z zero
        where the electrode touches the workpiece top.

    Raises
    ------
    InputError
        If there is no layer, a feed does not increase or is no multiple of 0.1 um, or a half
        width is not positive; the text names the layer.
    """
    _check_layers(layers)
    common = _common_values(scanning, len(layers))
    blocks = [
        template.header.format_map(common),
        *(
            _layer_block(template, layer, scanning, common, clockwise=index % 2 == 1)
            for index, layer in enumerate(layers)
        ),
        template.footer.format_map(common),
    ]
    return "\n".join(blocks) + "\n"


def write_polyline_program(
    path: str | os.PathLike[str],
    template: GcodeTemplate,
    layers: Sequence[PolylineLayer],
    scanning: PolylineScanning,
) -> None:
    """Write the program to a file, completely or not at all; see `polyline_program_text`.

    Raises
    ------
    InputError
        As `polyline_program_text`, or if the file cannot be written.
    """
    write_text(path, polyline_program_text(template, layers, scanning))


def polyline_program_text(
    template: GcodeTemplate, layers: Sequence[PolylineLayer], scanning: PolylineScanning
) -> str:
    """Program that follows given polylines in every layer.

    Parameters
    ----------
    template : GcodeTemplate
        The words of the program. Every run of a layer is written as a layer of its own, with the
        same number and Z.
    layers : sequence of PolylineLayer
        From the top downwards.
    scanning : PolylineScanning
        Electrode and feed rates.

    Returns
    -------
    str
        The program, in absolute millimetres, X and Y as in the polylines.

    Raises
    ------
    InputError
        As `program_text`, or if a layer has no run.
    """
    _check_layers(layers)
    common = _common_values(scanning, len(layers))
    blocks = [template.header.format_map(common)]
    turns = 0
    for layer in layers:
        if not layer.runs:
            raise InputError(f"layer {layer.number}: it has no way to follow: give one run or more")
        if layer.quarter_turns != turns:
            turns = layer.quarter_turns
            words = {"number": layer.number, "quarter_turns": turns}
            blocks.append(template.turn.format_map(common | words))
        blocks += [_run_block(template, layer, run, common) for run in layer.runs]
    blocks.append(template.footer.format_map(common))
    return "\n".join(blocks) + "\n"


def _run_block(
    template: GcodeTemplate, layer: PolylineLayer, run: np.ndarray, common: dict[str, object]
) -> str:
    # As written, so that a move shorter than a written step is left out.
    steps = np.round(np.asarray(run, float) * STEPS_PER_UM)
    moved = np.append(True, np.any(np.diff(steps, axis=0) != 0, axis=1))
    points = (steps[moved] / STEPS_PER_UM).tolist()
    values = common | _layer_values(layer, *points[0])
    if len(points) == 1:
        passes = template.plunge.format_map(values)
    else:
        passes = "\n".join(_move(template.line, common, (x, y)) for x, y in points[1:])
    return template.layer.format_map(values | {"passes": passes})


def contour_offsets(half_width: float, electrode_radius: float, overlap: float) -> list[float]:
    """Distances of the electrode's centre from the cavity's centre, one per contour.

    Parameters
    ----------
    half_width : float, um
        Half width that the electrode's side sweeps.
    electrode_radius : float, um
        Radius of the electrode.
    overlap : float
        Share of the electrode's width by which neighbouring contours overlap.

    Returns
    -------
    list of float, um
        From the edge inwards, multiples of 0.1 um; 0 is a point. The last contour overlaps
        itself across the centre by the same share, or is that point.
    """
    # Counted in written steps. A rounded distance between contours must not exceed the exact one:
    # without overlap it would leave a thin ring standing.
    offset = round(max(half_width - electrode_radius, 0.0) * STEPS_PER_UM)
    spacing = max(floor(2 * electrode_radius * (1 - overlap) * STEPS_PER_UM + 1e-9), 1)
    offsets = [offset]
    while offset > spacing / 2:
        offset = max(offset - spacing, 0)
        offsets.append(offset)
    return [steps / STEPS_PER_UM for steps in offsets]


def _check_settings(scanning: Scanning | PolylineScanning) -> None:
    for name in ("electrode_radius", "scan_feed", "plunge_feed", "safe_height"):
        value = getattr(scanning, name)
        if not 0 < value < float("inf"):
            raise InputError(f"{name} is {value:g}: give a number greater than zero")
    if not 0 <= scanning.side_gap < float("inf"):
        raise InputError(f"side_gap is {scanning.side_gap:g}: give zero or a positive number")


def _check_layers(layers: Sequence[ProgramLayer | PolylineLayer]) -> None:
    if not layers:
        raise InputError("the program has no layer: give at least one")
    above = 0.0
    for layer in layers:
        feed = layer.cumulative_feed
        if not above < feed < float("inf"):
            raise InputError(
                f"layer {layer.number}: its cumulative feed of {feed:g} um does not exceed the "
                f"{above:g} um above it: give the sum of all feeds down to the layer"
            )
        if abs(feed - round(feed * STEPS_PER_UM) / STEPS_PER_UM) > 1e-6:
            raise InputError(
                f"layer {layer.number}: its cumulative feed of {feed:.10g} um is no multiple of "
                f"{1 / STEPS_PER_UM:g} um: round it to the resolution of the machine"
            )
        if not 0 < layer.half_width < float("inf"):
            raise InputError(
                f"layer {layer.number}: its half width is {layer.half_width:g} um: "
                "give a number greater than zero"
            )
        above = feed


def _layer_block(
    template: GcodeTemplate,
    layer: ProgramLayer,
    scanning: Scanning,
    common: dict[str, object],
    clockwise: bool,
) -> str:
    offsets = contour_offsets(layer.half_width, scanning.electrode_radius, scanning.overlap)
    start_x, start_y = _contour_start(scanning.shape, offsets[0])
    values = common | _layer_values(layer, start_x, start_y)
    if offsets == [0.0]:
        passes = template.plunge.format_map(values)
    else:
        passes = "\n".join(_passes(template, scanning.shape, offsets, common, clockwise))
    return template.layer.format_map(values | {"passes": passes})


def _common_values(scanning: Scanning | PolylineScanning, layers: int) -> dict[str, object]:
    """Fields that stand in every text."""
    return {
        "shape": scanning.shape.upper(),
        "layer_count": layers,
        "electrode_radius": _millimetres(scanning.electrode_radius),
        "side_gap": _millimetres(scanning.side_gap),
        "safe_z": _millimetres(scanning.safe_height),
        "scan_feed": FeedRate(scanning.scan_feed),
        "plunge_feed": FeedRate(scanning.plunge_feed),
    }


def _layer_values(
    layer: ProgramLayer | PolylineLayer, start_x: float, start_y: float
) -> dict[str, object]:
    """Fields of one layer, or one run of it."""
    return {
        "number": layer.number,
        "cumulative_feed": _millimetres(layer.cumulative_feed),
        "half_width": _millimetres(layer.half_width),
        "z": _millimetres(-layer.cumulative_feed),
        "start_x": _millimetres(start_x),
        "start_y": _millimetres(start_y),
    }


def _passes(
    template: GcodeTemplate,
    shape: Shape,
    offsets: list[float],
    common: dict[str, object],
    clockwise: bool,
) -> Iterator[str]:
    """Moves along the contours, the electrode standing at the start of the first one."""
    for index, offset in enumerate(offsets):
        start = _contour_start(shape, offset)
        if index > 0:
            yield _move(template.line, common, start)
        if offset == 0.0:
            continue
        if shape == "square":
            for corner in _other_corners(offset, clockwise):
                yield _move(template.line, common, corner)
            yield _move(template.line, common, start)
        else:
            words = template.clockwise_arc if clockwise else template.counterclockwise_arc
            yield _move(words, common, start, i=_millimetres(-offset), j=_millimetres(0.0))


def _contour_start(shape: Shape, offset: float) -> tuple[float, float]:
    """Corner of a square contour, or the point of a circle on the X axis."""
    return (offset, offset if shape == "square" else 0.0)


def _other_corners(offset: float, clockwise: bool) -> list[tuple[float, float]]:
    counterclockwise = [(-offset, offset), (-offset, -offset), (offset, -offset)]
    return counterclockwise[::-1] if clockwise else counterclockwise


def _move(
    words: str, common: dict[str, object], end: tuple[float, float], **arc: Millimetres
) -> str:
    x, y = end
    return words.format_map(common | {"x": _millimetres(x), "y": _millimetres(y)} | arc)


def _millimetres(micrometres: float) -> Millimetres:
    return Millimetres(micrometres / 1000)
