"""`procmodel electrode path`: the path of the wire's centre for a wanted electrode."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options
from calibration.cli.path_correct import PROGRAMS
from procmodel.errors import InputError

if TYPE_CHECKING:
    from procmodel.electrode import Profile

SHAPES = ("cone-frustum", "square-frustum", "curved")


def path_command(
    shape: Annotated[
        Path,
        typer.Argument(
            help="cone-frustum, square-frustum or curved; or a CSV of the profile's corners from "
            "the tip upwards, 'radius [um]', 'z [um]', optional 'bulge [-]'."
        ),
    ],
    tip_diameter: Annotated[
        float | None, typer.Option("--tip-diameter", help="At the tip [um].")
    ] = None,
    base_diameter: Annotated[
        float | None, typer.Option("--base-diameter", help="At the height [um].")
    ] = None,
    tip_width: Annotated[
        float | None, typer.Option("--tip-width", help="Across the flats at the tip [um].")
    ] = None,
    base_width: Annotated[
        float | None, typer.Option("--base-width", help="Across the flats at the height [um].")
    ] = None,
    height: Annotated[float | None, typer.Option("--height", help="From tip to base [um].")] = None,
    arc_radius: Annotated[
        float | None, typer.Option("--arc-radius", help="Of a curved profile [um].")
    ] = None,
    convex: Annotated[
        bool, typer.Option("--convex", help="The curved profile bulges; else it is a hollow.")
    ] = False,
    sides: Annotated[
        int | None,
        typer.Option(
            "--sides",
            help="Number of flats; 4 for square-frustum. With a CSV, radius is the half width.",
        ),
    ] = None,
    wire_diameter: Annotated[
        float, typer.Option("--wire-diameter", help="Of the wire [um].")
    ] = 0.0,
    gap: Annotated[float, typer.Option("--gap", help="Discharge gap counted on [um].")] = 0.0,
    roughing: Annotated[
        list[float] | None,
        typer.Option(
            "--roughing",
            help="What a roughing pass leaves for the next ones [um]; repeat it for several.",
        ),
    ] = None,
    lead_in: Annotated[
        float, typer.Option("--lead-in", help="How far before the tip the path starts [um].")
    ] = 0.0,
    step: Annotated[float, typer.Option("--step", help="Greatest step of the path [um].")] = 0.3,
    resolution: Annotated[
        float, typer.Option("--resolution", help="Step of the machine's axes [um].")
    ] = 0.1,
    feed: Annotated[float, typer.Option("--feed", help="Feed rate [mm/min].")] = 1.0,
    acceleration: Annotated[
        float | None,
        typer.Option("--acceleration", help="Of the machine [mm/s^2], for the time."),
    ] = None,
    clearance: Annotated[
        float,
        typer.Option("--clearance", help="How far beyond the paths a program retreats [um]."),
    ] = 500.0,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write every position of the steps here (CSV).")
    ] = None,
    gcode: Annotated[
        Path | None,
        typer.Option("--gcode", help="Write lines and arcs as a generic ISO program here."),
    ] = None,
    template: Annotated[
        Path | None, typer.Option("--template", help="TOML template of the program.")
    ] = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Path of the wire's centre, in steps of the machine, that leaves a wanted electrode."""
    options.check_outputs(out, gcode, plot=plot)
    if out is not None and out.suffix.lower() in PROGRAMS:
        raise InputError(f"{out.name}: --out writes a table: give a program as --gcode.")
    if template is not None and gcode is None:
        raise InputError("--template is given without --gcode, the program it is for: give both.")
    for option, value in (("--feed", feed), ("--acceleration", acceleration)):
        if value is not None and not 0.0 < value < math.inf:
            raise InputError(f"{option} is {value:g}, but must be above 0.")
    for option, value in (
        ("--wire-diameter", wire_diameter), ("--gap", gap), ("--clearance", clearance),
    ):  # fmt: skip
        if not 0.0 <= value < math.inf:
            raise InputError(f"{option} is {value:g}, but must be 0 or more.")
    allowances = [*(roughing or []), 0.0]
    if (
        any(not math.isfinite(a) for a in allowances)
        or sorted(set(allowances), reverse=True) != allowances
    ):
        raise InputError("--roughing leaves less from pass to pass, always above 0: sort them.")

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from procmodel.electrode import wire_path, with_leads

    wanted = _profile(
        shape, (tip_diameter, base_diameter), (tip_width, base_width), height, arc_radius, convex,
        sides,
    )  # fmt: skip
    paths = [
        with_leads(wire_path(wanted, 0.5 * wire_diameter, gap, left), lead_in)
        for left in allowances
    ]
    names = [f"roughing, {left:g} um left" for left in allowances[:-1]] + ["finishing"]
    moved = [_interpolated(path, step, resolution) for path in paths]
    result = {
        "shape": shape.name,
        "sides": wanted.sides,
        "step_um": step,
        "resolution_um": resolution,
        "wire_diameter_um": wire_diameter,
        "gap_um": gap,
        "passes": [
            {"name": name, "allowance_um": left}
            | _figures(path, points, step, resolution, feed, acceleration)
            for name, left, path, points in zip(names, allowances, paths, moved, strict=True)
        ],
        "dimensions": _dimensions(wanted),
        "notes": _notes(wanted, wire_diameter, gap, gcode is not None),
    }
    if gcode is not None:
        _write_program(gcode, template, paths, names, feed, clearance, wanted.sides)
    if out is not None:
        _write_positions(out, moved)
    if plot is not None:
        from calibration.plots.electrode import draw_wire_path
        from calibration.plots.figures import save

        reach = 0.5 * wire_diameter + gap
        save(draw_wire_path(wanted, paths[-1], step, resolution, reach), plot)
    console.show(result, _as_text(result), as_json)


