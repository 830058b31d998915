"""`procmodel chatter tune`: a threshold from labelled cuts, and what to expect of it."""

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calibration.cli import chatter_options, console, options
from procmodel.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from calibration.chatter_cuts import CutScores
    from calibration.plans.threshold import ThresholdPlan


def tune(
    labels: Annotated[
        Path,
        typer.Argument(
            help="CSV of labelled cuts with columns 'file', 'label' (stable, marginal, chatter), "
            "'spindle speed [1/min]', 'tool', optional 'start [s]', 'stop [s]', 'rate [Hz]'; files "
            "are relative to its folder."
        ),
    ],
    baseline: chatter_options.BaselineFile,
    false_alarm_cost: Annotated[
        float, typer.Option("--false-alarm-cost", help="Cost of a false alarm, in any unit.")
    ] = 1.0,
    miss_cost: Annotated[
        float, typer.Option("--miss-cost", help="Cost of a miss, in the same unit.")
    ] = 1.0,
    window: chatter_options.Window = None,
    band: chatter_options.Band = None,
    false_alarms_per_hour: Annotated[
        float | None,
        typer.Option("--false-alarms-per-hour", help="Rate in stable cutting to keep as well."),
    ] = None,
    chatter_share: Annotated[
        float, typer.Option("--chatter-share", help="Share of windows (or cuts) that chatter.")
    ] = 0.5,
    cost_per: Annotated[
        str, typer.Option("--cost-per", help="window: each by itself; cut: by the rule.")
    ] = "window",
    tool: Annotated[
        str | None, typer.Option("--tool", help="Tool to tune for; else all of them together.")
    ] = None,
    votes: chatter_options.Votes = 2,
    of: chatter_options.Of = 5,
    averaged: Annotated[
        int,
        typer.Option(
            "--averaged",
            help="Tune the averaged rule instead, of so many spectra; --votes and --of are 1 then.",
        ),
    ] = 1,
    within: Annotated[
        float | None,
        typer.Option(
            "--within", help="Time to find chatter in [s]; else the length of chattering cuts."
        ),
    ] = None,
    tune_band: Annotated[
        bool, typer.Option("--tune-band", help="Tune band and averaging too, by gradients.")
    ] = False,
    folds: Annotated[
        int, typer.Option("--folds", help="Shares in which cuts are left out; 0 leaves it out.")
    ] = 5,
    seed: Annotated[int, typer.Option("--seed", help="Same seed, same result.")] = 0,
    channel: chatter_options.Channel = None,
    mains: chatter_options.Mains = None,
    ignore: chatter_options.Ignore = None,
    out: Annotated[
        Path | None, typer.Option("--out", help="Write the JSON here too, for --tuned.")
    ] = None,
    plot: options.Plot = None,
    as_json: options.AsJson = False,
) -> None:
    """Tune the threshold of chatter on labelled cuts, with the figures to expect of it."""
    _require(false_alarm_cost, miss_cost, chatter_share, folds, seed)
    options.check_outputs(out, plot=plot)
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.chatter_arrays import NullLaw, tools_of
    from calibration.chatter_cuts import null_numbers, read_labels, score_cuts
    from calibration.chatter_scores import fit_scores
    from calibration.plans.alarm_rule import AlarmRule
    from calibration.plans.threshold import plan_threshold
    from calibration.plans.threshold_check import check_threshold
    from calibration.plans.threshold_cost import Costs
    from procmodel.io import write_text
    from procmodel.io.baselines import load_baselines

    costs = Costs(miss_cost, false_alarm_cost, chatter_share, cost_per)
    rule = AlarmRule(1, 1) if averaged > 1 else AlarmRule(votes, of)
    labelled, baselines = read_labels(labels), load_baselines(baseline)
    progress = sys.stderr.isatty()
    settings: dict[str, Any] = {"mains": mains, "ignored": tuple(ignore or ())}
    if band is not None:
        settings["band"] = band
    cuts, detector = score_cuts(
        labelled,
        baselines,
        channels=channel,
        window=window,
        averaged=averaged,
        keep_distances=tune_band,
        **settings,
    )
    null = NullLaw(*null_numbers(detector, baselines, labelled[-1].spindle_speed), averaged)
    tools = tools_of(cuts)
    meant: str | Sequence[str] = tool or (tools[0] if len(tools) == 1 else tools)
    posterior = fit_scores(cuts, null=null, seed=seed, progress=progress)
    asked: dict[str, Any] = {"false_alarms_per_hour": false_alarms_per_hour}
    plan = plan_threshold(posterior, costs, rule, tool=meant, within=within, **asked)
    result = plan.as_dict() | {
        "statistic": "distance" if averaged == 1 else "averaged distance",
        "rule": {"votes": rule.votes, "of": rule.of, "averaged": averaged},
        "band_hz": list(detector.settings.band),
        "cuts": _counts(cuts),
        "posterior": posterior.status,
    }
    warnings = list(plan.warnings)
    if averaged > 1:
        warnings.append(
            f"this is a threshold of the distance of {averaged} averaged spectra: give it as "
            "--averaged-threshold, not as --threshold"
        )
    if not isinstance(meant, str):
        plans = {
            name: plan_threshold(posterior, costs, rule, tool=name, within=within, **asked)
            for name in meant
        }
        result["tools"] = {name: each.as_dict() for name, each in plans.items()}
        warnings.append(
            f"one threshold for the tools {' and '.join(meant)}: that of each by itself stands "
            "under 'tools', and --tool names one"
        )
    result["held_out"] = None
    if folds:
        check = check_threshold(
            posterior, costs, rule, null=null, tool=meant, folds=folds, seed=seed,
            progress=progress, **asked,
        )  # fmt: skip
        result["held_out"] = check.as_dict()
        warnings += check.warnings
    if tune_band:
        from calibration.plans.threshold_tuning import tune_setting

        of_windows = Costs(miss_cost, false_alarm_cost, chatter_share)
        tuning = tune_setting(cuts, of_windows, detector.settings.band, seed=seed)
        result["tuning"] = tuning.as_dict()
    result["warnings"] = warnings
    if plot is not None:
        from calibration.plots.figures import save
        from calibration.plots.threshold import draw_threshold

        shown = [cut for cut in cuts if tool is None or cut.tool == tool]
        save(draw_threshold(plan, shown), plot)
    if out is not None:
        write_text(out, console.json_text(result) + "\n")
    console.show(result, _as_text(result, plan), as_json)
    if not posterior.converged:
        raise typer.Exit(console.NOT_CONVERGED)


