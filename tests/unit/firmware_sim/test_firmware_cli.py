"""``firmware-sim`` as people and ``hil run`` start it: a process on a bus, ended by signals."""

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
from support.board_bench import RIG, HandPlant

from firmware_sim import cli
from firmware_sim.boards.codec import decode_values
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import HilError, LinkError
from hil.core.frames import Frame
from hil.links import Link, Received, open_link

COMMAND = [sys.executable, "-m", "firmware_sim"]
LIMIT_S = 20


@pytest.fixture
def process_kept() -> Iterator[None]:
    """What ``main`` changes of its process is put back."""
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
    """The process once it is ready, and the bus that it says to join."""
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
    assert decode_values(sample.data, protected=True) == ((16384, 16384, 16384), 0)
    while next_frame(link, 0x720).data != b"\x05":
        pass


@pytest.mark.parametrize(("kind", "ending"), [("udp", signal.SIGTERM), ("pty", signal.SIGINT)])
def test_boards_answer_on_the_bus_and_a_signal_ends_them(
    kind: str, ending: signal.Signals, port: int
) -> None:
    process, spec = started(f"udp:{port}" if kind == "udp" else "pty")
    with process, open_link(spec) as link:
        try:
            exchange_a_sample(link)
        finally:
            process.send_signal(ending)
        assert process.wait(LIMIT_S) == 0


def test_a_host_on_the_serial_device_sees_it_go() -> None:
    process, spec = started("pty")
    with process, open_link(spec) as link:
        process.kill()
        process.wait(LIMIT_S)
        with pytest.raises(LinkError, match="closed the line"):
            next_frame(link, 0x7FF)


def test_it_dies_with_the_parent_that_asked_for_it_even_by_kill_9(port: int) -> None:
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


