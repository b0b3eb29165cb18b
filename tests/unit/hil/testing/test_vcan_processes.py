"""Boards and gateway as processes: their rig file, their start, their end. The bus is UDP multicast here."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.link_contract import free_port

from hil.core.errors import HilError
from hil.core.rig import read_rig
from hil.testing.evidence import keep_recording
from hil.testing.fixtures import _keep_gateway
from hil.testing.vcan_processes import VcanBoards, VcanGateway, VcanRig, patient_rig_text

SETPOINT = ["--setpoint", "vertical=step:0.05@0.2"]


@pytest.fixture
def bus() -> str:
    return f"udp:{free_port()}"


@pytest.fixture
def gateway(bus: str, tmp_path: Path) -> Iterator[VcanGateway]:
    with VcanGateway(bus, tmp_path, None, SETPOINT) as made:
        yield made


def test_the_default_rig_file_tolerates_a_machine_that_stalls() -> None:
    rig = read_rig(patient_rig_text(), "rig.toml")
    assert rig.adc.stale_after_periods == 40
    assert (rig.dac.watchdog_timeout_s, rig.dac.heartbeat_timeout_s) == (0.504, 2.016)
    assert rig.adc.heartbeat_timeout_s == 2.016


def test_a_gateway_is_stopped_as_by_ctrl_c_and_a_failed_test_keeps_its_recording(
    bus: str, gateway: VcanGateway, tmp_path: Path
) -> None:
    with VcanBoards(bus, tmp_path, None, ["--linear"]) as boards:
        process = gateway.start()
        assert gateway.was_started
        with pytest.raises(HilError, match="the gateway of this test was started already"):
            gateway.start()
        while b"running" not in gateway._output_path.read_bytes():
            assert process.poll() is None, gateway.output()
        folder = tmp_path / "kept"
        folder.mkdir()
        lines = _keep_gateway(gateway, folder)
    assert [line.split()[0] for line in lines] == ["recording", "plot", "log"]
    assert {path.name for path in folder.iterdir()} == {"run.mcap", "run.png", "run.log"}
    run = gateway.recording()
    assert run.metadata["ending"]["reason"] == "interrupted"
    assert run.metadata["setpoints"]["vertical"] == "step:0.05@0.2"
    assert boards.process.returncode == 0


def test_a_gateway_that_was_not_started_keeps_nothing(gateway: VcanGateway, tmp_path: Path) -> None:
    assert _keep_gateway(gateway, tmp_path) == ["the gateway was not started"]


def test_wrong_arguments_are_reported_with_what_the_process_printed(bus: str, tmp_path: Path) -> None:
    with pytest.raises(HilError, match=r"firmware-sim did not start: .*nonsense"):
        VcanBoards(bus, tmp_path, None, ["--plant", "nonsense"]).__enter__()
    gateway = VcanGateway(bus, tmp_path, None, ["--setpoint", "nonsense"])
    with pytest.raises(HilError, match=r"hil run recorded nothing, exit status 2:\n.*nonsense"):
        VcanRig(VcanBoards(bus, tmp_path, None, []), gateway).run(0.1)
    assert _keep_gateway(gateway, tmp_path)[1] == "no recording: the run did not begin"


def test_a_run_that_does_not_end_is_ended(bus: str, gateway: VcanGateway, tmp_path: Path) -> None:
    gateway.start()
    with pytest.raises(HilError, match=r"hil run did not end within 0\.01 s; it printed:"):
        gateway.wait(0.01)


def test_a_recording_without_periods_has_no_plot(tmp_path: Path) -> None:
    from hil.testing.lockstep_states import build_rig

    recording = build_rig("offline", {}).save_recording(tmp_path / "run.mcap")
    assert keep_recording(recording, tmp_path, "run")[1].startswith("no plot: ")
