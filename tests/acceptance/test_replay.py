"""Replay: the core answers as recorded; a changed byte, signal, log entry or document is found."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from support.mcap_files import records

from hil.cli import main
from hil.core.errors import RecordingError
from hil.recording.reader import Recording
from hil.recording.schemas import AXIS_SIGNALS, CYCLE, layout_of
from hil.shells.replay import verify

DLC = -9
"""Offset of the data length in can_msgs/msg/Frame, from its end; eight bytes of data follow."""
ARGUMENTS = ["run", "--lockstep", "--duration", "3"]
SHORT = ["run", "--lockstep", "--linear", "--duration", "0.1", "--setpoint", "rotation=csv:table.csv"]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    assert main([*ARGUMENTS, "--record", str(path)]) == 0
    return path


class Message(NamedTuple):
    topic: str
    data: bytearray


def rewritten(
    source: Path,
    target: Path,
    change: Callable[[Message], None] = lambda _message: None,
    attachments: Callable[[str, bytes], bytes] = lambda _name, data: data,
    metadata: Callable[[str, dict[str, str]], dict[str, str]] = lambda _name, entries: entries,
    until: Callable[[Message], bool] = lambda _message: False,
) -> Path:
    """Copy a recording with the reader and writer of mcap, and change its parts; every CRC is right."""
    with source.open("rb") as original, target.open("wb") as file:
        reader = make_reader(original)
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="test")
        for attachment in reader.iter_attachments():
            data = attachments(attachment.name, attachment.data)
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, data)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, metadata(record.name, record.metadata))
        schemas: dict[int, int] = {}
        channels: dict[int, int] = {}
        for schema, channel, record in reader.iter_messages(log_time_order=False):
            assert schema is not None
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schemas[schema.id], dict(channel.metadata)
                )
            message = Message(channel.topic, bytearray(record.data))
            if until(message):
                break
            change(message)
            writer.add_message(
                channels[channel.id],
                record.log_time,
                bytes(message.data),
                record.publish_time,
                record.sequence,
            )
        writer.finish()
    return target


def nth(topic: str, number: int, change: Callable[[bytearray], None]) -> Callable[[Message], None]:
    """Return a function that changes the n-th message of a topic, counted from 1. Frames: of eight bytes."""
    seen = Counter[str]()

    def at(message: Message) -> None:
        if message.topic == topic and (not topic.startswith("/can/") or message.data[DLC] == 8):
            seen[topic] += 1
            if seen[topic] == number:
                change(message.data)

    return at


def flip(byte: int) -> Callable[[bytearray], None]:
    def change(data: bytearray) -> None:
        data[byte] ^= 0x01

    return change


def test_lockstep_recording_verifies(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "--verify", str(recorded)]) == 0
    assert "identical" in capsys.readouterr().out


def test_lockstep_gives_the_same_bytes(recorded: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    assert main([*ARGUMENTS, "--record", str(again)]) == 0
    assert again.read_bytes() == recorded.read_bytes()


def test_rewritten_recording_still_verifies(recorded: Path, tmp_path: Path) -> None:
    """The reader depends on the format, not on our writer's chunks."""
    copy = rewritten(recorded, tmp_path / "copy.mcap")
    report = verify(Recording(copy))
    assert report == verify(Recording(recorded))
    assert report.log_entries_compared == len(Recording(recorded).log())
    assert report.periods_compared == len(Recording(recorded).timing())


@pytest.mark.parametrize("message", [1, 100, 280])
@pytest.mark.parametrize("byte", range(-8, 0))
def test_one_changed_byte_is_found(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], message: int, byte: int
) -> None:
    changed = rewritten(recorded, tmp_path / "changed.mcap", nth("/can/tx", message, flip(byte)))
    assert main(["replay", "--verify", str(changed)]) == 1
    error = capsys.readouterr().err
    assert "different" in error
    assert str(changed) in error
    assert "the core sends" in error


def test_changed_input_is_found(recorded: Path, tmp_path: Path) -> None:
    """One bit of one received sample: its CRC is wrong, so the core does not answer as it did."""
    changed = rewritten(recorded, tmp_path / "changed.mcap", nth("/can/rx", 150, flip(-7)))
    assert main(["replay", "--verify", str(changed)]) == 1


