"""Boards and gateway as real processes on a virtual CAN bus."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

from hil.core.errors import HilError
from hil.host.child_process import await_end
from hil.shells.run_setup import RIG_NAME, SHIPPED
from hil.testing.process_faults import ProcessFaults

if TYPE_CHECKING:
    from firmware_sim.faults.kinds import AnyFault
    from hil.recording.reader import Recording

PATIENT_LIMITS: Final = {
    "stale_after_periods": "40",
    "watchdog_timeout_s": "0.504",
    "heartbeat_timeout_s": "2.016",
}
"""Values of the rig file that tolerate a machine which stalls for some tenths of a second."""
END_TIMEOUT_S: Final = 10.0
"""Time in which a process must end after it was asked to."""
RUN_MARGIN_S: Final = 60.0
"""Time that a run may take beyond its duration, on a busy machine."""


def patient_rig_text() -> str:
    """Return the shipped rig file with ``PATIENT_LIMITS``."""
    text = (SHIPPED / RIG_NAME).read_text(encoding="utf-8")
    for key, value in PATIENT_LIMITS.items():
        text = re.sub(rf"^{key} = [\d.]+", f"{key} = {value}", text, flags=re.MULTILINE)
    return text


def _rig_file(folder: Path, rig: str | Path | None) -> Path:
    if rig is not None:
        return Path(rig)
    path = folder / "patient-rig.toml"
    path.write_text(patient_rig_text(), encoding="utf-8")
    return path


class VcanBoards:
    """``firmware-sim`` as a process. Entering starts it; it is on the bus then. Leaving ends it."""

    def __init__(self, bus: str, folder: Path, rig: str | Path | None, arguments: Sequence[str]) -> None:
        """``rig`` is a rig file; the default is the shipped one with ``PATIENT_LIMITS``."""
        self.bus = bus
        self._command = [sys.executable, "-P", "-m", "firmware_sim", "--bus", bus]
        self._command += ["--rig", str(_rig_file(folder, rig)), *arguments]

    def __enter__(self) -> Self:
        self.process = subprocess.Popen(
            self._command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None and self.process.stderr is not None
        if not self.process.stdout.readline():  # the first line comes when it is on the bus
            raise HilError(f"firmware-sim did not start: {self.process.stderr.read().strip()}")
        return self

    def __exit__(self, *_error: object) -> None:
        self.process.terminate()
        await_end(self.process, END_TIMEOUT_S)
        for stream in (self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()


class VcanGateway:
    """``hil run`` as a process. :meth:`start` begins it; leaving ends it."""

    def __init__(self, bus: str, folder: Path, rig: str | Path | None, arguments: Sequence[str]) -> None:
        """``rig`` is a rig file; the default is the shipped one with ``PATIENT_LIMITS``."""
        self.recording_path = folder / "vcan-run.mcap"
        self._output_path = folder / "vcan-run.log"
        self._command = [sys.executable, "-P", "-m", "hil.cli", "run", "--bus", bus]
        self._command += ["--rig", str(_rig_file(folder, rig)), "--record", str(self.recording_path)]
        self._command.append("--no-plot")
        self._command += arguments
        self._process: subprocess.Popen[bytes] | None = None
        self._faults: ProcessFaults | None = None

    @property
    def was_started(self) -> bool:
        """True if :meth:`start` was called."""
        return self._process is not None

    def start(self, duration_s: float = 3600.0) -> subprocess.Popen[bytes]:
        """Begin a run of ``duration_s`` seconds of control. Returns its process. Raises HilError twice."""
        if self._process is not None:
            raise HilError("the gateway of this test was started already; a test runs it once")
        with self._output_path.open("wb") as output:
            self._process = subprocess.Popen(
                [*self._command, "--duration", str(duration_s)],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        self._faults = ProcessFaults(self._process.pid)
        return self._process

    def inject_fault(self, fault: AnyFault | str) -> None:
        """Let a fault of the gateway's processes begin, such as ``pause:gateway@0/0.5``, ``kill:recorder@2``
        or ``fill-disk@0``. Its time counts from now.

        Raises DocumentError for another kind of fault, and HilError if its process does not run.
        """
        if self._faults is None:
            raise HilError("the gateway was not started; call start first")
        self._faults.inject(fault)

    def wait(self, timeout_s: float) -> int:
        """Wait until the run is over; return its exit status. Raises HilError with its output."""
        assert self._process is not None, "the gateway was not started"
        try:
            return self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.stop()
            raise HilError(
                f"hil run did not end within {timeout_s:g} s; it printed:\n{self.output()}"
            ) from None

    def stop(self) -> None:
        """End the run as Ctrl-C does: the valves are centred and the recording is complete."""
        if self._faults is not None:
            self._faults.end()
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGINT)
            await_end(self._process, END_TIMEOUT_S)

    def recording(self) -> Recording:
        """Open the recording of the run. Raises RecordingError if there is none."""
        from hil.recording import open_recording

        return open_recording(self.recording_path)

    def output(self) -> str:
        """Return what the run has printed."""
        return self._output_path.read_text(encoding="utf-8", errors="replace")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.stop()


class VcanRig:
    """Boards and gateway as two processes on the same bus."""

    def __init__(self, boards: VcanBoards, gateway: VcanGateway) -> None:
        self.boards = boards
        self.gateway = gateway

    def run(self, duration_s: float) -> Recording:
        """Run for ``duration_s`` seconds of control; return the recording, whatever the run's ending is.

        Its ``metadata["ending"]`` has the reason. Raises HilError with the output if nothing was recorded.
        """
        self.gateway.start(duration_s)
        status = self.gateway.wait(duration_s + RUN_MARGIN_S)
        if not self.gateway.recording_path.exists():
            raise HilError(f"hil run recorded nothing, exit status {status}:\n{self.gateway.output()}")
        return self.gateway.recording()
