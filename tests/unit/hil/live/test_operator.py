"""A page operates a daemon: its requests are passed on, and the daemon's words come back."""

import json

import pytest

from hil.core.errors import OperationError
from hil.live import operator
from hil.live.operator import DaemonOperator
from hil.operation.protocol import Answer, AnyCall, ArmCall


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


@pytest.mark.parametrize("setpoint", ["", "  "])
def test_an_empty_setpoint_is_refused_in_words(setpoint: str) -> None:
    request = {"request": "setpoint", "axis": "vertical", "setpoint": setpoint}
    reply = DaemonOperator("x").ask(request)
    assert reply == {"accepted": False, "text": "the setpoint is empty: enter a position, such as 0.05"}


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
