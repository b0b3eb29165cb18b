"""``hil doctor``: what this machine grants a control loop, and what to do about what it does not.

Lives here: one function a question, each answering with :class:`Check` rows. Nothing is changed, except that
the real-time rights are taken for the half second in which wake-ups are measured.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import platform
import resource
import socket
import sys
import time
from collections.abc import Callable, Iterator
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from select import select
from typing import Final, NamedTuple

from hil.core.errors import EnvironmentLackError, LinkError
from hil.core.frames import Frame
from hil.host.realtime_rights import Right, real_time_rights

SYS: Final = Path("/sys")
PROC: Final = Path("/proc")
PERIOD_NS: Final = 11_200_000
WAKE_UPS: Final = 45
GOOD_LATENESS_US: Final = 1000
GOOD_LATENCY_TIMER_MS: Final = 2
ARPHRD_CAN: Final = "280"
PACKAGES: Final = ("pneumatic-hil", "python-can", "pyserial", "mcap", "numpy")

LIMITS_FILE: Final = "/etc/security/limits.d/hil.conf"
USER_ADVICE: Final = {
    "SCHED_FIFO": f"echo '{{user}} - rtprio 49' | sudo tee -a {LIMITS_FILE}; log in again",
    "processor": "comes with SCHED_FIFO",
    "memory lock": f"echo '{{user}} - memlock unlimited' | sudo tee -a {LIMITS_FILE}; log in again",
    "processor sleep": "sudo chmod a+w /dev/cpu_dma_latency",
}
CONTAINER_ADVICE: Final = {
    "SCHED_FIFO": "start the container with --cap-add SYS_NICE",
    "processor": "comes with SCHED_FIFO",
    "memory lock": "start the container with --cap-add IPC_LOCK",
    "processor sleep": "start the container with --device /dev/cpu_dma_latency",
}
"""Root lacks these rights only where something took them away."""


class Verdict(StrEnum):
    """How good a finding is for the loop."""

    GOOD = "good"
    FAIR = "could be better"
    MISSING = "missing"
    """The simulated rig cannot run without it."""


class Check(NamedTuple):
    """One finding. ``advice`` is what to do, a command or a file; empty when nothing is."""

    name: str
    verdict: Verdict
    found: str
    advice: str


def doctor() -> list[Check]:
    """Every check, in the order to read them; takes about a second."""
    return [check for question in QUESTIONS for check in question()]


def main(argv: list[str]) -> int:
    """Print the checks. 0: the simulated rig can run; 1: something that it needs is missing."""
    parser = argparse.ArgumentParser(
        prog="hil doctor",
        description="What this machine grants a control loop, and what to do about the rest.",
    )
    parser.add_argument("--json", action="store_true", help="for programs: a list of objects")
    options = parser.parse_args(argv)
    checks = doctor()
    if options.json:
        sys.stdout.write(json.dumps([check._asdict() for check in checks], indent=2) + "\n")
    else:
        _print(checks)
    return int(any(check.verdict is Verdict.MISSING for check in checks))


def _print(checks: list[Check]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    styles = {Verdict.GOOD: "green", Verdict.FAIR: "yellow", Verdict.MISSING: "bold red"}
    table = Table(box=None, show_header=False, pad_edge=False)
    for check in checks:
        verdict = Text(check.verdict, style=styles[check.verdict], no_wrap=True)
        table.add_row(Text(check.name, no_wrap=True), verdict, Text(check.found))
    console = Console(highlight=False)
    console.print(table)
    for check in checks:
        if check.advice:  # outside the table, so that a command stays on one line to copy
            console.print(Text(f"\n{check.name}:", style=styles[check.verdict]))
            console.print(Text(f"  {check.advice}"), soft_wrap=True)


def _check(name: str, found: str, advice: str = "", is_essential: bool = False) -> Check:
    """Good when there is nothing to advise."""
    verdict = (Verdict.MISSING if is_essential else Verdict.FAIR) if advice else Verdict.GOOD
    return Check(name, verdict, found, advice)


def _simulated_rig() -> Iterator[Check]:
    """The bus between the gateway and the simulated boards."""
    from hil.links import open_link

    name = "UDP multicast"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        spec = f"udp:{probe.getsockname()[1]}"
    try:
        with open_link(spec) as one, open_link(spec) as other:
            one.send(Frame(0x080))
            heard = other.receive(1.0)
    except LinkError as error:
        yield _check(name, str(error), "sudo ip link set lo up", is_essential=True)
        return
    if heard is None:
        advice = "does a firewall filter the loopback interface? sudo nft list ruleset"
        yield _check(name, "a frame sent inside this host did not arrive", advice, is_essential=True)
    else:
        yield _check(name, "frames arrive inside this host")


def _can() -> Iterator[Check]:
    from hil.host.vcan import choose_way

    try:
        socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
        yield _check("SocketCAN", "interfaces: " + (", ".join(_can_interfaces()) or "none"))
    except OSError as error:
        advice = "sudo modprobe can-raw (some systems ship it apart: linux-modules-extra-$(uname -r))"
        yield _check("SocketCAN", f"not in this kernel ({error.strerror})", advice)
    try:
        yield _check("hil vcan", f"uses {choose_way()}")
    except EnvironmentLackError as error:
        yield _check("hil vcan", "finds no way to a vcan0", str(error))


def _can_interfaces() -> list[str]:
    return [
        f"{path.parent.name} ({_text(path.parent / 'operstate')})"
        for path in sorted(SYS.glob("class/net/*/type"))
        if _text(path) == ARPHRD_CAN
    ]


def _serial_ports() -> Iterator[Check]:
    from serial.tools.list_ports import comports

    good = []
    for device in sorted(port.device for port in comports()):
        timer = SYS / "bus/usb-serial/devices" / Path(device).name / "latency_timer"
        latency_ms = _text(timer)
        if not os.access(device, os.R_OK | os.W_OK):
            yield _check(device, "you may not use it", "sudo adduser $USER dialout; log in again")
        elif latency_ms and int(latency_ms) > GOOD_LATENCY_TIMER_MS:
            advice = (
                f"hil asks for less when it opens the port; for other programs: echo 1 | sudo tee {timer}"
            )
            yield _check(device, f"latency timer {latency_ms} ms", advice)
        else:
            good.append(f"{device} (latency timer {latency_ms} ms)" if latency_ms else device)
    shown = ", ".join(good[:4]) + (f" and {len(good) - 4} more" if len(good) > 4 else "")
    yield _check("serial ports", shown or "none to use")


def _rights_and_wake_ups() -> Iterator[Check]:
    with real_time_rights() as rights:
        lateness_ns = _wake_up_lateness_ns()
    for right in rights:
        yield _check(right.name, right.detail, "" if right.is_granted else _advice(right))
    p50_us, worst_us = lateness_ns[WAKE_UPS // 2] // 1000, lateness_ns[-1] // 1000
    yield _check(
        "wake-ups",
        f"late by p50 {p50_us} us, worst {worst_us} us of {WAKE_UPS}",
        "is the machine busy? SCHED_FIFO, an isolated processor (isolcpus=) and PREEMPT_RT help"
        * (worst_us > GOOD_LATENESS_US),
    )


def _advice(right: Right) -> str:
    if right.detail == os.strerror(errno.ENOENT):
        return ""
    advice = (USER_ADVICE if os.geteuid() else CONTAINER_ADVICE).get(right.name, "")
    return advice.format(user=os.environ.get("USER", "USER"))


def _wake_up_lateness_ns() -> list[int]:
    """Sorted; from waits as the loop's, to absolute deadlines a period apart."""
    lateness_ns = []
    deadline_ns = time.monotonic_ns()
    for _ in range(WAKE_UPS):
        deadline_ns += PERIOD_NS
        while (left_ns := deadline_ns - time.monotonic_ns()) > 0:
            select([], [], [], left_ns * 1e-9)
        lateness_ns.append(-left_ns)
    return sorted(lateness_ns)


