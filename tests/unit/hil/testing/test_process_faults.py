"""Faults of processes, on processes that stand for the gateway and its recorder."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.recorded_runs import wait_until

from firmware_sim.event_input import parse_present_event
from hil.core.errors import DocumentError, HilError
from hil.lockstep_rig import LockstepRig
from hil.testing.process_faults import ProcessFaults
from hil.testing.vcan_processes import VcanGateway

WRITER = """
import sys
for line in sys.stdin:
    try:
        with open(sys.argv[2], "ab", buffering=0) as file:
            file.write(line.encode())
        print("written", flush=True)
    except OSError as error:
        print(error.strerror, flush=True)
"""


class Writer:
    """A child of this process that writes what it is given, as the recorder does."""

    def __init__(self, path: Path) -> None:
        command = [sys.executable, "-c", WRITER, "recorder_process", str(path)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def write(self) -> str:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write("line\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[Writer]:
    made = Writer(tmp_path / "file")
    yield made
    made.process.kill()
    made.process.communicate()


@pytest.fixture
def faults() -> Iterator[ProcessFaults]:
    """Faults of this process, of which the writer is the recorder."""
    made = ProcessFaults(os.getpid())
    yield made
    made.end()


def state(process: subprocess.Popen[str]) -> str:
    return Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_a_full_disk_refuses_every_further_byte_until_it_ends(writer: Writer, faults: ProcessFaults) -> None:
    assert writer.write() == "written"
    faults.inject("fill-disk@0")
    assert [writer.write(), writer.write()] == ["File too large"] * 2
    faults.end()
    assert writer.write() == "written"


def test_the_recorder_is_killed(writer: Writer, faults: ProcessFaults) -> None:
    faults.inject("kill:recorder@0.01")
    assert writer.process.wait(20) == -9
    faults.end()


def test_a_process_is_paused_for_a_time(writer: Writer, faults: ProcessFaults) -> None:
    gateway = ProcessFaults(writer.process.pid)
    gateway.inject("pause:gateway@0")
    wait_until(lambda: state(writer.process) == "T", "the process pauses")
    gateway.end()
    wait_until(lambda: state(writer.process) != "T", "the process goes on")
    gateway.inject("pause:gateway@0/0.01")
    assert writer.write() == "written"
    gateway.inject("kill:gateway@0")
    assert writer.process.wait(20) == -9
    gateway.end()


@pytest.mark.parametrize(
    ("fault", "error", "words"),
    [
        ("lose:sample@0", DocumentError, "acts on the simulated boards, not on the gateway's processes"),
        ("pause:gateway@running", DocumentError, "has a time and no condition"),
        ("kill:recorder@0", HilError, "the gateway has no recorder process"),
        ("kill:boards@0", DocumentError, "process is 'boards', but must be 'gateway' or 'recorder'"),
    ],
)
def test_faults_that_cannot_begin_are_explained(
    faults: ProcessFaults, fault: str, error: type[HilError], words: str
) -> None:
    with pytest.raises(error, match=words):
        faults.inject(fault)


def test_a_gateway_that_was_not_started_has_no_faults(tmp_path: Path) -> None:
    with pytest.raises(HilError, match="the gateway was not started; call start first"):
        VcanGateway("udp:1", tmp_path, None, []).inject_fault("kill:gateway@0")


@pytest.mark.parametrize("fault", ["kill:gateway@0", "pause:gateway@1/0.5", "fill-disk@0"])
def test_simulated_rigs_refuse_them_and_name_what_to_use(fault: str) -> None:
    words = "acts on a process of the gateway, and a simulated rig has none"
    with pytest.raises(DocumentError, match=words):
        LockstepRig(faults=[fault])
    with pytest.raises(DocumentError, match=words) as caught:
        parse_present_event(fault)
    assert "unplug is what the boards see of a killed gateway, and stall:S of a paused one" in str(
        caught.value
    )
