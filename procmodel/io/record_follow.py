"""Recordings that are still being written: the samples as they come, and what is missing.

A table of text or a WAV file that grows is read to its end again and again; standard input hands
over text, WAV, or bare 32-bit floats.
"""

from __future__ import annotations

import io
import select
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO

from procmodel.errors import InputError
from procmodel.io.record_growing import Block, Counts, Gap, Reader, Wanted, reader_for
from procmodel.io.textfile import read_bytes

__all__ = ["Block", "Counts", "Follower", "Gap", "follow"]

_BYTES_AT_ONCE = 1 << 20
_STANDARD_INPUT = Path("standard input")


class Follower:
    """Samples of a growing recording; it is iterated once.

    Attributes
    ----------
    path : pathlib.Path
        The file, or `standard input`.
    rate : float [Hz]
        Sampling rate.
    channels, units : tuple of str
        Names of the channels and their SI units.
    clocked : bool
        Whether a clock shows gaps and what comes twice; without one they go unseen.
    counts : Counts
        What came, what is missing, what came twice.
    status : str
        A sentence on how the iteration ended.
    """

    def __init__(self, feed: _Feed, reader: Reader, block_length: int) -> None:
        self._feed, self._reader, self._block_length = feed, reader, block_length
        self.path, self.rate = feed.path, reader.rate
        self.channels = tuple(channel.name for channel in reader.picked)
        self.units = tuple(channel.unit for channel in reader.picked)
        self.clocked = reader.clocked
        self.counts = reader.counts
        self.status = "not read yet"

    def __iter__(self) -> Iterator[Block | Gap]:
        """Blocks of at most `block_length` samples as they come, and gaps between them."""
        try:
            while True:
                for item in self._reader.items():
                    for part in _parts(item, self._block_length):
                        if self._feed.stop():
                            self.status = self._ended("stopped on request")
                            return
                        if isinstance(part, Block):
                            self.counts.samples += len(part.samples)
                        yield part
                content = self._feed.read()
                if content is None:
                    self.status = self._ended(self._feed.ending)
                    return
                self._reader.add(content)
        finally:
            self._feed.close()

    def _ended(self, how: str) -> str:
        seen = self.counts
        text = f"{how} after {seen.samples} samples"
        for count, what in (
            (seen.missing, "missing"),
            (seen.repeated, "dropped because they came twice"),
            (seen.faulty, "in rows that hold no numbers"),
        ):
            text += f", {count} {what}" if count else ""
        return text


def follow(
    path: str | Path,
    rate: float | None = None,
    channels: str | Sequence[str] | None = None,
    *,
    raw: Sequence[str] | None = None,
    stop: Callable[[], bool] = lambda: False,
    idle: float | None = None,
    poll: float = 0.1,
    longest_repeat: float = 10.0,
    block_length: int = 4096,
    sleep: Callable[[float], object] = time.sleep,
    stream: BinaryIO | None = None,
) -> Follower:
    """Follow a recording while it is written; waits until its header is there.

    Parameters
    ----------
    path : path-like
        A growing table of text or WAV file, or "-" for standard input.
    rate : float, optional [Hz]
        Sampling rate; needed where neither a header nor a column of times tells it.
    channels : str or sequence of str, optional
        Names of the channels, in the order wanted; all signals where left out.
    raw : sequence of str, optional
        For bare little-endian 32-bit floats, one per channel and sample in turn: the headings of
        the channels, `acceleration y [m/s^2]`.
    stop : callable () -> bool
        Asked before every block and every wait; the follower ends when it answers true.
    idle : float, optional [s]
        End when nothing has come for so long; without it a file is followed until `stop`.
    poll : float [s]
        How long to wait before a file is looked at again.
    longest_repeat : float [s]
        A clock that goes back by less has sent something twice, which is dropped; one that goes
        back further has started anew.
    block_length : int
        Most samples per block.
    sleep : callable (float)
        What waits.
    stream : binary file, optional
        What to read in place of standard input.

    Returns
    -------
    Follower
        Where there is a column `sample [1]` or `time [s]`, gaps and repeated blocks are told by it.

    Raises
    ------
    InputError
        If the header is faulty, a channel is missing, the rate is unknown or contradicted, or the
        source ends within its header. While following: if the file gets shorter.
    """
    feed = _Feed(path, stream, stop, idle, poll, sleep)
    size = feed.size if feed.is_file else None
    wanted = Wanted(feed.path, rate, channels, raw, longest_repeat, size)
    counts, content = Counts(), b""
    try:
        while True:
            more = feed.read()
            content += more or b""
            reader = reader_for(wanted, content, more is None, counts)
            if reader is not None:
                return Follower(feed, reader, block_length)
            if more is None:
                raise InputError(
                    f"{feed.path}: {feed.ending} before the header was complete: start the "
                    "recording first"
                )
    except BaseException:
        feed.close()
        raise


class _Feed:
    """Bytes as they come; `read` waits, and gives None at the end, which `ending` names."""

    def __init__(
        self,
        path: str | Path,
        stream: BinaryIO | None,
        stop: Callable[[], bool],
        idle: float | None,
        poll: float,
        sleep: Callable[[float], object],
    ) -> None:
        self.stop, self._idle, self._poll, self._sleep = stop, idle, poll, sleep
        self.ending = ""
        self.is_file = str(path) != "-"
        self.path = Path(path) if self.is_file else _STANDARD_INPUT
        self._position = 0
        if self.is_file:
            try:
                self._file: BinaryIO = self.path.open("rb")
            except OSError:
                read_bytes(self.path)  # Says in a sentence what is in the way.
                raise
        else:
            self._file = stream or sys.stdin.buffer

    def read(self) -> bytes | None:
        waited = 0.0
        while True:
            if self.stop():
                self.ending = "stopped on request"
                return None
            if self.is_file:
                content = self._file.read(_BYTES_AT_ONCE)
                if not content and self.size() < self._position:
                    raise InputError(
                        f"{self.path}: the file got shorter while it was read: start again"
                    )
                self._position += len(content)
            elif not self._is_waiting():
                content = b""
            else:
                content = self._read_some()
                if not content:
                    self.ending = "the source ended"
                    return None
            if content:
                return content
            if self._idle is not None and waited >= self._idle:
                self.ending = f"nothing came for {self._idle:g} s"
                return None
            if self.is_file:
                self._sleep(self._poll)
            waited += self._poll

    def size(self) -> int:
        """Bytes in the file by now."""
        return self.path.stat().st_size

    def close(self) -> None:
        if self.is_file:
            self._file.close()

    def _is_waiting(self) -> bool:
        """Whether standard input has something, so that a wait for it can be broken off."""
        try:
            ready, _, _ = select.select([self._file], [], [], self._poll)
        except (OSError, ValueError, TypeError, io.UnsupportedOperation):
            return True
        return bool(ready)

    def _read_some(self) -> bytes:
        # `read` would wait until everything asked for is there.
        read = getattr(self._file, "read1", self._file.read)
        content: bytes = read(_BYTES_AT_ONCE)
        return content


def _parts(item: Block | Gap, size: int) -> Iterator[Block | Gap]:
    if isinstance(item, Gap):
        yield item
        return
    for start in range(0, len(item.samples), size):
        yield Block(item.first + start, item.samples[start : start + size])
