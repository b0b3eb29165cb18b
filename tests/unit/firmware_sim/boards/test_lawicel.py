"""The Lawicel adapter as a state machine: its answers follow the CAN232 manual, however bytes are split."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_sim.boards.lawicel import LawicelAdapter, frame_from_text, frame_to_text
from hil.core.frames import Frame

short_ids, long_ids = st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF)
any_frame = st.one_of(
    st.builds(lambda i, data: Frame(i, data), short_ids, st.binary(max_size=8)),
    st.builds(lambda i, data: Frame(i, data, is_extended=True), long_ids, st.binary(max_size=8)),
    st.builds(lambda i, n: Frame(i, bytes(n), is_remote=True), short_ids, st.integers(0, 8)),
    st.builds(lambda i, n: Frame(i, bytes(n), is_extended=True, is_remote=True), long_ids, st.integers(0, 8)),
)


def opened(commands: bytes = b"S6\rO\r") -> LawicelAdapter:
    adapter = LawicelAdapter()
    assert adapter.from_host(commands).to_host == b"\r" * commands.count(b"\r")
    return adapter


@given(any_frame)
def test_a_frame_survives_conversion_to_text_and_back(frame: Frame) -> None:
    text = frame_to_text(frame)
    assert frame_from_text(text) == frame
    assert frame_from_text(text[:1] + text[1:].lower()) == frame


@pytest.mark.parametrize(
    ("text", "frame"),
    [
        (b"t10021133", Frame(0x100, b"\x11\x33")),
        (b"t1000", Frame(0x100)),
        (b"T0000010021133", Frame(0x100, b"\x11\x33", is_extended=True)),
        (b"r1002", Frame(0x100, bytes(2), is_remote=True)),
        (b"R000001008", Frame(0x100, bytes(8), is_extended=True, is_remote=True)),
    ],
)
def test_examples_of_the_manual(text: bytes, frame: Frame) -> None:
    assert frame_from_text(text) == frame
    answer = opened().from_host(text + b"\r")
    assert answer.to_bus == (frame,)
    assert answer.to_host == (b"Z\r" if frame.is_extended else b"z\r")


@pytest.mark.parametrize(
    "text",
    [
        b"t",
        b"t100",
        b"t8000",  # over 11 bits
        b"T200000000",  # over 29 bits
        b"t1009112233445566778899",
        b"t10021",
        b"t1002112233",
        b"t10021G33",
        b"t+1021133",
        b"t1_021133",
        b"t 1021133",
        b"r10021133",
        b"T1002",
        b"x1000",
    ],
)
def test_an_invalid_frame_is_rejected(text: bytes) -> None:
    assert opened().from_host(text + b"\r") == (b"\a", ())


@pytest.mark.parametrize(
    ("before", "command", "answer"),
    [
        (b"", b"O", b"\a"),  # no bit rate yet
        (b"", b"L", b"\a"),
        (b"", b"C", b"\a"),
        (b"", b"S0", b"\r"),
        (b"", b"S8", b"\r"),
        (b"", b"S9", b"\a"),
        (b"", b"S", b"\a"),
        (b"", b"s031C", b"\r"),
        (b"", b"s31C", b"\a"),
        (b"", b"Z1", b"\r"),
        (b"", b"Z2", b"\a"),
        (b"", b"M00000000", b"\r"),
        (b"", b"mFFFFFFFF", b"\r"),
        (b"", b"mFFFF", b"\a"),
        (b"", b"X0", b"\r"),
        (b"", b"X1", b"\r"),
        (b"", b"X2", b"\a"),
        (b"", b"X", b"\a"),
        (b"", b"W0", b"\r"),
        (b"", b"W1", b"\r"),
        (b"", b"W2", b"\a"),
        (b"", b"U0", b"\r"),
        (b"", b"U6", b"\r"),
        (b"", b"U7", b"\a"),
        (b"", b"Q1", b"\a"),
        (b"", b"P", b"\a"),
        (b"", b"A", b"\a"),
        (b"S6\rO\r", b"Q0", b"\r"),
        (b"S6\rO\r", b"Q1", b"\r"),
        (b"S6\rO\r", b"Q2", b"\r"),
        (b"S6\rO\r", b"Q3", b"\a"),
        (b"S6\rO\r", b"Q", b"\a"),
        (b"S6\rO\r", b"X1", b"\a"),
        (b"S6\rO\r", b"W1", b"\a"),
        (b"S6\rO\r", b"U1", b"\a"),
        (b"S6\rO\r", b"P", b"\a"),  # with automatic polling there is nothing to poll
        (b"S6\rO\r", b"A", b"\a"),
        (b"X0\rS6\rO\r", b"P", b"\r"),
        (b"X0\rS6\rO\r", b"A", b"A\r"),
        (b"", b"V", b"V1013\r"),
        (b"", b"v", b"v0001\r"),
        (b"", b"N", b"NSIM1\r"),
        (b"", b"F", b"\a"),
        (b"", b"", b"\r"),
        (b"", b"?", b"\a"),
        (b"", b"t1000", b"\a"),
        (b"s031C\r", b"O", b"\r"),
        (b"S6\r", b"L", b"\r"),
        (b"S6\rO\r", b"O", b"\a"),
        (b"S6\rO\r", b"S6", b"\a"),
        (b"S6\rO\r", b"Z1", b"\a"),
        (b"S6\rO\r", b"M00000000", b"\a"),
        (b"S6\rO\r", b"V", b"V1013\r"),
        (b"S6\rO\r", b"F", b"F00\r"),
        (b"S6\rO\r", b"C", b"\r"),
        (b"S6\rL\r", b"t1000", b"\a"),
        (b"S6\rO\rC\r", b"O", b"\r"),
        (b"S6\rO\rC\r", b"t1000", b"\a"),
    ],
)
def test_commands_by_state(before: bytes, command: bytes, answer: bytes) -> None:
    assert opened(before).from_host(command + b"\r") == (answer, ())


def test_frames_from_the_bus_reach_the_host_only_while_the_channel_is_open() -> None:
    frame = Frame(0x190, b"\x40\x00")
    assert LawicelAdapter().from_bus(frame, 0) == b""
    assert opened().from_bus(frame, 0) == b"t19024000\r"
    assert opened(b"S6\rL\r").from_bus(frame, 0) == b"t19024000\r"
    assert opened(b"S6\rO\rC\r").from_bus(frame, 0) == b""
    assert opened().from_bus(Frame(4, bytes(8), is_error=True), 0) == b""


class TestPolling:
    def test_without_automatic_polling_frames_wait_for_the_host(self) -> None:
        adapter = opened(b"X0\rS6\rO\r")
        for identifier in (0x100, 0x101, 0x102):
            assert adapter.from_bus(Frame(identifier), 0) == b""
        assert adapter.from_host(b"P\r").to_host == b"t1000\r"
        assert adapter.from_host(b"A\r").to_host == b"t1010\rt1020\rA\r"
        assert adapter.from_host(b"P\rA\r").to_host == b"\rA\r"

    def test_a_frame_that_is_sent_is_answered_by_an_empty_line(self) -> None:
        adapter = opened(b"X0\rS6\rO\r")
        assert adapter.from_host(b"t1000\rT000001000\r").to_host == b"\r\r"

    def test_the_time_stamp_is_that_of_the_arrival(self) -> None:
        adapter = opened(b"X0\rZ1\rS6\rO\r")
        adapter.from_bus(Frame(0x100), 4_660_000_000)
        assert adapter.from_host(b"P\r").to_host == b"t10001234\r"

    def test_frames_that_do_not_fit_are_lost_and_flagged(self) -> None:
        adapter = opened(b"X0\rS6\rO\r")
        for number in range(40):
            adapter.from_bus(Frame(number), 0)
        assert adapter.from_host(b"A\r").to_host.count(b"t") == 32
        assert adapter.from_host(b"F\r").to_host == b"F01\r"

    def test_frames_that_wait_are_lost_when_the_channel_is_closed(self) -> None:
        adapter = opened(b"X0\rS6\rO\r")
        adapter.from_bus(Frame(1), 0)
        assert adapter.from_host(b"C\rO\rA\r").to_host == b"\r\rA\r"


class TestPowerOn:
    def test_the_channel_is_closed_and_has_no_bit_rate(self) -> None:
        adapter = opened()
        adapter.from_host(b"t10")
        adapter.overrun()
        adapter.power_on()
        assert adapter.from_host(b"O\rt1000\rS6\rO\rF\r") == (b"\a\a\r\rF00\r", ())

    def test_q1_opens_the_channel(self) -> None:
        adapter = opened(b"S6\rO\rQ1\r")
        adapter.power_on()
        assert adapter.from_host(b"t1000\r") == (b"z\r", (Frame(0x100),))

    def test_q2_opens_the_channel_as_a_listener(self) -> None:
        adapter = opened(b"S6\rO\rQ2\r")
        adapter.power_on()
        assert adapter.from_host(b"t1000\r") == (b"\a", ())
        assert adapter.from_bus(Frame(0x100), 0) == b"t1000\r"

    def test_polling_and_time_stamps_keep_their_settings(self) -> None:
        adapter = opened(b"X0\rZ1\rS6\rO\rQ1\r")
        adapter.power_on()
        assert adapter.from_bus(Frame(0x100), 0) == b""
        assert adapter.from_host(b"P\r").to_host == b"t10000000\r"


@pytest.mark.parametrize(
    ("now_ms", "stamp"), [(0, b"0000"), (4660, b"1234"), (59_999, b"EA5F"), (60_000, b"0000")]
)
def test_time_stamps_are_milliseconds_of_a_minute(now_ms: int, stamp: bytes) -> None:
    adapter = opened(b"Z1\rS6\rO\r")
    assert adapter.from_bus(Frame(0x100), now_ms * 1_000_000) == b"t1000" + stamp + b"\r"


def test_an_overrun_is_flagged_once() -> None:
    adapter = opened()
    adapter.overrun()
    assert adapter.from_host(b"F\rF\r").to_host == b"F01\rF00\r"


pieces = st.lists(
    st.sampled_from(
        [
            b"C\r",
            b"S6\r",
            b"O\r",
            b"L\r",
            b"Z1\r",
            b"X0\r",
            b"A\r",
            b"Q1\r",
            b"U1\r",
            b"W1\r",
            b"V\r",
            b"F\r",
            b"\r",
            b"\n",
            b"\a",
            b"t",
        ]
    )
    | any_frame.map(lambda frame: frame_to_text(frame) + b"\r")
    | st.binary(max_size=40),
    max_size=30,
).map(b"".join)


@given(pieces, st.lists(st.integers(0, 400), max_size=20))
def test_the_answers_do_not_depend_on_where_the_bytes_are_split(data: bytes, cuts: list[int]) -> None:
    whole, divided = opened(), opened()
    answer = whole.from_host(data)
    edges = [0, *sorted(cuts), len(data)]
    parts = [divided.from_host(data[start:end]) for start, end in pairwise(edges) if start <= end]
    assert b"".join(part.to_host for part in parts) == answer.to_host
    assert tuple(frame for part in parts for frame in part.to_bus) == answer.to_bus
    assert answer.to_host.count(b"\r") + answer.to_host.count(b"\a") == data.count(b"\r")


@given(st.binary(max_size=200), any_frame)
def test_a_line_end_resynchronises_the_adapter_after_garbage(garbage: bytes, frame: Frame) -> None:
    adapter = LawicelAdapter()
    adapter.from_host(garbage + b"\rC\rS6\rO\r")
    assert adapter.from_host(frame_to_text(frame) + b"\r").to_bus == (frame,)


def test_a_line_without_end_uses_no_memory_and_is_rejected() -> None:
    adapter = opened()
    for _ in range(1000):
        assert adapter.from_host(b"t1000" * 100) == (b"", ())
    assert len(adapter._line) < 100
    assert adapter.from_host(b"\rt1000\r") == (b"\az\r", (Frame(0x100),))
