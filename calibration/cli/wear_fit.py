"""`procmodel wear fit`: the wear ratio from the profile of a test cavity."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import console, options
from procmodel.errors import InputError

if TYPE_CHECKING:
    from calibration.wear import CavityFit


def fit_command(
    profile: Annotated[
        Path, typer.Argument(help="CSV with columns 'x [um]', 'z [um]', optional 'sigma [um]'.")
    ],
    section: options.Section,
    half_width: Annotated[
        float, typer.Option("--half-width", help="Programmed half width of the first layer [um].")
    ],
    feed: options.Feed,
    step: options.Step,
    electrode_diameter: options.ElectrodeDiameter = None,
    electrode_area: options.ElectrodeArea = None,
    layers: options.Layers = None,
    gap: Annotated[
        float, typer.Option("--gap", help="Side gap [um]; the start with --fit-gap.")
    ] = 0.0,
    fit_gap: Annotated[bool, typer.Option("--fit-gap", help="Fit the side gap too.")] = False,
    fit_electrode_area: Annotated[
        bool, typer.Option("--fit-electrode-area", help="Free the area too; depths cannot tell it.")
    ] = False,
    round_corners: Annotated[
        bool,
        typer.Option(
            "--round-corners", help="Count the corners of a square that a round electrode leaves."
        ),
    ] = False,
    reach: Annotated[
        str, typer.Option("--reach", help="half (from the centre), full (both walls), or auto.")
    ] = "auto",
    readings: Annotated[
        str,
        typer.Option(
            "--readings",
            help="wall: x is where the wall was seen; depths: x is the layer's programmed half "
            "width, the gap shows in the depth alone.",
        ),
    ] = "wall",
    noise: Annotated[
        float | None, typer.Option("--noise", help="Standard deviation of z, if known [um].")
    ] = None,
    solver: Annotated[
        str, typer.Option("--solver", help="box_lm, optimistix, scipy or jaxopt.")
    ] = "box_lm",
    resolution: options.Resolution = 0.1,
    posterior: Annotated[
        Path | None, typer.Option("--posterior", help="Sample, and save the posterior (netCDF).")
    ] = None,
    draws: Annotated[
        int | None, typer.Option("--draws", help="Draws of each ensemble or chain.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the sampler.")] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the JSON here too, for 'wear plan --fit'.")
    ] = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Fit the wear ratio to the measured profile of a test cavity cut with constant feed."""
    from procmodel.io import read_profile, write_text

    area = console.electrode_area(electrode_diameter, electrode_area)
    options.require_feed_above(feed, resolution)
    for name, value, known in (
        ("--reach", reach, ("auto", "half", "full")),
        ("--readings", readings, ("wall", "depths")),
    ):
        if value not in known:
            raise InputError(f"{name} is {value!r}, but must be one of {', '.join(known)}.")
    if not 0 <= gap < math.inf:
        raise InputError(f"--gap is {gap:g}, but must be 0 or more.")
    if gap >= half_width:
        raise InputError(f"--gap is {gap:g}, but must be below the half width {half_width:g}.")
    if seed < 0:
        raise InputError(f"--seed is {seed}, but must be 0 or more.")
    options.check_outputs(out, posterior, plot=plot)
    if posterior is not None and posterior.suffix != ".nc":
        raise InputError(f"{posterior.name}: a posterior ends in .nc: rename it.")
    measured = read_profile(profile)
    if noise is not None and measured.sigma is not None:
        raise InputError(f"{profile.name} has a sigma column and --noise is given: drop one.")
    if noise is not None and not noise > 0:
        raise InputError(f"--noise is {noise:g}, but must be above 0.")

    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.wear import TestCavity, fit_cavity

    corner_radius = math.sqrt(area / math.pi) if round_corners else 0.0
    cavity = TestCavity(section, half_width, step, feed, area, layers, corner_radius)
    found = fit_cavity(
        measured.x,
        measured.z,
        cavity,
        noise if measured.sigma is None else measured.sigma,
        gap=gap,
        fit_gap=fit_gap,
        fit_electrode_area=fit_electrode_area,
        reach=reach,
        readings=readings,
        solver=solver,
        source=profile.name,
    )
    result = result_as_dict(found)
    text = found.result.report() + "".join(f"\nnote  {note}." for note in found.notes)
    if posterior is not None:
        summary, line = _sample_to(found, posterior, draws, seed)
        result["posterior"] = summary
        text += f"\nposterior  {line}"
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.wear import draw_fit

        save(draw_fit(found), plot)
    if out is not None:
        write_text(out, console.json_text(result) + "\n")
    console.show(result, text, as_json)
    if not found.result.converged:
        raise typer.Exit(console.NOT_CONVERGED)


def result_as_dict(found: "CavityFit") -> dict[str, Any]:
    """The fit as the JSON that the command prints and `wear plan --fit` reads."""
    result = found.result.as_dict()
    result["warnings"] = [*result["warnings"], *found.notes]
    result["wear_per_area"] = result["parameters"]["wear_per_area"]["value"]
    result["layers"] = found.cavity.layers
    result["reach"] = found.reach
    result["z_counts_upwards"] = found.flipped
    return result


def _sample_to(
    found: "CavityFit", path: Path, draws: int | None, seed: int
) -> tuple[dict[str, Any], str]:
    """Sample and save the posterior; its summary for JSON and for people."""
    from calibration.archive import save_result
    from calibration.posterior import with_predictions
    from calibration.sampling import sample

    tree = sample(found.result.problem, seed=seed, draws=draws, start=found.result, progress=True)
    save_result(path, found.result, posterior=with_predictions(found.result.problem, tree))
    draws_of = tree["posterior"].dataset["wear_ratio"]
    summary = {
        "file": str(path),
        "converged": bool(tree.attrs["converged"]),
        "status": tree.attrs["status"],
        "wear_ratio": {
            "mean": float(draws_of.mean()),
            "std": float(draws_of.std()),
            "interval95": [float(q) for q in draws_of.quantile([0.025, 0.975])],
        },
    }
    return summary, f"{tree.attrs['status']}; saved in {path}"
