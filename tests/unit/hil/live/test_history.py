"""The ring of rows from which every viewer of the live page takes what is new to it."""

import numpy as np
from support.live_feeds import PERIOD_NS, SIGNALS, cycle

from hil.live.history import COLUMNS, HISTORY_S, History
from hil.live.period_record import Periods, packer, unpack_periods

PERIOD_S = 0.0112


def periods(*numbers: int) -> Periods:
    pack = packer(1)
    messages = [pack(c, c.wake_ns + 300_000, c.wake_ns + 400_000) for c in map(cycle, numbers)]
    return unpack_periods(messages, 1)


def test_a_row_has_times_in_seconds_and_milliseconds_and_the_signals() -> None:
    history = History(1, PERIOD_S, start_ns=PERIOD_NS)
    history.add_periods(periods(1, 2))
    rows = history.since(0)
    assert rows.shape == (2, len(COLUMNS) + 3)
    signals = [SIGNALS.setpoint, SIGNALS.position, SIGNALS.command_v]
    np.testing.assert_allclose(rows[1], [0.0112, 0.05, 0.4, 3, 1, *signals])


def test_a_viewer_gets_only_rows_that_are_new() -> None:
    history = History(1, PERIOD_S)
    history.add_periods(periods(0, 1))
    seen = history.end
    history.add_periods(periods(2))
    assert len(history.since(seen)) == 1
    assert len(history.since(history.end)) == 0


def test_the_ring_holds_ten_minutes_and_no_more() -> None:
    history = History(1, PERIOD_S)
    capacity = round(HISTORY_S / PERIOD_S)
    count = capacity + 10
    whole = np.zeros((count, len(COLUMNS) + 3))
    whole[:, 0] = np.arange(count)
    for part in np.array_split(whole, 7):
        history.add_rows(part)
    np.testing.assert_array_equal(history.since(0)[:, 0], np.arange(10, count))
    np.testing.assert_array_equal(history.since(capacity)[:, 0], np.arange(capacity, count))
    history.add_rows(whole)  # more rows at once than it holds
    np.testing.assert_array_equal(history.since(0)[:, 0], np.arange(10, count))


def test_an_hour_of_periods_takes_no_more_memory() -> None:
    history = History(1, PERIOD_S)
    before = history._rows.nbytes
    hour = np.zeros((round(3600 / PERIOD_S), len(COLUMNS) + 3))
    for part in np.array_split(hour, 100):
        history.add_rows(part)
    assert history.end == len(hour) and history._rows.nbytes == before
    assert len(history.since(0)) == round(HISTORY_S / PERIOD_S)
