"""Faults of the gateway's processes, for rigs of real processes: killed, paused, or a full disk.

They are faults of the library, in its notation: ``kill:gateway@0``, ``pause:gateway@2/0.5``,
``kill:recorder@0``, ``fill-disk@1``. A full disk is simulated by a limit of the recorder's file size: each
further write fails with an error of the operating system, as on a full disk.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Timer
from typing import Final

from firmware_sim.faults.fault_text import fault_text, parse_fault
from firmware_sim.faults.kinds import AnyFault, FillDisk, Kill, Pause, ProcessFault
from hil.core.errors import DocumentError, HilError

_RECORDER: Final = b"recorder_process"
"""Part of the recorder's command line."""


class ProcessFaults:
    """The faults of the processes of one gateway, whose process id is ``gateway``."""

    def __init__(self, gateway: int) -> None:
        self._gateway = gateway
        self._timers: list[Timer] = []
        self._ends: list[Callable[[], None]] = []

    def inject(self, fault: AnyFault | str) -> None:
        """Let a fault begin; its time counts from now.

        Raises DocumentError for a fault of another kind or with a condition, and HilError if its process does
        not run.
        """
        parsed = parse_fault(fault) if isinstance(fault, str) else fault
        text = fault_text(parsed)
        if not isinstance(parsed, ProcessFault):
            raise DocumentError(
                f"fault {text!r} acts on the simulated boards, not on the gateway's processes: give it to "
                "firmware-sim with --fault"
            )
        if parsed.when:
            raise DocumentError(
                f"fault {text!r}: a fault of a process has a time and no condition, because nothing observes "
                f"the bus for it; write a time in place of {parsed.when!r}"
            )
        if parsed.at_s == 0.0:
            self._begin(parsed)
        else:
            self._later(parsed.at_s, partial(self._begin, parsed))

    def end(self) -> None:
        """End all faults that can end, and forget those that have not begun."""
        for timer in self._timers:
            timer.cancel()
        for end in self._ends:
            end()
        self._ends.clear()

    def _begin(self, fault: ProcessFault) -> None:
        match fault:
            case Kill(process=name):
                os.kill(self._process(name), signal.SIGKILL)
                return
            case Pause(process=name):
                paused = self._process(name)
                os.kill(paused, signal.SIGSTOP)
                self._ends.append(partial(_if_it_runs, partial(os.kill, paused, signal.SIGCONT)))
            case FillDisk():
                recorder = self._process("recorder")
                before = resource.prlimit(recorder, resource.RLIMIT_FSIZE)
                resource.prlimit(recorder, resource.RLIMIT_FSIZE, (0, before[1]))
                self._ends.append(
                    partial(_if_it_runs, partial(resource.prlimit, recorder, resource.RLIMIT_FSIZE, before))
                )
        if fault.for_s is not None:
            self._later(fault.for_s, self._ends[-1])

    def _process(self, name: str) -> int:
        """Return the id of a process of the gateway. Raises HilError if it does not run."""
        if name == "gateway":
            return self._gateway
        for child in Path(f"/proc/{self._gateway}/task/{self._gateway}/children").read_text().split():
            if _RECORDER in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
        raise HilError(f"process {self._gateway}: the gateway has no recorder process; was it started?")

    def _later(self, delay_s: float, action: Callable[[], None]) -> None:
        timer = Timer(delay_s, partial(_if_it_runs, action))
        timer.daemon = True
        self._timers.append(timer)
        timer.start()


def _if_it_runs(action: Callable[[], object]) -> None:
    """Act on a process that may have ended."""
    with contextlib.suppress(OSError, HilError):
        action()