def test_a_parent_that_is_not_the_parent_is_refused(
    process_kept: None, capsys: pytest.CaptureFixture[str]
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
            "broken.toml: loop.period_s: 7.0: expected `float` <= 1.0",
        ),
        (["--bus", "pty", "--rig", "binary.toml"], "binary.toml: is not text"),
    ],
)
def test_wrong_input_is_told_without_a_traceback(
    arguments: list[str],
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    process_kept: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = (Path(cli.__file__).parents[1] / "hil" / "shipped" / "rig.toml").read_text()
    Path("broken.toml").write_text(re.sub(r"period_s = [\d.]+", "period_s = 7.0", shipped))
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
    """A bus on which a gateway starts the boards and sends SYNC."""

    def __init__(self) -> None:
        self.heard: list[Frame] = []
        self._frames = [Frame(0x000, b"\x01\x00"), Frame(0x080), Frame(0x080)]

    def send(self, frame: Frame) -> None:
        self.heard.append(frame)

    def receive(self, timeout_s: float) -> Received | None:
        return Received(self._frames.pop(0), time.time_ns(), "kernel")

    def close(self) -> None:
        pass


def test_a_failing_plant_ends_it_with_its_message_and_both_boards_fall_silent(
    monkeypatch: pytest.MonkeyPatch, process_kept: None, capsys: pytest.CaptureFixture[str]
) -> None:
    bus = GatewayBus()
    monkeypatch.setattr(cli, "build_plant", lambda rig, _options: (DivergingPlant(rig), "a plant"))
    monkeypatch.setattr(cli, "_open", lambda spec: (bus, spec))
    assert cli.main(["--bus", "inproc:diverging"]) == 1
    assert capsys.readouterr().err == "firmware-sim: vertical: position 3.2 m exceeds 0.15 m\n"
    assert [frame.id for frame in bus.heard] == [0x710, 0x720, 0x190]


class SteppedBus:
    """A bus and the clocks: each step passes a time, sets the wall clock by another, and gives a frame."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, steps: list[tuple[int, int, int]]) -> None:
        self.monotonic_ns, self.wall_offset_ns = 10**12, 10**18
        monkeypatch.setattr(cli, "monotonic_ns", lambda: self.monotonic_ns)
        monkeypatch.setattr(cli, "time_ns", lambda: self.monotonic_ns + self.wall_offset_ns)
        self.steps = steps

    def send(self, frame: Frame) -> None:
        pass

    def close(self) -> None:
        pass

    def receive(self, timeout_s: float) -> Received | None:
        if not self.steps:
            raise LinkError("over")
        passed_ns, age_ns, set_ns = self.steps.pop(0)
        self.monotonic_ns += passed_ns
        stamp_ns = self.monotonic_ns + self.wall_offset_ns - age_ns
        self.wall_offset_ns += set_ns
        return Received(Frame(0x080), stamp_ns, "kernel")


MS = 1_000_000
HOUR = 3_600_000 * MS


@pytest.mark.parametrize(
    ("steps", "expected_ms"),
    [
        ([(50 * MS, 0, 0), (11 * MS, 0, 0)], [50, 61]),
        ([(50 * MS, 40 * MS, 0), (0, 29 * MS, 0)], [10, 21]),
        ([(50 * MS, 0, 0), (10 * MS, 20 * MS, 0)], [50, 50]),
        ([(50 * MS, 10 * MS, -HOUR), (11 * MS, 0, 0)], [50, 61]),
        ([(50 * MS, 10 * MS, HOUR), (11 * MS, 0, 0)], [0, 61]),
    ],
    ids=["at once", "after a stall", "never back", "wall clock set back", "wall clock set forward"],
)
def test_frames_are_taken_at_the_time_they_came(
    steps: list[tuple[int, int, int]], expected_ms: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = SteppedBus(monkeypatch, steps)
    assert taken_ms(bus, bus.monotonic_ns) == expected_ms


def test_a_stall_between_the_two_clocks_moves_no_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = SteppedBus(monkeypatch, [(50 * MS, 3 * MS, 0)])
    start_ns, stalls = bus.monotonic_ns, [25 * MS, 25 * MS]

    def late_ns() -> int:
        bus.monotonic_ns += stalls.pop() if stalls and not bus.steps else 0
        return bus.monotonic_ns + bus.wall_offset_ns

    monkeypatch.setattr(cli, "time_ns", late_ns)
    assert taken_ms(bus, start_ns) == [47]


@pytest.mark.parametrize(
    ("age_ms", "expected_ms"),
    [(20, 110), (35, 95)],  # the boards' heartbeats were due at 100 ms
    ids=["after the deadline", "before it, handed over late"],
)
def test_a_stall_after_the_wait_for_a_deadline_makes_nothing_late(
    age_ms: int, expected_ms: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class StalledBus(SteppedBus):
        has_stalled = False

        def receive(self, timeout_s: float) -> Received | None:
            if self.has_stalled:
                return super().receive(timeout_s)
            self.has_stalled = True
            self.monotonic_ns += round(timeout_s * 1e9) + 30 * MS  # kept waiting after the time was up
            return None

    bus = StalledBus(monkeypatch, [(0, age_ms * MS, 0)])
    assert taken_ms(bus, bus.monotonic_ns) == [expected_ms]


def taken_ms(bus: SteppedBus, start_ns: int) -> list[float]:
    """When frames are taken, after the start."""
    taken = []

    class NotingRig(SimulatedRig):
        def receive(self, frame: Frame, now_ns: int) -> tuple[Frame, ...]:
            taken.append((now_ns - start_ns) / MS)
            return ()

    with pytest.raises(LinkError, match="over"):
        cli.simulate(NotingRig(RIG, HandPlant()), bus)
    return taken


def test_without_the_right_to_a_priority_it_runs_all_the_same(
    monkeypatch: pytest.MonkeyPatch, process_kept: None
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    ran = []
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(cli, "simulate", lambda rig, *_: ran.append(rig))
    assert cli.main(["--bus", "inproc:no right"]) == 0
    assert len(ran) == 1


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])  # with a mark before it, as hil run takes it
def test_the_rig_file_sets_the_boards_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, process_kept: None, encoding: str
) -> None:
    path = tmp_path / "rig.toml"
    shipped = (Path(cli.__file__).parents[1] / "hil" / "shipped" / "rig.toml").read_text()
    path.write_text(shipped.replace("watchdog_periods = 8", "watchdog_periods = 7"), encoding=encoding)
    seen = []
    monkeypatch.setattr(cli, "simulate", lambda rig, *_: seen.append(rig))
    assert cli.main(["--bus", "inproc:set up", "--rig", str(path)]) == 0
    assert seen[0].dac._watchdog_ns == 7 * 11_200_000


def test_the_boards_start_light_and_share_nothing_of_the_gateways_wire() -> None:
    program = (
        "import sys, firmware_sim.cli\n"
        "heavy = {'numpy', 'scipy', 'control', 'matplotlib', 'can', 'rich'} & set(sys.modules)\n"
        "shared = {name for name in sys.modules if name.startswith(('hil.core.wire', 'hil.core.gateway'))}\n"
        "sys.exit(f'imported {heavy | shared}' if heavy | shared else 0)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
