"""Experiments on the simulated arm through gateway, frames and boards, as ``hil run`` runs them."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete, tf2ss
from support.arm_bench import identify, prbs
from support.arm_files import SHIPPED_TEXT
from support.constants import PERIOD_NS, PERIOD_S
from support.shipped_rig import RIG_TEXT, SHIPPED_RIG

from hil.cli import main
from hil.core.life_cycle import LifeCycleState
from hil.recording.mcap_reader import Rows
from hil.recording.reader import Recording
from hil.shells.replay import verify


def running(recording: Recording, axis: str) -> Rows:
    rows = recording.axis(axis)
    return rows[rows["state"] == LifeCycleState.RUNNING]


def run(path: Path, *arguments: str) -> Recording:
    assert main(["run", "--lockstep", "--record", str(path), *arguments]) == 0
    return Recording(path)


class Stair:
    """One step of a recorded response, up to the next step."""

    def __init__(self, rows: Rows, index: int, end: int) -> None:
        r, y = rows["setpoint"], rows["position"][index:end]
        size = r[index] - r[index - 1]
        error = y - r[index]
        outside = np.flatnonzero(np.abs(error) > 0.02 * abs(size))
        self.settling_s = (outside[-1] + 1) * PERIOD_S if len(outside) else 0.0
        self.overshoot_percent = 100.0 * max(0.0, float(np.max(error * np.sign(size)))) / abs(size)
        self.error = float(np.mean(y[-40:]) - r[index])


def stairs(rows: Rows) -> list[Stair]:
    changes = np.flatnonzero(np.diff(rows["setpoint"])) + 1
    ends = [*changes[1:], len(rows)]
    return [Stair(rows, int(start), int(end)) for start, end in zip(changes, ends, strict=True)]


def test_fig_13_step_of_the_vertical_axis(tmp_path: Path) -> None:
    """The paper's response settles in about 1 s, without overshoot and with an error of about 0.7 mm."""
    recording = run(tmp_path / "fig13.mcap", "--scenario", "fig13")
    rows = running(recording, "vertical")
    (step,) = stairs(rows)
    assert np.flatnonzero(rows["setpoint"])[0] * PERIOD_S > 4.0
    assert 0.7 < step.settling_s < 1.1
    assert step.overshoot_percent < 0.5
    assert abs(step.error) < 0.7e-3
    assert (tmp_path / "fig13-figure.png").read_bytes().startswith(b"\x89PNG")
    assert "scenario.toml" in recording.attachments
    assert verify(recording).frames_compared > 900


def test_fig_14_staircase_with_load_at_low_pressure(tmp_path: Path) -> None:
    """With 3 kg, 400 kPa and moving axes the response is nearly as without; the paper's settles later."""
    recording = run(tmp_path / "fig14.mcap", "--scenario", "fig14")
    steps = stairs(running(recording, "vertical"))
    assert len(steps) == 6
    for step in steps:
        assert step.overshoot_percent < 1.0
        assert abs(step.error) < 1e-3
    settling_s = sorted(step.settling_s for step in steps)
    assert settling_s[4] < 1.4
    assert settling_s[5] < 2.0
    for axis, moved in (("horizontal", 0.05), ("rotation", 0.4)):
        assert np.ptp(running(recording, axis)["position"]) > moved


def test_fig_15_steps_of_the_other_axes(tmp_path: Path) -> None:
    recording = run(tmp_path / "fig15.mcap", "--scenario", "fig15")
    for axis, size in (("horizontal", 0.1), ("rotation", 1.0)):
        (step,) = stairs(running(recording, axis))
        assert 0.7 < step.settling_s < 1.5, axis
        assert step.overshoot_percent < 2.0, axis
        assert abs(step.error) < 0.02 * size, axis


def test_the_whole_chain_identifies_equation_15(tmp_path: Path) -> None:
    """Excite in open loop through the gateway, record, and estimate OE(1,3,1) from the recording."""
    amplitude_v, volts_per_metre = 0.4, 4.0
    u_wanted = amplitude_v / volts_per_metre * prbs(int(60 / PERIOD_S), 12, seed=1)
    rows, time_s = ["time_s,setpoint"], 0.0
    for before, after in pairwise(u_wanted):
        time_s += PERIOD_S
        if before != after:
            rows += [f"{time_s - PERIOD_S / 2},{before}", f"{time_s - PERIOD_S / 2},{after}"]
    (tmp_path / "prbs.csv").write_text("\n".join(rows))
    open_loop = {
        "format": "hil-controller", "version": 1, "name": "open loop", "description": "u = 4 V/m r",
        "sample_time_s": PERIOD_S, "input_unit": "m", "output_unit": "V", "origin": {},
        "law": {
            "kind": "state_space", "inputs": "r, y",
            "A": [], "B": [], "C": [[]], "D": [[volts_per_metre, 0.0]],
        },
    }  # fmt: skip
    (tmp_path / "open.json").write_text(json.dumps(open_loop))
    # In open loop, the difference of setpoint and position means nothing.
    envelope = '[axes.vertical.envelope]\ndisabled = ["max_error"]\n'
    (tmp_path / "rig.toml").write_text(RIG_TEXT + envelope)
    recording = run(
        tmp_path / "excited.mcap", "--duration", "60", "--seed", "1", "--rig", f"{tmp_path}/rig.toml",
        "--controller", f"vertical={tmp_path}/open.json", "--setpoint", f"vertical=csv:{tmp_path}/prbs.csv",
    )  # fmt: skip
    rows_read = running(recording, "vertical")
    commanded_v = rows_read["command_v"] - 5.0
    applied_v = np.concatenate([[0.0], commanded_v[:-1]])  # a command acts at the next SYNC
    model = identify(applied_v, rows_read["position"].copy(), stops=0.14)
    assert model.velocity_gain == pytest.approx(0.47947 * 90.76 / 167.9, rel=0.05)
    assert model.slow_rad_s == pytest.approx(0.4231, rel=0.15)
    assert model.mode_rad_s == pytest.approx(math.sqrt(167.9), rel=0.10)
    assert model.damping == pytest.approx(16.97 / 2 / math.sqrt(167.9), rel=0.15)
    assert model.velocity_gain / model.slow_rad_s == pytest.approx(0.47947 * 90.76 / 167.9 / 0.4231, rel=0.11)
    assert model.fit_percent > 97.0


