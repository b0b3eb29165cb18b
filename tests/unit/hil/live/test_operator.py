"""A page operates a daemon: its requests are passed on, and the daemon's words come back."""

import asyncio
import json
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from hil.core.errors import OperationError
from hil.live import operator
from hil.live.operator import MAX_JOG_AGE_S, DaemonOperator
from hil.operation.client import Client
from hil.operation.protocol import Answer, AnyCall, ArmCall, JogCall, StartCall, StopCall

WAIT_S = 60.0
JOG = {"request": "jog", "axis": "vertical", "offset_v": 0.5, "duration_s": 0.2}
ARMED = Answer(id=0, accepted=True, text="armed")


class Connection:
    """A client that answers, or fails."""

    def __init__(self, answer: Answer | OperationError = ARMED) -> None:
        self.answer = answer
        self.calls: list[AnyCall] = []
        self.closed = threading.Event()

    def answer_to(self, call: AnyCall) -> Answer:
        self.calls.append(call)
        if isinstance(self.answer, OperationError):
            raise self.answer
        return self.answer

    def close(self) -> None:
        self.closed.set()


class Daemon:
    """A daemon that notes all requests, and does not answer those of a kind until it is released."""

    def __init__(self, slow: type[AnyCall]) -> None:
        self.slow = slow
        self.calls: list[AnyCall] = []
        self.is_asked, self.is_released = threading.Event(), threading.Event()

    def connect(self, _path: Path) -> "Daemon":
        return self

    def answer_to(self, call: AnyCall) -> Answer:
        self.calls.append(call)
        if isinstance(call, self.slow):
            self.is_asked.set()
            assert self.is_released.wait(WAIT_S)
        return ARMED

    def close(self) -> None:
        pass


def ask(asked: DaemonOperator, request: Mapping[str, Any]) -> dict[str, Any]:
    return asyncio.run(asked.ask(request))


@pytest.fixture
def now_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Give the time of the server's clock."""
    time_s = [1000.0]
    monkeypatch.setattr(operator, "monotonic", lambda: time_s[0])
    return time_s


