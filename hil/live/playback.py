"""Plays a recording in the page: at any speed, from any time, each viewer for itself."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from hil.core.errors import RecordingError
from hil.live.feed_file import HISTORY_S
from hil.live.history import Rows
from hil.live.readings import readings
from hil.recording import open_recording
from hil.views.summary import min_steps

MAX_SPEED = 1000.0
READINGS_INTERVAL_S = 0.5


class Playback:
    """A recording as rows, in memory once for all viewers."""

    def __init__(self, paths: Sequence[Path], from_s: float | None = None, to_s: float | None = None) -> None:
        """Read a range of a recording: a file, all files of a run, or their folder. Raises RecordingError."""
        recording = open_recording(paths[0] if len(paths) == 1 else list(paths)).between(from_s, to_s)
        timing = recording.timing()
        self.axes = list(recording.axes.items())
        self.states = [name for _, name in sorted(recording.state_names.items())]
        columns: list[Any] = [
            timing.time_s,
            (timing.wake_ns - timing.deadline_ns) * 1e-6,
            (timing.sent_ns - timing.wake_ns) * 1e-6,
            timing.state,
            timing.fresh,
        ]
        for name, _ in self.axes:
            axis = recording.axis(name)
            columns += [axis.setpoint, axis.position, axis.command_v]
        self.rows: Rows = np.column_stack(columns).astype(np.float64)
        self.log: list[tuple[float, int, str, str]] = [
            (recording.seconds(entry.now_ns), int(entry.entry.severity), entry.entry.source, entry.entry.text)
            for entry in recording.log()
        ]
        if len(self.rows) == 0:
            raise RecordingError(f"{paths[0]}: no period to play in this range")
        self.min_steps = min_steps(recording.documents.get("rig.toml", ""))
        self.begin_s, self.end_s = float(self.rows[0, 0]), float(self.rows[-1, 0])
        """Times of the first and the last period, in seconds from the first recorded one."""
        documents = recording.documents
        controllers = {
            name: _name_of(documents[f"controllers/{name}.json"])
            for name, _ in self.axes
            if f"controllers/{name}.json" in documents
        }
        digest = hashlib.sha256(documents.get("rig.toml", "").encode()).hexdigest()
        self.information = {
            "axes": self.axes,
            "period_s": float(np.median(np.diff(self.rows[:, 0]))) if len(self.rows) > 1 else 0.01,
            "states": self.states,
            "rig": f"rig.toml, SHA-256 {digest[:12]}",
            "bus": "recorded",
            "start_ns": 0,
            "epoch_offset_ns": 0,
        }
        self.status = {
            "counts": {"messages dropped while recording": recording.messages_dropped},
            "fault": None,
            "readiness": "",
            "controllers": controllers,
            "recording": ", ".join(path.name for path in paths),
        }


class PlaybackSource:
    """A recording as one viewer plays it."""

    def __init__(self, playback: Playback) -> None:
        self._playback = playback
        self._speed = 1.0
        self._is_paused = False
        self._position_s = playback.begin_s
        self._read_at_s = monotonic()
        self._next_row = 0
        self._next_log = 0
        self._messages: list[dict[str, Any]] = []
        self._next_readings_s = 0.0

    def begin(self) -> list[dict[str, Any]]:
        """Return what the recording is."""
        playback = self._playback
        return [
            {
                "run": playback.information,
                "mode": "recording",
                "may_operate": False,
                "begin_s": playback.begin_s,
                "end_s": playback.end_s,
            },
            {"status": playback.status},
        ]

    def take(self) -> tuple[list[dict[str, Any]], Rows]:
        """Return what the time that has passed has brought."""
        playback = self._playback
        now_s = monotonic()
        if not self._is_paused:
            passed_s = (now_s - self._read_at_s) * self._speed
            self._position_s = min(self._position_s + passed_s, playback.end_s)
        self._read_at_s = now_s
        end = int(np.searchsorted(playback.rows[:, 0], self._position_s, side="right"))
        rows = playback.rows[self._next_row : end]
        self._next_row = max(end, self._next_row)
        messages, self._messages = self._messages, []
        last_log = self._next_log
        while self._next_log < len(playback.log) and playback.log[self._next_log][0] <= self._position_s:
            self._next_log += 1
        if self._next_log > last_log:
            messages.append({"log": playback.log[last_log : self._next_log]})
        if now_s >= self._next_readings_s and end:
            self._next_readings_s = now_s + READINGS_INTERVAL_S
            begin = np.searchsorted(playback.rows[:, 0], self._position_s - HISTORY_S)
            seen = playback.rows[begin:end]
            messages.append({"readings": readings(seen, playback.axes, playback.states, playback.min_steps)})
        messages.append({"position_s": self._position_s})
        return messages, rows

    async def request(self, request: Mapping[str, Any]) -> dict[str, Any] | None:
        """Take ``{"speed": x}``, ``{"paused": true}`` or ``{"seek_s": s}``. Raises ValueError."""
        if "speed" in request:
            speed = float(request["speed"])
            if not 0.0 < speed <= MAX_SPEED:
                raise ValueError(f"speed {speed:g} is not between 0 and {MAX_SPEED:g}")
            self._speed = speed
        elif "paused" in request:
            self._is_paused = bool(request["paused"])
        elif "seek_s" in request:
            self._seek(float(request["seek_s"]))
        else:
            raise ValueError("a recording takes speed, paused and seek_s")
        return None

    def _seek(self, position_s: float) -> None:
        """Go to a time; what is on the page begins anew, with the ten minutes before that time."""
        playback = self._playback
        if not playback.begin_s <= position_s <= playback.end_s:
            raise ValueError(
                f"{position_s:g} s is not between {playback.begin_s:g} s and {playback.end_s:g} s"
            )
        self._position_s = position_s
        self._read_at_s = monotonic()
        self._next_row = int(np.searchsorted(playback.rows[:, 0], position_s - HISTORY_S))
        self._next_log = 0
        self._next_readings_s = 0.0
        self._messages = [{"clear": True}]


def _name_of(document: str) -> str:
    """Return the name in a controller file."""
    try:
        return str(json.loads(document).get("name", "without a name"))
    except ValueError:
        return "unreadable"
