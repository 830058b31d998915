"""`procmodel chatter baseline`: the spectra of air cutting, as a file to compare cuts with."""

from pathlib import Path
from typing import Annotated, Any

import typer

from calibration.cli import chatter_options, console, options
from procmodel.errors import InputError


def baseline_command(
    record: chatter_options.Record,
    spindle_speed: chatter_options.SpindleSpeed,
    out: Annotated[Path, typer.Option("--out", help="File of baselines to write (HDF5).")],
    rate: chatter_options.Rate = None,
    start: Annotated[
        float | None, typer.Option("--start", help="Where air cutting begins [s].")
    ] = None,
    stop: Annotated[
        float | None, typer.Option("--stop", help="Where it ends [s], itself not included.")
    ] = None,
    window: Annotated[int, typer.Option("--window", help="Window length [samples].")] = 4096,
    hop: Annotated[
        int | None,
        typer.Option("--hop", help="Samples from window to window; half a window if left out."),
    ] = None,
    taper: Annotated[str, typer.Option("--taper", help="hann or rectangular.")] = "hann",
    channel: chatter_options.Channel = None,
    override: Annotated[
        float, typer.Option("--override", help="Of spindle speed and feed [%].")
    ] = 100.0,
    add: Annotated[
        bool, typer.Option("--add", help="Add this override to the file instead of replacing it.")
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Record what air cutting sounds like: mean and deviation of its power spectrum."""
    chatter_options.require_speed(spindle_speed)
    options.check_outputs(out)
    if add and not out.exists():
        raise InputError(f"{out}: --add needs a file to add to; leave it out for the first.")
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration import chatter_detection
    from procmodel.chatter import Windowing, refined_rotation
    from procmodel.chatter.rotation import FOUND, STATUS
    from procmodel.io.baselines import load_baselines, save_baselines
    from procmodel.io.records import read_record

    before = load_baselines(out) if add else None
    read = read_record(record, rate, channel, start, stop)
    windowing = Windowing(read.rate, window, hop, taper)
    try:
        air, warnings = chatter_detection.air_cut_of_record(read, windowing, spindle_speed / 60.0)
        rotation = refined_rotation(air.baseline.mean, windowing, air.rotation)
    except InputError as error:
        named = str(error).startswith(str(record))
        raise error if named else InputError(f"{record}: {error}") from error
    made = chatter_detection.stored(air, read.units, override)
    if before is not None:
        try:
            made = chatter_detection.with_override(before, made)
        except InputError as error:
            raise InputError(f"{out}: {error}") from error
        warnings += _about_speeds(made.overrides)
    if rotation.status != FOUND:
        warnings.append(f"rotation {STATUS[rotation.status]}")
    save_baselines(out, made)
    result = {
        "windows": int(air.baseline.count),
        "rate_hz": windowing.rate,
        "window": windowing.length,
        "hop": windowing.step,
        "taper": windowing.taper,
        "resolution_hz": windowing.resolution,
        "channels": list(air.channels),
        "units": list(read.units),
        "rotation_hz": rotation.frequency,
        "rotation_found": rotation.status == FOUND,
        "override_percent": override,
        "overrides": [
            {"override_percent": each.override, "spindle_speed": each.spindle_speed}
            for each in made.overrides
        ],
        "out": str(out),
        "warnings": warnings,
    }
    console.show(result, _as_text(result), as_json)


def _about_speeds(overrides: Any) -> list[str]:
    """Whether spindle speed and override go together."""
    full = {each.override: 100.0 * each.spindle_speed / each.override for each in overrides}
    low, high = min(full.values()), max(full.values())
    if high <= 1.02 * low:
        return []
    said = ", ".join(f"{each.spindle_speed:g} 1/min at {each.override:g} %" for each in overrides)
    return [
        f"spindle speeds do not go with the overrides ({said}): --spindle-speed is the speed at "
        "the override, not the programmed one"
    ]


def _as_text(result: dict[str, Any]) -> str:
    lines = [
        f"baseline     {result['windows']} windows of {result['window']} samples at "
        f"{result['rate_hz']:g} Hz, {result['taper']}, {result['resolution_hz']:.4g} Hz per bin",
        f"channels     {', '.join(result['channels'])}",
        f"rotation     {result['rotation_hz']:.4f} Hz",
        f"overrides    {', '.join(format(o['override_percent'], 'g') for o in result['overrides'])}"
        f" % in {result['out']}",
    ]
    return "\n".join([*lines, *(f"warning  {each.rstrip('.')}." for each in result["warnings"])])
