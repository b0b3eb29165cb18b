"""The long recordings of the benchmarks are what the recorder would have written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.constants import PERIOD_NS
from support.long_recordings import REPEATED_PERIODS, record_long_run

from hil.recording import open_recording
from hil.recording.entries import CycleRecorded


def test_times_and_numbers_go_on_over_the_repetitions(tmp_path: Path) -> None:
    assert record_long_run(tmp_path / "run.mcap", 2 * REPEATED_PERIODS + 1) == 3 * REPEATED_PERIODS
    run = open_recording(tmp_path / "run.mcap")
    timing, axis = run.timing(), run.axis("rotation")
    assert np.array_equal(timing.number, np.arange(3 * REPEATED_PERIODS))
    for column in ("deadline_ns", "wake_ns", "receive_ns", "computed_ns", "sent_ns"):
        assert set(np.diff(timing[column]).tolist()) == {PERIOD_NS}
    assert np.array_equal(axis.time_ns, timing.wake_ns)
    assert set(np.diff(run.frames("sent", 0x80).time_ns).tolist()) == {PERIOD_NS}
    assert sum(isinstance(entry, CycleRecorded) for entry in run.entries()) == 3 * REPEATED_PERIODS
