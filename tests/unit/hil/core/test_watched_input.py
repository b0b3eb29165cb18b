"""One contact: closed by fresh frames, open by its bit, unknown without good frames."""

from __future__ import annotations

import pytest
from support.protected_rigs import TIMEOUT_NS, inputs_frame

from hil.core.input_settings import InputSettings
from hil.core.watched_input import WatchedInput

NAME = "emergency_stop"


def contact(byte: int = 0, bit: int = 0, protected: bool = True) -> WatchedInput:
    settings = InputSettings(frame=0x290, byte=byte, bit=bit, timeout_s=0.05, protected=protected)
    return WatchedInput(NAME, settings, 2, "it is pressed")


def give(watched: WatchedInput, bits: int, counter: int, now_ns: int = 0, crc_error: int = 0) -> str | None:
    return watched.receive(inputs_frame(bits, counter, crc_error).data, now_ns)


def test_without_any_frame_the_contact_is_not_closed() -> None:
    assert contact().problem(10**12) == (
        "no frame 0x290 has shown the contact closed (rig: emergency_stop.frame): check the module that "
        "sends it"
    )


def test_a_frame_closes_the_contact_for_exactly_the_timeout() -> None:
    watched = contact()
    assert give(watched, 1, 0, now_ns=1000) is None
    assert watched.problem(1000 + TIMEOUT_NS) is None
    assert watched.problem(1000 + TIMEOUT_NS + 1_000_000) == (
        "no good frame 0x290 for 51.0 ms, limit 50 ms (rig: emergency_stop.timeout_s)"
    )
    assert watched.problem(1000 + TIMEOUT_NS + 1) is not None


def test_a_cleared_bit_opens_the_contact_at_once() -> None:
    watched = contact()
    give(watched, 1, 0)
    assert give(watched, 0xFE, 1) is None
    assert watched.problem(0) == (
        "the contact is open: bit 0 of byte 0 of frame 0x290 is 0 (rig: emergency_stop): it is pressed"
    )
    give(watched, 1, 2)
    assert watched.problem(0) is None


@pytest.mark.parametrize("counter", [0, 255, 129])
def test_a_cleared_bit_opens_the_contact_whatever_the_counter_is(counter: int) -> None:
    watched = contact()
    give(watched, 1, 0)
    assert give(watched, 0, counter) is None
    assert watched.problem(0) is not None


def test_a_repeated_counter_proves_nothing() -> None:
    watched = contact()
    give(watched, 1, 7)
    for now_ns in range(0, 2 * TIMEOUT_NS, TIMEOUT_NS // 4):
        assert give(watched, 1, 7, now_ns) in (None, "frame 0x290: counter 7 after 7 is no newer frame")
    assert watched.problem(2 * TIMEOUT_NS) == (
        "no good frame 0x290 for 100.0 ms, limit 50 ms (rig: emergency_stop.timeout_s); last frame rejected: "
        "frame 0x290: counter 7 after 7 is no newer frame"
    )


@pytest.mark.parametrize(
    ("step", "is_newer"), [(1, True), (127, True), (128, False), (255, False), (0, False)]
)
def test_a_counter_may_advance_by_1_to_127(step: int, is_newer: bool) -> None:
    watched = contact()
    give(watched, 1, 200)
    assert (give(watched, 1, 200 + step) is None) is is_newer


def test_after_a_restart_of_the_module_its_second_frame_is_taken() -> None:
    watched = contact()
    give(watched, 1, 100)
    assert give(watched, 1, 0, TIMEOUT_NS) == "frame 0x290: counter 0 after 100 is no newer frame"
    assert give(watched, 1, 1, TIMEOUT_NS) is None
    assert watched.problem(2 * TIMEOUT_NS) is None


@pytest.mark.parametrize("bits", [0, 1])
def test_a_damaged_frame_proves_nothing(bits: int) -> None:
    watched = contact()
    give(watched, 1, 0)
    rejection = give(watched, bits, 1, crc_error=1)
    assert rejection is not None and rejection.startswith("frame 0x290: CRC 0x")
    assert watched.problem(TIMEOUT_NS) is None
    assert watched.problem(TIMEOUT_NS + 1) is not None


def test_a_short_frame_is_rejected() -> None:
    assert contact().receive(b"\x01\x00", 0) == "frame 0x290 has 2 bytes, and needs 3 (rig: emergency_stop)"
    assert contact(byte=3, protected=False).receive(b"\xff\xff\xff", 0) == (
        "frame 0x290 has 3 bytes, and needs 4 (rig: emergency_stop)"
    )


def test_without_protection_each_frame_counts() -> None:
    watched = contact(byte=3, bit=5, protected=False)
    for now_ns in (0, TIMEOUT_NS, 2 * TIMEOUT_NS):
        assert watched.receive(b"\0\0\0\x20", now_ns) is None
        assert watched.problem(now_ns) is None
    assert watched.receive(b"\xff\xff\xff\xdf\xff", 2 * TIMEOUT_NS) is None
    assert watched.problem(2 * TIMEOUT_NS) is not None


def test_the_reason_of_a_rejection_is_named_until_a_good_frame_arrives() -> None:
    watched = contact()
    rejection = give(watched, 1, 0, crc_error=1)
    assert rejection is not None
    problem = watched.problem(0)
    assert problem is not None
    assert problem.endswith(f"; last frame rejected: {rejection}")
    give(watched, 0, 1)
    problem = watched.problem(0)
    assert problem is not None
    assert problem.endswith(": it is pressed")


def test_a_contact_that_was_closed_again_is_missing_and_not_open() -> None:
    watched = contact()
    give(watched, 0, 0)
    give(watched, 1, 1, now_ns=0)
    problem = watched.problem(2 * TIMEOUT_NS)
    assert problem is not None
    assert problem.startswith("no good frame 0x290 for 100.0 ms")