AXIS_FIELDS = [
    field for field in layout_of(AXIS_SIGNALS.definition, "").fields if field.name not in ("header.frame_id",)
]
CYCLE_FIELDS = [
    field for field in layout_of(CYCLE.definition, "").fields if field.name not in ("computed_ns", "sent_ns")
]
"""All fields but those of the shell: when the core had answered, and when the link had taken it."""


@pytest.mark.parametrize("field", AXIS_FIELDS, ids=lambda field: field.name)
def test_a_changed_signal_is_found(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], field: NamedTuple
) -> None:
    name, code, offset = field

    def change(data: bytearray) -> None:
        (value,) = struct.unpack_from("<" + code, data, offset)
        struct.pack_into("<" + code, data, offset, value + 1e-7 if code == "d" else 1 - value % 2)

    changed = rewritten(recorded, tmp_path / "changed.mcap", nth("/axis/rotation", 200, change))
    assert main(["replay", "--verify", str(changed)]) == 1
    error = capsys.readouterr().err
    assert "recorded rotation " + ("stamp_ns" if name.startswith("header") else name) in error
    assert "the core gives rotation" in error


@pytest.mark.parametrize("field", CYCLE_FIELDS, ids=lambda field: field.name)
def test_a_changed_period_is_found(recorded: Path, tmp_path: Path, field: NamedTuple) -> None:
    _, _, offset = field
    changed = rewritten(recorded, tmp_path / "changed.mcap", nth("/gateway/cycle", 200, flip(offset)))
    assert main(["replay", "--verify", str(changed)]) == 1


def test_the_last_bit_of_a_sampled_position_is_compared_and_that_of_a_law_is_not(
    recorded: Path, tmp_path: Path
) -> None:
    """Machines may round a law differently, but they scale a sample in the same way."""
    places = {name: offset for name, _, offset in AXIS_FIELDS}
    for name, status in (("position", 1), ("potentiometer_v", 1), ("output_v", 0), ("setpoint", 0)):
        change = nth("/axis/vertical", 200, flip(places[name]))
        changed = rewritten(recorded, tmp_path / f"{name}.mcap", change)
        assert main(["replay", "--verify", str(changed)]) == status, name


@pytest.mark.parametrize("part", ["level", "name", "text"])
def test_a_changed_log_entry_is_found(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], part: str
) -> None:
    def change(message: Message) -> None:
        if message.topic == "/gateway/log" and b"armed -> running" in message.data:
            place = {"level": 12, "name": 21, "text": message.data.index(b"running")}[part]
            message.data[place] ^= 20 ^ 30 if part == "level" else 0x01

    changed = rewritten(recorded, tmp_path / "changed.mcap", change)
    assert main(["replay", "--verify", str(changed)]) == 1
    assert "the core gives info life cycle: armed -> running (start)" in capsys.readouterr().err


