"""Child processes that hang are killed after a timeout."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator

import pytest
from support.recorded_runs import children_of

from hil.cli import run, run_parts
from hil.host.child_process import await_end


def process(program: str) -> subprocess.Popen[bytes]:
    """Return a Python process that has begun to run ``program``."""
    started = subprocess.Popen(
        [sys.executable, "-c", f"print(flush=True)\n{program}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert started.stdout is not None
    started.stdout.readline()
    return started


@pytest.fixture
def stopped() -> Iterator[subprocess.Popen[bytes]]:
    with process("input()") as started:
        os.kill(started.pid, signal.SIGSTOP)
        yield started
        started.kill()


def test_the_status_of_a_process_that_exits_is_returned() -> None:
    with process("import sys; sys.exit(3)") as started:
        assert await_end(started, 60.0) == 3


def test_a_stopped_process_is_killed(stopped: subprocess.Popen[bytes]) -> None:
    assert await_end(stopped, 0.05) is None
    assert stopped.wait() == -signal.SIGKILL


def test_boards_that_hang_do_not_delay_the_end_of_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_parts, "BOARDS_END_TIMEOUT_S", 0.05)
    before = set(children_of(os.getpid()))
    options = run.parser().parse_args(["--linear"])
    with run_parts.boards_process("udp:43113", options):
        (boards,) = set(children_of(os.getpid())) - before
        os.kill(boards, signal.SIGSTOP)
    assert boards not in children_of(os.getpid())
