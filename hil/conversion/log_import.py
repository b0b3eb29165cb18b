"""Make a recording of a bus log, which the reader and the reports take.

The log is read twice: once to find the buses, the order of time and when the valves were commanded, and once
to write. So memory stays bounded.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from hil import __version__
from hil.conversion.bus_logs import LogFormat, LoggedFrame, log_format, logged_frames
from hil.conversion.dbc import read_dbc
from hil.conversion.log_periods import LogDecoder, Period
from hil.conversion.output_file import new_file
from hil.core.errors import RecordingError
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.core.rig import read_rig
from hil.recording.recorder import Recorder, RunHeader

IMPORTED = "imported"
"""Name of the metadata that mark a recording as imported from a bus log."""

MAX_STEP_BACK_NS = 1_000_000_000
"""Largest step back of the log's time that is taken for disorder of frames, which several buses cause."""
START_NS = 1_000_000_000
"""Monotonic instant of the first frame. It is not 0, which stands for no sample."""
WATCH_FRAMES = 5000
"""Number of frames from one report of progress to the next."""


class Document(NamedTuple):
    """A text that the import uses and attaches to the recording."""

    text: str
    source: str
    """File it comes from, for errors and metadata."""


class Imported(NamedTuple):
    """Result of an import."""

    path: Path
    """Recording that was written."""
    format: LogFormat
    received: int
    """Number of frames that the gateway had received."""
    sent: int
    """Number of frames that the gateway had sent."""
    periods: int
    """Number of periods; 0 if the log has neither SYNC nor samples."""
    unreadable: int
    """Number of frames that were left out: not classic CAN, or corrupt."""
    reordered: int
    """Number of frames whose time was before that of the frame before; they get the time of that frame."""


class _Survey(NamedTuple):
    """What the first reading of the log finds."""

    frames: int
    first_ns: int
    channel: str
    has_sync: bool
    running_ns: tuple[int, int] | None
    """Instants of the first and the last command that opened a valve; None if none did."""
    unreadable: int
    reordered: int


def import_log(
    log: Path,
    path: Path,
    rig: Document,
    dbc: Document,
    *,
    channel: str | None = None,
    force: bool = False,
    watch: Callable[[float], None] = lambda share: None,
) -> Imported:
    """Write the frames of a bus log, and the signals decoded from them, as the recording ``path``.

    Frames that the DBC file lets the gateway send count as sent, all others as received. A period begins with
    SYNC, or with a sample if the log has no SYNC. The state is *running* from the first to the last command
    that opens a valve, *ready* otherwise, and *offline* before the first sample. Setpoints are unknown.
    ``channel`` chooses one of several buses in the log. ``watch`` is called with the share that is done.

    Raises DocumentError, RecordingExistsError, EnvironmentLackError, and RecordingError when the log is
    damaged or has no frame.
    """
    kind = log_format(log)
    decoder = LogDecoder(read_rig(rig.text, rig.source), read_dbc(dbc.text, dbc.source), dbc.source)
    survey = _survey(log, kind, decoder, channel, watch)
    epoch_offset_ns = max(survey.first_ns - START_NS, 0)
    header = _header(log, kind, survey, epoch_offset_ns, rig, dbc)
    with new_file(path, force=force, source=log) as temporary:
        temporary.unlink()  # the recorder creates its file itself
        recorder = Recorder(temporary, header, lossless=True)
        writer = _Writer(recorder, decoder, survey, epoch_offset_ns)
        ended = False
        try:
            for number, (time_ns, frame) in enumerate(_frames(log, kind, survey.channel), 1):
                writer.add(frame, time_ns)
                if number % WATCH_FRAMES == 0:
                    watch(0.5 + 0.5 * number / survey.frames)
            writer.end_period()
            ended = True
        finally:
            reason = "imported from a bus log" if ended else "the import was interrupted"
            report = recorder.close({"ending": {"reason": reason}})
        if report.failure is not None:
            raise RecordingError(f"{path}: cannot be written: {report.failure}")
    return Imported(
        path, kind, writer.received, writer.sent, writer.periods, survey.unreadable, survey.reordered
    )


def _survey(
    log: Path, kind: LogFormat, decoder: LogDecoder, channel: str | None, watch: Callable[[float], None]
) -> _Survey:
    channels: dict[str, int] = {}
    frames = unreadable = reordered = 0
    first_ns = last_ns = None
    running_ns: tuple[int, int] | None = None
    has_sync = False
    for logged in logged_frames(log, kind):
        channels[logged.channel] = channels.get(logged.channel, 0) + 1
        if channel is not None and logged.channel != channel:
            continue
        if logged.frame is None:
            unreadable += 1
            continue
        frames += 1
        if first_ns is None or last_ns is None:
            first_ns = last_ns = logged.time_ns
        if logged.time_ns < last_ns:
            reordered += 1
            _check_step_back(log, frames, last_ns - logged.time_ns)
        last_ns = max(last_ns, logged.time_ns)
        has_sync = has_sync or decoder.is_sync(logged.frame)
        command_v = decoder.command(logged.frame)
        if command_v is not None and not decoder.is_centred(command_v):
            running_ns = (last_ns if running_ns is None else running_ns[0], last_ns)
    if channel is None and len(channels) > 1:
        raise RecordingError(
            f"{log}: has frames of {len(channels)} buses ({', '.join(sorted(channels))}); choose one with "
            "--channel"
        )
    if first_ns is None:
        raise RecordingError(f"{log}: {_no_frame(channels, channel, unreadable)}")
    watch(0.5)
    chosen = next(iter(channels)) if channel is None else channel
    return _Survey(frames, first_ns, chosen, has_sync, running_ns, unreadable, reordered)


