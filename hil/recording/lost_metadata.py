"""Makes the metadata ``recording`` again from the messages, when a file has lost or damaged them.

Without them, a file is no recording: they hold the difference between epoch time and monotonic time, and the
name of the bus. A call at a deadline has both times, and every frame has the name.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from mcap.records import Metadata

from hil.recording import schemas
from hil.recording.handover import MESSAGE_HEADER
from hil.recording.mcap_chunks import walk
from hil.recording.metadata_digests import DIGEST_KIND
from hil.recording.scan_result import Part, Scan

RECORDING = "recording"
_DEADLINE = struct.Struct("<4sqq")
"""Payload of ``hil_msgs/msg/Deadline``: CDR header, deadline, time of the call."""
_FRAME_ID_OFFSET = 12
"""Offset, in the payload of a frame, of the length of its frame_id."""
_MAX_BUS_BYTES = 256


def restore_recording(found: Scan, content_of: Callable[[Part], bytes]) -> bool:
    """Make the metadata ``recording`` again if they lack what a recording needs. Return True if so.

    ``content_of`` returns the uncompressed content of a part. Nothing is done without a deadline and a frame.
    """
    own = next((record.metadata for record in found.metadata if record.name == RECORDING), {})
    if own.get("epoch_offset_ns", "").isdecimal() and "bus" in own and "format_version" in own:
        return False
    topics = {channel.topic: channel.id for channel in found.channels.values()}
    epoch_offset_ns, bus = None, None
    for part in found.parts:
        content = content_of(part)
        offsets = walk(content)
        for place in offsets.get(topics.get(schemas.DEADLINE_TOPIC, -1), ())[:1]:
            *_, log_time, _ = MESSAGE_HEADER.unpack_from(content, place)
            epoch_offset_ns = log_time - _DEADLINE.unpack_from(content, place + MESSAGE_HEADER.size)[2]
        for topic in (schemas.SENT_TOPIC, schemas.RECEIVED_TOPIC):
            for place in offsets.get(topics.get(topic, -1), ())[:1]:
                bus = _frame_id(content, int(place) + MESSAGE_HEADER.size + _FRAME_ID_OFFSET)
        if epoch_offset_ns is not None and bus is not None:
            break
    else:
        return False
    restored = {
        "format_version": str(schemas.FORMAT_VERSION),
        "epoch_offset_ns": str(epoch_offset_ns),
        "bus": bus,
        "stamp_origin": "unknown",
        DIGEST_KIND: "sha256",
    }
    found.metadata = [record for record in found.metadata if record.name != RECORDING]
    found.metadata.insert(0, Metadata(RECORDING, restored))
    return True


def _frame_id(content: bytes, place: int) -> str | None:
    size = int.from_bytes(content[place : place + 4], "little")
    if not 0 < size <= _MAX_BUS_BYTES:
        return None
    return content[place + 4 : place + 3 + size].decode(errors="replace")
