"""Put a run together from boards, link, recorder, display and core, in real time or in lockstep."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_sim.plant_options import plant_arguments
from firmware_sim.simulated_plant import build_boards, build_plant, planned_events, refuse_host_faults
from hil import __version__
from hil.cli.quantities import duration_text
from hil.core.errors import LinkError
from hil.core.gateway import Gateway
from hil.core.output import LogEntry, Severity
from hil.host.child_process import await_end
from hil.recording.recorder import ARM_EVENTS, FAULTS_BEGUN, Recorder, RecorderReport, RunHeader
from hil.shells.run_plan import RunPlan, StopRequest
from hil.shells.run_setup import RunSetup
from hil.shells.session import Session

if TYPE_CHECKING:
    from hil.links import Link

LOCKSTEP_EPOCH_NS = 1_000_000_000_000_000_000
"""Start of simulated time, 2001-09-09. It is fixed, so that a recording depends on the setup alone."""
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SIMULATED = "sim"
"""Name of the bus to simulated boards that are started with the run."""
BOARDS_END_TIMEOUT_S = 2.0
"""Time in which the process of the simulated boards must end."""
MEDIA_TYPES = {".toml": "application/toml", ".json": "application/json", ".csv": "text/csv"}


def run_realtime(
    setup: RunSetup, plan: RunPlan, path: Path, bus: str, options: argparse.Namespace
) -> RecorderReport:
    """Run on ``bus``. With ``sim``, the boards are started in a process of their own, on a bus of their own.

    Raises LinkError or RecordingError if the run cannot begin.
    """
    from hil.host.realtime_rights import real_time_rights
    from hil.links import open_link
    from hil.shells.realtime import run
    from hil.views.live_display import LiveDisplay

    if bus == SIMULATED:
        refuse_host_faults(options)
    spec = f"udp:{_free_udp_port()}" if bus == SIMULATED else bus
    axes = [(name, axis.unit) for name, axis in setup.rig.axes.items()]
    with _stop_on_signals() as stop_request, contextlib.ExitStack() as stack:
        if bus == SIMULATED:
            stack.enter_context(_boards_process(spec, options))
        link = stack.enter_context(open_link(spec))
        epoch_offset_ns = time.time_ns() - time.monotonic_ns()
        planned = planned_events(options) if bus == SIMULATED else {}
        header = _header(setup, epoch_offset_ns, spec, link.stamp_origin, _host_versions(), planned)
        recorder = Recorder(path, header, lossless=False)
        display = LiveDisplay(axes)
        stack.callback(display.close)
        with real_time_rights() as rights:
            most_refused = setup.rig.adc.stale_after_periods
            gateway = setup.gateway(time.monotonic_ns() + setup.rig.loop.period_ns)
            session = Session(gateway, plan, link.send, time.monotonic_ns, recorder, display, most_refused)
            session.note(LogEntry(Severity.INFO, "rights", str(rights)))
            _announce(session, setup, plan.duration_s, planned)
            error = run(session, link, stop_request)
        ending = _ending(plan, gateway) | {
            "frames dropped by the kernel": _dropped(link),
            "frames unreadable": str(link.unreadable),
            "frames not sent": str(link.send_failures),
        }
        metadata = {"rights": rights.as_metadata(), "ending": ending}
        if error is not None:
            metadata["error"] = {"traceback": "".join(traceback.format_exception(error))}
        return recorder.close(metadata)


def run_lockstep(
    setup: RunSetup, plan: RunPlan, path: Path, duration_s: float, options: argparse.Namespace
) -> RecorderReport:
    """Run against simulated boards in this process and in simulated time. Every run gives the same bytes."""
    from firmware_sim.faulty_rig import FaultyRig
    from hil.cli.progress import LockstepProgress
    from hil.shells.lockstep import Lockstep

    plant, _ = build_plant(setup.rig, options)
    planned = planned_events(options)
    header = _header(setup, LOCKSTEP_EPOCH_NS, "lockstep", "simulated", {}, planned)
    boards = build_boards(setup.rig, plant, options)
    lockstep = Lockstep(boards, 0, boards.host if isinstance(boards, FaultyRig) else None)
    gateway = setup.gateway(setup.rig.loop.period_ns)
    with _stop_on_signals() as stop_request:
        recorder = Recorder(path, header, lossless=True)
        with LockstepProgress(duration_s) as progress:
            session = Session(gateway, plan, lockstep.send, lockstep.clock_ns, recorder, progress)
            _announce(session, setup, duration_s, planned)
            lockstep.run(session, stop_request)
        begun = boards.begun_by_time() if isinstance(boards, FaultyRig) else {}
        return recorder.close({"ending": _ending(plan, gateway)} | ({FAULTS_BEGUN: begun} if begun else {}))


def _announce(session: Session, setup: RunSetup, duration_s: float, planned: dict[str, float]) -> None:
    """Log what will happen to the simulated arm. Warn of events that do not happen and of early setpoints."""
    for text, at_s in planned.items():
        if at_s < duration_s:
            entry = LogEntry(Severity.INFO, "arm", f"planned: {text} (seconds from the first sample on)")
        else:
            entry = LogEntry(
                Severity.WARNING,
                "arm",
                f"{text} does not happen: it is after the end of the run, {duration_text(duration_s)}",
            )
        session.note(entry)
    for name, setpoint in setup.setpoints.items():
        first = setpoint.at(0.0)
        if first != 0.0:
            session.note(LogEntry(Severity.WARNING, name, _early_setpoint(first, setup.rig.axes[name].unit)))


def _early_setpoint(first: float, unit: str) -> str:
    """Return the warning for a setpoint that is not 0 when control begins."""
    return (
        f"the setpoint begins at {first:g} {unit}: control begins without a jump of the valve, so that an "
        "axis that is elsewhere approaches this value slowly; for a step, begin at 0 and change later"
    )


def _header(
    setup: RunSetup,
    epoch_offset_ns: int,
    bus: str,
    stamp_origin: str,
    versions: dict[str, str],
    planned: dict[str, float],
) -> RunHeader:
    return RunHeader(
        epoch_offset_ns=epoch_offset_ns,
        bus=bus,
        stamp_origin=stamp_origin,
        axes=tuple((name, axis.unit) for name, axis in setup.rig.axes.items()),
        attachments={
            name: (MEDIA_TYPES.get(Path(name).suffix, "text/plain"), text.encode())
            for name, text in setup.texts.items()
        },
        metadata={
            "documents": setup.digests(),
            "run": {"configuration sha256": setup.fingerprint(), "hil": __version__, **versions},
            "setpoints": {name: setpoint.text for name, setpoint in setup.setpoints.items()},
            **({ARM_EVENTS: {text: repr(at_s) for text, at_s in planned.items()}} if planned else {}),
            **({"plant": json.loads(setup.texts["plant.json"])} if "plant.json" in setup.texts else {}),
        },
    )


def _host_versions() -> dict[str, str]:
    return {
        "python": platform.python_version(),
        "python-can": version("python-can"),
        "kernel": platform.release(),
        "host": platform.node(),
    }


def _ending(plan: RunPlan, gateway: Gateway) -> dict[str, str]:
    loop = gateway.experiment
    experiment = {} if loop is None else loop.outcome()
    return experiment | {
        "reason": str(plan.ending),
        "duration asked for, s": f"{plan.duration_s:g}",
        "fault": gateway.fault_reason or "",
        "readiness": gateway.readiness,
        "missed periods": str(gateway.missed_periods),
        "rejected frames": str(gateway.rejected_frames),
        "lost samples": str(gateway.lost_samples),
        "error frames": str(gateway.error_frames),
    }


@contextlib.contextmanager
def _boards_process(spec: str, options: argparse.Namespace) -> Iterator[None]:
    """Run the simulated boards in another process, which the kernel kills if this one is killed."""
    # -P: modules in the working directory are not imported.
    command = [sys.executable, "-P", "-m", "firmware_sim", "--bus", spec, "--parent-pid", str(os.getpid())]
    if options.rig is not None:
        command += ["--rig", str(options.rig)]
    process = subprocess.Popen(
        [*command, *plant_arguments(options)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C must not end the boards before the gateway has centred the valves
    )
    try:
        yield
    finally:
        process.terminate()
        await_end(process, BOARDS_END_TIMEOUT_S)


@contextlib.contextmanager
def _stop_on_signals() -> Iterator[StopRequest]:
    """Let signals end the run in good order until the recording is closed; then they end the program."""
    stop = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # only the main thread may have signal handlers
        return
    before = {number: signal.signal(number, stop.set) for number in STOP_SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _free_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))  # on all addresses, so that no other rig uses the port
        return int(probe.getsockname()[1])


def _dropped(link: Link) -> str:
    with contextlib.suppress(LinkError, OSError):
        return str(link.dropped())
    return "unknown"
