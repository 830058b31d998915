"""`procmodel chatter detect`: when and at which frequency a recorded cut chatters."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from calibration.cli import chatter_options, console, options


def detect_command(
    record: chatter_options.Record,
    baseline: chatter_options.BaselineFile,
    spindle_speed: chatter_options.SpindleSpeed,
    rate: chatter_options.Rate = None,
    threshold: chatter_options.Threshold = None,
    averaged_threshold: chatter_options.AveragedThreshold = None,
    tuned: chatter_options.Tuned = None,
    band: chatter_options.Band = None,
    teeth: chatter_options.Teeth = None,
    votes: chatter_options.Votes = 2,
    of: chatter_options.Of = 5,
    mains: chatter_options.Mains = None,
    ignore: chatter_options.Ignore = None,
    limit: chatter_options.Limit = None,
    report_marginal: chatter_options.Marginal = False,
    channel: chatter_options.Channel = None,
    override: chatter_options.Override = None,
    window: chatter_options.Window = None,
    start: Annotated[float | None, typer.Option("--start", help="Where to begin [s].")] = None,
    stop: Annotated[float | None, typer.Option("--stop", help="Where to end [s].")] = None,
    events: Annotated[
        Path | None, typer.Option("--events", help="Write the events here (CSV).")
    ] = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Compare a recorded cut with air cutting, and say when it chatters."""
    chatter_options.require_speed(spindle_speed)
    options.check_outputs(events, plot=plot)
    level, interval = chatter_options.chosen_threshold(threshold, tuned)
    settings = chatter_options.settings_of(
        level, averaged_threshold, band, teeth, votes, of, mains, ignore, limit, report_marginal,
        tuned,
    )  # fmt: skip
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.chatter_detection import Source, detect_record
    from calibration.chatter_trace import Trace
    from procmodel.io import write_text
    from procmodel.io.baselines import load_baselines
    from procmodel.io.records import open_record

    baselines = load_baselines(baseline)
    wanted = channel or baselines.channels
    stream = open_record(record, rate, wanted, start, stop)
    detector, warnings = chatter_options.detector_from(
        baseline,
        baselines,
        Source(stream.rate, stream.channels, stream.units),
        spindle_speed,
        {"override": override, "window": window, **settings},
    )
    trace = None if plot is None else Trace(detector, stream.start)
    found = detect_record(stream, detector, trace, progress=sys.stderr.isatty())
    result = found.as_dict()
    result["warnings"] = [*warnings, *found.warnings]
    if events is not None:
        head = ",".join(chatter_options.EVENT_HEADINGS) + "\n"
        write_text(events, head + chatter_options.event_rows(found.events))
    if trace is not None and plot is not None:
        from calibration.plots.chatter import draw_detection
        from calibration.plots.figures import save

        save(draw_detection(found, trace, stream.units, interval), plot)
    text = chatter_options.as_text(result, stream.channels, result["warnings"])
    text += [each.sentence for each in found.events]
    console.show(result, "\n".join(text), as_json)
