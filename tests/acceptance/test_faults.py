"""Faults as options of ``hil run``: the same bytes in every lockstep run, the same effect in real time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.constants import PERIOD_S

from hil.cli import main
from hil.recording.reader import Recording
from hil.recording.recorder import FAULT_SOURCE, FAULTS_BEGUN
from hil.shells.replay import verify

FAULTS = ["--fault", "lose:sample,20%@0.5/0.5", "--fault", "unplug@vertical>0.05"]
SCENARIO = """
title = "a second board and a cable that is pulled out"
duration_s = 3.0
[setpoints]
vertical = "step:0.1@0.5"
[[faults]]
fault = "noisy sensor"
axis = "vertical"
rms_v = 0.002
[[faults]]
fault = "unplug"
when = "vertical>0.05"
for_s = 0.5
"""


def run(path: Path, *options: str) -> Recording:
    setpoint = ["--setpoint", "vertical=step:0.1@0.5"] if "--scenario" not in options else []
    assert main(["run", "--duration", "3", "--record", str(path), *setpoint, *options]) == 1
    return Recording(path)


def test_a_lockstep_run_with_faults_gives_the_same_bytes_and_a_replay(tmp_path: Path) -> None:
    first = run(tmp_path / "a.mcap", "--lockstep", "--no-plot", *FAULTS, "--seed", "3")
    assert not (tmp_path / "a.png").exists()
    second = run(tmp_path / "b.mcap", "--lockstep", *FAULTS, "--seed", "3")
    assert first.path.read_bytes() == second.path.read_bytes()
    assert list(first.metadata[FAULTS_BEGUN].values()) == ["lose:sample,20%@0.5/0.5", "unplug@vertical>0.05"]
    assert first.metadata["plant"]["faults"] == "lose:sample,20%@0.5/0.5 unplug@vertical>0.05"
    assert main(["replay", str(first.path)]) == 0


def test_faults_of_a_scenario_file_act(tmp_path: Path) -> None:
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    recording = run(tmp_path / "run.mcap", "--lockstep", "--scenario", str(tmp_path / "scenario.toml"))
    assert "no good sample for 5 periods" in recording.metadata["ending"]["fault"]
    assert "unplug@vertical>0.05/0.5" in recording.metadata[FAULTS_BEGUN].values()


@pytest.mark.real_time
def test_the_same_fault_stops_a_run_in_real_time(tmp_path: Path) -> None:
    recording = run(
        tmp_path / "run.mcap", "--fault", "hang:dac@armed/0.02", "--fault", "unplug@vertical>0.05"
    )
    assert "no good sample for 5 periods" in recording.metadata["ending"]["fault"]
    vertical = recording.axis("vertical")
    assert np.nanmax(vertical.position) < 0.07
    (first_ns, first), (last_ns, last) = [
        (at_ns, entry) for at_ns, entry in recording.log() if entry.source == FAULT_SOURCE
    ]
    assert (first.text, last.text) == ("hang:dac@armed/0.02 begins", "unplug@vertical>0.05 begins")
    assert recording.metadata[FAULTS_BEGUN] == {
        f"{recording.seconds(first_ns):.4f} s": "hang:dac@armed/0.02",
        f"{recording.seconds(last_ns):.4f} s": "unplug@vertical>0.05",
    }
    known = vertical[np.isfinite(vertical.position)]
    before = known.time_s < recording.seconds(last_ns) - 2 * PERIOD_S
    assert np.all(known.position[before] < 0.05), "the instant is that of the sample beyond the limit"
    assert verify(recording).complete


def test_a_fault_of_the_host_is_refused_in_real_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--record", str(tmp_path / "run.mcap"), "--no-plot", "--fault", "stall:0.1@1"]
    assert main(["run", *options]) == 2
    assert "acts on the gateway's host in simulated time only" in capsys.readouterr().err


def test_a_fault_on_a_real_bus_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--bus", "can0", "--fault", "unplug@1"]) == 2
    assert "--fault chooses what `hil run` simulates" in capsys.readouterr().err
