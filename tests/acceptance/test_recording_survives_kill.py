"""kill -9 of a run in real time: at most one second is lost, and a batch if only the gateway is killed.

The test listens on the bus and counts the periods by their SYNC frames. So it knows what the gateway had
done.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from support.patient_rig import write_patient_rig
from support.recorded_runs import PERIOD_S, children_of

from hil.core.errors import RecordingError
from hil.core.wire import codec
from hil.links import Link, open_link
from hil.recording.reader import Recording

pytestmark = pytest.mark.real_time

TIMEOUT_S = 20.0


class Run:
    """``hil run`` and the boards as processes of their own, and a link that receives all their frames."""

    def __init__(self, gateway: subprocess.Popen[bytes], boards: subprocess.Popen[bytes], link: Link) -> None:
        self.gateway = gateway
        self.boards = boards
        self._link = link
        self._periods = 0

    def until_period(self, number: int) -> None:
        """Wait until ``number`` periods have begun."""
        while self._periods < number:
            assert self._receive(TIMEOUT_S), f"no frame came within {TIMEOUT_S} s"

    def periods_after_death(self) -> int:
        """Return the number of periods that had begun, including those whose frames are still on the bus.

        A period counts with its SYNC. A late loop sends none in some periods.
        """
        while self._receive(0.0):
            pass
        return self._periods

    def _receive(self, timeout_s: float) -> bool:
        received = self._link.receive(timeout_s)
        if received is not None and received.frame.id == codec.SYNC:
            self._periods += 1
        return received is not None


@contextmanager
def running(path: Path) -> Iterator[Run]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        bus = f"udp:{probe.getsockname()[1]}"
    rig = write_patient_rig(path.with_name("rig.toml"))
    on_bus = ["--rig", rig, "--bus", bus]
    with open_link(bus) as link:
        command = [sys.executable, "-m", "firmware_sim", *on_bus]
        boards = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        command = [
            sys.executable,
            "-m",
            "hil.cli",
            "run",
            *on_bus,
            "--duration",
            "600",
            "--record",
            str(path),
        ]
        gateway = subprocess.Popen(command)
        try:
            yield Run(gateway, boards, link)
        finally:
            for process in (gateway, boards):
                process.kill()
                process.wait()


def recorder_of(gateway: subprocess.Popen[bytes]) -> int:
    """Return the process id of the gateway's recorder."""
    (recorder,) = (
        child
        for child in children_of(gateway.pid)
        if b"recorder_process" in Path(f"/proc/{child}/cmdline").read_bytes()
    )
    return recorder


def wait_for_end_of(process_id: int) -> None:
    """Wait until a process has ended that is not a child of this one."""
    try:
        handle = os.pidfd_open(process_id)
    except ProcessLookupError:
        return
    assert select.select([handle], [], [], 20.0)[0], "the recorder process did not end"
    os.close(handle)


@pytest.mark.parametrize("kill_at_period", [40, 200, 217, 234])
def test_kill_of_every_process_loses_at_most_one_second(tmp_path: Path, kill_at_period: int) -> None:
    path = tmp_path / "run.mcap"
    with running(path) as run:
        run.until_period(kill_at_period)
        recorder_process = recorder_of(run.gateway)
        for process_id in (recorder_process, run.gateway.pid, run.boards.pid):
            os.kill(process_id, signal.SIGKILL)
        wait_for_end_of(recorder_process)
        run.gateway.wait()
        begun = run.periods_after_death()
    try:
        recording = Recording(path)
    except RecordingError as error:  # the first chunk was still on its way
        assert "cut off before its first period" in str(error)
        assert begun * PERIOD_S <= 1.0
        return
    assert not recording.complete
    assert np.all(np.diff(recording.timing()["number"]) > 0)
    recorded = len(recording.frames("sent", codec.SYNC))
    assert 0 <= (begun - recorded) * PERIOD_S <= 1.0
    assert recording.attachments.keys() >= {"rig.toml", "arm.dbc", "controllers/vertical.json"}
    assert messages_read_by_mcap(path) == sum(recording.counts.values())


def messages_read_by_mcap(path: Path) -> int:
    """Return the number of messages that mcap's reader finds before it fails at the torn end."""
    count = 0
    with path.open("rb") as stream:
        try:
            for _ in NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False):
                count += 1
        except (McapError, struct.error):
            pass
    return count


def test_kill_of_the_gateway_alone_leaves_a_complete_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with running(path) as run:
        run.until_period(100)
        recorder_process = recorder_of(run.gateway)
        os.kill(run.gateway.pid, signal.SIGKILL)
        run.gateway.wait()
        wait_for_end_of(recorder_process)
        begun = run.periods_after_death()
    recording = Recording(path)
    assert recording.complete
    assert "without closing" in recording.metadata["recorder"]["end"]
    assert 0 <= (begun - len(recording.frames("sent", codec.SYNC))) * PERIOD_S <= 0.3
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(recording.counts.values())
