"""The question to a board that ignores NMT start, and its answers in words (CiA 301, SDO upload)."""

from __future__ import annotations

import struct

import pytest

from hil.core.error_query import ANSWER_TIMEOUT_NS, ErrorQuery, Step, describe_error_register
from hil.core.frames import Frame

FIRST = Frame(0x620, bytes.fromhex("4001100000000000"))
SECOND = Frame(0x620, bytes.fromhex("4003100100000000"))


def answer(command: int, index: int, subindex: int, value: int) -> bytes:
    return struct.pack("<BHBI", command, index, subindex, value)


REGISTER = answer(0x4F, 0x1001, 0, 0x11)


def begun() -> ErrorQuery:
    query = ErrorQuery(0x20)
    assert query.begin(0) == FIRST
    return query


def finding(first: bytes, second: bytes) -> str | None:
    query = begun()
    assert query.answer(first, 0) == Step(request=SECOND)
    assert query.is_answer(second)
    step = query.answer(second, 0)
    assert step.request is None and step.finding == query.finding
    return step.finding


def test_register_and_last_error_are_put_into_words() -> None:
    assert finding(REGISTER, answer(0x43, 0x1003, 1, 0x0001_8130)) == (
        "error register 0x11 (generic error, communication error, 1001h); last error 0x8130 (heartbeat or "
        "life guard error) (1003h)"
    )


def test_an_upload_without_a_stated_size_is_read_too() -> None:
    assert finding(answer(0x42, 0x1001, 0, 0x04), answer(0x42, 0x1003, 1, 0x3100)) == (
        "error register 0x04 (voltage, 1001h); last error 0x3100 (mains voltage) (1003h)"
    )


@pytest.mark.parametrize(
    ("code", "words"),
    [(0x0800_0024, "no data"), (0x0602_0000, "no such object"), (0x1234_5678, "unknown abort code")],
)
def test_an_abort_is_put_into_words(code: int, words: str) -> None:
    assert finding(answer(0x80, 0x1001, 0, code), answer(0x80, 0x1003, 1, code)) == (
        f"error register not readable: abort 0x{code:08X}, {words} (1001h); last error not readable: abort "
        f"0x{code:08X}, {words} (1003h)"
    )


def test_a_segmented_answer_is_not_read() -> None:
    text = finding(answer(0x41, 0x1001, 0, 5), answer(0x41, 0x1003, 1, 5))
    assert text is not None and text.count("the answer has more than four bytes") == 2


@pytest.mark.parametrize(
    ("register", "words"),
    [
        (0x00, "no error"),
        (0x01, "generic error"),
        (0x0A, "current, temperature"),
        (0x20, "device profile"),
        (0xC0, "reserved, manufacturer specific"),
    ],
)
def test_each_bit_of_the_register_has_its_word(register: int, words: str) -> None:
    assert describe_error_register(register) == f"0x{register:02X} ({words}, 1001h)"


@pytest.mark.parametrize(
    "data",
    [
        answer(0x4F, 0x1001, 1, 0),  # another subindex
        answer(0x43, 0x1003, 1, 0),  # not asked yet
        answer(0x60, 0x1001, 0, 0),  # the answer to a download
        answer(0x40, 0x1001, 0, 0)[:7],
        b"",
    ],
)
def test_any_other_frame_is_no_answer(data: bytes) -> None:
    assert not begun().is_answer(data)


def test_an_answer_that_nobody_awaits_is_none() -> None:
    query = ErrorQuery(0x20)
    assert not query.is_answer(REGISTER)
    query.begin(0)
    assert query.is_answer(REGISTER)
    query.answer(REGISTER, 0)
    assert not query.is_answer(REGISTER)
    query.reset()
    assert not query.is_answer(answer(0x43, 0x1003, 1, 0))


def test_a_silent_board_is_reported_after_the_timeout() -> None:
    query = begun()
    assert query.check_timeout(ANSWER_TIMEOUT_NS) is None
    step = query.check_timeout(ANSWER_TIMEOUT_NS + 1)
    assert step == Step(finding="no answer to SDO (1001h:0) within 500 ms")
    assert query.check_timeout(10 * ANSWER_TIMEOUT_NS) is None


def test_the_register_is_kept_if_the_second_answer_does_not_come() -> None:
    query = begun()
    query.answer(REGISTER, 1000)
    step = query.check_timeout(1000 + ANSWER_TIMEOUT_NS + 1)
    assert step == Step(
        finding="error register 0x11 (generic error, communication error, 1001h); no answer to SDO (1003h:1) "
        "within 500 ms"
    )
