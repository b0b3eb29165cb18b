"""The run that is shown: it ends with its feed, or the next run of a daemon follows."""

from pathlib import Path

import pytest
from support.live_feeds import RUN, make_feed, write_periods

from hil.live import current_run
from hil.live.current_run import CurrentRun


@pytest.fixture(autouse=True)
def search_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(current_run, "SEARCH_INTERVAL_S", 0.0)


def test_the_next_run_of_a_daemon_follows(tmp_path: Path) -> None:
    link = tmp_path / "daemon.sock.live"
    first = make_feed(link=link)
    current = CurrentRun(link, is_followed=True)
    write_periods(first, 1, 2)
    assert not current.update()
    first.close()
    assert not current.update() and current.run.is_over
    assert not current.update()  # no daemon runs
    second = make_feed(RUN, link)
    write_periods(second, 1)
    assert current.update()
    assert not current.update() and not current.run.is_over
    assert len(current.run.history.since(0)) == 1
    second.close()


def test_the_feed_of_a_daemon_that_was_killed_is_not_taken_again(tmp_path: Path) -> None:
    link = tmp_path / "daemon.sock.live"
    killed = make_feed(link=link)
    current = CurrentRun(link, is_followed=True)
    target = link.readlink()
    killed.close()
    stale = make_feed(link=link)
    current.update()
    assert current.run.is_over
    assert link.readlink() != target
    stale._file._memory[16] = 1  # the run has ended, and the link stays
    assert not current.update() and current.run.is_over
    stale.close()


def test_a_run_of_its_own_is_the_last_one() -> None:
    feed = make_feed()
    current = CurrentRun(feed.path, is_followed=False)
    feed.close()
    assert not current.update() and current.run.is_over
    assert not current.update()
