"""The rig with which an axis is jogged to its ends: wide limits for it, slow jogs, and nothing starts."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.gateway_bench import EXAMPLE_RIG
from support.operated_runs import OperatedRun

from hil.core.calibration_rig import MAX_JOG_S, MAX_JOG_V, calibration_text, calibration_warnings
from hil.core.errors import DocumentError
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Severity
from hil.core.requests import JogRequest, SetpointRequest
from hil.core.rig import Rig, read_rig
from hil.recording.reader import Recording
from hil.shells.replay import verify
from hil.shells.run_setup import calibration_setup, load_setup

HOLD = dict.fromkeys(("vertical", "horizontal", "rotation"), "hold")


def calibrated(text: str = EXAMPLE_RIG, axis: str = "vertical") -> Rig:
    return read_rig(calibration_text(text, axis, "mine.toml"), "mine.toml")


@pytest.mark.parametrize("axis", list(HOLD))
def test_the_limits_are_those_of_the_potentiometer(axis: str) -> None:
    rig = calibrated(axis=axis)
    wide, before = rig.axes[axis], read_rig(EXAMPLE_RIG, "rig.toml").axes[axis]
    assert rig.calibration == axis
    fence = [wide.potentiometer.volts(y) for y in wide.fence_limits]
    assert fence == pytest.approx([0.051, 9.9986], abs=1e-3)
    stops = [wide.potentiometer.volts(y) for y in (wide.limits.min_y, wide.limits.max_y)]
    assert stops == pytest.approx([0.05, 9.9996], abs=1e-3)
    assert wide.potentiometer.min_v == 0.05, "a broken wire is still found"
    assert (wide.operator_limits.jog_max_v, wide.operator_limits.jog_max_s) == (MAX_JOG_V, MAX_JOG_S)
    assert wide.potentiometer.y_at_0v == before.potentiometer.y_at_0v
    assert wide.valve == before.valve


def test_other_axes_keep_their_limits() -> None:
    before = read_rig(EXAMPLE_RIG, "rig.toml")
    rig = calibrated()
    assert {name: rig.axes[name] for name in ("horizontal", "rotation")} == {
        name: before.axes[name] for name in ("horizontal", "rotation")
    }
    assert (rig.loop, rig.adc, rig.dac) == (before.loop, before.adc, before.dac)


def test_given_limits_are_widened_and_lower_ones_of_a_jog_stay() -> None:
    tables = (
        "\n[axes.vertical.envelope]\nmin_y = -0.155\nmax_y = 0.155\nmax_speed = 1.0\n"
        "\n[axes.vertical.operator]\njog_max_v = 0.2\nsetpoint_max_speed = 0.1\n"
    )
    fenced = EXAMPLE_RIG.replace("# fence_min_y = -0.12 ", "fence_min_y = -0.12 ", 1)
    vertical = calibrated(fenced + tables).axes["vertical"]
    assert vertical.limits.min_y < -0.163
    assert vertical.limits.max_y > 0.164
    assert vertical.fence_limits[0] < -0.163
    assert vertical.limits.max_speed == 1.0
    assert vertical.operator_limits.jog_max_v == 0.2
    assert vertical.operator_limits.max_speed == 0.1


def test_a_disabled_end_stop_stays_disabled() -> None:
    text = EXAMPLE_RIG + '\n[axes.vertical.envelope]\ndisabled = ["min_y"]\n'
    assert calibrated(text).axes["vertical"].envelope.disabled == ["min_y"]


def test_an_axis_that_the_rig_does_not_have_is_refused() -> None:
    with pytest.raises(DocumentError, match=r"--calibrate vertcal: .*; did you mean vertical\?"):
        calibration_text(EXAMPLE_RIG, "vertcal", "mine.toml")
    with pytest.raises(DocumentError, match=r"mine\.toml: calibration: 'elbow' is not an axis of this rig"):
        read_rig(f'calibration = "elbow"\n{EXAMPLE_RIG}', "mine.toml")


def test_a_table_that_cannot_be_edited_is_refused() -> None:
    header = "[axes.vertical.potentiometer]\n"
    text = EXAMPLE_RIG.replace(header, "[axes.vertical]\n", 1)
    with pytest.raises(DocumentError, match=r"mine\.toml"):
        calibration_text(text, "vertical", "mine.toml")


def test_the_calibration_is_warned_of() -> None:
    (warning,) = calibration_warnings(calibrated())
    assert (warning.severity, warning.source) == (Severity.WARNING, "vertical")
    assert "jogs have at most 0.5 V, and controllers do not start" in warning.text
    assert calibration_warnings(read_rig(EXAMPLE_RIG, "rig.toml")) == []


def test_an_axis_is_jogged_beyond_its_fence_and_nothing_starts(tmp_path: Path) -> None:
    rig_path, path = tmp_path / "wide.toml", tmp_path / "run.mcap"
    rig_path.write_text(calibration_text(EXAMPLE_RIG, "vertical", "rig.toml"))
    run = OperatedRun(path, HOLD, rig_path=rig_path)
    run.periods(20)
    assert run.ask(Trigger.ARM).accepted
    assert run.ask(SetpointRequest("vertical", "0.05")).accepted
    reply = run.ask(Trigger.START)
    assert (reply.accepted, "being calibrated (rig: calibration)" in reply.text) == (False, True)
    assert not run.ask(JogRequest("vertical", 0.6, 0.2)).accepted
    assert not run.ask(JogRequest("vertical", 0.5, 0.4)).accepted
    while run.shown.cycles[-1].axes[0].position > -0.13:  # beyond the fence of the rig file, -0.12 m
        assert run.ask(JogRequest("vertical", -0.3, 0.3)).accepted
        run.periods(5)
    run.periods(40)
    assert run.gateway.state is LifeCycleState.ARMED, "the jog ended by its time"
    run.close()
    verify(Recording(path))


def test_a_setup_is_calibrated_without_its_file(tmp_path: Path) -> None:
    setup = calibration_setup(load_setup(None, {}, HOLD), "rotation", "rig.toml")
    assert setup.rig.calibration == "rotation"
    assert 'calibration = "rotation"' in setup.texts["rig.toml"]
    assert setup.setpoints["vertical"].text == "hold"
