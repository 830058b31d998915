"""`procmodel demo`: the whole way from a measured cavity to the next feed schedule."""

import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calibration.cli import console
from procmodel.errors import InputError
from procmodel.io import write_table

FILES = ("cavity.csv", "fit.json", "fit.png", "plan.csv", "plan.nc", "plan.png")
SEED = 1997
TRUE_WEAR_RATIO = 0.3
NOISE = 1.0


def run_demo(folder: Path, command: Callable[[list[str]], object]) -> None:
    """Simulate a test cavity and its measurement, then run the commands on it.

    Parameters
    ----------
    folder : Path
        Where the files go; made if it is not there.
    command : callable
        Runs the command with a list of arguments.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: this folder cannot be made ({error.strerror}): use another --folder."
        ) from None
    profile = folder / "cavity.csv"
    x, z = simulated_profile()
    write_table(profile, {"x [um]": x, "z [um]": z}, decimals=3)
    console.say(
        f"A 500 um square test cavity, 101 layers of 2 um feed, wear ratio {TRUE_WEAR_RATIO} and "
        f"{NOISE:g} um reading noise (simulated, seed {SEED}): {profile}\n"
    )
    # Quoted as a shell wants it, should the folder's name hold a space.
    at = {name: shlex.quote(str(folder / name)) for name in FILES}
    fitting = (
        f"wear fit {at['cavity.csv']} --section square --half-width 250 --feed 2 --step 2 "
        f"--electrode-diameter 100 --out {at['fit.json']} --plot {at['fit.png']}"
    )
    planning = (
        f"wear plan --shape hemisphere --radius 150 --depth 140 --layer-depth 2 "
        f"--fit {at['fit.json']} --electrode-diameter 100 --usable-length 500 "
        f"--out {at['plan.csv']} --gcode {at['plan.nc']} --plot {at['plan.png']}"
    )
    for line in (fitting, planning):
        print(f"$ procmodel {line}", flush=True)
        command(shlex.split(line))
        print(flush=True)
    console.say(f"Look at {folder / 'fit.png'}, {folder / 'plan.png'} and {folder / 'plan.csv'}.")


def simulated_profile() -> tuple[np.ndarray, np.ndarray]:
    """Readings of a full section through the demo's cavity, instrument tilted and off centre.

    Returns
    -------
    x, z : ndarray, shape (261,) [um]
        Lateral position, and height counted upwards.
    """
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from procmodel.wear import LayeredCavity, SquareSection, constant_step_half_widths

    half_widths = constant_step_half_widths(250.0, 2.0, 101)
    area = np.pi * 50.0**2
    cavity = LayeredCavity(half_widths, 2.0, SquareSection(), TRUE_WEAR_RATIO, area)
    x = np.linspace(0.0, 624.0, 261)
    across = x - 311.0
    depth = np.asarray(cavity.wall_depth(across)) + 4.0 + 0.004 * across
    return x, -depth + np.random.default_rng(SEED).normal(0.0, NOISE, len(x))
