"""Files that appear complete or not at all."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from procmodel.errors import InputError


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Write a file beside its final place and move it there once it is complete.

    Parameters
    ----------
    path : path-like
        Where the file shall stand. A file already there is replaced, and keeps its permissions.

    Yields
    ------
    pathlib.Path
        An empty file in the same folder and with the same suffix, to be written by name. If the
        block ends well it takes the place of `path`; if it raises, it is removed and `path`
        stays as it was.

    Raises
    ------
    InputError
        If `path` is a folder or a device, or its folder is missing or cannot be written to.

    Examples
    --------
    >>> with writing("figure.png") as draft:  # doctest: +SKIP
    ...     figure.savefig(draft)
    """
    target = check_target(Path(path))
    draft = _create_beside(target)
    try:
        yield draft
        _flush_to_disk(draft)
        if target.exists():
            draft.chmod(stat.S_IMODE(target.stat().st_mode))
        draft.replace(target)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write `text` as UTF-8 to `path`, completely or not at all; see `writing` for the errors."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: str | os.PathLike[str], content: bytes) -> None:
    """Write `content` to `path`, completely or not at all; see `writing` for the errors."""
    with writing(path) as draft:
        draft.write_bytes(content)


def check_target(path: str | os.PathLike[str]) -> Path:
    """Check that a file may be written to `path`, before the work that it is to hold.

    Parameters
    ----------
    path : path-like
        Where the file is to stand.

    Returns
    -------
    Path
        The place of the file itself, behind any links.

    Raises
    ------
    InputError
        If a folder, device or write-protected file stands there, or the folder is missing.
    """
    path = Path(path)
    # A link keeps pointing where it did: its target is what gets replaced.
    target = path.resolve() if path.is_symlink() else path
    if target.is_dir():
        raise InputError(f"{path}: this is a folder: give the name of a file in it")
    if target.exists() and not target.is_file():
        raise InputError(f"{path}: this is a device or a pipe: give the name of an ordinary file")
    if target.exists() and not os.access(target, os.W_OK):
        # Moving another file over it would succeed, against the wish its owner has expressed.
        raise InputError(
            f"{path}: this file is write-protected: choose another name or unprotect it"
        )
    if not target.parent.is_dir():
        raise InputError(f"{path}: folder '{target.parent}' does not exist: create it first")
    return target


def _create_beside(target: Path) -> Path:
    """Empty file with a free name in the folder of `target`."""
    # The stem is cut so that the longer name stays within what file systems allow.
    draft = target.with_name(f".{target.stem[:40]}-{os.urandom(8).hex()}{target.suffix}")
    try:
        # Unlike the files of `tempfile`, which only their owner may read, a file opened this way
        # gets the permissions that the user's umask gives to any new file.
        os.close(os.open(draft, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise InputError(
            f"{target}: cannot write in folder '{target.parent}' ({error.strerror}): "
            "choose a folder that you may write to"
        ) from error
    return draft


def _flush_to_disk(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())