def test_a_recorded_deadline_that_is_not_the_cores_is_found(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = rewritten(recorded, tmp_path / "changed.mcap", nth("/gateway/deadline", 100, flip(4)))
    assert main(["replay", "--verify", str(changed)]) == 1
    assert "recorded deadline" in capsys.readouterr().err


def test_a_changed_command_of_the_operator_is_found(recorded: Path, tmp_path: Path) -> None:
    """Text of the same length: start in place of reset."""

    def change(data: bytearray) -> None:
        data[8:13] = b"reset"

    changed = rewritten(recorded, tmp_path / "changed.mcap", nth("/gateway/operator", 2, change))
    assert main(["replay", "--verify", str(changed)]) == 1


def test_an_unknown_command_of_the_operator_is_refused(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = rewritten(recorded, tmp_path / "changed.mcap", nth("/gateway/operator", 1, flip(8)))
    assert main(["replay", "--verify", str(changed)]) == 2
    assert "cannot be read: '`rm' is not a command of the operator" in capsys.readouterr().err


def test_a_recording_that_ends_within_an_answer_of_the_core_is_different(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last command and everything after it is missing; no gap in the sequence shows it."""
    seen = Counter[str]()

    def until(message: Message) -> bool:
        seen[message.topic] += 1
        return message.topic == "/can/tx" and seen["/can/tx"] == 400

    changed = rewritten(recorded, tmp_path / "changed.mcap", until=until)
    assert main(["replay", "--verify", str(changed)]) == 1
    assert "after the last message: recorded nothing, the core sends" in capsys.readouterr().err


def test_a_recording_without_a_period_is_refused(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    changed = rewritten(
        recorded, tmp_path / "changed.mcap", until=lambda message: message.topic == "/gateway/deadline"
    )
    assert main(["replay", "--verify", str(changed)]) == 2
    error = capsys.readouterr().err
    assert "changed.mcap: has no period, so there is nothing to replay; its messages are " in error
    assert "on /gateway/log; the run ended by: completed" in error


@pytest.mark.parametrize(("place", "value"), [(12, 99), (20, 0xFF)])
def test_a_message_that_cannot_be_read_is_refused(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], place: int, value: int
) -> None:
    """A severity that does not exist; a name that is not UTF-8."""

    def change(data: bytearray) -> None:
        data[place] = value

    changed = rewritten(recorded, tmp_path / "changed.mcap", nth("/gateway/log", 2, change))
    assert main(["replay", "--verify", str(changed)]) == 2
    error = capsys.readouterr().err
    assert f"refused    {changed}: message " in error
    assert "cannot be read" in error


# The documents


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small recording with every kind of record and of document."""
    folder = tmp_path_factory.mktemp("short")
    (folder / "table.csv").write_text("time_s,setpoint\n0,0\n0.05,0.1\n")
    path = folder / "run.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main([*SHORT, "--record", str(path)]) == 0
    return path


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("rig.toml", b"max_rate_v_s = 400.0", b"max_rate_v_s = 401.0"),
        ("arm.dbc", b"VERSION", b"VERSIOM"),
        ("controllers/vertical.json", b'"kp"', b'"kq"'),
        ("controllers/horizontal.json", b"}", b"\xff"),
        ("setpoints/rotation.csv", b"0.05,0.1", b"0.05,0.2"),
    ],
)
def test_a_changed_document_is_refused_and_named(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, before: bytes, after: bytes
) -> None:
    """The CRC is right, and some of these changes would not show in the replay."""

    def change(attachment: str, data: bytes) -> bytes:
        assert attachment != name or before in data
        return data.replace(before, after, 1) if attachment == name else data

    changed = rewritten(short, tmp_path / "changed.mcap", attachments=change)
    assert main(["replay", "--verify", str(changed)]) == 2
    error = capsys.readouterr().err
    assert str(changed) in error
    assert f"the attachment {name} was changed" in error


def test_a_missing_document_is_named(short: Path, tmp_path: Path) -> None:
    def rename(_name: str, entries: dict[str, str]) -> dict[str, str]:
        return {key.replace("arm.dbc", "leg.dbc"): value for key, value in entries.items()}

    with pytest.raises(RecordingError, match=r"the attachment leg\.dbc is missing"):
        verify(Recording(rewritten(short, tmp_path / "changed.mcap", metadata=rename)))


def test_a_changed_setpoint_is_refused(short: Path, tmp_path: Path) -> None:
    """The step lies after the end of the recording, so that no signal differs."""

    def change(name: str, entries: dict[str, str]) -> dict[str, str]:
        return entries | {"vertical": "step:0.1@9"} if name == "setpoints" else entries

    with pytest.raises(RecordingError, match=r"metadata run\.configuration sha256"):
        verify(Recording(rewritten(short, tmp_path / "changed.mcap", metadata=change)))


def test_every_changed_byte_of_a_file_is_found(short: Path, tmp_path: Path) -> None:
    """CRCs cover every byte of every record except themselves."""
    content = short.read_bytes()
    kinds = kinds_of_records(content)
    changed = tmp_path / "changed.mcap"
    found: Counter[str] = Counter()
    for place in range(0, len(content), 3):
        bit = 1 << place % 8
        changed.write_bytes(content[:place] + bytes([content[place] ^ bit]) + content[place + 1 :])
        with pytest.raises(RecordingError, match=str(changed)):
            verify(Recording(changed))
            pytest.fail(f"byte {place} ({kinds[place]}), bit {bit}")
        found[kinds[place]] += 1
    assert found.keys() == set(kinds)


def kinds_of_records(content: bytes | bytearray) -> list[str]:
    """Return the kind of record of each byte of a file."""
    kinds = ["magic"] * len(MCAP0_MAGIC)
    while len(kinds) < len(content) - len(MCAP0_MAGIC):
        opcode, length = struct.unpack_from("<BQ", content, len(kinds))
        name = Opcode(opcode).name
        kinds += [f"{name} head"] * 9 + [name] * length
    return kinds + ["magic"] * len(MCAP0_MAGIC)


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("ATTACHMENT", "the attachment rig.toml is damaged"),
        ("CHUNK", "the chunk at byte"),
        ("METADATA", "damaged: the metadata at byte"),
        ("MESSAGE_INDEX", "damaged: the CRC of bytes 0 to"),
        ("STATISTICS", "damaged: the CRC of bytes"),
        ("FOOTER", "damaged: the CRC of bytes"),
        ("DATA_END head", "its records do not lead to its end"),
        ("CHUNK head", "damaged"),
    ],
)
def test_damage_is_described(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, words: str
) -> None:
    content = bytearray(short.read_bytes())
    place = kinds_of_records(content).index(kind)
    place += {"ATTACHMENT": 500, "CHUNK": 300, "METADATA": 30, "MESSAGE_INDEX": 20}.get(kind, 3)
    content[place] ^= 0x04
    changed = tmp_path / "changed.mcap"
    changed.write_bytes(content)
    assert main(["replay", "--verify", str(changed)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"refused    {changed}: ")
    assert words in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("cut", [0.5, 0.9, -1, -7, -8, -9, -30])
def test_a_file_that_was_cut_off_is_verified_up_to_its_end(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], cut: float
) -> None:
    content = recorded.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(content[: int(cut * len(content)) if cut > 0 else int(cut)])
    assert main(["replay", "--verify", str(torn)]) == 0
    assert "the recording was cut off, and was verified up to its end" in capsys.readouterr().out


