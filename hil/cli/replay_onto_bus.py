"""``hil replay --bus``: confirm, send the recorded frames, and report the timing."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from hil.cli.confirmation import announce_bit_rate
from hil.cli.cut_off import warn_if_cut_off
from hil.core.errors import HilError, LinkError, RecordingError
from hil.core.frames import Frame
from hil.core.rig import Rig, read_rig
from hil.host.realtime_rights import Rights, real_time_rights
from hil.links import open_link
from hil.recording import open_recording
from hil.recording.reader import Recording
from hil.shells.bus_guard import sole_gateway
from hil.shells.bus_replay import BusReplay, Schedule, Side, centre_after, fresh_samples, schedule_of
from hil.shells.real_bus import is_real
from hil.shells.run_plan import CENTRING_PERIODS, StopRequest

INTERRUPTED = 130
_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def replay_onto_bus(path: Path, options: argparse.Namespace) -> int:
    """Replay the recording ``path`` onto ``options.bus``; return the exit status. Raises HilError."""
    if options.bus == "sim":
        raise LinkError(
            "--bus sim: simulated boards have a bus only within a run; start `firmware-sim --bus udp:43113` "
            "and replay with --bus udp:43113"
        )
    side = Side(options.side or Side.BOARDS)
    recording = open_recording(path)
    warn_if_cut_off(recording)
    schedule = schedule_of(recording, side, options.from_s, options.to_s, answer_sync=options.answer_sync)
    rig = _rig_of(recording) if side is Side.GATEWAY else None
    with contextlib.ExitStack() as stack:
        bit_rate = _adapter_bit_rate(recording, options.bus)
        announce_bit_rate(options.bus, bit_rate, f"{path}: rig.toml")
        link = stack.enter_context(open_link(options.bus, bit_rate))
        if rig is not None:
            stack.enter_context(sole_gateway(link, rig.heartbeat_periods * rig.loop.period_s))
        if is_real(options.bus) and not options.yes:
            _confirm(options.bus, side, schedule, recording)
        stop = stack.enter_context(_stop_on_signals())
        replay = BusReplay(
            link,
            schedule,
            speed=options.speed or 1.0,
            change=_change(recording, fresh=options.fresh or options.answer_sync),
            watch=_shown_progress if sys.stderr.isatty() else lambda _time_s, _worst_ms: None,
        )
        failure: LinkError | None = None
        is_whole = False
        centred = 0
        with real_time_rights() as rights:
            try:
                is_whole = replay.run(stop, endless=options.loop)
            except LinkError as error:
                failure = error
            finally:
                if rig is not None:
                    centred = centre_after(replay, rig, link.reopen)
    sys.stdout.write(_report(options.bus, side, schedule, replay, rights))
    if rig is not None:
        sys.stdout.write(_centring_report(centred))
    if failure is not None:
        raise failure
    if stop.is_set and not options.loop:
        return INTERRUPTED
    return 0 if (is_whole or options.loop) and replay.refused == 0 else 1


def _rig_of(recording: Recording) -> Rig:
    """Return the rig of the recorded run, which has the centre voltages. Raises HilError."""
    text = recording.documents.get("rig.toml")
    if text is None:
        raise RecordingError(
            f"{recording.path}: has no attachment rig.toml, so the valves could not be centred at the end; "
            "only --as boards is possible"
        )
    return read_rig(text, f"{recording.path}: rig.toml")


def _adapter_bit_rate(recording: Recording, bus: str) -> int | None:
    """Return the recorded rig's bit rate for a serial adapter; None for another bus. Raises HilError."""
    text = recording.documents.get("rig.toml")
    if text is None or not bus.startswith("slcan:"):
        return None
    return read_rig(text, f"{recording.path}: rig.toml").bus.bit_rate


def _change(recording: Recording, *, fresh: bool) -> Callable[[Frame], Frame]:
    """Return what is done to each frame before it is sent: ``fresh`` samples, in the recording's version."""
    if not fresh:
        return lambda frame: frame
    text = recording.documents.get("rig.toml")
    return fresh_samples(
        1 if text is None else read_rig(text, f"{recording.path}: rig.toml").bus.wire_version
    )


def _confirm(bus: str, side: Side, schedule: Schedule, recording: Recording) -> None:
    """Ask whether to send to a real bus. Raises HilError when the answer is no, or nobody can answer."""
    danger = (
        f"{bus} is not virtual: the recorded commands of {recording.path} will move the valves, without "
        "limits, envelope or supervision of this gateway"
        if side is Side.GATEWAY
        else f"{bus} is not virtual: a gateway on it will act on recorded samples, and valves may move"
    )
    if not sys.stdin.isatty():
        raise HilError(f"{danger}; nobody can be asked without a terminal: confirm it with --yes")
    frames, duration_s = len(schedule) + len(schedule.answers), schedule.due_ns[-1] * 1e-9
    sys.stderr.write(f"{danger}.\n{frames} frames, {duration_s:.1f} s. Go on? [y/N] ")
    sys.stderr.flush()
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise HilError("not confirmed; nothing was sent")


@contextlib.contextmanager
def _stop_on_signals() -> Iterator[StopRequest]:
    """Let signals end the replay in good order, so that the valves are centred."""
    stop = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # only the main thread may have signal handlers
        return
    before = {number: signal.signal(number, stop.set) for number in _STOP_SIGNALS}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _shown_progress(time_s: float, worst_ms: float) -> None:
    # A progress bar of rich would redraw in a thread, and that delays the frames.
    sys.stderr.write(f"\r{time_s:8.1f} s  worst timing error of the last second {worst_ms:7.3f} ms\x1b[K")
    sys.stderr.flush()


def _report(bus: str, side: Side, schedule: Schedule, replay: BusReplay, rights: Rights) -> str:
    end = "\n" if sys.stderr.isatty() else ""
    sys.stderr.write(end)
    lines = [f"replayed   {replay.sent} frames of the {side} onto {bus}; others sent {replay.received}"]
    if schedule.answers:
        lines.append(f"answered   {replay.answered} SYNCs with samples")
    if replay.refused:
        lines.append(
            f"refused    {replay.refused} frames: the queue of the bus was full; try a lower --speed"
        )
    if schedule.left_out:
        lines.append(
            f"left out   {schedule.left_out} frames: error frames, and commands that only a gateway may send"
        )
    fifo = next((right for right in rights if right.name == "SCHED_FIFO"), None)
    priority = "with SCHED_FIFO" if fifo is not None and fifo.is_granted else "without real-time priority"
    lines.append(f"timing     error {replay.timing_error()}, {priority}")
    return "\n".join(lines) + "\n"


def _centring_report(centred: int) -> str:
    if centred >= CENTRING_PERIODS:
        return f"valves     centred: the command was sent {centred} times\n"
    return (
        f"valves     the command that centres them was sent {centred} times, not {CENTRING_PERIODS}: the DAC "
        "board's watchdog has to centre them\n"
    )
