"""Priority and processor of user-mode Linux: it takes both, or none of them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from hil.host.vcan.machine import _take_priority

SHOW = "import os; print(os.sched_getscheduler(0), os.getpriority(0, 0), len(os.sched_getaffinity(0)))"


def started_with_priority() -> tuple[int, int, int]:
    """Return policy, nice value and number of processors of a process that is started as the machine is."""
    done = subprocess.run(
        [sys.executable, "-c", SHOW],
        preexec_fn=_take_priority,
        start_new_session=True,
        capture_output=True,
        text=True,
        check=True,
    )
    policy, nice, processors = map(int, done.stdout.split())
    return policy, nice, processors


def unchanged() -> tuple[int, int, int]:
    return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0), len(os.sched_getaffinity(0))


def test_a_machine_before_ordinary_programs_has_one_processor() -> None:
    assert started_with_priority() in ((os.SCHED_OTHER, -20, 1), unchanged())


def test_a_machine_without_the_right_to_priority_may_use_every_processor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_arguments: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "setpriority", refuse)
    assert started_with_priority() == unchanged()
