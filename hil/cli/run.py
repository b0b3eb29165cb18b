"""``hil run``: one run of the controllers against the rig, recorded, summed up and plotted.

Imports nothing slow before the loop: what only the summary needs is imported after it.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import platform
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from hil import __version__
from hil.errors import HilError, LinkError
from hil.events import Cycle, Event, Severity
from hil.gateway import Gateway
from hil.recording.recorder import Recorder, RecorderReport, RunHeader
from hil.run_setup import RunSetup, load_setup, shipped_controllers
from hil.setpoints import FORMS
from hil.shells.run_plan import Ending, RunPlan
from hil.shells.session import Session

LOCKSTEP_EPOCH_NS = 1_000_000_000_000_000_000
"""Simulated time begins here (2001-09-09), so that lockstep files depend on nothing but the setup."""
SIMULATED = "sim"
DEFAULT_DURATION_S = 10.0


def main(argv: list[str]) -> int:
    """Run, then tell how it went. 0: completed or interrupted; 1: fault, no boards, or a lost link."""
    options = _parser().parse_args(argv)
    setup = load_setup(options.rig, _by_axis(options.controller), _by_axis(options.setpoint))
    bus = options.bus or setup.rig.bus.channel
    path: Path = options.record or _default_path()
    path.parent.mkdir(parents=True, exist_ok=True)
    plan = RunPlan(options.duration, setup.rig.loop.period_s)
    if options.lockstep:
        report = _run_lockstep(setup, plan, path, options.duration)
    else:
        report = _run_realtime(setup, plan, path, bus, options)
    return _tell(plan, report)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="hil run",
        description="Run the controllers against the rig and record it. Without options: the simulated rig.",
        epilog=f"Controllers shipped: {', '.join(shipped_controllers())}. Setpoints: {FORMS}.",
    )
    parser.add_argument("--rig", type=Path, metavar="FILE", help="rig file (the shipped example)")
    parser.add_argument(
        "--controller", action="append", default=[], metavar="AXIS=FILE", help="controller of an axis"
    )
    parser.add_argument(
        "--setpoint", action="append", default=[], metavar="AXIS=SETPOINT", help="setpoint of an axis"
    )
    parser.add_argument(
        "--duration", type=_seconds, default=DEFAULT_DURATION_S, metavar="S", help="seconds of control (10)"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--bus", metavar="BUS", help="sim, vcan0, can0, slcan:/dev/ttyACM0, udp:PORT")
    where.add_argument(
        "--lockstep", action="store_true", help="simulated boards and simulated time, as fast as it goes"
    )
    parser.add_argument("--record", type=Path, metavar="FILE", help="recording (runs/<date>-<time>.mcap)")
    return parser


def _run_realtime(
    setup: RunSetup, plan: RunPlan, path: Path, bus: str, options: argparse.Namespace
) -> RecorderReport:
    from hil.links import open_link
    from hil.rights import real_time_rights
    from hil.shells.display import Display
    from hil.shells.realtime import StopRequest, run_realtime

    is_simulated = bus == SIMULATED
    spec = f"udp:{_free_udp_port()}" if is_simulated else bus
    stop = StopRequest()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop.set)
    axes = [(name, axis.unit) for name, axis in setup.rig.axes.items()]
    with contextlib.ExitStack() as stack:
        if is_simulated:
            stack.enter_context(_simulated_boards(spec, options.rig))
        link = stack.enter_context(open_link(spec))
        header = _header(setup, time.time_ns() - time.monotonic_ns(), spec, link.stamp_origin, "real time")
        recorder = Recorder(path, header, lossless=False)
        display = Display(axes, options.duration)
        stack.callback(display.close)
        with real_time_rights() as rights:
            gateway = setup.gateway(time.monotonic_ns() + setup.rig.loop.period_ns)
            session = Session(gateway, plan, link.send, time.monotonic_ns, recorder, display)
            session.note(Event(Severity.INFO, "rights", str(rights)))
            run_realtime(session, link, stop)
        ending = _ending(plan, gateway) | {
            "frames dropped by the kernel": _dropped(link),
            "frames not sent": str(link.send_failures),
        }
        return recorder.close({"rights": rights.as_metadata(), "ending": ending})


def _run_lockstep(setup: RunSetup, plan: RunPlan, path: Path, duration_s: float) -> RecorderReport:
    from firmware_sim.linear_plant import LinearPlant
    from firmware_sim.simulated_rig import SimulatedRig
    from hil.shells.lockstep import Lockstep

    header = _header(setup, LOCKSTEP_EPOCH_NS, "lockstep", "simulated", "lockstep")
    recorder = Recorder(path, header, lossless=True)
    lockstep = Lockstep(SimulatedRig(setup.rig, LinearPlant(setup.rig)), 0)
    gateway = setup.gateway(setup.rig.loop.period_ns)
    with _ProgressBar(duration_s) as progress:
        lockstep.run(Session(gateway, plan, lockstep.send, lockstep.clock_ns, recorder, progress))
    return recorder.close({"ending": _ending(plan, gateway)})


class _ProgressBar:
    """The audience in lockstep: events, and a bar where the run is long enough to want one."""

    SHORT_RUN_S = 120.0
    UPDATE_PERIODS = 2000

    def __init__(self, duration_s: float) -> None:
        self._duration_s = duration_s
        self._bar: object = None

    def __enter__(self) -> _ProgressBar:
        from rich.console import Console
        from rich.progress import Progress

        self._progress = Progress(console=Console(stderr=True), disable=self._duration_s < self.SHORT_RUN_S)
        self._progress.start()
        self._task = self._progress.add_task("lockstep", total=self._duration_s)
        return self

    def __exit__(self, *_error: object) -> None:
        self._progress.stop()

    def event(self, event: Event) -> None:
        if event.severity > Severity.INFO:
            self._progress.console.print(f"{event.source}: {event.text}", highlight=False)

    def cycle(self, cycle: Cycle, gateway: Gateway) -> None:
        if cycle.number % self.UPDATE_PERIODS == 0:
            self._progress.update(self._task, completed=cycle.deadline_ns / 1e9)


def _header(setup: RunSetup, epoch_offset_ns: int, bus: str, stamp_origin: str, shell: str) -> RunHeader:
    media = {".toml": "application/toml", ".json": "application/json", ".csv": "text/csv"}
    run = {"shell": shell, "configuration sha256": setup.fingerprint(), "hil": __version__}
    if shell == "real time":
        run |= {
            "python": platform.python_version(),
            "python-can": version("python-can"),
            "kernel": platform.release(),
            "host": platform.node(),
        }
    return RunHeader(
        epoch_offset_ns=epoch_offset_ns,
        bus=bus,
        stamp_origin=stamp_origin,
        axes=tuple((name, axis.unit) for name, axis in setup.rig.axes.items()),
        attachments={
            name: (media.get(Path(name).suffix, "text/plain"), text.encode())
            for name, text in setup.texts.items()
        },
        metadata={
            "run": run,
            "setpoints": {name: setpoint.text for name, setpoint in setup.setpoints.items()},
        },
    )


def _ending(plan: RunPlan, gateway: Gateway) -> dict[str, str]:
    return {
        "reason": str(plan.ending),
        "fault": gateway.fault_reason or "",
        "missed periods": str(gateway.missed_periods),
        "rejected frames": str(gateway.rejected_frames),
        "lost samples": str(gateway.lost_samples),
    }


@contextlib.contextmanager
def _simulated_boards(spec: str, rig: Path | None) -> Iterator[None]:
    """The boards in a process and session of their own, which a kill of this one ends too."""
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "firmware_sim", "--bus", spec, "--parent-pid", str(os.getpid())),
            *(("--rig", str(rig)) if rig else ()),
        ],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the gateway, which centres the valves while the boards listen
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def _tell(plan: RunPlan, report: RecorderReport) -> int:
    """Summary and plot, from the recording."""
    from rich.console import Console

    from hil.plots import plot_run
    from hil.recording.reader import Recording
    from hil.summary import summarise

    console = Console(highlight=False)
    if report.failure:
        console.print(f"recording: {report.failure}", style="red")
    status = 0 if plan.ending in (Ending.COMPLETED, Ending.INTERRUPTED) else 1
    recording = Recording(report.path)
    fault = recording.metadata.get("ending", {}).get("fault", "")
    try:
        summary = summarise(recording)
        console.print(summary.table())
        picture = report.path.with_suffix(".png")
        plot_run(recording, picture)
        console.print(f"recording  {report.path}\nplot       {picture}")
    except HilError as error:
        console.print(f"no summary: {error}", style="yellow")
    if plan.ending is Ending.NO_BOARDS:
        console.print(
            "The boards did not come up: no heartbeat from both and no good sample. Is the bus right "
            "(--bus), are the boards powered, the bit rate the same, the node ids 0x10 and 0x20?",
            style="red",
        )
    elif status:
        console.print(f"ended by {plan.ending}: {fault}", style="red")
    return status


def _by_axis(given: list[str]) -> dict[str, str]:
    pairs = {}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals or not name or not value:
            raise HilError(f"{text!r} is not AXIS=VALUE, such as vertical=ppid")
        pairs[name] = value
    return pairs


def _seconds(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value > 0):
        raise argparse.ArgumentTypeError(f"{text} is not a number of seconds over 0")
    return value


def _default_path() -> Path:
    name = time.strftime("%Y%m%d-%H%M%S")
    path = Path("runs") / f"{name}.mcap"
    number = 1
    while path.exists():
        number += 1
        path = Path("runs") / f"{name}-{number}.mcap"
    return path


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _dropped(link: object) -> str:
    with contextlib.suppress(LinkError, OSError):
        return str(link.dropped())  # type: ignore[attr-defined]
    return "unknown"
