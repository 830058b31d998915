"""Baselines on disk: to the bit what was saved, or a sentence."""

import h5py
import numpy as np
import pytest

from procmodel.errors import InputError
from procmodel.io.baselines import (
    OverrideBaseline,
    StoredBaseline,
    load_baselines,
    save_baselines,
)


def override(percent=100.0, channels=2, bins=65, seed=0, **changes):
    rng = np.random.default_rng(seed)
    fields = {
        "override": percent,
        "spindle_speed": 180.0 * percent,
        "count": 25,
        "mean": rng.lognormal(-30.0, 20.0, (channels, bins)),
        "squares": rng.lognormal(-60.0, 40.0, (channels, bins)),
    }
    return OverrideBaseline(**(fields | changes))


def stored(**changes):
    fields = {
        "rate": 25600.0 / 3.0,
        "window_length": 128,
        "hop": 96,
        "taper": "hann",
        "channels": ("spindle y", "Halter \u00fc"),
        "units": ("m/s^2", "m"),
        "overrides": (override(50.0, seed=1), override(100.0), override(70.1, seed=2)),
    }
    return StoredBaseline(**(fields | changes))


def assert_same(found, expected):
    for name in ("rate", "window_length", "hop", "taper", "channels", "units"):
        assert getattr(found, name) == getattr(expected, name), name
    assert len(found.overrides) == len(expected.overrides)
    for here, there in zip(found.overrides, expected.overrides, strict=True):
        for name in ("override", "spindle_speed", "count"):
            assert getattr(here, name) == getattr(there, name), name
        assert here.mean.tobytes() == there.mean.tobytes()
        assert here.squares.tobytes() == there.squares.tobytes()
        assert here.mean.dtype == np.float64 and here.mean.flags.c_contiguous


def test_round_trip_to_the_bit(tmp_path):
    baseline = stored()
    assert [each.override for each in baseline.overrides] == [100.0, 70.1, 50.0]
    save_baselines(tmp_path / "b.h5", baseline)
    assert_same(load_baselines(tmp_path / "b.h5"), baseline)
    many = stored(overrides=[override(p, seed=p) for p in range(10, 131)])
    save_baselines(tmp_path / "b.h5", many)
    assert_same(load_baselines(tmp_path / "b.h5"), many)


def test_extreme_numbers_survive(tmp_path):
    mean = np.full((1, 2), np.nextafter(0, 1))
    mean[0, 1] = np.finfo(float).max
    baseline = stored(
        window_length=3,
        channels=["x"],
        units=["1"],
        overrides=[override(mean=mean, squares=np.zeros((1, 2)), count=1)],
    )
    save_baselines(tmp_path / "b.h5", baseline)
    assert_same(load_baselines(tmp_path / "b.h5"), baseline)


def test_no_damage_goes_unnoticed(tmp_path):
    """Each byte that changes is refused, or changes nothing that is read."""
    baseline = stored(overrides=[override(), override(90.0, seed=3)])
    path = tmp_path / "b.h5"
    save_baselines(path, baseline)
    content = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for at in [*range(0, 100), *rng.integers(0, len(content), 400)]:
        damaged = bytearray(content)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            found = load_baselines(path)
        except InputError as error:
            assert str(path) in str(error)
            refused += 1
        else:
            assert_same(found, baseline)
    assert refused > 200, refused
    for left in (0, 8, 100, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:left])
        with pytest.raises(InputError):
            load_baselines(path)


def test_foreign_missing_and_newer_files(tmp_path):
    path = tmp_path / "b.h5"
    for call, words in (
        (lambda: load_baselines(path), "no such file"),
        (lambda: load_baselines(tmp_path), "folder"),
    ):
        with pytest.raises(InputError, match=words):
            call()
    path.write_text("x [um], z [um]\n1,2\n")
    with pytest.raises(InputError, match="no file of baselines"):
        load_baselines(path)
    with h5py.File(path, "w") as file:
        file["data"] = np.arange(3.0)
    with pytest.raises(InputError, match="holds no baselines"):
        load_baselines(path)
    save_baselines(path, stored())
    with h5py.File(path, "r+") as file:
        file.attrs["version"] = 2
    with pytest.raises(InputError, match=r"version 2 .* install a newer"):
        load_baselines(path)
    save_baselines(path, stored())
    with h5py.File(path, "r+") as file:
        file.attrs["window_length"] = 256
    with pytest.raises(InputError, match=r"b\.h5: damaged, .*windows of 256"):
        load_baselines(path)
    save_baselines(path, stored())
    with h5py.File(path, "r+") as file:
        file["override 1/mean"][0, 3] *= 1.0 + 1e-15
    with pytest.raises(InputError, match="damaged or changed"):
        load_baselines(path)
    with h5py.File(path, "r+") as file:
        del file.attrs["hop"]
    with pytest.raises(InputError, match="damaged"):
        load_baselines(path)


def test_a_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "b.h5"
    save_baselines(path, stored())
    before = path.read_bytes()

    def fail(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(h5py.Group, "create_dataset", fail)
    with pytest.raises(KeyboardInterrupt):
        save_baselines(path, stored(hop=1))
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["b.h5"]
    with pytest.raises(InputError, match="does not exist"):
        save_baselines(tmp_path / "no" / "b.h5", stored())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rate": 0.0}, "rate is 0"),
        ({"rate": float("nan")}, "rate is nan"),
        ({"window_length": 1}, "window_length is 1"),
        ({"window_length": 64}, "windows of 64"),
        ({"hop": 0}, "hop is 0"),
        ({"hop": 1.5}, "hop is 1.5"),
        ({"units": ("m",)}, "2 channels with 1 units"),
        ({"channels": ("x",), "units": ("m",)}, r"shape \(2, 65\), not \(1, 65\)"),
        ({"overrides": ()}, "no baseline"),
        ({"overrides": (override(), override())}, "100 % stands twice"),
    ],
)
def test_faulty_sets_are_named(changes, words):
    with pytest.raises(InputError, match=words):
        stored(**changes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"percent": 0.0}, "override is 0"),
        ({"spindle_speed": -1.0}, "spindle_speed is -1"),
        ({"count": 0}, "count is 0"),
        ({"count": 2.5}, "count is 2.5"),
        ({"mean": -np.ones((2, 65))}, "mean at override 100 %"),
        ({"squares": np.full((2, 65), np.nan)}, "squares at override 100 %"),
        ({"mean": np.ones(65)}, r"mean .* shape \(65,\)"),
        ({"squares": np.ones((2, 64))}, r"\(2, 65\) and \(2, 64\)"),
    ],
)
def test_faulty_spectra_are_named(changes, words):
    with pytest.raises(InputError, match=words):
        override(**changes)
