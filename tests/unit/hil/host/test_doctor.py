"""The doctor's rows against machines made of files, and against this one."""

import errno
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from hil.core.errors import EnvironmentLackError
from hil.host import doctor
from hil.host.doctor import Check, Verdict
from hil.host.realtime_rights import Right, real_time_rights


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty /sys and /proc."""
    monkeypatch.setattr(doctor, "SYS", tmp_path)
    monkeypatch.setattr(doctor, "PROC", tmp_path)
    return tmp_path


def write(root: Path, path: str, text: str) -> None:
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text + "\n")


def named(checks: list[Check], name: str) -> Check:
    (check,) = (check for check in checks if check.name == name)
    return check


def test_every_question_is_answered_once_and_says_what_to_do_unless_all_is_good() -> None:
    checks = doctor.doctor()
    names = [check.name for check in checks]
    assert len(names) == len(set(names))
    for check in checks:
        assert check.found
        assert (check.verdict is Verdict.GOOD) == (not check.advice)


def test_it_tells_the_rights_that_the_loop_would_get() -> None:
    checks = doctor.doctor()
    with real_time_rights() as rights:
        expected = [(right.name, right.detail) for right in rights]
    assert [(named(checks, name).name, named(checks, name).found) for name, _ in expected] == expected


def test_here_the_simulated_rig_can_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor.main(["--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert {
        "name": "UDP multicast",
        "verdict": "good",
        "found": "frames arrive inside this host",
        "advice": "",
    } in rows


def test_where_the_loopback_interface_is_down_it_cannot() -> None:
    program = "import sys; from hil.host.doctor import main; sys.exit(main([]))"
    done = subprocess.run(["unshare", "-rn", sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "UDP multicast        missing " in done.stdout
    assert "\nUDP multicast:\n  sudo ip link set lo up\n" in done.stdout


def test_commands_to_copy_stay_on_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    command = "sudo " + "x" * 200
    doctor._print([Check("a name", Verdict.FAIR, "found [brackets]", command)])
    output = capsys.readouterr().out
    assert f"\na name:\n  {command}\n" in output
    assert "found [brackets]" in output


def test_a_missing_way_to_vcan_is_told_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise EnvironmentLackError("sudo apt-get install user-mode-linux")

    monkeypatch.setattr("hil.host.vcan.choose_way", refuse)
    check = named(list(doctor._can()), "hil vcan")
    assert check == (
        "hil vcan",
        Verdict.FAIR,
        "finds no way to a vcan0",
        "sudo apt-get install user-mode-linux",
    )


def test_can_interfaces_are_those_of_their_type(machine: Path) -> None:
    for name, kind, state in (("can0", 280, "up"), ("eth0", 1, "up"), ("vcan1", 280, "unknown")):
        write(machine, f"class/net/{name}/type", str(kind))
        write(machine, f"class/net/{name}/operstate", state)
    assert doctor._can_interfaces() == ["can0 (up)", "vcan1 (unknown)"]


@pytest.mark.parametrize(
    ("source", "verdict"),
    [("tsc", Verdict.GOOD), ("kvm-clock", Verdict.GOOD), ("hpet", Verdict.FAIR), ("acpi_pm", Verdict.FAIR)],
)
def test_a_slow_clock_source_is_told(machine: Path, source: str, verdict: Verdict) -> None:
    write(machine, "devices/system/clocksource/clocksource0/current_clocksource", source)
    check = named(list(doctor._clock()), "clock source")
    assert (check.found, check.verdict) == (source, verdict)


def test_a_coarse_timer_is_told(machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "clock_getres", lambda _clock: 0.004)
    check = named(list(doctor._clock()), "timer resolution")
    assert (check.found, check.verdict) == ("4000000 ns", Verdict.FAIR)


@pytest.mark.parametrize(
    ("governors", "verdict", "found"),
    [
        ([], Verdict.GOOD, "none: the frequency is not this system's to set"),
        (["performance", "performance"], Verdict.GOOD, "performance"),
        (["performance", "powersave"], Verdict.FAIR, "performance, powersave"),
    ],
)
def test_governors_other_than_performance_are_told(
    machine: Path, governors: list[str], verdict: Verdict, found: str
) -> None:
    for number, governor in enumerate(governors):
        write(machine, f"devices/system/cpu/cpu{number}/cpufreq/scaling_governor", governor)
    check = named(list(doctor._processors()), "frequency governor")
    assert (check.verdict, check.found) == (verdict, found)


def test_a_single_processor_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: {3})
    assert named(list(doctor._processors()), "processors").verdict is Verdict.FAIR


@pytest.mark.parametrize(
    ("runtime", "verdict"), [("950000", "good"), ("-1", "good"), ("0", "could be better")]
)
def test_forbidden_real_time_tasks_are_told(machine: Path, runtime: str, verdict: str) -> None:
    write(machine, "sys/kernel/sched_rt_runtime_us", runtime)
    check = named(list(doctor._limits()), "sched_rt_runtime_us")
    assert (check.found, check.verdict) == (runtime, verdict)


def test_a_limit_that_kills_a_busy_loop_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _kind: (200_000, 200_000))
    check = named(list(doctor._limits()), "RLIMIT_RTTIME")
    assert (check.found, check.verdict) == ("200000 us, at most 200000 us", Verdict.FAIR)


def test_serial_ports_with_a_slow_latency_timer_are_told(
    machine: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    devices = [tmp_path / name for name in ("ttyUSB0", "ttyUSB1", "ttyACM0", "ttyS0", "ttyS1", "ttyS2")]
    for device in devices:
        device.touch()
    locked = tmp_path / "ttyUSB9"
    ports = [SimpleNamespace(device=str(device)) for device in (*devices, locked)]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    write(machine, "bus/usb-serial/devices/ttyUSB0/latency_timer", "16")
    write(machine, "bus/usb-serial/devices/ttyUSB1/latency_timer", "1")
    checks = list(doctor._serial_ports())
    slow = named(checks, str(devices[0]))
    assert (slow.verdict, slow.found) == (Verdict.FAIR, "latency timer 16 ms")
    assert slow.advice.endswith(f"echo 1 | sudo tee {machine}/bus/usb-serial/devices/ttyUSB0/latency_timer")
    assert named(checks, str(locked)).advice == "sudo adduser $USER dialout; log in again"
    assert named(checks, "serial ports").found == (
        f"{devices[2]}, {devices[3]}, {devices[4]}, {devices[5]} and 1 more"
    )


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
    assert doctor._advice(Right("SCHED_FIFO", False, "Operation not permitted")) == advice
    assert doctor._advice(Right("processor sleep", False, os.strerror(errno.ENOENT))) == ""


def test_wake_ups_are_measured_from_absolute_deadlines(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_ns=0)

    def wait(_read: object, _write: object, _error: object, timeout_s: float) -> None:
        clock.now_ns += round(timeout_s * 1e9) + 300_000

    monkeypatch.setattr(time, "monotonic_ns", lambda: clock.now_ns)
    monkeypatch.setattr(doctor, "select", wait)
    assert doctor._wake_up_lateness_ns() == [300_000] * doctor.WAKE_UPS
    assert clock.now_ns == doctor.WAKE_UPS * doctor.PERIOD_NS + 300_000
