"""The display's process receives messages in order; a process that stalls or ends never blocks the sender."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hil.views.display_process import DisplayProcess, received_messages


def test_messages_arrive_in_order_until_the_connection_is_closed() -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.send(b'{"a": 1}')
    ours.send(b'{"b": [2, 3]}')
    ours.close()
    assert list(received_messages(theirs.detach())) == [{"a": 1}, {"b": [2, 3]}]


@pytest.fixture
def stalled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> DisplayProcess:
    """A display process that never reads."""
    (tmp_path / "stalled.py").write_text("import signal\nsignal.pause()\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return DisplayProcess("stalled")


def test_messages_to_a_stalled_or_dead_process_are_dropped(stalled: DisplayProcess) -> None:
    for number in range(5000):
        stalled.send({"number": number})  # Would never return if it waited.
    os.kill(stalled._process.pid, signal.SIGKILL)
    stalled._process.wait()
    stalled.send({"to": "nobody"})
    stalled.close()


def test_a_process_that_does_not_end_is_killed(
    stalled: DisplayProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.views.display_process.CLOSE_TIMEOUT_S", 0.05)
    os.kill(stalled._process.pid, signal.SIGSTOP)
    stalled.close()
    assert stalled._process.returncode == -signal.SIGKILL


def test_ctrl_c_in_the_terminal_does_not_reach_the_process(stalled: DisplayProcess) -> None:
    """The terminal signals all processes of its session, even one that has not imported anything yet."""
    assert os.getsid(stalled._process.pid) != os.getsid(0)
    stalled._process.kill()
    stalled.close()


def test_modules_in_the_working_directory_are_not_imported(tmp_path: Path) -> None:
    for name in ("json", "socket", "rich", "hil"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported from the working directory')\n")
    program = """
from hil.views.display_process import DisplayProcess
display = DisplayProcess("hil.views.terminal")
display.send({"log": [1.5, 20, "adc", "operational"]})
display.close()
"""
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stderr == "     1.50 s  adc: operational\n"