def _profile(
    shape: Path,
    diameters: tuple[float | None, float | None],
    widths: tuple[float | None, float | None],
    height: float | None,
    arc_radius: float | None,
    convex: bool,
    sides: int | None,
) -> "Profile":
    from procmodel.electrode import cone_frustum, curved, square_frustum

    # A job file gives the name as a file of its own folder.
    name = shape.name
    given = {
        "--tip-diameter": diameters[0], "--base-diameter": diameters[1], "--tip-width": widths[0],
        "--base-width": widths[1], "--height": height, "--arc-radius": arc_radius,
        "--convex": convex or None, "--sides": sides,
    }  # fmt: skip
    round_ends = {"--tip-diameter", "--base-diameter", "--height"}
    needed = {
        "cone-frustum": round_ends,
        "square-frustum": {"--tip-width", "--base-width", "--height"},
        "curved": {*round_ends, "--arc-radius"},
    }.get(name, set())
    allowed = needed | {
        "cone-frustum": set(), "square-frustum": {"--sides"}, "curved": {"--convex"},
    }.get(name, {"--sides"})  # fmt: skip
    if name not in SHAPES and shape.suffix.lower() != ".csv":
        raise InputError(
            f"the shape is {name!r}, but must be {', '.join(SHAPES)} or a CSV of the profile."
        )
    for option, value in given.items():
        if value is not None and option not in allowed:
            raise InputError(f"{option} is not of the shape {name}: leave it out.")
        if option in needed:
            console.required(value, option, f"the shape {name}")
    if name not in SHAPES:
        return _read_profile(shape, sides)
    assert height is not None
    tip, base = widths if name == "square-frustum" else diameters
    assert tip is not None and base is not None
    if name == "square-frustum":
        return square_frustum(0.5 * tip, 0.5 * base, height, 4 if sides is None else sides)
    if name == "cone-frustum":
        return cone_frustum(0.5 * tip, 0.5 * base, height)
    assert arc_radius is not None
    return curved(0.5 * tip, 0.5 * base, height, arc_radius, convex)


def _read_profile(path: Path, sides: int | None) -> "Profile":
    import numpy as np

    from procmodel.electrode import from_bulges
    from procmodel.io import Column, read_table

    table = read_table(
        path, [Column("radius", "um"), Column("z", "um"), Column("bulge", "-", required=False)]
    )
    corners = np.column_stack([table.values["radius"], table.values["z"]])
    try:
        return from_bulges(corners, table.values.get("bulge"), sides)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _interpolated(path: "Profile", step: float, resolution: float) -> tuple[Any, Any, Any]:
    """Positions before and after rounding, and the piece of each."""
    from procmodel.electrode import interpolate_profile

    rounded, piece = interpolate_profile(path, step, resolution)
    return interpolate_profile(path, step)[0], rounded, piece


def _figures(
    path: "Profile",
    positions: tuple[Any, Any, Any],
    step: float,
    resolution: float,
    feed: float,
    acceleration: float | None,
) -> dict[str, Any]:
    import numpy as np

    from procmodel.electrode import Arc, chord_error, deviations, feed_along
    from procmodel.electrode.profile import length_of
    from procmodel.electrode.profile_steps import steps_of

    exact, rounded, piece = positions
    at_points, at_middles = deviations(path, rounded, piece)
    length = sum(float(length_of(one)) for one in path.pieces)
    bent = [one for one in path.pieces if isinstance(one, Arc) and float(one.radius) > 0.0]
    speed = feed * 1000.0 / 60.0
    time = length / speed
    if acceleration is not None:
        time = feed_along(exact, speed, 1000.0 * acceleration).duration
    return {
        "pieces": [
            {
                "kind": type(one).__name__.lower(),
                "length_um": float(length_of(one)),
                "radius_um": float(one.radius) if isinstance(one, Arc) else None,
                "steps": count,
            }
            for one, count in zip(path.pieces, steps_of(path, step), strict=True)
        ],
        "steps": len(rounded) - 1,
        "length_um": length,
        "start_um": rounded[0],
        "end_um": rounded[-1],
        "chord_error_um": max((float(chord_error(a.radius, step)) for a in bent), default=0.0),
        "rounding_um": float(np.max(np.abs(rounded - exact))),
        "deviation_um": float(max(np.abs(at_points).max(), np.abs(at_middles).max(initial=0.0))),
        "time_s": time,
    }


