"""Recordings as TDMS, the format of NI measuring rigs."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from procmodel.errors import InputError
from procmodel.io.record_source import Blocks, Channel, Source, reblocked
from procmodel.io.record_units import rate_among, si_or_as_written

_LEAD_IN = 28
_NOT_FINAL = 0xFFFFFFFFFFFFFFFF


def open_tdms(path: Path) -> Source:
    """Open a TDMS file; see `Source`.

    The rate is that of `wf_increment`, the unit that of `unit_string`; a unit that is not known
    stays as written. A channel is called by its own name where only one group has it, else
    `group/channel`.

    Raises
    ------
    InputError
        If it is no TDMS file, is damaged, or its channels differ in rate.

    Notes
    -----
    While streaming, memory holds one chunk per channel as the rig wrote it. A file that was
    rearranged ("defragmented") has one chunk per channel, and is then held whole.
    """
    fault = None if _closed(path) else "the file is cut off within its last segment"
    with _tdms_file(path) as file:
        found = [
            channel
            for group in file.groups()
            for channel in group.channels()
            if len(channel) and channel.dtype.kind in "iuf"
        ]
        names = Counter(channel.name for channel in found)
        rates, channels, addresses = {}, [], {}
        for each in found:
            full = f"{each.group_name}/{each.name}"
            alone = names[each.name] == 1
            factor, unit = si_or_as_written(str(each.properties.get("unit_string", "")))
            channel = Channel(
                name=each.name if alone else full,
                unit=unit,
                length=len(each),
                alias=full if alone else each.name,
                clock=each.name.strip().lower() in ("time", "t"),
            )
            channels.append(channel)
            addresses[channel.name] = (each.group_name, each.name, factor)
            rate = rate_among(each.properties)
            if rate is not None:
                rates[channel.name] = rate
        shared = rate_among(file.properties)

    def blocks(picked: Sequence[Channel], first: int, last: int | None, size: int) -> Blocks:
        with _tdms_file(path) as stream:
            columns = []
            for channel in picked:
                group, name, factor = addresses[channel.name]
                columns.append(_scaled(stream[group][name], factor))
            yield from reblocked(_together(columns), first, last, size)

    return Source(path, tuple(channels), _one_rate(path, rates) or shared, blocks, fault)


def _one_rate(path: Path, rates: dict[str, float]) -> float | None:
    if not rates:
        return None
    name, rate = next(iter(rates.items()))
    for other, value in rates.items():
        if abs(value - rate) > 1e-6 * rate:
            raise InputError(
                f"{path}: channel '{name}' has {rate:g} Hz but '{other}' has {value:g} Hz: save "
                "channels of one rate in a file"
            )
    return rate


def _scaled(channel: Any, factor: float) -> Iterator[np.ndarray]:
    chunks = channel.data_chunks()
    while True:
        with _quiet():
            chunk = next(chunks, None)
        if chunk is None:
            return
        if len(chunk):
            # A damaged sample may be a NaN of the kind that warns when it is used.
            with np.errstate(invalid="ignore"):
                values = np.asarray(chunk[:], np.float64) * factor
            yield values


def _together(columns: Sequence[Iterator[np.ndarray]]) -> Iterator[np.ndarray]:
    """Pieces of several channels, cut where the shortest ends, side by side."""
    held = [np.empty(0) for _ in columns]
    while True:
        for index, column in enumerate(columns):
            if not len(held[index]):
                held[index] = next(column, np.empty(0))
        count = min(map(len, held))
        if count == 0:
            return
        yield np.stack([piece[:count] for piece in held], axis=1)
        held = [piece[count:] for piece in held]


def _closed(path: Path) -> bool:
    """Whether the last segment ends where the file does, as after an orderly stop."""
    size, position = path.stat().st_size, 0
    with path.open("rb") as file:
        while position < size:
            file.seek(position)
            lead_in = file.read(_LEAD_IN)
            if len(lead_in) < _LEAD_IN:
                return False
            if lead_in[:4] != b"TDSm":
                raise InputError(
                    f"{path}: this is not a TDMS file, or it is damaged at byte {position}: copy "
                    "it from the rig again"
                )
            # Bit 6 of the table of contents: big-endian numbers, those of the lead-in as well.
            order = "big" if lead_in[4] & 0x40 else "little"
            following = int.from_bytes(lead_in[12:20], order)  # type: ignore[arg-type]
            if following == _NOT_FINAL:
                return False
            position += _LEAD_IN + following
    return position == size


@contextmanager
def _tdms_file(path: Path) -> Iterator[Any]:
    """File opened without its samples, every error of the library as a sentence."""
    from nptdms import TdmsFile

    try:
        # By a file of our own: the library leaves one it opened itself open after an error.
        with path.open("rb") as raw:
            with _quiet():
                file = TdmsFile.open(raw)
            yield file
    except InputError:
        raise
    except Exception as error:
        # A damaged file makes the library's parser stumble in a dozen unrelated ways.
        raise InputError(
            f"{path}: the TDMS file is damaged ({error}): copy it from the rig again"
        ) from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the library from warning on the terminal of what is said here in a sentence."""
    from nptdms.log import log_manager

    level = log_manager.log_level
    log_manager.set_level(logging.ERROR)
    try:
        yield
    finally:
        log_manager.set_level(level)