def _check_step_back(log: Path, frames: int, step_ns: int) -> None:
    if step_ns > MAX_STEP_BACK_NS:
        raise RecordingError(
            f"{log}: time goes back by {step_ns * 1e-9:.3f} s at frame {frames}, limit "
            f"{MAX_STEP_BACK_NS * 1e-9:g} s: the clock was set, or two logs were joined; split the log there"
        )


def _no_frame(channels: dict[str, int], channel: str | None, unreadable: int) -> str:
    if channel is not None and channel not in channels:
        return f"has no frame of bus {channel!r} (--channel); its buses are {', '.join(sorted(channels))}"
    return "has no frame of classic CAN" + (f"; {unreadable} others" if unreadable else "")


def _frames(log: Path, kind: LogFormat, channel: str) -> Iterator[tuple[int, Frame]]:
    """Yield the frames of a bus with ascending time stamps."""
    last_ns = 0
    logged: LoggedFrame
    for logged in logged_frames(log, kind):
        if logged.frame is not None and logged.channel == channel:
            last_ns = max(last_ns, logged.time_ns)
            yield last_ns, logged.frame


def _header(
    log: Path, kind: LogFormat, survey: _Survey, epoch_offset_ns: int, rig: Document, dbc: Document
) -> RunHeader:
    texts = {"rig.toml": ("application/toml", rig), "arm.dbc": ("text/plain", dbc)}
    axes = read_rig(rig.text, rig.source).axes
    return RunHeader(
        epoch_offset_ns=epoch_offset_ns,
        bus=survey.channel or "can0",
        stamp_origin="bus log",
        axes=tuple((name, axis.unit) for name, axis in axes.items()),
        attachments={name: (media, document.text.encode()) for name, (media, document) in texts.items()},
        metadata={
            "documents": {
                name: hashlib.sha256(document.text.encode()).hexdigest()
                for name, (_, document) in texts.items()
            },
            "run": {"hil": __version__},
            IMPORTED: {
                "file": log.name,
                "format": kind,
                "sha256": _sha256(log),
                "bus": survey.channel,
                "rig": rig.source,
                "dbc": dbc.source,
                "period begins with": "SYNC" if survey.has_sync else "TPDO1_ADC",
                "state": "running from the first to the last command that opens a valve",
                "setpoint": "unknown",
                "frames unreadable": str(survey.unreadable),
                "frames out of order": str(survey.reordered),
            },
        },
    )


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class _Writer:
    """Records frames and periods in the order of the log."""

    def __init__(
        self, recorder: Recorder, decoder: LogDecoder, survey: _Survey, epoch_offset_ns: int
    ) -> None:
        self._recorder = recorder
        self._decoder = decoder
        self._has_sync = survey.has_sync
        self._running_ns = survey.running_ns
        self._epoch_offset_ns = epoch_offset_ns
        self._period: Period | None = None
        self._volts: list[float] | None = None
        """Voltages of the last sample; None before the first one."""
        self._command_v = decoder.centres_v
        """Voltages of the last command."""
        self.received = self.sent = self.periods = 0

    def add(self, frame: Frame, time_ns: int) -> None:
        """Record a frame, and begin or complete a period with it."""
        now_ns = time_ns - self._epoch_offset_ns
        if self._decoder.is_sync(frame) if self._has_sync else self._decoder.is_sample(frame):
            self.end_period()
            self._period = Period(self.periods, now_ns)
        if self._decoder.is_sent(frame):
            self.sent += 1
            self._recorder.frame_sent(frame, now_ns)
        else:
            self.received += 1
            self._recorder.frame_received(frame, now_ns, time_ns)
        self._decode(frame, now_ns)

    def end_period(self) -> None:
        """Record the period in progress, if there is one."""
        period = self._period
        if period is None:
            return
        self._period = None
        self.periods += 1
        signals = self._decoder.signals(self._volts, self._command_v)
        cycle = period.cycle(self._state(period), signals)
        self._recorder.cycle(cycle, period.receive_ns or period.begin_ns, period.end_ns)
        self._recorder.hand_over()

    def _decode(self, frame: Frame, now_ns: int) -> None:
        volts, command_v = self._decoder.sample(frame), self._decoder.command(frame)
        if volts is not None:
            self._volts = volts
        if command_v is not None:
            self._command_v = command_v
        if self._period is not None and (volts is not None or command_v is not None):
            self._period.end_ns = now_ns
            if volts is not None:
                self._period.receive_ns = now_ns

    def _state(self, period: Period) -> LifeCycleState:
        if self._volts is None:
            return LifeCycleState.OFFLINE
        if self._running_ns is not None:
            first_ns, last_ns = (instant - self._epoch_offset_ns for instant in self._running_ns)
            if period.end_ns >= first_ns and period.begin_ns <= last_ns:
                return LifeCycleState.RUNNING
        return LifeCycleState.READY
