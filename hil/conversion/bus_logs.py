"""Read the CAN frames of a bus log: candump, Vector ASC, Vector BLF, and MF4 bus logging.

candump logs are read here, because python-can's reader takes most error frames for data frames. python-can
reads the other formats.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import re
import stat
import sys
import traceback
from collections.abc import Iterator
from enum import StrEnum
from importlib import reload
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hil.conversion.blf_containers import check_containers
from hil.conversion.frame_files import ERROR_FLAG
from hil.conversion.optional import optional_module
from hil.core.errors import HilError, RecordingError
from hil.core.frames import Frame
from hil.links.messages import MAX_EXTENDED_ID, MAX_STANDARD_ID, frame_of

if TYPE_CHECKING:
    import can

MAX_LINE_CHARACTERS = 1000
"""Longest line of a candump log. A frame has 60 characters."""
_MAX_TIME_S = 2**31
"""Largest time stamp in seconds: what a recording can hold, January 2038."""
_LINE = re.compile(
    r"\((\d{1,12})\.(\d{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(#[0-9A-Fa-f]*|R\d*|[0-9A-Fa-f]*)"
    r"(?:\s+[RT])?\s*"
)
_MAX_DATA_BYTES = 8


class LogFormat(StrEnum):
    """Format of a bus log."""

    CANDUMP = "candump"
    ASC = "asc"
    BLF = "blf"
    MF4 = "mf4"


class LoggedFrame(NamedTuple):
    """A frame of a bus log."""

    time_ns: int
    """Time stamp in ns: since 1970, or since the begin of a log without a date."""
    channel: str
    """Name or number of the bus; empty if the format has none."""
    frame: Frame | None
    """The frame; None if it is not classic CAN, or corrupt."""


def log_format(path: Path) -> LogFormat:
    """Return the format of a bus log, judged by its content. Raises RecordingError."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise RecordingError(f"{path}: not a regular file")
        with path.open("rb") as file:
            head = file.read(64)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
    text = head.lstrip().lower()
    if not text:
        raise RecordingError(f"{path}: is empty")
    if head.startswith(b"\x89MCAP"):
        raise RecordingError(f"{path}: is a recording (MCAP) already; `hil replay` and `hil export` take it")
    if head.startswith(b"LOGG"):
        return LogFormat.BLF
    if head.startswith((b"MDF ", b"UnFinMF")):
        return LogFormat.MF4
    if text.startswith(b"("):
        return LogFormat.CANDUMP
    if text.startswith((b"date ", b"base ", b"//", b"begin ")):
        return LogFormat.ASC
    raise RecordingError(
        f"{path}: is no bus log that can be read; the formats are candump -L, ASC, BLF and MF4"
    )


def logged_frames(path: Path, kind: LogFormat) -> Iterator[LoggedFrame]:
    """Yield the frames of a log in its order. Raises RecordingError where the log is damaged."""
    return _candump_frames(path) if kind is LogFormat.CANDUMP else _library_frames(path, kind)


def _candump_frames(path: Path) -> Iterator[LoggedFrame]:
    with path.open(encoding="ascii", errors="replace") as file:
        number = 0
        while line := file.readline(MAX_LINE_CHARACTERS):
            number += 1
            if not line.strip():
                continue
            match = None if len(line) == MAX_LINE_CHARACTERS else _LINE.fullmatch(line.rstrip("\n"))
            if match is None or int(match[1]) >= _MAX_TIME_S:
                shown = line.strip()[:60]
                raise RecordingError(f"{path}: line {number} is not of the format of `candump -L`: {shown!r}")
            time_ns = int(match[1]) * 1_000_000_000 + int(match[2].ljust(9, "0"))
            yield LoggedFrame(time_ns, match[3], _candump_frame(match[4], match[5]))


def _candump_frame(identifier_text: str, data_text: str) -> Frame | None:
    identifier, is_long = int(identifier_text, 16), len(identifier_text) == 8
    is_error = bool(is_long and identifier & ERROR_FLAG)
    identifier &= ~ERROR_FLAG
    if data_text.startswith("#") or identifier > (MAX_EXTENDED_ID if is_long else MAX_STANDARD_ID):
        return None  # CAN FD, or no identifier
    if data_text.startswith("R"):
        return Frame(identifier, b"", is_long, True, False)
    if len(data_text) % 2 or len(data_text) > 2 * _MAX_DATA_BYTES:
        return None
    return Frame(identifier, bytes.fromhex(data_text), is_long and not is_error, False, is_error)


def _library_frames(path: Path, kind: LogFormat) -> Iterator[LoggedFrame]:
    try:
        # The readers raise errors of many types for a damaged file.
        with _without_log("asammdf"), _reader(path, kind) as reader:
            for message in reader:
                frame = frame_of(message)
                if not 0 <= message.timestamp < _MAX_TIME_S:
                    raise ValueError(f"time stamp {message.timestamp} s")
                channel = "" if message.channel is None else str(message.channel)
                yield LoggedFrame(round(message.timestamp * 1e9), channel, frame)
    except (GeneratorExit, HilError, MemoryError):
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        _drop_reader(error)
        raise RecordingError(f"{path}: damaged, or not {kind.upper()}: {reason}") from None


def _reader(path: Path, kind: LogFormat) -> can.io.generic.MessageReader:
    import can

    if kind is LogFormat.ASC:
        return can.ASCReader(path, relative_timestamp=False)
    if kind is LogFormat.MF4:
        return _mf4_reader(path)
    check_containers(path)
    return can.BLFReader(path)


@contextlib.contextmanager
def _without_log(name: str) -> Iterator[None]:
    """Disable a library's log, which would print tracebacks for a damaged file."""
    logger = logging.getLogger(name)
    before, logger.disabled = logger.disabled, True
    try:
        yield
    finally:
        logger.disabled = before


def _mf4_reader(path: Path) -> can.io.generic.MessageReader:
    """Open an MF4 file. Raises EnvironmentLackError without asammdf."""
    from can.io import mf4

    optional_module("asammdf", "mf4", "reading MF4")
    # asammdf imports python-can, which then finds asammdf half imported and takes it for missing.
    if getattr(mf4, "asammdf", None) is None:
        reload(mf4)
    return mf4.MF4Reader(path)


def _drop_reader(error: Exception) -> None:
    """Free the reader that failed: asammdf prints a traceback when a file that it could not open is freed."""
    hook = sys.unraisablehook
    sys.unraisablehook = lambda _unraisable: None
    try:
        traceback.clear_frames(error.__traceback__)
        error.__traceback__ = error.__context__ = error.__cause__ = None
        gc.collect()
    finally:
        sys.unraisablehook = hook
