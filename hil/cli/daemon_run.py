"""Put a daemon together from boards, link, recorder, log, socket process and core, and run it."""

from __future__ import annotations

import argparse
import contextlib
import shlex
import signal
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from firmware_sim.simulated_plant import planned_events
from hil import __version__
from hil.cli.confirmation import bus_notes
from hil.cli.daemon_actions import daemon_actions, event_check
from hil.cli.live_page import live_views, make_feed
from hil.cli.planned_events import note_not_begun, planned_reports
from hil.cli.record_path import create_folder_of, recording_path
from hil.cli.run_parts import (
    SIMULATED,
    connected_boards,
    dropped_by_kernel,
    free_udp_port,
    host_versions,
    run_header,
    stop_on_signals,
)
from hil.core.calibration_rig import calibration_warnings
from hil.core.errors import EnvironmentLackError, LinkError
from hil.core.output import LogEntry, Severity
from hil.host.realtime_rights import real_time_rights
from hil.links import Link, open_link
from hil.live.feed import LiveFeed
from hil.live.feed_file import link_beside
from hil.operation.pipe import Facts
from hil.operation.socket_path import default_path, listening
from hil.operation.socket_process import socket_process
from hil.operation.systemd import Notifier
from hil.recording.no_recorder import NoRecorder
from hil.recording.recorder import Recorder
from hil.shells.bus_guard import refuse_gateway_that_was_heard, sole_gateway
from hil.shells.observers import Observers
from hil.shells.operator_port import Described, OperatorPort
from hil.shells.preflight import missing_rights
from hil.shells.realtime import run
from hil.shells.recordings import Recordings, RotationLimits
from hil.shells.rehearsal import polling_of
from hil.shells.run_plan import Ending, OperatorPlan
from hil.shells.run_setup import RIG_NAME, RunSetup
from hil.shells.session import Observer, Session
from hil.shells.watchdog import WatchdogObserver
from hil.views.log_lines import LogLines

RESERVED_S = 600.0
"""Disk space for a recording of this duration must be free when the daemon starts."""
MIN_FREE_BYTES = 1_000_000_000
"""With less free disk space, the daemon warns."""


def run_daemon(setup: RunSetup, bus: str, options: argparse.Namespace) -> int:
    """Run until a signal or a client ends the daemon. Return the exit status.

    Raises HilError if it cannot begin: another daemon has the socket, another gateway is on the bus.
    """
    is_simulated = bus == SIMULATED
    spec = f"udp:{free_udp_port()}" if is_simulated else bus
    with stop_on_signals() as stop, contextlib.ExitStack() as stack:
        notifier = stack.enter_context(Notifier())
        listener = stack.enter_context(listening(options.socket or default_path()))
        events = stack.enter_context(connected_boards(spec, options)) if is_simulated else None
        link = stack.enter_context(open_link(spec, setup.rig.bus.bit_rate))
        if not is_simulated:
            heartbeat_interval_s = setup.rig.heartbeat_periods * setup.rig.loop.period_s
            stack.enter_context(sole_gateway(link, heartbeat_interval_s))
        epoch_offset_ns = time.time_ns() - time.monotonic_ns()
        recordings: Recordings | None = None

        def recording() -> str:
            return "" if recordings is None else str(recordings.written_path or "")

        path = None if options.no_record else recording_path(options.record, RESERVED_S, has_figure=False)
        feed, feed_warning = _feed(stack, setup, spec, epoch_offset_ns, recording, options)
        # A page that cannot be served leaves no recording behind.
        recorder = None if path is None else _recorder(path, setup, spec, link, epoch_offset_ns, options)
        limits = RotationLimits(options.rotate_bytes, options.rotate_s, options.keep)
        recordings = None if recorder is None else Recordings(recorder, limits)
        log = LogLines()
        stack.callback(log.close)
        facts = Facts(
            __version__, bus, setup.texts[RIG_NAME], None if events is None else event_check(options)
        )
        pipe = stack.enter_context(socket_process(listener, facts))
        plan = OperatorPlan()
        loop = setup.rig.loop
        with real_time_rights(loop.poll_before_deadline_s, loop.poll_for_sample_s) as rights:
            polling = polling_of(rights, setup)
            port = OperatorPort(
                pipe,
                _described(setup, bus, epoch_offset_ns),
                daemon_actions(stop, events),
                lambda: recording() or None,
                time.monotonic_ns,
                missing_rights(setup.rig, bus, rights),
            )
            observers: list[Observer] = [port, log, WatchdogObserver(notifier)]
            if feed is not None:
                observers.append(feed)
            reports = None if events is None else planned_reports(events, options)
            if reports is not None:
                observers.append(reports)
            session = Session(
                setup.gateway(time.monotonic_ns() + setup.rig.loop.period_ns),
                plan,
                link.send,
                time.monotonic_ns,
                recorder or NoRecorder(),
                Observers(*observers),
                setup.rig.adc.stale_after_periods,
                recordings,
                feed,
            )
            if reports is not None:
                reports.attach(session)
            try:
                refuse_gateway_that_was_heard(link)
            except LinkError as refusal:
                if recorder is not None:
                    recorder.close({"ending": {"reason": str(refusal)}})
                raise
            session.note(LogEntry(Severity.INFO, "rights", str(rights)))
            if feed_warning:
                session.note(LogEntry(Severity.WARNING, "live", feed_warning))
            for warning in (*bus_notes(setup, bus), *calibration_warnings(setup.rig)):
                session.note(warning)
            error = run(session, link, stop, port.serve, polling)
            if reports is not None:
                reports.finish()
                note_not_begun(session, options, reports.faults_begun, reports.events_begun)
            if stop.signal is not None:
                text = f"{signal.Signals(stop.signal).name} ended the daemon"
                session.note(LogEntry(Severity.INFO, "hil", text))
        notifier.send("STOPPING=1")
        metadata = {"rights": rights.as_metadata(), "ending": _ending(session, link)}
        if error is not None:
            metadata["error"] = {"traceback": "".join(traceback.format_exception(error))}
        report = None if recorder is None else recorder.close(metadata)
        failure = None if report is None else report.failure
        if report is not None and failure is None:
            text = f"the last recording is complete; next: hil replay {shlex.quote(str(report.path))}"
            log.log(LogEntry(Severity.INFO, "recorder", text))
    if failure is not None:
        sys.stderr.write(f"hil daemon: the recording is incomplete: {failure}\n")
    return 0 if plan.ending is Ending.INTERRUPTED and failure is None else 1