def _require(false_alarm: float, miss: float, share: float, folds: int, seed: int) -> None:
    for name, value in (("--false-alarm-cost", false_alarm), ("--miss-cost", miss)):
        if not 0.0 < value < math.inf:
            raise InputError(f"{name} is {value:g}, but must be above 0.")
    if not 0.0 < share < 1.0:
        raise InputError(f"--chatter-share is {share:g}, but must be between 0 and 1.")
    if folds < 0 or folds == 1:
        raise InputError(f"--folds is {folds}, but must be 2 or more, or 0 for none.")
    if seed < 0:
        raise InputError(f"--seed is {seed}, but must be 0 or more.")


def _counts(cuts: "Sequence[CutScores]") -> dict[str, int]:
    from calibration.chatter_cuts import LABELS

    return {label: sum(cut.label == label for cut in cuts) for label in LABELS}


def _as_text(result: dict[str, Any], plan: "ThresholdPlan") -> str:
    def spread(name: str, digits: str) -> str:
        low, high = result[f"{name}_interval90"]
        return f"{result[name]:{digits}} ({low:{digits}} to {high:{digits}})"

    counts = ", ".join(f"{count} {label}" for label, count in result["cuts"].items() if count)
    lines = [
        f"status       {plan.status}",
        f"cuts         {counts}",
        f"alarm from   P(chatter | score) {result['alarm_from_probability']:.3g}",
        f"false alarms {spread('false_alarms_per_hour', '.3g')} per hour of stable cutting",
        f"detection    {spread('detection_probability', '.3f')} of chattering cuts within "
        f"{result['detection_within_s']:.3g} s",
        f"delay        {spread('delay_s', '.3g')} s",
    ]
    held = result["held_out"]
    if held is not None:
        rows = [("held out", held), ("in sample", held["in_sample"])]
        for name, row in rows:
            said = []
            if row["false_alarms_per_hour"] is not None:
                low, high = row["false_alarms_per_hour_interval90"]
                rate = row["false_alarms_per_hour"]
                said.append(f"{rate:.3g} ({low:.2g} to {high:.2g}) false alarms per hour")
            if row["detection_probability"] is not None:
                low, high = row["detection_probability_interval90"]
                said.append(f"detection {row['detection_probability']:.3f} ({low:.2f}, {high:.2f})")
            if row["auc"] is not None:
                said.append(f"AUC {row['auc']:.3f}")
            lines.append(f"{name:<13}{', '.join(said)}")
    if "tuning" in result:
        tuned = result["tuning"]["tuned"]
        lines += [
            f"tuning       {result['tuning']['status']}",
            f"{'':<13}{tuned['low']:.4g} to {tuned['high']:.4g} Hz, "
            f"{tuned['averaged']:g} averaged, threshold {tuned['threshold']:.4g}",
        ]
    for name, each in result.get("tools", {}).items():
        lines.append(f"tool {name:<8}{each['status']}")
    lines += [f"warning  {each.rstrip('.')}." for each in result["warnings"]]
    return "\n".join(lines)
