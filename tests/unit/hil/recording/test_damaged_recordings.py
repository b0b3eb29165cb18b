"""Recordings that were damaged, cut off, made to exhaust memory, or written by other programs."""

from __future__ import annotations

import random
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer
from support.mcap_files import chunk_starts, record_bytes, records, rewritten, without_crcs, without_end
from support.recorded_runs import RUN_HEADER, in_memory, record_periods, record_run, wait_until

from hil import run_experiment
from hil.core.errors import RecordingError
from hil.core.frames import Frame
from hil.recording.handover import RECORD_HEADER
from hil.recording.mcap_reader import McapContents
from hil.recording.metadata_digests import DIGEST_KIND
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder

PERIODS = 120


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recording") / "run.mcap"
    record_run(file, PERIODS)
    return file


@pytest.fixture(scope="module")
def recording(path: Path) -> Recording:
    return Recording(path)


class TestCutOffFiles:
    def test_a_record_length_beyond_the_file_is_no_end_when_chunks_follow(
        self, path: Path, tmp_path: Path
    ) -> None:
        """The flip sets the length of the second chunk to 2**40. It must not pass as the end of the file."""
        content = bytearray(without_end(path.read_bytes()))
        starts = chunk_starts(bytes(content))
        content[starts[1] + 6] ^= 1
        content[starts[1] + 60] ^= 1  # so that the chunk cannot prove itself by its own size either
        damaged = tmp_path / "damaged.mcap"
        damaged.write_bytes(content)
        follow = len(starts) - 2
        with pytest.raises(
            RecordingError,
            match=rf"do not lead to its end; {follow} chunks follow the damage; `hil recover {damaged}`",
        ):
            Recording(damaged)

    def test_a_chunk_whose_record_states_a_wrong_length_is_read_by_the_size_of_its_data(
        self, path: Path, recording: Recording, tmp_path: Path
    ) -> None:
        content = without_end(path.read_bytes())
        for start in chunk_starts(content):
            for place in (1, 2, 6):
                changed = bytearray(content)
                changed[start + place] ^= 1
                damaged = tmp_path / "damaged.mcap"
                damaged.write_bytes(changed)
                assert Recording(damaged).counts == recording.counts

    @pytest.mark.parametrize(
        "word", [b"setpoints", b"vertical", b"step:0.1@1", b"metadata digests", b"0.1.0", b"digests", b"part"]
    )
    def test_changed_metadata_are_noticed(self, path: Path, tmp_path: Path, word: bytes) -> None:
        content = without_end(path.read_bytes())
        place = content.rindex(word, 0, chunk_starts(content)[0])
        damaged = tmp_path / "damaged.mcap"
        damaged.write_bytes(content[:place] + b"X" + content[place + 1 :])
        with pytest.raises(
            RecordingError,
            match=r"damaged: metadata .* are missing or not as recorded",
        ):
            Recording(damaged)

    @pytest.mark.parametrize("word", [b"completed", b"reason", b"ending", b"digests of the end", b"1013"])
    def test_changed_metadata_at_the_end_are_noticed(self, path: Path, tmp_path: Path, word: bytes) -> None:
        """A file may be cut off after these metadata, before the CRC of its data."""
        content = _without_summary(path.read_bytes())
        damaged = tmp_path / "damaged.mcap"
        for place in _places(content, word, chunk_starts(content)[-1]):
            damaged.write_bytes(content[:place] + b"X" + content[place + 1 :])
            with pytest.raises(RecordingError, match=r"damaged: metadata .* are missing or not as recorded"):
                Recording(damaged)

    def test_metadata_at_the_end_may_be_cut_off(
        self, path: Path, recording: Recording, tmp_path: Path
    ) -> None:
        content = _without_summary(path.read_bytes())
        torn = tmp_path / "torn.mcap"
        starts = [start for opcode, start, _ in records(content) if opcode == Opcode.METADATA]
        for size in range(starts[-3], len(content)):
            torn.write_bytes(content[:size])
            opened = Recording(torn)
            assert not opened.complete
            assert ("ending" in opened.metadata) == (size >= starts[-1])
            assert opened.counts == recording.counts

    def test_a_recording_without_a_digest_of_its_metadata_is_read(self, path: Path, tmp_path: Path) -> None:
        """Recordings of pneumatic-hil 0.2 have none."""
        content = without_end(path.read_bytes())
        (_, start, _), (_, _, end) = [r for r in records(content) if r[0] == Opcode.METADATA][:2]
        own = Recording(path).metadata["recording"]
        own.pop(DIGEST_KIND)
        older = tmp_path / "older.mcap"
        older.write_bytes(content[:start] + metadata_record("recording", own) + content[end:])
        assert len(Recording(older).timing()) == PERIODS + 6

    def test_every_cut_of_the_last_chunk_gives_what_is_before_it(
        self, path: Path, recording: Recording, tmp_path: Path
    ) -> None:
        content = without_end(path.read_bytes())
        last = chunk_starts(content)[-1]
        counts = None
        for size in range(last, len(content), 29):
            torn = tmp_path / "torn.mcap"
            torn.write_bytes(content[:size])
            opened = Recording(torn)
            assert not opened.complete
            whole = opened.counts == recording.counts
            assert whole == (size >= records(content)[_index_after(content, last)][1])
            if not whole:
                counts = counts or opened.counts
                assert opened.counts == counts


