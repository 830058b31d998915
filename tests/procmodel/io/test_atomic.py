"""Files that appear complete or not at all."""

import os
import stat

import pytest

from procmodel.errors import InputError
from procmodel.io import atomic, write_bytes, write_text, writing


def test_text_is_written_as_it_is(tmp_path):
    path = tmp_path / "plan.csv"
    write_text(path, "\u00b5m\r\nend\n")
    assert path.read_bytes() == "\u00b5m\r\nend\n".encode()
    write_bytes(path, b"\0new")
    assert path.read_bytes() == b"\0new"
    assert os.listdir(tmp_path) == ["plan.csv"]


def test_draft_lies_beside_the_file_with_its_suffix(tmp_path):
    with writing(tmp_path / "figure.png") as draft:
        assert draft.parent == tmp_path
        assert draft.suffix == ".png"
        assert not (tmp_path / "figure.png").exists()
        draft.write_bytes(b"picture")
    assert (tmp_path / "figure.png").read_bytes() == b"picture"


@pytest.mark.parametrize("interruption", [RuntimeError, KeyboardInterrupt])
def test_a_failure_leaves_the_old_file_and_no_draft(tmp_path, interruption):
    path = tmp_path / "plan.csv"
    path.write_text("old")
    with pytest.raises(interruption), writing(path) as draft:
        draft.write_text("half")
        raise interruption
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["plan.csv"]


@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o077, 0o600), (0o002, 0o664)])
def test_new_files_follow_the_umask(tmp_path, umask, mode):
    before = os.umask(umask)
    try:
        write_text(tmp_path / "plan.csv", "text")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "plan.csv").stat().st_mode) == mode


def test_replaced_files_keep_their_permissions(tmp_path):
    path = tmp_path / "plan.csv"
    path.touch()
    path.chmod(0o640)
    write_text(path, "text")
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_link_keeps_pointing_to_its_file(tmp_path):
    (tmp_path / "real.csv").write_text("old")
    link = tmp_path / "link.csv"
    link.symlink_to("real.csv")
    write_text(link, "new")
    assert link.is_symlink()
    assert (tmp_path / "real.csv").read_text() == "new"


def test_long_names(tmp_path):
    path = tmp_path / ("n" * 250 + ".csv")
    write_text(path, "text")
    assert path.read_text() == "text"


def test_folder_as_target(tmp_path):
    with pytest.raises(InputError, match="this is a folder: give the name of a file in it"):
        write_text(tmp_path, "text")


def test_device_as_target():
    with pytest.raises(InputError, match=r"/dev/null: this is a device .* ordinary file"):
        write_text("/dev/null", "text")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


def test_missing_folder(tmp_path):
    with pytest.raises(InputError, match=r"plan\.csv: folder '.*new' does not exist: create it"):
        write_text(tmp_path / "new" / "plan.csv", "text")


def test_folder_that_cannot_be_written(tmp_path, monkeypatch):
    # Refused by hand, as permissions do not bind the administrator who may run the tests.
    def refuse(*arguments):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(atomic.os, "open", refuse)
    with pytest.raises(InputError, match=r"plan\.csv: cannot write in folder .*Permission denied"):
        write_text(tmp_path / "plan.csv", "text")


def test_protected_file(tmp_path, monkeypatch):
    path = tmp_path / "plan.csv"
    path.write_text("old")
    monkeypatch.setattr(atomic.os, "access", lambda *arguments: False)
    with pytest.raises(InputError, match=r"plan\.csv: this file is write-protected: choose"):
        write_text(path, "text")
