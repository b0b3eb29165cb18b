"""Wait for a child process to exit, and kill it after a timeout."""

from __future__ import annotations

import contextlib
import subprocess
from typing import Any


def await_end(process: subprocess.Popen[Any], timeout_s: float) -> int | None:
    """Wait until ``process`` exits and return its exit status.

    After ``timeout_s`` seconds the process is killed and the result is None. It hung, or a signal had
    stopped it.
    """
    try:
        return process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):  # it waits in the kernel, as for a disk
            process.wait(timeout_s)
        return None
