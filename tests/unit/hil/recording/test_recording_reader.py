"""The reader: tables, entries, and files that are damaged, cut off or not recordings."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex, DataEnd, MessageIndex
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, Writer
from support.mcap_files import records
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
from hil.core.life_cycle import Trigger
from hil.core.output import LogEntry, Severity
from hil.core.requests import ControllerRequest, JogRequest, SetpointRequest
from hil.recording.entries import (
    DeadlineCalled,
    Entry,
    FrameReceived,
    FrameRefused,
    FrameSent,
    LinkFailed,
    Logged,
    Operated,
)
from hil.recording.mcap_reader import McapContents
from hil.recording.reader import Recording
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


def test_an_axis_is_a_table_of_its_signals(recording: Recording) -> None:
    rows = recording.axis("rotation")
    expected = [TENTH_STEP(number * PERIOD_S) for number in range(PERIODS)]
    running = rows[3:-3]
    for place, column in enumerate(
        ("setpoint", "position", "error", "output_v", "command_v", "potentiometer_v")
    ):
        np.testing.assert_array_equal(running[column], [signals[place] for signals in expected])
    sampled_ns = START_NS + np.arange(-3, PERIODS + 3) * PERIOD_NS + 100_000
    np.testing.assert_array_equal(rows["time_ns"], sampled_ns)
    np.testing.assert_allclose(rows["time_s"], np.arange(PERIODS + 6) * PERIOD_S, atol=1e-12)
    np.testing.assert_array_equal(rows["state"], [2] * 3 + [3] * PERIODS + [2] * 3)
    assert rows["fresh"].all()
    np.testing.assert_array_equal(rows["running"], rows["state"] == 3)
    assert (rows.name, rows.unit) == ("rotation", "rad")


def test_a_column_is_an_attribute_and_a_key(recording: Recording) -> None:
    for table in (recording.axis("vertical"), recording.timing(), recording.frames("sent")):
        assert {"time_s"} < set(table.columns)
        for name in table.columns:
            column = table[name]
            assert getattr(table, name) is column
            assert len(column) == len(table)
            assert column.flags.c_contiguous
        assert ", ".join(table.columns) in repr(table)
        with pytest.raises(KeyError, match=r"no column 'speed'; the columns are time_s, "):
            table["speed"]


def test_rows_are_selected_by_slice_condition_and_number(recording: Recording) -> None:
    vertical = recording.axis("vertical")
    for key in (slice(2, 9), vertical.running, np.array([7, 3, 3])):
        selected = vertical[key]
        assert (type(selected), selected.name, selected.unit) == (type(vertical), "vertical", "m")
        for name in vertical.columns:
            np.testing.assert_array_equal(selected[name], vertical[name][key])
    assert vertical[-1] == {name: vertical[name][-1] for name in vertical.columns}


def test_a_table_becomes_a_structured_array(recording: Recording) -> None:
    for table in (recording.axis("vertical"), recording.frames("received")):
        rows = np.asarray(table)
        assert rows.dtype.names == table.columns
        for name in table.columns:
            np.testing.assert_array_equal(rows[name], table[name])
    vertical = recording.axis("vertical")
    assert np.array_equal(vertical, recording.axis("vertical"))
    assert not np.array_equal(vertical, recording.axis("vertical")[::-1])


def test_frames_are_a_table_in_each_direction(recording: Recording) -> None:
    received, sent = recording.frames("received"), recording.frames("sent")
    periods = START_NS + np.arange(-3, PERIODS + 3) * PERIOD_NS
    np.testing.assert_array_equal(received.time_ns, periods + 300_000)
    np.testing.assert_allclose(received.time_s, (received.time_ns - recording.start_ns) * 1e-9)
    np.testing.assert_array_equal(received.stamp_ns, received.time_ns + EPOCH_OFFSET_NS - 30_000)
    assert received.data[5].tobytes() == (2).to_bytes(8, "little")
    assert set(received.length) == {8}
    commands = recording.frames("sent", identifier=0x220)
    assert len(sent) == 2 * len(commands) == len(recording.frames("sent", identifier=0x080)) * 2
    np.testing.assert_array_equal(commands.data, sent[sent.id == 0x220].data)
    assert set(commands.length) == {6}
    assert recording.frames("refused").id.tolist() == [0x080]


def test_frames_by_identifier_are_data_frames_with_an_identifier_of_11_bits(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    kinds = [Frame(0x190, b"\1"), Frame(0x190, is_remote=True), Frame(0x190, is_extended=True)]
    kinds += [Frame(0x190, is_error=True), Frame(0x191)]
    for frame in kinds:
        recorder.frame_refused(frame, START_NS)
    recorder.close({})
    recording = Recording(path)
    assert recording.frames("refused", identifier=0x190).data.tolist() == [[1, *[0] * 7]]
    refused = recording.frames("refused")
    flags = zip(refused.id, refused.is_extended, refused.is_remote, refused.is_error, strict=True)
    assert list(flags) == [(f.id, f.is_extended, f.is_remote, f.is_error) for f in kinds]


def test_times_in_seconds_count_from_the_first_period(recording: Recording) -> None:
    start_ns = START_NS - 3 * PERIOD_NS + 100_000
    assert recording.start_ns == start_ns
    assert recording.seconds(start_ns + 1_500_000_000) == 1.5
    assert recording.timing().time_s[0] == recording.axis("vertical").time_s[0] == 0.0


def test_a_recording_without_a_period_has_empty_tables(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    recorder.operated(Trigger.ARM, START_NS)
    recorder.close({})
    recording = Recording(path)
    assert recording.start_ns == 0
    assert len(recording.axis("vertical")) == len(recording.timing()) == len(recording.frames("sent")) == 0


def test_documents_are_the_attachments_as_text(recording: Recording) -> None:
    assert recording.documents == {"rig.toml": "[loop]\nperiod_s = 0.0112\n", "arm.dbc": ""}


def test_timing_is_in_monotonic_nanoseconds(recording: Recording) -> None:
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


def test_an_unknown_axis_is_named_with_those_that_exist(recording: Recording) -> None:
    with pytest.raises(RecordingError, match=r"no axis 'elbow'; the recording has vertical, horizontal, rot"):
        recording.axis("elbow")
    with pytest.raises(RecordingError, match=r"no axis 'vertcal'; .*; did you mean vertical\?"):
        recording.axis("vertcal")


instants = st.integers(0, 10**17)
frames = st.builds(
    Frame,
    st.integers(0, 2**29 - 1),
    st.binary(max_size=8),
    is_extended=st.booleans(),
    is_remote=st.booleans(),
    is_error=st.booleans(),
)
texts = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=30)
any_texts = st.text(max_size=30)
finite = st.floats(allow_nan=False)
requests = st.one_of(
    st.sampled_from(Trigger),
    st.builds(SetpointRequest, any_texts, any_texts),
    st.builds(ControllerRequest, any_texts, any_texts, any_texts),
    st.builds(JogRequest, any_texts, finite, finite),
)
entries = st.one_of(
    st.builds(FrameReceived, instants, frames, st.integers(0, 2**31 * 10**9 - 1)),
    st.builds(FrameSent, instants, frames),
    st.builds(FrameRefused, instants, frames),
    st.builds(DeadlineCalled, instants, instants),
    st.builds(Operated, instants, requests, any_texts),
    st.builds(LinkFailed, instants, texts),
    st.builds(Logged, instants, st.builds(LogEntry, st.sampled_from(Severity), texts, texts)),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(entries, max_size=40), st.integers(1, 9))
def test_all_entries_come_back_in_their_order(
    tmp_path_factory: pytest.TempPathFactory, reported: list[Entry], batch_size: int
) -> None:
    path = tmp_path_factory.mktemp("any") / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    for number, entry in enumerate(reported):
        match entry:
            case FrameReceived(now_ns, frame, stamp_ns):
                recorder.frame_received(frame, now_ns, stamp_ns)
            case FrameSent(now_ns, frame):
                recorder.frame_sent(frame, now_ns)
            case FrameRefused(now_ns, frame):
                recorder.frame_refused(frame, now_ns)
            case DeadlineCalled(now_ns, deadline_ns):
                recorder.deadline_called(deadline_ns, now_ns)
            case Operated(now_ns, request, asked_by):
                recorder.operated(request, now_ns, asked_by)
            case LinkFailed(now_ns, reason):
                recorder.link_failed(reason, now_ns)
            case Logged(now_ns, log_entry):
                recorder.log_entry(log_entry, now_ns)
        if number % batch_size == 0:
            recorder.hand_over()
    recorder.close({})
    recording = Recording(path)
    assert list(recording.entries()) == reported
    assert recording.log() == [entry for entry in reported if isinstance(entry, Logged)]


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 1.0, exclude_max=True))
@example(0.0001)  # The magic bytes alone.
def test_a_file_that_was_cut_off_anywhere_gives_its_complete_chunks(
    path: Path, recording: Recording, tmp_path_factory: pytest.TempPathFactory, part: float
) -> None:
    content = path.read_bytes()
    torn_path = tmp_path_factory.mktemp("torn") / "torn.mcap"
    torn_path.write_bytes(content[: int(part * len(content))])
    try:
        torn = Recording(torn_path)
    except RecordingError as error:
        (_, _, first_chunk_end), *_ = (r for r in records(content) if r[0] == Opcode.CHUNK)
        assert part * len(content) < first_chunk_end
        assert f"{torn_path}: was cut off before its first period: it holds no data" in str(error)
        return
    assert not torn.complete
    whole = list(recording.entries())
    found = list(torn.entries())
    assert found == whole[: len(found)]
    found_rows = torn.axis("vertical")
    assert len(found_rows) == torn.counts["/axis/vertical"]
    for name in found_rows.columns:
        np.testing.assert_array_equal(found_rows[name], recording.axis("vertical")[name][: len(found_rows)])


def test_a_cut_loses_one_chunk_at_most(path: Path, recording: Recording, tmp_path: Path) -> None:
    torn_path = tmp_path / "torn.mcap"
    last = _chunks(path)[-1]
    torn_path.write_bytes(path.read_bytes()[: last.chunk_start_offset + last.chunk_length - 1])
    lost = len(recording.timing()) - len(Recording(torn_path).timing())
    assert 0 < lost * PERIOD_NS < 700_000_000


def test_dropped_messages_end_the_entries(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 100)
    recorder._sequence += 7
    recorder._pipe.dropped.update({1: 7})
    record_periods(recorder, 100, first=100)
    recorder.close({})
    recording = Recording(path)
    found = []
    with pytest.raises(RecordingError, match=rf"{path}: 7 messages before \d+ ns were dropped"):
        found.extend(recording.entries())
    assert len(found) == 800, "all entries before the gap"
    assert len(recording.timing()) == 200


def test_messages_dropped_at_the_end_are_reported(tmp_path: Path) -> None:
    """No later message shows a gap in the sequence; the recorder's count does."""
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 100)
    recorder._pipe.dropped.update({1: 3, 2: 4})
    recorder.close({})
    with pytest.raises(RecordingError, match=rf"{path}: 7 messages after the last one were dropped"):
        list(Recording(path).entries())


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


