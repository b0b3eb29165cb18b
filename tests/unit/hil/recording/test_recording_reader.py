"""The reader: arrays, calls, and files that are damaged, cut off or something else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import Writer
from support.recorded_runs import (
    EPOCH_OFFSET_NS,
    PERIOD_NS,
    PERIOD_S,
    RUN_HEADER,
    START_NS,
    TENTH_STEP,
    in_memory,
    record_periods,
    record_run,
)

from hil.core.errors import RecordingError
from hil.core.frames import Frame
from hil.core.output import LogEntry, Severity
from hil.recording.reader import Call, DeadlineCalled, FrameReceived, FrameSent, Operated, Recording
from hil.recording.recorder import Recorder

PERIODS = 300


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recording") / "run.mcap"
    record_run(file, PERIODS)
    return file


@pytest.fixture(scope="module")
def recording(path: Path) -> Recording:
    return Recording(path)


def test_axes_and_states_are_named(recording: Recording) -> None:
    assert recording.axes == {"vertical": "m", "horizontal": "m", "rotation": "rad"}
    assert recording.state_names == {0: "offline", 1: "ready", 2: "armed", 3: "running", 4: "fault"}
    assert recording.complete


def test_an_axis_comes_as_columns(recording: Recording) -> None:
    rows = recording.axis("rotation")
    expected = [TENTH_STEP(number * PERIOD_S) for number in range(PERIODS)]
    running = rows[3:-3]
    for place, column in enumerate(
        ("setpoint", "position", "error", "output_v", "command_v", "potentiometer_v")
    ):
        np.testing.assert_array_equal(running[column], [signals[place] for signals in expected])
    sampled_ns = START_NS + np.arange(-3, PERIODS + 3) * PERIOD_NS + 100_000
    np.testing.assert_array_equal(rows["time_ns"], sampled_ns)
    np.testing.assert_array_equal(rows["state"], [2] * 3 + [3] * PERIODS + [2] * 3)
    assert rows["fresh"].all()


def test_timing_comes_in_monotonic_nanoseconds(recording: Recording) -> None:
    timing = recording.timing()
    deadlines = START_NS + np.arange(-3, PERIODS + 3) * PERIOD_NS
    np.testing.assert_array_equal(timing["number"], np.arange(-3, PERIODS + 3))
    for column, late_ns in (
        ("deadline", 0),
        ("wake", 100_000),
        ("receive", 300_000),
        ("computed", 350_000),
        ("sent", 500_000),
    ):
        np.testing.assert_array_equal(timing[f"{column}_ns"], deadlines + late_ns)


def test_an_axis_that_is_not_there_is_named(recording: Recording) -> None:
    with pytest.raises(RecordingError, match=r"no channel /axis/elbow; it has /can/rx, "):
        recording.axis("elbow")


instants = st.integers(0, 10**17)
frames = st.builds(
    Frame,
    st.integers(0, 2**29 - 1),
    st.binary(max_size=8),
    is_extended=st.booleans(),
    is_remote=st.booleans(),
    is_error=st.booleans(),
)
calls = st.one_of(
    st.builds(FrameReceived, instants, frames, st.integers(0, 2**31 * 10**9 - 1)),
    st.builds(FrameSent, instants, frames),
    st.builds(DeadlineCalled, instants, instants),
    st.builds(
        Operated,
        instants,
        st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=30),
    ),
)
events = st.builds(
    LogEntry,
    st.sampled_from(Severity),
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=9),
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=30),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(calls, events), max_size=40), st.integers(1, 9))
def test_any_calls_come_back_in_their_order(
    tmp_path_factory: pytest.TempPathFactory, reports: list[Call | LogEntry], batch_size: int
) -> None:
    path = tmp_path_factory.mktemp("any") / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    for number, report in enumerate(reports):
        match report:
            case FrameReceived(now_ns, frame, stamp_ns):
                recorder.frame_received(frame, now_ns, stamp_ns)
            case FrameSent(now_ns, frame):
                recorder.frame_sent(frame, now_ns)
            case DeadlineCalled(now_ns, deadline_ns):
                recorder.deadline_called(deadline_ns, now_ns)
            case Operated(now_ns, command):
                recorder.operated(command, now_ns)
            case event:
                recorder.log_entry(event, number)
        if number % batch_size == 0:
            recorder.hand_over()
    recorder.close({})
    recording = Recording(path)
    assert list(recording.calls()) == [report for report in reports if not isinstance(report, LogEntry)]
    assert [event for _, event in recording.log()] == [
        report for report in reports if isinstance(report, LogEntry)
    ]


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_off_anywhere_gives_what_is_whole(
    path: Path, recording: Recording, tmp_path_factory: pytest.TempPathFactory, part: float
) -> None:
    content = path.read_bytes()
    torn_path = tmp_path_factory.mktemp("torn") / "torn.mcap"
    torn_path.write_bytes(content[: int(part * len(content))])
    try:
        torn = Recording(torn_path)
    except RecordingError as error:
        assert part * len(content) < content.index(b"setpoints")
        assert "not an MCAP file" in str(error) or "metadata recording" in str(error)
        return
    assert not torn.complete
    if not torn.axes:
        return
    whole = list(recording.calls())
    found = list(torn.calls())
    assert found == whole[: len(found)]
    np.testing.assert_array_equal(
        torn.axis("vertical"), recording.axis("vertical")[: torn.counts["/axis/vertical"]]
    )


def test_a_cut_loses_one_chunk_at_most(path: Path, recording: Recording, tmp_path: Path) -> None:
    torn_path = tmp_path / "torn.mcap"
    last = _chunks(path)[-1]
    torn_path.write_bytes(path.read_bytes()[: last.chunk_start_offset + last.chunk_length - 1])
    lost = len(recording.timing()) - len(Recording(torn_path).timing())
    assert 0 < lost * PERIOD_NS < 700_000_000


def test_what_was_dropped_ends_the_calls(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 100)
    recorder._sequence += 7
    record_periods(recorder, 100, first=100)
    recorder.close({})
    recording = Recording(path)
    found = []
    with pytest.raises(RecordingError, match=rf"{path}: 7 messages before \d+ ns were dropped"):
        found.extend(recording.calls())
    calls = recording.calls()
    assert sum(1 for _ in zip(range(400), calls, strict=False)) == 400
    assert len(recording.timing()) == 200


def test_what_was_dropped_at_the_end_is_missed_too(tmp_path: Path) -> None:
    """No later message tells by its sequence; the recorder's count does."""
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 100)
    recorder._pipe.dropped.update({1: 3, 2: 4})
    recorder.close({})
    with pytest.raises(RecordingError, match=rf"{path}: 7 messages after the last one were dropped"):
        list(Recording(path).calls())


