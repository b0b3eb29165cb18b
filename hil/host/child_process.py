"""How processes that were started here end: waited for with patience, then killed. Nothing else of them."""

from __future__ import annotations

import contextlib
import subprocess
from typing import Any


def await_end(process: subprocess.Popen[Any], patience_s: float) -> int | None:
    """Its exit status; None where it was stopped, or hung, and had to be killed after ``patience_s``."""
    try:
        return process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        with contextlib.suppress(subprocess.TimeoutExpired):  # asleep in the kernel: a disk that hangs
            process.wait(patience_s)
        return None
