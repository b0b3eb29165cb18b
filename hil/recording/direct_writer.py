"""Writes a recording in this process when it is ended: for simulated time, where no deadline waits."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import msgspec

from hil.core.errors import RecordingError, RecordingExistsError
from hil.core.output import LogEntry
from hil.recording.handover import (
    BATCH,
    BLOCK_HEADER,
    END,
    HEADER,
    NextFile,
    Progress,
    RunHeader,
    next_header,
)
from hil.recording.mcap_writer import McapWriter


class DirectWriter:
    """Takes the blocks of a :class:`hil.recording.recorder.Recorder`, as a recorder process would.

    The file has the same bytes as that of a recorder process. Nothing is written before :meth:`close` or
    :meth:`next_file`, which raise RecordingExistsError if the file exists, and RecordingError if it cannot be
    written.
    """

    has_backlog = False
    failure: str | None = None
    progress: Progress | None = None

    def __init__(self, path: Path, lossless: bool = True) -> None:
        self.dropped: Counter[int] = Counter()
        self.log: list[LogEntry] = []
        self._path = path
        self._written: list[bytes] = []

    def send(self, block: bytearray, kind: bytes) -> None:
        """Add a block to the file."""
        content = bytes(block[BLOCK_HEADER.size :])
        if kind == HEADER:
            self._header = msgspec.msgpack.decode(content, type=RunHeader)
            self._writer = McapWriter(self._written.append, self._header)
        elif kind == BATCH:
            self._writer.add_batch(content)
        elif kind == END:
            self._writer.finish(msgspec.msgpack.decode(content, type=dict[str, dict[str, str]]))

    def push(self) -> None:
        """Return at once: no block waits."""

    def await_start(self) -> None:
        """Return at once: no process starts."""

    def drain(self) -> None:
        """Return at once: no block waits."""

    def read_reports(self) -> None:
        """Return at once: no process reports anything."""

    def next_file(self, path: Path, block: bytearray) -> bool:
        """Write the file, and go on with another one. Always returns True."""
        self.close()
        file = msgspec.msgpack.decode(block[BLOCK_HEADER.size :], type=NextFile)
        for name in file.remove:
            Path(name).unlink(missing_ok=True)
        self._path = path
        self._written.clear()
        self.dropped.clear()
        self._writer = McapWriter(self._written.append, next_header(self._header, file))
        return True

    def close(self) -> None:
        """Write the file."""
        try:
            with self._path.open("xb") as file:
                file.writelines(self._written)
        except FileExistsError:
            raise RecordingExistsError(
                f"{self._path}: exists already; remove it or choose another name, because nothing is "
                "overwritten"
            ) from None
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot be written: {error.strerror}") from None
