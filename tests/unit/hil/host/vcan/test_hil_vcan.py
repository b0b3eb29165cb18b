"""``hil vcan`` by the way that this machine offers. tests/vcan tries the others, inside user-mode Linux."""

import json
import os
import pty
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from hil.cli.vcan import main
from hil.core.errors import EnvironmentLackError
from hil.host.vcan import Way, choose_way, machine, user_mode_linux

VCAN = [sys.executable, "-m", "hil.cli", "vcan", "--"]

EXAMINE = r"""
import json, os, subprocess, sys, time

exchange = "candump -L -n 1 vcan0 & until cansend vcan0 123#C0FFEE && ! kill -0 $!; do :; done"
subprocess.Popen(["setsid", "sleep", "50"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
found = {
    "arguments": sys.argv[1:],
    "directory": os.getcwd(),
    "environment": [os.environ[name] for name in ("ODD", "bash_func%%")],
    "is a terminal": [os.isatty(1), os.isatty(2)],
    "time_ns": time.time_ns(),
    "candump": subprocess.check_output(["sh", "-c", exchange], text=True, stderr=subprocess.DEVNULL),
}
out = sys.stdout.buffer
out.write(json.dumps(found).encode() + b"\n" + b"a\0\r\n\xff\tb\n")
out.write(b"".join(b"%d\n" % number for number in range(200_000)))
sys.stderr.write("no\n\nnewline")
sys.exit(7)
"""
"""A program that examines its surroundings, writes much, and leaves a process behind."""

ARGUMENTS = ["a  b", "'", '"', "$HOME", "", "*", "\n", "é", "-n", "--help", "--"]
ODD = "two\nlines ' \" $X \\"


def run(*command: str, **options: Any) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*VCAN, *command], capture_output=True, timeout=60, **options)


class Examined(NamedTuple):
    done: subprocess.CompletedProcess[bytes]
    found: dict[str, Any]
    directory: Path
    start_ns: int
    end_ns: int


@pytest.fixture(scope="module")
def examined(tmp_path_factory: pytest.TempPathFactory) -> Examined:
    """One run of the program that examines its surroundings."""
    directory = tmp_path_factory.mktemp("vcan") / "it's a $HOME"
    directory.mkdir()
    environment = {**os.environ, "ODD": ODD, "bash_func%%": "() { :; }"}
    start_ns = time.time_ns()
    done = run(sys.executable, "-c", EXAMINE, *ARGUMENTS, cwd=directory, env=environment)
    end_ns = time.time_ns()
    assert done.stdout, done.stderr
    return Examined(done, json.loads(done.stdout.splitlines()[0]), directory, start_ns, end_ns)


class TestExamined:
    def test_vcan0_carries_frames(self, examined: Examined) -> None:
        assert examined.found["candump"].split()[1:] == ["vcan0", "123#C0FFEE"]

    def test_the_exit_status_is_the_commands(self, examined: Examined) -> None:
        assert examined.done.returncode == 7

    def test_output_and_errors_come_back_byte_by_byte(self, examined: Examined) -> None:
        _, _, rest = examined.done.stdout.partition(b"\n")
        assert rest.startswith(b"a\0\r\n\xff\tb\n")
        assert examined.done.stderr == b"no\n\nnewline"

    def test_long_output_is_complete(self, examined: Examined) -> None:
        expected = b"".join(b"%d\n" % number for number in range(200_000))
        assert examined.done.stdout.endswith(b"\tb\n" + expected)

    def test_arguments_environment_and_directory_are_handed_over(self, examined: Examined) -> None:
        assert examined.found["arguments"] == ARGUMENTS
        assert examined.found["directory"] == str(examined.directory)
        assert examined.found["environment"] == [ODD, "() { :; }"]

    def test_the_clock_is_the_hosts(self, examined: Examined) -> None:
        tolerance_ns = 10_000_000
        time_ns = examined.found["time_ns"]
        assert examined.start_ns - tolerance_ns < time_ns < examined.end_ns + tolerance_ns

    def test_a_pipe_is_not_taken_for_a_terminal(self, examined: Examined) -> None:
        assert examined.found["is a terminal"] == [False, False]

    def test_a_process_that_the_command_leaves_behind_does_not_delay_the_end(
        self, examined: Examined
    ) -> None:
        assert examined.end_ns - examined.start_ns < 40e9


