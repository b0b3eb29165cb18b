"""Write CAN frames as candump log, Vector ASC, Vector BLF and MF4 bus log.

The text formats are written here: python-can's writers lose the content of error frames, and date the header
of an ASC file with the time of writing. Each text format has a resolution of 1 µs.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.conversion.frames import BusFrame
from hil.conversion.optional import optional_module
from hil.conversion.signal_files import save_mf4, utc
from hil.core.frames import Frame

ERROR_FLAG = 0x2000_0000
"""Flag of an error frame in the identifier of a candump log (linux/can.h: CAN_ERR_FLAG)."""
_MILLISECOND_NS = 1_000_000
_CHANNEL = 1
"""Number of the bus in the formats that count buses from 1."""


def write_candump(path: Path, frames: Iterable[BusFrame], bus: str) -> int:
    """Write the log format of ``candump -L -x``, which canplayer plays, and return the number of frames.

    Each line ends with the direction, R or T. Spaces in the name of the bus become underscores.
    """
    name = "_".join(bus.split()) or "can0"
    count = 0
    with path.open("w", encoding="utf-8", newline="\n") as file:
        for epoch_ns, frame, is_received in frames:
            count += 1
            seconds, microseconds = divmod(round(epoch_ns / 1000), 1_000_000)
            direction = "R" if is_received else "T"
            file.write(f"({seconds}.{microseconds:06d}) {name} {candump_text(frame)} {direction}\n")
    return count


def candump_text(frame: Frame) -> str:
    """Return a frame as candump logs it, such as ``190#00400040``."""
    if frame.is_error:
        identifier = f"{frame.id | ERROR_FLAG:08X}"
    else:
        identifier = f"{frame.id:08X}" if frame.is_extended else f"{frame.id:03X}"
    if frame.is_remote:
        return f"{identifier}#R{len(frame.data) or ''}"
    return f"{identifier}#{frame.data.hex().upper()}"


def write_asc(path: Path, frames: Iterable[BusFrame]) -> int:
    """Write Vector's ASC format, and return the number of frames.

    The date in the header is that of the first frame, in local time as the format demands. An error frame
    keeps its instant; the format has no place for its content.
    """
    count = 0
    with path.open("w", encoding="utf-8", newline="\n") as file:
        start_ns = 0
        for count, (epoch_ns, frame, is_received) in enumerate(frames, 1):
            if count == 1:
                start_ns = epoch_ns // _MILLISECOND_NS * _MILLISECOND_NS
                date = _asc_date(start_ns)
                file.write(f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n")
                file.write(f"Begin Triggerblock {date}\n")
            file.write(f"{(epoch_ns - start_ns) / 1e9: 9.6f} {_asc_text(frame, is_received)}\n")
        file.write("End TriggerBlock\n")
    return count


def _asc_date(epoch_ns: int) -> str:
    moment = datetime.datetime.fromtimestamp(epoch_ns // 1_000_000_000)
    return moment.strftime(f"%a %b %d %H:%M:%S.{epoch_ns // _MILLISECOND_NS % 1000:03d} %Y")


def _asc_text(frame: Frame, is_received: bool) -> str:
    if frame.is_error:
        return f"{_CHANNEL}  ErrorFrame"
    identifier = f"{frame.id:X}x" if frame.is_extended else f"{frame.id:X}"
    kind = "r" if frame.is_remote else "d"
    data = "" if frame.is_remote else frame.data.hex(" ").upper()
    direction = "Rx" if is_received else "Tx"
    return f"{_CHANNEL}  {identifier:<15} {direction:<4} {kind} {len(frame.data):x} {data}"


def write_blf(path: Path, frames: Iterable[BusFrame]) -> int:
    """Write Vector's BLF format through python-can, and return the number of frames."""
    import can

    count = 0
    with can.BLFWriter(path, channel=_CHANNEL) as writer:
        for epoch_ns, frame, is_received in frames:
            count += 1
            writer.on_message_received(
                can.Message(
                    timestamp=epoch_ns / 1e9,
                    arbitration_id=frame.id,
                    is_extended_id=frame.is_extended or frame.is_error,
                    is_remote_frame=frame.is_remote,
                    is_error_frame=frame.is_error,
                    dlc=len(frame.data),
                    data=None if frame.is_remote else frame.data,
                    is_rx=is_received,
                )
            )
    return count


def write_mf4_bus(path: Path, blocks: Iterable[npt.NDArray[Any]]) -> int:
    """Write an MF4 file with CAN bus logging, and return the number of frames.

    ``blocks`` are those of :func:`hil.conversion.frames.frame_rows`. Data, error and remote frames have a
    channel group each, as the standard demands. All frames are in memory. Raises EnvironmentLackError without
    asammdf.
    """
    asammdf = optional_module("asammdf", "mf4", "writing MF4")
    blocks = iter(blocks)
    first = next(blocks, None)
    with asammdf.MDF(version="4.10") as file:
        rows = first if first is None else np.concatenate(list(chain((first,), blocks)))
        if rows is not None:
            start_ns = int(rows["epoch_ns"][0]) // 1000 * 1000
            file.header.start_time = utc(start_ns)
            is_data = ~(rows["is_error"] | rows["is_remote"])
            _append_group(file, asammdf, "CAN_DataFrame", rows[is_data], start_ns)
            _append_group(file, asammdf, "CAN_ErrorFrame", rows[rows["is_error"]], start_ns)
            _append_group(file, asammdf, "CAN_RemoteFrame", rows[rows["is_remote"]], start_ns)
        save_mf4(file, path)
    return 0 if rows is None else len(rows)


def _append_group(file: Any, asammdf: Any, name: str, rows: npt.NDArray[Any], start_ns: int) -> None:
    """Append the channel group of one kind of frames, in the structure of ASAM MDF bus logging."""
    if len(rows) == 0:
        return
    fields: list[Any] = [
        ("BusChannel", "u1"), ("ID", "<u4"), ("IDE", "u1"), ("DLC", "u1"), ("Dir", "u1"), ("EDL", "u1"),
        ("DataLength", "u1"), ("DataBytes", "u1", (8,)),
    ]  # fmt: skip
    samples = np.zeros(len(rows), [(f"{name}.{field}", *kind) for field, *kind in fields])
    samples[f"{name}.BusChannel"] = _CHANNEL
    samples[f"{name}.ID"] = rows["id"]
    samples[f"{name}.IDE"] = rows["is_extended"]
    samples[f"{name}.DLC"] = samples[f"{name}.DataLength"] = rows["length"]
    samples[f"{name}.Dir"] = ~rows["is_received"]
    samples[f"{name}.DataBytes"] = rows["data"]
    constants = asammdf.blocks.v4_constants
    source = asammdf.blocks.v4_blocks.SourceInformation(
        source_type=constants.SOURCE_BUS, bus_type=constants.BUS_TYPE_CAN
    )
    file.append(
        asammdf.Signal(samples, (rows["epoch_ns"] - start_ns) / 1e9, name=name, source=source),
        acq_source=source,
    )
    file.groups[-1].channel_group.flags |= constants.FLAG_CG_BUS_EVENT
