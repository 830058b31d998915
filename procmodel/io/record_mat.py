"""Recordings as MATLAB files up to version 7; those of version 7.3 are HDF5."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from procmodel.errors import InputError
from procmodel.io.record_clock import rate_of_even_clock
from procmodel.io.record_source import Blocks, Channel, Source, numbered
from procmodel.io.record_units import rate_among


def open_mat(path: Path) -> Source:
    """Open a MATLAB file; see `Source`.

    Vectors are channels, matrices are several, `name 1..c`, along the shorter axis. There are no
    units. The rate is a scalar (`fs`, `rate`, `dt`), or that of a vector `time` or `t` in s.

    Raises
    ------
    InputError
        If it is no MATLAB file or is damaged, or the vector of times has uneven steps.

    Notes
    -----
    These files are compressed as a whole and of 2 GB at most: the arrays are held in memory.
    """
    import scipy.io

    try:
        content = scipy.io.loadmat(path)
    except Exception as error:
        # A damaged file makes the parser stumble in a dozen unrelated ways.
        raise InputError(
            f"{path}: this is not a MATLAB file, or it is damaged or cut off: save it again, or "
            "as HDF5"
        ) from error
    channels: list[Channel] = []
    columns: dict[str, np.ndarray] = {}
    scalars: dict[str, object] = {}
    for name, array in content.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf" or array.ndim > 2:
            continue
        if array.size == 1:
            scalars[name] = array.item()
        if array.size <= 1:
            continue
        table = array if array.shape[0] >= array.shape[1] else array.T
        clock = name.lower() in ("time", "t") and table.shape[1] == 1
        for index, label in enumerate(numbered(name, table.shape[1])):
            channels.append(Channel(label, "s" if clock else "1", len(table), clock=clock))
            columns[label] = table[:, index]
    rate = rate_among(scalars)
    for channel in channels if rate is None else ():
        if channel.clock:
            try:
                rate = rate_of_even_clock(columns[channel.name])
            except InputError as error:
                raise InputError(f"{path}: '{channel.name}': {error}") from error

    def blocks(picked: Sequence[Channel], first: int, last: int | None, size: int) -> Blocks:
        length = len(columns[picked[0].name])
        end = length if last is None else min(last, length)
        for start in range(first, end, size):
            parts = [columns[channel.name][start : min(start + size, end)] for channel in picked]
            # A damaged sample may be a NaN of the kind that warns when it is used.
            with np.errstate(invalid="ignore"):
                block = np.stack(parts, axis=1).astype(np.float64)
            yield block

    return Source(path, tuple(channels), rate, blocks)
