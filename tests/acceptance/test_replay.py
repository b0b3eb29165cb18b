"""Replay: every outgoing byte of a recorded run comes out again, and one changed byte is found."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from hil.cli import main
from hil.recording.reader import Recording
from hil.shells.replay import verify

DLC = -9
"""Place of the data length in can_msgs/msg/Frame; eight bytes of data follow."""
ARGUMENTS = ["run", "--lockstep", "--duration", "3"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    assert main([*ARGUMENTS, "--record", str(path)]) == 0
    return path


def copy_with_changed_byte(source: Path, target: Path, topic: str, message: int, byte: int) -> None:
    """Copy a recording by mcap's own reader and writer; flip one bit of the n-th frame of eight bytes."""
    with source.open("rb") as original, target.open("wb") as file:
        reader = make_reader(original)
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="test")
        for attachment in reader.iter_attachments():
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        seen = 0
        for schema, channel, record in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], dict(channel.metadata)
                )
            data = bytearray(record.data)
            if channel.topic == topic and data[DLC] == 8:
                seen += 1
                if seen == message:
                    data[byte] ^= 0x01
            writer.add_message(
                channels[channel.id], record.log_time, bytes(data), record.publish_time, record.sequence
            )
        writer.finish()


def test_lockstep_recording_verifies(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "--verify", str(recorded)]) == 0
    assert "identical" in capsys.readouterr().out


def test_lockstep_gives_the_same_bytes(recorded: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    assert main([*ARGUMENTS, "--record", str(again)]) == 0
    assert again.read_bytes() == recorded.read_bytes()


def test_rewritten_recording_still_verifies(recorded: Path, tmp_path: Path) -> None:
    """The reader depends on the format, not on our writer's chunks."""
    copy = tmp_path / "copy.mcap"
    copy_with_changed_byte(recorded, copy, "/can/tx", 0, 0)
    assert verify(Recording(copy)) == verify(Recording(recorded))


@pytest.mark.parametrize("message", [1, 100, 280])
@pytest.mark.parametrize("byte", range(-8, 0))
def test_one_changed_byte_is_found(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], message: int, byte: int
) -> None:
    changed = tmp_path / "changed.mcap"
    copy_with_changed_byte(recorded, changed, "/can/tx", message, byte)
    assert main(["replay", "--verify", str(changed)]) == 1
    told = capsys.readouterr().err
    assert "different" in told
    assert str(changed) in told
    assert "the core sends" in told


def test_changed_input_is_found(recorded: Path, tmp_path: Path) -> None:
    """One bit of one received sample: its CRC is wrong, so the core does not answer as it did."""
    changed = tmp_path / "changed.mcap"
    copy_with_changed_byte(recorded, changed, "/can/rx", 150, -7)
    assert main(["replay", "--verify", str(changed)]) == 1


def test_what_is_no_recording_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = tmp_path / "notes.txt"
    empty.write_text("hello")
    assert main(["replay", "--verify", str(empty)]) == 2
    assert "notes.txt: not an MCAP file" in capsys.readouterr().err
    assert main(["replay", "--verify", str(tmp_path / "none.mcap")]) == 2
