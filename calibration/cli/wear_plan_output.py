"""What `wear plan` writes and prints."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from calibration.plans.layer_depth import LayerDepthOption
    from calibration.plans.schedule import Schedule


def write_schedule(path: Path, stages: list["Schedule"], gap: float) -> None:
    """Write the schedule of all stages, one row for a layer.

    Parameters
    ----------
    path : Path
        The file.
    stages : list of Schedule
        Roughing, and finishing if there is one.
    gap : float [um]
        Side gap.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    from procmodel.io import write_table

    columns: dict[str, list[Any]] = {}
    for stage, schedule in enumerate(stages, start=1):
        count = len(schedule.feeds)
        for header, values in {
            "layer": np.arange(1, count + 1),
            "stage [1]": np.full(count, stage),
            "target z [um]": schedule.layers.bottom,
            "half width [um]": schedule.layers.half_width,
            "programmed half width [um]": np.maximum(schedule.layers.half_width - gap, 0.0),
            "area [um^2]": schedule.layers.area,
            "feed [um]": schedule.feeds,
            "cumulative feed [um]": schedule.cumulative_feed,
            "depth [um]": schedule.depths,
            "depth spread [um]": schedule.depth_spread,
            "wear [um]": schedule.wear,
            "electrode left [um]": schedule.electrode_left,
        }.items():
            columns.setdefault(header, []).append(np.asarray(values))
    write_table(path, {header: np.concatenate(parts) for header, parts in columns.items()})


def write_shape_program(
    path: Path,
    template: Path | None,
    schedule: "Schedule",
    shape: str,
    area: float,
    gap: float,
    scanning: tuple[float, float, float],
) -> None:
    """Write the program of a pyramid, cone or hemisphere, along squares or arcs.

    Parameters
    ----------
    path : Path
        The file.
    template : Path, optional
        Words of the control.
    schedule : Schedule
        Feeds.
    shape : str
        Name of the shape.
    area : float [um^2]
        Section of the electrode, taken as round.
    gap : float [um]
        Side gap.
    scanning : (float, float, float)
        Feed rates along the passes and downwards [mm/min], and the overlap.

    Raises
    ------
    InputError
        As `procmodel.io.write_program`.
    """
    from procmodel.io import ProgramLayer, Scanning, read_template, write_program

    scan_feed, plunge_feed, overlap = scanning
    layers = [
        ProgramLayer(n + 1, float(feed), max(float(width) - gap, 0.0))
        for n, (feed, width) in enumerate(
            zip(schedule.cumulative_feed, schedule.layers.half_width, strict=True)
        )
    ]
    write_program(
        path,
        read_template(template),
        layers,
        Scanning(
            shape="square" if shape == "pyramid" else "circle",
            electrode_radius=math.sqrt(area / math.pi),
            scan_feed=scan_feed,
            plunge_feed=plunge_feed,
            side_gap=gap,
            overlap=overlap,
        ),
    )


def as_dict(
    stages: list["Schedule"], notes: list[str], compared: "list[LayerDepthOption]"
) -> dict[str, Any]:
    """The plan as JSON has it.

    Parameters
    ----------
    stages : list of Schedule
        Roughing, and finishing if there is one.
    notes : list of str
        What to know besides the schedules' own warnings.
    compared : list of LayerDepthOption
        The layer depths that were tried, the chosen one first.

    Returns
    -------
    dict
        Plain types and numbers.
    """
    last = stages[-1]
    per_stage = [
        {
            "layers": len(s.feeds),
            "total_feed": s.total_feed,
            "commanded_feed": float(s.cumulative_feed[-1]),
            "electrode_length": s.electrode_length,
            "electrode_length_limit": s.electrode_length_limit,
            "electrodes": s.electrodes,
            "new_electrode_before": list(s.new_electrode_before),
            "touch_off_after": list(s.touch_off_after),
            "depth": float(s.depths[-1]),
            "depth_spread": float(s.depth_spread[-1]),
            "max_wall_error": s.max_wall_error,
            "expected_wall_error": s.expected_wall_error,
            "time": s.time,
            "status": s.status,
        }
        for s in stages
    ]
    times = [s.time for s in stages]
    result: dict[str, Any] = {
        "layers": sum(len(s.feeds) for s in stages),
        "total_feed": sum(s.total_feed for s in stages),
        "electrode_length": sum(s.electrode_length for s in stages),
        "electrodes": sum(s.electrodes for s in stages),
        "max_wall_error": last.max_wall_error,
        "expected_wall_error": last.expected_wall_error,
        "time": None if None in times else sum(t for t in times if t is not None),
        "stages": per_stage,
        "warnings": [*notes, *(w for s in stages for w in s.warnings)],
    }
    if len(compared) > 1:
        result["compared"] = [
            {
                "layer_depth": option.layer_depth,
                "layers": len(option.schedule.feeds),
                "stair_error": option.stair_error,
                "expected_wall_error": option.schedule.expected_wall_error,
                "electrode_length": option.schedule.electrode_length,
                "time": option.schedule.time,
                "cost": option.cost,
            }
            for option in compared
        ]
    return result


