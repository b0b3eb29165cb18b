"""Recovery: what is whole is saved, what is lost is counted, and nothing is overwritten."""

from __future__ import annotations

import random
from dataclasses import fields
from pathlib import Path

import msgspec
import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC
from support.mcap_files import chunk_starts, records, rewritten, without_end
from support.recorded_runs import PERIOD_NS, RUN_HEADER, record_run
from support.shipped_rig import RIG_TEXT

import hil.cli.recover as command
from hil.core.errors import RecordingError, RecordingExistsError
from hil.recording.metadata_digests import END_DIGESTS
from hil.recording.reader import Recording
from hil.recording.recover import recover
from hil.recording.tables import AxisTable

PERIODS = 160


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recording") / "run.mcap"
    rig = {"rig.toml": ("application/toml", RIG_TEXT.encode())}
    record_run(file, PERIODS, header=msgspec.structs.replace(RUN_HEADER, attachments=rig))
    return file


@pytest.fixture(scope="module")
def recording(path: Path) -> Recording:
    return Recording(path)


def saved(content: bytes, tmp_path: Path) -> tuple[Recording, command.Recovery]:
    """Recover a file with ``content``, and return the new recording."""
    damaged, output = tmp_path / "damaged.mcap", tmp_path / "saved.mcap"
    damaged.write_bytes(content)
    output.unlink(missing_ok=True)
    result = recover(damaged, output)
    assert damaged.read_bytes() == content, "the file itself is not changed"
    return Recording(output), result


def test_a_cut_off_file_becomes_an_indexed_one(path: Path, recording: Recording, tmp_path: Path) -> None:
    new, result = saved(without_end(path.read_bytes()), tmp_path)
    assert list(new.entries()) == list(recording.entries())
    assert (result.lost, result.was_complete, result.rebuilt_channels) == ((), False, False)
    assert not new.complete, "the end of the run is unknown"
    assert new.attachments == recording.attachments
    assert new.metadata["recovery"]["bytes lost"] == "0"
    with new.path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert len(list(reader.iter_messages())) == result.messages == sum(recording.counts.values())
        summary = reader.get_summary()
        assert summary is not None and len(summary.chunk_indexes) == len(chunk_starts(path.read_bytes()))


def test_a_whole_file_is_copied(path: Path, recording: Recording, tmp_path: Path) -> None:
    new, result = saved(path.read_bytes(), tmp_path)
    assert new.complete
    assert list(new.entries()) == list(recording.entries())
    assert result.lost == ()
    assert result.was_complete


def test_a_damaged_chunk_is_lost_with_its_messages_and_its_time(
    path: Path, recording: Recording, tmp_path: Path
) -> None:
    content = bytearray(path.read_bytes())
    start, following = chunk_starts(bytes(content))[1:3]
    content[start + 200] ^= 1
    new, result = saved(bytes(content), tmp_path)
    (lost,) = result.lost
    assert (lost.start, lost.size) == (start, following - start)
    assert lost.messages == sum(recording.counts.values()) - result.messages > 100
    assert lost.duration_ms == pytest.approx(lost.messages / 8 * PERIOD_NS / 1e6, abs=2 * PERIOD_NS / 1e6)
    with pytest.raises(RecordingError, match=rf"^{new.path}: {lost.messages} messages before \d+ ns were lo"):
        list(new.entries())
    assert new.metadata["recovery"]["messages lost"] == str(lost.messages)


def test_without_the_first_chunk_the_channels_are_those_of_the_rig_file(
    path: Path, recording: Recording, tmp_path: Path
) -> None:
    """The first chunk describes the channels; a file that was cut off has no summary that does."""
    content = bytearray(without_end(path.read_bytes()))
    content[chunk_starts(bytes(content))[0] + 200] ^= 1
    new, result = saved(bytes(content), tmp_path)
    assert result.rebuilt_channels
    assert new.axes == recording.axes
    vertical = new.axis("vertical")
    whole = recording.axis("vertical")
    for field in fields(AxisTable):
        if field.name in vertical.columns and field.name != "time_s":
            assert (vertical[field.name] == whole[field.name][-len(vertical) :]).all()


