"""The conformance files of the MCAP project through the reader, the scanner, and the recovery."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.records import Attachment, Channel, Message, Metadata
from mcap.stream_reader import StreamReader
from support.mcap_variants import CONTENTS, Variant, file_of, variants

from hil.recording.handover import MESSAGE_HEADER, RECORD_HEADER
from hil.recording.mcap_reader import McapContents
from hil.recording.mcap_records import FileBytes
from hil.recording.mcap_scan import scan
from hil.recording.recover import recover

ALL = list(variants())


def messages_in(contents: McapContents) -> list[tuple[int, int, int, int, bytes]]:
    """Return channel, sequence, log time, publish time and data of each message, in file order."""
    found = []
    for body, offsets in contents.chunks():
        for channel, places in offsets.items():
            for place in places.tolist():
                prefix, sequence, log_time, publish_time = MESSAGE_HEADER.unpack_from(body, place)
                end = place + RECORD_HEADER.size + RECORD_HEADER.unpack(prefix[:9])[1]
                data = body[place + MESSAGE_HEADER.size : end]
                found.append((channel, sequence, log_time, publish_time, data))
    return found


def expected_messages(variant: Variant) -> list[tuple[int, int, int, int, bytes]]:
    return [
        (m.channel_id, m.sequence, m.log_time, m.publish_time, m.data)
        for m in variant.records
        if isinstance(m, Message)
    ]


def test_there_are_416_files() -> None:
    assert len(ALL) == len({str(variant) for variant in ALL}) == 416


@pytest.mark.parametrize("content", CONTENTS)
def test_every_file_is_read_right(tmp_path: Path, content: str) -> None:
    for variant in (v for v in ALL if v.content == content):
        path = tmp_path / f"{variant}.mcap"
        path.write_bytes(file_of(variant))
        contents = McapContents(path)
        records = variant.records
        assert contents.is_complete, variant
        assert sorted(messages_in(contents)) == sorted(expected_messages(variant)), variant
        assert contents.attachments == {r.name: r.data for r in records if isinstance(r, Attachment)}, variant
        assert contents.metadata == {r.name: r.metadata for r in records if isinstance(r, Metadata)}, variant
        assert list(contents.channels.values()) == [r for r in records if isinstance(r, Channel)], variant
        assert contents.counts == {"example": len(expected_messages(variant))} or not contents.channels


def test_every_file_is_walked_through_without_a_loss(tmp_path: Path) -> None:
    for variant in ALL:
        path = tmp_path / "file.mcap"
        path.write_bytes(file_of(variant))
        found = scan(FileBytes(path))
        assert found.losses == [], variant
        assert found.has_end, variant
        assert found.counts.total() == len(expected_messages(variant)), variant


def test_a_recovered_file_is_read_by_the_reader_of_the_project(tmp_path: Path) -> None:
    for variant in (v for v in ALL if v.content == "TenMessages"):
        path, output = tmp_path / f"{variant}.mcap", tmp_path / f"{variant}-new.mcap"
        path.write_bytes(file_of(variant))
        assert recover(path, output).lost == (), variant
        with output.open("rb") as stream:
            records = list(StreamReader(stream, validate_crcs=True).records)
        found = [
            (m.channel_id, m.sequence, m.log_time, m.publish_time, m.data)
            for m in records
            if isinstance(m, Message)
        ]
        assert found == expected_messages(variant), variant
