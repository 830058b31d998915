"""Baselines of air cutting on disk, as HDF5."""

from __future__ import annotations

import hashlib
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from procmodel.errors import InputError
from procmodel.io.atomic import writing
from procmodel.io.textfile import read_bytes

__all__ = ["OverrideBaseline", "StoredBaseline", "load_baselines", "save_baselines"]

_KIND, _VERSION = "procmodel baselines", 1
_GROUP = "override "


@dataclass(frozen=True, eq=False)
class OverrideBaseline:
    """Spectra of air cutting at one override.

    Attributes
    ----------
    override : float [%]
        Of spindle speed and feed.
    spindle_speed : float [1/min]
        Spindle speed at this override.
    count : int
        Spectra that went in.
    mean : numpy.ndarray, shape (c, bins)
        Mean power spectrum of each channel.
    squares : numpy.ndarray, shape (c, bins)
        Sum of the squared deviations from the mean.

    Raises
    ------
    InputError
        If a number is out of its range, or the spectra differ in shape or are not finite.
    """

    override: float
    spindle_speed: float
    count: int
    mean: np.ndarray
    squares: np.ndarray

    def __post_init__(self) -> None:
        for name in ("override", "spindle_speed"):
            value = float(getattr(self, name))
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} is {value:g}: give a number greater than zero")
            object.__setattr__(self, name, value)
        if int(self.count) != self.count or self.count < 1:
            raise InputError(f"count is {self.count}: give the number of spectra, at least 1")
        object.__setattr__(self, "count", int(self.count))
        for name in ("mean", "squares"):
            values = np.asarray(getattr(self, name), np.float64)
            if values.ndim != 2 or not np.isfinite(values).all() or (values < 0.0).any():
                raise InputError(
                    f"{name} at override {self.override:g} % has shape {values.shape} or holds "
                    "numbers below zero or none: give power spectra, one row per channel"
                )
            object.__setattr__(self, name, values)
        if self.mean.shape != self.squares.shape:
            raise InputError(
                f"mean and squares at override {self.override:g} % have shapes {self.mean.shape} "
                f"and {self.squares.shape}: give both for the same channels and bins"
            )