def _without_summary(content: bytes) -> bytes:
    """Return a file up to the end of its data, without the record that has their CRC."""
    return content[: next(start for opcode, start, _ in records(content) if opcode == Opcode.DATA_END)]


def _places(content: bytes, word: bytes, start: int) -> list[int]:
    """Return where ``word`` stands in ``content`` from ``start`` on."""
    found = [start + match.start() for match in re.finditer(re.escape(word), content[start:])]
    assert found
    return found


def _index_after(content: bytes, chunk: int) -> int:
    return [start for _, start, _ in records(content)].index(chunk) + 1


def metadata_record(name: str, entries: dict[str, str]) -> bytes:
    def text(value: str) -> bytes:
        return len(value.encode()).to_bytes(4, "little") + value.encode()

    pairs = b"".join(text(key) + text(value) for key, value in entries.items())
    body = text(name) + len(pairs).to_bytes(4, "little") + pairs
    return RECORD_HEADER.pack(Opcode.METADATA, len(body)) + body


class TestSingleBitFlips:
    @pytest.mark.parametrize("is_cut", [False, True], ids=["whole file", "cut-off file"])
    def test_a_flip_gives_an_error_or_the_same_entries(
        self, tmp_path_factory: pytest.TempPathFactory, is_cut: bool
    ) -> None:
        folder = tmp_path_factory.mktemp("flips")
        file = folder / "run.mcap"
        record_run(file, 36)
        content = without_end(file.read_bytes()) if is_cut else file.read_bytes()
        file.write_bytes(content)
        whole = Recording(file)
        expected, metadata = list(whole.entries()), whole.metadata
        draw = random.Random(11)
        refused = 0
        for _ in range(1000):
            changed = bytearray(content)
            changed[draw.randrange(len(content))] ^= 1 << draw.randrange(8)
            file.write_bytes(changed)
            try:
                opened = Recording(file)
                found = list(opened.entries())
            except RecordingError:
                refused += 1
                continue
            assert is_cut, "the CRCs of a whole file cover all of it"
            assert (found, opened.metadata) == (expected, metadata)
        assert refused == 1000 if not is_cut else refused > 400


