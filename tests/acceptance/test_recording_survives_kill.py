"""kill -9 at the real rate: of loop and recorder, one second is lost at most; of the loop alone, a batch.

The loop is a process of its own that records three axes by the clock, and says on stdout which period it has
just recorded.
"""

from __future__ import annotations

import os
import select
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from support.recorded_runs import PERIOD_S, children_of

from hil.recording.reader import Recording

TESTS = Path(__file__).parents[1]
LOOP = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from support.recorded_runs import PERIOD_S, RUN_HEADER, record_periods
from hil.recording.recorder import Recorder
recorder = Recorder(Path(sys.argv[2]), RUN_HEADER, lossless=False)
began = time.monotonic()
number = 0
while True:
    time.sleep(max(0.0, began + number * PERIOD_S - time.monotonic()))
    record_periods(recorder, 1, first=number)
    print(number, flush=True)
    number += 1
"""


@contextmanager
def recording_loop(path: Path) -> Iterator[subprocess.Popen[bytes]]:
    loop = subprocess.Popen([sys.executable, "-c", LOOP, str(TESTS), str(path)], stdout=subprocess.PIPE)
    try:
        yield loop
    finally:
        loop.kill()
        loop.wait()


def read_until_period(loop: subprocess.Popen[bytes], number: int) -> None:
    assert loop.stdout is not None
    while int(loop.stdout.readline()) < number:
        pass


def periods_recorded(loop: subprocess.Popen[bytes], at_least: int) -> int:
    """After the loop's death, by its own account."""
    assert loop.stdout is not None
    told_since = loop.stdout.read().split()
    return int(told_since[-1]) + 1 if told_since else at_least


def wait_for_end_of(process_id: int) -> None:
    """Return when a process that is not our child has ended."""
    try:
        handle = os.pidfd_open(process_id)
    except ProcessLookupError:
        return
    assert select.select([handle], [], [], 20.0)[0], "the recorder process did not end"
    os.close(handle)


@pytest.mark.parametrize("kill_at_period", [40, 200, 217, 234])
def test_kill_of_loop_and_recorder_loses_one_second_at_most(tmp_path: Path, kill_at_period: int) -> None:
    path = tmp_path / "run.mcap"
    with recording_loop(path) as loop:
        read_until_period(loop, kill_at_period)
        (recorder_process,) = children_of(loop.pid)
        for process_id in (recorder_process, loop.pid):
            os.kill(process_id, signal.SIGKILL)
        wait_for_end_of(recorder_process)
        loop.wait()
        recorded = periods_recorded(loop, kill_at_period + 1)
    recording = Recording(path)
    assert not recording.complete
    numbers = recording.timing()["number"] if recording.axes else np.empty(0)
    np.testing.assert_array_equal(numbers, np.arange(len(numbers)))
    assert (recorded - len(numbers)) * PERIOD_S <= 1.0
    assert recording.attachments.keys() == {"rig.toml", "arm.dbc"}
    assert messages_read_by_mcap(path) == sum(recording.counts.values()) == 8 * len(numbers)


def messages_read_by_mcap(path: Path) -> int:
    """What mcap's own reader gives before it stumbles over the torn end."""
    count = 0
    with path.open("rb") as stream:
        try:
            for _ in NonSeekingReader(stream, validate_crcs=True).iter_messages(log_time_order=False):
                count += 1
        except (McapError, struct.error):
            pass
    return count


def test_kill_of_the_loop_alone_leaves_a_whole_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with recording_loop(path) as loop:
        read_until_period(loop, 100)
        (recorder_process,) = children_of(loop.pid)
        os.kill(loop.pid, signal.SIGKILL)
        loop.wait()
        wait_for_end_of(recorder_process)
        recorded = periods_recorded(loop, 101)
    recording = Recording(path)
    assert recording.complete
    assert "without closing" in recording.metadata["recorder"]["end"]
    assert 0 <= (recorded - len(recording.timing())) * PERIOD_S <= 0.3
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(recording.counts.values())
