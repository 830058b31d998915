"""What `wear plan` says and writes of scanning paths."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calibration.cli.wear_plan_stages import Scan
from procmodel.wear.scanning import Rates, path_time

if TYPE_CHECKING:
    from calibration.plans.schedule import Schedule


def summed_up(
    scans: list[Scan], schedules: "list[Schedule]", scan_feed: float, plunge_feed: float
) -> dict[str, Any]:
    """What the JSON says of the paths.

    Parameters
    ----------
    scans : list of Scan
        Paths of every stage.
    schedules : list of Schedule
        Its feeds.
    scan_feed, plunge_feed : float [mm/min]
        Feed rates.

    Returns
    -------
    dict
        Lengths in um, time in s, counts and shares.

    Raises
    ------
    InputError
        If a feed rate is not above 0.
    """
    rates = Rates(scan_feed * 1000 / 60, plunge_feed * 1000 / 60)
    paths = [path for scan in scans for path in scan.paths]
    time = sum(
        path_time(path, float(feed), rates)
        for scan, schedule in zip(scans, schedules, strict=True)
        for path, feed in zip(scan.paths, schedule.feeds, strict=True)
    )
    reachable = sum(scan.reachable for scan in scans)
    return {
        "path_length_um": sum(path.length for path in paths),
        "lifted_length_um": sum(path.lifted_length for path in paths),
        "lifted_moves": sum(int(np.sum(~path.cutting)) for path in paths),
        "turning_points": sum(path.turning_points for path in paths),
        "path_time_s": time,
        "uncovered_share": sum(s.uncovered for s in scans) / reachable if reachable else 0.0,
        # What roughing does not reach is left to the last stage.
        "unreachable_share": scans[-1].unreachable / scans[-1].wanted,
        "islands": int(max(np.max(scan.slices.islands) for scan in scans)),
    }


def write_paths(path: Path, scans: list[Scan], schedules: "list[Schedule]") -> None:
    """Write the corners of all paths, one row each.

    Parameters
    ----------
    path : Path
        The file.
    scans : list of Scan
        Paths of every stage.
    schedules : list of Schedule
        Its feeds.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    from procmodel.io import write_table

    columns: dict[str, list[np.ndarray]] = {}
    for number, (scan, schedule) in enumerate(zip(scans, schedules, strict=True), start=1):
        for n, (way, feed) in enumerate(
            zip(scan.paths, schedule.cumulative_feed, strict=True), start=1
        ):
            count = len(way.points)
            for header, values in {
                "layer [1]": np.full(count, n),
                "stage [1]": np.full(count, number),
                "x [um]": way.points[:, 0],
                "y [um]": way.points[:, 1],
                "cumulative feed [um]": np.full(count, float(feed)),
                "cutting [1]": np.append(0, way.cutting.astype(int)),
                "quarter turns [1]": np.full(count, way.quarter_turns),
            }.items():
                columns.setdefault(header, []).append(values)
    table = {header: np.concatenate(parts) for header, parts in columns.items()}
    remark = (
        "way of the electrode's centre; cutting: whether the move to this point is made at depth, "
        "else the electrode is lifted; quarter turns: of the electrode, from how it was mounted"
    )
    write_table(path, table, decimals=4, comments=[remark])


def write_scanning_program(
    path: Path,
    template: Path | None,
    name: str,
    scan: Scan,
    schedule: "Schedule",
    gap: float,
    feeds: tuple[float, float],
) -> None:
    """Write the program that follows the paths.

    Parameters
    ----------
    path : Path
        The file.
    template : Path, optional
        Words of the control.
    name : str
        What the cavity is called in the header.
    scan : Scan
        Paths.
    schedule : Schedule
        Feeds.
    gap : float [um]
        Side gap.
    feeds : (float, float) [mm/min]
        Feed rates along the passes and downwards.

    Raises
    ------
    InputError
        As `procmodel.io.write_polyline_program`.
    """
    from procmodel.io import (
        PolylineLayer,
        PolylineScanning,
        read_template,
        write_polyline_program,
    )

    layers = []
    half_widths = np.asarray(schedule.layers.half_width)
    for n, way in enumerate(scan.paths):
        runs = np.split(way.points, np.flatnonzero(~way.cutting) + 1)
        programmed = max(float(half_widths[n]) - gap, 0.0)
        feed = float(schedule.cumulative_feed[n])
        layers.append(PolylineLayer(n + 1, feed, programmed, runs, way.quarter_turns))
    settings = PolylineScanning(name, scan.electrode.half, *feeds, side_gap=gap)
    write_polyline_program(path, read_template(template), layers, settings)
