"""Recordings as WAV: integers of 8 to 32 bits or floats, any number of channels, also RF64.

Integers are handed over as fractions of full scale, in [-1, 1); a WAV file names no unit.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from procmodel.errors import InputError
from procmodel.io.record_source import Blocks, Channel, Source, numbered

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
# What stands where the size belongs if the writer could not go back to it, and in RF64.
_NOT_FINAL = 0xFFFFFFFF


@dataclass(frozen=True)
class WavHeader:
    """What stands before the samples of a WAV file.

    Attributes
    ----------
    rate : float, Hz
        Sampling rate.
    count : int
        Channels.
    kind : str
        Format of a sample, `int16`, `float32` and so on.
    width : int
        Bytes of a sample.
    begin : int
        Where the samples begin in the file, in bytes.
    size : int or None
        Bytes of samples as declared; None while the recording goes on.
    total : int
        Size of the whole file as declared, 0 where it is not.
    """

    rate: float
    count: int
    kind: str
    width: int
    begin: int
    size: int | None
    total: int

    @property
    def frame(self) -> int:
        """Bytes of one sample of every channel."""
        return self.count * self.width


def open_wav(path: Path) -> Source:
    """Open a WAV file; see `Source`.

    Raises
    ------
    InputError
        If it is no WAV file, or its encoding is compressed.
    """
    with path.open("rb") as file:
        header = read_wav_header(file, path)
        if header is None:
            raise InputError(f"{path}: the file ends within its header: record it anew")
        there = max(file.seek(0, 2) - header.begin, 0)
    fault = None
    sound = there // header.frame
    if header.size is None or (header.size == 0 and there):
        fault = "the recording was not closed, its header does not say how long it is"
    elif header.size > there:
        promised = header.size // header.frame
        fault = f"the file is cut off, its header promises {promised} samples"
    else:
        sound = header.size // header.frame
    channels = tuple(Channel(name, "1", sound) for name in numbered("data", header.count))

    def blocks(picked: Sequence[Channel], first: int, last: int | None, size: int) -> Blocks:
        columns = [channels.index(channel) for channel in picked]
        end = sound if last is None else min(last, sound)
        with path.open("rb") as stream:
            stream.seek(header.begin + first * header.frame)
            for position in range(first, end, size):
                content = stream.read(min(size, end - position) * header.frame)
                yield wav_samples(content, header)[:, columns]

    return Source(path, channels, header.rate, blocks, fault)


def read_wav_header(file: BinaryIO, path: Path) -> WavHeader | None:
    """Header of a WAV file from its beginning; None where it is not complete yet.

    Raises
    ------
    InputError
        As for `open_wav`.
    """
    file.seek(0)
    start = file.read(12)
    if len(start) < 12:
        return None
    mark, total, kind = start[:4], int.from_bytes(start[4:8], "little"), start[8:]
    if mark not in (b"RIFF", b"RF64") or kind != b"WAVE":
        raise InputError(f"{path}: this is not a WAV file: save it as WAV or give another format")
    encoding: tuple[float, int, str, int] | None = None
    long_size: int | None = None
    while True:
        head = file.read(8)
        if len(head) < 8:
            return None
        name, size = head[:4], int.from_bytes(head[4:], "little")
        if name == b"data":
            break
        content = file.read(size + size % 2)
        if len(content) < size:
            return None
        if name == b"fmt ":
            encoding = _encoding(content, path)
        elif name == b"ds64" and size >= 16:
            total, long_size = struct.unpack("<QQ", content[:16])
    if encoding is None:
        raise InputError(f"{path}: there is no 'fmt ' chunk before the samples: record it anew")
    declared: int | None = size
    if size == _NOT_FINAL:
        declared = long_size if mark == b"RF64" and long_size else None
    return WavHeader(*encoding, file.tell(), declared, total + 8 if total else 0)


def wav_samples(content: bytes, header: WavHeader) -> np.ndarray:
    """Samples of whole frames, shape (k, c), integers as fractions of full scale."""
    values: np.ndarray
    if header.kind == "int24":
        octets = np.frombuffer(content, np.uint8).reshape(-1, 3)
        wide = np.zeros((len(octets), 4), np.uint8)
        wide[:, 1:] = octets
        values = wide.view("<i4")[:, 0] * 2.0**-31
    elif header.kind == "uint8":
        values = (np.frombuffer(content, np.uint8) - 128.0) * 2.0**-7
    elif header.kind.startswith("int"):
        bits = 8 * header.width
        values = np.frombuffer(content, f"<i{header.width}") * 2.0 ** (1 - bits)
    else:
        # A damaged sample may be a NaN of the kind that warns when it is used.
        with np.errstate(invalid="ignore"):
            values = np.frombuffer(content, f"<f{header.width}").astype(np.float64)
    return values.reshape(-1, header.count)


def _encoding(content: bytes, path: Path) -> tuple[float, int, str, int]:
    """Rate, channels, kind and width out of the `fmt ` chunk."""
    if len(content) < 16:
        raise InputError(f"{path}: the 'fmt ' chunk is too short: record it anew")
    tag, count, rate, _, frame, bits = struct.unpack("<HHIIHH", content[:16])
    if tag == _EXTENSIBLE and len(content) >= 26:
        tag = int.from_bytes(content[24:26], "little")
    kinds = {
        (_PCM, 8): "uint8",
        (_PCM, 16): "int16",
        (_PCM, 24): "int24",
        (_PCM, 32): "int32",
        (_FLOAT, 32): "float32",
        (_FLOAT, 64): "float64",
    }
    kind = kinds.get((tag, bits))
    if kind is None:
        raise InputError(
            f"{path}: samples of {bits} bits in encoding {tag} cannot be read: save them as "
            "integers of 16, 24 or 32 bits or as 32-bit floats"
        )
    if count == 0 or rate == 0 or frame != count * bits // 8:
        raise InputError(
            f"{path}: the header contradicts itself ({count} channels, {rate} Hz, {frame} bytes "
            "per sample): record it anew"
        )
    return float(rate), count, kind, bits // 8
