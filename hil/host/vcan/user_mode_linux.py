"""Run a command in user-mode Linux: a kernel with vcan that runs as an ordinary program, for any user.

The guest's root directory is this host's. ``init.sh`` is the guest's first process. The layout of Debian's
package ``user-mode-linux`` is assumed.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Final, Self

from hil.core.errors import EnvironmentLackError
from hil.host.vcan.console import OTHER_WAY, MachineStoppedError
from hil.host.vcan.guest_job import GuestJob
from hil.host.vcan.machine import ControlPipe, Machine, find_program
from hil.host.vcan.xsave_area import xsave_area_library

_MODULES: Final = Path("/usr/lib/uml/modules")
_PACKAGES: Final = {"linux.uml": "user-mode-linux", "modprobe": "kmod", "ip": "iproute2"}
_SIGNALS_BEFORE_KILL: Final = 3
"""Number of signals to this process at which the machine is switched off at once."""
_START_TIMEOUT_S: Final = 60.0
"""Time that a trial may take. A start takes 1 to 3 s, and several times that on a busy machine."""


def require_user_mode_linux() -> None:
    """Raise EnvironmentLackError, which says what to install, if something that it needs is missing."""
    missing = [package for program, package in _PACKAGES.items() if not find_program(program)]
    if not _MODULES.is_dir():
        missing = [*{"user-mode-linux": 0, **dict.fromkeys(missing)}]
    if missing:
        raise EnvironmentLackError(
            "there is no vcan0, it cannot be made here, and user-mode Linux is not complete. Either "
            f"{OTHER_WAY}; or, on Debian: sudo apt-get install --no-install-recommends {' '.join(missing)}"
        )
    xsave_area_library()


def run_in_user_mode_linux(command: Sequence[str]) -> int:
    """Boot, run ``command``, switch off; return its exit status as a shell gives it.

    127: the command was not found. 128 + n: signal n ended it. Its output is passed on as it is written.
    SIGINT, SIGTERM and SIGHUP to this process go to the command. Raises MachineStoppedError if the machine
    stops before the command has ended.
    """
    with GuestJob(command) as job:
        with (
            ControlPipe() as control,
            _ForwardedSignals(control) as signals,
            Machine(job, control) as machine,
        ):
            machine.pass_output(1, 2)
        status = job.status()
        if status is not None:
            return status
        if signals.last:
            return 128 + signals.last
        raise MachineStoppedError("user-mode Linux ended before the command did", job.console_text())


def try_user_mode_linux(timeout_s: float = _START_TIMEOUT_S) -> float:
    """Boot, look for ``vcan0``, switch off; return how long that took, in seconds.

    Raises MachineStoppedError if the machine does not start, does not finish within ``timeout_s`` seconds, or
    has no ``vcan0``.
    """
    start = time.monotonic()
    with GuestJob(["test", "-e", "/sys/class/net/vcan0"]) as job, Path(os.devnull).open("wb") as nowhere:
        with ControlPipe() as control, Machine(job, control) as machine:
            is_off = machine.pass_output(nowhere.fileno(), nowhere.fileno(), timeout_s)
        status = job.status()
        if status != 0:
            if not is_off:
                problem = f"user-mode Linux did not start within {timeout_s:g} s"
            elif status is None:
                problem = "user-mode Linux does not start"
            else:
                problem = "user-mode Linux starts, but cannot make vcan0"
            raise MachineStoppedError(problem, job.console_text())
    return time.monotonic() - start


class _ForwardedSignals:
    """While entered, signals to this process go to the guest's command.

    The third of them raises KeyboardInterrupt instead, which switches the machine off.
    """

    def __init__(self, control: ControlPipe) -> None:
        self._control = control
        self._count = 0
        self.last = 0
        """Number of the last signal that was forwarded; 0 if there was none."""

    def __enter__(self) -> Self:
        self._before = {
            number: signal.signal(number, self._forward)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        }
        return self

    def __exit__(self, *_error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _forward(self, number: int, _frame: FrameType | None) -> None:
        self.last = number
        self._count += 1
        if self._count == _SIGNALS_BEFORE_KILL:
            raise KeyboardInterrupt
        self._control.send(signal.Signals(number))
