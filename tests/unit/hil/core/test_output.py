"""Outputs that are joined, and log entries that are throttled."""

from __future__ import annotations

import math

import pytest

from hil.core.frames import Frame
from hil.core.output import (
    NOTHING,
    AxisSignals,
    Cycle,
    LogEntry,
    LogThrottle,
    Output,
    Severity,
    answer,
    combine,
)
from hil.core.phase import Phase
from hil.core.requests import Reply

ONE, TWO = Frame(1), Frame(2)
ENTRY, OTHER = LogEntry(Severity.INFO, "a", "x"), LogEntry(Severity.FATAL, "b", "y")
SIGNALS = AxisSignals(0.0, 0.0, 0.0, 0.0, 5.0, math.nan)
CYCLE, LATER = Cycle(1, 2, 3, 4, 0, True, (SIGNALS,)), Cycle(2, 3, 4, 5, 0, True, (SIGNALS,))


class TestCombine:
    def test_nothing_is_joined_to_nothing(self) -> None:
        assert combine() is NOTHING
        assert combine(NOTHING, NOTHING) is NOTHING
        assert Output() == NOTHING

    def test_a_single_output_is_returned_itself(self) -> None:
        output = Output((ONE,), (ENTRY,), CYCLE)
        assert combine(NOTHING, output, NOTHING) is output

    def test_frames_and_log_entries_keep_their_order(self) -> None:
        joined = combine(Output((ONE,), (ENTRY,)), NOTHING, Output((TWO, ONE), (OTHER,)), Output((TWO,)))
        assert joined == Output((ONE, TWO, ONE, TWO), (ENTRY, OTHER))

    def test_a_cycle_is_kept(self) -> None:
        with_cycle = Output(cycle=CYCLE)
        assert combine(with_cycle, Output((ONE,))) == Output((ONE,), (), CYCLE)
        assert combine(Output((ONE,)), with_cycle) == Output((ONE,), (), CYCLE)

    def test_of_two_cycles_the_later_is_kept(self) -> None:
        assert combine(Output(cycle=CYCLE), Output(cycle=LATER)).cycle is LATER

    def test_of_two_replies_the_later_is_kept(self) -> None:
        first, later = Reply(True, "a"), Reply(False, "b")
        assert combine(Output(reply=first), Output((ONE,))).reply is first
        assert combine(Output((ONE,)), Output(reply=later)).reply is later
        assert combine(Output(reply=first), Output(reply=later)).reply is later


def test_severities_are_the_levels_of_ros_logs() -> None:
    assert {severity.name: severity.value for severity in Severity} == {
        "INFO": 20,
        "WARNING": 30,
        "ERROR": 40,
        "FATAL": 50,
    }


class TestLogThrottle:
    def test_the_first_eight_and_then_powers_of_two_are_reported(self) -> None:
        throttle = LogThrottle()
        reported = [number for number in range(1, 101) if throttle.should_report("x")]
        assert reported == [*range(1, 9), 16, 32, 64]

    def test_kinds_are_counted_apart(self) -> None:
        throttle = LogThrottle()
        for _ in range(9):
            throttle.should_report("x")
        assert throttle.should_report("y")

    def test_after_a_reset_entries_are_reported_again(self) -> None:
        throttle = LogThrottle()
        for _ in range(9):
            throttle.should_report("x")
        throttle.reset()
        assert throttle.should_report("x")

    def test_a_report_is_an_output_with_the_entry(self) -> None:
        assert LogThrottle().report(Severity.INFO, "a", "x") == Output(log=(ENTRY,))

    def test_by_default_entries_of_one_severity_and_source_are_one_kind(self) -> None:
        throttle = LogThrottle()
        for number in range(9):
            output = throttle.report(Severity.INFO, "a", str(number))
        assert output is NOTHING
        assert throttle.report(Severity.WARNING, "a", "x") is not NOTHING
        assert throttle.report(Severity.INFO, "b", "x") is not NOTHING
        assert throttle.report(Severity.INFO, "a", "x", kind="other") is not NOTHING


@pytest.mark.parametrize(("accepted", "severity"), [(True, Severity.INFO), (False, Severity.WARNING)])
def test_the_answer_to_a_request_is_a_log_entry_of_its_axis(accepted: bool, severity: Severity) -> None:
    reply = Reply(accepted, "text")
    assert answer("vertical", reply) == Output(log=(LogEntry(severity, "vertical", "text"),), reply=reply)


def test_an_axis_that_is_not_excited_has_no_phase() -> None:
    assert SIGNALS.phase == Phase.NONE == 0
