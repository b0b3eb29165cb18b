"""SDO uploads and downloads of the simulated boards, frame by frame, against the layouts of CiA 301."""

from __future__ import annotations

import struct

import pytest
from support.board_bench import HEARTBEAT_NS, MS, START, STOP, SYNC, Bench, command, nmt

from firmware_sim.boards.faults import DacFaults
from hil.core.frames import Frame

ADC, DAC = 0x10, 0x20


def request(command: int, index: int, subindex: int = 0, data: bytes = b"") -> bytes:
    return struct.pack("<BHB", command, index, subindex) + data.ljust(4, b"\0")


def ask(bench: Bench, data: bytes, node: int = ADC) -> bytes:
    """Return the only answer to a request."""
    (answer,) = bench.give(Frame(0x600 + node, data))
    assert answer.id == 0x580 + node
    return answer.data


def upload(bench: Bench, index: int, subindex: int = 0, node: int = ADC) -> bytes:
    """Read an object: expedited, or in segments."""
    answer = ask(bench, request(0x40, index, subindex), node)
    assert answer[1:4] == struct.pack("<HB", index, subindex)
    if answer[0] & 0x02:
        return answer[4 : 8 - (answer[0] >> 2 & 3)]
    length, value, toggle = int.from_bytes(answer[4:], "little"), b"", 0
    while True:
        segment = ask(bench, bytes((0x60 | toggle,)) + bytes(7), node)
        assert segment[0] & 0x10 == toggle
        value += segment[1 : 8 - (segment[0] >> 1 & 7)]
        if segment[0] & 0x01:
            assert len(value) == length
            return value
        toggle ^= 0x10


def aborted(answer: bytes) -> int:
    command, code = answer[0], int.from_bytes(answer[4:], "little")
    assert command == 0x80
    return code


@pytest.mark.parametrize(
    ("node", "device_type", "name"),
    [(ADC, 0x0005_0191, b"Simulated potentiometer board"), (DAC, 0x0008_0191, b"Simulated valve board")],
)
def test_the_mandatory_objects_are_uploaded(node: int, device_type: int, name: bytes) -> None:
    bench = Bench()
    assert upload(bench, 0x1000, node=node) == struct.pack("<I", device_type)
    assert upload(bench, 0x1001, node=node) == b"\0"
    assert upload(bench, 0x1017, node=node) == struct.pack("<H", 100)
    identity = [upload(bench, 0x1018, subindex, node) for subindex in range(5)]
    assert identity == [b"\x04", *(struct.pack("<I", value) for value in (0, node, 0x10000, 1))]
    assert upload(bench, 0x1008, node=node) == name


def test_the_first_answer_is_laid_out_as_cia_301_says() -> None:
    bench = Bench()
    assert ask(bench, request(0x40, 0x1001)).hex() == "4f01100000000000"
    assert ask(bench, request(0x40, 0x1017)).hex() == "4b17100064000000"
    assert ask(bench, request(0x40, 0x1000)).hex() == "4300100091010500"
    assert ask(bench, request(0x40, 0x1008)).hex() == "410810001d000000"


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (request(0x40, 0x1002), 0x0602_0000),
        (request(0x40, 0x1018, 5), 0x0609_0011),
        (request(0x40, 0x1000, 1), 0x0609_0011),
        (request(0x40, 0x1003, 1), 0x0800_0024),
        (request(0x23, 0x1000, 0, b"\0"), 0x0601_0002),
        (request(0x2F, 0x1001, 0, b"\0"), 0x0601_0002),
        (request(0x23, 0x1002, 0, b"\0"), 0x0602_0000),
        (request(0x2F, 0x1017, 0, b"\x64"), 0x0607_0010),
        (request(0x2F, 0x1003, 0, b"\x01"), 0x0609_0030),
        (request(0x21, 0x1017, 0, b"\x02"), 0x0607_0010),
        (request(0x60, 0), 0x0504_0001),
        (request(0xA0, 0x1000), 0x0504_0001),
        (request(0x00, 0), 0x0504_0001),
    ],
    ids=[
        "no object",
        "no subindex",
        "a variable has subindex 0 only",
        "no error is kept",
        "read-only",
        "the error register is read-only",
        "download of no object",
        "one byte too short",
        "only 0 clears the errors",
        "segmented download",
        "a segment without upload",
        "block upload",
        "a segment of a download",
    ],
)
def test_what_cannot_be_is_aborted_with_the_code_of_cia_301(data: bytes, code: int) -> None:
    answer = ask(Bench(), data)
    assert aborted(answer) == code
    if data[1:4] != bytes(3):
        assert answer[1:4] == data[1:4]


