"""The fuzzer finds planted defects, repeats itself, and writes a short file that can be run again."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fuzz import wire
from fuzz.fuzzer import Failure, run_sequence, search
from fuzz.minimiser import minimise
from fuzz.sequence_file import read_sequence, write_failure
from hil.core import (
    axis_loops,
    board_watch,
    envelope,
    foreign_frames,
    gateway,
    hardware_protection,
    jogging,
    operating_state,
    sample_guard,
    sync_matching,
    valve_commands,
    watched_input,
)
from hil.core.frames import Frame
from hil.core.output import NOTHING, Output

Patch = Callable[[pytest.MonkeyPatch], None]


def _rate(patch: pytest.MonkeyPatch) -> None:
    command = valve_commands.ValveCommands.command

    def faster(self: Any, index: int, offset_v: float) -> float:
        self._change_time_s *= 1.02
        return command(self, index, offset_v)

    patch.setattr(valve_commands.ValveCommands, "command", faster)


def _longer_change_time(patch: pytest.MonkeyPatch) -> None:
    def set_change_time(self: Any, elapsed_s: float) -> None:
        self._change_time_s = self._period_s

    patch.setattr(valve_commands.ValveCommands, "set_change_time", set_change_time)


def _magnitude(patch: pytest.MonkeyPatch) -> None:
    init = valve_commands.ValveCommands.__init__

    def wider(self: Any, *arguments: Any) -> None:
        init(self, *arguments)
        self._max_v = tuple(limit_v + wire.COUNT_V for limit_v in self._max_v)

    patch.setattr(valve_commands.ValveCommands, "__init__", wider)


def _open_in_fault(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(axis_loops.AxisLoops, "centre", axis_loops.AxisLoops.command)


def _checksum_ignored(patch: pytest.MonkeyPatch) -> None:
    check = sample_guard.SampleGuard._check_integrity

    def only_length(self: Any, data: bytes) -> Any:
        verdict = check(self, data)
        return None if verdict is not None and "CRC" in verdict.reason else verdict

    patch.setattr(sample_guard.SampleGuard, "_check_integrity", only_length)


def _old_samples(patch: pytest.MonkeyPatch) -> None:
    match = sync_matching.SyncMatcher.match

    def always_fresh(self: Any, step: int, now_ns: int) -> Any:
        match(self, step, now_ns)
        return sync_matching.FRESH

    patch.setattr(sync_matching.SyncMatcher, "match", always_fresh)


def _unguarded_identifier(patch: pytest.MonkeyPatch) -> None:
    patch.delitem(foreign_frames.COMMANDS_TO_BOARDS, 0x520)


def _stop_ignored(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(hardware_protection.HardwareProtection, "_check_emergency_stop", lambda self, now: NOTHING)


def _enable_ignored(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(hardware_protection.HardwareProtection, "_check_enable", lambda self, now_ns: NOTHING)


def _valves_ignored(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(hardware_protection.HardwareProtection, "_check_valves", lambda self: NOTHING)


def _contact_never_opens_by_time(patch: pytest.MonkeyPatch) -> None:
    problem = watched_input.WatchedInput.problem
    patch.setattr(
        watched_input.WatchedInput, "problem", lambda self, now: problem(self, self._closed_ns or now)
    )


def _no_envelope(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(envelope.Envelope, "check", lambda self, t, y, error, offset_v: None)


def _no_standstill(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(envelope.Envelope, "_check_still", lambda self, t, y, offset_v: None)


def _infinite(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(axis_loops.math, "isfinite", lambda value: True)


def _late_fault(patch: pytest.MonkeyPatch) -> None:
    init = gateway.Gateway.__init__

    def patient(self: Any, *arguments: Any) -> None:
        init(self, *arguments)
        self._stale_periods._limit += 1

    patch.setattr(gateway.Gateway, "__init__", patient)


def _heartbeat(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(board_watch.BoardWatch, "check_timeout", lambda self, now_ns: None)


def _jog_without_limit(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(jogging, "limits_refusal", lambda request, axis: None)


def _endless_jog(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(jogging.Jogging, "begin_period", lambda self, now_ns: NOTHING)


def _repeated_counter(patch: pytest.MonkeyPatch) -> None:
    frame = valve_commands.ValveCommands.frame

    def same(self: Any) -> Frame:
        self._counter &= 0x7F
        return frame(self)

    patch.setattr(valve_commands.ValveCommands, "frame", same)


def _fault_without_centre(patch: pytest.MonkeyPatch) -> None:
    fault = operating_state.OperatingState.fault

    def silent(self: Any, source: str, reason: str) -> Output:
        return fault(self, source, reason)._replace(frames=())

    patch.setattr(operating_state.OperatingState, "fault", silent)


DEFECTS: dict[str, tuple[Patch, set[str]]] = {
    "the rate limit is 2 % too wide": (_rate, {"rate"}),
    "a command after half a period may change as after a whole one": (_longer_change_time, {"rate"}),
    "the magnitude limit is one count too wide": (_magnitude, {"magnitude"}),
    "the centring command holds the last voltages": (_open_in_fault, {"centre"}),
    "the checksum of a sample is ignored": (_checksum_ignored, {"answer"}),
    "the age of a sample is ignored": (_old_samples, {"answer"}),
    "RPDO4 to the valve board is ignored": (_unguarded_identifier, {"fault"}),
    "the emergency stop is ignored": (_stop_ignored, {"fault", "answer"}),
    "the enable switch is ignored": (_enable_ignored, {"stop"}),
    "the read-back of the valves is ignored": (_valves_ignored, {"fault"}),
    "a contact stays closed without frames": (
        _contact_never_opens_by_time,
        {"fault", "answer", "life cycle"},
    ),
    "the envelope is ignored": (_no_envelope, {"fault"}),
    "the standstill of an axis is ignored": (_no_standstill, {"fault"}),
    "an output that is no number is not noticed": (_infinite, {"number", "exception ValueError"}),
    "samples may be missing for one period more": (_late_fault, {"fault"}),
    "the heartbeat's timeout is ignored": (_heartbeat, {"fault"}),
    "a jog has no limits": (_jog_without_limit, {"life cycle"}),
    "a jog has no end": (_endless_jog, {"stop"}),
    "the counter of the commands loses a bit": (_repeated_counter, {"frame"}),
    "a fault sends no command": (_fault_without_centre, {"centre", "SYNC"}),
}


def find(patch: pytest.MonkeyPatch, defect: Patch) -> Failure:
    """Return what the search finds in a gateway with a planted defect."""
    defect(patch)
    result = search(200_000, seed=1)
    assert result.failure is not None, f"not found in {result.inputs} inputs"
    return result.failure


@pytest.mark.parametrize("name", DEFECTS)
def test_a_planted_defect_is_found(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    defect, rules = DEFECTS[name]
    assert find(monkeypatch, defect).rule in rules


def test_a_failure_becomes_a_short_file_that_fails_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        failure = minimise(find(patch, _unguarded_identifier))
        path = write_failure(failure, tmp_path / "failures", seed=7)
        again = run_sequence(read_sequence(path))
        assert again is not None
        assert again.rule == failure.rule == json.loads(path.read_text())["rule"] == "fault"
    assert [step[0] for step in failure.sequence.steps] == ["bring up", "frame"]
    assert failure.sequence.steps[1][1:] == [0x520, "", 0] or failure.sequence.steps[1][1] == 0x520
    assert path.name == "fault-7.json"
    assert run_sequence(read_sequence(path)) is None, "the gateway without the defect"


def test_an_exception_of_the_gateway_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: object, now_ns: int) -> Output:
        raise ZeroDivisionError("planted")

    monkeypatch.setattr(gateway.Gateway, "on_deadline", fail)
    result = search(10, seed=1)
    assert result.failure is not None
    assert result.failure.text == "ZeroDivisionError: planted"


def test_the_same_seed_gives_the_same_search() -> None:
    first, second, other = search(3000, seed=5), search(3000, seed=5), search(3000, seed=6)
    assert (first.inputs, first.sequences, first.open_commands) == (
        second.inputs,
        second.sequences,
        second.open_commands,
    )
    assert (first.inputs, first.open_commands) != (other.inputs, other.open_commands)
