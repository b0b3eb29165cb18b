"""The doctor's findings about buses, on machines made of files and on this one."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from support.doctor_checks import check_named, write_kernel_file

from hil.core.errors import EnvironmentLackError
from hil.host.doctor import CheckVerdict, buses, kernel_files
from hil.host.vcan import Way
from hil.host.vcan.console import OTHER_WAY, MachineStoppedError

CONSOLE = "userspace - ptrace set fp regs failed, errno = 14\nKernel panic - not syncing\nCPU: 0\n"


class TestVirtualCan:
    def test_a_missing_way_is_reported_with_its_remedy(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse() -> None:
            raise EnvironmentLackError("sudo apt-get install user-mode-linux")

        monkeypatch.setattr("hil.host.vcan.choose_way", refuse)
        (check,) = buses.virtual_can()
        assert check == (
            "hil vcan",
            CheckVerdict.FAIR,
            "finds no way to vcan0",
            "sudo apt-get install user-mode-linux",
        )

    def test_an_interface_of_this_host_is_good(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("hil.host.vcan.choose_way", lambda: Way.NATIVE)
        (check,) = buses.virtual_can()
        assert check == ("hil vcan", CheckVerdict.GOOD, "uses vcan0 of this host", "")

    @pytest.fixture
    def user_mode_linux(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("hil.host.vcan.choose_way", lambda: Way.USER_MODE_LINUX)

    @pytest.mark.usefixtures("user_mode_linux")
    def test_user_mode_linux_is_started(self) -> None:
        (check,) = buses.virtual_can()
        assert check.verdict is CheckVerdict.GOOD, check
        assert check.found.startswith("uses user-mode Linux, which started and made vcan0 in ")

    @pytest.mark.usefixtures("user_mode_linux")
    def test_user_mode_linux_that_does_not_start_is_reported_with_its_console(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def stop() -> float:
            raise MachineStoppedError("user-mode Linux does not start", CONSOLE)

        monkeypatch.setattr("hil.host.vcan.user_mode_linux.try_user_mode_linux", stop)
        (check,) = buses.virtual_can()
        assert check.verdict is CheckVerdict.FAIR
        assert check.found == (
            "user-mode Linux does not start; its console ended with: "
            "userspace - ptrace set fp regs failed, errno = 14 / Kernel panic - not syncing"
        )
        assert "pip install -e ." in check.advice

    @pytest.mark.usefixtures("user_mode_linux")
    def test_a_host_without_room_for_it_is_reported(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail() -> float:
            raise OSError(28, "No space left on device", "/tmp/job")

        monkeypatch.setattr("hil.host.vcan.user_mode_linux.try_user_mode_linux", fail)
        (check,) = buses.virtual_can()
        assert "No space left on device" in check.found
        assert check.advice == OTHER_WAY


def test_can_interfaces_are_found_by_their_type(kernel: Path) -> None:
    for name, kind, state in (("can0", 280, "up"), ("eth0", 1, "up"), ("vcan1", 280, "unknown")):
        write_kernel_file(kernel, f"class/net/{name}/type", str(kind))
        write_kernel_file(kernel, f"class/net/{name}/operstate", state)
    assert buses._can_interfaces() == ["can0 (up)", "vcan1 (unknown)"]


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty /sys."""
    monkeypatch.setattr(kernel_files, "SYS", tmp_path)
    return tmp_path


def test_serial_ports_with_a_slow_latency_timer_are_reported(
    kernel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    devices = [tmp_path / name for name in ("ttyUSB0", "ttyUSB1", "ttyACM0", "ttyS0", "ttyS1", "ttyS2")]
    for device in devices:
        device.touch()
    locked = tmp_path / "ttyUSB9"
    ports = [SimpleNamespace(device=str(device)) for device in (*devices, locked)]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: ports)
    write_kernel_file(kernel, "bus/usb-serial/devices/ttyUSB0/latency_timer", "16")
    write_kernel_file(kernel, "bus/usb-serial/devices/ttyUSB1/latency_timer", "1")
    checks = list(buses.serial_ports())
    slow = check_named(checks, str(devices[0]))
    assert (slow.verdict, slow.found) == (CheckVerdict.FAIR, "latency timer 16 ms")
    assert slow.advice.endswith(f"echo 1 | sudo tee {kernel}/bus/usb-serial/devices/ttyUSB0/latency_timer")
    assert check_named(checks, str(locked)).advice == "sudo adduser $USER dialout; log in again"
    assert check_named(checks, "serial ports").found == (
        f"{devices[2]}, {devices[3]}, {devices[4]}, {devices[5]} and 1 more"
    )
