"""The recorder and its process: the contents of the file, and failures."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

import msgspec
import pytest
from support.recorded_runs import (
    EPOCH_OFFSET_NS,
    PERIOD_NS,
    RUN_HEADER,
    START_NS,
    SYNC,
    children_of,
    in_memory,
    record_periods,
    wait_until,
)

from hil.core.errors import RecordingError
from hil.core.frames import Frame
from hil.core.life_cycle import Trigger
from hil.core.output import LogEntry, Severity
from hil.recording import pipe
from hil.recording.entries import (
    DeadlineCalled,
    FrameReceived,
    FrameRefused,
    FrameSent,
    LinkFailed,
    Logged,
    Operated,
)
from hil.recording.handover import Progress
from hil.recording.metadata_digests import digest
from hil.recording.reader import Recording
from hil.recording.recorder import BATCH_BYTES, Recorder, RecorderReport

UNUSED_TOPICS = ("/gateway/log", "/gateway/operator", "/gateway/link_failure", "/can/refused")


@contextmanager
def recorder_process(path: Path, *, lossless: bool) -> Iterator[tuple[Recorder, int]]:
    """Yield a recorder and the id of its process, which ends with the test."""
    before = set(children_of(os.getpid()))
    recorder = Recorder(path, RUN_HEADER, lossless)
    (process_id,) = set(children_of(os.getpid())) - before
    try:
        yield recorder, process_id
    finally:
        if process_id in children_of(os.getpid()):
            os.kill(process_id, signal.SIGKILL)
            recorder.close({})


def test_all_calls_and_answers_can_be_read_back(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = Recorder(path, RUN_HEADER, lossless=False)
    received = Frame(0x190, b"\x01\x02\x03\x04\x05\x06\x07")
    unusual = [
        Frame(0x1ABCDEF0, b"\xff" * 8, is_extended=True),
        Frame(0x701, is_remote=True),
        Frame(0x04, bytes(8), is_error=True),
    ]
    entry = LogEntry(Severity.FATAL, "adc", "no good sample for 3 periods — limit 3")
    recorder.operated(Trigger.ARM, START_NS)
    recorder.deadline_called(START_NS + 1, START_NS + 2)
    recorder.frame_sent(SYNC, START_NS + 3)
    recorder.frame_received(received, START_NS + 5, EPOCH_OFFSET_NS + START_NS + 4)
    for frame in unusual:
        recorder.frame_received(frame, START_NS + 6, EPOCH_OFFSET_NS + START_NS + 6)
    recorder.log_entry(entry, START_NS + 7)
    recorder.frame_refused(unusual[0], START_NS + 8)
    recorder.link_failed("Network is down", START_NS + 9)
    report = recorder.close({"ending": {"reason": "link"}})

    recording = Recording(path)
    assert report == RecorderReport(10, {}, path, None)
    assert recording.complete
    assert list(recording.entries()) == [
        Operated(START_NS, Trigger.ARM),
        DeadlineCalled(START_NS + 2, START_NS + 1),
        FrameSent(START_NS + 3, SYNC),
        FrameReceived(START_NS + 5, received, EPOCH_OFFSET_NS + START_NS + 4),
        *(FrameReceived(START_NS + 6, frame, EPOCH_OFFSET_NS + START_NS + 6) for frame in unusual),
        Logged(START_NS + 7, entry),
        FrameRefused(START_NS + 8, unusual[0]),
        LinkFailed(START_NS + 9, "Network is down"),
    ]
    assert recording.log() == [(START_NS + 7, entry)]
    assert recording.attachments == {name: content for name, (_, content) in RUN_HEADER.attachments.items()}
    assert recording.metadata == RUN_HEADER.metadata | {
        "recording": {
            "format_version": "2",
            "epoch_offset_ns": str(EPOCH_OFFSET_NS),
            "bus": "vcan0",
            "stamp_origin": "kernel",
            "run id": recording.metadata["recording"]["run id"],
            "part": "1",
            "metadata digests": "sha256",
        },
        "digests": {
            name: digest(name, recording.metadata[name]) for name in ("recording", "run", "setpoints")
        },
        "digests of the end": {
            name: digest(name, recording.metadata[name]) for name in ("ending", "recorder")
        },
        "ending": {"reason": "link"},
        "recorder": {"messages": "10"},
    }


def test_the_same_calls_give_the_same_bytes(tmp_path: Path) -> None:
    files = [tmp_path / "first.mcap", tmp_path / "second.mcap", tmp_path / "in-memory.mcap"]
    for path in files[:2]:
        recorder = Recorder(path, RUN_HEADER, lossless=True)
        record_periods(recorder, 1000)
        recorder.close({})
    with in_memory(files[2]):
        recorder = Recorder(files[2], RUN_HEADER, lossless=True)
    record_periods(recorder, 1000)
    recorder.close({})
    first, *others = (path.read_bytes() for path in files)
    assert len(first) > 100_000
    assert all(other == first for other in others)


def test_the_loops_side_imports_no_slow_library() -> None:
    program = "import sys, hil.recording.recorder; print({'numpy', 'mcap', 'zstandard'} & set(sys.modules))"
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert finished.stdout.strip() == "set()"


def test_an_existing_file_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_text("precious")
    with pytest.raises(RecordingError, match=r"run\.mcap: exists already"):
        Recorder(path, RUN_HEADER, lossless=False)
    assert path.read_text() == "precious"


def test_an_unwritable_path_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"cannot be created: No such file or directory"):
        Recorder(tmp_path / "absent" / "run.mcap", RUN_HEADER, lossless=False)


@pytest.mark.parametrize("epoch_offset_ns", [-1, 2**31 * 10**9])
def test_a_clock_outside_ros_time_is_refused(tmp_path: Path, epoch_offset_ns: int) -> None:
    header = msgspec.structs.replace(RUN_HEADER, epoch_offset_ns=epoch_offset_ns)
    with pytest.raises(RecordingError, match="set the clock"):
        Recorder(tmp_path / "run.mcap", header, lossless=False)
    assert not (tmp_path / "run.mcap").exists()


class TestAwaitStart:
    def test_the_process_has_begun_its_file(self, tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        with recorder_process(path, lossless=False) as (recorder, _):
            recorder.await_start()
            assert recorder.file_bytes > 0
            recorder.close({})

    @pytest.mark.parametrize("signum", [signal.SIGKILL, signal.SIGSTOP], ids=["dead", "hanging"])
    def test_a_process_that_does_not_start_ends_the_wait(
        self, signum: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(pipe, "TIMEOUT_S", 0.1)
        with recorder_process(tmp_path / "run.mcap", lossless=False) as (recorder, process_id):
            os.kill(process_id, signum)
            recorder.await_start()
            assert recorder.file_bytes == 0
            assert recorder.close({}).failure is not None


def test_signals_for_the_gateway_do_not_end_the_recorder(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with recorder_process(path, lossless=False) as (recorder, process_id):
        wait_until(lambda: path.stat().st_size > 0, "the header")
        record_periods(recorder, 50)
        for signum in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(process_id, signum)
        record_periods(recorder, 50, first=50)
        report = recorder.close({})
    assert report.failure is None
    assert len(Recording(path).timing()) == 100


def cycles_in(path: Path) -> int:
    """Return the number of periods in a file that is being written."""
    try:
        return Recording(path).counts.get("/gateway/cycle", 0)
    except RecordingError:  # no chunk yet
        return 0


def test_a_chunk_is_written_although_no_batch_follows(tmp_path: Path) -> None:
    """The loop may hang, so a chunk must not wait for the next batch."""
    path = tmp_path / "run.mcap"
    with recorder_process(path, lossless=False) as (recorder, _):
        record_periods(recorder, 2)
        handed_over = 2 + 200_000_000 // PERIOD_NS
        record_periods(recorder, handed_over - 1, first=2)
        wait_until(lambda: b"setpoints" in path.read_bytes(), "the metadata before the first message")
        wait_until(lambda: cycles_in(path) >= handed_over - 2, "a chunk")
        recorder.close({})
    assert len(Recording(path).timing()) == handed_over + 1


def batches_of(monkeypatch: pytest.MonkeyPatch, recorder: Recorder) -> list[int]:
    """Return the list to which the size of each further batch is appended."""
    sizes: list[int] = []
    send = recorder._pipe.send

    def send_and_note(block: bytearray, kind: bytes) -> None:
        sizes.append(len(block))
        send(block, kind)

    monkeypatch.setattr(recorder._pipe, "send", send_and_note)
    return sizes


def test_a_batch_is_handed_over_every_0_2_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Five batches a second: one each period would slow the loop down, and a crash loses the last batch."""
    with in_memory(tmp_path / "run.mcap"):
        recorder = Recorder(tmp_path / "run.mcap", RUN_HEADER, lossless=True)
    record_periods(recorder, 1)
    sizes = batches_of(monkeypatch, recorder)
    record_periods(recorder, 18 * 50, first=1)
    assert len(sizes) == 50, "18 periods are 0.2016 s"
    assert max(sizes) < BATCH_BYTES


