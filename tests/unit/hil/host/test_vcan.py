"""``hil vcan`` by whichever way this machine has; tests/vcan runs the other ways inside."""

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

import pytest

from hil.core.errors import EnvironmentLackError
from hil.host.vcan import Way, choose_way, main, user_mode_linux

VCAN = [sys.executable, "-m", "hil.cli", "vcan", "--"]


def run(*command: str | bytes, **options: object) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([*VCAN, *command], capture_output=True, timeout=60, **options)  # type: ignore[call-overload]


@pytest.fixture
def waiting() -> Iterator[subprocess.Popen[str]]:
    """A command that has started, says what signals it got, and would wait for a minute."""
    script = "trap 'echo INT; exit 42' INT; trap 'echo TERM; exit 43' TERM; echo ready; sleep 60 & wait"
    with subprocess.Popen([*VCAN, "sh", "-c", script], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        yield process
        process.kill()


def test_vcan0_is_there_and_carries_frames() -> None:
    done = run(
        "sh", "-c", "candump -L -n 1 vcan0 & until cansend vcan0 123#C0FFEE && ! kill -0 $!; do :; done"
    )
    assert done.stdout.split()[-1:] == [b"123#C0FFEE"], done.stderr


def test_status_output_and_errors_come_back_byte_by_byte() -> None:
    done = run("sh", "-c", r"printf 'a\000\r\n\377\tb'; printf 'no\n\nnewline' >&2; exit 7")
    assert (done.stdout, done.stderr, done.returncode) == (b"a\0\r\n\xff\tb", b"no\n\nnewline", 7)


def test_much_output_is_not_lost() -> None:
    done = run("seq", "200000")
    assert done.stdout == b"".join(b"%d\n" % number for number in range(1, 200001))
    assert done.returncode == 0


def test_arguments_environment_and_directory_are_handed_over(tmp_path: Path) -> None:
    directory = tmp_path / "it's a $HOME"
    directory.mkdir()
    environment = {**os.environ, "ODD": "two\nlines ' \" $X \\", "bash_func%%": "() { :; }"}
    program = (
        "import os, sys; print([sys.argv[1:], os.getcwd(), os.environ['ODD'], os.environ['bash_func%%']])"
    )
    arguments = ["a  b", "'", '"', "$HOME", "", "*", "\n", "é"]
    done = run(sys.executable, "-c", program, *arguments, cwd=directory, env=environment)
    expected = [arguments, str(directory), environment["ODD"], environment["bash_func%%"]]
    assert done.stdout.decode() == f"{expected}\n", done.stderr


def test_files_are_shared_and_output_is_seen_while_the_command_runs(tmp_path: Path) -> None:
    script = f"echo begun; until [ -e {tmp_path}/go ]; do sleep 0.05; done; echo more >{tmp_path}/result"
    with subprocess.Popen([*VCAN, "sh", "-c", script], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"begun\n"
        assert process.poll() is None
        (tmp_path / "go").touch()
        assert process.wait(timeout=30) == 0
    assert (tmp_path / "result").read_text() == "more\n"


def test_its_clock_is_the_hosts() -> None:
    start_ns = time.time_ns()
    done = run("date", "+%s%N")
    assert start_ns - 10_000_000 < int(done.stdout) < time.time_ns() + 10_000_000


def test_a_pipe_is_a_pipe_in_there() -> None:
    assert run("sh", "-c", "[ -t 1 ] || [ -t 2 ]").returncode == 1


def test_a_terminal_is_a_terminal_in_there() -> None:
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


def test_nothing_outlives_it_when_it_is_killed(waiting: subprocess.Popen[str]) -> None:
    children = Path(f"/proc/{waiting.pid}/task/{waiting.pid}/children").read_text().split()
    endings = [os.pidfd_open(int(child)) for child in children]
    waiting.kill()
    for ending in endings:
        assert select.select([ending], [], [], 30)[0]
        os.close(ending)


def test_what_the_command_leaves_behind_does_not_hold_it_up() -> None:
    start = time.monotonic()
    assert run("sh", "-c", "setsid sleep 50 >/dev/null 2>&1 & exit 3").returncode == 3
    assert time.monotonic() - start < 40


def test_a_command_that_is_not_found_is_127() -> None:
    done = run("no-such-command")
    assert done.returncode == 127
    assert b"no-such-command" in done.stderr


def test_no_command_is_wrong_use(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--"])
    assert caught.value.code == 2
    assert "hil vcan -- candump vcan0" in capsys.readouterr().err


def test_options_after_the_command_are_the_commands() -> None:
    done = run("echo", "-n", "--help", "--")
    assert done.stdout == b"--help --"


@pytest.fixture
def no_vcan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.host.vcan._is_up", lambda: False)
    monkeypatch.setattr("hil.host.vcan._namespace", list)


@pytest.mark.usefixtures("no_vcan")
def test_user_mode_linux_is_the_last_way(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(user_mode_linux, "_find", lambda program: f"/usr/bin/{program}")
    monkeypatch.setattr(user_mode_linux, "_MODULES", Path("/"))
    assert choose_way() is Way.USER_MODE_LINUX


@pytest.mark.usefixtures("no_vcan")
@pytest.mark.parametrize(
    ("missing", "packages"),
    [({"linux.uml"}, "user-mode-linux"), ({"modprobe", "ip"}, "kmod iproute2")],
)
def test_what_is_missing_is_named_with_the_command_that_installs_it(
    missing: set[str], packages: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(user_mode_linux, "_find", lambda name: None if name in missing else name)
    monkeypatch.setattr(user_mode_linux, "_MODULES", Path("/"))
    with pytest.raises(EnvironmentLackError) as caught:
        choose_way()
    assert str(caught.value).endswith(f"sudo apt-get install --no-install-recommends {packages}")
    assert "sudo modprobe vcan" in str(caught.value)


def test_a_machine_that_does_not_boot_is_an_error_with_its_console(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(user_mode_linux, "_find", lambda _program: "/bin/echo")
    with pytest.raises(EnvironmentLackError, match=r"ended before the command did(.|\n)*rootfstype=hostfs"):
        user_mode_linux.run_in_user_mode_linux(["true"])
