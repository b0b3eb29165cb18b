"""Gateway and boards as two processes on SocketCAN in real time, recorded by candump as well."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from support.constants import CENTRED, PERIOD_NS, PERIOD_S
from support.patient_rig import STALE_PERIODS, WATCHDOG_S, write_patient_rig

from firmware_sim.boards.codec import Converter, data_identity, decode_values
from firmware_sim.plants.linear_plant import LinearPlant
from hil.core.board_watch import ADC_NODE, NMT_START
from hil.core.foreign_frames import OWN_IDENTIFIERS
from hil.core.output import Severity
from hil.core.rig import read_rig
from hil.core.wire import codec
from hil.recording.entries import DeadlineCalled, FrameReceived, FrameSent
from hil.recording.reader import Recording
from hil.shells.replay import verify

pytestmark = pytest.mark.vcan

LSB_V = 10 / 4096
STALL_S = 0.3
"""Time that a busy machine may add to a reaction. Tests in simulated time assert the exact limits."""
STAMPS_S = 0.001
"""Difference between two readings of the wall clock for the same instant."""
CANDUMP_LINE = re.compile(r"\((\d+\.\d+)\) \w+ ([0-9A-F]+)#([0-9A-F]*)")
TIMEOUT_S = 60
STEPS = {"vertical": (0.1, 1, "ppid"), "horizontal": (0.05, 2, "ppid"), "rotation": (0.2, 3, "ppid_rad")}
PIPE_BYTES, CANDUMP_BYTES = 1 << 20, 1 << 24
"""Buffers for a whole run. Otherwise candump loses frames if nobody reads, or if it does not get to run."""


def run_command(rig: str, path: Path, duration_s: int, **setpoints: str) -> list[str]:
    """A run of ``hil run`` with a step on every axis; ``setpoints`` replace it by axis."""
    options = ["--rig", rig, "--bus", "vcan0", "--duration", str(duration_s), "--record", str(path)]
    for axis, (size, at_s, controller) in STEPS.items():
        setpoint = setpoints.get(axis, f"step:{size}@{at_s}")
        options += ["--setpoint", f"{axis}={setpoint}", "--controller", f"{axis}={controller}"]
    return [sys.executable, "-m", "hil.cli", "run", *options]


@contextlib.contextmanager
def process(command: list[str], **options: object) -> Iterator[subprocess.Popen[str]]:
    """A process that is killed at the end of the test."""
    with subprocess.Popen(command, text=True, **options) as started:  # type: ignore[call-overload]
        try:
            yield started
        finally:
            started.kill()


@pytest.fixture
def rig(tmp_path: Path) -> str:
    """A rig file with limits that tolerate a machine that stalls."""
    return write_patient_rig(tmp_path / "rig.toml")


@pytest.fixture
def boards(rig: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "firmware_sim", "--linear", "--bus", "vcan0", "--rig", rig]
    with process(command, stdout=subprocess.PIPE) as started:
        assert started.stdout is not None
        assert "boards" in started.stdout.readline(), "firmware-sim reports when it is on the bus"
        yield started


class Candump:
    """candump on vcan0 with the kernel's time stamps."""

    def __init__(self, started: subprocess.Popen[bytes]) -> None:
        assert started.stdout is not None
        self._pipe = started.stdout.fileno()
        fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._unread = b""
        self.frames: list[tuple[float, int, bytes]] = []

    def until(
        self, wanted: Callable[[int, bytes], bool], watched: subprocess.Popen[str] | None = None
    ) -> float:
        """Read frames until one is ``wanted``, and return its time. Fail if ``watched`` ends before."""
        end = time.monotonic() + TIMEOUT_S
        while time.monotonic() < end:
            line, newline, rest = self._unread.partition(b"\n")
            if newline:
                self._unread = rest
                match = CANDUMP_LINE.match(line.decode())
                assert match, line
                frame = (float(match[1]), int(match[2], 16), bytes.fromhex(match[3]))
                self.frames.append(frame)
                if wanted(*frame[1:]):
                    return frame[0]
            elif select.select([self._pipe], [], [], 1.0)[0]:
                self._unread += os.read(self._pipe, 65536)
            else:
                assert watched is None or watched.poll() is None, "the process ended before the frame came"
        raise AssertionError("the frame did not come in time")

    def up_to_now(self) -> list[tuple[float, int, bytes]]:
        """Every frame until now."""
        subprocess.run(["cansend", "vcan0", "7FE#"], check=True)
        self.until(lambda identifier, _data: identifier == 0x7FE)
        return self.frames

    def times(self, identifier: int) -> np.ndarray:
        return np.array([time for time, frame_id, _ in self.frames if frame_id == identifier])


