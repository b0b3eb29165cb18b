"""Read the CAN frames of a bus log: candump, Vector ASC, Vector BLF, and MF4 bus logging.

candump logs are read here, because python-can's reader takes most error frames for data frames. python-can
reads the other formats.
"""

from __future__ import annotations

import re
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from hil.conversion import mf4_process
from hil.conversion.blf_containers import check_containers
from hil.conversion.frame_files import ERROR_FLAG
from hil.conversion.optional import optional_module
from hil.core.errors import RecordingError
from hil.core.frames import Frame
from hil.links.messages import MAX_EXTENDED_ID, MAX_STANDARD_ID, frame_of

MAX_LINE_CHARACTERS = 1000
"""Longest line of a candump log. A frame has 60 characters."""
_LINE = re.compile(
    r"\((\d{1,12})\.(\d{1,9})\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(#[0-9A-Fa-f]*|R\d*|[0-9A-Fa-f]*)"
    r"(?:\s+[RT])?\s*"
)
_MAX_DATA_BYTES = 8
_RECORDS_AT_ONCE = 4096


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
    if kind is LogFormat.CANDUMP:
        return _candump_frames(path)
    return _mf4_frames(path) if kind is LogFormat.MF4 else _library_frames(path, kind)


def _candump_frames(path: Path) -> Iterator[LoggedFrame]:
    with path.open(encoding="ascii", errors="replace") as file:
        number = 0
        while line := file.readline(MAX_LINE_CHARACTERS):
            number += 1
            if not line.strip():
                continue
            match = None if len(line) == MAX_LINE_CHARACTERS else _LINE.fullmatch(line.rstrip("\n"))
            if match is None or int(match[1]) >= mf4_process.MAX_TIME_S:
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
        length = int(data_text[1:] or 0)
        return None if length > _MAX_DATA_BYTES else Frame(identifier, bytes(length), is_long, True, False)
    if len(data_text) % 2 or len(data_text) > 2 * _MAX_DATA_BYTES:
        return None
    return Frame(identifier, bytes.fromhex(data_text), is_long and not is_error, False, is_error)


def _library_frames(path: Path, kind: LogFormat) -> Iterator[LoggedFrame]:
    import can

    try:
        # The readers raise errors of many types for a damaged file.
        if kind is LogFormat.BLF:
            check_containers(path)
            reader: can.io.generic.MessageReader = can.BLFReader(path)
        else:
            reader = can.ASCReader(path, relative_timestamp=False)
        with reader:
            for message in reader:
                if not 0 <= message.timestamp < mf4_process.MAX_TIME_S:
                    raise ValueError(f"time stamp {message.timestamp} s")
                channel = "" if message.channel is None else str(message.channel)
                yield LoggedFrame(round(message.timestamp * 1e9), channel, frame_of(message))
    except (GeneratorExit, RecordingError, MemoryError):
        raise
    except Exception as error:
        reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        raise RecordingError(f"{path}: damaged, or not {kind.upper()}: {reason}") from None


def _mf4_frames(path: Path) -> Iterator[LoggedFrame]:
    """Read an MF4 file in a process of its own; :mod:`hil.conversion.mf4_process` says why."""
    if find_spec("asammdf") is None:
        optional_module("asammdf", "mf4", "reading MF4")
    # -P: modules in the working directory are not imported.
    command = [sys.executable, "-P", "-m", mf4_process.__name__, str(path.absolute())]
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors) as reader,
    ):
        assert reader.stdout is not None
        try:
            while records := reader.stdout.read(mf4_process.RECORD.size * _RECORDS_AT_ONCE):
                whole = len(records) - len(records) % mf4_process.RECORD.size  # it may end within a record
                yield from map(_mf4_frame, mf4_process.RECORD.iter_unpack(records[:whole]))
        except BaseException:
            reader.kill()
            raise
        status = reader.wait()
        if status != 0:
            errors.seek(0)
            lines = errors.read().decode(errors="replace").splitlines()
            reason = lines[-1] if lines and status > 0 else "the library that reads it crashed"
            raise RecordingError(f"{path}: damaged, or not MF4: {reason}")


def _mf4_frame(values: tuple[int, int, int, int, int, bytes]) -> LoggedFrame:
    time_ns, bus, flags, identifier, length, data = values
    frame = Frame(
        identifier,
        data[:length],
        bool(flags & mf4_process.EXTENDED),
        bool(flags & mf4_process.REMOTE),
        bool(flags & mf4_process.ERROR),
    )
    return LoggedFrame(time_ns, str(bus), None if flags & mf4_process.UNREADABLE else frame)
