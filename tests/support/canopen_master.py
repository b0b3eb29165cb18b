"""Tests of the simulated boards with the ``canopen`` library as their master, for any bus.

The test class of a bus inherits ``CanopenMasterContract`` and defines two fixtures: ``spec`` is the bus as
``firmware-sim`` names it, ``bus`` is the same bus as python-can opens it.
"""

from __future__ import annotations

import multiprocessing
import queue
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import can
import canopen
import pytest
from canopen.objectdictionary import (
    INTEGER16,
    UNSIGNED8,
    UNSIGNED32,
    ObjectDictionary,
    ODRecord,
    ODVariable,
)

from firmware_sim import cli
from firmware_sim.plants.linear_plant import LinearPlant
from support.constants import PERIOD_S
from support.shipped_rig import SHIPPED_RIG
from support.wire import frame_crc

LIMIT_S = 20
CENTRE = 16384
VOLTS = 10 / 32768

ANALOGUE_INPUT, ANALOGUE_OUTPUT = 0x6401, 0x6411
COUNTER_AND_CRC = 0x2000


def record(name: str, index: int, types: list[int], values: list[int]) -> ODRecord:
    made = ODRecord(name, index)
    for subindex, (data_type, value) in enumerate(zip(types, values, strict=True)):
        variable = ODVariable(f"{name} {subindex}", index, subindex)
        variable.data_type = data_type
        variable.default = value
        made.add_member(variable)
    return made


def dictionary(communication: int, mapping: int, cob_id: int, channels: int) -> ObjectDictionary:
    """Return an object dictionary (CiA 401): three channels of 16 bits, then a counter and a CRC."""
    mapped = [channels << 16 | n << 8 | 16 for n in (1, 2, 3)] + [
        COUNTER_AND_CRC << 16 | n << 8 | 8 for n in (1, 2)
    ]
    made = ObjectDictionary()
    made.add_object(
        record("PDO communication", communication, [UNSIGNED8, UNSIGNED32, UNSIGNED8], [2, cob_id, 1])
    )
    made.add_object(record("PDO mapping", mapping, [UNSIGNED8] + [UNSIGNED32] * 5, [5, *mapped]))
    made.add_object(record("channel", channels, [UNSIGNED8] + [INTEGER16] * 3, [3, 0, 0, 0]))
    made.add_object(record("protection", COUNTER_AND_CRC, [UNSIGNED8] * 3, [2, 0, 0]))
    return made


def drain(waiting: queue.SimpleQueue[Any]) -> None:
    while not waiting.empty():
        waiting.get()


class Board:
    """A remote node, and queues of the states and emergencies that it reported."""

    def __init__(self, network: canopen.Network, node_id: int, od: ObjectDictionary) -> None:
        self.node: canopen.RemoteNode = network.add_node(node_id, od)
        self.states: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.node.nmt.add_heartbeat_callback(self.states.put)
        self.emergencies: queue.SimpleQueue[canopen.emcy.EmcyError] = queue.SimpleQueue()
        self.node.emcy.add_callback(self.emergencies.put)

    def wait_for(self, state: int) -> None:
        while self.states.get(timeout=LIMIT_S) != state:
            pass

    def emergency(self) -> tuple[int, int]:
        emergency = self.emergencies.get(timeout=LIMIT_S)
        return emergency.code, emergency.register


class Master:
    """A CANopen master with both boards, their mapped PDOs, and the counter of the commands."""

    def __init__(self, bus: can.BusABC) -> None:
        self.network = canopen.Network(bus)
        self.network.NOTIFIER_CYCLE = 0.1
        self.adc = Board(self.network, 0x10, dictionary(0x1800, 0x1A00, 0x190, ANALOGUE_INPUT))
        self.dac = Board(self.network, 0x20, dictionary(0x1400, 0x1600, 0x220, ANALOGUE_OUTPUT))
        self.adc.node.tpdo[1].read(from_od=True)
        self.dac.node.rpdo[1].read(from_od=True)
        self.samples: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
        self.adc.node.tpdo[1].add_callback(lambda pdo: self.samples.put((pdo.timestamp, bytes(pdo.data))))
        self.network.connect()
        self.counter = 0

    def reset(self) -> None:
        """Reset both boards and start them, whatever their state is."""
        for board in (self.adc, self.dac):
            drain(board.states)
            board.node.nmt.state = "RESET"
            board.wait_for(0)
            board.node.nmt.state = "OPERATIONAL"
            board.wait_for(5)
            drain(board.emergencies)
            board.node.emcy.reset()
        drain(self.samples)

    def sample(self) -> float:
        """Send SYNC. Returns the time at which TPDO1 arrived, in seconds."""
        self.network.sync.transmit()
        return self.samples.get(timeout=LIMIT_S)[0]

    def command(self, *counts: int, crc_error: int = 0) -> None:
        rpdo = self.dac.node.rpdo[1]
        for channel, count in enumerate(counts):
            rpdo[channel].raw = count
        self.counter = (self.counter + 1) & 0xFF
        rpdo[3].raw = self.counter
        rpdo[4].raw = frame_crc(0x220, bytes(rpdo.data[:7])) ^ crc_error
        rpdo.transmit()

    def potentiometer_v(self, channel: int) -> float:
        """Return the voltage of a channel (counted from 0) in the last sample."""
        return float(self.adc.node.tpdo[1][channel].raw * VOLTS)


