"""Priority and processor of user-mode Linux: it takes both, or none of them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import pytest

from hil.host.vcan.machine import _take_priority

SHOW = "import os; print(os.sched_getscheduler(0), os.getpriority(0, 0), len(os.sched_getaffinity(0)))"


def started(prepare: Callable[[], None] | None) -> tuple[int, int, int]:
    """Return policy, nice value and number of processors of a process that ``prepare`` begins in."""
    done = subprocess.run(
        [sys.executable, "-c", SHOW],
        preexec_fn=prepare,
        start_new_session=True,
        capture_output=True,
        text=True,
        check=True,
    )
    policy, nice, processors = map(int, done.stdout.split())
    return policy, nice, processors


def test_a_machine_before_ordinary_programs_has_one_processor() -> None:
    assert started(_take_priority) in ((os.SCHED_OTHER, -20, 1), started(None))


def test_a_machine_without_the_right_to_priority_may_use_every_processor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_arguments: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "setpriority", refuse)
    assert started(_take_priority) == started(None)