def as_text(result: dict[str, Any]) -> str:
    """The plan for people.

    Parameters
    ----------
    result : dict
        From `as_dict`, with what was found of the paths.

    Returns
    -------
    str
        Lines.
    """
    lines = []
    names = ("roughing", "finishing") if len(result["stages"]) > 1 else ("",)
    for name, stage in zip(names, result["stages"], strict=True):
        lines += [f"{name:<17} {stage['status']}".strip()]
        lines += [
            f"layers            {stage['layers']}",
            f"total feed        {stage['total_feed']:.4f} um "
            f"(commanded {stage['commanded_feed']:.4f})",
            f"electrode length  {stage['electrode_length']:.2f} um, at most "
            f"{stage['electrode_length_limit']:.2f} (97.5 %)",
            f"electrodes        {stage['electrodes']}"
            + _listed(", a fresh one before layer", stage["new_electrode_before"]),
            f"depth             {stage['depth']:.4f} um +- {stage['depth_spread']:.2g} (95 %)",
            f"wall error        {stage['max_wall_error']:.4f} um at most, "
            f"{stage['expected_wall_error']:.4f} um rms expected",
        ]
        if stage["touch_off_after"]:
            lines.append("touch-off pays" + _listed("    after layer", stage["touch_off_after"]))
        if stage["time"] is not None:
            lines.append(f"time              {stage['time'] / 60.0:.1f} min")
    if "levelling" in result:
        passes = result["levelling"]
        feeds = ", ".join(f"{feed:g}" for feed in passes["feeds"])
        lines.append(
            f"levelling         passes fed {feeds} um take the tilt from "
            f"{passes['tilt_before']:.3g} to {passes['tilt']:.3g} um (at most "
            f"{passes['tilt_limit']:.3g})"
        )
    if result["path_length_um"] is not None:
        lines.append(
            f"path              {result['path_length_um'] / 1000.0:.1f} mm, "
            f"{result['turning_points']} turning points, lifted {result['lifted_moves']} times on "
            f"the way, {result['path_time_s'] / 60.0:.1f} min at the feed rates"
        )
        lines.append(
            f"left standing     {100.0 * result['uncovered_share']:.2f} % of what the electrode "
            f"reaches; {100.0 * result['unreachable_share']:.2f} % of the layers is out of reach"
        )
    for option in result.get("compared", ()):
        lines.append(
            f"layer depth {option['layer_depth']:g} um: {option['layers']} layers, stairs "
            f"{option['stair_error']:.3g} um, wall {option['expected_wall_error']:.3g} um, "
            f"cost {option['cost']:.4g} um^2"
        )
    return "\n".join([*lines, *(f"note  {warning}." for warning in result["warnings"])])


def _listed(words: str, layers: list[int]) -> str:
    if not layers:
        return ""
    shown = ", ".join(str(n) for n in layers[:8])
    return f"{words} {shown}" + (f" and {len(layers) - 8} more" if len(layers) > 8 else "")
