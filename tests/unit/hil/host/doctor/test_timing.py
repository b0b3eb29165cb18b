"""The doctor's findings about rights, limits, clocks and processors, on machines made of files."""

import errno
import os
import resource
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.doctor_checks import check_named, write_kernel_file

from hil.host.doctor import CheckVerdict, kernel_files, timing
from hil.host.realtime_rights import Right


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty /sys and /proc."""
    monkeypatch.setattr(kernel_files, "SYS", tmp_path)
    monkeypatch.setattr(kernel_files, "PROC", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("source", "verdict"),
    [
        ("tsc", CheckVerdict.GOOD),
        ("kvm-clock", CheckVerdict.GOOD),
        ("hpet", CheckVerdict.FAIR),
        ("acpi_pm", CheckVerdict.FAIR),
        ("jiffies", CheckVerdict.FAIR),
    ],
)
def test_a_slow_clock_source_is_reported(kernel: Path, source: str, verdict: CheckVerdict) -> None:
    write_kernel_file(kernel, "devices/system/clocksource/clocksource0/current_clocksource", source)
    check = check_named(timing.clock(), "clock source")
    assert (check.found, check.verdict) == (source, verdict)


def test_a_coarse_timer_is_reported(kernel: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "clock_getres", lambda _clock: 0.004)
    check = check_named(timing.clock(), "timer resolution")
    assert (check.found, check.verdict) == ("4000000 ns", CheckVerdict.FAIR)


@pytest.mark.parametrize(
    ("governors", "verdict", "found"),
    [
        ([], CheckVerdict.GOOD, "none: this system does not control the frequency"),
        (["performance", "performance"], CheckVerdict.GOOD, "performance"),
        (["performance", "powersave"], CheckVerdict.FAIR, "performance, powersave"),
    ],
)
def test_governors_other_than_performance_are_reported(
    kernel: Path, governors: list[str], verdict: CheckVerdict, found: str
) -> None:
    for number, governor in enumerate(governors):
        write_kernel_file(kernel, f"devices/system/cpu/cpu{number}/cpufreq/scaling_governor", governor)
    check = check_named(timing.processors(), "frequency governor")
    assert (check.verdict, check.found) == (verdict, found)


def test_a_single_processor_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: {3})
    assert check_named(timing.processors(), "processors").verdict is CheckVerdict.FAIR


@pytest.mark.parametrize(
    ("runtime", "verdict"), [("950000", "good"), ("-1", "good"), ("0", "could be better")]
)
def test_a_system_that_forbids_real_time_threads_is_reported(
    kernel: Path, runtime: str, verdict: str
) -> None:
    write_kernel_file(kernel, "sys/kernel/sched_rt_runtime_us", runtime)
    check = check_named(timing.limits(), "sched_rt_runtime_us")
    assert (check.found, check.verdict) == (runtime, verdict)


def test_a_limit_that_kills_a_busy_loop_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _kind: (200_000, 200_000))
    check = check_named(timing.limits(), "RLIMIT_RTTIME")
    assert (check.found, check.verdict) == ("200000 us, at most 200000 us", CheckVerdict.FAIR)


@pytest.mark.parametrize(
    ("user_id", "advice"),
    [
        (1000, "echo 'ada - rtprio 49' | sudo tee -a /etc/security/limits.d/hil.conf; log in again"),
        (0, "start the container with --cap-add SYS_NICE"),
    ],
)
def test_advice_on_a_refused_right_fits_the_user(
    user_id: int, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: user_id)
    monkeypatch.setenv("USER", "ada")
    assert timing.rights_advice(Right("SCHED_FIFO", False, "Operation not permitted")) == advice
    assert timing.rights_advice(Right("processor sleep", False, os.strerror(errno.ENOENT))) == ""


def test_wake_ups_are_measured_from_absolute_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_ns=0)

    def wait(_read: object, _write: object, _error: object, timeout_s: float) -> None:
        clock.now_ns += round(timeout_s * 1e9) + 300_000

    monkeypatch.setattr(time, "monotonic_ns", lambda: clock.now_ns)
    monkeypatch.setattr(timing, "select", wait)
    assert timing.wake_up_lateness_ns() == [300_000] * timing.WAKE_UPS
    assert clock.now_ns == timing.WAKE_UPS * timing.PERIOD_NS + 300_000


def test_wake_ups_within_the_polling_time_are_not_late(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_ns=0)

    def now() -> int:
        clock.now_ns += 500  # reading the clock takes time
        return int(clock.now_ns)

    def wait(_read: object, _write: object, _error: object, timeout_s: float) -> None:
        clock.now_ns += round(timeout_s * 1e9) + 100_000

    monkeypatch.setattr(time, "monotonic_ns", now)
    monkeypatch.setattr(timing, "select", wait)
    assert max(timing.wake_up_lateness_ns(150_000)) <= 500
