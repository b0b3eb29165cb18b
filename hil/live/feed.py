"""The loop's end of the live page: sends every period, log entry and count to the serving process.

Sending never blocks. What the process does not take in time is dropped and counted; the page shows the count.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import struct
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from time import monotonic_ns

from hil.core.gateway import Gateway
from hil.core.output import Cycle, LogEntry
from hil.host.child_process import await_end
from hil.live.address import Address

BATCH_PERIODS = 4
"""Number of periods in one message, 45 ms: a page that is drawn 20 times a second needs no more messages."""
COUNT_PERIODS = 18
"""Number of periods from one message with counts to the next, about 0.2 s."""
CLOSE_TIMEOUT_S = 2.0
PERIODS = b"P"
"""First byte of a message with periods. A message of JSON begins with ``{``."""
MESSAGE_BYTES = 65536
"""Size of the receive buffer; messages are far smaller."""


def period_format(axes: int) -> str:
    """Return the ``struct`` format of one period.

    Deadline, wake and done in monotonic ns, state and fresh as bytes, then setpoint, position and valve
    voltage of every axis.
    """
    return f"<qqqBB{3 * axes}d"


@dataclass(frozen=True)
class RunInformation:
    """What the page says about a run."""

    axes: Sequence[tuple[str, str]]
    """Name and unit of each axis."""
    period_s: float
    states: Sequence[str]
    """Names of the states of the life cycle, by number."""
    rig: str
    bus: str
    controllers: Mapping[str, str]
    """Name of the controller file by axis."""
    recording: str
    """Path of the recording; empty if the run is not recorded."""
    start_ns: int
    """Monotonic time of the page's second 0."""
    epoch_offset_ns: int
    """Epoch time minus monotonic time."""
    rig_text: str
    """Text of the rig file."""


class LiveFeed:
    """Observer of a run that feeds the process which serves the page.

    Create it before the loop takes real-time rights or a processor of its own: the process inherits them.
    """

    def __init__(self, run: RunInformation, address: Address, operator_socket: str | None = None) -> None:
        """``operator_socket``: path of the daemon's socket if the page may operate it, else None."""
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = start_server(address, feed=theirs.fileno(), operator_socket=operator_socket)
        self._socket.setblocking(False)
        self._pack = struct.Struct(period_format(len(run.axes))).pack
        self._batch = bytearray(PERIODS)
        self._batched = 0
        self.dropped = 0
        """Number of messages that the serving process did not take."""
        self._send(json.dumps({"run": asdict(run)}).encode())

    def log(self, entry: LogEntry) -> None:
        """Send a log entry."""
        message = [monotonic_ns(), int(entry.severity), entry.source, entry.text[:2000]]
        self._send(json.dumps({"log": message}).encode())

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Send a period with its batch, and the counts from time to time."""
        signals = [value for s in cycle.axes for value in (s.setpoint, s.position, s.command_v)]
        self._batch += self._pack(
            cycle.deadline_ns, cycle.wake_ns, monotonic_ns(), cycle.state, cycle.fresh, *signals
        )
        self._batched += 1
        if self._batched >= BATCH_PERIODS:
            self._send(self._batch)
            self._batch = bytearray(PERIODS)
            self._batched = 0
        if cycle.number % COUNT_PERIODS == 0:
            self._send_counts(gateway)

    def close(self) -> None:
        """End the serving process."""
        self._socket.close()
        await_end(self._process, CLOSE_TIMEOUT_S)

    def _send_counts(self, gateway: Gateway) -> None:
        counts = {
            "missed periods": gateway.missed_periods,
            "rejected frames": gateway.rejected_frames,
            "lost samples": gateway.lost_samples,
            "error frames": gateway.error_frames,
            "messages dropped for this page": self.dropped,
        }
        message = {"counts": counts, "fault": gateway.fault_reason, "readiness": gateway.readiness}
        self._send(json.dumps(message).encode())

    def _send(self, message: bytes | bytearray) -> None:
        try:
            self._socket.send(message)
        except BlockingIOError:
            self.dropped += 1
        except OSError:  # The process has ended; the run goes on without a page.
            pass


def start_server(
    address: Address,
    *,
    feed: int | None = None,
    watched_socket: str | None = None,
    recording: str | None = None,
    operator_socket: str | None = None,
) -> subprocess.Popen[bytes]:
    """Start the process that serves the page at ``address``.

    It reads a feed from the descriptor ``feed``, watches the daemon with the socket ``watched_socket``, or
    plays ``recording``. With ``operator_socket``, the page may operate that daemon.
    """
    options = {
        "listen": address.listener.fileno(),
        "hosts": address.hosts,
        "token": address.token,
        "feed": feed,
        "watch": watched_socket,
        "operate": operator_socket,
        "recording": recording,
    }
    read_end, write_end = os.pipe()
    passed = [read_end, address.listener.fileno()]
    if feed is not None:
        passed.append(feed)
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "hil.live.server", str(read_end)],
        pass_fds=passed,
        stdin=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C in the terminal must not end the page before the run.
    )
    os.close(read_end)
    with contextlib.suppress(BrokenPipeError), os.fdopen(write_end, "w") as pipe:  # no token in an argument
        json.dump(options, pipe)
    return process