def test_without_channels_and_rig_file_nothing_is_usable(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    record_run(file, PERIODS)
    content = bytearray(without_end(file.read_bytes()))
    content[chunk_starts(bytes(content))[0] + 200] ^= 1
    with pytest.raises(RecordingError, match="descriptions of its channels are lost, and its rig file too"):
        saved(bytes(content), tmp_path)


def test_damage_before_the_first_chunk_loses_no_message(
    path: Path, recording: Recording, tmp_path: Path
) -> None:
    content = bytearray(path.read_bytes())
    content[4] ^= 1  # the magic bytes
    (place,) = [start for opcode, start, _ in records(bytes(content)) if opcode == Opcode.ATTACHMENT]
    content[place + 3] ^= 1  # the length of the attachment
    new, result = saved(bytes(content), tmp_path)
    assert new.counts == recording.counts
    assert new.metadata.keys() > recording.metadata.keys() - {END_DIGESTS}
    assert new.attachments == {}
    assert [part.messages for part in result.lost] == [0]


def test_without_its_own_metadata_clock_and_bus_are_those_of_the_messages(
    path: Path, recording: Recording, tmp_path: Path
) -> None:
    content = bytearray(path.read_bytes())
    for word in (b"epoch_offset_ns", b"format_version"):
        content[content.index(word) + 3] ^= 1
    new, result = saved(bytes(content), tmp_path)
    assert result.restored_metadata
    assert (new.epoch_offset_ns, new.bus) == (recording.epoch_offset_ns, recording.bus)
    assert list(new.entries()) == list(recording.entries())


def test_without_metadata_and_deadlines_nothing_is_restored(path: Path, tmp_path: Path) -> None:
    copy = rewritten(path, tmp_path / "copy.mcap", {}, keep=lambda topic, _: topic != "/gateway/deadline")
    content = copy.read_bytes()
    with pytest.raises(RecordingError, match=r"metadata recording\.epoch_offset_ns is missing"):
        saved(content.replace(b"epoch_offset_ns", b"epoch_offset_nz", 1), tmp_path)


@pytest.mark.parametrize("is_cut", [False, True])
def test_changed_metadata_are_reported(path: Path, tmp_path: Path, is_cut: bool) -> None:
    content = without_end(path.read_bytes()) if is_cut else path.read_bytes()
    place = content.rindex(b"step:0.1@1", 0, chunk_starts(content)[0])
    new, result = saved(content[:place] + b"S" + content[place + 1 :], tmp_path)
    assert [part.reason for part in result.lost] == [
        "metadata setpoints: not as recorded, or missing, by their SHA-256"
    ]
    assert new.metadata["recovery"]["damaged metadata"] == result.lost[0].reason


def test_a_damaged_summary_is_no_loss(path: Path, recording: Recording, tmp_path: Path) -> None:
    content = path.read_bytes()
    new, result = saved(content[:-100] + bytes(100), tmp_path)
    assert result.lost == ()
    (end,) = (end for opcode, _, end in records(content) if opcode == Opcode.DATA_END)
    assert result.repaired == (f"the summary or the footer, from byte {end} on",)
    assert list(new.entries()) == list(recording.entries())


def test_damage_without_a_loss_is_named(path: Path, recording: Recording, tmp_path: Path) -> None:
    content = path.read_bytes()
    chunk = chunk_starts(content)[1]
    found = {opcode: start for opcode, start, _ in reversed(records(content))}
    index = next(start for _, start, _ in records(content) if start > chunk)
    data_end, summary = found[Opcode.DATA_END], found[Opcode.STATISTICS]
    for place, words in (
        (2, "the magic bytes at the begin of the file"),
        (chunk + 6, f"the length of the chunk at byte {chunk}"),
        (index + 40, f"the message index of the chunk at byte {chunk}"),
        (found[Opcode.HEADER] + 20, f"a record's header or padding before byte {data_end}, or the CRC"),
        (data_end + 10, f"a record's header or padding before byte {data_end}, or the CRC"),
        (summary + 12, f"the summary from byte {data_end + 13} on, or its CRC"),
    ):
        changed = bytearray(content)
        changed[place] ^= 1
        new, result = saved(bytes(changed), tmp_path)
        assert result.lost == ()
        (repaired,) = result.repaired
        assert repaired.startswith(words)
        assert list(new.entries()) == list(recording.entries())


def test_many_damaged_indexes_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    record_run(file, 1500)
    content = bytearray(file.read_bytes())
    starts = chunk_starts(bytes(content))
    assert len(starts) > 22
    for opcode, start, _ in records(bytes(content)):
        if opcode == Opcode.MESSAGE_INDEX:
            content[start + 20] ^= 1
    _, result = saved(bytes(content), tmp_path)
    assert len(result.repaired) == 21
    assert result.repaired[-1] == f"{len(starts) - 20} more lengths or message indexes"


def test_a_zero_filled_end_is_lost(path: Path, tmp_path: Path) -> None:
    """A file system may fill blocks with zeros that it had not written at a power failure."""
    content = path.read_bytes()
    start = chunk_starts(content)[-1]
    new, result = saved(content[: start + 300] + bytes(4096), tmp_path)
    (lost,) = result.lost
    assert (lost.start, lost.messages) == (start, None)
    assert new.metadata["recovery"]["messages lost"] == "0 or more"
    assert len(new.timing()) > 80


def test_messages_outside_chunks_are_saved(path: Path, recording: Recording, tmp_path: Path) -> None:
    copy = rewritten(path, tmp_path / "copy.mcap", {"use_chunking": False})
    new, _ = saved(copy.read_bytes()[:-3000], tmp_path)
    found, expected = list(new.entries()), list(recording.entries())
    assert found == expected[: len(found)]
    assert len(found) > 0.8 * len(expected)


def test_every_cut_of_the_last_two_chunks_loses_them_and_no_more(
    path: Path, recording: Recording, tmp_path: Path
) -> None:
    content = without_end(path.read_bytes())
    first = chunk_starts(content)[-2]
    whole = list(recording.entries())
    before = len(list(saved(content[:first], tmp_path)[0].entries()))
    for size in range(first, len(content), 13):
        new, result = saved(content[:size], tmp_path)
        assert before <= result.messages <= len(whole)
        assert sum(part.size for part in result.lost) < len(content) - first
        assert sum(new.counts.values()) == result.messages


def test_single_bit_flips_lose_one_chunk_at_most(path: Path, recording: Recording, tmp_path: Path) -> None:
    content = path.read_bytes()
    total = sum(recording.counts.values())
    largest = total // 2
    draw = random.Random(3)
    for _ in range(150):
        changed = bytearray(content)
        place = draw.randrange(len(content))
        changed[place] ^= 1 << draw.randrange(8)
        new, result = saved(bytes(changed), tmp_path)
        assert result.lost or result.repaired, "what was damaged is named"
        known = sum(part.messages or 0 for part in result.lost)
        at_end = any(part.messages is None for part in result.lost)
        assert result.messages + known == total or (at_end and result.messages > largest)
        assert sum(new.counts.values()) == result.messages


def test_a_channel_with_a_wrong_number_in_the_summary_is_left_out(
    path: Path, recording: Recording, tmp_path: Path
) -> None:
    content = bytearray(path.read_bytes())
    topic = content.rindex(b"/can/refused")
    assert content[topic - 8] == 3  # number of the channel, before the schema and the length of the topic
    content[topic - 8] = 35
    new, result = saved(bytes(content), tmp_path)
    assert result.repaired
    assert new.counts == recording.counts
    assert list(new.entries()) == list(recording.entries())


def test_a_schema_with_a_wrong_number_in_the_summary_is_left_out(path: Path, tmp_path: Path) -> None:
    content = bytearray(path.read_bytes())
    name = content.rindex(b"hil_msgs/msg/Cycle")
    assert content[name - 6] == 3  # number of the schema, before the length of its name
    content[name - 6] = 35
    new, _ = saved(bytes(content), tmp_path)
    with new.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert sorted(summary.schemas) == [1, 2, 3, 4, 5, 6]


def test_channels_that_only_the_summary_describes_are_saved(path: Path, tmp_path: Path) -> None:
    """The first chunk, which describes them too, is lost; some of them have no message after it."""
    content = bytearray(path.read_bytes())
    content[chunk_starts(content)[0] + 60] ^= 1
    new, result = saved(bytes(content), tmp_path)
    assert len(result.lost) == 1
    assert set(new.counts) == set(Recording(path).counts)


def test_an_existing_file_is_not_overwritten(path: Path, tmp_path: Path) -> None:
    output = tmp_path / "there.mcap"
    output.write_text("mine")
    with pytest.raises(RecordingExistsError, match=r"there\.mcap: exists already; choose another name"):
        recover(path, output)
    assert output.read_text() == "mine"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            b"no recording",
            "nothing can be saved: it is not an MCAP file, and no chunk with a matching CRC is in it",
        ),
        (MCAP0_MAGIC, "was cut off before its first period: it holds no data"),
        (b"", "was cut off before its first period: it holds no data"),
    ],
    ids=["text", "magic alone", "empty"],
)
def test_a_file_without_messages_gives_no_new_file(tmp_path: Path, content: bytes, words: str) -> None:
    with pytest.raises(RecordingError, match=rf"damaged\.mcap: {words}"):
        saved(content, tmp_path)
    assert not (tmp_path / "saved.mcap").exists()


