"""Replay onto SocketCAN: to boards, to a gateway, and beside candump."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.patient_rig import write_patient_rig

from hil.cli import main
from hil.core.output import Severity
from hil.core.wire import codec
from hil.links import Link, open_link
from hil.links.link import Received
from hil.lockstep_rig import run_experiment
from hil.recording.reader import Recording

pytestmark = pytest.mark.vcan

TIMEOUT_S = 60


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> str:
    return write_patient_rig(tmp_path_factory.mktemp("rig") / "rig.toml")


@pytest.fixture(scope="module")
def recording(rig: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    run_experiment(path, duration_s=4.0, rig=rig, setpoints={"vertical": "step:0.05@0.5", "rotation": "hold"})
    return path


@pytest.fixture
def listener() -> Iterator[Link]:
    """A link with a receive queue for a whole replay."""
    with open_link("vcan0") as link:
        yield link


def heard(link: Link) -> list[Received]:
    return list(iter(lambda: link.receive(0.2), None))


def test_every_frame_is_on_the_bus_at_its_instant(
    recording: Path, listener: Link, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(recording), "--bus", "vcan0", "--from", "1", "--to", "2"]) == 0
    messages = heard(listener)
    recorded = Recording(recording).frames("received")
    chosen = recorded[(recorded.time_s >= 1.0) & (recorded.time_s < 2.0)]
    assert [message.frame.id for message in messages] == chosen.id.tolist()
    assert b"".join(message.frame.data.ljust(8, b"\0") for message in messages) == chosen.data.tobytes()
    late_s = np.array([message.stamp_ns for message in messages]) * 1e-9 - chosen.time_s
    late_s -= late_s.min()
    assert np.median(late_s) < 0.01, "a machine that stalls moves a few frames, not all that follow"
    assert "timing     error p50" in capsys.readouterr().out


def test_boards_follow_the_gateways_frames_and_end_centred(recording: Path, rig: str, listener: Link) -> None:
    command = [sys.executable, "-m", "firmware_sim", "--linear", "--bus", "vcan0", "--rig", rig]
    with subprocess.Popen(command, text=True, stdout=subprocess.PIPE) as boards:
        try:
            assert boards.stdout is not None
            assert "boards" in boards.stdout.readline()
            assert main(["replay", str(recording), "--bus", "vcan0", "--as", "gateway", "--to", "2"]) == 0
        finally:
            boards.kill()
    frames = [message.frame for message in heard(listener)]
    samples = [frame.data for frame in frames if frame.id == codec.TPDO1_ADC]
    positions_v = [codec.decode_tpdo1_adc(data).potentiometer1 for data in samples]
    assert len(samples) > 100, "the boards were started, and answer SYNC"
    assert np.ptp(positions_v) > 0.1, "the commands moved the arm"
    commands = [frame.data for frame in frames if frame.id == codec.RPDO1_DAC]
    counters = [codec.decode_rpdo1_dac(data).counter for data in commands]
    assert {(b - a) & 0xFF for a, b in pairwise(counters)} == {1}
    assert all(codec.decode_rpdo1_dac(data)[:3] == (5.0, 5.0, 5.0) for data in commands[-3:])


def test_a_gateway_runs_on_replayed_boards(recording: Path, rig: str, tmp_path: Path) -> None:
    """The boards' side answers each SYNC of a real gateway with the next recorded sample."""
    path = tmp_path / "under-test.mcap"
    hil = [sys.executable, "-m", "hil.cli"]
    replay = [*hil, "replay", str(recording), "--bus", "vcan0", "--answer-sync", "--loop", "--from", "3"]
    run = [*hil, "run", "--rig", rig, "--bus", "vcan0", "--duration", "2", "--record", str(path)]
    for axis in ("vertical", "horizontal", "rotation"):
        run += ["--setpoint", f"{axis}=hold"]
    with subprocess.Popen(replay, stdout=subprocess.PIPE, text=True) as boards:
        try:
            assert subprocess.run(run, timeout=TIMEOUT_S, check=False).returncode == 0
        finally:
            boards.terminate()
        output, _ = boards.communicate(timeout=TIMEOUT_S)
    assert "SYNCs with samples" in output
    seen = Recording(path)
    assert not [entry for _, entry in seen.log() if entry.severity is Severity.FATAL]
    assert seen.metadata["ending"]["reason"] == "completed"
    assert seen.axis("vertical").running.sum() > 150