def _dimensions(wanted: "Profile") -> list[dict[str, float]]:
    from procmodel.electrode import section_area
    from procmodel.electrode.profile import ends

    corners = [ends(wanted.pieces[0])[0], *(ends(piece)[1] for piece in wanted.pieces)]
    what = "diameter_um" if wanted.sides is None else "width_um"
    return [
        {
            "z_um": float(z),
            what: 2.0 * float(x),
            "area_um2": float(section_area(x, wanted.sides)),
        }
        for x, z in corners
    ]


def _notes(wanted: "Profile", wire_diameter: float, gap: float, program: bool) -> list[str]:
    notes = []
    if wire_diameter == 0.0 and gap == 0.0:
        notes.append(
            "wire and gap are 0, so that the path is the profile itself: give --wire-diameter and "
            "--gap"
        )
    elif gap == 0.0:
        notes.append("no gap is counted on, so that the electrode gets thinner by it: give --gap")
    if wanted.sides is not None:
        notes.append(
            f"every pass is run {wanted.sides} times, the spindle {360 / wanted.sides:g} degrees "
            "further each time"
        )
    if program:
        notes.append("the program leaves the steps between the corners to the control")
    return notes


def _write_positions(out: Path, moved: list[tuple[Any, Any, Any]]) -> None:
    import numpy as np

    from procmodel.io import write_table

    rounded = [points for _, points, _ in moved]
    numbers = [np.full(len(points), i) for i, points in enumerate(rounded, start=1)]
    positions = np.concatenate(rounded)
    write_table(
        out,
        {
            "pass [1]": np.concatenate(numbers),
            "x [um]": positions[:, 0],
            "z [um]": positions[:, 1],
        },
    )


def _write_program(
    out: Path,
    template: Path | None,
    paths: "list[Profile]",
    names: list[str],
    feed: float,
    clearance: float,
    sides: int | None,
) -> None:
    import numpy as np

    from procmodel.electrode import Arc, index_angles
    from procmodel.electrode.profile import ends
    from procmodel.io import BulgePolyline
    from procmodel.io.gcode_profile import ProfileSettings, write_profile_program

    lines = []
    for path, name in zip(paths, names, strict=True):
        pieces = [p for p in path.pieces if not isinstance(p, Arc) or float(p.radius) > 0.0]
        points = [np.asarray(ends(pieces[0])[0]), *(np.asarray(ends(p)[1]) for p in pieces)]
        bulges = [math.tan(float(p.sweep) / 4) if isinstance(p, Arc) else 0.0 for p in pieces]
        lines.append(BulgePolyline(np.stack(points) / 1e3, np.array(bulges), False, name))
    widest = max(float(np.max(line.points[:, 0])) for line in lines)
    # An arc may bulge beyond its ends by its sagitta.
    bulging = max(float(np.max(np.abs(line.bulges) * line.chords / 2)) for line in lines)
    angles = () if sides is None else tuple(np.degrees(index_angles(sides)).tolist())
    settings = ProfileSettings(feed, widest + bulging + clearance / 1e3, angles)
    write_profile_program(out, lines, settings, template)


def _as_text(result: dict[str, Any]) -> str:
    flats = "" if result["sides"] is None else f", {result['sides']} flats"
    lines = [f"shape       {result['shape']}{flats}"]
    for one in result["dimensions"]:
        size = one.get("diameter_um", one.get("width_um"))
        lines.append(
            f"  z {one['z_um']:.3f} um: {'across' if result['sides'] else 'diameter'} "
            f"{size:.3f} um, area {one['area_um2']:.1f} um^2"
        )
    for i, one in enumerate(result["passes"], start=1):
        lines += [
            f"pass {i:<7}{one['name']}: {one['steps']} steps of {result['step_um']:g} um, "
            f"{one['length_um']:.3f} um, {one['time_s']:.1f} s",
            f"{'':<12}from x {one['start_um'][0]:.3f}, z {one['start_um'][1]:.3f} to "
            f"x {one['end_um'][0]:.3f}, z {one['end_um'][1]:.3f} um",
            f"{'':<12}off the path by {one['deviation_um']:.4f} um at most (chord "
            f"{one['chord_error_um']:.2g}, rounding {one['rounding_um']:.2g} per axis)",
        ]
    return "\n".join([*lines, *(f"note  {note}." for note in result["notes"])])
