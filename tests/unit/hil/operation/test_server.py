"""The server of the operator's socket: requests, limits and hostile clients, with a made-up loop."""

from __future__ import annotations

import json
import os
import select
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from support.operation_bench import FACTS, TIMEOUT_S, MadeUpLoop, RawClient, served, status

from hil.core.controller_change import PreparedController
from hil.core.errors import DocumentError, OperationError, RequestRefusedError
from hil.core.requests import ControllerRequest
from hil.core.rig import Rig
from hil.host.controller_files import SHIPPED_CONTROLLERS
from hil.operation import peer, request_checks, server
from hil.operation.client import connect
from hil.operation.pipe import Replied
from hil.operation.protocol import (
    MAX_CONNECTIONS,
    MAX_LINE_BYTES,
    MAX_PROBLEM_CHARACTERS,
    PROTOCOL,
    VERSION,
    ArmCall,
    AxisSetpoint,
    ControllerCall,
    EventCall,
    JogCall,
    LoopCall,
    RecordNewCall,
    SetpointCall,
    SetpointsCall,
    ShutdownCall,
)

Bench = tuple[MadeUpLoop, Path]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with served(tmp_path) as made:
        yield made


def test_the_socket_is_for_its_owner_alone(bench: Bench) -> None:
    _, path = bench
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert path.stat().st_uid == os.getuid()


def test_a_client_is_greeted_with_protocol_and_version(bench: Bench) -> None:
    with RawClient(bench[1]) as client:
        assert client.read() == {"protocol": PROTOCOL, "version": VERSION, "hil": FACTS.hil}


def test_a_request_is_answered_with_its_id_and_the_loops_words(bench: Bench) -> None:
    loop, path = bench
    loop.reply = lambda asked: Replied(asked.number, False, "not now")
    with RawClient(path) as client:
        client.read()
        client.send(b'{"request": "arm", "id": 77}\n')
        assert client.read() == {"id": 77, "accepted": False, "text": "not now"}
    (asked,) = loop.asked
    assert asked.call == ArmCall(id=77)
    assert f"process {os.getpid()}" in asked.asked_by


def test_the_client_sends_each_request(bench: Bench, tmp_path: Path) -> None:
    loop, path = bench
    loop.send_status()
    document = (SHIPPED_CONTROLLERS / "ppid.json").read_text()
    (tmp_path / "c.json").write_text(document)
    with connect(path) as client:
        for method in (client.arm, client.start, client.stop, client.disarm, client.reset):
            assert method() == "done"
        client.set_setpoint("vertical", 0.05)
        client.set_setpoint("vertical", "hold")
        client.set_setpoints({"vertical": 0.1, "rotation": "hold"})
        client.set_controller("vertical", tmp_path / "c.json")
        client.jog("rotation", -0.5, 0.2)
        client.record_new()
        client.record_stop()
        assert client.status() == status()
        assert client.rig_text() == FACTS.rig
    kinds = [type(asked.call).__struct_config__.tag for asked in loop.asked]
    assert kinds == [
        *("arm", "start", "stop", "disarm", "reset"),
        *("setpoint", "setpoint", "setpoints", "controller", "jog", "record new", "record stop"),
    ]
    calls: list[LoopCall] = [msgspec.structs.replace(asked.call, id=0) for asked in loop.asked]
    assert calls[5:10] == [
        SetpointCall(axis="vertical", setpoint="step:0.05@0"),
        SetpointCall(axis="vertical", setpoint="hold"),
        SetpointsCall(setpoints=(AxisSetpoint("vertical", "step:0.1@0"), AxisSetpoint("rotation", "hold"))),
        ControllerCall(axis="vertical", name="c.json", document=document),
        JogCall(axis="rotation", offset_v=-0.5, duration_s=0.2),
    ]


def test_the_client_raises_the_daemons_refusal(bench: Bench) -> None:
    loop, path = bench
    loop.reply = lambda asked: Replied(asked.number, False, "arm refused in state offline")
    with connect(path) as client, pytest.raises(RequestRefusedError, match="arm refused in state offline"):
        client.arm()


