"""Put a daemon together from boards, link, recorder, log, socket process and core, and run it."""

from __future__ import annotations

import argparse
import contextlib
import sys
import time
import traceback

from hil import __version__
from hil.cli.confirmation import protection_warnings
from hil.cli.record_path import create_folder_of, recording_path
from hil.cli.run_parts import (
    SIMULATED,
    boards_process,
    dropped_by_kernel,
    free_udp_port,
    host_versions,
    run_header,
    stop_on_signals,
)
from hil.core.output import LogEntry, Severity
from hil.core.requests import Reply
from hil.host.realtime_rights import real_time_rights
from hil.links import open_link
from hil.operation.pipe import Facts
from hil.operation.protocol import ShutdownCall
from hil.operation.socket_path import default_path, listening
from hil.operation.socket_process import socket_process
from hil.operation.systemd import Notifier
from hil.recording.recorder import Recorder
from hil.shells.bus_guard import refuse_other_gateway
from hil.shells.observers import Observers
from hil.shells.operator_port import Described, OperatorPort
from hil.shells.realtime import run
from hil.shells.run_plan import Ending, OperatorPlan
from hil.shells.run_setup import RIG_NAME, RunSetup
from hil.shells.session import Session
from hil.shells.watchdog import WatchdogObserver
from hil.views.log_lines import LogLines

RESERVED_S = 600.0
"""Disk space for a recording of this duration must be free when the daemon starts."""


def run_daemon(setup: RunSetup, bus: str, options: argparse.Namespace) -> int:
    """Run until a signal or a client ends the daemon. Return the exit status.

    Raises HilError if it cannot begin: another daemon has the socket, another gateway is on the bus.
    """
    is_simulated = bus == SIMULATED
    spec = f"udp:{free_udp_port()}" if is_simulated else bus
    with stop_on_signals() as stop, contextlib.ExitStack() as stack:
        notifier = stack.enter_context(Notifier())
        listener = stack.enter_context(listening(options.socket or default_path()))
        if is_simulated:
            stack.enter_context(boards_process(spec, options))
        link = stack.enter_context(open_link(spec))
        if not is_simulated:
            refuse_other_gateway(link, setup.rig.heartbeat_periods * setup.rig.loop.period_s)
        epoch_offset_ns = time.time_ns() - time.monotonic_ns()
        path = recording_path(options.record, RESERVED_S, has_figure=False)
        create_folder_of(path)
        recorder = Recorder(
            path,
            run_header(setup, epoch_offset_ns, spec, link.stamp_origin, host_versions(), {}),
            lossless=False,
        )
        log = LogLines()
        stack.callback(log.close)
        units = {name: axis.unit for name, axis in setup.rig.axes.items()}
        facts = Facts(__version__, bus, setup.texts[RIG_NAME])
        pipe = stack.enter_context(socket_process(listener, facts))
        plan = OperatorPlan()

        def shut_down(session: Session, _call: ShutdownCall, asked_by: str) -> Reply:
            session.note(LogEntry(Severity.INFO, "operator", f"{asked_by} asks: shutdown"))
            stop.set()
            return Reply(True, "the daemon centres the valves, closes the recording and ends")

        port = OperatorPort(
            pipe,
            Described(bus, is_simulated, tuple(units.items()), setup.rig.loop.period_s, epoch_offset_ns),
            {ShutdownCall: shut_down},
            lambda: str(path),
            time.monotonic_ns,
        )
        with real_time_rights(setup.rig.loop.poll_before_deadline_s) as rights:
            gateway = setup.gateway(time.monotonic_ns() + setup.rig.loop.period_ns)
            observer = Observers(port, log, WatchdogObserver(notifier))
            session = Session(
                gateway,
                plan,
                link.send,
                time.monotonic_ns,
                recorder,
                observer,
                setup.rig.adc.stale_after_periods,
            )
            session.note(LogEntry(Severity.INFO, "rights", str(rights)))
            for warning in protection_warnings(setup, bus):
                session.note(warning)
            error = run(session, link, stop, port.serve, rights.poll_ns)
        notifier.send("STOPPING=1")
        metadata = {"rights": rights.as_metadata(), "ending": {"reason": str(plan.ending)}}
        if error is not None:
            metadata["error"] = {"traceback": "".join(traceback.format_exception(error))}
        metadata["ending"]["frames dropped by the kernel"] = dropped_by_kernel(link)
        report = recorder.close(metadata)
    if report.failure:
        sys.stderr.write(f"hil daemon: the recording is incomplete: {report.failure}\n")
    return 0 if plan.ending is Ending.INTERRUPTED and not report.failure else 1