class TestMadeUpFiles:
    @pytest.mark.parametrize("part", ["schema", "channel"])
    def test_a_damaged_description_without_any_crc_is_an_error_of_the_product(
        self, path: Path, recording: Recording, tmp_path: Path, part: str
    ) -> None:
        """The first chunk is stored without compression and without a CRC, and its text is damaged."""
        content = without_crcs(path.read_bytes())
        start = chunk_starts(content)[0]
        end = next(end for _, begin, end in records(content) if begin == start)
        with path.open("rb") as stream:
            chunk = next(r for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, Chunk))
        body = zstandard.decompress(chunk.data, chunk.uncompressed_size)
        place = body.index(b"hil_msgs" if part == "schema" else b"/gateway/cycle")
        draw = random.Random(5)
        outcomes = set()
        for _ in range(150):
            changed = bytearray(body)
            changed[draw.randrange(0, place + 400)] = draw.randrange(256)
            chunk.data, chunk.compression, chunk.uncompressed_crc = bytes(changed), "", 0
            damaged = tmp_path / "damaged.mcap"
            damaged.write_bytes(content[:start] + record_bytes(chunk) + content[end:])
            outcomes.add(_read_everything(damaged))
        assert len(outcomes) == 2, "some damage is in comments alone, and some is an error"

    @pytest.mark.parametrize(
        ("definition", "words"),
        [
            (b"\xff\xfe", "the definition of its messages is damaged"),
            (b"uint8[99999999999] x\n", "messages of 100000000003 bytes, limit 1048576"),
            (b"what\n", "the definition of its messages cannot be read"),
            (b"uint8[] x\n", "a field of type uint8\\[\\] has no fixed size"),
            (b"A a\n" + b"=" * 80 + b"\nMSG: A\nA a\n", "the definition of its messages cannot be read"),
            (
                b"A1 a\n"
                + b"".join(b"=" * 80 + b"\nMSG: A%d\n" % n + b"A%d a\n" % (n + 1) * 9 for n in range(1, 40))
                + b"=" * 80
                + b"\nMSG: A40\n",
                "the definition of its messages cannot be read: more than 1000 fields",
            ),
        ],
        ids=["no text", "huge", "one word", "sequence", "itself", "exponential"],
    )
    def test_a_definition_that_is_none_is_refused(
        self, tmp_path: Path, definition: bytes, words: str
    ) -> None:
        path = tmp_path / "made.mcap"
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start("ros2")
            schema = writer.register_schema("hil_msgs/msg/Cycle", "ros2msg", definition)
            channel = writer.register_channel("/gateway/cycle", "cdr", schema)
            writer.add_message(channel, 0, b"\0\1\0\0", 0, sequence=1)
            writer.add_metadata("recording", {"format_version": "2", "epoch_offset_ns": "0", "bus": "vcan0"})
            writer.finish()
        recording = Recording(path)
        with pytest.raises(RecordingError, match=words):
            recording.timing()
        with pytest.raises(RecordingError, match=r"cannot be read|is damaged"):
            list(recording.entries())

    @pytest.mark.parametrize("compression", ["zstd", ""])
    def test_a_small_file_that_states_much_is_refused(self, tmp_path: Path, compression: str) -> None:
        """A megabyte of zeros compresses to 50 bytes. Chunks are read up to 1000 times their size."""
        size = 60 * 1024 * 1024
        data = zstandard.compress(bytes(size)) if compression else bytes(1000)
        chunk = Chunk(compression, data, 0, 0, 0, size)
        path = tmp_path / "small.mcap"
        path.write_bytes(MCAP0_MAGIC + record_bytes(chunk))
        assert path.stat().st_size < 61_000
        with pytest.raises(RecordingError, match=rf"states {size} bytes, limit"):
            McapContents(path)

    def test_a_frame_that_states_another_size_than_its_chunk_is_refused(self, tmp_path: Path) -> None:
        chunk = Chunk("zstd", zstandard.compress(bytes(1000)), 0, 0, 0, 999)
        path = tmp_path / "small.mcap"
        path.write_bytes(MCAP0_MAGIC + record_bytes(chunk))
        with pytest.raises(RecordingError, match="it has 1000 bytes and states 999"):
            McapContents(path)

    def test_a_file_that_looks_like_records_everywhere_is_refused_in_bounded_work(
        self, tmp_path: Path
    ) -> None:
        start = RECORD_HEADER.pack(Opcode.METADATA, 100_000)
        path = tmp_path / "nested.mcap"
        path.write_bytes(MCAP0_MAGIC + RECORD_HEADER.pack(0, 5) + start * 30_000)
        with pytest.raises(RecordingError, match="has the unknown kind 0"):
            McapContents(path)