def test_setpoints_of_a_request_must_be_for_different_axes_and_fit_into_a_message(bench: Bench) -> None:
    loop, path = bench
    twice = SetpointsCall(setpoints=(AxisSetpoint("vertical", "0"), AxisSetpoint("vertical", "0.1")))
    table = "0,0\n" * 10_000
    large = SetpointsCall(
        setpoints=(AxisSetpoint("vertical", "csv:a", table), AxisSetpoint("rotation", "csv:b", table))
    )
    with connect(path) as client:
        assert "vertical is given twice" in client.answer_to(twice).text
        assert "80000 characters together, limit 65536" in client.answer_to(large).text
        assert (
            "no axis 'elbow'" in client.answer_to(SetpointsCall(setpoints=(AxisSetpoint("elbow", "0"),))).text
        )
    assert loop.asked == []


def test_there_is_no_status_before_the_first_period(bench: Bench) -> None:
    with connect(bench[1]) as client, pytest.raises(RequestRefusedError, match="first period"):
        client.status()


def test_watching_yields_the_status_and_the_log_since_the_one_before(bench: Bench) -> None:
    loop, path = bench
    loop.send_log("before the watch")
    loop.send_status()
    with connect(path) as client:
        client.record_new()  # so that the status has arrived
        looks = client.watch(0.05)
        assert next(looks) == status()
        loop.send_log("during the watch")
        loop.send_status(state="armed")
        for look in looks:
            if look.log:
                assert [line.text for line in look.log] == ["during the watch"]
                break
        assert client.arm() == "done", "requests are possible meanwhile"


def test_a_watch_ends_with_the_daemon(tmp_path: Path) -> None:
    with served(tmp_path) as (loop, path):
        loop.send_status()
        with connect(path) as client:
            client.arm()
            looks = client.watch(0.05)
            next(looks)
    assert list(looks)[-1:] in ([], [status()])


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"request": "controller", "axis": "elbow", "name": "c", "document": "{}"}, "no axis 'elbow'"),
        ({"request": "controller", "axis": "verticl", "name": "c", "document": ""}, "did you mean vertical"),
        ({"request": "controller", "axis": "vertical", "name": "c", "document": "{"}, "refused: c: "),
        ({"request": "event", "text": "payload:3"}, "this daemon is on can7"),
    ],
)
def test_what_needs_slow_checks_is_refused_before_the_loop(
    bench: Bench, request_: dict[str, Any], words: str
) -> None:
    loop, path = bench
    with RawClient(path) as client:
        client.read()
        client.send(json.dumps(request_).encode() + b"\n")
        answer = client.read()
    assert answer["accepted"] is False
    assert words in answer["text"]
    assert loop.asked == []


@pytest.mark.parametrize(("axis", "name", "words"), [("rotation", "ppid", "but the axis is in rad")])
def test_a_controller_that_does_not_fit_the_axis_is_refused(
    bench: Bench, axis: str, name: str, words: str
) -> None:
    with connect(bench[1]) as client, pytest.raises(RequestRefusedError, match=words):
        client.set_controller(axis, SHIPPED_CONTROLLERS / f"{name}.json")


def test_a_text_overrides_one_check(bench: Bench) -> None:
    loop, path = bench
    with connect(path) as client:
        assert client.arm(override="SCHED_FIFO") == "done"
        assert client.arm(override=["SCHED_FIFO", "memory-lock"]) == "done"
        with pytest.raises(RequestRefusedError, match="--override foo: no check has this name"):
            client.arm(override="foo")
    assert [asked.call for asked in loop.asked] == [
        ArmCall(id=1, override=("SCHED_FIFO",)),
        ArmCall(id=2, override=("SCHED_FIFO", "memory-lock")),
    ]


def test_the_client_takes_the_names_of_shipped_controllers(bench: Bench) -> None:
    loop, path = bench
    with connect(path) as client:
        assert client.check_controller("vertical", "hls") == "controller hls.json fits"
        assert client.set_controller("vertical", "hls") == "done"
        with pytest.raises(DocumentError, match=r"'ppdi': there is no file ppdi, .*; did you mean ppid\?"):
            client.set_controller("vertical", "ppdi")
    document = (SHIPPED_CONTROLLERS / "hls.json").read_text()
    assert [asked.call for asked in loop.asked] == [
        ControllerCall(id=2, axis="vertical", name="hls.json", document=document)
    ]


def test_an_event_is_checked_by_the_function_that_the_daemon_names(tmp_path: Path) -> None:
    facts = msgspec.structs.replace(FACTS, event_check="hil.core.setpoints:parse_setpoint")
    with served(tmp_path, facts) as (loop, path), connect(path) as client:
        assert client.event("hold") == "done"
        with pytest.raises(RequestRefusedError, match="nonsense"):
            client.event("nonsense")
    assert [type(asked.call) for asked in loop.asked] == [EventCall]


