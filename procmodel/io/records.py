"""Recordings of vibration: read whole, or in blocks with constant memory.

TDMS, WAV, HDF5, MATLAB files and tables of text are told apart by their content.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.record_csv import open_csv
from procmodel.io.record_hdf5 import open_hdf5
from procmodel.io.record_mat import open_mat
from procmodel.io.record_source import Channel, Source, agreed_rate, picked_channels
from procmodel.io.record_tdms import open_tdms
from procmodel.io.record_wav import open_wav
from procmodel.io.textfile import read_bytes

__all__ = ["Record", "RecordStream", "open_record", "read_record"]

_HDF5_MARK = b"\x89HDF\r\n\x1a\n"
_BINARY_SUFFIXES = {
    ".tdms": "TDMS",
    ".wav": "WAV",
    ".h5": "HDF5",
    ".hdf5": "HDF5",
    ".hdf": "HDF5",
}


@dataclass(frozen=True, eq=False)
class Record:
    """A recording, or a part of one.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    rate : float [Hz]
        Sampling rate.
    channels : tuple of str
        Names of the channels.
    units : tuple of str
        Unit of each, an SI unit as far as the file names one; "1" where it does not.
    samples : numpy.ndarray, shape (n, c), float64
        One column per channel.
    start : float [s]
        Time of the first sample since the beginning of the recording.
    """

    path: Path
    rate: float
    channels: tuple[str, ...]
    units: tuple[str, ...]
    samples: np.ndarray
    start: float = 0.0

    @property
    def times(self) -> np.ndarray:
        """Time of each sample since the beginning of the recording, shape (n,) [s]."""
        return self.start + np.arange(len(self.samples)) / self.rate


class RecordStream:
    """A recording that is read block by block; each iteration begins anew.

    Attributes
    ----------
    path : pathlib.Path
        The file.
    rate : float [Hz]
        Sampling rate.
    channels, units : tuple of str
        Names of the channels and their units, as in `Record`.
    length : int or None
        Samples that will come; None where only reading to the end can tell.
    start : float [s]
        Time of the first sample since the beginning of the recording.
    fault : str or None
        What is wrong with the end of the file, if that lies within what is asked for.
    status : str
        A sentence on how the last iteration ended.
    """

    def __init__(
        self,
        source: Source,
        picked: tuple[Channel, ...],
        rate: float,
        first: int,
        last: int | None,
        block_length: int,
    ) -> None:
        self.path = source.path
        self.rate = rate
        self.channels = tuple(channel.name for channel in picked)
        self.units = tuple(channel.unit for channel in picked)
        self.start = first / rate
        self.status = "not read yet"
        self._source, self._picked, self._block_length = source, picked, block_length
        self._first, self._last = first, last
        lengths = [channel.length for channel in picked if channel.length is not None]
        sound = min(lengths) if lengths else None
        within = sound is not None and last is not None and last <= sound
        self.fault = None if within else source.fault
        if sound is None:
            self.length = None
            return
        if first >= sound or (last is not None and last > sound + 1 and self.fault is None):
            raise self._beyond(sound)
        # A stop at the very end may be one sample too far by rounding.
        self.length = (sound if last is None else min(last, sound)) - first

    def __iter__(self) -> Iterator[np.ndarray]:
        """Blocks of samples, shape (k, c), in the units of `units`."""
        count = 0
        self.status = "stopped before the end"
        for block in self._source.blocks(self._picked, self._first, self._end, self._block_length):
            count += len(block)
            yield block
        stopped = self._last is not None and count >= self._last - self._first - 1
        ended_early = count == 0 or self._last is not None
        if self.length is None and self.fault is None and not stopped and ended_early:
            raise self._beyond(self._first + count if count else None)
        if self.fault is not None and not stopped:
            self.status = f"{self.fault}; {count} samples are sound and were read"
        else:
            self.status = f"read to the end: {count} samples"

    @property
    def _end(self) -> int | None:
        return self._last if self.length is None else self._first + self.length

    def _beyond(self, sound: int | None) -> InputError:
        """What to say of a part that is not there; None where the end itself is unknown."""
        if self._last is not None and sound is not None and self._first < sound:
            asked, name = self._last / self.rate, "stop"
        else:
            asked, name = self.start, "start"
        end = "" if sound is None else f" at {sound / self.rate:g} s"
        return InputError(
            f"{self.path}: {name} at {asked:g} s lies behind the end of the recording{end}: give "
            f"an earlier {name}"
        )


def open_record(
    path: str | os.PathLike[str],
    rate: float | None = None,
    channels: str | Sequence[str] | None = None,
    start: float | None = None,
    stop: float | None = None,
    block_length: int = 16384,
) -> RecordStream:
    """Open a recording to read it block by block.

    Parameters
    ----------
    path : path-like
        The file.
    rate : float, optional [Hz]
        Sampling rate; needed where the file does not hold it.
    channels : str or sequence of str, optional
        Names of the channels, in the order wanted. Left out: all signals, which then have to be
        equally long.
    start, stop : float, optional [s]
        Part of the recording, from its beginning; `stop` itself is not included.
    block_length : int
        Samples per block; the last one may be shorter.

    Returns
    -------
    RecordStream
        Memory in use does not grow with the recording, but for MATLAB files before version 7.3 and
        rearranged TDMS files.

    Raises
    ------
    InputError
        If the file cannot be read, holds another rate or none, lacks a channel, or the part asked
        for. Faults inside a table of text are raised when its blocks are read.

    Notes
    -----
    A file that is cut off is read as far as it is sound; `fault` and `status` say so.
    """
    path = Path(path)
    if rate is not None and not (math.isfinite(rate) and rate > 0.0):
        raise InputError(f"rate is {rate:g} Hz: give a number greater than zero")
    if block_length < 1:
        raise InputError(f"block_length is {block_length}: give at least 1")
    source = _open(path, rate)
    picked = picked_channels(source, channels)
    used = agreed_rate(source.path, rate, source.rate, source.rate_tolerance)
    first, last = _part(start, stop, used)
    return RecordStream(source, picked, used, first, last, block_length)


def read_record(
    path: str | os.PathLike[str],
    rate: float | None = None,
    channels: str | Sequence[str] | None = None,
    start: float | None = None,
    stop: float | None = None,
) -> Record:
    """Read a recording, or a part of it.

    Parameters
    ----------
    path, rate, channels, start, stop
        As for `open_record`.

    Returns
    -------
    Record
        With at least one sample.

    Raises
    ------
    InputError
        As for `open_record`, and if the file is cut off within the part asked for; the text says
        how many samples are sound.
    """
    stream = open_record(path, rate, channels, start, stop, block_length=65536)
    if stream.fault is not None and stream.length is not None:
        raise _cut_off(stream, stream.length)
    shape = (stream.length or 0, len(stream.channels))
    samples = np.empty(shape)
    if stream.length is None:
        blocks = list(stream)
        samples = np.concatenate(blocks) if blocks else samples
    else:
        position = 0
        for block in stream:
            samples[position : position + len(block)] = block
            position += len(block)
        if position < stream.length:
            raise InputError(
                f"{stream.path}: {position} samples are there where {stream.length} were "
                "promised: copy the file again"
            )
    if stream.fault is not None and not stream.status.startswith("read to the end"):
        raise _cut_off(stream, len(samples))
    return Record(stream.path, stream.rate, stream.channels, stream.units, samples, stream.start)


def _cut_off(stream: RecordStream, count: int) -> InputError:
    end = stream.start + count / stream.rate
    return InputError(
        f"{stream.path}: {stream.fault}; {count} samples up to {end:.9g} s are sound: record it "
        f"anew, or read it with stop at {end:.9g} s"
    )


def _open(path: Path, rate: float | None) -> Source:
    """Source by the content of the file."""
    try:
        with path.open("rb") as file:
            beginning = file.read(520)
    except OSError:
        read_bytes(path)  # Says in a sentence what is in the way.
        raise
    suffix = path.suffix.lower()
    if not beginning:
        raise InputError(f"{path}: the file is empty: record it anew")
    if beginning[:4] == b"TDSm":
        return open_tdms(path)
    if beginning[:4] in (b"RIFF", b"RF64"):
        return open_wav(path)
    if beginning.startswith(_HDF5_MARK) or beginning[512:].startswith(_HDF5_MARK):
        return open_hdf5(path)
    if beginning.startswith(b"MATLAB") or suffix == ".mat":
        return open_mat(path)
    if suffix in _BINARY_SUFFIXES:
        raise InputError(
            f"{path}: this is not a {_BINARY_SUFFIXES[suffix]} file, or its beginning is damaged: "
            "copy it from the rig again"
        )
    return open_csv(path, rate)


def _part(start: float | None, stop: float | None, rate: float) -> tuple[int, int | None]:
    """First sample and the one behind the last, None for the end of the file."""
    for name, value in (("start", start), ("stop", stop)):
        if value is not None and not (math.isfinite(value) and value >= 0.0):
            raise InputError(f"{name} is {value:g} s: give seconds since the recording began")
    # Rounding must not make the sample at `start` itself miss its place.
    first = 0 if start is None else math.ceil(start * rate - 1e-6)
    last = None if stop is None else math.ceil(stop * rate - 1e-6)
    if last is not None and last <= first:
        raise InputError(
            f"there is no sample between start {start or 0:g} s and stop {stop:g} s: give a later "
            "stop"
        )
    return first, last
