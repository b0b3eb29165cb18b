"""Comparison of two recordings: alignment, differences and where they are, tolerances."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from support.recorded_runs import (
    AXES,
    CENTRED,
    PERIOD_S,
    RUN_HEADER,
    Signals,
    following,
    in_memory,
    lag,
    record_periods,
    record_run,
    step,
)

import hil.cli.compare as command
from hil.core.errors import RecordingError
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.recording.handover import RunHeader
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder
from hil.views.comparison import Event, SignalDifference, compare

SLOW = following(step(0.1, 1.0), lag(0.1, 1.0, 0.2))


def bumped(at_s: float, size: float) -> Signals:
    """Return the signals of ``SLOW`` with a position that is off by ``size`` in the period at ``at_s``."""

    def position(t: float) -> float:
        return lag(0.1, 1.0, 0.2)(t) + (size if abs(t - at_s) < PERIOD_S / 2 else 0.0)

    return following(step(0.1, 1.0), position)


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., Path]:
    def make(name: str, signals: Signals = SLOW, armed: int = 3, header: RunHeader = RUN_HEADER) -> Path:
        path = tmp_path / name
        with in_memory(path):
            recorder = Recorder(path, header, lossless=True)
        record_periods(
            recorder,
            armed,
            lambda t: CENTRED,
            first=-armed,
            state=LifeCycleState.ARMED,
            axes=len(header.axes),
        )
        record_periods(recorder, 300, signals, axes=len(header.axes))
        recorder.close({})
        return path

    return make


def found(first: Path, second: Path, event: Event | None = None) -> dict[tuple[str, str], SignalDifference]:
    comparison = compare(Recording(first), Recording(second), event)
    return {(row.axis, row.signal): row for row in comparison.signals}


def test_equal_runs_that_begin_at_other_times_do_not_differ(run: Callable[..., Path]) -> None:
    first, second = run("a.mcap"), run("b.mcap", armed=40)
    comparison = compare(Recording(first), Recording(second))
    assert comparison.event is Event.RUNNING
    assert (comparison.first_event_s, comparison.second_event_s) == pytest.approx(
        (3 * PERIOD_S, 40 * PERIOD_S)
    )
    assert {row.largest for row in comparison.signals} == {0.0}
    assert comparison.samples == 303
    assert comparison.documents == ()
    assert comparison.first_controlled_s == pytest.approx(299 * PERIOD_S)


def test_the_largest_difference_and_its_place_are_found(run: Callable[..., Path]) -> None:
    first, second = run("a.mcap", bumped(2.0, 0.004)), run("b.mcap", armed=9)
    rows = found(first, second)
    position = rows["vertical", "position"]
    assert position.largest == pytest.approx(0.004)
    assert position.at_s == pytest.approx(2.0, abs=PERIOD_S / 2)
    assert position.first - position.second == pytest.approx(0.004)
    assert position.rms == pytest.approx(0.004 / math.sqrt(303))
    assert position.unit == "m"
    valve = rows["rotation", "command_v"]
    assert (valve.largest, valve.unit) == (pytest.approx(0.04), "V")
    assert rows["vertical", "setpoint"].largest == 0.0


def test_runs_can_be_aligned_on_the_first_change_of_a_setpoint(run: Callable[..., Path]) -> None:
    later = following(step(0.1, 1.5), lag(0.1, 1.5, 0.2))
    first, second = run("a.mcap"), run("b.mcap", later)
    assert found(first, second)["vertical", "position"].largest > 0.05
    aligned = found(first, second, Event.SETPOINT)
    assert aligned["vertical", "setpoint"].largest == 0.0
    assert aligned["vertical", "position"].largest < 0.005


def test_runs_that_were_never_under_control_are_aligned_on_their_begin(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ("a.mcap", "b.mcap")]
    for path in paths:
        with in_memory(path):
            recorder = Recorder(path, RUN_HEADER, lossless=True)
        record_periods(recorder, 20, SLOW, state=LifeCycleState.ARMED)
        recorder.close({})
    comparison = compare(*map(Recording, paths))
    assert comparison.event is Event.BEGIN
    assert comparison.samples == 20
    with pytest.raises(RecordingError, match=r"a\.mcap: has no first period under control; choose another"):
        compare(*map(Recording, paths), Event.RUNNING)


def test_a_value_in_one_run_alone_is_an_infinite_difference(run: Callable[..., Path]) -> None:
    nowhere = CENTRED._replace(position=math.nan)
    first = run("a.mcap", lambda t: nowhere if 1.0 < t < 1.01 else CENTRED)
    second = run("b.mcap", lambda t: CENTRED)
    assert found(first, second)["vertical", "position"].largest == math.inf
    assert found(first, first)["vertical", "position"].largest == 0.0


def test_what_else_differs_is_named(run: Callable[..., Path]) -> None:
    attachments = {**RUN_HEADER.attachments, "arm.dbc": ("text/plain", b"other")}
    other = msgspec.structs.replace(
        RUN_HEADER, attachments=attachments, axes=AXES[1:], metadata={"setpoints": {"vertical": "hold"}}
    )
    comparison = compare(Recording(run("a.mcap")), Recording(run("b.mcap", header=other)))
    assert comparison.documents == ("arm.dbc", "setpoint of vertical (step:0.1@1, hold)")
    assert (comparison.only_first, comparison.only_second) == (("vertical",), ())


def test_runs_that_cannot_be_compared_are_refused(run: Callable[..., Path], tmp_path: Path) -> None:
    first = run("a.mcap")
    elbow = run("b.mcap", header=msgspec.structs.replace(RUN_HEADER, axes=(("elbow", "rad"),)))
    with pytest.raises(RecordingError, match="have no common axis: vertical, horizontal, rotation; elbow"):
        compare(Recording(first), Recording(elbow))
    radians = run("c.mcap", header=msgspec.structs.replace(RUN_HEADER, axes=(("vertical", "rad"),)))
    with pytest.raises(RecordingError, match=r"vertical is in m in .*a\.mcap, and in rad in .*c\.mcap"):
        compare(Recording(first), Recording(radians))
    empty = tmp_path / "empty.mcap"
    with in_memory(empty):
        recorder = Recorder(empty, RUN_HEADER, lossless=True)
    recorder.operated(Trigger.ARM, 1)
    recorder.close({})
    with pytest.raises(RecordingError, match=r"a\.mcap: has no period|empty\.mcap: has no period"):
        compare(Recording(first), Recording(empty))


class TestCommand:
    def test_a_difference_is_no_failure_without_a_tolerance(
        self, run: Callable[..., Path], capsys: pytest.CaptureFixture[str]
    ) -> None:
        files = [str(run("a.mcap", bumped(2.0, 0.004))), str(run("b.mcap"))]
        assert command.main(files) == 0
        out = capsys.readouterr().out
        assert "aligned on the first period under control: 0.034 s in the first run, 0.034 s" in out
        assert any(
            line.split()[:4] == ["vertical", "position", "(m)", "0.00023"] for line in out.splitlines()
        )
        assert max(len(line) for line in out.splitlines()) <= 100

    @pytest.mark.parametrize(
        ("tolerances", "status"),
        [
            (["position=0.005", "error=0.005", "valve=0.05"], 0),
            (["position=0.003"], 1),
            (["0.05"], 0),
            (["0.003", "position=0.005", "error=0.005", "valve=0.05"], 0),
            (["0"], 1),
        ],
    )
    def test_a_tolerance_makes_a_gate(
        self,
        run: Callable[..., Path],
        capsys: pytest.CaptureFixture[str],
        tolerances: list[str],
        status: int,
    ) -> None:
        files = [str(run("a.mcap", bumped(2.0, 0.004))), str(run("b.mcap"))]
        options = [part for text in tolerances for part in ("--tolerance", text)]
        assert command.main([*files, *options]) == status
        assert ("exceeded   vertical position: 0.004 m at 2.00" in capsys.readouterr().out) == bool(status)

    @pytest.mark.parametrize("text", ["pos=1", "position=x", "-1", "nan", ""])
    def test_a_wrong_tolerance_is_refused(self, text: str, capsys: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(SystemExit) as ended:
            command.main(["a.mcap", "b.mcap", f"--tolerance={text}"])
        assert ended.value.code == 2
        assert "--tolerance" in capsys.readouterr().err

    def test_the_event_can_be_chosen(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        path = tmp_path / "run.mcap"
        record_run(path, 200)
        assert command.main([str(path), str(path), "--align", "setpoint"]) == 0
        assert "aligned on the first change of a setpoint: 1.0" in capsys.readouterr().out