@pytest.fixture
def candump() -> Iterator[Candump]:
    with subprocess.Popen(
        ["stdbuf", "-oL", "candump", "-r", str(CANDUMP_BYTES), "-L", "vcan0"], stdout=subprocess.PIPE
    ) as started:
        try:
            yield Candump(started)
        finally:
            started.kill()


def is_moving(identifier: int, data: bytes) -> bool:
    """Whether a frame commands a valve away from its centre, so that the gateway is running."""
    return identifier == codec.RPDO1_DAC and any(
        abs(volts - 5.0) > 0.1 for volts in codec.decode_rpdo1_dac(data)[:3]
    )


def is_off_centre(identifier: int, data: bytes) -> bool:
    """Whether a frame commands a valve away from its centre by more than one count."""
    return identifier == codec.RPDO1_DAC and any(
        abs(volts - 5.0) > 0.0005 for volts in codec.decode_rpdo1_dac(data)[:3]
    )


def is_alarm(identifier: int, data: bytes) -> bool:
    """Whether a frame is an emergency message of the DAC board with an error."""
    return identifier == codec.EMCY_DAC and codec.decode_emcy_dac(data).error_code != 0


def largest_error_v(rig: str, candump: Candump) -> float:
    """The largest difference between the boards' samples and a plant that is driven by the recorded commands.

    The plant gets each command at the time at which candump saw it, so the machine's timing does not matter.
    Replay verifies the controllers.
    """
    plant = LinearPlant(read_rig(Path(rig).read_text(), rig))
    converter = Converter(12)
    applied = pending = CENTRED
    largest, is_started, before_s = 0.0, False, candump.times(codec.SYNC)[0]
    expected: deque[Sequence[float]] = deque()
    for at_s, identifier, data in candump.frames:
        if identifier == codec.RPDO1_DAC:
            counts = decode_values(data, True, data_identity(identifier, 2)).counts
            first, second, third = map(converter.volts, counts)
            pending = (first, second, third)
        elif identifier == codec.SYNC:
            plant.advance(round((at_s - before_s) * 1e9), applied)
            applied, before_s = pending, at_s
            if is_started:
                expected.append(plant.potentiometer_v())
        elif identifier == codec.NMT:
            is_started = is_started or data == codec.encode_nmt(NMT_START, ADC_NODE)
        elif identifier == codec.TPDO1_ADC:
            sampled = codec.decode_tpdo1_adc(data)[:3]
            largest = max(largest, *np.abs(np.subtract(sampled, expected.popleft())))
    return largest


def test_a_run_of_ten_seconds_with_three_axes(
    rig: str, boards: subprocess.Popen[str], candump: Candump, tmp_path: Path
) -> None:
    recording_path = tmp_path / "run.mcap"
    with process(run_command(rig, recording_path, 10)) as run:
        candump.until(is_moving, run)
        assert run.wait(TIMEOUT_S) == 0
    candump.up_to_now()

    recording = Recording(recording_path)
    calls = list(recording.entries())
    sent, received = (
        [(call.frame.id, call.frame.data) for call in calls if isinstance(call, kind)]
        for kind in (FrameSent, FrameReceived)
    )
    seen = [frame[1:] for frame in candump.frames]
    assert sent == [frame for frame in seen if frame[0] in OWN_IDENTIFIERS], (
        "sent frames are recorded as they were on the bus"
    )
    from_boards = [frame for frame in seen if frame[0] not in OWN_IDENTIFIERS]
    first_received = next(
        i for i in range(len(from_boards)) if from_boards[i : i + len(received)] == received
    )
    assert codec.TPDO1_ADC not in [identifier for identifier, _ in from_boards[:first_received]], (
        "no sample before the first received frame"
    )

    periods = np.diff([call.deadline_ns for call in calls if isinstance(call, DeadlineCalled)]) / PERIOD_NS
    assert np.array_equal(periods, np.maximum(np.round(periods), 1)), "deadlines are on a grid of one period"
    sync_s = candump.times(codec.SYNC)
    assert np.ptp(sync_s) / periods.sum() == pytest.approx(PERIOD_S, rel=0.01), "89.3 Hz"
    assert len(candump.times(codec.TPDO1_ADC)) > 0.95 * len(sync_s), "the board answers every SYNC"

    assert recording.complete
    assert recording.metadata["ending"]["reason"] == "completed"
    assert recording.metadata["ending"]["frames dropped by the kernel"] == "0"
    assert recording.metadata["ending"]["frames not sent"] == "0"
    assert not [key for key in recording.metadata["recorder"] if key.startswith("dropped")]
    assert largest_error_v(rig, candump) < 3 * LSB_V, "eq. (15) under the commands on the bus"
    for axis, (size, _, _) in STEPS.items():
        last_second = recording.axis(axis)[-int(1 / PERIOD_S) :]
        assert np.all(np.abs(last_second["position"] / size - 1.0) < 0.02), axis
    assert verify(recording).frames_compared == len(sent)


