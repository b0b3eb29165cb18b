"""The process that keeps the server of the operator's socket alive. No process is started here."""

from __future__ import annotations

import io
import os
import signal
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
from support.operation_bench import FACTS

from hil.operation import server_process
from hil.operation.pipe import Logged, pipe

KILLED, FAILED, DONE = int(signal.SIGKILL), 256, 0
SUSPENDED = signal.SIGSTOP << 8 | 0x7F
"""Statuses of waitpid."""


class Keeper:
    """The keeper's world: children that end with given statuses, and a clock that sleeping advances."""

    def __init__(self, lives: list[tuple[float, int]]) -> None:
        self.lives = iter(lives)
        self.now_s = 100.0
        self.slept: list[float] = []

    def wait(self, _child: int, _options: int) -> tuple[int, int]:
        life_s, status = next(self.lives)
        self.now_s += life_s
        return 7, status

    def sleep(self, duration_s: float) -> None:
        self.slept.append(duration_s)
        self.now_s += duration_s


@pytest.fixture
def ends(tmp_path: Path) -> Iterator[tuple[socket.socket, list[str]]]:
    """The loop's end of the pipe, and the arguments of the process."""
    ours, theirs = pipe()
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(str(tmp_path / "s"))
    listener.listen()
    yield ours, [str(listener.detach()), str(theirs.detach())]
    ours.close()


def run_keeper(
    monkeypatch: pytest.MonkeyPatch, arguments: list[str], lives: list[tuple[float, int]]
) -> Keeper:
    keeper = Keeper(lives)
    stdin = SimpleNamespace(buffer=io.BytesIO(msgspec.json.encode(FACTS)))
    monkeypatch.setattr(server_process.sys, "stdin", stdin)
    monkeypatch.setattr(server_process.signal, "signal", lambda *_: None)
    monkeypatch.setattr(server_process.time, "sleep", keeper.sleep)
    monkeypatch.setattr(server_process.time, "monotonic", lambda: keeper.now_s)
    monkeypatch.setattr(os, "nice", lambda _: 0)
    monkeypatch.setattr(os, "fork", lambda: 7)
    monkeypatch.setattr(os, "waitpid", keeper.wait)
    server_process.main(arguments)
    return keeper


def reports(end: socket.socket) -> list[str]:
    found = []
    while data := end.recv(65536):  # the keeper has closed its end
        found.append(msgspec.msgpack.decode(data, type=Logged).line.text)
    return found


def test_the_keeper_ends_with_the_loop(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[socket.socket, list[str]]
) -> None:
    ours, arguments = ends
    assert run_keeper(monkeypatch, arguments, [(5.0, DONE)]).slept == []
    assert reports(ours) == []


def test_a_server_that_ends_is_started_again_and_reported(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[socket.socket, list[str]]
) -> None:
    ours, arguments = ends
    lives = [(60.0, KILLED), (0.1, FAILED), (0.1, FAILED), (60.0, KILLED), (1.0, DONE)]
    assert run_keeper(monkeypatch, arguments, lives).slept == [0.2, 0.4, 0.8, 0.2]
    texts = reports(ours)
    assert len(texts) == 4
    assert "(killed by signal 9); it is started again" in texts[0]
    assert "(exit status 1)" in texts[1]


def test_a_server_that_is_suspended_is_killed_and_started_again(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[socket.socket, list[str]]
) -> None:
    ours, arguments = ends
    killed: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "kill", lambda *call: killed.append(call))
    run_keeper(monkeypatch, arguments, [(5.0, SUSPENDED), (0.0, KILLED), (1.0, DONE)])
    assert killed == [(7, signal.SIGKILL)]
    (text,) = reports(ours)
    assert "(killed by signal 9); it is started again" in text


def test_servers_that_fail_at_once_are_started_ever_more_slowly(
    monkeypatch: pytest.MonkeyPatch, ends: tuple[socket.socket, list[str]]
) -> None:
    keeper = run_keeper(monkeypatch, ends[1], [(0.0, FAILED)] * 10 + [(0.0, DONE)])
    assert keeper.slept[-1] == server_process.MAX_RESTART_DELAY_S


class _Exit(BaseException):
    pass


@pytest.mark.parametrize(("is_broken", "status"), [(False, 0), (True, 1)])
def test_the_child_serves_until_the_loop_ends(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    is_broken: bool,
    status: int,
) -> None:
    exited: list[int] = []

    def leave(code: int) -> None:
        exited.append(code)
        raise _Exit

    monkeypatch.setattr(os, "_exit", leave)
    monkeypatch.setattr(server_process.ctypes, "CDLL", lambda _: SimpleNamespace(prctl=lambda *_: 0))
    ours, theirs = pipe()
    facts = msgspec.structs.replace(FACTS, rig="no rig") if is_broken else FACTS
    with socket.socket(socket.AF_UNIX) as listener, theirs:
        listener.bind(str(tmp_path / "s"))
        listener.listen()
        ours.close()
        with pytest.raises(_Exit):
            server_process._serve(listener, theirs, facts)
    assert exited == [status]
    assert ("Traceback" in capsys.readouterr().err) is is_broken
