"""Start the process that serves the operator's socket, and end it."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
from collections.abc import Iterator

import msgspec

from hil.host.child_process import await_end
from hil.operation.pipe import Facts, pipe

END_TIMEOUT_S = 2.0
"""Time in which the socket process must end after the loop has closed its end of the pipe."""

ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment with which numpy calculates in one thread. Several would compete with the loop for processors,
and wait for each other: the check of a large controller then took 1 s instead of 0.1 s."""


@contextlib.contextmanager
def socket_process(listener: socket.socket, facts: Facts) -> Iterator[socket.socket]:
    """Run the socket process, and give the loop's end of the pipe to it.

    ``listener`` is closed here, because it is the process' from now on: if the process ends, who connects is
    refused at once, and does not wait in the kernel's queue for an answer. Start it before the loop takes
    real-time rights, because the process inherits them.
    """
    ours, theirs = pipe()
    with ours:
        descriptors = listener.fileno(), theirs.fileno()
        with theirs:
            process = subprocess.Popen(
                # -P: modules in the working directory are not imported.
                [sys.executable, "-P", "-m", "hil.operation.server_process", *map(str, descriptors)],
                pass_fds=descriptors,
                env=os.environ | ONE_THREAD,
                stdin=subprocess.PIPE,
                start_new_session=True,  # Ctrl-C ends the daemon, which then ends this process.
            )
            listener.close()
        assert process.stdin is not None
        with contextlib.suppress(BrokenPipeError), process.stdin:
            process.stdin.write(msgspec.json.encode(facts))
        try:
            yield ours
        finally:
            ours.close()
            await_end(process, END_TIMEOUT_S)
