"""Put a run together from boards, link, recorder, display and core, in real time or in lockstep."""

from __future__ import annotations

import argparse
import contextlib
import time
import traceback
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from firmware_sim.arm.event_text import event_text
from firmware_sim.simulated_plant import (
    build_boards,
    build_plant,
    planned_events,
    planned_faults,
    refuse_host_faults,
)
from hil.cli.boards_reports import BoardsReports
from hil.cli.confirmation import bus_notes
from hil.cli.live_page import live_views, make_feed
from hil.cli.planned_events import note_not_begun, planned_reports
from hil.cli.quantities import duration_text
from hil.cli.run_parts import (
    SIMULATED,
    boards_process,
    connected_boards,
    dropped_by_kernel,
    free_udp_port,
    host_versions,
    run_header,
    stop_on_signals,
)
from hil.core.errors import LinkError
from hil.core.gateway import Gateway
from hil.core.life_cycle import LifeCycleState
from hil.core.output import LogEntry, Severity
from hil.recording.recorder import EVENT_SOURCE, FAULTS_BEGUN, Recorder, RecorderReport
from hil.shells.observers import Observers
from hil.shells.run_plan import RunPlan
from hil.shells.run_setup import RunSetup
from hil.shells.session import Observer, Session
from hil.shells.simulated_faults import StateReports, event_entry, fault_entry, faults_by_instant

if TYPE_CHECKING:
    from firmware_sim.arm.events import AnyEvent
    from firmware_sim.faulty_rig import FaultyRig
    from hil.shells.lockstep import Lockstep

LOCKSTEP_EPOCH_NS = 1_000_000_000_000_000_000
"""Start of simulated time, 2001-09-09. It is fixed, so that a recording depends on the setup alone."""


def run_realtime(
    setup: RunSetup, plan: RunPlan, path: Path, bus: str, options: argparse.Namespace
) -> RecorderReport:
    """Run on ``bus``. With ``sim``, the boards are started in a process of their own, on a bus of their own.

    Raises LinkError or RecordingError if the run cannot begin.
    """
    from hil.host.realtime_rights import real_time_rights
    from hil.links import open_link
    from hil.shells.bus_guard import refuse_gateway_that_was_heard, sole_gateway
    from hil.shells.preflight import missing_rights
    from hil.shells.realtime import run
    from hil.shells.rehearsal import polling_of
    from hil.views.live_display import LiveDisplay

    if bus == SIMULATED:
        refuse_host_faults(options)
    spec = f"udp:{free_udp_port()}" if bus == SIMULATED else bus
    axes = [(name, axis.unit) for name, axis in setup.rig.axes.items()]
    reports: BoardsReports | None = None
    with stop_on_signals() as stop_request, contextlib.ExitStack() as stack:
        if bus == SIMULATED:
            reports = _start_boards(stack, spec, options)
        link = stack.enter_context(open_link(spec, setup.rig.bus.bit_rate))
        if bus != SIMULATED:
            heartbeat_interval_s = setup.rig.heartbeat_periods * setup.rig.loop.period_s
            stack.enter_context(sole_gateway(link, heartbeat_interval_s))
        epoch_offset_ns = time.time_ns() - time.monotonic_ns()
        feed = None
        if options.live or options.foxglove is not None:
            made = make_feed(setup, spec, epoch_offset_ns, options, lambda: str(path))
            feed = stack.enter_context(live_views(made, options))
        planned = planned_events(options) if bus == SIMULATED else {}
        header = run_header(setup, epoch_offset_ns, spec, link.stamp_origin, host_versions(), planned)
        # A page that cannot be served leaves no recording behind.
        recorder = Recorder(path, header, lossless=False)
        display = LiveDisplay(axes)
        stack.callback(display.close)
        others: list[Observer] = [other for other in (feed, reports) if other is not None]
        observer = Observers(display, *others) if others else display
        recorder.await_start()
        loop = setup.rig.loop
        with real_time_rights(loop.poll_before_deadline_s, loop.poll_for_sample_s) as rights:
            polling = polling_of(rights, setup)
            most_refused = setup.rig.adc.stale_after_periods
            gateway = setup.gateway(time.monotonic_ns() + setup.rig.loop.period_ns)
            session = Session(
                gateway, plan, link.send, time.monotonic_ns, recorder, observer, most_refused, feed=feed
            )
            if reports is not None:
                reports.attach(session)
            try:
                refuse_gateway_that_was_heard(link)
            except LinkError as refusal:
                recorder.close({"ending": {"reason": str(refusal)}})
                raise
            session.note(LogEntry(Severity.INFO, "rights", str(rights)))
            plan.take_failures(missing_rights(setup.rig, bus, rights))
            for note in bus_notes(setup, bus):
                session.note(note)
            _announce(session, setup, plan.duration_s, planned)
            error = run(session, link, stop_request, polling=polling)
        ending = _ending(plan, gateway) | {
            "frames dropped by the kernel": dropped_by_kernel(link),
            "frames unreadable": str(link.unreadable),
            "frames not sent": str(link.send_failures),
        }
        metadata = {"rights": rights.as_metadata(), "ending": ending}
        if reports is not None:
            if begun := reports.finish():
                metadata[FAULTS_BEGUN] = begun
            note_not_begun(session, options, reports.faults_begun, reports.events_begun)
        if error is not None:
            metadata["error"] = {"traceback": "".join(traceback.format_exception(error))}
        return recorder.close(metadata)


