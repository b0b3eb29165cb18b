"""Real-time rights are requested, reported and restored. The tests do not know what this machine grants."""

import gc
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil.host.realtime_rights import FIFO_PRIORITY, NEEDS_FIFO, Right, Rights, real_time_rights

NAMES = [
    "garbage collector",
    "timer slack",
    "processor sleep",
    "memory lock",
    "SCHED_FIFO",
    "processor",
    "polling",
]


def state() -> dict[str, object]:
    """Return what the kernel and the interpreter say about this thread."""
    status = Path("/proc/self/status").read_text()
    return {
        "policy": os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK,
        "priority": os.sched_getparam(0).sched_priority,
        "processors": os.sched_getaffinity(0),
        "timer slack": Path("/proc/self/timerslack_ns").read_text().strip(),
        "is memory locked": "VmLck:\t       0 kB" not in status,
        "is collecting": gc.isenabled(),
        "frozen objects": gc.get_freeze_count(),
    }


def is_granted(rights: Rights, name: str) -> bool:
    (right,) = (right for right in rights if right.name == name)
    return right.is_granted


def test_the_report_agrees_with_the_kernel() -> None:
    before = state()
    with real_time_rights(0.0002) as rights:
        during = state()
    assert [right.name for right in rights] == NAMES
    assert is_granted(rights, "garbage collector")
    assert not during["is collecting"]
    assert during["frozen objects"] != 0
    assert is_granted(rights, "timer slack")
    assert (during["policy"] == os.SCHED_FIFO) == is_granted(rights, "SCHED_FIFO")
    assert (during["priority"] == FIFO_PRIORITY) == is_granted(rights, "SCHED_FIFO")
    assert during["is memory locked"] == is_granted(rights, "memory lock")
    assert is_granted(rights, "polling") == (
        is_granted(rights, "SCHED_FIFO") and len(os.sched_getaffinity(0)) > 1
    )
    assert rights.poll_ns == (200_000 if is_granted(rights, "polling") else 0)
    if is_granted(rights, "processor"):
        assert isinstance(during["processors"], set)
        assert len(during["processors"]) == 1
    else:
        assert during["processors"] == before["processors"]


def test_the_former_state_is_restored() -> None:
    before = state()
    with real_time_rights():
        pass
    assert state() == before


def test_the_former_state_is_restored_after_an_error() -> None:
    before = state()
    with pytest.raises(ZeroDivisionError), real_time_rights():
        1 / 0  # noqa: B018
    assert state() == before


def test_a_refusal_is_reported_with_its_reason_and_raises_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_arguments: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    processors = os.sched_getaffinity(0)
    with real_time_rights(0.0002) as rights:
        assert os.sched_getaffinity(0) == processors, "without priority, the thread is not bound"
    reported = rights.as_metadata()
    assert list(reported) == NAMES
    assert reported["SCHED_FIFO"] == "refused: Operation not permitted"
    assert reported["processor"] == "refused: not useful without SCHED_FIFO"
    assert reported["polling"] == "refused: not useful without SCHED_FIFO"
    assert rights.poll_ns == 0
    assert reported["garbage collector"] == "granted: frozen and off"
    assert "refused: " in str(rights)
    assert "SCHED_FIFO (Operation not permitted)" in str(rights).partition("refused: ")[2]


def test_the_line_of_the_log_is_short() -> None:
    names = ("garbage collector", "timer slack", "processor sleep")
    granted = [Right(name, True, "some detail") for name in names]
    refused = [Right("SCHED_FIFO", False, "Operation not permitted"), Right("polling", False, NEEDS_FIFO)]
    assert str(Rights(granted)) == "granted: garbage collector, timer slack, processor sleep"
    assert str(Rights([*granted, *refused])) == (
        "refused: SCHED_FIFO (Operation not permitted), polling; granted: garbage collector, timer slack, "
        "processor sleep"
    )
    assert str(Rights(refused[:1])).endswith("; granted: nothing")


class TestPolling:
    @pytest.fixture
    def scheduler(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """A machine that grants SCHED_FIFO on two processors."""
        monkeypatch.setattr(os, "sched_getscheduler", lambda _pid: os.SCHED_FIFO)
        monkeypatch.setattr(os, "sched_setscheduler", lambda *_arguments: None)
        monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: {0, 1})
        monkeypatch.setattr(os, "sched_setaffinity", lambda *_arguments: None)

    @pytest.mark.usefixtures("scheduler")
    def test_it_is_granted_with_priority_and_a_second_processor(self) -> None:
        with real_time_rights(0.00015) as rights:
            assert rights.as_metadata()["polling"] == "granted: 150 us before each deadline"
            assert (rights.poll_ns, rights.sample_poll_ns) == (150_000, 0)

    @pytest.mark.usefixtures("scheduler")
    def test_the_time_for_a_sample_is_granted_and_reported_too(self) -> None:
        with real_time_rights(0.00015, 0.001) as rights:
            expected = "granted: 150 us before each deadline, up to 1000 us for each sample"
            assert rights.as_metadata()["polling"] == expected
            assert (rights.poll_ns, rights.sample_poll_ns) == (150_000, 1_000_000)

    @pytest.mark.usefixtures("scheduler")
    def test_the_rig_file_turns_it_off(self) -> None:
        with real_time_rights(0.0) as rights:
            reason = "turned off (rig: loop.poll_before_deadline_s, loop.poll_for_sample_s)"
            assert rights.as_metadata()["polling"] == f"refused: {reason}"
            assert rights.poll_ns == 0

    @pytest.mark.usefixtures("scheduler")
    def test_it_is_refused_on_a_single_processor(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: {0})
        with real_time_rights(0.00015) as rights:
            assert rights.as_metadata()["polling"] == "refused: needs more than one processor"
            assert rights.poll_ns == 0


def test_under_a_limit_that_would_kill_a_busy_loop_priority_is_not_taken() -> None:
    program = (
        "import resource; from hil.host.realtime_rights import real_time_rights\n"
        "resource.setrlimit(resource.RLIMIT_RTTIME, (50_000, 50_000))\n"
        "with real_time_rights() as rights: print(rights.as_metadata()['SCHED_FIFO'])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "refused: RLIMIT_RTTIME of 50000 us would kill a busy loop\n"


def test_soft_limits_are_raised_to_the_hard_limits() -> None:
    program = (
        "import resource; from hil.host.realtime_rights import real_time_rights\n"
        "resource.setrlimit(resource.RLIMIT_RTTIME, (50_000, 5_000_000))\n"
        "with real_time_rights(): print(resource.getrlimit(resource.RLIMIT_RTTIME))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "(5000000, 5000000)\n"


def test_a_child_does_not_inherit_the_priority() -> None:
    with real_time_rights():
        done = subprocess.run(
            [sys.executable, "-c", "import os; print(os.sched_getscheduler(0) == os.SCHED_OTHER)"],
            capture_output=True,
            text=True,
            check=True,
        )
    assert done.stdout == "True\n"


@pytest.mark.parametrize(
    ("listed", "expected"), [("", set()), ("\n", set()), ("3\n", {3}), ("1-2,5\n", {1, 2, 5})]
)
def test_isolated_processors_are_read(
    listed: str, expected: set[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    from hil.host import realtime_rights as rights

    monkeypatch.setattr(Path, "read_text", lambda _self: listed)
    assert rights._isolated_processors() == expected
