"""What a console says is reduced to its last lines and explained."""

import subprocess
import sys
from pathlib import Path

import pytest

from hil.host.vcan import machine
from hil.host.vcan.console import OTHER_WAY, MachineStoppedError, last_lines
from hil.host.vcan.user_mode_linux import try_user_mode_linux

PANIC = """\
SELinux: CONFIG_SECURITY_SELINUX_CHECKREQPROT_VALUE is non-zero.
mmapper_init - find_iomem failed
<6>Zone ranges:
<3>userspace - ptrace set fp regs failed, errno = 14

<0>Kernel panic - not syncing: Attempted to kill init! exitcode=0x0000000b
<4>CPU: 0 PID: 1 Comm: sh Not tainted 6.1.176 #1
Stack:
 606944ba 607e7fcd 9c88bb90 6067bb96
Call Trace:
 [<606944ba>] ? _printk+0x0/0x94
"""


class TestConsole:
    def test_the_last_lines_are_those_before_the_stack_trace(self) -> None:
        assert last_lines(PANIC) == [
            "Zone ranges:",
            "userspace - ptrace set fp regs failed, errno = 14",
            "Kernel panic - not syncing: Attempted to kill init! exitcode=0x0000000b",
        ]

    def test_an_empty_console_has_no_lines(self) -> None:
        assert last_lines("\n \n") == []
        assert "(nothing)" in str(MachineStoppedError("it stopped", ""))

    @pytest.mark.parametrize(
        ("console", "remedy"),
        [
            (PANIC, "pip install -e ."),
            ("Operation not permitted\n/dev/shm must be not mounted noexec", "remount,exec"),
            ("ptrace: Operation not permitted", "--cap-add SYS_PTRACE"),
            ("<3>Bus error - the host /dev/shm or /tmp mount likely just ran out of space", "--shm-size"),
            ("setup_physmem - mapping 2131664896 bytes of memory at 0x1 failed - errno = -12", "ulimit -v"),
            ("anything else", OTHER_WAY),
        ],
    )
    def test_the_remedy_fits_the_cause(self, console: str, remedy: str) -> None:
        error = MachineStoppedError("user-mode Linux does not start", console)
        assert remedy in error.remedy
        assert error.remedy in str(error)
        assert error.last_lines[-1] in str(error)


class TestTrial:
    """What ``hil doctor`` does."""

    def test_it_starts_and_finds_vcan0(self) -> None:
        assert 0.0 < try_user_mode_linux() < 60.0

    def test_a_start_without_vcan0_is_an_error(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        program = tmp_path / "linux.uml"
        report = 'for word; do case $word in job=*) echo 1 >"${word#job=}/status";; esac; done'
        program.write_text(f"#!/bin/sh\n{report}\n")
        program.chmod(0o755)
        monkeypatch.setattr(machine, "find_program", lambda _name: str(program))
        with pytest.raises(MachineStoppedError, match="starts, but cannot make vcan0"):
            try_user_mode_linux()

    def test_a_machine_that_hangs_is_switched_off(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        program = tmp_path / "linux.uml"
        program.write_text(f"#!/bin/sh\necho $$ >{tmp_path}/pid; echo booting; exec sleep 100\n")
        program.chmod(0o755)
        monkeypatch.setattr(machine, "find_program", lambda _name: str(program))
        with pytest.raises(MachineStoppedError) as caught:
            try_user_mode_linux(timeout_s=0.5)
        assert caught.value.problem == "user-mode Linux did not start within 0.5 s"
        assert caught.value.last_lines == ["booting"]
        assert not Path(f"/proc/{(tmp_path / 'pid').read_text().strip()}").exists()

    def test_a_host_that_forbids_executable_memory_files_is_explained(self) -> None:
        """The real console, in a mount namespace whose /dev/shm is mounted noexec."""
        program = (
            "from hil.host.vcan import machine, user_mode_linux\n"
            "machine._directory_for_memory = lambda: '/dev/shm'\n"
            "try: user_mode_linux.try_user_mode_linux()\n"
            "except Exception as error: print(error)\n"
        )
        mount = 'mount -t tmpfs -o noexec tmpfs /dev/shm && exec "$@"'
        done = subprocess.run(
            ["unshare", "-rm", "sh", "-c", mount, "-", sys.executable, "-c", program],
            capture_output=True,
            text=True,
        )
        assert "user-mode Linux does not start." in done.stdout, done.stderr
        assert "sudo mount -o remount,exec /dev/shm" in done.stdout