@pytest.mark.parametrize("entry", ["epoch_offset_ns", "bus"])
def test_a_recording_without_its_own_metadata_is_refused(tmp_path: Path, entry: str) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        own = {"epoch_offset_ns": "1", "bus": "vcan0"}
        writer.add_metadata("recording", {key: value for key, value in own.items() if key != entry})
        writer.finish()
    with pytest.raises(RecordingError, match=rf"metadata recording\.{entry} is missing"):
        Recording(path)


def test_a_recording_whose_clock_is_no_number_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        writer.add_metadata("recording", {"epoch_offset_ns": "1x", "bus": "vcan0"})
        writer.finish()
    with pytest.raises(RecordingError, match=r"metadata recording\.epoch_offset_ns is no number"):
        Recording(path)


def test_a_damaged_chunk_is_named(path: Path, tmp_path: Path) -> None:
    content = path.read_bytes()
    for chunk in _chunks(path):
        for part in (0.3, 0.6, 0.9):
            place = chunk.chunk_start_offset + int(part * chunk.chunk_length)
            damaged = tmp_path / "damaged.mcap"
            damaged.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
            with pytest.raises(RecordingError, match=rf"chunk at byte {chunk.chunk_start_offset} is damaged"):
                Recording(damaged)


def _chunks(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return summary.chunk_indexes


@pytest.mark.parametrize("stamp_ns", [-1, 2**31 * 10**9, 2**64])
def test_a_stamp_that_cannot_be_is_recorded_as_none(tmp_path: Path, stamp_ns: int) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    recorder.frame_received(Frame(1), START_NS, stamp_ns)
    recorder.close({})
    assert list(Recording(path).calls()) == [FrameReceived(START_NS, Frame(1), 0)]


def test_something_else_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no recording")
    with pytest.raises(RecordingError, match=r"notes\.txt: not an MCAP file"):
        Recording(text)
    with pytest.raises(RecordingError, match=r"absent\.mcap: cannot be read: No such file"):
        Recording(tmp_path / "absent.mcap")


def test_somebody_elses_mcap_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        channel = writer.register_channel(
            "/tf", "cdr", writer.register_schema("tf2_msgs/msg/TFMessage", "ros2msg", b"")
        )
        writer.add_message(channel, EPOCH_OFFSET_NS, b"", EPOCH_OFFSET_NS)
        writer.finish()
    with pytest.raises(
        RecordingError, match=r"not the recording of a run: metadata recording\.epoch_offset_ns is missing"
    ):
        Recording(path)
