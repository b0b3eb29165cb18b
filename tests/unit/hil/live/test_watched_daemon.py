"""A daemon that was started without a page, and a page that operates a daemon."""

import json
import math
from pathlib import Path

import pytest

from hil.core.errors import OperationError
from hil.live import operator
from hil.live.operator import DaemonOperator
from hil.live.run import Run
from hil.live.watched_daemon import take_status, watch
from hil.operation.protocol import Answer, AnyCall, ArmCall, AxisStatus, LogLine, Status

AXIS = AxisStatus("vertical", "m", 0.1, 0.09, 0.01, 1.0, 6.0)


def status(time_ns: int, **changed: object) -> Status:
    given: dict[str, object] = {
        "state": "running", "fault": None, "readiness": "both up", "bus": "sim", "is_simulated": True,
        "period": 1, "period_s": 0.0112, "time_ns": time_ns, "max_lateness_ms": 0.2, "missed_periods": 4,
        "rejected_frames": 0, "lost_samples": 0, "recording": None, "axes": (AXIS,),
    }  # fmt: skip
    return Status(**given | changed)  # type: ignore[arg-type]


def test_a_status_becomes_a_row_counts_and_log_entries() -> None:
    run = Run()
    start_ns = 1_700_000_000_000_000_000
    take_status(run, status(start_ns))
    entry = LogLine(start_ns + 2_000_000_000, 30, "adc", "late")
    take_status(run, status(start_ns + 3_000_000_000, log=(entry,), fault="adc: lost"))
    assert run.history is not None
    time_s, lateness_ms, response_ms, state, fresh, *signals = run.history.since(1)[0]
    assert (time_s, lateness_ms, state, fresh) == (3.0, 0.2, 3.0, 1.0)
    assert math.isnan(response_ms)
    assert signals == [0.1, 0.09, 6.0]
    assert list(run.log) == [[2.0, 30, "adc", "late"]]
    assert run.status["counts"]["missed periods"] == 4 and run.status["fault"] == "adc: lost"


def test_numbers_that_are_not_known_are_gaps() -> None:
    run = Run()
    take_status(run, status(0, axes=(AxisStatus("vertical", "m", None, None, None, None, 5.0),)))
    assert run.history is not None
    assert [math.isnan(value) for value in run.history.since(0)[0][5:]] == [True, True, False]


def test_without_a_daemon_the_page_says_so_and_ends(tmp_path: Path) -> None:
    run = Run()
    watch(tmp_path / "none.sock", run, lambda call: call())
    assert run.is_over
    assert "no daemon runs at" in run.log[0][3]


class Daemon:
    """A client that answers, or fails."""

    def __init__(self, answer: Answer | OperationError) -> None:
        self.answer = answer
        self.calls: list[AnyCall] = []

    def answer_to(self, call: AnyCall) -> Answer:
        self.calls.append(call)
        if isinstance(self.answer, OperationError):
            raise self.answer
        return self.answer


def test_a_request_is_passed_on_with_the_daemons_words(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = Daemon(Answer(id=0, accepted=False, text="not ready"))
    monkeypatch.setattr(operator, "connect", lambda _path: daemon)
    assert DaemonOperator("x").ask({"request": "arm"}) == {"accepted": False, "text": "not ready"}
    assert daemon.calls == [ArmCall()]


@pytest.mark.parametrize("name", ["shutdown", "record new", "event", "status", "nonsense", None])
def test_a_page_may_only_operate(name: str | None) -> None:
    with pytest.raises(ValueError, match="is not one of arm"):
        DaemonOperator("x").ask({"request": name})


def test_a_request_with_a_wrong_key_is_no_request() -> None:
    with pytest.raises(ValueError, match="volts"):
        DaemonOperator("x").ask(json.loads('{"request": "jog", "axis": "vertical", "volts": 1}'))


def test_after_the_daemon_has_ended_it_is_connected_again(monkeypatch: pytest.MonkeyPatch) -> None:
    daemons = [
        Daemon(OperationError("the daemon has ended")),
        Daemon(Answer(id=0, accepted=True, text="armed")),
    ]
    monkeypatch.setattr(operator, "connect", lambda _path: daemons.pop(0))
    asked = DaemonOperator("x")
    assert asked.ask({"request": "arm"}) == {"accepted": False, "text": "the daemon has ended"}
    assert asked.ask({"request": "arm"})["accepted"]