def test_a_batch_is_handed_over_at_its_size_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A babbling node sends hundreds of frames in each period."""
    with in_memory(tmp_path / "run.mcap"):
        recorder = Recorder(tmp_path / "run.mcap", RUN_HEADER, lossless=True)
    record_periods(recorder, 1)
    sizes = batches_of(monkeypatch, recorder)
    for number in range(1, 10):
        for _ in range(1000):
            recorder.frame_received(Frame(0x7F0), START_NS + number * PERIOD_NS, EPOCH_OFFSET_NS)
        record_periods(recorder, 1, first=number)
    assert len(sizes) == 9
    assert min(sizes) >= BATCH_BYTES


def test_a_recorder_that_is_too_slow_drops_messages_and_counts_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipe, "BACKLOG_BYTES", 100_000)
    path = tmp_path / "run.mcap"
    with recorder_process(path, lossless=False) as (recorder, process_id):
        os.kill(process_id, signal.SIGSTOP)
        log = record_periods(recorder, 3000)
        os.kill(process_id, signal.SIGCONT)
        dropped = recorder.dropped
        report = recorder.close({})
    recording = Recording(path)
    assert [entry.severity for entry in log] == [Severity.WARNING]
    assert "dropped from here on" in log[0].text
    assert report.failure is None
    assert dropped == sum(report.dropped.values()) > 1000
    for topic, count in recording.counts.items():
        reported = 0 if topic in UNUSED_TOPICS else 6000 if topic == "/can/tx" else 3000
        assert count + report.dropped.get(topic, 0) == reported, topic
    assert recording.metadata["recorder"] == {"messages": str(report.messages)} | {
        f"dropped {topic}": str(count) for topic, count in report.dropped.items()
    }
    with pytest.raises(RecordingError, match="dropped while recording"):
        list(recording.entries())


def test_lossless_waits_instead_of_dropping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipe, "BACKLOG_BYTES", 0)
    monkeypatch.setattr(pipe, "PIPE_BYTES", 4096)
    recorder = Recorder(tmp_path / "run.mcap", RUN_HEADER, lossless=True)
    assert record_periods(recorder, 2000) == []
    assert recorder.close({}).dropped == {}
    assert len(Recording(tmp_path / "run.mcap").timing()) == 2000


@pytest.mark.parametrize("lossless", [False, True])
def test_when_the_recorder_process_dies_the_loop_goes_on_and_reports_it(
    tmp_path: Path, lossless: bool
) -> None:
    path = tmp_path / "run.mcap"
    with recorder_process(path, lossless=lossless) as (recorder, process_id):
        wait_until(lambda: path.stat().st_size > 0, "the header")
        os.kill(process_id, signal.SIGKILL)
        os.waitid(os.P_PID, process_id, os.WEXITED | os.WNOWAIT)
        log = record_periods(recorder, 500)
        report = recorder.close({})
    assert [(entry.severity, entry.source) for entry in log] == [(Severity.ERROR, "recorder")]
    assert report.failure == "the recorder process was killed"
    assert report.failure in log[0].text
    assert str(path) in log[0].text
    assert sum(report.dropped.values()) == 500 * 8


def test_a_full_disk_ends_the_recording_and_not_the_loop(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, hard))
    try:
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    log = record_periods(recorder, 5000)
    report = recorder.close({})
    assert [entry.severity for entry in log] == [Severity.ERROR]
    assert report.failure is not None
    assert "File too large" in report.failure
    recording = Recording(path)
    assert not recording.complete
    assert 0 < len(recording.timing()) < 5000


@pytest.mark.parametrize("lossless", [False, True])
def test_a_recorder_process_that_hangs_is_killed_after_a_timeout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lossless: bool
) -> None:
    """With lossless, while the loop sends; in real time, at the end of a run."""
    monkeypatch.setattr(pipe, "TIMEOUT_S", 0.05)
    path = tmp_path / "run.mcap"
    with recorder_process(path, lossless=lossless) as (recorder, process_id):
        os.kill(process_id, signal.SIGSTOP)
        log = record_periods(recorder, 3000)
        report = recorder.close({})
        assert process_id not in children_of(os.getpid())
    assert report.failure == "the recorder process read nothing for 0.05 s and was killed"
    assert bool(log) == lossless
    assert sum(report.dropped.values()) > 1000
    assert report.missing(0) == 3000 * 8, "the messages in the pipe are missing too"


def test_a_recorder_process_that_reads_everything_and_does_not_end_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipe, "TIMEOUT_S", 0.05)
    with recorder_process(tmp_path / "run.mcap", lossless=False) as (recorder, process_id):
        os.kill(process_id, signal.SIGSTOP)
        record_periods(recorder, 3)
        report = recorder.close({})
    assert report.failure == "the recorder process did not end within 0.05 s and was killed"
    assert sum(report.dropped.values()) == 0
    assert report.missing(in_file=0) == 3 * 8


class TestFurtherFiles:
    """Files that the recorder process opens after the first one."""

    ENDING: ClassVar = {"ending": {"reason": "continued"}}

    def begin(self, recorder: Recorder, path: Path, remove: Sequence[Path] = ()) -> str | None:
        return recorder.begin_file(path, {"more.json": ("application/json", b"{}")}, self.ENDING, remove)

    @pytest.mark.parametrize("lossless", [False, True])
    def test_each_file_is_complete_and_has_its_own_messages(self, tmp_path: Path, lossless: bool) -> None:
        first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
        recorder = Recorder(first, RUN_HEADER, lossless)
        record_periods(recorder, 30)
        assert recorder.path == first
        assert self.begin(recorder, second) is None
        assert recorder.path == second
        record_periods(recorder, 20)
        report = recorder.close({"ending": {"reason": "completed"}})
        assert report == RecorderReport(20 * 8, {}, second, None)
        for path, periods, reason in ((first, 30, "continued"), (second, 20, "completed")):
            recording = Recording(path)
            assert recording.complete
            assert len(recording.timing()) == periods
            assert recording.metadata["ending"] == {"reason": reason}
            assert recording.metadata["recorder"] == {"messages": str(periods * 8)}
            assert len(list(recording.entries())) == periods * 8
        assert Recording(second).attachments["more.json"] == b"{}"
        assert Recording(second).metadata["documents"]["more.json"].startswith("44136fa3")
        assert Recording(second).attachments["rig.toml"] == Recording(first).attachments["rig.toml"]

    def test_old_files_are_removed(self, tmp_path: Path) -> None:
        first = tmp_path / "first.mcap"
        recorder = Recorder(first, RUN_HEADER, lossless=True)
        record_periods(recorder, 3)
        assert self.begin(recorder, tmp_path / "second.mcap", [first, tmp_path / "gone.mcap"]) is None
        recorder.close({})
        assert [path.name for path in tmp_path.iterdir()] == ["second.mcap"]

    def test_nothing_is_recorded_between_two_files(self, tmp_path: Path) -> None:
        recorder = Recorder(tmp_path / "first.mcap", RUN_HEADER, lossless=True)
        record_periods(recorder, 3)
        recorder.stop(self.ENDING)
        assert recorder.path is None
        record_periods(recorder, 5000)
        assert self.begin(recorder, tmp_path / "second.mcap") is None
        record_periods(recorder, 4)
        recorder.stop(self.ENDING)
        recorder.stop(self.ENDING)
        record_periods(recorder, 3)
        assert recorder.close({"ending": {"reason": "later"}}).failure is None
        for name, periods in (("first.mcap", 3), ("second.mcap", 4)):
            recording = Recording(tmp_path / name)
            assert (recording.complete, len(recording.timing())) == (True, periods)
            assert recording.metadata["ending"] == {"reason": "continued"}

    def test_a_file_that_exists_is_not_touched(self, tmp_path: Path) -> None:
        second = tmp_path / "second.mcap"
        second.write_text("mine")
        recorder = Recorder(tmp_path / "first.mcap", RUN_HEADER, lossless=True)
        assert self.begin(recorder, second) == f"{second} exists already; a recording overwrites no file"
        record_periods(recorder, 3)
        recorder.close({})
        assert second.read_text() == "mine"
        assert len(Recording(tmp_path / "first.mcap").timing()) == 3

    def test_after_a_file_that_cannot_be_created_another_can_be(self, tmp_path: Path) -> None:
        first, lost, third = (tmp_path / name for name in ("first.mcap", "none/second.mcap", "third.mcap"))
        recorder = Recorder(first, RUN_HEADER, lossless=False)
        assert self.begin(recorder, lost) is None
        log: list[LogEntry] = []
        wait_until(lambda: bool(log.extend(record_periods(recorder, 20)) or log), "the failure")
        assert log[0].severity is Severity.ERROR
        assert log[0].text == f"{lost}: recording ended: No such file or directory"
        assert self.begin(recorder, third) is None
        assert record_periods(recorder, 20) == []
        report = recorder.close({})
        assert (report.failure, report.messages) == (None, 20 * 8)
        assert Recording(first).complete
        assert len(Recording(third).timing()) == 20

    def test_after_a_full_disk_another_file_can_be_written(self, tmp_path: Path) -> None:
        soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, hard))
        try:
            recorder = Recorder(tmp_path / "first.mcap", RUN_HEADER, lossless=True)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        log = record_periods(recorder, 5000)
        assert "File too large" in log[0].text
        assert self.begin(recorder, tmp_path / "second.mcap") is None
        record_periods(recorder, 20)
        assert recorder.close({}).failure is None
        assert not Recording(tmp_path / "first.mcap").complete
        assert len(Recording(tmp_path / "second.mcap").timing()) == 20

    def test_a_further_file_that_is_replaced_while_it_is_written_is_reported(self, tmp_path: Path) -> None:
        second = tmp_path / "second.mcap"
        recorder = Recorder(tmp_path / "first.mcap", RUN_HEADER, lossless=True)
        assert self.begin(recorder, second) is None
        wait_until(second.exists, "the second file")
        second.rename(tmp_path / "moved.mcap")
        second.write_text("mine")
        assert recorder.close({}).failure == "the file was removed or replaced while it was written"
        assert second.read_text() == "mine"

    def test_the_last_file_that_fails_is_reported(self, tmp_path: Path) -> None:
        recorder = Recorder(tmp_path / "first.mcap", RUN_HEADER, lossless=True)
        assert self.begin(recorder, tmp_path / "none" / "second.mcap") is None
        assert recorder.close({}).failure == "No such file or directory"

    def test_without_a_process_no_file_begins(self, tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        with recorder_process(path, lossless=False) as (recorder, process_id):
            os.kill(process_id, signal.SIGKILL)
            os.waitid(os.P_PID, process_id, os.WEXITED | os.WNOWAIT)
            reason = self.begin(recorder, tmp_path / "second.mcap")
            recorder.close({})
        assert reason == "the recorder process has ended; end this program and start it again to record"


class TestProgress:
    def test_the_process_says_how_large_its_file_is(self, tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        recorder = Recorder(path, RUN_HEADER, lossless=False)
        assert recorder.file_bytes == 0
        wait_until(lambda: record_periods(recorder, 30) == [] and recorder.file_bytes > 0, "progress")
        assert recorder.file_bytes <= path.stat().st_size
        recorder.close({})

    def test_little_free_space_is_reported_once(self, tmp_path: Path) -> None:
        recorder = Recorder(tmp_path / "run.mcap", RUN_HEADER, lossless=False, min_free_bytes=2**62)
        log: list[LogEntry] = []
        wait_until(lambda: bool(log.extend(record_periods(recorder, 30)) or log), "the warning")
        log += record_periods(recorder, 300)
        recorder.close({})
        assert [(entry.severity, entry.source) for entry in log] == [(Severity.WARNING, "recorder")]
        assert "MB are free for recordings, less than 4611686018427 MB; the loop goes on" in log[0].text

    def test_it_is_reported_again_after_there_was_more(self, tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        with in_memory(path):
            recorder = Recorder(path, RUN_HEADER, lossless=True, min_free_bytes=1000)
        reported = []
        for number, free in enumerate((2000, 999, 500, 1050, 900, 1101, 900)):
            recorder._pipe.progress = Progress(1, free)
            reported.append(len(record_periods(recorder, 40, first=40 * number)))
        assert reported == [0, 1, 0, 0, 0, 0, 1]