def test_a_wrong_toggle_bit_aborts_the_upload() -> None:
    bench = Bench()
    ask(bench, request(0x40, 0x1008))
    assert aborted(ask(bench, bytes((0x70,)) + bytes(7))) == 0x0503_0000
    assert aborted(ask(bench, bytes((0x60,)) + bytes(7))) == 0x0504_0001


@pytest.mark.parametrize("data", [b"", bytes(7), bytes((0x80,)) + bytes(7)], ids=["empty", "short", "abort"])
def test_some_frames_get_no_answer(data: bytes) -> None:
    assert Bench().give(Frame(0x610, data)) == []


def test_an_abort_of_the_client_ends_the_upload() -> None:
    bench = Bench()
    ask(bench, request(0x40, 0x1008))
    bench.give(Frame(0x610, request(0x80, 0x1008)))
    assert aborted(ask(bench, bytes((0x60,)) + bytes(7))) == 0x0504_0001


def test_a_stopped_board_does_not_answer() -> None:
    bench = Bench()
    bench.give(nmt(STOP))
    assert bench.give(Frame(0x610, request(0x40, 0x1000))) == []


def test_a_new_heartbeat_interval_acts_from_the_write_on_until_a_reset() -> None:
    bench = Bench()
    bench.wait(30 * MS)
    assert ask(bench, request(0x2B, 0x1017, 0, b"\x32\0")).hex() == "6017100000000000"
    assert upload(bench, 0x1017) == b"\x32\0"
    beats = [frame for frame in bench.wait(200 * MS) if frame.id == 0x710]
    assert len(beats) == 4
    bench.give(nmt(129))
    assert upload(bench, 0x1017) == b"\x64\0"


def test_an_interval_of_zero_ends_the_heartbeat() -> None:
    bench = Bench()
    ask(bench, request(0x2B, 0x1017))
    assert {frame.id for frame in bench.wait(10 * HEARTBEAT_NS)} == {0x720}


def test_the_error_register_and_the_list_of_errors_show_an_emergency_until_it_ends() -> None:
    bench = Bench().started()
    bench.give(command((5, 5, 5), 1))
    bench.wait(10 * HEARTBEAT_NS)  # the watchdog reports 0x8250
    assert upload(bench, 0x1001, node=DAC) == b"\x11"
    assert upload(bench, 0x1003, 0, DAC) == b"\x01"
    assert upload(bench, 0x1003, 1, DAC) == struct.pack("<I", 0x8250)
    bench.give(command((5, 5, 5), 2))
    assert upload(bench, 0x1001, node=DAC) == b"\0"
    assert upload(bench, 0x1003, 1, DAC) == struct.pack("<I", 0x8250)
    assert ask(bench, request(0x2F, 0x1003), DAC)[0] == 0x60
    assert upload(bench, 0x1003, 0, DAC) == b"\0"


def test_the_list_of_errors_has_the_last_one_first_and_at_most_four() -> None:
    bench = Bench().started()
    for code in (0x1001, 0x2002, 0x3003, 0x4004, 0x5005):
        bench.rig.adc.faults = None
        bench.rig.dac.faults = DacFaults(emergency_code=code)
        bench.give(SYNC)
    assert upload(bench, 0x1003, 0, DAC) == b"\x04"
    assert [int.from_bytes(upload(bench, 0x1003, n, DAC), "little") for n in (1, 4)] == [0x5005, 0x2002]


@pytest.mark.parametrize(
    ("code", "register"), [(0x2310, 0x03), (0x3310, 0x05), (0x4200, 0x09), (0x5000, 0x01), (0x8130, 0x11)]
)
def test_a_board_that_ignores_nmt_start_shows_why(code: int, register: int) -> None:
    bench = Bench()
    bench.rig.dac.faults = DacFaults(start_prevented_by=code)
    bench.give(nmt(START))
    assert (bench.rig.adc.state, bench.rig.dac.state) == (5, 127)
    assert upload(bench, 0x1001, node=DAC) == bytes((register,))
    assert int.from_bytes(upload(bench, 0x1003, 1, DAC), "little") == code
    bench.rig.dac.faults = None
    bench.give(nmt(START))
    assert bench.rig.dac.state == 5
