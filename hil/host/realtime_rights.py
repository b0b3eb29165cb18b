"""Request the real-time rights for the calling thread, report what was granted, and restore everything.

The rights are SCHED_FIFO, locked memory, a fixed processor, no timer slack, no deep processor sleep, a
garbage collector that is frozen and off, and polling before each deadline and for each sample. Linux refuses
real-time priority to most sessions. A refusal is no error, but it is reported, so that a loop without a right
does not look like a loop that has it. ``hil doctor`` says how to obtain a refused right.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

FIFO_PRIORITY: Final = 49
"""Priority of the loop. It is below 50, the priority of interrupt threads in a PREEMPT_RT kernel."""

_MCL_CURRENT: Final = 1  # linux: asm-generic/mman.h
_MCL_FUTURE: Final = 2  # linux: asm-generic/mman.h
_PR_SET_TIMERSLACK: Final = 29  # linux: linux/prctl.h
_PR_GET_TIMERSLACK: Final = 30  # linux: linux/prctl.h
_CAP_IPC_LOCK: Final = 14  # linux: linux/capability.h
NEEDS_FIFO: Final = "not useful without SCHED_FIFO"
"""Detail of a right that is not asked for because SCHED_FIFO was refused."""
POLLING_IS_OFF: Final = "turned off (rig: loop.poll_before_deadline_s, loop.poll_for_sample_s)"
"""Detail of the right to poll if the rig file does not want it."""
_MIN_RTTIME_US: Final = 200_000
"""Smallest limit RLIMIT_RTTIME under which the loop takes SCHED_FIFO.

