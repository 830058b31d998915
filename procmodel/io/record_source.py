"""What every format of recordings hands over: channels, a rate, and blocks of samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procmodel.errors import InputError, nearest

Blocks = Iterator[np.ndarray]


@dataclass(frozen=True)
class Channel:
    """A numeric channel of a recording.

    Attributes
    ----------
    name : str
        By which it is picked.
    unit : str
        SI unit in which its samples are handed over; "1" where the file names none.
    length : int or None
        Samples in the file; None where only reading to the end can tell.
    alias : str
        A second name by which it may be picked.
    clock : bool
        Whether it holds the time or a count of the samples; then it is no signal.
    """

    name: str
    unit: str
    length: int | None = None
    alias: str = ""
    clock: bool = False


@dataclass(frozen=True)
class Source:
    """A recording that is open for reading.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    channels : tuple of Channel
        What can be picked.
    rate : float or None
        Sampling rate in Hz as far as the file says.
    blocks : callable (channels, first, last, size) -> iterator of numpy.ndarray, shape (k, c)
        Samples `first` to `last` (exclusive, None for the end) of the picked channels in SI, in
        blocks of `size`, the last one shorter. Memory does not grow with the recording.
    fault : str or None
        Half a sentence on what is wrong with the end of the file.
    rate_tolerance : float
        Relative accuracy with which the file gives the rate.
    """

    path: Path
    channels: tuple[Channel, ...]
    rate: float | None
    blocks: Callable[[Sequence[Channel], int, int | None, int], Blocks]
    fault: str | None = None
    rate_tolerance: float = 1e-6


def picked_channels(source: Source, names: str | Sequence[str] | None) -> tuple[Channel, ...]:
    """Channels by name, or every signal where none is named.

    Raises
    ------
    InputError
        If a name is unknown or named twice, there is no signal, or the channels differ in length.
    """
    if names is None:
        found = tuple(channel for channel in source.channels if not channel.clock)
        if not found:
            raise InputError(
                f"{source.path}: there is no channel of numbers: record at least one signal"
            )
    else:
        wanted = [names] if isinstance(names, str) else list(names)
        if not wanted:
            raise InputError("channels is empty: name at least one, or leave it out")
        found = tuple(_named(source, name) for name in wanted)
        if len(set(found)) < len(found):
            raise InputError(f"channels {', '.join(wanted)} name one twice: name each once")
    lengths = {channel.length for channel in found}
    # A file that is cut off may hold more of its first channel than of its last.
    if len(lengths) > 1 and source.fault is None:
        listed = ", ".join(f"'{channel.name}' {channel.length}" for channel in found)
        raise InputError(
            f"{source.path}: the channels differ in length ({listed} samples): pick those that "
            "belong together by name"
        )
    return found


def _named(source: Source, name: str) -> Channel:
    for attribute in ("name", "alias"):
        found = [channel for channel in source.channels if getattr(channel, attribute) == name]
        if len(found) == 1:
            return found[0]
        if len(found) > 1:
            full = " or ".join(f"'{channel.name}'" for channel in found)
            raise InputError(f"{source.path}: there are several channels '{name}': write {full}")
    known = [channel.name for channel in source.channels if not channel.clock]
    if not known:
        raise InputError(f"{source.path}: no channel '{name}': the file holds no signal")
    raise InputError(f"{source.path}: no channel '{name}'{nearest(name, known)}")


def agreed_rate(path: Path, given: float | None, held: float | None, tolerance: float) -> float:
    """Rate in Hz that was given, that the file holds, or that both agree on.

    Raises
    ------
    InputError
        If they differ by more than the share `tolerance`, or there is neither.
    """
    if given is None and held is None:
        raise InputError(f"{path}: the file does not tell its sampling rate: give it in Hz")
    if given is None or held is None:
        return held if given is None else given  # type: ignore[return-value]
    if abs(given - held) > tolerance * held:
        raise InputError(
            f"{path}: the file holds a rate of {held:.9g} Hz, not the {given:.9g} Hz given: leave "
            "the rate out, or correct it"
        )
    return given


def numbered(name: str, count: int) -> list[str]:
    """Names of the columns of an array: `data`, or `data 1`, `data 2` and so on."""
    return [name] if count == 1 else [f"{name} {index}" for index in range(1, count + 1)]


def reblocked(pieces: Iterable[np.ndarray], first: int, last: int | None, size: int) -> Blocks:
    """Pieces of any length cut to samples `first` to `last` and to blocks of `size`."""
    held: list[np.ndarray] = []
    waiting = position = 0
    for piece in pieces:
        begin = max(first - position, 0)
        end = len(piece) if last is None else min(len(piece), last - position)
        position += len(piece)
        part = piece[begin : max(end, begin)]
        if len(part):
            held.append(part)
            waiting += len(part)
        if waiting >= size:
            joined = np.concatenate(held)
            whole = waiting - waiting % size
            for start in range(0, whole, size):
                # A copy: a block that is kept must not keep the whole piece alive.
                yield joined[start : start + size].copy()
            held, waiting = [joined[whole:].copy()], waiting - whole
        if last is not None and position >= last:
            break
    if waiting:
        yield np.concatenate(held)