GARBAGE = [
    b"\n",
    b"GET / HTTP/1.1\n",
    b"\x00\xff\xfe\n",
    b"[]\n",
    b'"arm"\n',
    b'{"request": "fly"} {}\n',
    b'{"request": "jog", "axis": "vertical", "offset_v": NaN, "duration_s": 1}\n',
    b'{"request": "jog", "axis": "vertical", "offset_v": 1e999, "duration_s": 1}\n',
    b"[" * 50_000 + b"\n",
    b'{"a":' * 20_000 + b"\n",
    b'{"a":' * 20_000 + b"1" + b"}" * 20_000 + b"\n",
    b'{"request": "jog", "axis": "vertical", "offset_v": ' + b"9" * 100_000 + b', "duration_s": 1}\n',
]

WRONG = [
    (b"{}", "missing key request, which must be 'status' or"),
    (b'{"request": "fly"}', "request is 'fly', but must be 'status' or"),
    (b'{"request": ["jog"]}', "request is a list, but must be a text"),
    (b'{"request": "arm", "please": true}', "arm refused: unknown key please. Valid keys: request, ov"),
    (b'{"request": "arm", "override": [1]}', "arm refused: override[0] is 1, but must be a text"),
    (b'{"request": "arm", "override": "foo"}', "arm refused: override is 'foo', but must be a list"),
    (
        b'{"request": "jog", "axis": "vertical", "offset_v": 1, "duration_s": -1.0}',
        "jog refused: duration_s is -1.0, but must be more than 0.0",
    ),
    (b'{"request": "jog", "axis": "vertical"}', "jog refused: missing keys offset_v, duration_s"),
    (
        b'{"request": "jog", "axis": "vertical", "offset_v": null, "duration_s": 1}',
        "jog refused: offset_v is null, but must be a number",
    ),
    (
        b'{"request": "setpoint", "axis": "", "setpoint": "hold"}',
        "setpoint refused: axis has 0 characters, but must have at least 1",
    ),
    (
        b'{"request": "setpoints", "setpoints": [{"axis": "a", "setpiont": "0"}]}',
        "setpoints refused: setpoints[0]: unknown key setpiont; did you mean setpoint? Valid keys: axis, ",
    ),
    (b'{"request": "event", "text": ""}', "event refused: text has 0 characters, but must have at least 1"),
    (b'{"request": "watch", "interval_s": 1e-9}', "interval_s is 1e-09, but must be at least 0.05"),
    (b'{"request": "event", "text": ' + b"[" * 300 + b"]" * 300 + b"}", "text is a list, but must be a text"),
    (b'{"request": "arm", "' + b"x" * 100_000 + b'": 1}', "arm refused: unknown key xxx"),
]


