"""The recorder process: reads blocks from stdin, and writes one recording after the other.

The first file is its stdout, which the gateway has created. It opens each further file when a block names it.
It finishes a file at an end block or at the end of its input. So the file is complete however the gateway
ended. It ignores the signals that end the gateway.

If a file cannot be written, it says so on stderr and reads on: the gateway may go on with another file.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import time
from pathlib import Path
from typing import Any

import msgspec

from hil.recording.handover import (
    BATCH,
    BLOCK_HEADER,
    END,
    FAILED,
    HEADER,
    LOSSLESS,
    NEXT,
    NextFile,
    Progress,
    RunHeader,
    next_header,
    progress_line,
)
from hil.recording.mcap_writer import McapWriter

INPUT, OUTPUT, REPORTS = 0, 1, 2
READ_BYTES = 1024 * 1024
FLUSH_TIMEOUT_S = 0.5
"""In real time, the chunk in progress is written when no block came for this time: the loop may be stuck."""
PROGRESS_INTERVAL_S = 1.0
"""Shortest time between two reports of progress."""

GATEWAY_ENDED = {"recorder": {"end": "the gateway ended without closing the recording"}}


def main() -> None:
    """Record until the end of the input. The exit status is 1 when the last file cannot be written."""
    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signum, signal.SIG_IGN)
    os.set_blocking(REPORTS, False)
    is_real_time = sys.argv[1] != LOSSLESS
    files = _Files(Path(sys.argv[2]))
    record(files, is_real_time)
    if files.failure is not None:
        sys.exit(files.failure)


def record(files: _Files, is_real_time: bool) -> None:
    """Write the blocks of stdin to their files until the end of the input."""
    next_progress_s = 0.0
    while True:
        if is_real_time and not select.select([INPUT], [], [], FLUSH_TIMEOUT_S)[0]:
            files.flush()
        block = _next_block(INPUT)
        if block is None:
            files.finish(GATEWAY_ENDED)
            return
        files.take(*block)
        if is_real_time and time.monotonic() >= next_progress_s:
            next_progress_s = time.monotonic() + PROGRESS_INTERVAL_S
            files.report_progress()


class _Files:
    """The present file and those after it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._output = OUTPUT
        self._header: RunHeader | None = None
        """Header of the first file."""
        self._writer: McapWriter | None = None
        """Writer of the present file; None before its header, after its end, and when it has failed."""
        self._written = 0
        self.failure: str | None = None
        """Reason why the present file is incomplete."""

    def take(self, kind: bytes, content: bytes) -> None:
        """Do what a block asks for. An error of the system ends the file, and is reported."""
        try:
            if kind == HEADER:
                self._header = msgspec.msgpack.decode(content, type=RunHeader)
                self._writer = McapWriter(self._write, self._header)
            elif kind == BATCH:
                if self._writer is not None:
                    self._writer.add_batch(content)
            elif kind == END:
                self._finish(msgspec.msgpack.decode(content, type=dict[str, dict[str, str]]))
            elif kind == NEXT:
                self._open(msgspec.msgpack.decode(content, type=NextFile))
        except OSError as error:
            self._fail(error)

    def flush(self) -> None:
        """Write the chunk in progress."""
        if self._writer is not None:
            try:
                self._writer.flush()
            except OSError as error:
                self._fail(error)

    def finish(self, metadata: dict[str, Any]) -> None:
        """Finish a file that has not been ended."""
        try:
            self._finish(metadata)
        except OSError as error:
            self._fail(error)

    def report_progress(self) -> None:
        """Say how much was written, and how much may still be."""
        with contextlib.suppress(OSError):
            system = os.fstatvfs(self._output)
            _report(progress_line(Progress(self._written, system.f_bavail * system.f_frsize)))

    def _open(self, file: NextFile) -> None:
        """Close the present file, and create the next one."""
        self._writer = None
        self._path = Path(file.path)
        self.failure = "the file could not be created"
        with contextlib.suppress(OSError):  # An earlier one may have failed to open.
            os.close(self._output)
        self._output = -1
        for path in file.remove:
            with contextlib.suppress(FileNotFoundError):
                Path(path).unlink()
        self._output = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        self._written = 0
        self.failure = None
        if self._header is not None:
            self._writer = McapWriter(self._write, next_header(self._header, file))

    def _finish(self, metadata: dict[str, Any]) -> None:
        if self._writer is not None:
            writer, self._writer = self._writer, None
            writer.finish(metadata)
            if not self._is_in_place():
                raise OSError("the file was removed or replaced while it was written")

    def _is_in_place(self) -> bool:
        """Return whether the path still names the file that is written."""
        try:
            return os.path.samestat(os.fstat(self._output), self._path.stat())
        except OSError:
            return False

    def _fail(self, error: OSError) -> None:
        self._writer = None
        self.failure = error.strerror or str(error)
        _report(f"{FAILED}{self.failure}")

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            count = os.write(self._output, rest)
            self._written += count
            rest = rest[count:]


def _report(line: str) -> None:
    """Write a line to stderr, or drop it if the gateway reads none."""
    with contextlib.suppress(OSError):
        os.write(REPORTS, f"{line}\n".encode())


def _next_block(source: int) -> tuple[bytes, bytes] | None:
    """Read the next complete block; returns kind and content, or None at the end of the input."""
    header = _read(source, BLOCK_HEADER.size)
    if len(header) < BLOCK_HEADER.size:
        return None
    kind, size = BLOCK_HEADER.unpack(header)
    content = _read(source, size)
    return (kind, content) if len(content) == size else None


def _read(source: int, size: int) -> bytes:
    """Read ``size`` bytes, or fewer at the end of the input."""
    content = os.read(source, min(size, READ_BYTES))
    while 0 < len(content) < size:
        more = os.read(source, min(size - len(content), READ_BYTES))
        if not more:
            break
        content += more
    return content


if __name__ == "__main__":
    main()
