"""The rights of the real-time loop: each is asked for, and what was granted is told, never assumed.

Lives here: SCHED_FIFO, memory lock, processor, timer slack, processor sleep and the frozen garbage
collector, for the calling thread, given back at the end. Does not live here: advice on how to obtain what
was refused (``hil doctor``).
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

FIFO_PRIORITY: Final = 49
"""Under 50, where a PREEMPT_RT kernel runs the interrupts that the loop waits for."""

_MCL_CURRENT: Final = 1
_MCL_FUTURE: Final = 2
_PR_SET_TIMERSLACK: Final = 29
_PR_GET_TIMERSLACK: Final = 30
_CAP_IPC_LOCK: Final = 14
_LEAST_RTTIME_US: Final = 200_000
"""A loop may be busy for many periods at once (a long backlog) and must not be killed for it."""

Request = Callable[[contextlib.ExitStack], str]


class Right(NamedTuple):
    """One thing asked for. ``detail`` says what was granted, or why not."""

    name: str
    is_granted: bool
    detail: str


class Rights(tuple[Right, ...]):
    """What was asked for, in order."""

    def __str__(self) -> str:
        """One line: what was granted; what was refused, and why."""
        granted = ", ".join(f"{right.name} ({right.detail})" for right in self if right.is_granted)
        refused = ", ".join(f"{right.name} ({right.detail})" for right in self if not right.is_granted)
        return f"granted: {granted or 'nothing'}; refused: {refused or 'nothing'}"

    def as_metadata(self) -> dict[str, str]:
        """Name to ``granted: …`` or ``refused: …``."""
        return {
            right.name: f"{'granted' if right.is_granted else 'refused'}: {right.detail}" for right in self
        }


@contextlib.contextmanager
def real_time_rights() -> Iterator[Rights]:
    """Ask for every right for the calling thread; on leaving, give them back. Refusals raise nothing."""
    with contextlib.ExitStack() as give_back:
        yield Rights(_asked(name, request, give_back) for name, request in _REQUESTS.items())


def _asked(name: str, request: Request, give_back: contextlib.ExitStack) -> Right:
    try:
        return Right(name, True, request(give_back))
    except OSError as error:
        return Right(name, False, error.strerror or str(error))


def _freeze_collector(give_back: contextlib.ExitStack) -> str:
    gc.collect()
    gc.freeze()
    give_back.callback(gc.unfreeze)
    if gc.isenabled():
        gc.disable()
        give_back.callback(gc.enable)
    return "frozen and off"


def _set_timer_slack(give_back: contextlib.ExitStack) -> str:
    before_ns = _libc("prctl", _PR_GET_TIMERSLACK, 0, 0, 0, 0)
    _libc("prctl", _PR_SET_TIMERSLACK, 1, 0, 0, 0)
    give_back.callback(_libc, "prctl", _PR_SET_TIMERSLACK, before_ns, 0, 0, 0)
    return "1 ns"


def _keep_awake(give_back: contextlib.ExitStack) -> str:
    """Processors stay out of deep sleep as long as the file is open; see the kernel's pm_qos_interface."""
    request = os.open("/dev/cpu_dma_latency", os.O_WRONLY | os.O_CLOEXEC)
    give_back.callback(os.close, request)
    os.write(request, (0).to_bytes(4, "little"))
    return "latency 0 us"


def _lock_memory(give_back: contextlib.ExitStack) -> str:
    _, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    is_unlimited = hard == resource.RLIM_INFINITY or _has_capability(_CAP_IPC_LOCK)
    # Under a limit, locking what comes later would let allocations fail in the middle of a run.
    _libc("mlockall", _MCL_CURRENT | _MCL_FUTURE if is_unlimited else _MCL_CURRENT)
    give_back.callback(_libc, "munlockall")
    return "all" if is_unlimited else "what is in use now"


def _take_fifo(give_back: contextlib.ExitStack) -> str:
    _, hard_us = resource.getrlimit(resource.RLIMIT_RTTIME)
    if hard_us != resource.RLIM_INFINITY and hard_us < _LEAST_RTTIME_US:
        raise OSError(0, f"RLIMIT_RTTIME of {hard_us} us would kill a busy loop")
    resource.setrlimit(resource.RLIMIT_RTTIME, (hard_us, hard_us))
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    os.sched_setscheduler(0, policy, os.sched_param(FIFO_PRIORITY))
    # An unprivileged thread may not take the flag off again.
    give_back.callback(os.sched_setscheduler, 0, before | os.SCHED_RESET_ON_FORK, parameter)
    return f"priority {FIFO_PRIORITY}"


def _take_processor(give_back: contextlib.ExitStack) -> str:
    """One processor: an isolated one, else the last, since the first serves most interrupts.

    Only under SCHED_FIFO: a thread without priority is better off where it can move away.
    """
    before = os.sched_getaffinity(0)
    chosen = max(_isolated_processors() & before, default=max(before))
    if os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK != os.SCHED_FIFO:
        raise OSError(0, "of no use without SCHED_FIFO")
    os.sched_setaffinity(0, {chosen})
    give_back.callback(os.sched_setaffinity, 0, before)
    return f"number {chosen} of {len(before)}"


_REQUESTS: Final[dict[str, Request]] = {
    "garbage collector": _freeze_collector,
    "timer slack": _set_timer_slack,
    "processor sleep": _keep_awake,
    "memory lock": _lock_memory,
    "SCHED_FIFO": _take_fifo,
    "processor": _take_processor,
}


def _isolated_processors() -> set[int]:
    """The processors that the kernel's ``isolcpus=`` keeps free, from a list such as ``2-3,5``."""
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
