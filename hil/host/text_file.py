"""Read text files that a user names: rig, design, scenario, arm, controller and plant files, and tables."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from hil.core.errors import DocumentError

MAX_DOCUMENT_BYTES = 1_000_000
"""Largest TOML or JSON document. The largest shipped one has 8 kB."""
MAX_TABLE_BYTES = 50_000_000
"""Largest CSV table: about two million rows."""

_MCAP_MAGIC = b"\x89MCAP"
_OTHER_FILES = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a named pipe (FIFO)",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def read_text(
    path: Path, max_bytes: int = MAX_DOCUMENT_BYTES, for_recording: str = "`hil replay` takes it"
) -> str:
    """Return the text of a regular file of at most ``max_bytes`` bytes, without a byte order mark.

    What is not a regular file is refused before it is opened: reading it might never end. ``for_recording``
    says what to do with a recording that was named instead. Raises DocumentError.
    """
    try:
        kind = stat.S_IFMT(path.stat().st_mode)
        if kind in _OTHER_FILES:
            raise DocumentError(f"{path}: is {_OTHER_FILES[kind]}, not a regular file")
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read(max_bytes + 1 if size <= max_bytes else len(_MCAP_MAGIC))
    except OSError as error:
        raise DocumentError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:  # a null character in the name
        raise DocumentError(f"{str(path)!r}: cannot be read: {error}") from None
    if data.startswith(_MCAP_MAGIC):
        raise DocumentError(f"{path}: is a recording (MCAP), not a text; {for_recording}")
    if size > max_bytes or len(data) > max_bytes:
        raise DocumentError(
            f"{path}: has {_amount(max(size, len(data)), max_bytes)}, more than the limit "
            f"{_amount(max_bytes, max_bytes)} for such a file"
        )
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise DocumentError(f"{path}: is not text in UTF-8: byte {error.start} cannot be decoded") from None


def _amount(size: int, limit: int) -> str:
    """Return a size in the unit that suits the limit."""
    return f"{size / 1e6:g} MB" if limit >= 1_000_000 else f"{size / 1e3:g} kB"
