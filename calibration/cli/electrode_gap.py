"""`procmodel electrode gap`: mean and spread of the discharge gap from measured diameters."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options
from procmodel.errors import InputError

if TYPE_CHECKING:
    from calibration.electrode import GapData
    from calibration.electrode_gap import GapPosterior

Holes = Annotated[
    Path | None,
    typer.Argument(
        help="CSV with columns 'hole diameter [um]' and 'electrode diameter [um]', a row for each "
        "drilled hole."
    ),
]
Electrodes = Annotated[
    Path | None,
    typer.Option(
        "--electrodes",
        help="CSV of earlier electrodes with 'path radius [um]', of the wire's centre in the last "
        "pass, and 'electrode diameter [um]'; needs --wire-diameter.",
    ),
]
DiameterError = Annotated[
    float,
    typer.Option(
        "--diameter-error", help="Greatest error of a measured diameter, all alike likely [um]."
    ),
]
Repeats = Annotated[
    int, typer.Option("--repeats", help="Measurements that each diameter is the mean of.")
]


def gap_command(
    holes: Holes = None,
    electrodes: Electrodes = None,
    wire_diameter: Annotated[
        float | None, typer.Option("--wire-diameter", help="Of the wire [um].")
    ] = None,
    diameter_error: DiameterError = 1.0,
    repeats: Repeats = 1,
    level: Annotated[
        float, typer.Option("--level", help="Probability inside the band of the next gap.")
    ] = 0.9,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Estimate mean and spread of the discharge gap, and the next gap to expect."""
    options.check_outputs(plot=plot)
    require_level(level)
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    data, posterior = known_gap(holes, electrodes, wire_diameter, diameter_error, repeats)
    if plot is not None:
        from calibration.plots.electrode_gap import draw_gap
        from calibration.plots.figures import save

        save(draw_gap(data, posterior, level), plot)
    result = as_dict(data, posterior, level)
    console.show(result, _as_text(result), as_json)


def require_level(level: float) -> None:
    """Refuse a level that is no probability.

    Parameters
    ----------
    level : float
        Of --level.

    Raises
    ------
    InputError
        If it is not between 0 and 1.
    """
    if not 0 < level < 1:
        raise InputError(f"--level is {level:g}, but must be between 0 and 1, such as 0.9.")


def known_gap(
    holes: Path | None,
    electrodes: Path | None,
    wire_diameter: float | None,
    diameter_error: float,
    repeats: int,
) -> tuple["GapData", "GapPosterior"]:
    """What the given tables tell of the gap.

    Parameters
    ----------
    holes, electrodes : Path, optional
        The tables, one at least.
    wire_diameter : float, optional [um]
        Of the wire; needed for electrodes.
    diameter_error : float [um]
        Greatest error of a measured diameter.
    repeats : int
        Measurements that each diameter is the mean of.

    Returns
    -------
    GapData, GapPosterior
        All readings, and their posterior.

    Raises
    ------
    InputError
        If a table or a number cannot be used, or there is a single reading.
    """
    from calibration.electrode import read_electrodes, read_holes
    from calibration.electrode_gap import fit_gap

    if not 0 < diameter_error < float("inf"):
        raise InputError(f"--diameter-error is {diameter_error:g}, but must be above 0.")
    if repeats < 1:
        raise InputError(f"--repeats is {repeats}, but must be 1 or more.")
    parts = []
    if holes is not None:
        parts.append(read_holes(holes, diameter_error, repeats))
    if electrodes is not None:
        diameter = console.required(wire_diameter, "--wire-diameter", "a table of electrodes")
        if not 0 < diameter < float("inf"):
            raise InputError(f"--wire-diameter is {diameter:g}, but must be above 0.")
        parts.append(read_electrodes(electrodes, 0.5 * diameter, diameter_error, repeats))
    if not parts:
        raise InputError("nothing was measured: give a table of holes, or --electrodes.")
    data = parts[0] if len(parts) == 1 else parts[0].joined(parts[1])
    return data, fit_gap(data)


def as_dict(data: "GapData", posterior: "GapPosterior", level: float) -> dict[str, Any]:
    """The result as plain types.

    Parameters
    ----------
    data : GapData
        The readings.
    posterior : GapPosterior
        What they tell.
    level : float
        Probability inside the interval of the next gap.

    Returns
    -------
    dict
        For JSON; lengths in um.
    """
    result = posterior.as_dict()
    ahead = posterior.next_gap()
    result["next_gap"] = {
        "value": ahead.mean,
        "std": ahead.deviation,
        "level": level,
        "interval": list(ahead.interval(level)),
    }
    result["lowest"], result["highest"] = float(data.gap.min()), float(data.gap.max())
    result["measuring_std"] = float(data.sigma.max())
    result["notes"] = _notes(data, posterior)
    return result


def _notes(data: "GapData", posterior: "GapPosterior") -> list[str]:
    notes = [
        "gaps are taken as normal, and those of drilled holes as good for grinding by the wire: "
        "measure ground electrodes to be sure"
    ]
    if len(data) < 5:
        notes.append(
            f"{len(data)} readings say little of the spread: its interval is half prior, measure "
            "ten"
        )
    middle = float(posterior.spread_quantile(0.5))
    if middle < float(data.sigma.min()):
        notes.append(
            "the gap scatters less than measuring does: measure every diameter several times "
            "(--repeats)"
        )
    return notes


def _as_text(result: dict[str, Any]) -> str:
    mean, spread, ahead = (result[name] for name in ("gap_mean", "gap_spread", "next_gap"))

    def between(ends: list[float]) -> str:
        return f"{ends[0]:.2f} to {ends[1]:.2f}"

    lines = [
        f"readings   {result['readings']}, {result['lowest']:.2f} to {result['highest']:.2f} um, "
        f"measured within a standard deviation of {result['measuring_std']:.2f} um",
        f"mean gap   {mean['value']:.2f} um [95 %: {between(mean['interval95'])}]",
        f"spread     {spread['value']:.2f} um [95 %: {between(spread['interval95'])}]",
        f"next gap   {ahead['value']:.2f} um [{100 * ahead['level']:.3g} %: "
        f"{between(ahead['interval'])}]",
        *(f"note       {note}." for note in result["notes"]),
    ]
    return "\n".join(lines)
