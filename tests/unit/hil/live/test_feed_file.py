"""The file through which a loop feeds the live views: who may open it, and when the run is over."""

import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

import pytest
from support.live_feeds import RUN, make_feed, write_periods

from hil.core.errors import EnvironmentLackError, OperationError
from hil.live import feed_file
from hil.live.feed_file import FeedReader, FeedWriter, link_beside


def test_a_reader_knows_the_run_and_sees_its_end() -> None:
    feed = make_feed()
    assert feed.path.stat().st_mode & 0o777 == 0o600
    reader = FeedReader(feed.path)
    assert [tuple(axis) for axis in reader.run.axes] == RUN.axes
    assert reader.run.rig_text == RUN.rig_text
    assert not reader.is_over()
    write_periods(feed, 1, 2)
    feed.close()
    assert not feed.path.exists()
    assert reader.is_over()
    assert len(reader.periods.read().messages) == 2  # the memory is still there
    reader.close()


def test_a_reader_notices_that_the_loop_was_killed() -> None:
    program = (
        "import sys; sys.path.insert(0, 'tests'); from support.live_feeds import make_feed; "
        "feed = make_feed(); print(feed.path, flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        path = Path(process.stdout.readline().strip())
        reader = FeedReader(path)
        assert not reader.is_over()
        process.kill()
    assert reader.is_over()
    reader.close()
    path.unlink()


def test_a_daemon_puts_a_link_beside_its_socket(tmp_path: Path) -> None:
    link = link_beside(tmp_path / "daemon.sock")
    feed = make_feed(link=link)
    assert link.name == "daemon.sock.live" and link.readlink() == feed.path
    FeedReader(link).close()
    feed.close()
    assert not link.is_symlink()


def test_a_daemon_takes_the_place_of_one_that_was_killed(tmp_path: Path) -> None:
    link = tmp_path / "daemon.sock.live"
    killed = make_feed(link=link)
    feed = make_feed(link=link)
    assert link.readlink() == feed.path
    killed.close()
    assert link.readlink() == feed.path  # the link of the present daemon is left alone
    feed.close()


def test_the_feeds_of_loops_that_were_killed_are_removed_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed_file, "FOLDER", tmp_path)
    killed, young, other = (tmp_path / name for name in ("hil-live-1", "hil-live-2", "other"))
    for path in (killed, young, other):
        path.write_bytes(b"")
    running = make_feed()
    for path in (killed, other, running.path):
        os.utime(path, (1.0, 1.0))
    make_feed().close()
    assert sorted(tmp_path.iterdir()) == sorted([young, other, running.path])
    running.close()


def test_no_feed_is_reported_with_the_path(tmp_path: Path) -> None:
    with pytest.raises(OperationError, match="none: the feed of the run cannot be opened: No such file"):
        FeedReader(tmp_path / "none")


@pytest.mark.parametrize("content", [b"", b"short", bytes(8192)])
def test_a_file_that_is_no_feed_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(OperationError, match="is no feed of a run"):
        FeedReader(path)


def test_a_feed_of_another_user_is_not_read() -> None:
    feed = make_feed()
    found = os.stat_result((0o600, 1, 1, 1, 4711, 0, 8192, 0, 0, 0))
    with (
        mock.patch.object(feed_file.os, "fstat", return_value=found),
        pytest.raises(OperationError, match="belongs to another user"),
    ):
        FeedReader(feed.path)
    feed.close()


def test_without_shared_memory_the_error_names_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed_file, "FOLDER", tmp_path / "none")
    with pytest.raises(EnvironmentLackError, match="none: no shared memory for the live page: No such file"):
        FeedWriter(RUN)


def test_a_full_shared_memory_is_noticed_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed_file, "FOLDER", tmp_path)
    full = OSError(28, "No space left on device")
    monkeypatch.setattr(feed_file.os, "posix_fallocate", mock.Mock(side_effect=full))
    with pytest.raises(EnvironmentLackError, match=r"no 9 MB of shared memory .* No space left"):
        FeedWriter(RUN)
    assert list(tmp_path.iterdir()) == []
