"""The command ``firmware-sim``: a process on a bus that a signal ends, and its errors."""

from __future__ import annotations

import gc
import os
import re
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from support.board_bench import decoded
from support.shipped_rig import RIG_TEXT

import hil
from firmware_sim import cli
from hil.core.errors import HilError, LinkError
from hil.core.frames import Frame
from hil.links import Link, Received, open_link

COMMAND = [sys.executable, "-m", "firmware_sim"]
LIMIT_S = 20


@pytest.fixture
def restored_process() -> Iterator[None]:
    """Restore what ``main`` changes in this process: signal handlers, scheduling, garbage collector."""
    numbers = (signal.SIGINT, signal.SIGTERM)
    handlers = [signal.getsignal(number) for number in numbers]
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    yield
    for number, handler in zip(numbers, handlers, strict=True):
        signal.signal(number, handler)
    if os.sched_getscheduler(0) != policy:
        os.sched_setscheduler(0, policy, parameter)
    gc.unfreeze()


@pytest.fixture
def port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def started(bus: str) -> tuple[subprocess.Popen[str], str]:
    """Start the boards. Returns the process when it is ready, and the bus that it prints."""
    process = subprocess.Popen([*COMMAND, "--linear", "--bus", bus], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if joined := re.fullmatch(r"join with: hil run --bus (\S+)\n", line):
            return process, joined[1]
    raise AssertionError(f"firmware-sim ended with {process.wait()}")


def next_frame(link: Link, identifier: int) -> Frame:
    while (received := link.receive(LIMIT_S)) is not None:
        if received.frame.id == identifier:
            return received.frame
    raise AssertionError(f"no {identifier:03X} within {LIMIT_S} s")


def exchange_a_sample(link: Link) -> None:
    link.send(Frame(0x000, b"\x01\x00"))
    link.send(Frame(0x080))
    sample = next_frame(link, 0x190)
    assert decoded(sample) == ((16384, 16384, 16384), 0)
    while next_frame(link, 0x720).data != b"\x05":
        pass


@pytest.mark.parametrize(("kind", "ending"), [("udp", signal.SIGTERM), ("pty", signal.SIGINT)])
def test_boards_answer_on_the_bus_until_a_signal_ends_the_program(
    kind: str, ending: signal.Signals, port: int
) -> None:
    process, spec = started(f"udp:{port}" if kind == "udp" else "pty")
    with process, open_link(spec) as link:
        try:
            exchange_a_sample(link)
        finally:
            process.send_signal(ending)
        assert process.wait(LIMIT_S) == 0


def test_a_signal_ends_the_program_although_its_exception_is_discarded(
    monkeypatch: pytest.MonkeyPatch, restored_process: None
) -> None:
    """As if it came while the interpreter runs a callback, before the first frame."""
    bus = GatewayBus()

    def interrupted(_boards: object, _plant: object, _options: object) -> None:
        with pytest.raises(SystemExit):
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(cli, "_watch", interrupted)
    monkeypatch.setattr(cli, "_open", lambda spec, _bit_rate: (bus, spec))
    assert cli.main(["--linear", "--bus", "inproc:interrupted"]) == 0
    assert bus.sent == []


@pytest.mark.parametrize("lines", [1, 2, 3, 4])
def test_a_signal_right_after_a_line_of_the_start_ends_the_program(lines: int) -> None:
    command = [*COMMAND, "--linear", "--bus", "pty"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, bufsize=1) as process:
        assert process.stdout is not None
        for _ in range(lines):
            process.stdout.readline()
        process.terminate()
        assert process.wait(LIMIT_S) == 0


def test_a_host_sees_the_serial_device_disappear() -> None:
    process, spec = started("pty")
    with process, open_link(spec) as link:
        process.kill()
        process.wait(LIMIT_S)
        with pytest.raises(LinkError, match="closed the line"):
            next_frame(link, 0x7FF)


def test_the_program_ends_when_its_parent_is_killed(port: int) -> None:
    program = (
        "import os, subprocess, sys\n"
        f"child = subprocess.Popen([*{COMMAND!r}, '--bus', 'udp:{port}', '--parent-pid', str(os.getpid())],"
        " stdout=subprocess.PIPE)\n"
        "child.stdout.readline()\n"
        "print(child.pid, flush=True)\n"
        "child.wait()\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    with parent:
        assert parent.stdout is not None
        child = os.pidfd_open(int(parent.stdout.readline()))
        assert not select.select([child], [], [], 0)[0]
        parent.kill()
        assert select.select([child], [], [], LIMIT_S)[0]
        os.close(child)


def test_a_process_that_is_not_the_parent_is_rejected(
    restored_process: None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["--bus", "pty", "--parent-pid", "1"]) == 2
    assert f"the parent is process {os.getppid()}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--bus", "nonsense:1"], "names no bus"),
        (["--bus", "pty", "--rig", "absent.toml"], "absent.toml: cannot be read: No such file"),
        (
            ["--bus", "pty", "--rig", "broken.toml"],
            "broken.toml: loop.period_s is 7.0, but must be at most 1.0",
        ),
        (["--bus", "pty", "--rig", "binary.toml"], "binary.toml: is not text"),
        (["--bus", "pty", "--watch", "--linear"], "--watch shows the pneumatic arm and no linear model"),
        (["--bus", "pty", "--watch", "--plant", "vertical=paper"], "--watch shows the pneumatic arm"),
        (["--bus", "pty", "--plant", "rotation=paper"], "output_unit: m, but axis rotation is in rad"),
    ],
)
def test_wrong_input_gives_a_message_without_a_traceback(
    arguments: list[str],
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    restored_process: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("broken.toml").write_text(re.sub(r"period_s = [\d.]+", "period_s = 7.0", RIG_TEXT))
    Path("binary.toml").write_bytes(b"\xff\xfe")
    assert cli.main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("firmware-sim: ")
    assert complaint in error


class DivergingPlant:
    def __init__(self, rig: object) -> None:
        pass

    def advance(self, duration_ns: int, valve_v: Sequence[float]) -> None:
        raise HilError("vertical: position 3.2 m exceeds 0.15 m")

    def potentiometer_v(self) -> Sequence[float]:
        return [5.0, 5.0, 5.0]


class GatewayBus:
    """A bus on which a gateway starts the boards and then sends SYNC."""

    def __init__(self) -> None:
        self.sent: list[Frame] = []
        self._frames = [Frame(0x000, b"\x01\x00"), Frame(0x080), Frame(0x080)]

    def send(self, frame: Frame) -> None:
        self.sent.append(frame)

    def receive(self, timeout_s: float) -> Received | None:
        return Received(self._frames.pop(0), time.time_ns(), "kernel")

    def close(self) -> None:
        pass


def test_a_failing_plant_ends_the_program_with_its_message(
    monkeypatch: pytest.MonkeyPatch, restored_process: None, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = GatewayBus()
    monkeypatch.setattr(cli, "build_plant", lambda rig, _options: (DivergingPlant(rig), "a plant"))
    monkeypatch.setattr(cli, "_open", lambda spec, _bit_rate: (bus, spec))
    assert cli.main(["--bus", "inproc:diverging"]) == 1
    assert capsys.readouterr().err == "firmware-sim: vertical: position 3.2 m exceeds 0.15 m\n"
    assert [frame.id for frame in bus.sent] == [0x710, 0x720, 0x190]


def test_the_boards_run_without_the_right_to_a_priority(
    monkeypatch: pytest.MonkeyPatch, restored_process: None
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    ran = []
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(cli, "simulate", lambda rig, *_: ran.append(rig))
    assert cli.main(["--bus", "inproc:no right"]) == 0
    assert len(ran) == 1


@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-8-sig"]
)  # with a byte order mark, which hil run accepts too
def test_the_boards_use_the_rig_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, restored_process: None, encoding: str
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(
        RIG_TEXT.replace("watchdog_timeout_s = 0.0896", "watchdog_timeout_s = 0.0784"), encoding=encoding
    )
    seen = []
    monkeypatch.setattr(cli, "simulate", lambda rig, *_: seen.append(rig))
    assert cli.main(["--bus", "inproc:set up", "--rig", str(path)]) == 0
    assert seen[0].dac._watchdog_ns == 7 * 11_200_000


def test_the_boards_import_no_heavy_library_and_no_wire_code_of_the_gateway() -> None:
    program = (
        "import sys, firmware_sim.cli\n"
        "heavy = {'numpy', 'scipy', 'control', 'matplotlib', 'can', 'rich'} & set(sys.modules)\n"
        "shared = {name for name in sys.modules if name.startswith(('hil.core.wire', 'hil.core.gateway'))}\n"
        "sys.exit(f'imported {heavy | shared}' if heavy | shared else 0)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_version_prints_the_version_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"firmware-sim {hil.__version__}\n"


def test_the_safe_path_keeps_modules_of_the_working_directory_out(tmp_path: Path) -> None:
    """``hil run`` starts the boards with ``python -P``. A module that lies in its directory must not run."""
    for name in ("json", "msgspec", "can", "firmware_sim", "hil"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported from the working directory')")
    command = [sys.executable, "-P", "-m", "firmware_sim", "--bus", "pty"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stdout is not None
        printed = [next(process.stdout) for _ in range(4)]
        process.terminate()
    assert printed[-1].startswith("join with: ")
    assert process.returncode == 0
