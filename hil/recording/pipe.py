"""The loop's end of the pipe to the recorder process: starts it, sends it blocks, counts lost messages."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import subprocess
import sys
import time
from collections import Counter, deque
from pathlib import Path

from hil.core.errors import RecordingError, RecordingExistsError
from hil.core.output import LogEntry, Severity
from hil.host.child_process import await_end
from hil.recording.handover import (
    BATCH,
    BLOCK_HEADER,
    FAILED,
    LOSSLESS,
    NEXT,
    REAL_TIME,
    Progress,
    index_messages,
    read_progress,
)

PROCESS_MODULE = "hil.recording.recorder_process"
PIPE_BYTES = 1024 * 1024
BACKLOG_BYTES = 16 * 1024 * 1024
"""Largest backlog, more than three minutes of a run with three axes. Batches beyond it are dropped."""
TIMEOUT_S = 10.0
"""Longest wait for a recorder process that reads nothing or does not end. A slow disk needs less."""


class RecorderPipe:
    """Starts a recorder process that writes to ``path``, and sends it blocks in their order.

    With ``lossless``, :meth:`send` waits for the process; otherwise it never blocks, and drops batches that
    exceed the backlog. Raises RecordingError when ``path`` exists or cannot be created.
    """

    def __init__(self, path: Path, lossless: bool) -> None:
        self.failure: str | None = None
        """Reason why the recorder process has stopped; None while it works."""
        self.dropped: Counter[int] = Counter()
        """Number of messages that were not sent to the recorder process, by channel id."""
        self.log: list[LogEntry] = []
        """Log entries about the recording itself that the user has not been shown yet."""
        self.progress: Progress | None = None
        """How far the process was when it last said so. In real time, it says so once a second."""
        self._path = path
        self._unread = b""
        """Beginning of a line of the process whose end has not been read yet."""
        self._lossless = lossless
        self._backlog: deque[bytearray] = deque()
        self._backlog_bytes = 0
        self._written_of_first = 0
        self._process = _start_process(path, lossless)
        assert self._process.stdin is not None and self._process.stderr is not None
        self._stdin, self._stderr = self._process.stdin, self._process.stderr
        os.set_blocking(self._stdin.fileno(), False)
        os.set_blocking(self._stderr.fileno(), False)
        with contextlib.suppress(OSError):  # Beyond the user's quota; the default size also works.
            fcntl.fcntl(self._stdin, fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    @property
    def has_backlog(self) -> bool:
        """True while blocks wait for :meth:`push`."""
        return bool(self._backlog)

    def send(self, block: bytearray, kind: bytes) -> None:
        """Send ``block``. Its first ``BLOCK_HEADER.size`` bytes are reserved; this method fills them in."""
        BLOCK_HEADER.pack_into(block, 0, kind, len(block) - BLOCK_HEADER.size)
        if self.failure is not None or (
            kind == BATCH and not self._lossless and self._backlog_bytes + len(block) > BACKLOG_BYTES
        ):
            self._drop(block)
            return
        self._backlog.append(block)
        self._backlog_bytes += len(block)
        self.push()
        if self._lossless:
            self.drain()

    def await_start(self) -> None:
        """Wait until the process has begun its file, for ``TIMEOUT_S`` at most. Only in real time it says so.

        While a process starts, it takes processor time and reads its code from the disk, which delays a loop
        that shares a processor with it.
        """
        end_s = time.monotonic() + TIMEOUT_S
        while self.progress is None and self.failure is None and self._process.poll() is None:
            left_s = end_s - time.monotonic()
            if left_s <= 0 or not select.select([self._stderr], [], [], left_s)[0]:
                return
            self.read_reports()

    def read_reports(self) -> None:
        """Read what the process has said since the last call, without waiting."""
        with contextlib.suppress(OSError):
            self._unread += self._stderr.read() or b""
        *lines, self._unread = self._unread.split(b"\n")
        for line in lines:
            text = line.decode(errors="replace")
            if text.startswith(FAILED):
                self._fail(text.removeprefix(FAILED))
            else:
                self.progress = read_progress(text) or self.progress

    def next_file(self, path: Path, block: bytearray) -> bool:
        """Send the block that opens the file ``path``. Return False if the process has ended."""
        if self._process.poll() is not None:
            return False
        self.read_reports()
        self.failure = self.progress = None
        self.dropped.clear()
        self._path = path
        self.send(block, NEXT)
        return True

    def push(self) -> None:
        """Write as much of the backlog as the pipe accepts without blocking."""
        try:
            while self._backlog:
                first = self._backlog[0]
                self._written_of_first += os.write(
                    self._stdin.fileno(), memoryview(first)[self._written_of_first :]
                )
                if self._written_of_first == len(first):
                    self._backlog.popleft()
                    self._backlog_bytes -= len(first)
                    self._written_of_first = 0
        except BlockingIOError:
            pass
        except BrokenPipeError:
            self._fail(self._reason_of_end())

    def drain(self) -> None:
        """Wait until the backlog is written; kill a process that reads nothing for ``TIMEOUT_S``."""
        while self._backlog:
            if not select.select([], [self._stdin], [], TIMEOUT_S)[1]:
                self._process.kill()
                self._fail(f"the recorder process read nothing for {TIMEOUT_S:g} s and was killed")
            self.push()

    def close(self) -> None:
        """Write the backlog and wait for the process to end; ``failure`` is set if the file is incomplete."""
        self.drain()
        self._stdin.close()
        status = await_end(self._process, TIMEOUT_S)
        if status is None:
            self._fail(f"the recorder process did not end within {TIMEOUT_S:g} s and was killed")
        elif status != 0:
            self._fail(self._reason_of_end())
        self._stderr.close()

    def _drop(self, block: bytearray) -> None:
        kind, _ = BLOCK_HEADER.unpack_from(block)
        if kind != BATCH:
            return
        if not self.dropped and self.failure is None:
            text = f"{self._path}: the recorder process is too slow; messages are dropped from here on"
            self.log.append(LogEntry(Severity.WARNING, "recorder", text))
        for channel, pairs in index_messages(block, BLOCK_HEADER.size).items():
            self.dropped[channel] += len(pairs) // 2

    def _fail(self, reason: str) -> None:
        if self.failure is not None:
            return
        self.failure = reason
        self.log.append(LogEntry(Severity.ERROR, "recorder", f"{self._path}: recording ended: {reason}"))
        for block in self._backlog:
            self._drop(block)
        self._backlog.clear()
        self._backlog_bytes = 0

    def _reason_of_end(self) -> str:
        """Return the last line that the recorder process wrote to stderr, besides its progress."""
        with contextlib.suppress(OSError):
            self._unread += self._stderr.read() or b""
        lines = self._unread.decode(errors="replace").split("\n")
        reasons = [line for line in lines if line.strip() and read_progress(line) is None]
        return reasons[-1].removeprefix(FAILED) if reasons else "the recorder process was killed"


def _start_process(path: Path, lossless: bool) -> subprocess.Popen[bytes]:
    """Start the process with ``path`` as its stdout. Raises RecordingError."""
    try:
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        raise RecordingExistsError(
            f"{path}: exists already; a recording overwrites no file: remove it or choose another name"
        ) from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be created: {error.strerror}") from None
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", PROCESS_MODULE, LOSSLESS if lossless else REAL_TIME, str(path)],
            stdin=subprocess.PIPE,
            stdout=file,
            stderr=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,  # Ctrl-C in the terminal must not end the recorder.
        )
    except OSError as error:
        path.unlink()
        raise RecordingError(f"{path}: the recorder process cannot be started: {error.strerror}") from None
    finally:
        os.close(file)