def test_a_broken_wire_is_a_fault_with_its_cause(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scenario = tmp_path / "wire.toml"
    scenario.write_text(
        'title = "wire"\nduration_s = 4.0\n'
        '[[events]]\nat_s = 2.0\nchange = "broken wire"\naxis = "rotation"\n'
    )
    path = tmp_path / "wire.mcap"
    arguments = ["run", "--lockstep", "--record", str(path), "--scenario", str(scenario)]
    assert main(arguments) == 1
    printed = capsys.readouterr().out
    assert (
        "rotation: potentiometer 0.000 V outside 0.1 to 9.9 V (rig: axes.rotation.potentiometer)" in printed
    )
    assert Recording(path).axis("rotation")["command_v"][-1] == 5.0


def test_the_same_run_twice_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two", "other"):
        seed = "7" if name == "other" else "0"
        run(tmp_path / f"{name}.mcap", "--scenario", "fig15", "--duration", "2", "--seed", seed)
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()
    assert (tmp_path / "one.mcap").read_bytes() != (tmp_path / "other.mcap").read_bytes()


def test_a_scenario_runs_on_the_users_own_arm(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    own = tmp_path / "arm.toml"
    own.write_text(SHIPPED_TEXT + "# mine\n")
    arguments = ["run", "--lockstep", "--duration", "1", "--scenario", "fig14", "--record", str(path)]
    assert main([*arguments, "--arm", str(own)]) == 0
    assert Recording(path).attachments["arm.toml"].endswith(b"# mine\n")
    assert main([*arguments, "--linear"]) == 2


def test_a_run_is_repeated_from_its_recording(tmp_path: Path) -> None:
    events = ["--event", "payload:2@0.5", "--event", "stuck-spool:rotation@1"]
    given = ["--scenario", "fig14", "--duration", "2", "--seed", "3", *events]
    first = run(tmp_path / "first.mcap", *given)
    for name in ("arm.toml", "scenario.toml"):
        (tmp_path / name).write_bytes(first.attachments[name])
    plant = first.metadata["plant"]
    assert plant == json.loads(first.attachments["plant.json"])
    events_again = [argument for event in plant["events"].split() for argument in ("--event", event)]
    files = ["--scenario", str(tmp_path / "scenario.toml"), "--arm", str(tmp_path / "arm.toml")]
    again = run(tmp_path / "again.mcap", *files, *events_again, "--seed", plant["seed"], "--duration", "2")
    assert np.array_equal(first.axis("vertical"), again.axis("vertical"))
    assert first.metadata["run"] == again.metadata["run"]
    other = run(tmp_path / "other.mcap", *files, *events_again, "--seed", "4", "--duration", "2")
    assert first.metadata["run"]["configuration sha256"] != other.metadata["run"]["configuration sha256"]


@pytest.mark.real_time
def test_an_event_reaches_the_boards_in_their_own_process(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "wire.mcap"
    arguments = ["run", "--record", str(path), "--duration", "20", "--event", "broken-wire:rotation@1"]
    assert main(arguments) == 1
    assert "rotation: potentiometer 0.000 V outside 0.1 to 9.9 V" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--event", "payload:300@2"], "--event 'payload:300@2': mass_kg is 300, but must be at most 100.0"),
        (["--linear", "--event", "payload:3@2"], "--event is for the pneumatic arm"),
        (
            ["--bus", "inproc:x", "--event", "payload:3@2"],
            "--event chooses what `hil run` simulates; --bus inproc:x is no simulation",
        ),
    ],
)
def test_an_invalid_event_is_rejected(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *arguments]) == 2
    assert complaint in capsys.readouterr().err


