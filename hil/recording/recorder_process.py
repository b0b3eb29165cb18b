"""The recorder process: reads blocks from stdin, writes the recording to stdout and errors to stderr.

It finishes the file at an end block or at the end of its input. So the file is complete however the gateway
ended. It ignores the signals that end the gateway.
"""

from __future__ import annotations

import os
import select
import signal
import sys

import msgspec

from hil.recording.handover import BATCH, BLOCK_HEADER, HEADER, LOSSLESS, RunHeader
from hil.recording.mcap_writer import McapWriter

INPUT, OUTPUT = 0, 1
READ_BYTES = 1024 * 1024
FLUSH_TIMEOUT_S = 0.5
"""In real time, the chunk in progress is written when no block came for this time: the loop may be stuck."""

GATEWAY_ENDED = {"recorder": {"end": "the gateway ended without closing the recording"}}


def main() -> None:
    """Record until the end of the input. The exit status is 1 when the file cannot be written."""
    for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(signum, signal.SIG_IGN)
    try:
        record(flush_on_timeout=sys.argv[1] != LOSSLESS)
    except OSError as error:
        sys.exit(error.strerror)


def record(flush_on_timeout: bool) -> None:
    """Write the blocks of stdin to the file until the last one. Raises OSError when writing fails."""
    block = _next_block(INPUT)
    if block is None:
        return
    assert block[0] == HEADER
    file = McapWriter(_write, msgspec.msgpack.decode(block[1], type=RunHeader))
    while True:
        if flush_on_timeout and not select.select([INPUT], [], [], FLUSH_TIMEOUT_S)[0]:
            file.flush()
        block = _next_block(INPUT)
        if block is None:
            file.finish(GATEWAY_ENDED)
            return
        kind, content = block
        if kind == BATCH:
            file.add_batch(content)
        else:
            file.finish(msgspec.msgpack.decode(content, type=dict[str, dict[str, str]]))
            return


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


def _write(data: bytes) -> None:
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(OUTPUT, rest) :]


if __name__ == "__main__":
    main()