The kernel kills a real-time thread that is busy for longer than the limit without a pause. A loop that works
off a backlog may be busy for many periods.
"""

Request = Callable[[contextlib.ExitStack], str]
"""Function that takes one right and says what it got. It adds to the stack what restores the former state."""


class Right(NamedTuple):
    """One right that was requested."""

    name: str
    is_granted: bool
    detail: str
    """What was granted, or the reason of the refusal."""


class Rights(tuple[Right, ...]):
    """All rights that were requested, in the order of the requests."""

    poll_ns: int = 0
    """Time before each deadline in which the loop may poll instead of sleeping, in nanoseconds."""
    sample_poll_ns: int = 0
    """Time after SYNC in which the loop may poll for the sample instead of sleeping, in nanoseconds."""

    def __str__(self) -> str:
        """Return one line: what was refused and why, and what was granted. The metadata has all details."""
        granted = ", ".join(right.name for right in self if right.is_granted) or "nothing"
        refused = ", ".join(
            right.name if right.detail == NEEDS_FIFO else f"{right.name} ({right.detail})"
            for right in self
            if not right.is_granted
        )
        return f"refused: {refused}; granted: {granted}" if refused else f"granted: {granted}"

    def as_metadata(self) -> dict[str, str]:
        """Return for each name a text ``granted: …`` or ``refused: …``, for the recording."""
        return {
            right.name: f"{'granted' if right.is_granted else 'refused'}: {right.detail}" for right in self
        }


@contextlib.contextmanager
def real_time_rights(poll_before_deadline_s: float = 0.0, poll_for_sample_s: float = 0.0) -> Iterator[Rights]:
    """Request every right for the calling thread, and restore the former state at the end.

    The arguments are the times in seconds for which the loop wants to poll before each deadline, and after
    each SYNC; 0 means not at all. A refusal raises no error.
    """
    processors = len(os.sched_getaffinity(0))
    with contextlib.ExitStack() as restore:
        granted = [_request(name, request, restore) for name, request in _REQUESTS.items()]
        allow = partial(_allow_polling, poll_before_deadline_s, poll_for_sample_s, processors)
        polling = _request("polling", allow, restore)
        rights = Rights([*granted, polling])
        if polling.is_granted:
            rights.poll_ns = round(poll_before_deadline_s * 1e9)
            rights.sample_poll_ns = round(poll_for_sample_s * 1e9)
        yield rights


def _request(name: str, request: Request, restore: contextlib.ExitStack) -> Right:
    try:
        return Right(name, True, request(restore))
    except OSError as error:
        return Right(name, False, error.strerror or str(error))


def _freeze_collector(restore: contextlib.ExitStack) -> str:
    gc.collect()
    gc.freeze()
    restore.callback(gc.unfreeze)
    if gc.isenabled():
        gc.disable()
        restore.callback(gc.enable)
    return "frozen and off"


def _set_timer_slack(restore: contextlib.ExitStack) -> str:
    before_ns = _libc("prctl", _PR_GET_TIMERSLACK, 0, 0, 0, 0)
    _libc("prctl", _PR_SET_TIMERSLACK, 1, 0, 0, 0)
    restore.callback(_libc, "prctl", _PR_SET_TIMERSLACK, before_ns, 0, 0, 0)
    return "1 ns"


def _keep_awake(restore: contextlib.ExitStack) -> str:
    """Keep the processors out of deep sleep while the file is open (Linux: pm_qos_interface)."""
    descriptor = os.open("/dev/cpu_dma_latency", os.O_WRONLY | os.O_CLOEXEC)
    restore.callback(os.close, descriptor)
    os.write(descriptor, (0).to_bytes(4, "little"))
    return "latency 0 us"


def _lock_memory(restore: contextlib.ExitStack) -> str:
    _, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    is_unlimited = hard == resource.RLIM_INFINITY or _has_capability(_CAP_IPC_LOCK)
    # Under a limit, locking future memory too would make allocations fail in the middle of a run.
    _libc("mlockall", _MCL_CURRENT | _MCL_FUTURE if is_unlimited else _MCL_CURRENT)
    restore.callback(_libc, "munlockall")
    return "all" if is_unlimited else "memory in use at the start"


def _take_fifo(restore: contextlib.ExitStack) -> str:
    _, hard_us = resource.getrlimit(resource.RLIMIT_RTTIME)
    if hard_us != resource.RLIM_INFINITY and hard_us < _MIN_RTTIME_US:
        raise OSError(0, f"RLIMIT_RTTIME of {hard_us} us would kill a busy loop")
    resource.setrlimit(resource.RLIMIT_RTTIME, (hard_us, hard_us))
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    os.sched_setscheduler(0, policy, os.sched_param(FIFO_PRIORITY))
    # An unprivileged thread may not clear the flag again.
    restore.callback(os.sched_setscheduler, 0, before | os.SCHED_RESET_ON_FORK, parameter)
    return f"priority {FIFO_PRIORITY}"


def _take_processor(restore: contextlib.ExitStack) -> str:
    """Bind the thread to one processor: an isolated one, else the last, as the first serves most interrupts.

    Only with SCHED_FIFO: a thread without priority must be able to move to an idle processor.
    """
    before = os.sched_getaffinity(0)
    chosen = max(_isolated_processors() & before, default=max(before))
    if not _is_fifo():
        raise OSError(0, NEEDS_FIFO)
    os.sched_setaffinity(0, {chosen})
    restore.callback(os.sched_setaffinity, 0, before)
    return f"number {chosen} of {len(before)}"


def _allow_polling(
    before_deadline_s: float, for_sample_s: float, processors: int, _restore: contextlib.ExitStack
) -> str:
    """Allow polling if it gains something and leaves a processor to other threads.

    Without SCHED_FIFO, another thread may run at the deadline all the same. On a single processor, polling
    would take time from the boards, the recorder and the kernel.
    """
    if before_deadline_s <= 0 and for_sample_s <= 0:
        raise OSError(0, POLLING_IS_OFF)
    if not _is_fifo():
        raise OSError(0, NEEDS_FIFO)
    if processors < 2:
        raise OSError(0, "needs more than one processor")
    before, after = f"{1e6 * before_deadline_s:g} us before each deadline", f"{1e6 * for_sample_s:g} us"
    return f"{before}, up to {after} for each sample" if for_sample_s > 0 else before


def _is_fifo() -> bool:
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO


_REQUESTS: Final[dict[str, Request]] = {
    "garbage collector": _freeze_collector,
    "timer slack": _set_timer_slack,
    "processor sleep": _keep_awake,
    "memory lock": _lock_memory,
    "SCHED_FIFO": _take_fifo,
    "processor": _take_processor,
}


def _isolated_processors() -> set[int]:
    """Return the processors that ``isolcpus=`` keeps free, from the kernel's list, such as ``2-3,5``."""
    processors: set[int] = set()
    with contextlib.suppress(OSError):
        for part in Path("/sys/devices/system/cpu/isolated").read_text().split(","):
            if part.strip():
                first, _, last = part.partition("-")
                processors |= set(range(int(first), int(last or first) + 1))
    return processors


def _has_capability(number: int) -> bool:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> number & 1)
    return False


def _libc(function: str, *arguments: int) -> int:
    result: int = getattr(ctypes.CDLL(None, use_errno=True), function)(*arguments)
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result