def test_a_request_is_passed_on_with_the_daemons_words(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = Connection(Answer(id=0, accepted=False, text="not ready"))
    monkeypatch.setattr(operator, "connect", lambda _path: daemon)
    assert ask(DaemonOperator("x"), {"request": "arm"}) == {"accepted": False, "text": "not ready"}
    assert daemon.calls == [ArmCall()]


@pytest.mark.parametrize("name", ["shutdown", "record new", "event", "status", "nonsense", None])
def test_a_page_may_only_operate(name: str | None) -> None:
    with pytest.raises(ValueError, match="is not one of arm"):
        ask(DaemonOperator("x"), {"request": name})


@pytest.mark.parametrize("setpoint", ["", "  "])
def test_an_empty_setpoint_is_refused_in_words(setpoint: str) -> None:
    request = {"request": "setpoint", "axis": "vertical", "setpoint": setpoint}
    reply = ask(DaemonOperator("x"), request)
    assert reply == {"accepted": False, "text": "the setpoint is empty: enter a position, such as 0.05"}


def test_a_request_with_a_wrong_key_is_no_request() -> None:
    with pytest.raises(ValueError, match="volts"):
        ask(
            DaemonOperator("x"),
            json.loads('{"request": "jog", "axis": "vertical", "volts": 1, "beat_s": 1}'),
        )


def test_after_the_daemon_has_ended_it_is_connected_again(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = Connection(OperationError("the daemon has ended"))
    daemons = [ended, Connection()]
    monkeypatch.setattr(operator, "connect", lambda _path: daemons.pop(0))
    asked = DaemonOperator("x")
    assert ask(asked, {"request": "arm"}) == {"accepted": False, "text": "the daemon has ended"}
    assert ended.closed.is_set()
    assert ask(asked, {"request": "arm"})["accepted"]


def test_stop_is_given_again_if_its_idle_connection_was_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    daemons = [Connection(), Connection()]
    first, second = daemons
    monkeypatch.setattr(operator, "connect", lambda _path: daemons.pop(0))
    asked = DaemonOperator("x")
    assert ask(asked, {"request": "stop"})["accepted"]
    first.answer = OperationError("this client was idle for longest")
    assert ask(asked, {"request": "stop"})["accepted"]
    assert second.calls == [StopCall()]


@pytest.mark.parametrize("age_s", [MAX_JOG_AGE_S + 0.01, 5.0, -1.0, float("nan")])
def test_an_old_jog_is_not_given(monkeypatch: pytest.MonkeyPatch, now_s: list[float], age_s: float) -> None:
    daemon = Connection()
    monkeypatch.setattr(operator, "connect", lambda _path: daemon)
    asked = DaemonOperator("x")
    reply = ask(asked, {**JOG, "beat_s": now_s[0] - age_s})
    assert not reply["accepted"] and reply["text"].startswith("jog was not given to the daemon: it is")
    assert daemon.calls == []
    assert ask(asked, {**JOG, "beat_s": now_s[0] - 0.9 * MAX_JOG_AGE_S})["accepted"]
    assert daemon.calls == [JogCall(axis="vertical", offset_v=0.5, duration_s=0.2)]


def test_a_jog_without_a_beat_is_no_request() -> None:
    with pytest.raises(KeyError, match="beat_s"):
        ask(DaemonOperator("x"), JOG)


def test_a_jog_that_waits_for_the_connection_is_not_given(
    monkeypatch: pytest.MonkeyPatch, now_s: list[float]
) -> None:
    daemon = Connection()

    def connect(_path: Path) -> Connection:
        now_s[0] += 2.0  # the daemon was suspended
        return daemon

    monkeypatch.setattr(operator, "connect", connect)
    reply = ask(DaemonOperator("x"), {**JOG, "beat_s": now_s[0]})
    assert not reply["accepted"] and "it is 2.0 s old, limit 0.3 s" in reply["text"]
    assert daemon.calls == []


def test_jogs_that_wait_for_the_answer_to_another_are_not_given(
    monkeypatch: pytest.MonkeyPatch, now_s: list[float]
) -> None:
    daemon = Daemon(slow=JogCall)
    monkeypatch.setattr(operator, "connect", daemon.connect)

    async def burst() -> list[dict[str, Any]]:
        asked = DaemonOperator("x")
        jogs = [asyncio.create_task(asked.ask({**JOG, "beat_s": now_s[0]})) for _ in range(20)]
        await asyncio.to_thread(daemon.is_asked.wait, WAIT_S)
        now_s[0] += 5.0
        daemon.is_released.set()
        return await asyncio.gather(*jogs)

    assert [reply["accepted"] for reply in asyncio.run(burst())] == [True, *19 * [False]]
    assert len(daemon.calls) == 1


def test_stop_waits_for_no_other_request_and_cancels_those_that_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = Daemon(slow=ArmCall)
    monkeypatch.setattr(operator, "connect", daemon.connect)

    async def press() -> None:
        asked = DaemonOperator("x")
        arm = asyncio.create_task(asked.ask({"request": "arm"}))
        start = asyncio.create_task(asked.ask({"request": "start"}))
        await asyncio.to_thread(daemon.is_asked.wait, WAIT_S)
        assert (await asyncio.wait_for(asked.ask({"request": "stop"}), WAIT_S))["accepted"]
        assert not daemon.is_released.is_set()
        daemon.is_released.set()
        assert (await arm)["accepted"]
        assert await start == {
            "accepted": False,
            "text": "start was not given to the daemon: Stop was pressed after it; press it again",
        }

    try:
        asyncio.run(press())
    finally:
        daemon.is_released.set()
    assert daemon.calls == [ArmCall(), StopCall()]


def test_stop_is_given_again_after_a_start_that_was_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = Daemon(slow=StartCall)
    monkeypatch.setattr(operator, "connect", daemon.connect)

    async def press() -> None:
        asked = DaemonOperator("x")
        start = asyncio.create_task(asked.ask({"request": "start"}))
        await asyncio.to_thread(daemon.is_asked.wait, WAIT_S)
        await asked.ask({"request": "stop"})
        daemon.is_released.set()
        await start
        assert asked._last_stop is not None
        await asyncio.wrap_future(asked._last_stop)

    asyncio.run(press())
    assert daemon.calls == [StartCall(), StopCall(), StopCall()]


def test_stops_that_wait_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = Daemon(slow=StopCall)
    monkeypatch.setattr(operator, "connect", daemon.connect)

    async def press() -> list[dict[str, Any]]:
        asked = DaemonOperator("x")
        first = asyncio.create_task(asked.ask({"request": "stop"}))
        await asyncio.to_thread(daemon.is_asked.wait, WAIT_S)
        others = [asyncio.create_task(asked.ask({"request": "stop"})) for _ in range(50)]
        await asyncio.sleep(0)
        daemon.is_released.set()
        return await asyncio.gather(first, *others)

    assert all(reply["accepted"] for reply in asyncio.run(press()))
    assert len(daemon.calls) == 2


def test_disconnecting_does_not_wait_for_a_request(monkeypatch: pytest.MonkeyPatch) -> None:
    released, asked_for = threading.Event(), threading.Event()
    daemon = Connection()

    def connect(_path: Path) -> Client:
        asked_for.set()
        assert released.wait(WAIT_S)  # for the greeting of a daemon
        return daemon  # type: ignore[return-value]

    monkeypatch.setattr(operator, "connect", connect)

    async def restart() -> None:
        asked = DaemonOperator("x")
        arm = asyncio.create_task(asked.ask({"request": "arm"}))
        await asyncio.to_thread(asked_for.wait, WAIT_S)
        disconnecting = threading.Thread(target=asked.disconnect, daemon=True)
        disconnecting.start()
        await asyncio.to_thread(disconnecting.join, WAIT_S)
        assert not disconnecting.is_alive() and not released.is_set()
        released.set()
        assert (await arm)["accepted"]
        assert await asyncio.to_thread(daemon.closed.wait, WAIT_S)

    try:
        asyncio.run(restart())
    finally:
        released.set()