def _feed(
    stack: contextlib.ExitStack,
    setup: RunSetup,
    bus: str,
    epoch_offset_ns: int,
    recording: Callable[[], str],
    options: argparse.Namespace,
) -> tuple[LiveFeed | None, str]:
    """Create the feed for `hil live`, and start the views that the user asks for.

    ``recording`` returns the path of the present recording, or an empty text. Return the feed, or None and
    the reason why there is none. Raises EnvironmentLackError if there is none and the user asks for a view.
    """
    socket_path = options.socket or default_path()
    try:
        feed = make_feed(setup, bus, epoch_offset_ns, options, recording, link_beside(socket_path))
    except EnvironmentLackError as error:
        if options.live or options.foxglove is not None:
            raise
        return None, f"{error}: `hil live` cannot show this daemon"
    operator_socket = socket_path if options.operate else None
    return stack.enter_context(live_views(feed, options, operator_socket)), ""


def _recorder(
    path: Path, setup: RunSetup, spec: str, link: Link, epoch_offset_ns: int, options: argparse.Namespace
) -> Recorder:
    """Begin the first recording. Raises RecordingError."""
    create_folder_of(path)
    planned = planned_events(options)
    header = run_header(setup, epoch_offset_ns, spec, link.stamp_origin, host_versions(), planned)
    return Recorder(path, header, lossless=False, min_free_bytes=MIN_FREE_BYTES)


def _described(setup: RunSetup, bus: str, epoch_offset_ns: int) -> Described:
    axes = tuple((name, axis.unit) for name, axis in setup.rig.axes.items())
    rig = setup.rig
    return Described(bus, bus == SIMULATED, axes, rig.loop.period_s, epoch_offset_ns, rig.calibration)


def _ending(session: Session, link: Link) -> dict[str, str]:
    gateway = session.gateway
    return {
        "reason": str(session.plan.ending),
        "fault": gateway.fault_reason or "",
        "readiness": gateway.readiness,
        "missed periods": str(gateway.missed_periods),
        "rejected frames": str(gateway.rejected_frames),
        "lost samples": str(gateway.lost_samples),
        "frames dropped by the kernel": dropped_by_kernel(link),
        "frames not sent": str(link.send_failures),
    }
