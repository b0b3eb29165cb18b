"""The file in shared memory through which a loop feeds the processes that show it.

The file lies in ``/dev/shm``, with mode 0600. It begins with what the run is, as JSON, followed by three
rings: periods, log entries, and status. The loop holds a lock on the file, so that a reader notices when the
loop was killed. A daemon puts a link to the file beside its socket, so that ``hil live`` finds it.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import mmap
import os
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from hil.core.errors import EnvironmentLackError, OperationError
from hil.live.period_record import period_bytes, period_format
from hil.live.ring import OVERHEAD_BYTES, RingReader, RingWriter, ring_bytes

FOLDER = Path("/dev/shm")
PREFIX = "hil-live-"
LINK_SUFFIX = ".live"
"""End of the name of the link to a daemon's feed; the name of its socket stands before it."""
MAGIC = b"HILLIVE1"
HISTORY_S = 600.0
"""Time in s that the ring of periods holds, and the longest time that the page shows."""
STALE_AFTER_S = 10.0
"""Age in s from which on a feed without a lock is removed. A younger one may not have its lock yet."""
LOG_ENTRIES = 512
MAX_TEXT_BYTES = 2000
"""Longest source or text of a log entry in the feed, in bytes. A longer one is cut off."""
STATUS_BYTES = 16384
"""Size of a slot for the status. Its longest texts fit in, with the names of 32 controllers."""
STATUS_SLOTS = 4
_LOG_SLOT_BYTES = 2 * MAX_TEXT_BYTES + 64
_PAGE_BYTES = 4096
_LENGTH_BYTES = 4
_OVER = slice(16, 24)
"""Place of the word that is 1 after the run has ended."""
_JSON_BEGIN = 24


class FeedLog(msgspec.Struct, frozen=True, array_like=True):
    """A log entry of the feed."""

    time_ns: int
    """Monotonic time."""
    severity: int
    source: str
    text: str


class FeedStatus(msgspec.Struct, frozen=True):
    """What is true of the run at the moment, besides its signals."""

    counts: dict[str, int]
    fault: str | None
    readiness: str
    recording: str
    """Path of the present recording; empty while nothing is recorded."""
    controllers: dict[str, str]
    """Name of the controller in use, by axis."""


@dataclass(frozen=True)
class RunInformation:
    """Facts about a run that do not change."""

    axes: list[tuple[str, str]]
    """Name and unit of each axis."""
    period_s: float
    states: list[str]
    """Names of the states of the life cycle, by number."""
    rig: str
    bus: str
    start_ns: int
    """Monotonic time of the page's second 0."""
    epoch_offset_ns: int
    """Epoch time minus monotonic time."""
    rig_text: str
    """Text of the rig file."""


FORMAT = {
    "run": RunInformation.__annotations__,
    "status": FeedStatus.__annotations__,
    "log": FeedLog.__annotations__,
    "period": period_format(),
}
"""Names and types of everything in the file, by which a reader of another version of the program sees that it
cannot read it."""


class FeedVersionError(OperationError):
    """The feed was written by a version of the program that this one cannot read."""