def test_damage_before_the_first_message_is_not_taken_for_a_cut(path: Path, tmp_path: Path) -> None:
    content = path.read_bytes()
    first, second = chunk_starts(content)[:2]
    damaged = bytearray(content[:second])
    damaged[first + 200] ^= 1
    with pytest.raises(RecordingError, match="nothing can be saved: no message in it is whole"):
        saved(bytes(damaged), tmp_path)


def test_a_file_that_cannot_be_written_is_removed(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("hil.recording.recover.IndexedFile.add_chunk", fail)
    output = tmp_path / "new.mcap"
    with pytest.raises(RecordingError, match=r"new\.mcap: cannot be written: No space left on device"):
        recover(path, output)
    assert not output.exists()
    with pytest.raises(RecordingError, match="cannot be created: No such file"):
        recover(path, tmp_path / "absent" / "new.mcap")


class TestCommand:
    def test_a_whole_file(self, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        source = tmp_path / "run 1.mcap"
        source.write_bytes(path.read_bytes())
        assert command.main([str(source)]) == 0
        out = capsys.readouterr().out
        assert f"saved      {tmp_path}/run 1-recovered.mcap: 1333 messages, 1." in out
        assert "lost       nothing: all data in the file are whole\n" in out
        assert f"next       hil replay '{tmp_path}/run 1-recovered.mcap'\n" in out
        assert "repaired" not in out

    def test_a_file_with_damage_that_costs_nothing(
        self, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        source = tmp_path / "run.mcap"
        source.write_bytes(b"x" + path.read_bytes()[1:])
        assert command.main([str(source)]) == 0
        out = capsys.readouterr().out
        assert "lost       nothing: every message, attachment and metadata record is whole\n" in out
        assert "repaired   the magic bytes at the begin of the file\n" in out

    def test_a_damaged_and_cut_off_file(
        self, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        content = bytearray(without_end(path.read_bytes())[:-1000])
        for start in chunk_starts(bytes(content))[:2]:
            content[start + 200] ^= 1
        source = tmp_path / "run.mcap"
        source.write_bytes(content)
        assert command.main([str(source), "-o", str(tmp_path / "new.mcap")]) == 1
        out = capsys.readouterr().out
        assert "messages, between the begin and 0.000 s: the chunk at byte" in out
        assert "an unknown number of messages, between " in out
        assert "the file was cut off\n" in out
        assert "or more messages lost\n" in out
        assert "note       the recording was not ended: its end is missing" in out
        assert "they are those of the rig file\n" in out

    def test_nothing_usable(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        source = tmp_path / "run.mcap"
        source.write_text("nothing")
        assert command.main([str(source)]) == 2
        assert capsys.readouterr().err.startswith(f"hil recover: {source}: nothing can be saved: ")
