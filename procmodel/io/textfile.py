"""Text of a file, with a plain sentence for everything that may be in the way."""

from __future__ import annotations

import codecs
import os
from difflib import get_close_matches
from pathlib import Path

from procmodel.errors import InputError


def read_utf8(path: str | os.PathLike[str]) -> str:
    """Text of a UTF-8 file, without its byte-order mark.

    Raises
    ------
    InputError
        If the file is missing, a folder, unreadable, or not text in UTF-8.
    """
    content = read_bytes(Path(path))
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or b"\0" in content:
        raise InputError(f"{path}: this is UTF-16 or binary, not plain text: save it as CSV UTF-8")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            f"{path}, row {row}: byte 0x{content[error.start]:02x} is not UTF-8 text: "
            "save it as CSV UTF-8"
        ) from error


def read_bytes(path: Path) -> bytes:
    """Content of a file; the same errors as `read_utf8`, but for those of the text."""
    if path.is_dir():
        raise InputError(f"{path}: this is a folder: give the name of a file in it")
    try:
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file: {_name_advice(path)}") from error
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}): check the name and the permissions"
        ) from error


def _name_advice(path: Path) -> str:
    """Remedy for a missing file, with the nearest name in its folder."""
    if not path.parent.is_dir():
        return f"folder '{path.parent}' does not exist either, check the path"
    names = sorted(neighbour.name for neighbour in path.parent.iterdir() if neighbour.is_file())
    nearest = get_close_matches(path.name, names, n=1)
    return f"did you mean '{nearest[0]}'?" if nearest else "check the name and the folder"
