"""Supervision of one board: boot-up, NMT start, and heartbeats that stop, to the nanosecond."""

from __future__ import annotations

import pytest

from hil.core.board_watch import BoardWatch, NmtState, describe_emergency
from hil.core.frames import Frame

TIMEOUT_NS = 302_400_000
START = Frame(0x000, b"\x01\x10")


def watch() -> BoardWatch:
    return BoardWatch("adc", 0x10, TIMEOUT_NS, "adc.heartbeat_timeout_s")


def test_a_board_that_was_never_heard_is_silent_but_not_lost() -> None:
    board = watch()
    assert not board.is_up
    assert board.describe() == "silent"
    assert board.overdue(10**18) is None


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (0, "boot-up"),
        (4, "stopped"),
        (127, "pre-operational"),
        (42, "in unknown NMT state 42"),
        (0x85, "in unknown NMT state 133"),  # a toggle bit is node guarding, not a heartbeat
    ],
)
def test_a_board_that_is_not_operational_is_started(state: int, words: str) -> None:
    board = watch()
    assert board.heartbeat(state, 0) == START
    assert not board.is_up
    assert board.describe() == words


def test_the_start_command_is_for_this_board_alone() -> None:
    assert BoardWatch("dac", 0x20, 1, "x").heartbeat(NmtState.BOOT_UP, 0) == Frame(0x000, b"\x01\x20")


def test_an_operational_board_is_up_and_left_alone() -> None:
    board = watch()
    assert board.heartbeat(5, 0) is None
    assert board.is_up
    assert board.describe() == "operational"


def test_a_heartbeat_may_take_exactly_its_time() -> None:
    board = watch()
    board.heartbeat(NmtState.OPERATIONAL, 1000)
    assert board.overdue(1000 + TIMEOUT_NS) is None
    assert board.is_up
    assert board.overdue(1000 + TIMEOUT_NS + 1) == (
        "no heartbeat for 302 ms, limit 302 ms (rig: adc.heartbeat_timeout_s)"
    )


def test_every_heartbeat_gives_its_time_anew() -> None:
    board = watch()
    for now_ns in range(0, 10 * TIMEOUT_NS, TIMEOUT_NS):
        board.heartbeat(NmtState.OPERATIONAL, now_ns)
        assert board.overdue(now_ns + TIMEOUT_NS) is None


def test_a_lost_board_is_reported_once_and_is_not_up() -> None:
    board = watch()
    board.heartbeat(NmtState.OPERATIONAL, 0)
    assert board.overdue(2 * TIMEOUT_NS) is not None
    assert not board.is_up
    assert board.describe() == "silent"
    assert board.overdue(3 * TIMEOUT_NS) is None


def test_a_board_that_comes_back_is_watched_again() -> None:
    board = watch()
    board.heartbeat(NmtState.OPERATIONAL, 0)
    board.overdue(2 * TIMEOUT_NS)
    assert board.heartbeat(NmtState.BOOT_UP, 3 * TIMEOUT_NS) == START
    assert board.heartbeat(NmtState.OPERATIONAL, 3 * TIMEOUT_NS) is None
    assert board.is_up
    assert board.overdue(4 * TIMEOUT_NS) is None
    assert board.overdue(4 * TIMEOUT_NS + 1) is not None


def test_a_board_that_is_not_operational_is_watched_too() -> None:
    board = watch()
    board.heartbeat(NmtState.PRE_OPERATIONAL, 0)
    assert board.overdue(TIMEOUT_NS + 1) is not None


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x8250, "RPDO did not come in time"),
        (0x8253, "RPDO did not come in time"),
        (0x8299, "protocol error"),
        (0x5030, "device hardware"),
        (0xFF42, "device specific"),
        (0xA000, "unknown error"),
    ],
)
def test_an_emergency_is_told_in_words_as_closely_as_its_code_is_known(code: int, words: str) -> None:
    assert describe_emergency(code, 0x11, bytes(5)) == f"EMCY 0x{code:04X} ({words}), error register 0x11"


def test_what_the_vendor_adds_is_told_too() -> None:
    text = describe_emergency(0x8200, 0x11, bytes((2, 7, 0, 0, 0)))
    assert text == "EMCY 0x8200 (protocol error), error register 0x11, vendor bytes 02 07 00 00 00"
