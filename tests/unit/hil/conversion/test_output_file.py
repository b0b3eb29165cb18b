"""Output files appear whole or not at all, and overwrite only what the user named."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from hil.conversion.output_file import new_file
from hil.core.errors import RecordingError, RecordingExistsError


def test_the_file_appears_at_the_end_with_the_usual_rights(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    with new_file(target, force=False) as temporary:
        temporary.write_text("whole")
        assert not target.exists()
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".csv"
    assert target.read_text() == "whole"
    (tmp_path / "plain").touch()
    assert target.stat().st_mode == (tmp_path / "plain").stat().st_mode
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.csv", "plain"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, MemoryError])
def test_a_failure_leaves_no_file(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error), new_file(tmp_path / "out.csv", force=False) as temporary:
        temporary.write_text("half")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_an_error_with_the_name_of_the_file(tmp_path: Path) -> None:
    with (
        pytest.raises(RecordingError, match=r"out\.csv: cannot be written: No space left on device"),
        new_file(tmp_path / "out.csv", force=False),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten_without_force(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    target.write_text("old")
    with pytest.raises(RecordingExistsError, match="exists already"), new_file(target, force=False):
        pytest.fail("the block must not begin")
    with new_file(target, force=True) as temporary:
        temporary.write_text("new")
    assert target.read_text() == "new"


def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    with pytest.raises(RecordingExistsError), new_file(target, force=False) as temporary:
        temporary.write_text("new")
        target.write_text("of another program")
    assert target.read_text() == "of another program"


def test_the_file_that_is_read_is_never_the_output(tmp_path: Path) -> None:
    source, link = tmp_path / "run.mcap", tmp_path / "link.mcap"
    source.write_text("recording")
    link.symlink_to(source)
    for target in (source, link):
        with (
            pytest.raises(RecordingError, match="is the file that is being read"),
            new_file(target, force=True, source=source),
        ):
            pytest.fail("the block must not begin")


def test_special_files_and_missing_folders_are_refused(tmp_path: Path) -> None:
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    for target, reason in (
        (fifo, "is not a regular file"),
        (tmp_path, "is a directory"),
        (tmp_path / "none" / "out.csv", "there is no directory"),
        (tmp_path / ("x" * 300), "File name too long"),
    ):
        with pytest.raises(RecordingError, match=reason), new_file(target, force=True):
            pytest.fail("the block must not begin")
