"""Check the sizes of the compressed containers of a BLF file before python-can inflates them.

A few kilobytes can inflate to gigabytes, and python-can inflates each container as a whole. Layout of the
headers: as python-can reads them (can/io/blf.py).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from hil.core.errors import RecordingError

MAX_CONTAINER_BYTES = 32 * 1024 * 1024
"""Largest inflated container that is accepted. Loggers write containers of 128 kB to a few MB."""

_FILE_HEADER = struct.Struct("<4sL")
"""Signature and size of the file's header."""
_OBJECT_HEADER = struct.Struct("<4sHHLL")
"""Signature, size and version of the header; size and type of the object."""
_CONTAINER_HEADER = struct.Struct("<H6xL4x")
"""Method of compression and inflated size."""
_CONTAINER, _ZLIB = 10, 2


def check_containers(path: Path) -> None:
    """Inflate each container within bounded memory. Raises RecordingError for one that is too large.

    Damage of other kinds is left to the reader.
    """
    with path.open("rb") as file:
        head = file.read(_FILE_HEADER.size)
        if len(head) < _FILE_HEADER.size:
            return
        file.seek(_FILE_HEADER.unpack(head)[1])
        while len(head := file.read(_OBJECT_HEADER.size)) == _OBJECT_HEADER.size:
            signature, _, _, size, kind = _OBJECT_HEADER.unpack(head)
            place = file.tell() - _OBJECT_HEADER.size
            if signature != b"LOBJ" or size < _OBJECT_HEADER.size:
                return
            if kind == _CONTAINER and not _is_small(file.read(min(size, MAX_CONTAINER_BYTES))):
                raise RecordingError(
                    f"{path}: the container at byte {place} inflates to more than the limit "
                    f"{MAX_CONTAINER_BYTES // 2**20} MiB; write the log again with smaller containers"
                )
            file.seek(place + size + size % 4)


def _is_small(content: bytes) -> bool:
    if len(content) < _CONTAINER_HEADER.size or _CONTAINER_HEADER.unpack_from(content)[0] != _ZLIB:
        return True
    inflater = zlib.decompressobj()
    try:
        inflated = inflater.decompress(content[_CONTAINER_HEADER.size :], MAX_CONTAINER_BYTES)
    except zlib.error:
        return True
    return len(inflated) < MAX_CONTAINER_BYTES
