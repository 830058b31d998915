"""The root of the command: sub-commands, job files, and how errors are shown."""

import sys
from pathlib import Path
from typing import Annotated

import typer
from typer.exceptions import TyperException
from typer.main import get_command

from calibration.cli import (
    chatter_baseline,
    chatter_detect,
    chatter_simulate,
    chatter_tune,
    chatter_watch,
    console,
    electrode_gap,
    electrode_path,
    electrode_predict,
    fit_model,
    force_fit,
    path_check,
    path_correct,
    wear_fit,
    wear_fit_surface,
    wear_plan,
    wear_predict,
    wear_simulate,
    wear_volume_ratio,
)
from procmodel import __version__
from procmodel.errors import InputError

app = typer.Typer(
    name="procmodel",
    help="Process models for machining: fit them to measurements, plan on what was fitted.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # As markup, the units in brackets would vanish from the help.
    rich_markup_mode=None,
)
app.command("fit")(fit_model.fit_command)
app.command("report")(fit_model.report_command)
app.command("compare")(fit_model.compare_command)
wear_app = typer.Typer(
    help="Micro-EDM under electrode wear: wear ratio from a cavity, feeds for the next one.",
    no_args_is_help=True,
)
app.add_typer(wear_app, name="wear")
wear_app.command("fit")(wear_fit.fit_command)
wear_app.command("fit-surface")(wear_fit_surface.fit_surface_command)
wear_app.command("plan")(wear_plan.plan_command)
wear_app.command("predict")(wear_predict.predict_command)
wear_app.command("simulate")(wear_simulate.simulate_command)
wear_app.command("volume-ratio")(wear_volume_ratio.volume_ratio_command)
force_app = typer.Typer(
    help="Milling: the force coefficients of a tool in a material from measured forces.",
    no_args_is_help=True,
)
app.add_typer(force_app, name="force")
force_app.command("fit")(force_fit.fit_command)
path_app = typer.Typer(
    help="Milling: engagement along tool paths, and paths that hold it constant.",
    no_args_is_help=True,
)
app.add_typer(path_app, name="path")
path_app.command("check")(path_check.check_command)
path_app.command("correct")(path_correct.correct_command)
chatter_app = typer.Typer(
    help="Milling: chatter in recorded vibration, found against air cutting.",
    no_args_is_help=True,
)
app.add_typer(chatter_app, name="chatter")
chatter_app.command("baseline")(chatter_baseline.baseline_command)
chatter_app.command("detect")(chatter_detect.detect_command)
chatter_app.command("tune")(chatter_tune.tune)
chatter_app.command("watch")(chatter_watch.watch_command)
chatter_app.command("simulate")(chatter_simulate.simulate_command)
electrode_app = typer.Typer(
    help="Micro-electrodes ground by a wire: its path, the discharge gap, the size to expect.",
    no_args_is_help=True,
)
app.add_typer(electrode_app, name="electrode")
electrode_app.command("path")(electrode_path.path_command)
electrode_app.command("gap")(electrode_gap.gap_command)
electrode_app.command("predict")(electrode_predict.predict_command)


def main(arguments: list[str] | None = None) -> None:
    """Run the command and exit: 0 done, 1 not converged, 2 bad input in one sentence on stderr.

    Parameters
    ----------
    arguments : list of str, optional
        Instead of those of the process.
    """
    try:
        code = _run(arguments)
    except InputError as error:
        console.say(f"procmodel: {error}")
        code = console.BAD_INPUT
    except typer.Abort:
        console.say("procmodel: stopped; nothing more was written.")
        code = 130
    except TyperException as error:
        if not error.format_message().strip():  # nothing was asked; the parser has printed its help
            sys.exit(console.BAD_INPUT)
        console.say(f"procmodel: {_one_sentence(error.format_message())}")
        code = console.BAD_INPUT
    sys.exit(code)


def _run(arguments: list[str] | None) -> int:
    """Run one command; its exit code, errors raised."""
    command = get_command(app)
    return command.main(args=arguments, prog_name="procmodel", standalone_mode=False) or 0


def _one_sentence(message: str) -> str:
    return " ".join(message.split()).rstrip(".") + "; see --help."


@app.command("run")
def run_command(
    job: Annotated[Path, typer.Argument(help='TOML file: command = "wear fit" and its options.')],
) -> None:
    """Run a job file: any command with its options as TOML keys."""
    from calibration.cli.jobs import arguments_of_job

    code = _run(arguments_of_job(job, get_command(app)))
    if code:
        raise typer.Exit(code)


@app.command("demo")
def demo_command(
    folder: Annotated[Path, typer.Option("--folder", help="Where to write its files.")] = Path(
        "demo-output"
    ),
) -> None:
    """Make a test cavity, measure it, fit the wear ratio, plan a hemisphere: the whole way."""
    from calibration.cli.demo import run_demo

    run_demo(folder, _run)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"procmodel {__version__}")
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Version.")
    ] = False,
) -> None:
    """Hold the options of the command as a whole."""
