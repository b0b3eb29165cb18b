"""Checks of what decides how punctual a loop is: rights, wake-ups, limits, clocks and processors."""

from __future__ import annotations

import errno
import os
import resource
import time
from collections.abc import Iterator
from select import select
from typing import Final

from hil.core.rig import POLL_BEFORE_DEADLINE_S, POLL_FOR_SAMPLE_S
from hil.host.doctor import kernel_files
from hil.host.doctor.check import Check, check
from hil.host.doctor.kernel_files import read_line
from hil.host.realtime_rights import POLLING_IS_OFF, Right, real_time_rights

PERIOD_NS: Final = 11_200_000
"""Period of the measured wake-ups: that of the example rig."""
WAKE_UPS: Final = 45
"""Number of measured wake-ups; they take half a second."""
_MAX_LATENESS_US: Final = 1000
"""Largest lateness of a wake-up that is still good for a loop."""
_MAX_RESOLUTION_NS: Final = 1000
_SLOW_CLOCKS: Final = ("hpet", "acpi_pm", "jiffies")

_LIMITS_FILE: Final = "/etc/security/limits.d/hil.conf"
_USER_ADVICE: Final = {
    "SCHED_FIFO": f"echo '{{user}} - rtprio 49' | sudo tee -a {_LIMITS_FILE}; log in again",
    "processor": "granted together with SCHED_FIFO",
    "polling": "granted together with SCHED_FIFO, if more than one processor is usable",
    "memory lock": f"echo '{{user}} - memlock unlimited' | sudo tee -a {_LIMITS_FILE}; log in again",
    "processor sleep": "sudo chmod a+w /dev/cpu_dma_latency",
}
_CONTAINER_ADVICE: Final = {
    "SCHED_FIFO": "start the container with --cap-add SYS_NICE",
    "processor": "granted together with SCHED_FIFO",
    "polling": "granted together with SCHED_FIFO, if more than one processor is usable",
    "memory lock": "start the container with --cap-add IPC_LOCK",
    "processor sleep": "start the container with --device /dev/cpu_dma_latency",
}
"""Advice for root, who has these rights everywhere except in a container that was started without them."""


def rights_and_wake_ups(
    poll_before_deadline_s: float = POLL_BEFORE_DEADLINE_S, poll_for_sample_s: float = POLL_FOR_SAMPLE_S
) -> Iterator[Check]:
    """Take the real-time rights as a run does, and measure with them how late this thread wakes up.

    The arguments are the times of polling in the rig file, in seconds.
    """
    with real_time_rights(poll_before_deadline_s, poll_for_sample_s) as rights:
        lateness_ns = wake_up_lateness_ns(rights.poll_ns)
    for right in rights:
        yield check(right.name, right.detail, "" if right.is_granted else rights_advice(right))
    p50_us, worst_us = lateness_ns[WAKE_UPS // 2] // 1000, lateness_ns[-1] // 1000
    advice = "is the machine busy? SCHED_FIFO, an isolated processor (isolcpus=) and PREEMPT_RT help"
    yield check(
        "wake-ups",
        f"late by p50 {p50_us} us, worst {worst_us} us of {WAKE_UPS}",
        advice if worst_us > _MAX_LATENESS_US else "",
    )


def rights_advice(right: Right) -> str:
    """Return how to obtain a refused right; an empty text if there is nothing to do.

    That is so if this machine does not know the right, or if the rig file turns it off.
    """
    if right.detail in (os.strerror(errno.ENOENT), POLLING_IS_OFF):
        return ""
    advice = (_USER_ADVICE if os.geteuid() else _CONTAINER_ADVICE).get(right.name, "")
    return advice.format(user=os.environ.get("USER", "USER"))


def wake_up_lateness_ns(poll_ns: int = 0) -> list[int]:
    """Return how late this thread was at each deadline, in ascending order.

    It waits as the loop does: with ``select``, for absolute deadlines that are one period apart. In the last
    ``poll_ns`` before a deadline it polls the clock.
    """
    lateness_ns = []
    deadline_ns = time.monotonic_ns()
    for _ in range(WAKE_UPS):
        deadline_ns += PERIOD_NS
        while (left_ns := deadline_ns - time.monotonic_ns()) > 0:
            if left_ns > poll_ns:
                select([], [], [], (left_ns - poll_ns) * 1e-9)
        lateness_ns.append(-left_ns)
    return sorted(lateness_ns)


def limits() -> Iterator[Check]:
    """Check the limits on real-time priority and on the processor time of a real-time thread."""
    soft, hard = resource.getrlimit(resource.RLIMIT_RTPRIO)
    yield check("RLIMIT_RTPRIO", f"{_limit(soft)}, at most {_limit(hard)} (root needs none)")
    soft, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    advice = "the kernel kills a loop that is busy for longer: ulimit -R unlimited, or another session"
    yield check(
        "RLIMIT_RTTIME",
        f"{_limit(soft, ' us')}, at most {_limit(hard, ' us')}",
        "" if hard == resource.RLIM_INFINITY else advice,
    )
    runtime_us = read_line(kernel_files.PROC / "sys/kernel/sched_rt_runtime_us")
    advice = "no real-time thread may run: sudo sysctl kernel.sched_rt_runtime_us=950000"
    yield check("sched_rt_runtime_us", runtime_us or "unknown", advice if runtime_us == "0" else "")


def _limit(value: int, unit: str = "") -> str:
    return "unlimited" if value == resource.RLIM_INFINITY else f"{value}{unit}"


def clock() -> Iterator[Check]:
    """Check how fast the clock is read and how fine the timers are."""
    source = read_line(kernel_files.SYS / "devices/system/clocksource/clocksource0/current_clocksource")
    advice = "reading it takes microseconds; start the kernel with clocksource=tsc"
    yield check("clock source", source or "unknown", advice if source in _SLOW_CLOCKS else "")
    resolution_ns = round(time.clock_getres(time.CLOCK_MONOTONIC) * 1e9)
    advice = "the kernel needs CONFIG_HIGH_RES_TIMERS, and must not be started with highres=off"
    yield check(
        "timer resolution", f"{resolution_ns} ns", advice if resolution_ns > _MAX_RESOLUTION_NS else ""
    )


def processors() -> Iterator[Check]:
    """Check the number of processors and how their frequency is controlled."""
    count = len(os.sched_getaffinity(0))
    advice = "gateway, boards and recorder share it; give this machine another, or expect later wake-ups"
    yield check("processors", f"{count} usable of {os.cpu_count()}", advice if count == 1 else "")
    paths = kernel_files.SYS.glob("devices/system/cpu/cpu*/cpufreq/scaling_governor")
    governors = {read_line(path) for path in paths}
    found = ", ".join(sorted(governors)) or "none: this system does not control the frequency"
    advice = "sudo cpupower frequency-set -g performance"
    yield check("frequency governor", found, "" if governors <= {"performance"} else advice)