def test_a_killed_gateway_leaves_centred_valves(
    rig: str, boards: subprocess.Popen[str], candump: Candump, tmp_path: Path
) -> None:
    """The DAC board reports by EMCY that its watchdog has centred the valves, within the watchdog's time.

    Only an emergency after the last command counts: a stalled gateway may have caused earlier ones.
    """
    with process(run_command(rig, tmp_path / "killed.mcap", 60, vertical="sine:0.1@0.1/1")) as run:
        candump.until(is_moving, run)
        os.kill(run.pid, signal.SIGKILL)
        run.wait(TIMEOUT_S)
    frames = candump.up_to_now()
    last = max(place for place, frame in enumerate(frames) if frame[1] == codec.RPDO1_DAC)
    alarm_s = next((at_s for at_s, *frame in frames[last:] if is_alarm(*frame)), None)
    if alarm_s is None:
        alarm_s = candump.until(is_alarm)
    assert WATCHDOG_S <= alarm_s - frames[last][0] < WATCHDOG_S + PERIOD_S + STALL_S
    assert boards.poll() is None


def test_killed_boards_are_a_fault_of_the_gateway(
    rig: str, boards: subprocess.Popen[str], candump: Candump, tmp_path: Path
) -> None:
    path = tmp_path / "lost.mcap"
    with process(run_command(rig, path, 60)) as run:
        candump.until(is_moving, run)
        os.kill(boards.pid, signal.SIGKILL)
        assert run.wait(timeout=TIMEOUT_S) == 1
    recording = Recording(path)
    faults = [(now_ns, event) for now_ns, event in recording.log() if event.severity is Severity.FATAL]
    assert len(faults) == 1
    now_ns, fault = faults[0]
    assert fault.source == "adc"
    assert f"limit {STALE_PERIODS} (rig: adc.stale_after_periods)" in fault.text
    last_sample_ns = max(
        call.now_ns
        for call in recording.entries()
        if isinstance(call, FrameReceived) and call.frame.id == codec.TPDO1_ADC
    )
    assert (now_ns - last_sample_ns) * 1e-9 <= (STALE_PERIODS + 1) * PERIOD_S + STALL_S
    calls = [call for call in recording.entries() if isinstance(call, DeadlineCalled)]
    assert calls[-1].now_ns > now_ns, "the gateway went on to send centred commands"
    centred = [data for _, identifier, data in candump.up_to_now() if identifier == codec.RPDO1_DAC]
    assert codec.decode_rpdo1_dac(centred[-1])[:3] == CENTRED
    assert verify(recording).frames_compared > 0


def test_boards_of_their_own_print_a_fault_that_begins_and_refuse_what_they_cannot_see(
    rig: str, candump: Candump, tmp_path: Path
) -> None:
    command = [sys.executable, "-m", "firmware_sim", "--linear", "--bus", "vcan0", "--rig", rig]
    refused = subprocess.run([*command, "--fault", "lose:sample@armed"], capture_output=True, text=True)
    assert refused.returncode == 2
    assert "waits for the gateway's state 'armed', which no frame on the bus shows" in refused.stderr
    with process([*command, "--fault", "reset:dac@running+0.1"], stdout=subprocess.PIPE) as boards:
        assert boards.stdout is not None
        for line in boards.stdout:
            if line.startswith("join with"):
                break
        with process(run_command(rig, tmp_path / "reset.mcap", 60, vertical="sine:0.1@0.1/1")) as run:
            candump.until(is_moving, run)
            moves_s = next(at_s for at_s, *frame in candump.frames if is_off_centre(*frame))
            printed = re.fullmatch(r"\((\d+\.\d+)\) (.+) begins\n", boards.stdout.readline())
            assert printed, "one line with candump's time"
            assert printed[2] == "reset:dac@running+0.1"
            assert moves_s + 0.1 - STAMPS_S <= float(printed[1]) < moves_s + 0.1 + STALL_S
            assert run.wait(TIMEOUT_S) == 1, "a board that restarts is a fault"