@pytest.mark.parametrize(
    "table", ['figure_axes = ["elbow"]', '[setpoints]\nelbow = "step:0@0"', '[controllers]\nelbow = "ppid"']
)
def test_a_scenario_for_an_axis_that_the_rig_does_not_have_is_rejected(
    table: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'title = "elbow"\nduration_s = 1.0\n{table}\n')
    assert main(["run", "--lockstep", "--scenario", str(path)]) == 2
    complaint = f"{path}: {table.strip('[').split()[0].strip('[]')}: no axis 'elbow'; the rig has vertical, "
    assert complaint in capsys.readouterr().err


PLANT = {
    "format": "hil-plant", "version": 1, "name": "mine", "input_unit": "V", "output_unit": "m",
    "num": [0.5, 12.0], "den": [1.0, 9.0, 52.0, 15.0], "dead_time_s": 0.0171,
}  # fmt: skip
"""A plant that is not the arm's: a mode of 7.1 rad/s, and a dead time of 1.53 periods."""


@pytest.fixture
def plant_json(tmp_path: Path) -> Path:
    path = tmp_path / "plant.json"
    path.write_text(json.dumps(PLANT))
    return path


def test_a_run_on_a_plant_file_is_the_response_of_its_model(tmp_path: Path, plant_json: Path) -> None:
    """Each position is scipy's response to the recorded commands, to half a step of the converter."""
    recording = run(tmp_path / "run.mcap", "--plant", f"vertical={plant_json}", "--duration", "6")
    rows = recording.axis("vertical")
    rig = SHIPPED_RIG.axes["vertical"]
    # A frame has 15 bit, of which the board's converter uses 12. A command acts at the next SYNC.
    commanded_v = np.rint(rows["command_v"] * 3276.8) // 8 / 409.6
    applied_v = np.concatenate([[0.0], commanded_v[:-1] - 5.0])
    periods = np.rint(np.diff(rows["time_ns"]) / PERIOD_NS).astype(int)
    assert (periods == 1).all()
    steps_per_period = 112  # 0.1 ms: the dead time is a whole number of steps
    u = np.repeat(applied_v, steps_per_period)
    u = np.concatenate([np.zeros(171), u])[: len(u)]
    A, B, C, _, _ = cont2discrete(tf2ss(PLANT["num"], PLANT["den"]), PERIOD_S / steps_per_period, "zoh")
    x, y = np.zeros(len(A)), []
    for k, volts in enumerate(u):
        if k % steps_per_period == 0:
            y.append((C @ x).item())
        x = A @ x + B[:, 0] * volts
    resolution = (rig.potentiometer.y_at_10v - rig.potentiometer.y_at_0v) / 4096
    assert np.ptp(y) > 0.05
    assert np.abs(y - rows["position"]).max() < 0.501 * resolution
    assert verify(recording).frames_compared > 500


def test_a_run_on_a_plant_file_is_reproducible_and_repeated_from_its_recording(
    tmp_path: Path, plant_json: Path
) -> None:
    given = [
        "--setpoint",
        "vertical=step:0.05@0.2",
        "--event",
        "payload:2@0.5",
        "--duration",
        "2",
        "--seed",
        "3",
    ]
    first = run(tmp_path / "first.mcap", "--plant", f"vertical={plant_json}", *given)
    again = run(tmp_path / "again.mcap", "--plant", f"vertical={plant_json}", *given)
    assert (tmp_path / "first.mcap").read_bytes() == (tmp_path / "again.mcap").read_bytes()
    assert first.metadata["plant"]["plants"] == "vertical"
    assert json.loads(first.attachments["plants/vertical.json"]) == PLANT
    (tmp_path / "recorded.json").write_bytes(first.attachments["plants/vertical.json"])
    other = run(tmp_path / "other.mcap", "--plant", f"vertical={tmp_path}/recorded.json", *given)
    assert first.metadata["run"] == other.metadata["run"] == again.metadata["run"]
    without = run(tmp_path / "without.mcap", *given)
    assert not np.array_equal(first.axis("vertical")["position"], without.axis("vertical")["position"])


@pytest.mark.real_time
def test_a_plant_file_reaches_the_boards_in_their_own_process(tmp_path: Path, plant_json: Path) -> None:
    path = tmp_path / "run.mcap"
    arguments = ["run", "--record", str(path), "--duration", "2", "--plant", f"vertical={plant_json}"]
    assert main([*arguments, "--setpoint", "vertical=step:0.05@0.2"]) == 0
    moved = np.ptp(running(Recording(path), "vertical")["position"])
    assert 0.04 < moved < 0.12


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--plant", "rotation=paper"], "output_unit: m, but axis rotation is in rad"),
        (
            ["--plant", "elbow=paper"],
            "--plant elbow=paper: no such axis; the rig has vertical, horizontal, rotation",
        ),
        (["--plant", "paper"], "--plant 'paper': not AXIS=FILE"),
        (["--bus", "inproc:x", "--plant", "vertical=paper"], "--plant chooses what `hil run` simulates"),
    ],
)
def test_a_plant_file_that_does_not_fit_is_rejected(
    arguments: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", *arguments]) == 2
    assert complaint in capsys.readouterr().err
