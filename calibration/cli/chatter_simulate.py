"""`procmodel chatter simulate`: a recording of a cut of which is known whether it chatters."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import chatter_options, console, options
from procmodel.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from procmodel.chatter.dynamics import Plant
    from procmodel.chatter.recording import LabelledRecording

SUFFIXES = (".wav", ".h5", ".hdf5", ".csv")
# The case that the literature computes first: Insperger and Stepan's single mode, slotting.
_FREQUENCY, _DAMPING, _MASS = (922.0,), (0.011,), (0.03993,)
_SENSORS: dict[str, tuple[str, ...]] = {
    "acceleration": ("acceleration",),
    "displacement": ("displacement",),
    "both": ("displacement", "acceleration"),
}


def simulate_command(
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="Recording to write: .h5 with its truth inside; .csv or .wav with it beside, as "
            ".truth.json.",
        ),
    ],
    spindle_speed: chatter_options.SpindleSpeed,
    depth: Annotated[float, typer.Option("--depth", help="Axial depth [mm]; 0 for air alone.")],
    frequency: Annotated[
        list[float] | None,
        typer.Option("--frequency", help="Natural frequency of a mode [Hz]; repeat for more."),
    ] = None,
    damping: Annotated[
        list[float] | None, typer.Option("--damping", help="Damping ratio of each mode.")
    ] = None,
    mass: Annotated[
        list[float] | None, typer.Option("--mass", help="Modal mass of each mode [kg].")
    ] = None,
    direction: Annotated[
        list[float] | None,
        typer.Option("--direction", help="Direction of each mode from the feed [deg]; 0 else."),
    ] = None,
    teeth: Annotated[int, typer.Option("--teeth", help="Teeth of the tool.")] = 2,
    diameter: Annotated[float, typer.Option("--diameter", help="Of the tool [mm].")] = 10.0,
    helix: Annotated[float, typer.Option("--helix", help="Helix angle [deg].")] = 0.0,
    runout: Annotated[
        list[float] | None,
        typer.Option("--runout", help="How much farther a tooth reaches [um]; for each tooth."),
    ] = None,
    imbalance: Annotated[float, typer.Option("--imbalance", help="Of the tool [g mm].")] = 0.0,
    immersion: Annotated[
        float, typer.Option("--immersion", help="Radial depth over diameter; 1 for a slot.")
    ] = 1.0,
    milling: Annotated[str, typer.Option("--milling", help="down or up.")] = "down",
    feed_per_tooth: Annotated[
        float, typer.Option("--feed-per-tooth", help="Feed per tooth [mm].")
    ] = 0.1,
    tangential: Annotated[
        float, typer.Option("--tangential", help="Tangential coefficient [N/mm^2].")
    ] = 600.0,
    normal: Annotated[float, typer.Option("--normal", help="Normal coefficient [N/mm^2].")] = 200.0,
    rate: Annotated[float, typer.Option("--rate", help="Sampling rate [Hz].")] = 25600.0,
    oversampling: Annotated[
        int, typer.Option("--oversampling", help="Steps of the simulation per sample.")
    ] = 4,
    sensor: Annotated[
        str, typer.Option("--sensor", help="acceleration, displacement or both.")
    ] = "acceleration",
    noise: Annotated[
        float, typer.Option("--noise", help="Noise of each acceleration [m/s^2].")
    ] = 1.0,
    displacement_noise: Annotated[
        float, typer.Option("--displacement-noise", help="Noise of each displacement [um].")
    ] = 0.1,
    hardness_noise: Annotated[
        float,
        typer.Option("--hardness-noise", help="Fluctuation of the cutting force [1/sqrt(Hz)]."),
    ] = 0.0,
    force_noise: Annotated[
        float, typer.Option("--force-noise", help="Force on the tip, also in air [N/sqrt(Hz)].")
    ] = 0.0,
    before: Annotated[float, typer.Option("--before", help="Air before the cut [s].")] = 2.0,
    cutting: Annotated[float, typer.Option("--cutting", help="Cut at its full depth [s].")] = 1.5,
    after: Annotated[float, typer.Option("--after", help="Air after the cut [s].")] = 0.5,
    labelled_by: Annotated[
        str,
        typer.Option("--labelled-by", help="lobes (growth by theory) or motion (what happened)."),
    ] = "lobes",
    seed: Annotated[int, typer.Option("--seed", help="Of all noise.")] = 0,
    as_json: options.AsJson = False,
) -> None:
    """Simulate a cut with air before and after it, and write what sensors would record."""
    chatter_options.require_speed(spindle_speed)
    if out.suffix.lower() not in SUFFIXES:
        raise InputError(f"{out.name}: a recording ends in {', '.join(SUFFIXES)}: rename it.")
    if sensor not in _SENSORS:
        raise InputError(f"--sensor is {sensor!r}, but must be one of {', '.join(_SENSORS)}.")
    if not (math.isfinite(depth) and depth >= 0.0):
        raise InputError(f"--depth is {depth:g}, but must be 0 or more.")
    inside = out.suffix.lower() in (".h5", ".hdf5")
    beside = None if inside else out.with_name(f"{out.stem}.truth.json")
    options.check_outputs(out, beside)
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    import numpy as np

    from procmodel.chatter.cutting import Cut, CuttingCoefficients, Tool, engaged_between
    from procmodel.chatter.dynamics import Plant, ProcessNoise
    from procmodel.chatter.recording import air_cut_air, labelled_recording
    from procmodel.chatter.sampling import Sampling
    from procmodel.io import write_text

    modes = _modes(frequency, damping, mass, direction)
    rotation = spindle_speed / 60.0
    sampling = Sampling(rate, oversampling, 1e-6 * displacement_noise, noise)
    plant = Plant(
        modes,
        Tool(
            teeth,
            0.5e-3 * diameter,
            math.radians(helix),
            None if runout is None else 1e-6 * np.asarray(runout),
            1e-6 * imbalance,
        ),
        Cut(*engaged_between(immersion, milling), 1e-3 * feed_per_tooth),
        CuttingCoefficients(1e6 * tangential, 1e6 * normal),
        step=sampling.step,
        slowest=rotation,
        fastest=rotation,
        noise=ProcessNoise(hardness_noise, force_noise),
        # Straight teeth are exact in one piece.
        slices=1 if helix == 0.0 else 8,
    )
    schedule = air_cut_air(rotation, 1e-3 * depth, before=before, cutting=cutting, after=after)
    made = labelled_recording(plant, schedule, sampling, seed, labelled_by=labelled_by)
    columns = _columns(made, plant, _SENSORS[sensor])
    truth = _truth(made, columns) | {
        "spindle_speed": spindle_speed,
        "depth_mm": depth,
        "teeth": teeth,
        "labelled_by": labelled_by,
        "seed": seed,
    }
    named = [f"{made.channels[i]} [{made.units[i]}]" for i in columns]
    _write(out, made.samples[:, columns], named, rate, console.json_text(truth))
    if beside is not None:
        write_text(beside, console.json_text(truth) + "\n")
    result = {**truth, "out": str(out), "truth": str(beside or out)}
    console.show(result, _as_text(result), as_json)


def _modes(
    frequency: list[float] | None,
    damping: list[float] | None,
    mass: list[float] | None,
    direction: list[float] | None,
) -> Any:
    import numpy as np

    from procmodel.chatter.modes import Modes

    given = {"--frequency": frequency, "--damping": damping, "--mass": mass}
    if any(given.values()) and len({len(values or ()) for values in given.values()}) > 1:
        said = ", ".join(f"{len(values or ())} {name}" for name, values in given.items())
        raise InputError(
            f"every mode needs --frequency, --damping and --mass, but there are {said}."
        )
    frequencies = frequency or list(_FREQUENCY)
    if direction is not None and len(direction) != len(frequencies):
        raise InputError(
            f"there are {len(direction)} --direction for {len(frequencies)} modes: give one each."
        )
    angles = [math.radians(each) for each in direction or [0.0] * len(frequencies)]
    return Modes(
        np.asarray(frequencies),
        np.asarray(damping or _DAMPING),
        np.asarray(mass or _MASS),
        np.stack([np.cos(angles), np.sin(angles)], axis=1),
    )


def _columns(made: "LabelledRecording", plant: "Plant", kinds: tuple[str, ...]) -> list[int]:
    """Columns of the sensors asked for that see any mode."""
    import numpy as np

    gains = [*plant.sensors.displacement_gain, *plant.sensors.acceleration_gain]
    seen = [bool(np.any(np.abs(np.asarray(gain)) > 1e-9)) for gain in gains]
    return [i for i, name in enumerate(made.channels) if seen[i] and name.split(" ", 1)[0] in kinds]


def _truth(made: "LabelledRecording", columns: list[int]) -> dict[str, Any]:
    truth = made.truth
    found = truth.stability
    return {
        "label": truth.label,
        "chatter_frequency_hz": truth.chatter_frequency,
        "multiplier": None if found is None else abs(found.multiplier),
        "growth_rate": None if found is None else found.growth,
        "kind": None if found is None else found.kind,
        "excess": truth.excess,
        "entry_s": truth.entry,
        "exit_s": truth.exit,
        "rate_hz": made.rate,
        "samples": len(made.samples),
        "channels": [made.channels[i] for i in columns],
        "units": [made.units[i] for i in columns],
    }


def _write(path: Path, samples: "np.ndarray", named: list[str], rate: float, truth: str) -> None:
    import numpy as np

    from procmodel.io import write_text, writing
    from procmodel.io.record_units import split_heading

    suffix = path.suffix.lower()
    if suffix == ".csv":
        rows = (
            f"{i / rate:.9f},{','.join(map(repr, row))}\n" for i, row in enumerate(samples.tolist())
        )
        write_text(path, ",".join(["time [s]", *named]) + "\n" + "".join(rows))
        return
    if suffix == ".wav":
        import scipy.io.wavfile

        if rate != round(rate):
            raise InputError(f"{path.name}: WAV holds whole rates alone, not {rate:g} Hz.")
        with writing(path) as draft:
            scipy.io.wavfile.write(draft, round(rate), samples.astype(np.float32))
        return
    import h5py

    with writing(path) as draft, h5py.File(draft, "w") as file:
        file.attrs["rate"] = rate
        file.attrs["truth"] = truth
        for heading, values in zip(named, samples.T, strict=True):
            name, unit = split_heading(heading)
            file[name] = values
            file[name].attrs["unit"] = unit


def _as_text(result: dict[str, Any]) -> str:
    lines = [f"label        {result['label']}, by {result['labelled_by']}"]
    if result["multiplier"] is not None:
        lines.append(
            f"stability    {result['kind']}; factor {result['multiplier']:.5f} per "
            f"tooth, {result['growth_rate']:.4g} 1/s"
        )
    if result["chatter_frequency_hz"] is not None:
        lines.append(f"chatter      {result['chatter_frequency_hz']:.2f} Hz")
    if result["entry_s"] is not None:
        (enters, whole), (leaves, gone) = result["entry_s"], result["exit_s"]
        lines.append(
            f"cut          enters {enters:g} to {whole:g} s, leaves {leaves:g} to {gone:g} s"
        )
    lines.append(
        f"recording    {result['samples']} samples of {', '.join(result['channels'])} at "
        f"{result['rate_hz']:g} Hz in {result['out']}"
    )
    return "\n".join(lines)
