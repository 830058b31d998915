"""Recordings as files of each format, written by others than the readers."""

import struct
import wave

import h5py
import numpy as np
import scipy.io
from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

RATE = 25600.0


def vibration(count=5000, channels=2, seed=0):
    """Two tones and noise, one column per channel."""
    rng = np.random.default_rng(seed)
    time = np.arange(count)[:, None] / RATE
    tones = np.sin(2 * np.pi * 690.0 * time) + 0.3 * np.cos(2 * np.pi * 83.0 * time)
    return tones * np.arange(1, channels + 1) + 0.1 * rng.standard_normal((count, channels))


def write_tdms(path, samples, names=("y", "z"), unit="m/s^2", rate=RATE, segments=5, group="rig"):
    """Several segments, as a rig writes them, every channel in each."""
    properties = {"wf_increment": 1.0 / rate, "unit_string": unit}
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject({"operator": "A"}), GroupObject(group)])
        for part in np.array_split(samples, segments):
            writer.write_segment(
                [
                    ChannelObject(group, name, np.ascontiguousarray(part[:, i]), properties)
                    for i, name in enumerate(names)
                ]
            )
    return path


def big_endian_tdms(values, name="y", rate=RATE):
    """The bytes of a TDMS file of one channel and one segment, in big-endian order."""

    def text(words):
        return struct.pack(">l", len(words)) + words.encode()

    meta = struct.pack(">l", 1) + text(f"/'rig'/'{name}'")
    meta += struct.pack(">lllQ", 20, 10, 1, len(values))
    meta += struct.pack(">l", 1) + text("wf_increment") + struct.pack(">ld", 10, 1.0 / rate)
    content = values.astype(">f8").tobytes()
    lead_in = b"TDSm" + struct.pack("<l", 2 | 4 | 8 | 64)
    lead_in += struct.pack(">lQQ", 4712, len(meta) + len(content), len(meta))
    return lead_in + meta + content


def write_wav16(path, integers, rate=25600):
    with wave.open(str(path), "wb") as file:
        file.setnchannels(integers.shape[1])
        file.setsampwidth(2)
        file.setframerate(rate)
        file.writeframes(integers.astype("<i2").tobytes())
    return path


def write_wav24(path, integers, rate=25600):
    octets = integers.astype("<i4").view(np.uint8).reshape(-1, 4)[:, :3]
    with wave.open(str(path), "wb") as file:
        file.setnchannels(integers.shape[1])
        file.setsampwidth(3)
        file.setframerate(rate)
        file.writeframes(octets.tobytes())
    return path


def write_wav(path, values, rate=25600):
    """int32 or float32 by scipy."""
    scipy.io.wavfile.write(path, rate, values)
    return path


def rf64(values, rate=25600, size=None):
    """The bytes of a float32 WAV with 64-bit sizes."""
    content = values.astype("<f4").tobytes()
    count = values.shape[1]
    size = len(content) if size is None else size
    fmt = struct.pack("<HHIIHH", 3, count, rate, rate * 4 * count, 4 * count, 32)
    body = b"WAVE" + b"ds64" + struct.pack("<IQQQI", 28, size + 72, size, len(values), 0)
    body += b"fmt " + struct.pack("<I", 16) + fmt + b"data" + struct.pack("<I", 0xFFFFFFFF)
    return b"RF64" + struct.pack("<I", 0xFFFFFFFF) + body + content


def write_hdf5(path, samples, names=("y", "z"), unit="m/s^2", rate=RATE):
    with h5py.File(path, "w") as file:
        if rate is not None:
            file.attrs["sampling_rate"] = rate
        for i, name in enumerate(names):
            file[f"run/{name}"] = samples[:, i]
            file[f"run/{name}"].attrs["unit"] = unit
    return path


def write_mat73(path, **arrays):
    """MATLAB 7.3: HDF5 behind 512 bytes, arrays transposed, each with its class."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            file[name] = np.atleast_2d(array).T
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["note"] = np.array([[72], [105]], np.uint16)
        file["note"].attrs["MATLAB_class"] = np.bytes_("char")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116))
    return path


def table_text(samples, rate=RATE, header=None, digits=9, times=None, separator=","):
    """A table with a column of times and one per channel."""
    times = np.arange(len(samples)) / rate if times is None else times
    if header is None:
        names = [f"acceleration {i + 1} [m/s^2]" for i in range(samples.shape[1])]
        header = separator.join(["time [s]", *names])
    rows = [
        separator.join([f"{time:.{digits}f}", *(repr(float(v)) for v in row)])
        for time, row in zip(times, samples, strict=True)
    ]
    return "\n".join([header, *rows]) + "\n"
