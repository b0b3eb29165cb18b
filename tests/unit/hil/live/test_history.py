"""The ring of rows from which every viewer of the live page takes what is new to it."""

import struct

import numpy as np

from hil.live.feed import period_format
from hil.live.history import COLUMNS, HISTORY_S, History

PERIOD_S = 0.0112
PACK = struct.Struct(period_format(1)).pack


def period(number: int) -> bytes:
    deadline_ns = 1_000 + number * 11_200_000
    return PACK(deadline_ns, deadline_ns + 50_000, deadline_ns + 450_000, 3, 1, 0.1, 0.09, 5.5)


def test_a_row_has_times_in_seconds_and_milliseconds_and_the_signals() -> None:
    history = History(1, PERIOD_S, start_ns=1_000)
    history.add_message(period(0) + period(1))
    rows = history.since(0)
    assert rows.shape == (2, len(COLUMNS) + 3)
    np.testing.assert_allclose(rows[1], [0.0112, 0.05, 0.4, 3, 1, 0.1, 0.09, 5.5])


def test_a_viewer_gets_only_rows_that_are_new() -> None:
    history = History(1, PERIOD_S)
    history.add_message(period(0) + period(1))
    seen = history.end
    history.add_message(period(2))
    assert len(history.since(seen)) == 1
    assert len(history.since(history.end)) == 0


def test_the_ring_holds_ten_minutes_and_no_more() -> None:
    history = History(1, PERIOD_S, start_ns=1_000)
    capacity = round(HISTORY_S / PERIOD_S)
    history.add_message(b"".join(period(number) for number in range(capacity + 10)))
    rows = history.since(0)
    assert len(rows) == capacity
    np.testing.assert_allclose(rows[[0, -1], 0], [10 * PERIOD_S, (capacity + 9) * PERIOD_S])
