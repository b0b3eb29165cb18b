"""State of one board: boot-up, NMT start, heartbeat timeout to the nanosecond, and emergencies in words."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

from hil.core.board_watch import EMERGENCIES, BoardWatch, NmtState, describe_emergency
from hil.core.frames import Frame
from hil.core.nmt_starts import IMMEDIATE_STARTS, SETTLED_NS
from hil.core.wire import codec

TIMEOUT_NS = 302_400_000
START = Frame(0x000, b"\x01\x10")


def watch() -> BoardWatch:
    return BoardWatch("adc", 0x10, TIMEOUT_NS, "adc.heartbeat_timeout_s")


def test_a_board_without_any_heartbeat_is_silent_but_not_lost() -> None:
    board = watch()
    assert not board.is_up
    assert board.describe() == "silent"
    assert board.check_timeout(10**18) is None


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


def test_the_start_command_has_the_boards_node_id() -> None:
    assert BoardWatch("dac", 0x20, 1, "x").heartbeat(NmtState.BOOT_UP, 0) == Frame(0x000, b"\x01\x20")


def test_an_operational_board_is_up_and_is_not_started() -> None:
    board = watch()
    assert board.heartbeat(5, 0) is None
    assert board.is_up
    assert board.describe() == "operational"


def test_a_heartbeat_may_take_exactly_the_timeout() -> None:
    board = watch()
    board.heartbeat(NmtState.OPERATIONAL, 1000)
    assert board.check_timeout(1000 + TIMEOUT_NS) is None
    assert board.is_up
    assert board.check_timeout(1000 + TIMEOUT_NS + 1) == (
        "no heartbeat for 302 ms, limit 302 ms (rig: adc.heartbeat_timeout_s)"
    )


def test_every_heartbeat_restarts_the_timeout() -> None:
    board = watch()
    for now_ns in range(0, 10 * TIMEOUT_NS, TIMEOUT_NS):
        board.heartbeat(NmtState.OPERATIONAL, now_ns)
        assert board.check_timeout(now_ns + TIMEOUT_NS) is None


def test_a_lost_board_is_reported_once_and_is_not_up() -> None:
    board = watch()
    board.heartbeat(NmtState.OPERATIONAL, 0)
    assert board.check_timeout(2 * TIMEOUT_NS) is not None
    assert not board.is_up
    assert board.describe() == "silent"
    assert board.check_timeout(3 * TIMEOUT_NS) is None


def test_a_board_that_comes_back_is_watched_again() -> None:
    board = watch()
    board.heartbeat(NmtState.OPERATIONAL, 0)
    board.check_timeout(2 * TIMEOUT_NS)
    assert board.heartbeat(NmtState.BOOT_UP, 3 * TIMEOUT_NS) == START
    assert board.heartbeat(NmtState.OPERATIONAL, 3 * TIMEOUT_NS) is None
    assert board.is_up
    assert board.check_timeout(4 * TIMEOUT_NS) is None
    assert board.check_timeout(4 * TIMEOUT_NS + 1) is not None


def test_a_board_that_is_not_operational_is_watched_too() -> None:
    board = watch()
    board.heartbeat(NmtState.PRE_OPERATIONAL, 0)
    assert board.check_timeout(TIMEOUT_NS + 1) is not None


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x8250, "RPDO did not come in time"),
        (0x8253, "RPDO did not come in time"),
        (0x8299, "protocol error"),
        (0x5030, "device hardware"),
        (0x5131, "device hardware"),
        (0xFF42, "device specific"),
        (0xA000, "unknown error"),
    ],
)
def test_an_emergency_is_described_by_the_known_digits_of_its_code(code: int, words: str) -> None:
    assert describe_emergency(code, 0x11, bytes(5)) == f"EMCY 0x{code:04X} ({words}), error register 0x11"


@pytest.mark.parametrize("identifier", [codec.EMCY_ADC, codec.EMCY_DAC])
def test_the_codes_and_their_texts_are_those_of_the_dbc(identifier: int) -> None:
    dbc = (files("hil.core.wire") / "arm.dbc").read_text()
    table = re.search(rf"(?m)^VAL_ {identifier} ErrorCode (.*) ;$", dbc)
    assert table is not None
    choices = {int(code): text for code, text in re.findall(r'(\d+) "(.*?)"', table[1])}
    assert choices == {0: "no error"} | EMERGENCIES


def test_vendor_bytes_are_described() -> None:
    text = describe_emergency(0x8200, 0x11, bytes((2, 7, 0, 0, 0)))
    assert text == "EMCY 0x8200 (protocol error), error register 0x11, vendor bytes 02 07 00 00 00"


def test_a_board_that_was_silent_must_settle_anew() -> None:
    """The time before the silence does not count: the board may have restarted meanwhile."""
    board = watch()
    for _ in range(IMMEDIATE_STARTS + 1):
        board.heartbeat(NmtState.PRE_OPERATIONAL, 0)
        board.starts.should_start(0)
        board.starts.start_sent(0)
    board.heartbeat(NmtState.OPERATIONAL, 1)
    assert not board.is_fit
    assert board.check_timeout(1 + 2 * TIMEOUT_NS) is not None
    board.heartbeat(NmtState.OPERATIONAL, 1 + SETTLED_NS)
    assert not board.is_fit
    board.heartbeat(NmtState.OPERATIONAL, 1 + 2 * SETTLED_NS)
    assert board.is_fit


def test_a_long_silence_is_given_in_milliseconds() -> None:
    board = watch()
    board.heartbeat(NmtState.OPERATIONAL, 10**15)
    assert (board.check_timeout(2 * 10**15) or "").startswith("no heartbeat for 1000000000 ms, limit 302 ms")


def test_only_a_restart_ends_an_error_without_a_report() -> None:
    board = watch()
    board.error = "EMCY 0x1000"
    for state in (NmtState.STOPPED, NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL):
        board.heartbeat(state, 0)
        assert board.error == "EMCY 0x1000"
    assert board.describe() == "operational, in error: EMCY 0x1000"
    assert not board.is_fit
    board.heartbeat(NmtState.BOOT_UP, 0)
    assert board.error is None


def test_the_state_says_how_many_starts_were_sent() -> None:
    board = watch()
    assert board.name == "adc"
    for sent in range(IMMEDIATE_STARTS + 2):
        board.heartbeat(NmtState.PRE_OPERATIONAL, 0)
        said = f"pre-operational after {sent} NMT starts"
        assert board.describe() == (said if sent >= IMMEDIATE_STARTS else "pre-operational")
        board.starts.should_start(0)
        board.starts.start_sent(0)
    board.heartbeat(NmtState.OPERATIONAL, 0)
    assert board.describe() == f"operational, but not settled after {IMMEDIATE_STARTS + 2} NMT starts"
