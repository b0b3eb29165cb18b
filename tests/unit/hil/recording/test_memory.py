"""Memory for long recordings: as much as a part of them takes, not as the whole."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import pytest
from support.long_recordings import record_long_run
from support.recorded_runs import record_run

from hil.recording import open_recording
from hil.recording.recover import recover
from hil.views import comparison_windows, loop_figures, report_plots
from hil.views.comparison import compare
from hil.views.recording_report import render_report

PERIODS = 54_000
"""Ten minutes. The file has 12 MB, and the table of one axis has 5 MB."""
MB = 1_000_000


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recording") / "run.mcap"
    record_run(file, PERIODS)
    return file


def peak_bytes(work: Callable[[], object]) -> int:
    """Return the largest size of what ``work`` had allocated at once."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_opening_and_a_range_need_a_fraction_of_the_file(path: Path) -> None:
    assert path.stat().st_size > 10 * MB
    assert peak_bytes(lambda: open_recording(path)) < 4 * MB
    assert peak_bytes(lambda: open_recording(path).between(300.0, 310.0).axis("vertical")) < 4 * MB


def test_going_through_all_windows_needs_that_of_one(path: Path) -> None:
    def read() -> None:
        periods = sum(len(window.timing()) for window in open_recording(path).windows(20.0))
        assert periods == PERIODS + 6

    assert peak_bytes(read) < 5 * MB


def test_a_cut_off_file_and_its_recovery_need_a_fraction_of_it(path: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(path.read_bytes()[:6_000_000])
    assert peak_bytes(lambda: open_recording(torn).between(0.0, 1.0).timing()) < 4 * MB
    assert peak_bytes(lambda: recover(torn, tmp_path / "saved.mcap")) < 6 * MB


@pytest.fixture
def short_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the windows in which long runs are read, so that a run of minutes has many of them."""
    for module in (loop_figures, report_plots, comparison_windows):
        monkeypatch.setattr(module, "WINDOW_S", 20.0)


@pytest.mark.usefixtures("short_windows")
def test_a_report_has_a_bounded_size_and_needs_no_more_memory_for_a_longer_run(tmp_path: Path) -> None:
    """The longer run has four times as many periods. Of its chunks, their places alone are in memory."""
    peaks = []
    for periods in (10_000, 40_000):
        path = tmp_path / f"{periods}.mcap"
        pages: list[str] = []
        record_long_run(path, periods)
        peaks.append(peak_bytes(lambda: pages.append(render_report(open_recording(path)))))  # noqa: B023
        assert len(pages[0]) < 3 * MB
    assert peaks[1] < peaks[0] + 4 * MB < 20 * MB


@pytest.mark.usefixtures("short_windows")
def test_a_comparison_needs_no_more_memory_for_a_longer_run(tmp_path: Path) -> None:
    peaks = []
    for periods in (5_000, 20_000):
        path = tmp_path / f"{periods}.mcap"
        record_long_run(path, periods)
        peaks.append(peak_bytes(lambda: compare(open_recording(path), open_recording(path))))  # noqa: B023
    assert peaks[1] < peaks[0] + MB < 10 * MB
