"""The command ``firmware-sim``: both boards and a plant on a bus, in real time, until a signal ends it."""

from __future__ import annotations

import argparse
import contextlib
import gc
import os
import signal
import sys
import time
from importlib.resources import files
from pathlib import Path

from firmware_sim.arm.event_text import event_text
from firmware_sim.arm.events import AnyEvent
from firmware_sim.faulty_rig import FaultyRig
from firmware_sim.plant_options import add_plant_options
from firmware_sim.plants.plant import Plant
from firmware_sim.realtime import Bus, Watch, simulate
from firmware_sim.simulated_plant import build_boards, build_plant, refuse_host_faults
from firmware_sim.simulated_rig import SimulatedRig
from hil import __version__
from hil.core.errors import DocumentError, EnvironmentLackError, HilError
from hil.core.rig import Rig, read_rig
from hil.host.command_parser import CommandParser
from hil.host.text_file import read_text

PTY = "pty"
BOARDS_PRIORITY = 20
"""SCHED_FIFO priority of the boards. It is below the gateway's, so that the plant never delays the loop."""


def main(argv: list[str] | None = None) -> int:
    """Run ``firmware-sim``. Returns the exit status: 2 for wrong input, 1 for a failure while running."""
    options = parser().parse_args(argv)
    stop = _Stop()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop.exit)
    try:
        if options.parent_pid is not None:
            _die_with(options.parent_pid)
        rig = _read_rig(options.rig)
        refuse_host_faults(options)
        plant, plant_text = build_plant(rig, options)
        is_connected = options.event_descriptor is not None
        boards = build_boards(rig, plant, options, may_break=is_connected, is_told_states=is_connected)
        if options.watch and (options.linear or options.plant):
            raise DocumentError(
                "--watch shows the pneumatic arm and no linear model; omit it, or omit --linear and --plant"
            )
        bus, spec = _open(options.bus, rig.bus.bit_rate)
    except HilError as error:
        return _report(error, 2)
    with contextlib.closing(bus):
        try:
            print(_description(rig, plant_text, spec), flush=True)
            if isinstance(boards, FaultyRig):
                boards.on_begin = _print_fault
            sound_boards = boards.boards if isinstance(boards, FaultyRig) else boards
            sound_boards.on_event = _print_event
            _take_priority()
            simulate(boards, bus, _watch(boards, plant, options), stop.is_asked)
        except HilError as error:
            return _report(error, 1)
    return 0


def _watch(boards: SimulatedRig | FaultyRig, plant: Plant, options: argparse.Namespace) -> Watch | None:
    """Return the display of the arm, or the input of events and faults, or None."""
    from firmware_sim.arm.arm import Arm

    if options.watch and isinstance(plant, Arm):
        from firmware_sim.watch import ArmWatch

        return ArmWatch(plant)
    if options.event_descriptor is not None and isinstance(boards, FaultyRig):
        from firmware_sim.event_input import EventInput

        return EventInput(boards, options.event_descriptor)
    return None


def _print_fault(text: str) -> None:
    """Print that a fault begins: a gateway that has not started these boards cannot record it.

    The time is that of candump: seconds since 1970.
    """
    _print_begin(text, time.time())


def _print_event(event: AnyEvent, at_ns: int) -> None:
    """Print that a planned event has begun, as :func:`_print_fault` does. ``at_ns`` is monotonic."""
    _print_begin(event_text(event), time.time() - (time.monotonic_ns() - at_ns) * 1e-9)


def _print_begin(text: str, epoch_s: float) -> None:
    with contextlib.suppress(OSError):  # nobody reads any more
        print(f"({epoch_s:.6f}) {text} begins", flush=True)


def _take_priority() -> None:
    """Request real-time priority. Without the right to it, the boards run anyway and may answer late."""
    gc.freeze()
    with contextlib.suppress(OSError):
        parameter = os.sched_param(BOARDS_PRIORITY)
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, parameter)


def parser() -> CommandParser:
    """Return the parser of the arguments of ``firmware-sim``."""
    parser = CommandParser(
        prog="firmware-sim",
        description="Simulate the valve and potentiometer boards, and the arm behind them, on a bus.",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    parser.add_argument(
        "--bus",
        required=True,
        help="vcan0, can0, …: SocketCAN; udp:PORT: multicast inside this host; slcan:DEVICE: through a "
        "serial adapter; pty: create a serial device with the boards behind it and print its name",
    )
    parser.add_argument("--rig", type=Path, metavar="FILE", help="rig file (default: the shipped rig.toml)")
    add_plant_options(parser)
    parser.add_argument("--watch", action="store_true", help="show positions and pressures of the arm, live")
    parser.add_argument(
        "--parent-pid",
        type=int,
        metavar="PID",
        help="end when process PID ends, which must be the parent of this process",
    )
    parser.add_argument("--event-descriptor", type=int, help=argparse.SUPPRESS)  # see event_input
    return parser


def _read_rig(path: Path | None) -> Rig:
    if path is None:
        return read_rig((files("hil.shipped") / "rig.toml").read_text(encoding="utf-8"), "rig.toml")
    return read_rig(read_text(path), str(path))


def _open(spec: str, bit_rate: int | None) -> tuple[Bus, str]:
    """Open the bus. Returns it with the name by which a gateway joins it."""
    if spec == PTY:
        from firmware_sim.serial_device import SerialDevice

        device = SerialDevice()
        return device, f"slcan:{device.path}"
    from hil.links import open_link

    return open_link(spec, bit_rate), spec


def _description(rig: Rig, plant_text: str, spec: str) -> str:
    return (
        f"boards 0x10 (ADC) and 0x20 (DAC), 12 bit; commands apply {rig.dac.apply}\n"
        f"watchdog {rig.dac.watchdog_timeout_s:g} s\n"
        f"plant: {plant_text}\n"
        f"join with: hil run --bus {spec}"
    )


def _die_with(parent_pid: int) -> None:
    """Let the kernel kill this process when its parent ends, however the parent ends."""
    import ctypes

    set_parent_death_signal = 1  # PR_SET_PDEATHSIG of linux/prctl.h
    ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent_pid:
        raise EnvironmentLackError(
            f"--parent-pid {parent_pid}: the parent is process {os.getppid()}. Process {parent_pid} has "
            "ended, or it did not start this process"
        )


class _Stop:
    """The end of the program at a signal.

    The interpreter discards an exception that a handler raises within a callback, such as one of the import
    system while a module is loaded. Then the simulation ends when it asks.
    """

    def __init__(self) -> None:
        self._is_asked = False

    def exit(self, *_signal: object) -> None:
        """End the program. This is a signal handler."""
        self._is_asked = True
        raise SystemExit(0)

    def is_asked(self) -> bool:
        """Return whether a signal has come."""
        return self._is_asked


def _report(error: HilError, status: int) -> int:
    print(f"firmware-sim: {error}", file=sys.stderr)
    return status
