"""The loop's side of what people see: a status a few times a second and every event, to another process.

Terminals stall (a slow ssh, Ctrl-S); the loop must not. So nothing is printed here: messages go over a socket
that drops what does not fit, to ``hil.cli.watch``, which prints.
"""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
from collections.abc import Sequence

from hil.events import Cycle, Event
from hil.gateway import Gateway

STATUS_PERIODS = 18
"""A status every so many periods, about 0.2 s."""
CLOSE_TIMEOUT_S = 2.0


class Display:
    """An audience in a process of its own. Close it before printing anything else."""

    def __init__(self, axes: Sequence[tuple[str, str]], duration_s: float) -> None:
        """``axes`` are (name, unit)."""
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "hil.cli.watch", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
            )
        self._socket.setblocking(False)
        self._worst_lateness_ns = 0
        self._send({"axes": axes, "duration_s": duration_s})

    def event(self, event: Event) -> None:
        """Show an event."""
        self._send({"event": [int(event.severity), event.source, event.text]})

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        """Show a status now and then."""
        self._worst_lateness_ns = max(self._worst_lateness_ns, cycle.wake_ns - cycle.deadline_ns)
        if cycle.number % STATUS_PERIODS:
            return
        self._send(
            {
                "state": gateway.state.name.lower(),
                "period": cycle.number,
                "axes": [[s.setpoint, s.position, s.command_v] for s in cycle.axes],
                "lateness_ms": self._worst_lateness_ns / 1e6,
                "missed": gateway.missed_periods,
                "rejected": gateway.rejected_frames,
            }
        )
        self._worst_lateness_ns = 0

    def close(self) -> None:
        """Let the display finish what it has, and wait for it."""
        self._socket.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(CLOSE_TIMEOUT_S)

    def _send(self, message: dict[str, object]) -> None:
        with contextlib.suppress(OSError):  # full, or the display has gone: the loop goes on
            self._socket.send(json.dumps(message).encode())
