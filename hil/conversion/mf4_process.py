"""Process that reads an MF4 bus log: ``python -m hil.conversion.mf4_process FILE``.

asammdf runs native code that can crash on a damaged file, prints tracebacks, and does not free what it
opened. In a process of its own, none of that reaches the user. The process writes one record of
:data:`RECORD` for each frame to stdout, and the reason of a failure as the last line of stderr.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import BinaryIO

RECORD = struct.Struct("<qHBIB8s")
"""Time in ns, number of the bus, flags, identifier, number of data bytes, data."""
MAX_TIME_S = 2**31
"""Largest time stamp in seconds: what a recording can hold, January 2038."""
EXTENDED, REMOTE, ERROR, UNREADABLE = 1, 2, 4, 8
"""Flags of a record. UNREADABLE: the frame is not classic CAN, or corrupt; it has only time and bus."""


def main() -> None:
    """Write the frames of the file that the first argument names. The exit status is 1 after a failure."""
    try:
        write_frames(Path(sys.argv[1]), sys.stdout.buffer)
        sys.stdout.flush()
    except Exception as error:  # asammdf raises errors of many types for a damaged file
        sys.exit(f"{type(error).__name__}: {error}".splitlines()[0])


def write_frames(path: Path, output: BinaryIO) -> None:
    """Write a record for each frame of an MF4 file."""
    import can

    from hil.links.messages import frame_of

    with can.MF4Reader(path) as reader:
        for message in reader:
            if not 0 <= message.timestamp < MAX_TIME_S:
                raise ValueError(f"time stamp {message.timestamp} s")
            time_ns = round(message.timestamp * 1e9)
            bus = message.channel if isinstance(message.channel, int) else 0
            frame = frame_of(message)
            if frame is None:
                output.write(RECORD.pack(time_ns, bus, UNREADABLE, 0, 0, b""))
                continue
            flags = EXTENDED * frame.is_extended | REMOTE * frame.is_remote | ERROR * frame.is_error
            output.write(RECORD.pack(time_ns, bus, flags, frame.id, len(frame.data), frame.data))


if __name__ == "__main__":
    main()
