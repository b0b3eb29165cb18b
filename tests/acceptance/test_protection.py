"""The envelope on the simulated arm: reversed controllers, frozen potentiometers, and no false alarms."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.shipped_rig import RIG_TEXT, SHIPPED_RIG

from firmware_sim import simulated_rig
from firmware_sim.boards.canopen_slave import Frames
from firmware_sim.boards.faults import AdcFaults
from hil.cli import main
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.host.controller_files import SHIPPED_CONTROLLERS
from hil.recording.reader import Recording

AXES = ("vertical", "horizontal", "rotation")
RUNNING = LifeCycleState.RUNNING


def run(folder: Path, *options: str, status: int = 1) -> Recording:
    """Run in lockstep; the replay gives the same bytes."""
    path = folder / "run.mcap"
    assert main(["run", "--lockstep", "--record", str(path), *options]) == status
    assert main(["replay", str(path)]) == 0
    return Recording(path)


def fault(recording: Recording) -> str:
    return recording.metadata["ending"]["fault"]


def fault_time_s(recording: Recording) -> float:
    """Time of control until the fault."""
    period_s = SHIPPED_RIG.loop.period_s
    return float(np.count_nonzero(recording.timing()["state"] == RUNNING)) * period_s


def assert_valves_end_centred(recording: Recording) -> None:
    for axis in AXES:
        assert recording.axis(axis)["command_v"][-1] == 5.0


def reversed_controller(axis: str, folder: Path) -> str:
    """A copy of the axis' shipped controller with the opposite sign."""
    document = json.loads((SHIPPED_CONTROLLERS / f"{SHIPPED_RIG.axes[axis].controller}.json").read_text())
    for gain in ("kp", "ki", "kd"):
        document["law"][gain] *= -1.0
    path = folder / "reversed.json"
    path.write_text(json.dumps(document))
    return str(path)


@pytest.mark.parametrize("axis", AXES)
def test_an_axis_with_a_reversed_controller_faults(axis: str, tmp_path: Path) -> None:
    """Before, the axis stayed at its end stop with the valve fully open until the run was over."""
    size = 0.05 if axis != "rotation" else 0.5
    recording = run(
        tmp_path,
        "--controller", f"{axis}={reversed_controller(axis, tmp_path)}",
        "--setpoint", f"{axis}=step:{size}@1",
        "--override", f"controller-{axis}",
    )  # fmt: skip
    assert fault(recording).startswith(f"{axis}: the tracking error is ")
    assert f"(rig: axes.{axis}.envelope.max_error)" in fault(recording)
    assert fault_time_s(recording) < 1.0 + 1.5 + 3.0  # the step, the way to the end stop, max_error_s
    assert_valves_end_centred(recording)


def test_a_disabled_check_does_not_act_and_is_said_at_the_start(tmp_path: Path) -> None:
    envelope = '[axes.vertical.envelope]\ndisabled = ["max_error"]\n'
    (tmp_path / "rig.toml").write_text(RIG_TEXT + envelope)
    controller = reversed_controller("vertical", tmp_path)
    recording = run(
        tmp_path, "--rig", str(tmp_path / "rig.toml"), "--controller", f"vertical={controller}", status=0
    )
    said = [entry.text for _, entry in recording.log() if entry.source == "vertical"]
    arming_and_start = 2 * ["not protected by max_error (rig: axes.vertical.envelope.disabled)"]
    assert said == arming_and_start


def freeze(monkeypatch: pytest.MonkeyPatch, axis: str, at_s: float) -> None:
    """Let the axis' potentiometer keep its voltage from a time on."""
    channel = SHIPPED_RIG.axes[axis].potentiometer.channel

    class FrozenRig(simulated_rig.SimulatedRig):
        def receive(self, frame: Frame, now_ns: int) -> Frames:
            if now_ns >= at_s * 1e9 and self.adc.faults is None:
                self.adc.faults = AdcFaults(frozen_v={channel: self.plant.potentiometer_v()[channel - 1]})
            return super().receive(frame, now_ns)

    monkeypatch.setattr("firmware_sim.simulated_plant.SimulatedRig", FrozenRig)


