"""The socket process: serves clients, and starts the server again when it ends.

The process that the daemon starts only keeps a child alive, which does the work. So whatever ends the child,
the loop never has to start a process. Both end when the loop closes its end of the pipe.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import signal
import socket
import sys
import time
import traceback

import msgspec

from hil.core.output import Severity
from hil.operation.pipe import Facts, Logged
from hil.operation.protocol import LogLine
from hil.operation.server import Server

NICENESS = 10
"""Added to the niceness of the process, so that clients do not take processor time from the loop."""
RESTART_DELAY_S = 0.2
"""Wait before the server is started again; it doubles while the server ends at once."""
MAX_RESTART_DELAY_S = 10.0
_PR_SET_PDEATHSIG = 1  # linux: linux/prctl.h


def main(arguments: list[str]) -> None:
    """Keep a server running until the loop has ended."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(NICENESS)
    listener = socket.socket(fileno=int(arguments[0]))
    pipe = socket.socket(fileno=int(arguments[1]))
    pipe.setblocking(False)
    facts = msgspec.json.decode(sys.stdin.buffer.read(), type=Facts)
    delay_s = RESTART_DELAY_S
    while True:
        began_s = time.monotonic()
        child = os.fork()
        if child == 0:
            _serve(listener, pipe, facts)
        status = _await_end(child)
        if status == 0:
            return
        is_lasting = time.monotonic() - began_s > MAX_RESTART_DELAY_S
        delay_s = RESTART_DELAY_S if is_lasting else min(2.0 * delay_s, MAX_RESTART_DELAY_S)
        _report(pipe, f"the server of the operator's socket ended ({_cause(status)}); it is started again")
        time.sleep(delay_s)  # A server that ends at once must not take the processor by restarts.


def _await_end(child: int) -> int:
    """Wait until the server ends, and return its status as waitpid(2) gives it.

    A server that is suspended is killed: no operator could stop the arm meanwhile. When it went on, it would
    pass on requests that are old.
    """
    while True:
        _, status = os.waitpid(child, os.WUNTRACED)
        if not os.WIFSTOPPED(status):
            return status
        os.kill(child, signal.SIGKILL)


def _serve(listener: socket.socket, pipe: socket.socket, facts: Facts) -> None:
    """Serve in this child process until the loop has ended, then end with status 0."""
    parent = os.getppid()
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    status = 1
    if os.getppid() == parent:
        try:
            asyncio.run(Server(listener, pipe, facts).run())
            status = 0
        except Exception:
            traceback.print_exc()
    os._exit(status)


def _report(pipe: socket.socket, text: str) -> None:
    """Send a log entry to the loop, which records and shows it."""
    line = LogLine(time.time_ns(), int(Severity.ERROR), "operation", text)
    with contextlib.suppress(OSError):
        pipe.send(msgspec.msgpack.encode(Logged(line)))


def _cause(status: int) -> str:
    code = os.waitstatus_to_exitcode(status)
    return f"killed by signal {-code}" if code < 0 else f"exit status {code}"


if __name__ == "__main__":
    main(sys.argv[1:])
