"""The recording through other readers: those of mcap, mcap-ros2-support and rosbags."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Message, MessageIndex, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.stream_reader import breakup_chunk as records_in
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from support.recorded_runs import EPOCH_OFFSET_NS, PERIOD_NS, RUN_HEADER, START_NS, record_run

from hil.core.errors import RecordingError
from hil.recording import mcap_chunks, mcap_reader

PERIODS = 400
TOPICS = {
    "/can/rx": "can_msgs/msg/Frame",
    "/can/tx": "can_msgs/msg/Frame",
    "/can/refused": "can_msgs/msg/Frame",
    "/gateway/deadline": "hil_msgs/msg/Deadline",
    "/gateway/cycle": "hil_msgs/msg/Cycle",
    "/gateway/operator": "std_msgs/msg/String",
    "/gateway/link_failure": "std_msgs/msg/String",
    "/gateway/log": "rcl_interfaces/msg/Log",
    "/axis/vertical": "hil_msgs/msg/AxisSignals",
    "/axis/horizontal": "hil_msgs/msg/AxisSignals",
    "/axis/rotation": "hil_msgs/msg/AxisSignals",
}
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recording") / "run.mcap"
    record_run(file, PERIODS)
    return file


@pytest.fixture
def reader(path: Path) -> Iterator[McapReader]:
    with path.open("rb") as stream:
        yield make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])


def test_the_profile_is_ros2(reader: McapReader) -> None:
    assert reader.get_header().profile == "ros2"


def test_the_configuration_comes_before_the_first_message(path: Path) -> None:
    with path.open("rb") as stream:
        records = list(StreamReader(stream, emit_chunks=True, validate_crcs=True).records)
    first_chunk = next(place for place, record in enumerate(records) if isinstance(record, Chunk))
    before = records[:first_chunk]
    assert [record.name for record in before if isinstance(record, Attachment)] == ["rig.toml", "arm.dbc"]
    assert [record.name for record in before if isinstance(record, Metadata)] == [
        "digests",
        "recording",
        "run",
        "setpoints",
    ]
    assert isinstance(before[0], Header)
    assert isinstance(records[-1], Footer)
    described = [
        record for record in records_in(records[first_chunk]) if isinstance(record, Schema | Channel)
    ]
    assert len(described) == len(set(TOPICS.values())) + len(TOPICS)


def test_chunks_are_short_in_time_and_size(path: Path) -> None:
    with path.open("rb") as stream:
        chunks = [r for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, Chunk)]
    assert len(chunks) > 5
    for chunk in chunks:
        assert chunk.message_end_time - chunk.message_start_time < 700_000_000
        assert chunk.uncompressed_size < 2 * 64 * 1024


def test_the_statistics_match_the_contents(reader: McapReader) -> None:
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    messages = list(reader.iter_messages())
    times = [message.log_time for _, _, message in messages]
    statistics = summary.statistics
    assert statistics.message_count == len(messages) == (PERIODS + 6) * 8 + 5
    assert statistics.channel_message_counts == Counter(channel.id for _, channel, _ in messages)
    assert (statistics.message_start_time, statistics.message_end_time) == (min(times), max(times))
    assert statistics.chunk_count == len(summary.chunk_indexes)
    assert statistics.schema_count == len(summary.schemas)
    assert {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()} == TOPICS
    assert all(channel.message_encoding == "cdr" for channel in summary.channels.values())
    assert statistics.metadata_count == len(list(reader.iter_metadata())) == 7
    attachments = {a.name: (a.media_type, a.data) for a in reader.iter_attachments()}
    assert attachments == RUN_HEADER.attachments


def test_message_indexes_point_at_their_messages(path: Path) -> None:
    chunk: Chunk | None = None
    indexed: Counter[int] = Counter()
    with path.open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True).records:
            if isinstance(record, Chunk):
                chunk = record
                offsets = _message_offsets(chunk)
            elif isinstance(record, MessageIndex):
                assert chunk is not None
                assert [(offsets[offset]) for _, offset in record.records] == [
                    (record.channel_id, log_time) for log_time, _ in record.records
                ]
                indexed[record.channel_id] += len(record.records)
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert indexed == summary.statistics.channel_message_counts


def _message_offsets(chunk: Chunk) -> dict[int, tuple[int, int]]:
    """Return channel and log time of each message record, by its offset."""
    found = {}
    builder = RecordBuilder()
    for record in records_in(chunk, validate_crc=True):
        if isinstance(record, Message):
            found[builder.count] = (record.channel_id, record.log_time)
        record.write(builder)
    return found


def test_a_range_of_time_is_found_through_the_index(reader: McapReader) -> None:
    start, end = (EPOCH_OFFSET_NS + START_NS + periods * PERIOD_NS for periods in (100, 130))
    everything = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
    for topic in ("/can/tx", "/axis/rotation"):
        some = [
            (c.topic, m.log_time, m.data)
            for _, c, m in reader.iter_messages(topic, starting_at=start, ending_before=end)
        ]
        assert some == [m for m in everything if m[0] == topic and start <= m[1] < end]
        assert len(some) == (60 if topic == "/can/tx" else 30)


def test_order_without_an_index(path: Path) -> None:
    with path.open("rb") as stream:
        messages = [
            m for _, _, m in NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        ]
    assert [message.sequence for message in messages] == list(range(1, len(messages) + 1))


def test_mcap_ros2_support_decodes_every_topic(reader: McapReader) -> None:
    decoded = {topic: [] for topic in TOPICS}
    for _, channel, message, content in reader.iter_decoded_messages():
        decoded[channel.topic].append((message, content))
    message, frame = decoded["/can/rx"][5]
    assert (frame.header.frame_id, frame.id, frame.dlc, bytes(frame.data)) == (
        "vcan0",
        0x190,
        8,
        b"\2" + bytes(7),
    )
    assert frame.header.stamp.sec * 10**9 + frame.header.stamp.nanosec == message.publish_time
    assert message.publish_time == message.log_time - 30_000
    _, axis = decoded["/axis/vertical"][150]
    assert axis.setpoint == 0.1
    assert axis.error == 0.1 - axis.position
    assert (axis.state, axis.fresh) == (3, True)
    message, cycle = decoded["/gateway/cycle"][3]
    assert cycle.number == 0
    assert cycle.deadline_ns == START_NS
    assert message.log_time == cycle.sent_ns + EPOCH_OFFSET_NS
    ((_, entry),) = decoded["/gateway/log"]
    assert (entry.level, entry.name, entry.msg) == (20, "life cycle", "armed -> running (start)")
    assert (entry.file, entry.function, entry.line) == ("", "", 0)
    assert [content.data for _, content in decoded["/gateway/operator"]] == ["start", "stop"]
    assert [content.data for _, content in decoded["/gateway/link_failure"]] == ["Network is down"]
    assert [content.id for _, content in decoded["/can/refused"]] == [0x080]


def test_rosbags_reads_every_topic(path: Path) -> None:
    with AnyReader([path]) as bag:
        assert {c.topic: c.msgtype for c in bag.connections} == TOPICS
        counts = {c.topic: c.msgcount for c in bag.connections}
        found: Counter[str] = Counter()
        for connection, _, raw in bag.messages():
            message = bag.deserialize(raw, connection.msgtype)
            found[connection.topic] += 1
            if connection.topic == "/gateway/log":
                assert message.msg == "armed -> running (start)"
        assert found == counts


def test_a_chunk_that_states_gigabytes_is_refused_without_allocating_them(tmp_path: Path) -> None:
    """A zstd frame of a few bytes may state any size for its content."""
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("hil_msgs/msg/A", "ros2msg", b"uint8 x")
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_message(channel, 0, bytes(70_000), 0)
        writer.finish()
    data = path.read_bytes()
    header = data[data.index(ZSTD_MAGIC) :][:18]
    size = zstandard.frame_content_size(header).to_bytes(4, "little")
    stated = (mcap_chunks.MAX_CHUNK_BYTES + 1).to_bytes(4, "little")
    path.write_bytes(data.replace(header, header.replace(size, stated), 1))
    with pytest.raises(RecordingError, match=r"it states 67108865 bytes, limit 262144"):
        mcap_reader.McapContents(path)