@pytest.fixture
def waiting() -> Iterator[subprocess.Popen[str]]:
    """A command that has started, prints the signals that it gets, and would wait for a minute."""
    script = "trap 'echo INT; exit 42' INT; trap 'echo TERM; exit 43' TERM; echo ready; sleep 60 & wait"
    with subprocess.Popen([*VCAN, "sh", "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process
        process.kill()


def test_files_are_shared_and_output_is_passed_on_while_the_command_runs(tmp_path: Path) -> None:
    script = f"echo begun; until [ -e {tmp_path}/go ]; do sleep 0.05; done; echo more >{tmp_path}/result"
    with subprocess.Popen([*VCAN, "sh", "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"begun\n"
        assert process.poll() is None
        (tmp_path / "go").touch()
        assert process.wait(timeout=30) == 0
    assert (tmp_path / "result").read_text() == "more\n"


def test_a_terminal_is_a_terminal_for_the_command() -> None:
    terminal, theirs = pty.openpty()
    termios.tcsetwinsize(theirs, (41, 123))
    script = "test -t 1 && stty size <&1"
    with subprocess.Popen([*VCAN, "sh", "-c", script], stdout=theirs, stderr=subprocess.PIPE) as process:
        assert process.wait(timeout=60) == 0
    assert os.read(terminal, 100) == b"41 123\r\n"


@pytest.mark.parametrize(
    ("number", "name", "status"), [(signal.SIGINT, "INT", 42), (signal.SIGTERM, "TERM", 43)]
)
def test_signals_reach_the_command(
    waiting: subprocess.Popen[str], number: signal.Signals, name: str, status: int
) -> None:
    waiting.send_signal(number)
    output, _ = waiting.communicate(timeout=30)
    assert (output, waiting.returncode) == (f"{name}\n", status)


def test_no_process_outlives_it_when_it_is_killed(waiting: subprocess.Popen[str]) -> None:
    children = Path(f"/proc/{waiting.pid}/task/{waiting.pid}/children").read_text().split()
    endings = [os.pidfd_open(int(child)) for child in children]
    waiting.kill()
    for ending in endings:
        assert select.select([ending], [], [], 30)[0]
        os.close(ending)


def test_the_status_of_a_command_that_is_not_found_is_127() -> None:
    done = run("no-such-command")
    assert done.returncode == 127
    assert b"no-such-command" in done.stderr


def test_without_a_command_the_usage_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--"])
    assert caught.value.code == 2
    assert "hil vcan -- candump vcan0" in capsys.readouterr().err


@pytest.fixture
def no_vcan(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel without vcan."""
    monkeypatch.setattr("hil.host.vcan.ways._is_up", lambda: False)
    monkeypatch.setattr("hil.host.vcan.ways._namespace_command", list)


@pytest.mark.usefixtures("no_vcan")
class TestUserModeLinux:
    def test_it_is_the_last_way(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(user_mode_linux, "find_program", lambda program: f"/usr/bin/{program}")
        monkeypatch.setattr(user_mode_linux, "_MODULES", Path("/"))
        assert choose_way() is Way.USER_MODE_LINUX

    @pytest.mark.parametrize(
        ("missing", "packages"),
        [({"linux.uml"}, "user-mode-linux"), ({"modprobe", "ip"}, "kmod iproute2")],
    )
    def test_a_missing_program_is_named_with_the_command_that_installs_it(
        self, missing: set[str], packages: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(user_mode_linux, "find_program", lambda name: None if name in missing else name)
        monkeypatch.setattr(user_mode_linux, "_MODULES", Path("/"))
        with pytest.raises(EnvironmentLackError) as caught:
            choose_way()
        assert str(caught.value).endswith(f"sudo apt-get install --no-install-recommends {packages}")
        assert "sudo modprobe vcan" in str(caught.value)

    def test_a_missing_library_is_found_before_the_start(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse() -> Path:
            raise EnvironmentLackError("not compiled")

        monkeypatch.setattr(user_mode_linux, "find_program", lambda program: f"/usr/bin/{program}")
        monkeypatch.setattr(user_mode_linux, "_MODULES", Path("/"))
        monkeypatch.setattr(user_mode_linux, "xsave_area_library", refuse)
        with pytest.raises(EnvironmentLackError, match="not compiled"):
            choose_way()


def test_a_machine_that_does_not_boot_is_an_error_with_its_console(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "find_program", lambda _program: "/bin/echo")
    with pytest.raises(EnvironmentLackError, match=r"ended before the command did(.|\n)*rootfstype=hostfs"):
        user_mode_linux.run_in_user_mode_linux(["true"])