@pytest.mark.parametrize(
    ("own", "words"),
    [
        ({}, r"has format version 1, and this program reads version 2: read it with .* version 0\.1\.0$"),
        ({"format_version": "3"}, r"has format version 3, and this program reads version 2"),
    ],
    ids=["version 1, which has no entry", "a future version"],
)
def test_another_format_version_is_refused_by_name(tmp_path: Path, own: dict[str, str], words: str) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        writer.add_metadata("recording", {"epoch_offset_ns": "1", "bus": "vcan0", **own})
        writer.add_metadata("run", {"hil": "0.1.0"})
        writer.finish()
    with pytest.raises(RecordingError, match=rf"^{path}: the recording {words}"):
        Recording(path)


def test_a_recording_whose_clock_is_no_number_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        writer.add_metadata("recording", {"format_version": "2", "epoch_offset_ns": "1x", "bus": "vcan0"})
        writer.finish()
    with pytest.raises(RecordingError, match=r"metadata recording\.epoch_offset_ns is not an integer: '1x'"):
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


def test_an_intact_file_is_opened_without_decompressing_its_chunks(
    path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    decompressed: list[int] = []
    body_of = McapContents._body_of

    def note(contents: McapContents, record: bytes) -> bytes:
        decompressed.append(path.read_bytes().index(record))
        return body_of(contents, record)

    monkeypatch.setattr(McapContents, "_body_of", note)
    opened = Recording(path)
    assert opened.counts == recording.counts
    assert decompressed == []
    opened.axis("vertical")
    assert sorted(set(decompressed)) == [chunk.chunk_start_offset for chunk in _chunks(path)]


def test_a_message_index_that_no_crc_covers_is_not_used(
    path: Path, recording: Recording, tmp_path: Path
) -> None:
    content = bytearray(path.read_bytes())
    with path.open("rb") as stream:
        kinds = [type(record) for record in StreamReader(stream, emit_chunks=True).records]
    assert kinds.count(MessageIndex) > 20
    place = len(MCAP0_MAGIC)
    for kind in kinds[:-1]:
        (length,) = struct.unpack_from("<Q", content, place + 1)
        if kind is MessageIndex:
            content[place + 15 : place + 9 + length] = bytes(length - 6)
        if kind is DataEnd:
            content[place + 9 : place + 13] = bytes(4)
        place += 9 + length
    changed = tmp_path / "changed.mcap"
    changed.write_bytes(content)
    assert list(Recording(changed).entries()) == list(recording.entries())
    np.testing.assert_array_equal(
        Recording(changed).axis("vertical").position, recording.axis("vertical").position
    )


@pytest.mark.parametrize("options", [{"repeat_channels": False}, {"repeat_schemas": False}], ids=str)
def test_channels_that_are_described_in_a_chunk_alone_are_found(
    path: Path, recording: Recording, tmp_path: Path, options: dict[str, bool]
) -> None:
    copy = tmp_path / "copy.mcap"
    with path.open("rb") as original, copy.open("wb") as stream:
        reader, writer = make_reader(original), Writer(stream, enable_data_crcs=True, **options)  # type: ignore[arg-type]
        writer.start("ros2")
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        channels: dict[int, int] = {}
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if channel.id not in channels:
                schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, "cdr", schema_id, channel.metadata
                )
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence
            )
        writer.finish()
    assert list(Recording(copy).entries()) == list(recording.entries())


def _chunks(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return summary.chunk_indexes


@pytest.mark.parametrize("stamp_ns", [-1, 2**31 * 10**9, 2**64])
def test_a_stamp_outside_ros_time_is_recorded_as_0(tmp_path: Path, stamp_ns: int) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    recorder.frame_received(Frame(1), START_NS, stamp_ns)
    recorder.close({})
    assert list(Recording(path).entries()) == [FrameReceived(START_NS, Frame(1), 0)]


def test_a_file_that_is_not_mcap_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "notes.txt"
    text.write_text("no recording")
    with pytest.raises(RecordingError, match=r"notes\.txt: not an MCAP file"):
        Recording(text)
    with pytest.raises(RecordingError, match=r"absent\.mcap: cannot be read: No such file"):
        Recording(tmp_path / "absent.mcap")


def test_an_mcap_file_of_another_program_is_refused(tmp_path: Path) -> None:
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