def _limits() -> Iterator[Check]:
    soft, hard = resource.getrlimit(resource.RLIMIT_RTPRIO)
    yield _check("RLIMIT_RTPRIO", f"{_limit(soft)}, at most {_limit(hard)} (root needs none)")
    soft, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    advice = "the kernel kills a loop that is busy for longer: ulimit -R unlimited, or another session"
    yield _check(
        "RLIMIT_RTTIME",
        f"{_limit(soft, ' us')}, at most {_limit(hard, ' us')}",
        "" if hard == resource.RLIM_INFINITY else advice,
    )
    runtime_us = _text(PROC / "sys/kernel/sched_rt_runtime_us")
    advice = "no real-time task may run: sudo sysctl kernel.sched_rt_runtime_us=950000"
    yield _check("sched_rt_runtime_us", runtime_us or "not told", advice * (runtime_us == "0"))


def _limit(value: int, unit: str = "") -> str:
    return "unlimited" if value == resource.RLIM_INFINITY else f"{value}{unit}"


def _clock() -> Iterator[Check]:
    source = _text(SYS / "devices/system/clocksource/clocksource0/current_clocksource")
    advice = "reading it takes microseconds; kernel parameter clocksource=tsc"
    yield _check("clock source", source or "not told", advice * (source in ("hpet", "acpi_pm", "jiffies")))
    resolution_ns = round(time.clock_getres(time.CLOCK_MONOTONIC) * 1e9)
    advice = "the kernel needs CONFIG_HIGH_RES_TIMERS and no highres=off"
    yield _check("timer resolution", f"{resolution_ns} ns", advice * (resolution_ns > 1000))


def _processors() -> Iterator[Check]:
    count = len(os.sched_getaffinity(0))
    advice = "gateway, boards and recorder share it; give this machine another, or expect later wake-ups"
    yield _check("processors", f"{count} usable of {os.cpu_count()}", advice * (count == 1))
    governors = {_text(path) for path in SYS.glob("devices/system/cpu/cpu*/cpufreq/scaling_governor")}
    found = ", ".join(sorted(governors)) or "none: the frequency is not this system's to set"
    advice = "sudo cpupower frequency-set -g performance"
    yield _check("frequency governor", found, "" if governors <= {"performance"} else advice)


def _versions() -> Iterator[Check]:
    kind = "PREEMPT_RT" if _text(SYS / "kernel/realtime") == "1" else "not PREEMPT_RT"
    yield _check("kernel", f"{platform.system()} {platform.release()}, {kind}")
    found = [f"{name} {version(name)}" for name in PACKAGES]
    yield _check("versions", ", ".join([f"Python {platform.python_version()}", *found]))


QUESTIONS: Final[tuple[Callable[[], Iterator[Check]], ...]] = (
    _simulated_rig,
    _can,
    _serial_ports,
    _rights_and_wake_ups,
    _limits,
    _clock,
    _processors,
    _versions,
)


def _text(path: Path) -> str:
    """The file's text without its line end; empty when there is none to read."""
    try:
        return path.read_text().strip()
    except OSError:
        return ""