class CanopenMasterContract:
    @pytest.fixture(scope="class")
    @classmethod
    def boards(cls, spec: str, bus: can.BusABC) -> Iterator[Master]:
        master = Master(bus)
        process = multiprocessing.get_context("fork").Process(
            target=cli.main, args=(["--linear", "--bus", spec],), daemon=True
        )
        process.start()
        master.adc.wait_for(0)
        master.dac.wait_for(0)
        yield master
        process.terminate()
        process.join(LIMIT_S)
        master.network.disconnect()
        assert process.exitcode == 0

    @pytest.fixture
    def master(self, boards: Master) -> Master:
        boards.reset()
        return boards

    @pytest.mark.parametrize(
        ("command", "state"), [("PRE-OPERATIONAL", 127), ("STOPPED", 4), ("OPERATIONAL", 5)]
    )
    def test_an_nmt_command_reaches_one_board_and_changes_its_heartbeat(
        self, master: Master, command: str, state: int
    ) -> None:
        master.adc.node.nmt.state = command
        master.adc.wait_for(state)
        assert master.adc.node.nmt.wait_for_heartbeat(LIMIT_S) == command
        assert master.dac.node.nmt.wait_for_heartbeat(LIMIT_S) == "OPERATIONAL"

    @pytest.mark.parametrize("command", ["RESET", "RESET COMMUNICATION"])
    def test_a_reset_of_all_nodes_boots_both_boards_into_pre_operational(
        self, master: Master, command: str
    ) -> None:
        master.network.nmt.state = command
        for board in (master.adc, master.dac):
            board.wait_for(0)
            assert board.states.get(timeout=LIMIT_S) == 127

    def test_heartbeats_come_every_tenth_of_a_second(self, master: Master) -> None:
        stamps = []
        for _ in range(6):
            master.dac.node.nmt.wait_for_heartbeat(LIMIT_S)
            stamps.append(master.dac.node.nmt.timestamp)
        gaps = sorted(later - sooner for sooner, later in pairwise(stamps))
        assert gaps[2] == pytest.approx(0.1, abs=0.02)

    def test_each_sync_gets_one_sample_with_counter_and_crc(self, master: Master) -> None:
        master.network.sync.start(PERIOD_S)
        samples = [master.samples.get(timeout=LIMIT_S)[1] for _ in range(50)]
        master.network.sync.stop()
        assert [sample[6] for sample in samples] == list(range(50))
        assert [sample[7] for sample in samples] == [frame_crc(0x190, sample[:7]) for sample in samples]

    def test_a_command_moves_the_axis_as_the_model_predicts(self, master: Master) -> None:
        """0.3 V for 0.4 s, from rest. The other axes do not move."""
        offset_v = 0.3
        command = CENTRE + round(offset_v / VOLTS / 8) * 8
        master.sample()
        before_v = [master.potentiometer_v(channel) for channel in range(3)]
        master.command(command, CENTRE, CENTRE)
        began_s = now_s = master.sample()
        while now_s - began_s < 0.4:
            master.command(command, CENTRE, CENTRE)
            now_s = master.sample()
        plant = LinearPlant(SHIPPED_RIG)
        plant.advance(round((now_s - began_s) * 1e9), [5.0 + (command - CENTRE) * VOLTS, 5.0, 5.0])
        moved_v = [master.potentiometer_v(channel) - before_v[channel] for channel in range(3)]
        # On a machine that stalls, the watchdog may centre the valves at times: the axis moves less, never
        # more.
        assert 0.2 < moved_v[0] < plant.potentiometer_v()[0] - 5.0 + 0.1
        assert moved_v[1:] == pytest.approx([0.0, 0.0], abs=0.01)

    def test_missing_commands_are_reported_by_emcy_until_a_good_one(self, master: Master) -> None:
        master.command(CENTRE, CENTRE, CENTRE)
        assert master.dac.emergency() == (0x8250, 0x11)
        assert [error.code for error in master.dac.node.emcy.active] == [0x8250]
        master.command(CENTRE, CENTRE, CENTRE)
        assert master.dac.emergency() == (0, 0)
        assert master.dac.node.emcy.active == []

    def test_a_command_with_a_bad_crc_is_reported_by_emcy(self, master: Master) -> None:
        master.command(CENTRE, CENTRE, CENTRE, crc_error=0x01)
        assert master.dac.emergency() == (0x8200, 0x11)
        master.command(CENTRE, CENTRE, CENTRE)
        assert master.dac.emergency() == (0, 0)

    def test_a_missing_gateway_heartbeat_is_reported_by_emcy(self, master: Master) -> None:
        master.network.send_message(0x701, b"\x05")
        assert master.dac.emergency() == (0x8130, 0x11)
        master.network.send_message(0x701, b"\x05")
        assert master.dac.emergency() == (0, 0)

    def test_sdo_reads_the_identity_and_a_name_in_segments(self, master: Master) -> None:
        for board, name in (
            (master.adc, b"Simulated potentiometer board"),
            (master.dac, b"Simulated valve board"),
        ):
            sdo = board.node.sdo
            assert sdo.upload(0x1008, 0) == name
            identity = [int.from_bytes(sdo.upload(0x1018, subindex), "little") for subindex in range(5)]
            assert identity == [4, 0, board.node.id, 0x10000, 1]
            assert sdo.upload(0x1001, 0) == b"\0"

    def test_sdo_sets_the_interval_of_the_heartbeat_and_aborts_other_downloads(self, master: Master) -> None:
        sdo = master.adc.node.sdo
        sdo.download(0x1017, 0, (50).to_bytes(2, "little"))
        assert sdo.upload(0x1017, 0) == b"\x32\0"
        for index, code in ((0x1000, 0x06010002), (0x2345, 0x06020000)):
            with pytest.raises(canopen.SdoAbortedError) as caught:
                sdo.download(index, 0, bytes(4))
            assert caught.value.code == code

    def test_the_scanner_finds_both_boards(self, master: Master) -> None:
        master.network.scanner.reset()
        for board in (master.adc, master.dac):
            board.wait_for(5)
        assert sorted(master.network.scanner.nodes) == [0x10, 0x20]
