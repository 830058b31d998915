"""Feeds of `wear plan` searched through the simulation."""

from typing import Any

from calibration.cli.wear_plan_cavity import Cavity
from calibration.cli.wear_plan_stages import Scan
from calibration.plans.schedule import Machine, Schedule
from calibration.plans.simulated_schedule import (
    SimulatedSchedule,
    SimulationSettings,
    simulated_schedule,
)
from calibration.progress import reporting
from procmodel.wear.slicing import Reach


def refined(
    scan: Scan,
    reach: Reach,
    cavity: Cavity,
    wear_ratio: Any,
    schedule: Schedule,
    machine: Machine,
    feed_bounds: tuple[float, float],
    settings: SimulationSettings,
    quiet: bool,
) -> SimulatedSchedule:
    """Search the feeds that bring the simulated surface nearest to the wanted one.

    Parameters
    ----------
    scan : Scan
        Paths of the only stage.
    reach : Reach
        What the electrode makes of it: what it cannot reach does not count.
    cavity : Cavity
        What is wanted.
    wear_ratio : float, FitResult, xarray.DataTree or ndarray
        What is believed of it.
    schedule : Schedule
        Where the search starts.
    machine : Machine
        Resolution, electrode, tolerance.
    feed_bounds : (float, float) [um]
        Least and greatest feed of a layer.
    settings : SimulationSettings
        Cells, gaps, wear mode.
    quiet : bool
        Whether to show no progress.

    Returns
    -------
    SimulatedSchedule
        The plan.

    Raises
    ------
    InputError
        As `simulated_schedule`.
    """
    wanted = scan.slices if cavity.target is None else cavity.target
    with reporting(not quiet) as bar:
        bar.compiling("search")
        return simulated_schedule(
            scan.paths,
            wanted,
            scan.electrode,
            wear_ratio,
            schedule,
            settings,
            machine,
            feed_bounds=feed_bounds,
            spared=scan.slices.out_of_reach(reach),
            progress=lambda done, _: bar.running("search", done, settings.evaluations),
        )
