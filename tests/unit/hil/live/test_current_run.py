"""The run that is shown: it ends with its feed, or the next run of a daemon follows."""

import dataclasses
from pathlib import Path

import pytest
from support.live_feeds import PERIOD_NS, RUN, make_feed, write_periods

from hil.live import current_run, feed_file, run_source
from hil.live.current_run import CurrentRun
from hil.live.feed_file import running_feed
from hil.live.run_source import RunSource


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


@pytest.mark.parametrize("changed", ["added to the run", "missing in the run", "status"])
def test_a_feed_of_another_version_is_reported_and_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str
) -> None:
    link = tmp_path / "daemon.sock.live"
    first = make_feed(link=link)
    current = CurrentRun(link, is_followed=True)
    first.close()
    current.update()
    with monkeypatch.context() as other:
        fields = dataclasses.asdict(RUN)
        if changed == "status":
            other.setattr(feed_file, "FORMAT", {**feed_file.FORMAT, "status": {"new": "int"}})
        elif changed == "added to the run":
            other.setattr(feed_file, "asdict", lambda _run: fields | {"new": 1})
        else:
            other.setattr(feed_file, "asdict", lambda _run: {"axes": fields["axes"]})
        updated = make_feed(link=link)
    source = RunSource(current, None)
    for _ in range(2):
        assert not current.update() and current.run.is_over
    (error,) = [message["feed_error"] for message in source.take()[0] if "feed_error" in message]
    assert error == (
        f"{link}: the feed of the run is of another version of hil than this program: "
        "start `hil live` again, or the daemon if it is older"
    )
    assert running_feed(link) is None
    updated.close()
    same = make_feed(link=link)
    assert current.update() and current.feed_error == ""
    assert {"feed_error": ""} in source.take()[0]
    same.close()


def test_the_age_of_the_data_is_that_of_the_last_row_a_viewer_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_source, "monotonic", lambda: 1000.0)
    monkeypatch.setattr(run_source, "MAX_ROWS", 2)
    feed = make_feed(dataclasses.replace(RUN, start_ns=int(100e9)))
    current = CurrentRun(feed.path, is_followed=False)
    source = RunSource(current, None)
    assert source.take()[0][-1] == {"beat_s": 1000.0, "age_s": None, "is_behind": False}
    begin = int(990e9) // PERIOD_NS
    write_periods(feed, begin, begin + 1, begin + 2)
    current.update()
    for row, is_behind in ((begin + 1, True), (begin + 2, False), (begin + 2, False)):
        beat = source.take()[0][-1]
        assert beat["age_s"] == pytest.approx(1000.0 - row * PERIOD_NS * 1e-9)
        assert beat["is_behind"] is is_behind
    feed.close()
