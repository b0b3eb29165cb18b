"""Another controller on recorded measurements: with the recorded one, the recorded commands come out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.recorded_runs import CENTRED, RUN_HEADER, in_memory, record_periods

from hil.cli import main
from hil.core.controller_file import ControllerFile, TransferFunctionLaw
from hil.core.errors import DocumentError, RecordingError
from hil.core.life_cycle import LifeCycleState
from hil.lockstep_rig import run_experiment
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder
from hil.shells.controller_comparison import _controlled, compare
from hil.shells.run_setup import load_controller


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A run whose setpoint is fast and far, so that limits of rate and magnitude act."""
    path = tmp_path_factory.mktemp("comparison") / "run.mcap"
    return run_experiment(path, duration_s=2.0, setpoints={"vertical": "step:0.14@0.3"})


def gain(value: float, **changes: object) -> ControllerFile:
    """Return a controller u = value · e."""
    law = TransferFunctionLaw(num=[value], den=[1.0])
    fields = {
        "format": "hil-controller", "version": 1, "name": f"gain {value:g}", "sample_time_s": 0.0112,
        "input_unit": "m", "output_unit": "V", "law": law, "description": "", "origin": {}, **changes,
    }  # fmt: skip
    return ControllerFile(**fields)  # type: ignore[arg-type]


@pytest.mark.parametrize("axis", ["vertical", "horizontal", "rotation"])
def test_the_recorded_controller_gives_the_recorded_commands(run: Recording, axis: str) -> None:
    name = {"vertical": "ppid"}.get(axis, axis)
    found = compare(run, axis, load_controller(name), name)
    assert np.abs(found.difference_v).max() < 1e-9
    assert np.abs(found.output_v - found.axis.output_v).max() < 1e-9
    assert np.array_equal(found.recorded_at_limit, found.other_at_limit)
    assert (found.recorded_name, found.other_name) == (name, name)
    assert len(found.axis) > 150


def test_a_proportional_controller_commands_gain_times_error(run: Recording) -> None:
    found = compare(run, "vertical", gain(3.0), "gain.json")
    assert np.allclose(found.output_v, 3.0 * found.axis.error)
    free = ~found.other_at_limit
    assert np.allclose(found.command_v[free], 5.0 + 3.0 * found.axis.error[free])
    largest_v, at_s = found.largest_difference
    assert largest_v == pytest.approx(np.abs(found.command_v - found.axis.command_v).max())
    assert found.axis.time_s[np.argmax(np.abs(found.difference_v))] == at_s


def test_the_limits_of_the_rig_act_on_the_other_controller(run: Recording) -> None:
    found = compare(run, "vertical", gain(1000.0), "gain.json")
    assert found.command_v.max() <= 10.0
    assert found.other_at_limit.sum() > found.recorded_at_limit.sum()
    assert np.all(np.abs(np.diff(found.command_v)) <= 10.0)


@pytest.mark.parametrize(
    ("axis", "changes", "message"),
    [
        ("vertcal", {}, "no axis 'vertcal'; .*did you mean vertical"),
        ("vertical", {"input_unit": "rad"}, "input_unit is rad, but the axis is in m"),
        ("vertical", {"sample_time_s": 0.01}, "is not the loop's 0.0112 s"),
    ],
)
def test_a_controller_that_does_not_fit_is_refused(
    run: Recording, axis: str, changes: dict[str, object], message: str
) -> None:
    with pytest.raises((DocumentError, RecordingError), match=message):
        compare(run, axis, gain(1.0, **changes), "gain.json")


def test_a_jog_of_the_operator_is_left_out(tmp_path: Path) -> None:
    """In a jog the valve moves although setpoint and position are equal; no controller acts."""
    path = tmp_path / "jog.mcap"
    jog = CENTRED._replace(output_v=1.0, command_v=6.0)
    controlled = CENTRED._replace(setpoint=0.1, error=0.1, output_v=1.1, command_v=6.1)
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 5, lambda t: CENTRED, state=LifeCycleState.ARMED)
    record_periods(recorder, 20, lambda t: jog, first=5)
    record_periods(recorder, 5, lambda t: CENTRED, first=25, state=LifeCycleState.ARMED)
    record_periods(recorder, 30, lambda t: controlled, first=30)
    recorder.close({})
    table, received_ns, stretches = _controlled(Recording(path), "vertical")
    assert len(table) == len(received_ns) == len(stretches) == 30
    assert table.error.tolist() == [0.1] * 30


def test_an_excited_axis_is_refused_and_another_is_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    command = ["collect", "--axis", "vertical", "--lockstep", "--seed", "1", "--yes"]
    assert main([*command, "--duration", "2", "-o", "data.mcap"]) == 0
    data = Recording(tmp_path / "data.mcap")
    with pytest.raises(RecordingError, match="vertical was excited by an experiment"):
        compare(data, "vertical", gain(1.0), "gain.json")
    held = compare(data, "horizontal", load_controller("horizontal"), "horizontal")
    assert np.abs(held.difference_v).max() < 1e-9
