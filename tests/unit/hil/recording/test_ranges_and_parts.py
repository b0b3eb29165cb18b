"""Ranges of time, runs in several files, and tables as data frames of other libraries."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.opcode import Opcode
from support.mcap_files import chunk_starts, records
from support.recorded_runs import (
    EPOCH_OFFSET_NS,
    PERIOD_NS,
    PERIOD_S,
    RUN_HEADER,
    START_NS,
    in_memory,
    record_periods,
    record_run,
)

from hil.core.errors import EnvironmentLackError, RecordingError
from hil.core.output import LogEntry, Severity
from hil.recording import open_recording
from hil.recording.entries import DeadlineCalled
from hil.recording.handover import RunHeader
from hil.recording.mcap_reader import McapContents
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder
from hil.recording.rotation_names import STATE_NAME
from hil.recording.scan_result import Place

PERIODS = 2000


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    file = tmp_path_factory.mktemp("recording") / "run.mcap"
    record_run(file, PERIODS)
    return Recording(file)


class TestRanges:
    def test_a_range_has_the_rows_from_its_begin_up_to_its_end(self, recording: Recording) -> None:
        part = recording.between(3.0, 4.5)
        for whole, found in (
            (recording.axis("rotation"), part.axis("rotation")),
            (recording.timing(), part.timing()),
            (recording.frames("sent"), part.frames("sent")),
        ):
            chosen = (whole.time_s >= 3.0) & (whole.time_s < 4.5)
            assert chosen.any()
            for name in whole.columns:
                np.testing.assert_array_equal(found[name], whole[name][chosen])

    def test_open_ends_are_those_of_the_recording(self, recording: Recording) -> None:
        whole = recording.timing().number
        head, tail = (recording.between(to_s=2.0), recording.between(2.0))
        np.testing.assert_array_equal(np.concatenate([head.timing().number, tail.timing().number]), whole)
        assert recording.between().timing().number.tolist() == whole.tolist()

    def test_the_rest_of_the_file_is_not_read(
        self, recording: Recording, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        read: list[Place] = []
        original = McapContents._read

        def note(contents: McapContents, place: Place, channel: int | None) -> Any:
            read.append(place)
            return original(contents, place, channel)

        monkeypatch.setattr(McapContents, "_read", note)
        recording.between(1.0, 2.0).axis("vertical")
        epoch_ns = recording.start_ns + EPOCH_OFFSET_NS
        assert read
        assert all(place.end_ns >= epoch_ns + 1_000_000_000 for place in read)
        assert all(place.start_ns <= epoch_ns + 12_000_000_000 for place in read)
        assert len(read) < 0.7 * len(recording._contents._places)  # type: ignore[union-attr]

    def test_the_log_of_a_range(self, tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        with in_memory(path):
            recorder = Recorder(path, RUN_HEADER, lossless=True)
        record_periods(recorder, 50)
        for number in (10, 20, 30):
            recorder.log_entry(LogEntry(Severity.INFO, "adc", str(number)), START_NS + number * PERIOD_NS)
        recorder.close({})
        part = Recording(path).between(15 * PERIOD_S, 25 * PERIOD_S)
        assert [entry.text for _, entry in part.log()] == ["20"]

    def test_windows_cover_the_recording_once(self, recording: Recording) -> None:
        windows = list(recording.windows(3.0))
        assert len(windows) == 8
        numbers = np.concatenate([window.timing().number for window in windows])
        np.testing.assert_array_equal(numbers, recording.timing().number)
        frames = sum(len(window.frames("received")) for window in windows)
        assert frames == recording.counts["/can/rx"]
        assert recording.duration_s == pytest.approx((PERIODS + 6) * PERIOD_S, abs=PERIOD_S)

    def test_an_empty_range_and_the_replay_of_a_range_are_refused(self, recording: Recording) -> None:
        with pytest.raises(RecordingError, match="the range from 2 s to 1 s is empty"):
            recording.between(2.0, 1.0)
        with pytest.raises(RecordingError, match="a range of time cannot be replayed"):
            next(recording.between(1.0, 2.0).entries())

    def test_a_recording_without_a_message_has_no_window(self, tmp_path: Path) -> None:
        path = tmp_path / "run.mcap"
        with in_memory(path):
            recorder = Recorder(path, RUN_HEADER, lossless=True)
        recorder.close({})
        assert list(Recording(path).windows(1.0)) == []
        assert Recording(path).duration_s == 0.0


PART_PERIODS = 40


def record_parts(
    folder: Path, count: int, header: RunHeader = RUN_HEADER, pause_before: int = 0
) -> list[Path]:
    """Record a run of ``count`` files of 40 periods. Before one of them, the recording may be stopped."""
    paths = [folder / f"run-{number}.mcap" for number in range(1, count + 1)]
    with in_memory(paths[0]):
        recorder = Recorder(paths[0], header, lossless=True)
    for number, path in enumerate(paths, 1):
        if number == pause_before:
            recorder.stop({"ending": {"reason": "stopped"}})
        if number > 1:
            state = {STATE_NAME: ("application/json", b"%d" % number)}
            recorder.begin_file(path, state, {"ending": {"reason": f"part {number - 1}"}})
        record_periods(recorder, PART_PERIODS, first=PART_PERIODS * (number - 1))
    recorder.close({"ending": {"reason": f"part {count}"}})
    return paths


@pytest.fixture
def parts(tmp_path: Path) -> list[Path]:
    folder = tmp_path / "run"
    folder.mkdir()
    return record_parts(folder, 3)


class TestRunsInSeveralFiles:
    def test_their_tables_are_those_of_one_run(self, parts: list[Path], tmp_path: Path) -> None:
        whole = tmp_path / "whole.mcap"
        with in_memory(whole):
            recorder = Recorder(whole, RUN_HEADER, lossless=True)
        record_periods(recorder, 120)
        recorder.close({})
        expected = Recording(whole)
        for given in (parts, parts[::-1], parts[0].parent):
            run = open_recording(given)
            assert run.path == parts[0]
            assert run.counts == expected.counts
            assert run.complete
            for name in expected.axes:
                np.testing.assert_array_equal(np.asarray(run.axis(name)), np.asarray(expected.axis(name)))
            np.testing.assert_array_equal(run.timing().number, np.arange(120))
            assert list(run.entries()) == list(expected.entries())
            run.check_count()
            assert run.metadata["ending"] == {"reason": "part 3"}
            assert run.metadata["recording"]["part"] == "1"
            assert run.metadata["recorder"] == {"messages": "960"}
            assert len(run.between(0.3, 0.6).timing()) == pytest.approx(0.3 / PERIOD_S, abs=1)
            assert run.duration_s == expected.duration_s

    def test_the_recorder_names_the_run_and_the_part(self, parts: list[Path], tmp_path: Path) -> None:
        own = [Recording(path).metadata["recording"] for path in parts]
        assert [entries["part"] for entries in own] == ["1", "2", "3"]
        assert len({entries["run id"] for entries in own}) == 1
        (other,) = record_parts(tmp_path, 1, msgspec.structs.replace(RUN_HEADER, epoch_offset_ns=10**18))
        assert Recording(other).metadata["recording"]["run id"] != own[0]["run id"]

    def test_the_state_of_the_core_is_that_of_the_first_file(self, parts: list[Path]) -> None:
        assert STATE_NAME not in open_recording(parts).attachments
        later = open_recording(parts[1:])
        assert later.attachments[STATE_NAME] == b"2"
        assert later.metadata["documents"][STATE_NAME] == hashlib.sha256(b"2").hexdigest()

    def test_the_first_files_may_have_been_removed(self, parts: list[Path]) -> None:
        run = open_recording(parts[1:])
        np.testing.assert_array_equal(run.timing().number, np.arange(40, 120))
        assert sum(isinstance(entry, DeadlineCalled) for entry in run.entries()) == 80

    def test_a_missing_part_is_named(self, parts: list[Path]) -> None:
        with pytest.raises(RecordingError, match=r"run-3\.mcap: part 2 of its run is missing"):
            open_recording([parts[0], parts[2]])

    def test_a_part_given_twice_is_named(self, parts: list[Path], tmp_path: Path) -> None:
        copy = tmp_path / "copy.mcap"
        copy.write_bytes(parts[1].read_bytes())
        with pytest.raises(RecordingError, match=r"part 2 of its run is given twice"):
            open_recording([*parts, copy])

    def test_a_pause_ends_what_can_be_replayed_together(self, tmp_path: Path) -> None:
        parts = record_parts(tmp_path, 3, pause_before=3)
        run = open_recording(parts)
        assert len(run.timing()) == 120
        found = run.entries()
        for _ in range(2 * PART_PERIODS * 8):
            next(found)
        with pytest.raises(RecordingError, match=r"run-3\.mcap: the recording was stopped before this file"):
            next(found)

    def test_files_of_other_runs_are_refused(self, parts: list[Path], tmp_path: Path) -> None:
        header = msgspec.structs.replace(RUN_HEADER, bus="can7")
        other = record_parts(tmp_path, 2, header)[1]
        with pytest.raises(RecordingError, match="are of different runs"):
            open_recording([parts[0], other])

    def test_a_file_that_names_no_part_is_refused(self, parts: list[Path]) -> None:
        earlier = Path(__file__).parents[3] / "data" / "hil-0.2.0-run.mcap"
        with pytest.raises(RecordingError, match=r"run\.mcap: is not a part of a run in several files"):
            open_recording([parts[0], earlier])

    def test_parts_with_other_channels_are_refused(self, parts: list[Path], tmp_path: Path) -> None:
        axes = (("horizontal", "m"), ("vertical", "m"), ("rotation", "rad"))
        own = {key: Recording(parts[0]).metadata["recording"][key] for key in ("run id", "part")}
        header = msgspec.structs.replace(RUN_HEADER, axes=axes, metadata={"recording": {**own, "part": "2"}})
        (other,) = record_parts(tmp_path, 1, header)
        with pytest.raises(RecordingError, match="/axis/horizontal has another channel id than in"):
            open_recording([parts[0], other])

    def test_a_folder_without_recordings_and_no_file_are_refused(self, tmp_path: Path) -> None:
        with pytest.raises(RecordingError, match=r"the folder has no recording \(\*\.mcap\)"):
            open_recording(tmp_path)
        with pytest.raises(RecordingError, match="no file of a recording is given"):
            open_recording([])

    def test_a_folder_with_one_recording_is_that_recording(self, tmp_path: Path) -> None:
        record_run(tmp_path / "run.mcap", 20)
        assert open_recording(tmp_path).path == tmp_path / "run.mcap"

    def test_a_run_whose_last_file_was_cut_off_is_not_complete(self, parts: list[Path]) -> None:
        parts[2].write_bytes(parts[2].read_bytes()[:-20])
        run = open_recording(parts)
        assert not run.complete
        assert len(run.timing()) == 120

    def test_a_last_file_without_data_ends_a_run_if_it_says_which_part_it_is(self, parts: list[Path]) -> None:
        content = parts[2].read_bytes()
        parts[2].write_bytes(content[: chunk_starts(content)[0]])
        run = open_recording(parts)
        assert not run.complete
        assert len(run.timing()) == 80
        (_, _, metadata_end), *_ = (r for r in records(content) if r[0] == Opcode.METADATA)
        for size in (0, metadata_end - 1, metadata_end):
            parts[2].write_bytes(content[:size])
            with pytest.raises(RecordingError, match=r"run-3\.mcap: was cut off before its first period"):
                open_recording(parts)


class TestDataFrames:
    def test_pandas(self, recording: Recording) -> None:
        vertical = recording.axis("vertical")
        frame = vertical.to_pandas()
        assert list(frame.columns) == list(vertical.columns)
        assert frame.attrs == {"name": "vertical", "unit": "m"}
        np.testing.assert_array_equal(frame["position"].to_numpy(), vertical.position)
        frames = recording.frames("received")
        bytes_of = frames.to_pandas()[[f"data_{n}" for n in range(8)]]
        np.testing.assert_array_equal(bytes_of.to_numpy(), frames.data)

    def test_polars_and_xarray_are_given_the_same_columns(
        self, recording: Recording, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        polars, xarray = ModuleType("polars"), ModuleType("xarray")
        polars.DataFrame = dict  # type: ignore[attr-defined]
        xarray.Dataset = lambda variables, coords, attrs: SimpleNamespace(  # type: ignore[attr-defined]
            variables=variables, coords=coords, attrs=attrs
        )
        monkeypatch.setitem(sys.modules, "polars", polars)
        monkeypatch.setitem(sys.modules, "xarray", xarray)
        vertical = recording.axis("vertical")
        assert list(vertical.to_polars()) == list(vertical.columns)
        dataset = vertical.to_xarray()
        assert dataset.attrs == {"name": "vertical", "unit": "m"}
        np.testing.assert_array_equal(dataset.coords["time_s"], vertical.time_s)
        dimension, values = dataset.variables["position"]
        assert dimension == "time_s"
        np.testing.assert_array_equal(values, vertical.position)
        assert "data_7" in recording.frames("sent").to_polars()

    @pytest.mark.parametrize("library", ["pandas", "polars", "xarray"])
    def test_a_missing_library_is_named(
        self, recording: Recording, monkeypatch: pytest.MonkeyPatch, library: str
    ) -> None:
        monkeypatch.setitem(sys.modules, library, None)
        with pytest.raises(
            EnvironmentLackError,
            match=rf"to_{library} needs the package {library}, which is not installed: pip",
        ):
            getattr(recording.timing(), f"to_{library}")()
