"""The command ``firmware-sim``: both boards and a plant on a bus, in real time, until a signal ends them."""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import signal
import sys
from importlib.resources import files
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import TYPE_CHECKING, Protocol

from firmware_sim.plant_options import add_plant_options, build_plant
from firmware_sim.plants.plant import Plant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import DocumentError, EnvironmentLackError, HilError
from hil.core.frames import Frame
from hil.core.rig import Rig, read_rig
from hil.host.text_file import read_text

if TYPE_CHECKING:
    from hil.links import Received

PTY = "pty"
BOARDS_PRIORITY = 20
"""Under the gateway's own: a plant must never make the loop late."""
_CLOSE_NS = 50_000
_MOST_READINGS = 10


class Bus(Protocol):
    """What the boards hang on: a ``hil.links.Link`` or a ``SerialDevice``."""

    def send(self, frame: Frame) -> object: ...  # noqa: D102
    def receive(self, timeout_s: float) -> Received | None: ...  # noqa: D102
    def close(self) -> None: ...  # noqa: D102


class Watch(Protocol):
    """Whoever looks at the plant now and then."""

    def look(self, now_ns: int) -> None: ...  # noqa: D102


def main(argv: list[str] | None = None) -> int:
    """Run ``firmware-sim`` with ``argv``; returns the exit status: 2 wrong input, 1 failed while running."""
    options = _parser().parse_args(argv)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, _exit_cleanly)
    try:
        if options.parent_pid is not None:
            _die_with(options.parent_pid)
        rig = _read_rig(options.rig)
        plant, plant_name = build_plant(rig, options)
        if options.watch and options.linear:
            raise DocumentError("--watch shows the pneumatic arm; it has nothing to show with --linear")
        bus, spec = _open(options.bus)
    except HilError as error:
        return _complain(error, 2)
    with contextlib.closing(bus):
        try:
            print(_description(rig, plant_name, spec), flush=True)
            _take_priority()
            simulate(SimulatedRig(rig, plant), bus, _watch(plant) if options.watch else None)
        except HilError as error:
            return _complain(error, 1)
    return 0


def simulate(rig: SimulatedRig, bus: Bus, watch: Watch | None = None) -> None:
    """Power the boards on and run them on CLOCK_MONOTONIC until something is raised.

    Frames are taken at the instants of their arrival and before any deadline: where this process was kept
    waiting, which a board never is, no watchdog fires for commands that had come in time. Nor does a deadline
    that was served make a frame later that was on the bus before it: a kernel may hand one over late.
    Raises LinkError when the bus is gone, and what a failing plant raises: the boards fall silent.
    """
    now_ns = frame_ns = monotonic_ns()
    frames = rig.start(now_ns)
    while True:
        for frame in frames:
            bus.send(frame)
        if watch is not None:
            watch.look(now_ns)
        asked_ns = monotonic_ns()
        received = bus.receive(max(rig.next_deadline_ns - asked_ns, 0) * 1e-9)
        if received is None:
            # Until then nothing had come; what comes while this process waits to go on is not late.
            now_ns = max(rig.next_deadline_ns, asked_ns)
            frames = rig.on_deadline(now_ns)
        else:
            now_ns = frame_ns = max(_arrival_ns(received.stamp_ns), frame_ns)
            frames = rig.receive(received.frame, now_ns)


def _arrival_ns(stamp_ns: int) -> int:
    """A frame's stamp on CLOCK_MONOTONIC; by its age, because the wall clock may be set while we run."""
    for _ in range(_MOST_READINGS):
        before_ns, wall_ns, after_ns = monotonic_ns(), time_ns(), monotonic_ns()
        if after_ns - before_ns < _CLOSE_NS:
            break  # else this process was kept waiting between the two clocks
    return before_ns - max(wall_ns - stamp_ns, 0)


def _watch(plant: Plant) -> Watch:
    from firmware_sim.arm.arm import Arm
    from firmware_sim.watch import ArmWatch

    assert isinstance(plant, Arm)
    return ArmWatch(plant)


def _take_priority() -> None:
    """Where it is granted, never wait behind ordinary programs; else the boards answer late at times."""
    gc.freeze()
    with contextlib.suppress(OSError):
        parameter = os.sched_param(BOARDS_PRIORITY)
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, parameter)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="firmware-sim",
        description="Simulate the valve and potentiometer boards, and the arm behind them, on a bus.",
    )
    parser.add_argument(
        "--bus",
        required=True,
        help="vcan0, can0, …: SocketCAN; udp:PORT: multicast inside this host; slcan:DEVICE: through a "
        "serial adapter; pty: make a serial device with the boards behind it, and say its name",
    )
    parser.add_argument("--rig", type=Path, metavar="FILE", help="rig file (the shipped rig.toml)")
    add_plant_options(parser)
    parser.add_argument("--watch", action="store_true", help="show the arm and its pressures, live")
    parser.add_argument(
        "--parent-pid", type=int, metavar="PID", help="end when this process, which must be the parent, ends"
    )
    return parser


def _read_rig(path: Path | None) -> Rig:
    if path is None:
        return read_rig((files("hil.shipped") / "rig.toml").read_text(encoding="utf-8"), "rig.toml")
    return read_rig(read_text(path), str(path))


def _open(spec: str) -> tuple[Bus, str]:
    """The bus, and what others join it with."""
    if spec == PTY:
        from firmware_sim.serial_device import SerialDevice

        device = SerialDevice()
        return device, f"slcan:{device.path}"
    from hil.links import open_link

    return open_link(spec), spec


def _description(rig: Rig, plant_name: str, spec: str) -> str:
    return (
        f"boards 0x10 (ADC) and 0x20 (DAC), 12 bit; commands apply {rig.dac.apply}\n"
        f"watchdog {rig.dac.watchdog_periods} periods of {rig.loop.period_s:g} s\n"
        f"plant: {plant_name}\n"
        f"join with: hil run --bus {spec}"
    )


def _die_with(parent_pid: int) -> None:
    """Have the kernel kill this process when its parent ends, however that happens."""
    import ctypes

    set_parent_death_signal = 1  # PR_SET_PDEATHSIG of linux/prctl.h
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:
        raise EnvironmentLackError(
            f"--parent-pid {parent_pid}: the parent is process {os.getppid()}; it has ended, or is another"
        )


def _exit_cleanly(*_signal: object) -> None:
    raise SystemExit(0)


def _complain(error: HilError, status: int) -> int:
    print(f"firmware-sim: {error}", file=sys.stderr)
    return status
