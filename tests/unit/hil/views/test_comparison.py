"""Comparison of two recordings: alignment, differences and where they are, tolerances."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
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
from hil.views import comparison_windows
from hil.views.comparison import SignalDifference, compare
from hil.views.comparison_windows import Event

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
    assert comparison.samples == 300
    assert (comparison.from_s, comparison.to_s) == pytest.approx((0.0, 299 * PERIOD_S))
    assert comparison.documents == ()
    assert comparison.first_controlled_s == pytest.approx(299 * PERIOD_S)


def test_the_largest_difference_and_its_place_are_found(run: Callable[..., Path]) -> None:
    first, second = run("a.mcap", bumped(2.0, 0.004)), run("b.mcap", armed=9)
    rows = found(first, second)
    position = rows["vertical", "position"]
    assert position.largest == pytest.approx(0.004)
    assert position.at_s == pytest.approx(2.0, abs=PERIOD_S / 2)
    assert position.first - position.second == pytest.approx(0.004)
    assert position.rms == pytest.approx(0.004 / math.sqrt(300))
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


def test_a_value_in_one_run_alone_is_counted_and_exceeds_every_tolerance(run: Callable[..., Path]) -> None:
    nowhere = CENTRED._replace(position=math.nan)
    first = run("a.mcap", lambda t: nowhere if 1.0 < t < 1.01 else CENTRED)
    second = run("b.mcap", lambda t: CENTRED)
    position = found(first, second)["vertical", "position"]
    assert (position.only_first, position.only_second, position.largest) == (0, 1, 0.0)
    comparison = compare(Recording(first), Recording(second))
    assert {row.signal for row in comparison.exceeding({"position": 1e9})} == {"position"}
    assert comparison.exceeding({}) == []
    same = found(first, first)["vertical", "position"]
    assert (same.only_first, same.only_second, same.largest) == (0, 0, 0.0)


def test_a_signal_that_one_run_lacks_has_no_difference(
    run: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """An imported bus log has no setpoint."""
    unknown = CENTRED._replace(setpoint=math.nan, error=math.nan)
    first, second = run("a.mcap"), run("b.mcap", lambda t: unknown)
    row = found(first, second)["vertical", "setpoint"]
    assert math.isnan(row.largest) and math.isnan(row.rms)
    assert (row.only_first, row.only_second) == (300, 0)
    assert command.main([str(first), str(second)]) == 0
    out = capsys.readouterr().out
    assert "only the first run has vertical setpoint in 300 of 300 periods" in out
    assert "inf" not in out and "nan" not in out
    assert command.main([str(first), str(second), "--tolerance", "setpoint=1"]) == 1
    assert "exceeded   vertical setpoint: only one run has a value in 300 of 300" in capsys.readouterr().out


def record_with_lateness(path: Path, lateness_ns: Callable[[int], int], periods: int = 300) -> Path:
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, periods, SLOW, lateness_ns=lateness_ns)
    record_periods(recorder, 50, lambda t: CENTRED, first=periods, state=LifeCycleState.ARMED)
    recorder.close({})
    return path


def test_late_wake_ups_do_not_shift_the_alignment(tmp_path: Path) -> None:
    """The event's own period begins 0.9 periods late, and so does every seventh."""
    late_ns = round(0.9 * PERIOD_S * 1e9)
    first = record_with_lateness(tmp_path / "a.mcap", lambda number: 0)
    second = record_with_lateness(tmp_path / "b.mcap", lambda number: 0 if number % 7 else late_ns)
    for one, other in ((first, second), (second, first)):
        comparison = compare(Recording(one), Recording(other))
        assert comparison.samples == 300
        assert {row.largest for row in comparison.signals} == {0.0}


def test_the_estimated_start_of_an_imported_log_is_moved(run: Callable[..., Path]) -> None:
    """Its state running begins with the first command that opens a valve, four periods late here."""
    first = run("a.mcap")
    header = msgspec.structs.replace(RUN_HEADER, metadata={"imported": {"file": "run.log"}})
    second = first.with_name("b.mcap")
    with in_memory(second):
        recorder = Recorder(second, header, lossless=True)
    record_periods(recorder, 3, lambda t: CENTRED, first=-3, state=LifeCycleState.ARMED)
    record_periods(recorder, 4, SLOW, state=LifeCycleState.ARMED)
    record_periods(recorder, 296, SLOW, first=4)
    recorder.close({})
    for one, other, shift in ((first, second, -4), (second, first, 4)):
        comparison = compare(Recording(one), Recording(other))
        assert comparison.shift_periods == shift
        assert comparison.samples == 296
        assert {row.largest for row in comparison.signals} == {0.0}


def test_periods_after_the_end_of_control_are_not_compared(tmp_path: Path) -> None:
    first = record_with_lateness(tmp_path / "a.mcap", lambda number: 0)
    second = record_with_lateness(tmp_path / "b.mcap", lambda number: 0, periods=200)
    comparison = compare(Recording(first), Recording(second))
    assert comparison.samples == 200
    assert comparison.to_s == pytest.approx(199 * PERIOD_S)
    assert (comparison.first_controlled_s, comparison.second_controlled_s) == pytest.approx(
        (299 * PERIOD_S, 199 * PERIOD_S)
    )


def test_windows_give_the_result_of_the_whole(
    run: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = run("a.mcap", bumped(2.0, 0.004)), run("b.mcap", armed=9)
    for event in (None, Event.SETPOINT):
        whole = compare(Recording(first), Recording(second), event)
        monkeypatch.setattr(comparison_windows, "WINDOW_S", 0.3)
        parted = compare(Recording(first), Recording(second), event)
        monkeypatch.undo()
        assert [row.rms for row in parted.signals] == pytest.approx([row.rms for row in whole.signals])
        assert [replace(row, rms=0.0) for row in parted.signals] == [
            replace(row, rms=0.0) for row in whole.signals
        ]
        assert (parted.samples, parted.from_s, parted.to_s) == (whole.samples, whole.from_s, whole.to_s)


def test_what_else_differs_is_named(run: Callable[..., Path]) -> None:
    attachments = {**RUN_HEADER.attachments, "arm.dbc": ("text/plain", b"other")}
    other = msgspec.structs.replace(
        RUN_HEADER,
        attachments=attachments,
        axes=AXES[1:],
        metadata={
            "setpoints": {"vertical": "hold"},
            "arm events": {"payload:3": "4.0"},
        },
    )
    comparison = compare(Recording(run("a.mcap")), Recording(run("b.mcap", header=other)))
    assert comparison.documents == ("arm.dbc",)
    assert comparison.settings == (
        "setpoint of vertical (step:0.1@1, hold)",
        "arm event payload:3 (none, 4.0)",
    )
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
            line.split()[:4] == ["vertical", "position", "(m)", "0.000231"] for line in out.splitlines()
        )
        assert max(len(line) for line in out.splitlines()) <= 80

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

    def test_an_exceeded_signal_has_the_name_that_the_option_takes(
        self, run: Callable[..., Path], capsys: pytest.CaptureFixture[str]
    ) -> None:
        files = [str(run("a.mcap", bumped(2.0, 0.004))), str(run("b.mcap"))]
        assert command.main([*files, "--tolerance", "valve=0.01"]) == 1
        printed = capsys.readouterr().out
        assert "exceeded   rotation valve: 0.04" in printed
        assert "command_v" not in printed

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
