"""Progress of long work: a bar on the terminal that tells compiling from running."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

# A caller's own function gets (stage, done, total); done is None while JAX compiles.
Callback = Callable[[str, int | None, int], object]
ProgressOption = bool | Callback | None


class Progress(Protocol):
    """What long work reports to."""

    def compiling(self, stage: str) -> None:
        """A stage is being compiled; nothing can be counted yet."""

    def running(self, stage: str, done: int, total: int) -> None:
        """So much of a stage is done; a total of 0 says that nobody knows it."""


class _Silent:
    def compiling(self, stage: str) -> None:
        pass

    def running(self, stage: str, done: int, total: int) -> None:
        pass


class _Told:
    """Passes reports on to a caller's function."""

    def __init__(self, tell: Callback):
        self._tell = tell

    def compiling(self, stage: str) -> None:
        self._tell(stage, None, 0)

    def running(self, stage: str, done: int, total: int) -> None:
        self._tell(stage, done, total)


class _Bar:
    """A bar of rich on stderr, with the time left."""

    def __init__(self, bar: Any):
        self._bar = bar
        self._tasks: dict[str, Any] = {}
        self._shown = 0.0

    def _task(self, stage: str, total: int | None) -> Any:
        if stage not in self._tasks:
            self._tasks[stage] = self._bar.add_task(stage, total=total)
        return self._tasks[stage]

    def compiling(self, stage: str) -> None:
        task = self._task(stage, None)
        self._bar.update(task, description=f"{stage}: compiling", total=None)

    def running(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if 0 < done != total and now - self._shown < 0.1:
            return
        self._shown = now
        # The time left is that of running alone: the clock starts when compiling has ended.
        task = self._task(stage, total)
        if "compiling" in self._bar.tasks[task].description:
            self._bar.reset(task, total=total or None)
        self._bar.update(task, description=stage, completed=done, total=total or None)


@contextmanager
def reporting(progress: ProgressOption) -> Iterator[Progress]:
    """Something to report progress to, for the time of a block.

    Parameters
    ----------
    progress : bool or callable, optional
        True for a bar on stderr; a function is called with (stage, done, total), done being None
        while JAX compiles; False or None for silence.

    Yields
    ------
    Progress
        What to report to.
    """
    if progress is None or progress is False:
        yield _Silent()
    elif progress is True:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )
        from rich.progress import (
            Progress as RichProgress,
        )

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
        )
        with RichProgress(
            *columns, console=Console(file=sys.stderr), refresh_per_second=4, transient=False
        ) as bar:
            yield _Bar(bar)
    else:
        yield _Told(progress)
