"""The assertions on step responses and limits: what they accept, and how they explain a failure."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from support.constants import PERIOD_NS, PERIOD_S
from support.recorded_runs import lag, step

from hil.core.errors import HilError
from hil.lockstep_rig import LockstepRig
from hil.recording.tables import AxisTable
from hil.testing import assert_step_response, assert_within_limits
from hil.testing.lockstep_states import build_rig


def table(positions: np.ndarray, setpoints: np.ndarray, *, valve_v: np.ndarray | None = None) -> AxisTable:
    """A vertical axis under control from the fourth period on."""
    count = len(positions)
    time_ns = np.arange(count, dtype=np.int64) * PERIOD_NS
    running = np.arange(count) >= 3
    return AxisTable(
        time_s=time_ns * 1e-9,
        time_ns=time_ns,
        setpoint=setpoints,
        position=positions,
        error=setpoints - positions,
        output_v=np.zeros(count),
        command_v=np.full(count, 5.0) if valve_v is None else valve_v,
        potentiometer_v=np.full(count, 5.0),
        phase=np.zeros(count, np.uint8),
        state=np.where(running, 3, 2).astype(np.uint8),
        fresh=np.ones(count, np.bool_),
        running=running,
        name="vertical",
        unit="m",
    )


TIMES_S = (np.arange(300) - 3) * PERIOD_S


def lag_table(overshoot: float = 0.0) -> AxisTable:
    """A step of 0.1 m at 1 s of control, with a lag of 0.2 s, and a peak of one period at 1.5 s."""
    setpoints = np.array([step(0.1, 1.0)(t) for t in TIMES_S])
    positions = np.array([lag(0.1, 1.0, 0.2)(t) for t in TIMES_S])
    positions[np.searchsorted(TIMES_S, 1.5)] = 0.1 * (1.0 + overshoot) if overshoot else 0.0918
    return table(positions, setpoints)


def message(caught: pytest.ExceptionInfo[AssertionError]) -> str:
    return str(caught.value)


def test_a_good_step_gives_its_readings() -> None:
    readings = assert_step_response(lag_table(), overshoot=0.0, settling_s=0.8, steady_state_error=1e-3)
    assert readings.settling_s == pytest.approx(0.2 * np.log(50), abs=2 * PERIOD_S)


def test_a_bad_step_is_explained_with_values_limits_and_times() -> None:
    with pytest.raises(AssertionError) as caught:
        assert_step_response(
            lag_table(0.2), "vertical", overshoot=0.05, settling_s=0.3, steady_state_error=1e-5
        )
    first, overshoot, settling = message(caught).splitlines()
    assert first == "vertical: step from 0 to 0.1 m at 1.008 s:"
    assert overshoot == "  overshoot 20.00 %, limit 5 %: 0.1200 m at 1.501 s"
    assert re.fullmatch(
        r"  settling time: 0\.7\d+ s into 2 % \(±0\.002 m\), limit 0\.3 s: "
        r"last outside at 1\.7\d+ s with 0\.09\d+ m",
        settling,
    )


def test_a_steady_state_error_is_explained() -> None:
    with pytest.raises(AssertionError, match=r"\n  steady-state error \S+ m, limit ±1e-09 m$"):
        assert_step_response(lag_table(), steady_state_error=1e-9)


def test_a_response_that_does_not_settle_is_said() -> None:
    wavy = lag_table()
    wavy.position[-1] = 0.09
    with pytest.raises(AssertionError, match="settling time: never within 2 %"):
        assert_step_response(wavy, settling_s=1.0)


def test_a_limit_that_is_not_given_is_not_checked() -> None:
    assert_step_response(lag_table(0.2))


@pytest.mark.parametrize(
    ("setpoints", "positions", "reason"),
    [
        (np.zeros(300), np.zeros(300), "the setpoint did not change under control"),
        (np.where(TIMES_S < 1.0, 0.0, 0.1), np.full(300, 0.05), "the axis was 0.05 m from its setpoint"),
        (TIMES_S * 0.01, TIMES_S * 0.01, "was not constant before and after its last change"),
    ],
)  # fmt: skip
def test_without_a_step_from_rest_the_reason_is_said(
    setpoints: np.ndarray, positions: np.ndarray, reason: str
) -> None:
    with pytest.raises(AssertionError) as caught:
        assert_step_response(table(positions, setpoints), overshoot=0.1)
    assert message(caught).startswith("vertical: there is no step response: ")
    assert reason in message(caught)


def test_a_run_without_control_cannot_be_judged() -> None:
    idle = lag_table()
    idle.running[:] = False
    with pytest.raises(AssertionError, match="vertical: the controllers never acted in this run"):
        assert_within_limits(idle, position=(-1.0, 1.0))


def test_limits_that_hold_pass() -> None:
    assert_within_limits(
        lag_table(), position=(-0.01, 0.11), max_error=0.11, valve_v=(4.0, 6.0), max_valve_rate_v_s=1.0
    )
    assert_within_limits(lag_table(), max_error=0.05, from_s=1.2)


def test_each_violated_limit_is_explained_with_its_worst_value() -> None:
    valve_v = np.full(300, 5.0)
    valve_v[100:110] = 9.0
    bad = table(lag_table().position, lag_table().setpoint, valve_v=valve_v)
    with pytest.raises(AssertionError) as caught:
        assert_within_limits(
            bad, position=(-0.01, 0.05), max_error=0.05, valve_v=(2.0, 8.0), max_valve_rate_v_s=100.0
        )
    position, valve, error, falling, rising = message(caught).splitlines()
    assert re.fullmatch(
        r"vertical: position 0\.1 m at 3\.3\d\d s of control, limit 0\.05 m; \d+ periods beyond it", position
    )
    assert valve == "vertical: valve voltage 9 V at 1.086 s of control, limit 8 V; 10 periods beyond it"
    assert error.startswith("vertical: error 0.09608 m at 1.008 s of control, limit 0.05 m; ")
    assert falling.startswith("vertical: valve rate -357.1 V/s at 1.198 s of control, limit -100")
    assert rising.startswith("vertical: valve rate 357.1 V/s at 1.086 s of control, limit 100")


def test_a_window_without_control_is_no_success() -> None:
    with pytest.raises(AssertionError, match="no period under control between 90 and inf s of control"):
        assert_within_limits(lag_table(), max_error=1.0, from_s=90.0)


@pytest.fixture(scope="module")
def rig() -> LockstepRig:
    made = build_rig("running", {"setpoints": {"vertical": "step:0.05@0.3"}})
    made.run(1.8)
    return made


def test_a_rig_a_recording_and_its_path_give_the_same_readings(rig: LockstepRig, tmp_path: Path) -> None:
    recording = rig.save_recording(tmp_path / "run.mcap")
    readings = [assert_step_response(run, "vertical") for run in (rig, recording, recording.path)]
    assert readings[1] == readings[2]
    assert readings[0] == readings[1]
    for run in (rig, recording, recording.path):
        assert_within_limits(run)


def test_the_table_of_a_rig_is_that_of_its_recording(rig: LockstepRig, tmp_path: Path) -> None:
    recorded, live = rig.save_recording(tmp_path / "run.mcap").axis("rotation"), rig.axis("rotation")
    for column in recorded.columns:
        assert np.array_equal(recorded[column], live[column], equal_nan=column != "fresh"), column
    assert (live.name, live.unit) == ("rotation", "rad")


def test_the_limits_of_the_rig_file_are_the_default(rig: LockstepRig) -> None:
    with pytest.raises(AssertionError, match=r"vertical: position 0\.0\d+ m at .* limit 0\.01 m"):
        assert_within_limits(rig, position=(-0.01, 0.01))


def test_an_axis_must_be_named_if_there_are_several(rig: LockstepRig) -> None:
    with pytest.raises(AssertionError, match="name the axis to judge: vertical, horizontal, rotation"):
        assert_step_response(rig)


def test_a_mistyped_axis_is_refused_with_the_nearest_name() -> None:
    for judge in (assert_step_response, assert_within_limits):
        with pytest.raises(HilError, match=r"no axis 'vertcal'; .*; did you mean vertical\?"):
            judge(LockstepRig(), "vertcal")