@pytest.mark.parametrize("axis", AXES)
def test_a_frozen_potentiometer_and_a_large_error_are_a_fault(
    axis: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    freeze(monkeypatch, axis, 0.5)
    size = 0.1 if axis != "rotation" else 1.0
    recording = run(tmp_path, "--setpoint", f"{axis}=step:{size}@1")
    assert f"(rig: axes.{axis}.envelope.max_error)" in fault(recording)
    assert 4.0 < fault_time_s(recording) < 4.1
    assert_valves_end_centred(recording)


@pytest.mark.parametrize("axis", AXES)
def test_a_frozen_potentiometer_and_a_small_error_are_a_fault_when_the_valve_is_far_open(
    axis: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error stays below max_error, and the integrator of the controller opens the valve."""
    freeze(monkeypatch, axis, 0.5)
    size = 0.07 if axis != "rotation" else 0.7
    recording = run(tmp_path, "--setpoint", f"{axis}=step:{size}@1", "--duration", "20")
    assert fault(recording).startswith(f"{axis}: the position stands still at ")
    assert f"(rig: axes.{axis}.envelope.max_still_s)" in fault(recording)
    rows = recording.axis(axis)
    far_open = np.abs(rows["command_v"] - 5.0) >= 3.0
    assert np.count_nonzero(far_open) * SHIPPED_RIG.loop.period_s == pytest.approx(0.5, abs=0.03)
    assert_valves_end_centred(recording)


@pytest.mark.parametrize("plant", [[], ["--linear"]])
def test_the_largest_steps_on_all_axes_are_no_false_alarm(plant: list[str], tmp_path: Path) -> None:
    """The arm reaches its end stops, and the valves are fully open on the way."""
    levels = "0.14,-0.14,0.14,-0.14@1/1.5"
    setpoints = [
        f"vertical=ladder:{levels}",
        f"horizontal=ladder:{levels}",
        f"rotation=ladder:{levels.replace('0.14', '1.4')}",
    ]
    options = [part for text in setpoints for part in ("--setpoint", text)]
    recording = run(tmp_path, *plant, *options, "--duration", "8", status=0)
    assert fault(recording) == ""


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_setpoints_at_the_ends_with_little_supply_pressure_are_no_false_alarm(
    sign: float, tmp_path: Path
) -> None:
    recording = run(
        tmp_path,
        "--setpoint", f"vertical=step:{0.15 * sign}@1",
        "--setpoint", f"horizontal=step:{-0.15 * sign}@2",
        "--setpoint", f"rotation=step:{1.5 * sign}@3",
        "--event", "supply-pressure:300@0",
        status=0,
    )  # fmt: skip
    assert fault(recording) == ""


def test_a_start_far_from_the_setpoint_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = run(tmp_path, "--setpoint", "vertical=step:0.1@0")
    assert recording.metadata["ending"]["reason"] == "start was refused"
    (said,) = [
        entry.text for _, entry in recording.log() if entry.source == "vertical" and "refused" in entry.text
    ]
    assert said.startswith("start refused: the setpoint begins at 0.1 m and the position is ")
    assert "limit 0.075 m (rig: axes.vertical.envelope.max_error)" in said
    assert not np.any(recording.timing()["state"] == RUNNING)
    assert "start refused" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("setpoint", "speed"),
    [("sine:0.1@0/0.001", "628.3"), ("ramp:0.1@1/0.05", "2"), ("minimum-jerk:0.1@1/0.1", "1.875")],
)
def test_a_setpoint_that_is_faster_than_the_axis_is_refused(
    setpoint: str, speed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--record", str(tmp_path / "run.mcap"), "--setpoint", f"vertical={setpoint}"]
    assert main(["run", "--lockstep", *options]) == 2
    said = f"moves at up to {speed} m/s, limit 1.8 m/s (rig: axes.vertical.envelope.max_speed)"
    assert said in capsys.readouterr().err
