"""Recordings as HDF5, and as MATLAB's version 7.3 files, which are HDF5 as well."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from procmodel.errors import InputError
from procmodel.io.record_clock import rate_of_even_clock
from procmodel.io.record_source import Blocks, Channel, Source, numbered
from procmodel.io.record_units import rate_among, si_or_as_written, si_unit, split_heading

# An array with more columns than this is a picture or a table, not one recording.
_MOST_CHANNELS = 256
_HEAD = 65536


@dataclass(frozen=True)
class _Address:
    """Where a channel lies: dataset, axis of the time, column, factor to SI."""

    dataset: str
    axis: int
    column: int
    factor: float


def open_hdf5(path: Path) -> Source:
    """Open an HDF5 or MATLAB 7.3 file; see `Source`.

    Datasets of numbers with one axis are channels, those with two are several, `name 1..c`, along
    the shorter axis. The unit is in the name, `acceleration y [m/s^2]`, or an attribute `unit` or
    `units`. The rate is an attribute or a scalar dataset (`rate`, `fs`, `sampling_rate`, `dt`),
    or that of a dataset `time`. A channel is called by the last part of its name where only one
    has it, else `group/name`.

    Raises
    ------
    InputError
        If it is no HDF5 file or is damaged, or a dataset `time` has uneven steps.
    """
    channels: list[Channel] = []
    places: list[_Address] = []
    properties: dict[str, object] = {}
    rate = None
    with _hdf5_file(path) as file:
        properties.update(file.attrs)
        for name, dataset in _datasets(file):
            if dataset.size == 1 and dataset.ndim <= 2:
                properties[name.rsplit("/", 1)[-1]] = dataset[()].item()
                continue
            if dataset.ndim not in (1, 2) or not dataset.size:
                continue
            if dataset.size // max(dataset.shape) > _MOST_CHANNELS:
                continue
            properties.update(
                {k: v for k, v in dataset.parent.attrs.items() if k not in properties}
            )
            properties.update({k: v for k, v in dataset.attrs.items() if k not in properties})
            axis = int(np.argmax(dataset.shape))
            count = dataset.size // dataset.shape[axis]
            bare, unit, factor = _described(name, dataset.attrs)
            clock = bare.rsplit("/", 1)[-1].lower() in ("time", "t") and count == 1
            for column, label in enumerate(numbered(bare, count)):
                channels.append(Channel(label, unit, dataset.shape[axis], clock=clock))
                places.append(_Address(name, axis, column, factor))
        rate = rate_among(properties)
    channels = _shortened(channels)
    addresses = {channel.name: place for channel, place in zip(channels, places, strict=True)}

    def blocks(picked: Sequence[Channel], first: int, last: int | None, size: int) -> Blocks:
        assert picked[0].length is not None
        end = picked[0].length if last is None else min(last, picked[0].length)
        picks = [addresses[channel.name] for channel in picked]
        with _hdf5_file(path) as stream:
            for start in range(first, end, size):
                read = slice(start, min(start + size, end))
                parts: dict[str, np.ndarray] = {}
                for place in picks:
                    if place.dataset not in parts:
                        parts[place.dataset] = _slice(stream[place.dataset], place.axis, read)
                columns = [parts[each.dataset][:, each.column] for each in picks]
                # A damaged sample may be a NaN of the kind that warns when it is used.
                with np.errstate(invalid="ignore"):
                    block = np.stack(columns, axis=1).astype(np.float64)
                    block *= [each.factor for each in picks]
                yield block

    if rate is None:
        rate = _rate_of_time(path, channels, addresses)
    return Source(path, tuple(channels), rate, blocks)


def _shortened(channels: list[Channel]) -> list[Channel]:
    """Channels called by the last part of their names, where no other channel has it."""
    last = [channel.name.rsplit("/", 1)[-1] for channel in channels]
    often = Counter(last)
    return [
        replace(channel, name=short, alias=channel.name)
        if often[short] == 1
        else replace(channel, alias=short)
        for channel, short in zip(channels, last, strict=True)
    ]


def _described(name: str, attributes: Any) -> tuple[str, str, float]:
    """Name without unit, SI unit, and factor to it."""
    bare, unit = split_heading(name)
    if unit is not None:
        try:
            factor, si = si_unit(unit)
        except InputError:
            # The bracket is a part of the name, `a [run 3]`.
            return name, "1", 1.0
        return bare, si, factor
    for key in ("unit", "units", "Unit", "Units"):
        if key in attributes:
            value = attributes[key]
            text = value.decode(errors="replace") if isinstance(value, bytes) else str(value)
            factor, si = si_or_as_written(text)
            return name, si, factor
    return name, "1", 1.0


def _rate_of_time(
    path: Path, channels: list[Channel], addresses: dict[str, _Address]
) -> float | None:
    """Rate of a dataset `time`, checked at its beginning and its end."""
    for channel in channels:
        if not channel.clock or channel.length is None or channel.length < 2:
            continue
        place = addresses[channel.name]
        with _hdf5_file(path) as file:
            times = _slice(file[place.dataset], place.axis, slice(0, _HEAD))[:, 0]
            last = slice(channel.length - 1, channel.length)
            end = float(_slice(file[place.dataset], place.axis, last)[0, 0]) * place.factor
        try:
            rate = rate_of_even_clock(times) / place.factor
        except InputError as error:
            raise InputError(f"{path}: '{channel.name}': {error}") from error
        begin = float(times[0]) * place.factor
        due = begin + (channel.length - 1) / rate
        if not abs(end - due) <= max(0.5 / rate, 1e-4 * (due - begin)):
            raise InputError(
                f"{path}: '{channel.name}' ends at {end:g} s where {channel.length} even steps "
                f"would end at {due:g} s: cut the recording at its gaps"
            )
        return rate
    return None


def _datasets(file: Any) -> list[tuple[str, Any]]:
    """Datasets of numbers; not those of text that MATLAB stores as numbers, nor its `#refs#`."""
    import h5py

    found: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.startswith("#"):
            return
        kind = item.attrs.get("MATLAB_class", b"double")
        if item.dtype.kind in "iuf" and kind not in (b"char", b"logical", b"cell"):
            found.append((name, item))

    file.visititems(visit)
    return found


def _slice(dataset: Any, axis: int, read: slice) -> np.ndarray:
    if dataset.ndim == 1:
        part = dataset[read][:, None]
    else:
        part = dataset[read] if axis == 0 else dataset[:, read].T
    return np.asarray(part)


@contextmanager
def _hdf5_file(path: Path) -> Iterator[Any]:
    """File opened for reading, every error of the library as a sentence."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except InputError:
        raise
    except Exception as error:
        # Damage makes the library stumble in a dozen unrelated ways.
        raise InputError(
            f"{path}: this is not an HDF5 file, or it is damaged or cut off: save it again"
        ) from error
