"""Notifications to systemd, with this process in its place."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hil.core.life_cycle import LifeCycleState
from hil.core.output import Cycle
from hil.operation.systemd import Notifier
from hil.shells.watchdog import WatchdogObserver

SECOND_NS = 1_000_000_000


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(str(tmp_path / "notify"))
        end.setblocking(False)
        yield end


def received(end: socket.socket) -> list[str]:
    found = []
    while True:
        try:
            found.append(end.recv(4096).decode())
        except BlockingIOError:
            return found


def cycle(number: int, wake_ns: int) -> Cycle:
    return Cycle(number, wake_ns, wake_ns, 0, 0, False, ())


def gateway(state: LifeCycleState) -> Any:
    return SimpleNamespace(state=state)


def test_assignments_are_lines_of_one_message(systemd: socket.socket) -> None:
    with Notifier({"NOTIFY_SOCKET": systemd.getsockname()}) as notifier:
        notifier.send("READY=1", "STATUS=ready")
    assert received(systemd) == ["READY=1\nSTATUS=ready"]


def test_an_abstract_socket_is_written_with_an_at_sign() -> None:
    name = f"hil-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        end.bind(f"\0{name}")
        end.setblocking(False)
        with Notifier({"NOTIFY_SOCKET": f"@{name}"}) as notifier:
            notifier.send("STOPPING=1")
        assert received(end) == ["STOPPING=1"]


def test_without_systemd_nothing_happens(tmp_path: Path) -> None:
    with Notifier({}) as notifier:
        notifier.send("READY=1")
        assert notifier.watchdog_s is None
    with Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")}) as notifier:
        notifier.send("READY=1")


@pytest.mark.parametrize(
    ("environment", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "2000000"}, 2.0),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": str(os.getpid())}, 2.0),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "1"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_the_time_of_the_watchdog(
    systemd: socket.socket, environment: dict[str, str], watchdog_s: float | None
) -> None:
    with Notifier({"NOTIFY_SOCKET": systemd.getsockname(), **environment}) as notifier:
        assert notifier.watchdog_s == watchdog_s


def test_completed_periods_serve_the_watchdog(systemd: socket.socket) -> None:
    environment = {"NOTIFY_SOCKET": systemd.getsockname(), "WATCHDOG_USEC": "2000000"}
    with Notifier(environment) as notifier:
        observer = WatchdogObserver(notifier)
        for tenth in range(21):
            observer.cycle(cycle(tenth, tenth * SECOND_NS // 10), gateway(LifeCycleState.OFFLINE))
        assert received(systemd) == ["READY=1\nSTATUS=offline", *["WATCHDOG=1"] * 5]
        observer.cycle(cycle(22, 22 * SECOND_NS // 10), gateway(LifeCycleState.READY))
        assert received(systemd) == ["STATUS=ready"]