@pytest.mark.parametrize(
    "cut",
    [
        "empty",
        "in the magic bytes",
        "after the header",
        "in an attachment",
        "after the attachments",
        "after the first metadata",
        "in the last metadata",
        "in the first chunk",
    ],
)
def test_a_file_that_was_cut_off_before_its_first_period_holds_no_data(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], cut: str
) -> None:
    content = short.read_bytes()
    parts = records(content)
    attachments, metadata, chunks = (
        [(start, end) for found, start, end in parts if found == kind]
        for kind in (Opcode.ATTACHMENT, Opcode.METADATA, Opcode.CHUNK)
    )
    size = {
        "empty": 0,
        "in the magic bytes": 3,
        "after the header": parts[0][2],
        "in an attachment": sum(attachments[1]) // 2,
        "after the attachments": attachments[-1][1],
        "after the first metadata": metadata[0][1],
        "in the last metadata": [end for _, end in metadata if end <= chunks[0][0]][-1] - 5,
        "in the first chunk": sum(chunks[0]) // 2,
    }[cut]
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(content[:size])
    for command in (["replay", "--verify"], ["recover"], ["report"], ["export", "--to", "csv"], ["compare"]):
        given = [*command, str(torn), *([str(short)] if command == ["compare"] else [])]
        assert main(given) == 2, given
        error = capsys.readouterr().err
        assert f"{torn}: was cut off before its first period: it holds no data. If its" in error, given
        assert error.count("\n") == 1, given
    assert [path.name for path in tmp_path.iterdir()] == ["torn.mcap"]


@pytest.mark.parametrize(("kind", "place"), [("ATTACHMENT", 700), ("CHUNK", 900)])
def test_damage_in_a_file_that_was_cut_off_is_found(
    recorded: Path, tmp_path: Path, kind: str, place: int
) -> None:
    content = bytearray(recorded.read_bytes())
    content[kinds_of_records(content).index(kind) + place] ^= 0x10
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(content[:-100])
    with pytest.raises(RecordingError, match=f"the {kind.lower()} .* is damaged"):
        verify(Recording(torn))


def test_one_bad_file_does_not_hide_the_next(
    short: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", "--verify", str(tmp_path / "none.mcap"), str(short)]) == 2
    output = capsys.readouterr()
    assert "none.mcap: cannot be read: No such file" in output.err
    assert "identical" in output.out


def test_a_file_that_is_not_a_recording_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "notes.txt"
    empty.write_text("hello")
    assert main(["replay", "--verify", str(empty)]) == 2
    assert "notes.txt: not an MCAP file" in capsys.readouterr().err
    assert main(["replay", "--verify", str(tmp_path / "none.mcap")]) == 2
