"""A recording through Foxglove's JavaScript readers, in node: every value is that of this project's reader.

``tests/node`` names their versions; ``make test`` installs them there with ``npm ci``.
"""

from __future__ import annotations

import json
import math
import subprocess
from pathlib import Path
from typing import Any

import pytest
from support.constants import PERIOD_NS
from support.recorded_runs import EPOCH_OFFSET_NS, RUN_HEADER, START_NS, in_memory, record_periods

from hil.core.frames import Frame
from hil.core.life_cycle import Trigger
from hil.core.output import AxisSignals, LogEntry, Severity
from hil.recording import open_recording
from hil.recording.entries import (
    AxisRecorded,
    CycleRecorded,
    DeadlineCalled,
    Entry,
    FrameReceived,
    FrameRefused,
    FrameSent,
    LinkFailed,
    Logged,
    Operated,
)
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder
from hil.recording.request_texts import read_request

NODE_FOLDER = Path(__file__).parents[3] / "node"
SECOND_NS = 1_000_000_000
FRAMES = {"/can/tx": FrameSent, "/can/refused": FrameRefused}
INSTANTS = ("number", "deadline_ns", "wake_ns", "receive_ns", "computed_ns", "sent_ns")
SIGNALS = ("setpoint", "position", "error", "output_v", "command_v", "potentiometer_v")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A recording with a message of every topic, and with values that are easily misread."""
    path = tmp_path_factory.mktemp("foxglove") / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    recorder.operated(Trigger.START, START_NS - PERIOD_NS, "uid 1000")
    record_periods(recorder, 3, lambda t: AxisSignals(*[math.nan] * 4, 5.0, -0.0), first=-3)
    record_periods(recorder, 200)
    end_ns = START_NS + 200 * PERIOD_NS
    recorder.log_entry(LogEntry(Severity.WARNING, "axis µ", "Weg größer als 0,1 m – 位置"), end_ns)
    for frame in (
        Frame(0x1FFFFFFF, b"\xff\0\x80", is_extended=True),
        Frame(0x321, bytes(5), is_remote=True),
        Frame(0x40, bytes(8), is_error=True),
    ):
        recorder.frame_received(frame, end_ns, end_ns + EPOCH_OFFSET_NS)
    recorder.frame_refused(Frame(0x220, b"123456"), end_ns)
    recorder.link_failed("Network is down", end_ns)
    recorder.close({"ending": {"reason": "completed"}})
    return open_recording(path)


@pytest.fixture(scope="module")
def lines(recording: Recording) -> list[dict[str, Any]]:
    """What the JavaScript readers find in the recording."""
    done = subprocess.run(
        ["node", "read_recording.mjs", str(recording.path)],
        cwd=NODE_FOLDER,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, f"`npm ci` in {NODE_FOLDER} installs the readers: {done.stderr}"
    return [json.loads(line) for line in done.stdout.splitlines()]


def number(value: float | str) -> float:
    return float(value)


def frame_in(content: dict[str, Any]) -> Frame:
    assert content["header"]["frame_id"] == "vcan0"
    assert content["data"][content["dlc"] :] == [0] * (8 - content["dlc"])
    data = bytes(content["data"][: content["dlc"]])
    return Frame(content["id"], data, content["is_extended"], content["is_rtr"], content["is_error"])


def stamp_ns(stamp: dict[str, int]) -> int:
    return stamp["sec"] * SECOND_NS + stamp["nsec"]


def entry_in(line: dict[str, Any]) -> Entry:
    """Return the entry that a line describes."""
    topic, content = line["topic"], line["content"]
    now_ns = int(line["logTime"]) - EPOCH_OFFSET_NS
    match topic:
        case "/can/rx":
            assert stamp_ns(content["header"]["stamp"]) == int(line["publishTime"])
            return FrameReceived(now_ns, frame_in(content), int(line["publishTime"]))
        case "/can/tx" | "/can/refused":
            assert stamp_ns(content["header"]["stamp"]) == int(line["logTime"])
            return FRAMES[topic](now_ns, frame_in(content))
        case "/gateway/deadline":
            return DeadlineCalled(int(content["now_ns"]), int(content["deadline_ns"]))
        case "/gateway/cycle":
            instants = (int(content[name]) for name in INSTANTS)
            return CycleRecorded(now_ns, *instants, content["state"], content["fresh"])
        case "/gateway/operator":
            return Operated(now_ns, *read_request(content["data"]))
        case "/gateway/link_failure":
            return LinkFailed(now_ns, content["data"])
        case "/gateway/log":
            assert (content["file"], content["function"], content["line"]) == ("", "", 0)
            assert stamp_ns(content["stamp"]) == int(line["logTime"])
            return Logged(now_ns, LogEntry(Severity(content["level"]), content["name"], content["msg"]))
    axis = topic.removeprefix("/axis/")
    wake_ns = stamp_ns(content["header"]["stamp"]) - EPOCH_OFFSET_NS
    signals = AxisSignals(*(number(content[name]) for name in SIGNALS), content["phase"])
    return AxisRecorded(now_ns, axis, wake_ns, signals, content["state"], content["fresh"])


def test_every_message_has_the_values_that_our_reader_gives(
    recording: Recording, lines: list[dict[str, Any]]
) -> None:
    messages = [line for line in lines if "topic" in line]
    assert {line["topic"] for line in messages} == set(recording.counts)
    assert [line["sequence"] for line in messages] == list(range(1, len(messages) + 1))
    # repr: NaN is not equal to itself, and -0.0 is equal to 0.0.
    assert list(map(repr, map(entry_in, messages))) == list(map(repr, recording.entries()))


def test_attachments_and_metadata_are_those_that_our_reader_gives(
    recording: Recording, lines: list[dict[str, Any]]
) -> None:
    attached = {line["attachment"]: bytes(line["data"]) for line in lines if "attachment" in line}
    assert attached == recording.attachments
    assert {line["metadata"]: line["entries"] for line in lines if "metadata" in line} == recording.metadata
