"""`procmodel chatter watch`: events of a recording while it is made."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from calibration.cli import chatter_options, console, options
from procmodel.errors import InputError

if TYPE_CHECKING:
    from calibration.chatter_tally import Tally
    from procmodel.chatter import BadWindows, Event
    from procmodel.io.record_follow import Follower


def watch_command(
    record: Annotated[
        Path,
        typer.Argument(
            help="CSV or WAV file that grows, or - for standard input; a column 'sample [1]' or "
            "'time [s]' shows what is missing and what came twice."
        ),
    ],
    baseline: chatter_options.BaselineFile,
    spindle_speed: chatter_options.SpindleSpeed,
    rate: chatter_options.Rate = None,
    raw: Annotated[
        list[str] | None,
        typer.Option(
            "--raw",
            help="Heading such as 'y [m/s^2]' of a channel of bare 32-bit floats, instead of a "
            "header; repeat in the order of the channels.",
        ),
    ] = None,
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
    events: Annotated[
        Path | None, typer.Option("--events", help="Write the events here as they happen (CSV).")
    ] = None,
    until_idle: Annotated[
        float | None,
        typer.Option("--until-idle", help="End when nothing has come for so long [s]."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print a JSON object for each event and for the end.")
    ] = False,
) -> None:
    """Follow a recording while it is made, and say at once when the cut chatters."""
    chatter_options.require_speed(spindle_speed)
    options.check_outputs(events)
    if until_idle is not None and not until_idle > 0.0:
        raise InputError(f"--until-idle is {until_idle:g}, but must be above 0.")
    level, _ = chatter_options.chosen_threshold(threshold, tuned)
    settings = chatter_options.settings_of(
        level, averaged_threshold, band, teeth, votes, of, mains, ignore, limit, report_marginal,
        tuned,
    )  # fmt: skip
    from calibration.cli.runtime import prepare_jax

    prepare_jax()
    from calibration.chatter_detection import Source
    from procmodel.io.baselines import load_baselines
    from procmodel.io.record_follow import follow

    baselines = load_baselines(baseline)
    wanted = channel or baselines.channels
    with _stoppable() as asked:
        follower = follow(str(record), rate, wanted, raw=raw, stop=asked.__bool__, idle=until_idle)
        detector, warnings = chatter_options.detector_from(
            baseline,
            baselines,
            Source(follower.rate, follower.channels, follower.units),
            spindle_speed,
            {"override": override, "window": window, **settings},
        )
        if not follower.clocked:
            warnings.append(
                "no clock: without a column 'sample [1]' or 'time [s]' gaps and repetitions go "
                "unseen"
            )
        for each in warnings:
            console.say(f"warning  {each.rstrip('.')}.")
        with _Outlet(events, as_json) as outlet:
            _watch(follower, detector, outlet, asked)


class _Asked:
    """Whether somebody has asked to stop."""

    def __init__(self) -> None:
        self._so = False

    def __bool__(self) -> bool:
        return self._so

    def ask(self) -> None:
        self._so = True


class _Outlet:
    """Where events go as they happen: standard output, and a table."""

    def __init__(self, table: Path | None, as_json: bool) -> None:
        self._path, self._as_json = table, as_json
        self._table: TextIO | None = None

    def __enter__(self) -> "_Outlet":
        if self._path is not None:
            # Not the way of finished files: it has to be there while it grows.
            self._table = self._path.open("w", encoding="utf-8", newline="")
            self._append(",".join(chatter_options.EVENT_HEADINGS) + "\n")
        return self

    def __exit__(self, *_: object) -> None:
        if self._table is not None:
            self._table.close()

    def event(self, event: "Event") -> None:
        from calibration.chatter_detection import event_as_dict

        if self._table is not None:
            self._append(chatter_options.event_rows([event]))
        console.show(event_as_dict(event), event.sentence, self._as_json)

    def end(self, result: dict[str, Any], text: str) -> None:
        console.show(result, text, self._as_json)

    def _append(self, text: str) -> None:
        assert self._table is not None
        self._table.write(text)
        self._table.flush()


def _watch(follower: "Follower", detector: Any, outlet: _Outlet, asked: _Asked) -> None:
    from calibration.chatter_detection import after_gap
    from calibration.chatter_tally import Tally
    from procmodel.chatter import FAULTS, observed, start
    from procmodel.io.record_follow import Gap

    state, tally, told = start(), Tally(detector.settings.windowing.resolution), set[str]()
    try:
        for item in follower:
            if isinstance(item, Gap):
                console.say(f"gap  {item.sentence}.")
                state = after_gap(detector, state, item.missing)
                continue
            state, events, seen = observed(detector, state, item.samples)
            tally.add(seen, events)
            for event in events:
                outlet.event(event)
            for fault, time in ((each.fault, each.time) for each in seen if each.fault):
                if fault not in told:
                    told.add(fault)
                    console.say(f"warning  {fault} at {time:.3f} s: {FAULTS[fault]}.")
        outlet.end(
            _result(follower, detector, tally, state.bad), _closing(follower, tally, state.bad)
        )
    except BrokenPipeError:
        # Whoever read the events has gone; what is still in the buffer must not raise at the exit.
        asked.ask()
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        console.say("stopped: nobody reads the events any more.")


def _result(
    follower: "Follower", detector: Any, tally: "Tally", bad: "BadWindows"
) -> dict[str, Any]:
    counts = follower.counts
    return {
        **tally.as_dict(),
        "events": tally.events,
        "threshold": detector.settings.threshold,
        "rotation_hz": detector.rotation.frequency,
        "bad_windows": bad._asdict(),
        "samples": counts.samples,
        "gaps": counts.gaps,
        "missing": counts.missing,
        "repeated_blocks": counts.repeated_blocks,
        "repeated": counts.repeated,
        "restarts": counts.restarts,
        "faulty_rows": counts.faulty,
        "ended": follower.status,
    }


def _closing(follower: "Follower", tally: "Tally", bad: "BadWindows") -> str:
    """The last line: how it ended, what came, what did not, what it came to."""
    from calibration.chatter_tally import counted

    counts = follower.counts
    parts = [follower.status.split(",")[0]]
    if counts.gaps:
        parts.append(f"{counted(counts.gaps, 'gap')} with {counts.missing} samples missing")
    if counts.restarts:
        parts.append(f"started anew {counted(counts.restarts, 'time')}")
    if counts.repeated_blocks:
        parts.append(
            f"{counted(counts.repeated_blocks, 'block')} of {counts.repeated} samples came twice "
            "and dropped"
        )
    if counts.faulty:
        parts.append(f"{counted(counts.faulty, 'row')} without numbers dropped")
    parts.append(f"{counted(tally.windows, 'window')}, {counted(tally.events, 'event')}")
    if sum(bad):
        parts.append(f"{counted(sum(bad), 'window')} not scored")
    return "; ".join([*parts, tally.status]) + "."


@contextmanager
def _stoppable() -> Iterator[_Asked]:
    """Ctrl-C and SIGTERM ask to stop instead of ending the process; a second one ends it."""
    asked = _Asked()
    before: dict[int, Any] = {}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(_number: int, _frame: FrameType | None) -> None:
        asked.ask()
        restore()

    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            before[number] = signal.signal(number, ask)
    except ValueError:  # signals can be caught in the main thread alone
        pass
    try:
        yield asked
    finally:
        restore()
