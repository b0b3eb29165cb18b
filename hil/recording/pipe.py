"""The loop's end of the pipe to the recorder process: starts it, feeds it, counts what is lost."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import subprocess
import sys
from collections import Counter, deque
from pathlib import Path

from hil.core.errors import RecordingError, RecordingExistsError
from hil.core.output import LogEntry, Severity
from hil.host.child_process import await_end
from hil.recording.handover import BATCH, BLOCK_HEADER, LOSSLESS, REAL_TIME, index_messages

PROCESS_MODULE = "hil.recording.recorder_process"
PIPE_BYTES = 1024 * 1024
BACKLOG_BYTES = 16 * 1024 * 1024
"""More than three minutes of a three-axis run; what comes on top is dropped."""
PATIENCE_S = 10.0
"""For a recorder process that takes nothing while somebody waits for it: a slow disk, not one that hangs."""


class RecorderPipe:
    """Blocks go in, in order; the recorder process writes them to ``path``.

    ``lossless``: :meth:`send` waits for the process instead of dropping. Raises RecordingError when ``path``
    exists or cannot be created.
    """

    def __init__(self, path: Path, lossless: bool) -> None:
        self.failure: str | None = None
        """Why the recorder process no longer takes anything."""
        self.dropped: Counter[int] = Counter()
        """Messages lost on this side, by channel id."""
        self.news: list[LogEntry] = []
        """What the user should read."""
        self._path = path
        self._lossless = lossless
        self._backlog: deque[bytearray] = deque()
        self._backlog_bytes = 0
        self._written_of_first = 0
        self._process = _start_process(path, lossless)
        assert self._process.stdin is not None and self._process.stderr is not None
        self._stdin, self._stderr = self._process.stdin, self._process.stderr
        os.set_blocking(self._stdin.fileno(), False)
        os.set_blocking(self._stderr.fileno(), False)
        with contextlib.suppress(OSError):  # over the user's quota: the default size does, too
            fcntl.fcntl(self._stdin, fcntl.F_SETPIPE_SZ, PIPE_BYTES)

    @property
    def has_backlog(self) -> bool:
        """Whether something waits for :meth:`push`."""
        return bool(self._backlog)

    def send(self, block: bytearray, kind: bytes) -> None:
        """Pass on ``block``, whose first ``BLOCK_HEADER.size`` bytes are room for the header."""
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

    def push(self) -> None:
        """Write as much of the backlog as the pipe takes now."""
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
            self._fail(self._last_words())

    def drain(self) -> None:
        """Wait until everything is written, or the process has taken nothing for too long."""
        while self._backlog:
            if not select.select([], [self._stdin], [], PATIENCE_S)[1]:
                self._process.kill()
                self._fail(f"the recorder process took nothing for {PATIENCE_S:g} s, and was killed")
            self.push()

    def close(self) -> None:
        """Write what is left, and wait until the file is whole; ``failure`` says when it is not."""
        self.drain()
        self._stdin.close()
        status = await_end(self._process, PATIENCE_S)
        if status is None:
            self._fail(f"the recorder process did not end within {PATIENCE_S:g} s, and was killed")
        elif status != 0:
            self._fail(self._last_words())
        self._stderr.close()

    def _drop(self, block: bytearray) -> None:
        kind, _ = BLOCK_HEADER.unpack_from(block)
        if kind != BATCH:
            return
        if not self.dropped and self.failure is None:
            text = f"{self._path}: the recorder process falls behind; messages are dropped from here on"
            self.news.append(LogEntry(Severity.WARNING, "recorder", text))
        for channel, pairs in index_messages(block, BLOCK_HEADER.size).items():
            self.dropped[channel] += len(pairs) // 2

    def _fail(self, reason: str) -> None:
        if self.failure is not None:
            return
        self.failure = reason
        self.news.append(LogEntry(Severity.ERROR, "recorder", f"{self._path}: recording ended: {reason}"))
        for block in self._backlog:
            self._drop(block)
        self._backlog.clear()
        self._backlog_bytes = 0

    def _last_words(self) -> str:
        """The last line that the recorder process wrote before it ended."""
        with contextlib.suppress(OSError):
            lines = self._stderr.read()
            if lines:
                return lines.decode(errors="replace").strip().splitlines()[-1]
        return "the recorder process was killed"


def _start_process(path: Path, lossless: bool) -> subprocess.Popen[bytes]:
    """It reads blocks from its stdin, writes the file to its stdout, and says why it failed on its stderr."""
    try:
        file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    except FileExistsError:
        raise RecordingExistsError(
            f"{path}: exists already, and a recording never overwrites: remove it or choose another name"
        ) from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be created: {error.strerror}") from None
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", PROCESS_MODULE, LOSSLESS if lossless else REAL_TIME],
            stdin=subprocess.PIPE,
            stdout=file,
            stderr=subprocess.PIPE,
            bufsize=0,
            start_new_session=True,  # Ctrl-C in the terminal is for the gateway alone
        )
    except OSError as error:
        path.unlink()
        raise RecordingError(f"{path}: the recorder process cannot be started: {error.strerror}") from None
    finally:
        os.close(file)