@dataclass(frozen=True, eq=False)
class StoredBaseline:
    """Baselines of one set-up, and how their spectra were made.

    Attributes
    ----------
    rate : float [Hz]
        Sampling rate.
    window_length, hop : int
        Samples of a window, and from one window to the next.
    taper : str
        Name of the taper.
    channels, units : tuple of str
        Names of the channels and units of their samples.
    overrides : tuple of OverrideBaseline
        One for each override, in the order of falling override.

    Raises
    ------
    InputError
        If there is none or one twice, a number is out of its range, or the spectra do not have
        one row per channel and `window_length // 2 + 1` bins.
    """

    rate: float
    window_length: int
    hop: int
    taper: str
    channels: tuple[str, ...]
    units: tuple[str, ...]
    overrides: tuple[OverrideBaseline, ...]

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0.0):
            raise InputError(f"rate is {self.rate:g} Hz: give a number greater than zero")
        object.__setattr__(self, "rate", float(self.rate))
        for name, least in (("window_length", 2), ("hop", 1)):
            value = getattr(self, name)
            if int(value) != value or value < least:
                raise InputError(f"{name} is {value}: give at least {least} samples")
            object.__setattr__(self, name, int(value))
        object.__setattr__(self, "channels", tuple(map(str, self.channels)))
        object.__setattr__(self, "units", tuple(map(str, self.units)))
        if not self.channels or len(self.units) != len(self.channels):
            raise InputError(
                f"{len(self.channels)} channels with {len(self.units)} units: give one each"
            )
        ordered = tuple(sorted(self.overrides, key=lambda each: -each.override))
        if not ordered:
            raise InputError("there is no baseline: record air cutting at one override at least")
        object.__setattr__(self, "overrides", ordered)
        shape = (len(self.channels), self.window_length // 2 + 1)
        for before, each in zip((None, *ordered), ordered, strict=False):
            if before is not None and before.override == each.override:
                raise InputError(f"override {each.override:g} % stands twice: keep one of them")
            if each.mean.shape != shape:
                raise InputError(
                    f"spectra at override {each.override:g} % have shape {each.mean.shape}, not "
                    f"{shape}: make them with windows of {self.window_length} samples of each "
                    "channel"
                )


def save_baselines(path: str | os.PathLike[str], baseline: StoredBaseline) -> None:
    """Write baselines to a file, completely or not at all.

    Parameters
    ----------
    path : path-like
        The file; one already there is replaced.
    baseline : StoredBaseline
        What to write; `load_baselines` gives it back to the bit.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    import h5py

    with writing(path) as draft, h5py.File(draft, "w") as file:
        file.attrs["kind"] = np.bytes_(_KIND)
        file.attrs["version"] = _VERSION
        file.attrs["digest"] = np.bytes_(_digest(baseline))
        for name in ("rate", "window_length", "hop"):
            file.attrs[name] = getattr(baseline, name)
        for name in ("taper", "channels", "units"):
            file.attrs[name] = np.bytes_(json.dumps(getattr(baseline, name)).encode())
        for index, each in enumerate(baseline.overrides):
            group = file.create_group(f"{_GROUP}{index}")
            for name in ("override", "spindle_speed", "count"):
                group.attrs[name] = getattr(each, name)
            for name in ("mean", "squares"):
                group.create_dataset(name, data=getattr(each, name))


def load_baselines(path: str | os.PathLike[str]) -> StoredBaseline:
    """Read baselines that `save_baselines` wrote.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    StoredBaseline
        To the bit what was saved.

    Raises
    ------
    InputError
        If the file is missing, another kind of file, damaged, or of a newer version.
    """
    import h5py

    path = Path(path)
    if not path.is_file():
        read_bytes(path)  # Says in a sentence what is in the way.
    remedy = "make it again with 'procmodel chatter baseline'"
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("kind") != _KIND.encode():
                raise InputError(f"{path}: this HDF5 file holds no baselines: {remedy}")
            version = int(file.attrs["version"])
            if version > _VERSION:
                raise InputError(
                    f"{path}: written in version {version} of the format, {_VERSION} is known "
                    "here: install a newer procmodel"
                )
            baseline = _stored(file)
            if file.attrs["digest"] != _digest(baseline).encode():
                raise InputError(f"{path}: damaged or changed since it was written: {remedy}")
            return baseline
    except InputError as error:
        if str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}: damaged, {error}") from error
    except Exception as error:
        # Damage makes the library stumble in a dozen unrelated ways.
        raise InputError(
            f"{path}: this is no file of baselines, or it is damaged: {remedy}"
        ) from error


def _digest(baseline: StoredBaseline) -> str:
    """Fingerprint of every number and name, as HDF5's own checksums leave gaps."""
    digest = hashlib.sha256()
    names = ("rate", "window_length", "hop", "taper", "channels", "units")
    digest.update(json.dumps([getattr(baseline, name) for name in names]).encode())
    for each in baseline.overrides:
        digest.update(json.dumps([each.override, each.spindle_speed, each.count]).encode())
        digest.update(each.mean.astype("<f8").tobytes())
        digest.update(each.squares.astype("<f8").tobytes())
    return digest.hexdigest()


def _stored(file: Any) -> StoredBaseline:
    overrides = [
        OverrideBaseline(
            override=float(group.attrs["override"]),
            spindle_speed=float(group.attrs["spindle_speed"]),
            count=int(group.attrs["count"]),
            mean=group["mean"][()],
            squares=group["squares"][()],
        )
        for group in (file[f"{_GROUP}{index}"] for index in range(len(file)))
    ]
    return StoredBaseline(
        rate=float(file.attrs["rate"]),
        window_length=int(file.attrs["window_length"]),
        hop=int(file.attrs["hop"]),
        taper=str(json.loads(file.attrs["taper"])),
        channels=tuple(json.loads(file.attrs["channels"])),
        units=tuple(json.loads(file.attrs["units"])),
        overrides=tuple(overrides),
    )