def run_lockstep(
    setup: RunSetup, plan: RunPlan, path: Path, duration_s: float, options: argparse.Namespace
) -> RecorderReport:
    """Run against simulated boards in this process and in simulated time. Every run gives the same bytes."""
    from firmware_sim.faulty_rig import FaultyRig
    from hil.cli.progress import LockstepProgress
    from hil.links.bus_model.rig_bus import RigBus
    from hil.shells.lockstep import Lockstep
    from hil.shells.lockstep_bus import BusLockstep

    plant, _ = build_plant(setup.rig, options)
    planned = planned_events(options)
    header = run_header(setup, LOCKSTEP_EPOCH_NS, "lockstep", "simulated", {}, planned)
    bit_rate = setup.rig.bus.bit_rate
    bus = None if bit_rate is None else RigBus(bit_rate)
    boards = build_boards(setup.rig, plant, options, is_told_states=True, bus=bus)
    host = boards.host if isinstance(boards, FaultyRig) else None
    lockstep = (
        Lockstep(boards, 0, host, LOCKSTEP_EPOCH_NS)
        if bus is None
        else BusLockstep(boards, 0, bus, host, LOCKSTEP_EPOCH_NS)
    )
    gateway = setup.gateway(setup.rig.loop.period_ns)
    with stop_on_signals() as stop_request:
        recorder = Recorder(path, header, lossless=True)
        with LockstepProgress(duration_s) as progress:
            observer: Observer = progress
            if isinstance(boards, FaultyRig):
                enter = partial(_enter, boards, lockstep)
                observer = Observers(progress, StateReports(gateway, enter))
            max_refused = setup.rig.adc.stale_after_periods
            session = Session(
                gateway, plan, lockstep.send, lockstep.clock_ns, recorder, observer, max_refused
            )
            _announce(session, setup, duration_s, planned)
            events_begun: list[tuple[int, str]] = []

            def note_event(event: AnyEvent, at_ns: int) -> None:
                events_begun.append((at_ns, event_text(event)))
                session.note(event_entry(event_text(event)), at_ns)

            if isinstance(boards, FaultyRig):
                boards.on_begin = lambda text: session.note(fault_entry(text))
                boards.boards.on_event = note_event
            else:
                boards.on_event = note_event
            lockstep.run(session, stop_request)
        faults_begun = boards.begun if isinstance(boards, FaultyRig) else []
        begun = faults_by_instant(faults_begun)
        note_not_begun(session, options, faults_begun, events_begun)
        ending = _ending(plan, gateway) | ({} if bus is None else bus.figures(lockstep.clock_ns()))
        return recorder.close({"ending": ending} | ({FAULTS_BEGUN: begun} if begun else {}))


def _enter(boards: FaultyRig, lockstep: Lockstep, state: LifeCycleState) -> None:
    """Tell the simulated boards the gateway's state."""
    boards.gateway_entered(state.name.lower(), lockstep.clock_ns())


def _start_boards(
    stack: contextlib.ExitStack, spec: str, options: argparse.Namespace
) -> BoardsReports | None:
    """Start the simulated boards. Return what they report: faults and events that begin; None without any."""
    if planned_faults(options) or planned_events(options):
        return planned_reports(stack.enter_context(connected_boards(spec, options)), options)
    stack.enter_context(boards_process(spec, options))
    return None


def _announce(session: Session, setup: RunSetup, duration_s: float, planned: dict[str, float]) -> None:
    """Log what is planned for the simulated arm. Warn of late events and of early setpoints."""
    for text, at_s in planned.items():
        if at_s < duration_s:
            entry = LogEntry(
                Severity.INFO, EVENT_SOURCE, f"planned: {text} (seconds from the first sample on)"
            )
        else:
            entry = LogEntry(
                Severity.WARNING,
                EVENT_SOURCE,
                f"{text} may not happen: the run ends about {duration_text(duration_s)} after the first "
                "sample",
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