def test_a_stop_does_not_wait_for_the_check_of_a_controller(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    has_stopped = threading.Event()

    def check(request: ControllerRequest, _rig: Rig) -> PreparedController:
        assert has_stopped.wait(TIMEOUT_S)
        return PreparedController("", "checked at last", None, False)

    monkeypatch.setattr(request_checks, "prepare_controller", check)
    with RawClient(bench[1]) as slow, connect(bench[1]) as other:
        slow.read()
        slow.send(msgspec.json.encode(ControllerCall(axis="vertical", name="c", document="{}")) + b"\n")
        assert other.stop() == "done"
        has_stopped.set()
        assert "checked at last" in slow.read()["text"]


@pytest.mark.parametrize("garbage", GARBAGE)
def test_garbage_is_answered_once_and_ends_the_connection(bench: Bench, garbage: bytes) -> None:
    loop, path = bench
    with RawClient(path) as client:
        client.read()
        client.send(garbage)
        answer = client.read()
        assert answer["accepted"] is False
        assert f"not a request of {PROTOCOL} version {VERSION}" in answer["text"]
        assert client.read() == {}
    with connect(path) as other:
        assert other.arm() == "done"
    assert len(loop.asked) == 1


@pytest.mark.parametrize(("request_", "words"), WRONG)
def test_a_wrong_key_or_value_is_refused_in_words_and_the_connection_goes_on(
    bench: Bench, request_: bytes, words: str
) -> None:
    loop, path = bench
    with RawClient(path) as client:
        client.read()
        client.send(request_.replace(b"{", b'{"id": 7, ', 1).replace(b", }", b"}") + b"\n")
        answer = client.read()
        assert (answer["id"], answer["accepted"]) == (7, False)
        assert words in answer["text"]
        assert len(answer["text"]) <= MAX_PROBLEM_CHARACTERS
        client.send(b'{"request": "arm", "id": 8}\n')
        assert client.read() == {"id": 8, "accepted": True, "text": "done"}
    assert len(loop.asked) == 1


@pytest.mark.parametrize("number", [b"-1", b"true", b"1.5", b"9007199254740993", b'"7"'])
def test_a_request_with_a_wrong_id_is_answered_with_id_0(bench: Bench, number: bytes) -> None:
    with RawClient(bench[1]) as client:
        client.read()
        client.send(b'{"request": "arm", "id": ' + number + b"}\n")
        answer = client.read()
    assert answer["id"] == 0
    assert answer["text"].startswith("arm refused: id is ")


def test_the_client_goes_on_after_a_wrong_value(bench: Bench) -> None:
    with connect(bench[1]) as client:
        with pytest.raises(RequestRefusedError, match=r"^jog refused: duration_s is -1\.0, but must be more"):
            client.jog("vertical", 0.5, -1.0)
        with pytest.raises(RequestRefusedError, match=r"^event refused: text has 0 characters"):
            client.event("")
        assert client.stop() == "done"


def test_an_endless_line_ends_the_connection_and_is_not_kept(bench: Bench) -> None:
    with RawClient(bench[1]) as client:
        client.read()
        block = b"x" * 65536
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            for _ in range(16_384):  # 1 GB
                client.send(block)
    with connect(bench[1]) as other:
        assert other.arm() == "done"


def test_surplus_connections_are_refused(bench: Bench) -> None:
    _, path = bench
    clients = [RawClient(path) for _ in range(MAX_CONNECTIONS)]
    try:
        for client in clients:
            assert "protocol" in client.read()
        for _ in range(200):
            with RawClient(path) as surplus:
                assert "the limit" in surplus.read()["text"]
        with pytest.raises(OperationError, match=f"{MAX_CONNECTIONS} clients are connected"):
            connect(path)
    finally:
        for client in clients:
            client.close()


def other_processes(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Let further clients come from the process with the given number."""

    def become(process_id: int) -> None:
        monkeypatch.setattr(peer, "_CREDENTIALS", _Credentials((process_id, os.getuid(), 0)))

    return become


def test_a_program_that_takes_every_place_does_not_keep_an_operator_out(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    become = other_processes(monkeypatch)
    become(7)
    clients = [RawClient(bench[1]) for _ in range(MAX_CONNECTIONS)]
    try:
        for client in clients:
            assert "protocol" in client.read()
        clients[0].send(b'{"request": "arm"}\n')
        assert clients[0].read()["accepted"]
        become(8)
        with connect(bench[1]) as operator:
            assert operator.stop() == "done"
        assert "idle for longest" in clients[1].read()["text"]
        assert clients[1].read() == {}
        clients[0].send(b'{"request": "stop"}\n')
        assert clients[0].read()["accepted"]
    finally:
        for client in clients:
            client.close()


def test_a_client_whose_place_was_given_away_is_told_so(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop, path = bench
    become = other_processes(monkeypatch)
    become(7)
    client = connect(path)
    updates = client.watch(0.05)
    loop.send_status()
    assert next(updates).state == "ready"
    others = [RawClient(path) for _ in range(MAX_CONNECTIONS - 2)]
    try:
        assert all("protocol" in other.read() for other in others)
        become(8)
        with connect(path) as one, connect(path) as two:
            assert one.stop() == two.stop() == "done"
            with pytest.raises(OperationError, match="idle for longest"):
                client.stop()
            with pytest.raises(RequestRefusedError, match="idle for longest"):
                list(updates)
    finally:
        for other in (client, *others):
            other.close()


def test_a_client_that_leaves_makes_room_for_another(bench: Bench) -> None:
    for _ in range(3 * MAX_CONNECTIONS):
        with connect(bench[1]) as client:
            assert client.arm() == "done"


def test_a_flood_has_one_request_under_way_at_a_time(bench: Bench) -> None:
    loop, path = bench
    loop.reply = lambda _asked: None
    with RawClient(path) as flooding:
        flooding.read()
        flooding.send(b'{"request": "arm"}\n' * 1000)
        with RawClient(path) as other:
            other.read()
            other.send(b'{"request": "stop"}\n')
            while len(loop.asked) < 2:
                loop.send_log("waiting")
                other.socket.settimeout(0.01)
                try:
                    other.socket.recv(1)
                except TimeoutError:
                    continue
    assert len(loop.asked) == 2


def test_a_client_that_reads_nothing_is_disconnected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "WRITE_TIMEOUT_S", 0.05)
    monkeypatch.setattr(server, "MAX_REQUESTS_PER_S", 1e6)
    with served(tmp_path) as (loop, path):
        loop.reply = lambda asked: Replied(asked.number, True, "x" * 20_000)
        with RawClient(path) as client:
            client.read()
            client.send(b'{"request": "arm"}\n' * 100)
            hung_up = select.poll()
            hung_up.register(client.socket, select.POLLHUP)
            assert hung_up.poll(20_000), "the server has disconnected"
            answers = iter(client.read, {})
            assert sum(1 for _ in answers) < 100


def test_the_loop_that_takes_nothing_is_reported(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "REPLY_TIMEOUT_S", 0.05)
    loop, path = bench
    loop.reply = lambda _asked: None
    with connect(path) as client, pytest.raises(RequestRefusedError, match="did not reply within"):
        client.arm()


def test_a_request_that_does_not_fit_a_line_is_not_sent(bench: Bench, tmp_path: Path) -> None:
    long = tmp_path / "long.json"
    long.write_text(" " * (MAX_LINE_BYTES + 1))
    with connect(bench[1]) as client, pytest.raises(OperationError, match=f"limit {MAX_LINE_BYTES}"):
        client.set_controller("vertical", long)


def test_a_user_other_than_owner_and_root_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer, "_CREDENTIALS", _Credentials((1, 4_000_000, 0)))
    with served(tmp_path) as (_, path), pytest.raises(OperationError, match="user uid 4000000 may not"):
        connect(path)


def test_the_name_of_a_program_cannot_forge_who_asked(bench: Bench) -> None:
    loop, path = bench
    own = Path(f"/proc/{os.getpid()}/comm")
    before = own.read_text().rstrip("\n")
    own.write_text("a), b: \x1b[2J\nc")
    try:
        with connect(path) as client:
            client.arm()
    finally:
        own.write_text(before)
    (asked,) = loop.asked
    assert f" (a?? b? ?[2J?c, process {os.getpid()})" in asked.asked_by


class _Credentials:
    size = 12

    def __init__(self, peer: tuple[int, int, int]) -> None:
        self._peer = peer

    def unpack(self, _data: bytes) -> tuple[int, int, int]:
        return self._peer


def test_shutdown_waits_until_the_daemon_has_ended(tmp_path: Path) -> None:
    with served(tmp_path) as (loop, path):

        def reply(asked: Any) -> None:
            loop.send(Replied(asked.number, True, "the daemon ends"))
            loop.end.shutdown(2)

        loop.reply = reply
        with connect(path) as client:
            assert client.shutdown() == "the daemon ends"
    assert [type(asked.call) for asked in loop.asked] == [ShutdownCall]


def test_requests_that_the_loop_does_not_take_before_its_end_are_answered(tmp_path: Path) -> None:
    """A second shutdown gets what it asked for."""
    with served(tmp_path) as (loop, path):
        is_asked = threading.Semaphore(0)
        loop.reply = lambda _asked: is_asked.release()
        with RawClient(path) as first, RawClient(path) as second:
            for client, name in ((first, b"shutdown"), (second, b"arm")):
                client.read()
                client.send(b'{"request": "%s", "id": 1}\n' % name)
                assert is_asked.acquire(timeout=TIMEOUT_S)
            loop.end.shutdown(2)
            assert first.read() == {"id": 1, "accepted": True, "text": "the daemon has ended"}
            assert second.read() == {"id": 1, "accepted": False, "text": server.ENDED}


def test_a_second_shutdown_is_answered_while_the_recording_is_closed(bench: Bench) -> None:
    """The loop takes no requests then."""
    loop, path = bench
    with RawClient(path) as first, RawClient(path) as second:
        for client, text in ((first, "done"), (second, "the daemon is already shutting down")):
            client.read()
            client.send(b'{"request": "shutdown", "id": 1}\n')
            assert client.read() == {"id": 1, "accepted": True, "text": text}
    assert len(loop.asked) == 1


def test_record_new_is_one_request(bench: Bench) -> None:
    loop, path = bench
    with connect(path) as client:
        client.record_new()
    assert [type(asked.call) for asked in loop.asked] == [RecordNewCall]