def _read_everything(path: Path) -> str:
    """Return "read" or "refused"; any exception but the product's own fails the test."""
    try:
        recording = Recording(path)
        for axis in recording.axes:
            recording.axis(axis)
        recording.timing()
        recording.log()
        list(recording.entries())
    except RecordingError:
        return "refused"
    return "read"


class TestOtherWriters:
    @pytest.mark.parametrize(
        "options",
        [
            {"use_chunking": False},
            {"compression": CompressionType.LZ4},
            {"compression": CompressionType.NONE},
            {"index_types": IndexType.NONE},
            {"use_statistics": False},
            {"use_summary_offsets": False},
            {"enable_crcs": False},
            {"enable_data_crcs": True, "use_chunking": False},
            {"chunk_size": 4_000_000},
        ],
        ids=str,
    )
    def test_a_copy_by_another_writer_has_all_entries(
        self, path: Path, recording: Recording, tmp_path: Path, options: dict[str, object]
    ) -> None:
        copy = rewritten(path, tmp_path / "copy.mcap", options)
        opened = Recording(copy)
        assert opened.complete
        assert list(opened.entries()) == list(recording.entries())
        assert opened.counts == recording.counts
        assert opened.attachments == recording.attachments
        np.testing.assert_array_equal(opened.axis("vertical").position, recording.axis("vertical").position)

    def test_lz4_without_its_library_says_what_to_install(
        self, path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        copy = rewritten(path, tmp_path / "copy.mcap", {"compression": CompressionType.LZ4})
        monkeypatch.setitem(sys.modules, "lz4.frame", None)
        with pytest.raises(
            RecordingError, match="compressed with lz4, and the package lz4 is not installed: pip"
        ):
            Recording(copy)

    def test_an_unknown_compression_is_named(self, tmp_path: Path) -> None:
        path = tmp_path / "made.mcap"
        path.write_bytes(MCAP0_MAGIC + record_bytes(Chunk("brotli", b"abc", 0, 0, 0, 3)))
        with pytest.raises(RecordingError, match="compressed with 'brotli'; only zstd and lz4 can be read"):
            McapContents(path)

    def test_padding_at_the_end_of_every_record_is_skipped(
        self, path: Path, recording: Recording, tmp_path: Path
    ) -> None:
        content = path.read_bytes()
        padded = bytearray(MCAP0_MAGIC)
        for opcode, start, end in records(content):
            if opcode in (Opcode.SUMMARY_OFFSET, Opcode.CHUNK_INDEX, Opcode.ATTACHMENT_INDEX):
                continue
            body = content[start + RECORD_HEADER.size : end]
            if opcode == Opcode.DATA_END:
                body = bytes(4)
            if opcode == Opcode.FOOTER:
                body = bytes(20)
            padded += RECORD_HEADER.pack(opcode, len(body) + 3) + body + b"pad"
        other = tmp_path / "padded.mcap"
        other.write_bytes(padded + MCAP0_MAGIC)
        opened = Recording(other)
        assert opened.complete
        assert opened.attachments == recording.attachments
        assert list(opened.entries()) == list(recording.entries())

    def test_private_records_are_skipped(self, path: Path, recording: Recording, tmp_path: Path) -> None:
        content = without_end(path.read_bytes())
        start = chunk_starts(content)[0]
        other = tmp_path / "private.mcap"
        other.write_bytes(content[:start] + RECORD_HEADER.pack(0x90, 5) + b"mine!" + content[start:])
        assert Recording(other).counts == recording.counts

    def test_topics_that_another_program_removed_are_not_said_to_be_dropped(
        self, path: Path, tmp_path: Path
    ) -> None:
        copy = rewritten(path, tmp_path / "copy.mcap", {}, keep=lambda topic, _: topic != "/can/tx")
        with pytest.raises(RecordingError, match="removed by another program: the recorder has dropped none"):
            list(Recording(copy).entries())

    def test_an_end_that_another_program_removed_is_noticed(self, path: Path, tmp_path: Path) -> None:
        copy = rewritten(path, tmp_path / "copy.mcap", {}, keep=lambda _, sequence: sequence < 500)
        opened = Recording(copy)
        assert len(list(opened.entries())) == 499
        with pytest.raises(
            RecordingError, match=r"\d+ messages were removed by another program: the recorder"
        ):
            opened.check_count()
        Recording(path).check_count()


class TestWhatIsRecorded:
    def test_attachments_have_the_time_at_which_the_run_began(self, path: Path) -> None:
        with path.open("rb") as stream:
            times = {(a.log_time, a.create_time) for a in make_reader(stream).iter_attachments()}
        assert times == {(RUN_HEADER.epoch_offset_ns, RUN_HEADER.epoch_offset_ns)}

    def test_frames_in_simulated_time_are_stamped_with_epoch_time(self, tmp_path: Path) -> None:
        run = run_experiment(tmp_path / "run.mcap", duration_s=0.1)
        received = run.frames("received")
        assert len(received) > 10
        np.testing.assert_array_equal(received.stamp_ns, received.time_ns + run.epoch_offset_ns)
        with run.path.open("rb") as stream:
            times = {a.log_time for a in make_reader(stream).iter_attachments()}
        assert times == {run.epoch_offset_ns}

    def test_a_remote_frame_keeps_its_length(self, tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        with in_memory(path):
            recorder = Recorder(path, RUN_HEADER, lossless=True)
        frame = Frame(0x321, bytes(5), is_remote=True)
        recorder.frame_received(frame, 10, 20)
        recorder.close({})
        recording = Recording(path)
        assert [entry.frame for entry in recording.entries()] == [frame]
        assert recording.frames("received").length.tolist() == [5]
        assert str(frame) == "321#R5"
        assert str(Frame(0x321, is_remote=True)) == "321#R"

    def test_a_file_that_is_removed_during_the_run_is_a_failure(self, tmp_path: Path) -> None:
        folder = tmp_path / "runs"
        folder.mkdir()
        recorder = Recorder(folder / "run.mcap", RUN_HEADER, lossless=True)
        record_periods(recorder, 3)
        (folder / "run.mcap").unlink()
        folder.rmdir()
        report = recorder.close({})
        assert report.failure == "the file was removed or replaced while it was written"

    def test_a_further_file_that_is_removed_is_a_failure(self, tmp_path: Path) -> None:
        second = tmp_path / "second.mcap"
        recorder = Recorder(tmp_path / "first.mcap", RUN_HEADER, lossless=True)
        assert recorder.begin_file(second, {}, {}, ()) is None
        wait_until(second.exists, "the second file")
        second.unlink()
        assert recorder.close({}).failure == "the file was removed or replaced while it was written"

    def test_a_file_that_was_ended_may_be_moved(self, tmp_path: Path) -> None:
        path, second = tmp_path / "run.mcap", tmp_path / "second.mcap"
        recorder = Recorder(path, RUN_HEADER, lossless=True)
        record_periods(recorder, 3)
        recorder.stop({})
        assert recorder.begin_file(second, {}, {}, ()) is None
        wait_until(second.exists, "the second file, before which the first one ends")
        path.rename(tmp_path / "moved.mcap")
        assert recorder.close({}).failure is None
