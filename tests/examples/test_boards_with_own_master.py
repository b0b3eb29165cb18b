"""A user's master drives the simulated boards: it starts them, samples, and commands the valves."""

import struct

import pytest

PERIOD_S = 0.0112
SAMPLE = 0x190


def volts(sample):
    return [counts * 10 / 2**15 for counts in struct.unpack_from("<hhh", sample.data)]


class ProportionalMaster:
    """The smallest controller: vertical axis, u = 20 V/m times the error."""

    def __init__(self, boards, setpoint_m):
        self.boards = boards
        self.setpoint_m = setpoint_m
        self.position_m = 0.0

    def period(self):
        (sample,) = [frame for frame in self.boards.sync() if frame.id == SAMPLE]
        self.position_m = (volts(sample)[0] - 5.0) * 0.033
        self.boards.command((5.0 + 20.0 * (self.setpoint_m - self.position_m), 5.0, 5.0))
        self.boards.wait(PERIOD_S)


def test_boards_boot_and_answer_sync_after_they_are_started(boards_alone):
    assert [frame.id for frame in boards_alone.boot_frames] == [0x710, 0x720]
    assert boards_alone.sync() == []
    boards_alone.start_nodes()
    (sample,) = boards_alone.sync()
    assert volts(sample) == pytest.approx([5.0, 5.0, 5.0], abs=0.05)


def test_a_master_moves_the_arm(boards_alone):
    boards_alone.start_nodes()
    master = ProportionalMaster(boards_alone, setpoint_m=0.05)
    for _ in range(200):
        master.period()
    assert master.position_m == pytest.approx(0.05, abs=0.01)


def test_the_valves_are_centred_when_the_master_stops(boards_alone):
    boards_alone.start_nodes()
    master = ProportionalMaster(boards_alone, setpoint_m=0.1)
    for _ in range(5):
        master.period()
    assert boards_alone.valve_v[0] > 6.0
    frames = boards_alone.wait(0.1)
    assert boards_alone.valve_v == (5.0, 5.0, 5.0)
    assert [frame.data[:2] for frame in frames if frame.id == 0x0A0] == [b"\x50\x82"]  # RPDO timeout


def test_a_hung_board_keeps_its_valves(boards_alone):
    boards_alone.start_nodes()
    master = ProportionalMaster(boards_alone, setpoint_m=0.1)
    for _ in range(5):
        master.period()
    before = boards_alone.valve_v
    boards_alone.inject_fault("hang:dac@0")
    boards_alone.wait(1.0)
    assert boards_alone.valve_v == before