class FeedWriter:
    """The loop's end of the file. Creating it reserves all memory, so that writing cannot fail later."""

    def __init__(self, run: RunInformation, link: Path | None = None) -> None:
        """``link``: where a link to the file is put. Raises EnvironmentLackError without shared memory."""
        slot = OVERHEAD_BYTES + period_bytes(len(run.axes))
        slots = round(HISTORY_S / run.period_s)
        shapes = ((slot, slots), (_LOG_SLOT_BYTES, LOG_ENTRIES), (STATUS_BYTES, STATUS_SLOTS))
        description: dict[str, Any] = {"format": FORMAT, "run": asdict(run), "rings": shapes}
        text = json.dumps(description).encode()
        begin = -(-(_JSON_BEGIN + len(text)) // _PAGE_BYTES) * _PAGE_BYTES
        size = begin + sum(ring_bytes(*shape) for shape in shapes)
        self._descriptor, path = _new_file(size)
        self.path = Path(path)
        self._map = mmap.mmap(self._descriptor, size, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE)
        self._memory = memoryview(self._map)
        self._memory[8:12] = len(text).to_bytes(_LENGTH_BYTES, "little")
        self._memory[12:16] = begin.to_bytes(_LENGTH_BYTES, "little")
        self._memory[_JSON_BEGIN : _JSON_BEGIN + len(text)] = text
        writers = []
        for shape in shapes:
            end = begin + ring_bytes(*shape)
            writers.append(RingWriter(self._memory[begin:end], *shape))
            begin = end
        self.periods, self.log, self.status = writers
        self._memory[: len(MAGIC)] = MAGIC
        self._link = link
        if link is not None:
            _replace_link(link, self.path)

    def close(self) -> None:
        """Say that the run has ended, and remove the file. Processes that have it open can still read it."""
        self._memory[_OVER] = (1).to_bytes(8, "little")
        for ring in (self.periods, self.log, self.status):
            ring.release()
        self._memory.release()
        self._map.close()
        os.close(self._descriptor)
        self.path.unlink(missing_ok=True)
        if self._link is not None and _target(self._link) == self.path:
            self._link.unlink(missing_ok=True)


class FeedReader:
    """A reader's end of the file. It can change nothing: the memory is mapped for reading."""

    def __init__(self, path: Path) -> None:
        """``path``: of the file, or of the link to it. Raises OperationError."""
        try:
            target = _target(path) or path
            self._descriptor = os.open(target, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError as error:
            raise OperationError(
                f"{path}: the feed of the run cannot be opened: {error.strerror}; "
                "see whether the daemon runs: `hil status`"
            ) from None
        found = os.fstat(self._descriptor)
        if found.st_uid not in (0, os.getuid()):
            os.close(self._descriptor)
            raise OperationError(f"{path}: the feed belongs to another user, and is not read")
        if found.st_size < _PAGE_BYTES:
            os.close(self._descriptor)
            raise OperationError(f"{path}: this file is no feed of a run")
        self._map = mmap.mmap(self._descriptor, found.st_size, access=mmap.ACCESS_READ)
        self._memory = memoryview(self._map)
        if self._memory[: len(MAGIC)] != MAGIC:
            self.close()
            raise OperationError(f"{path}: this file is no feed of a run, or one of another version")
        length = int.from_bytes(self._memory[8:12], "little")
        begin = int.from_bytes(self._memory[12:16], "little")
        description = json.loads(bytes(self._memory[_JSON_BEGIN : _JSON_BEGIN + length]))
        if description.get("format") != FORMAT or set(description["run"]) != set(FORMAT["run"]):
            self.close()
            raise FeedVersionError(
                f"{path}: the feed of the run is of another version of hil than this program: "
                "start `hil live` again, or the daemon if it is older"
            )
        self.run = RunInformation(**description["run"])
        readers = []
        for slot_bytes, slots in description["rings"]:
            end = begin + ring_bytes(slot_bytes, slots)
            readers.append(RingReader(self._memory[begin:end], slot_bytes, slots))
            begin = end
        self.periods, self._log, self._status = readers

    def log(self) -> list[FeedLog]:
        """Return the log entries that are new since the last call."""
        return [msgspec.msgpack.decode(message, type=FeedLog) for message in self._log.read().messages]

    def status(self) -> FeedStatus | None:
        """Return the status, or None if it has not changed since the last call."""
        messages = self._status.read().messages
        return msgspec.msgpack.decode(messages[-1], type=FeedStatus) if messages else None

    def is_over(self) -> bool:
        """Return True if the run has ended, or the process of the loop was killed."""
        if any(self._memory[_OVER]):
            return True
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def close(self) -> None:
        """Close the file."""
        for ring in [getattr(self, name, None) for name in ("periods", "_log", "_status")]:
            if ring is not None:
                ring.release()
        self._memory.release()
        self._map.close()
        os.close(self._descriptor)


def running_feed(path: Path) -> FeedReader | None:
    """Return the feed at ``path``, as for ``FeedReader``, or None if no run writes it now.

    The link of a daemon that was killed stays, and the feed of one that begins is not complete yet.
    """
    try:
        return next_feed(path)
    except FeedVersionError:
        return None


def next_feed(path: Path) -> FeedReader | None:
    """Return the feed at ``path`` as ``running_feed`` does. Raises FeedVersionError if it is unreadable."""
    try:
        feed = FeedReader(path)
    except FeedVersionError:
        raise
    except OperationError:
        return None
    if feed.is_over():
        feed.close()
        return None
    return feed


def link_beside(socket_path: Path) -> Path:
    """Return the path of the link to the feed of the daemon with the socket ``socket_path``."""
    return socket_path.with_name(socket_path.name + LINK_SUFFIX)


def _new_file(size: int) -> tuple[int, str]:
    """Create a file of ``size`` bytes in shared memory, with a lock; return its descriptor and path."""
    _remove_stale_files()
    try:
        descriptor, path = tempfile.mkstemp(prefix=PREFIX, dir=FOLDER)
    except OSError as error:
        raise EnvironmentLackError(
            f"{FOLDER}: no shared memory for the live page: {error.strerror}"
        ) from None
    try:
        os.posix_fallocate(descriptor, 0, size)
    except OSError as error:
        os.close(descriptor)
        Path(path).unlink()
        raise EnvironmentLackError(
            f"{FOLDER}: no {size / 1e6:.0f} MB of shared memory for the live page: {error.strerror}"
        ) from None
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    return descriptor, path


def _remove_stale_files() -> None:
    """Remove the feeds of this user whose loops were killed: nobody holds their locks any more."""
    now_s = time.time()
    for path in FOLDER.glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError), path.open("rb") as file:
            found = os.fstat(file.fileno())
            if found.st_uid == os.getuid() and now_s - found.st_mtime > STALE_AFTER_S:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()


def _target(link: Path) -> Path | None:
    """Return the path that a link has, or None for a path that is no link."""
    try:
        return link.readlink()
    except OSError:
        return None


def _replace_link(link: Path, path: Path) -> None:
    """Put a link to ``path`` in the place of an older one."""
    hidden = link.with_name(f"{link.name}~")
    hidden.unlink(missing_ok=True)
    hidden.symlink_to(path)
    hidden.replace(link)
