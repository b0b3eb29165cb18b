"""Frames that the simulated boards send only if the rig file asks for them: inputs and read-back."""

from __future__ import annotations

import struct
from typing import Any

import msgspec
import pytest
from support.board_bench import RIG, STOP, SYNC, Bench, HandPlant, decoded, nmt, with_dac
from support.constants import CENTRED

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.arm_file import shipped_arm
from firmware_sim.arm.event_text import parse_event
from firmware_sim.boards.codec import crc8
from firmware_sim.boards.faults import AdcFaults, DacFaults
from firmware_sim.plants.combined_plant import CombinedPlant
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.frames import Frame
from hil.core.input_settings import InputSettings
from hil.core.rig import Rig

STOP_INPUT = InputSettings(frame=0x290, byte=0, bit=0, timeout_s=0.05)
ENABLE_INPUT = InputSettings(frame=0x290, byte=0, bit=1, timeout_s=0.05)
READ_BACK = with_dac(read_back=True)


def with_inputs(**inputs: Any) -> Rig:
    return msgspec.structs.replace(RIG, **inputs)


def inputs(bench: Bench, identifier: int = 0x290) -> list[bytes]:
    return [frame.data for frame in bench.give(SYNC) if frame.id == identifier]


def test_by_default_sync_is_answered_with_tpdo1_of_the_adc_board_alone() -> None:
    assert [frame.id for frame in Bench().started().give(SYNC)] == [0x190]


class TestInputs:
    def test_the_frame_follows_tpdo1_with_counter_and_crc(self) -> None:
        bench = Bench(with_inputs(emergency_stop=STOP_INPUT, enable=ENABLE_INPUT)).started()
        for counter in range(3):
            sample, frame = bench.give(SYNC)
            assert (sample.id, frame.id) == (0x190, 0x290)
            assert frame.data == bytes((3, counter, crc8(bytes((0x90, 0x02, 3, counter)))))

    def test_contacts_open_and_close(self) -> None:
        bench = Bench(with_inputs(emergency_stop=STOP_INPUT, enable=ENABLE_INPUT)).started()
        bench.rig.adc.faults = AdcFaults(emergency_stop_pressed=True)
        assert inputs(bench)[0][0] == 2
        bench.rig.adc.faults = AdcFaults(enable_released=True)
        assert inputs(bench)[0][0] == 1
        bench.rig.adc.faults = None
        assert inputs(bench)[0][0] == 3

    def test_each_identifier_has_a_frame_of_the_length_that_its_bytes_need(self) -> None:
        relay = InputSettings(frame=0x1A5, byte=2, bit=7, timeout_s=0.05, protected=False)
        bench = Bench(with_inputs(emergency_stop=STOP_INPUT, enable=relay)).started()
        assert [(frame.id, frame.data) for frame in bench.give(SYNC)[1:]] == [
            (0x290, bytes((1, 0, crc8(b"\x90\x02\x01\x00")))),
            (0x1A5, b"\0\0\x80"),
        ]

    def test_frames_can_be_lost_and_damaged(self) -> None:
        bench = Bench(with_inputs(emergency_stop=STOP_INPUT)).started()
        bench.rig.adc.faults = AdcFaults(silent_inputs=True)
        assert inputs(bench) == []
        bench.rig.adc.faults = AdcFaults(input_crcs_to_corrupt=1)
        bad, good = inputs(bench)[0], inputs(bench)[0]
        assert bad[2] != crc8(b"\x90\x02" + bad[:2]) and good[2] == crc8(b"\x90\x02" + good[:2])
        assert good[1] == 2

    def test_a_reset_begins_to_count_from_0(self) -> None:
        bench = Bench(with_inputs(emergency_stop=STOP_INPUT)).started()
        inputs(bench)
        bench.give(nmt(129))
        bench.started()
        assert inputs(bench)[0][1] == 0

    def test_before_the_start_no_frame_is_sent(self) -> None:
        assert inputs(Bench(with_inputs(emergency_stop=STOP_INPUT))) == []

    def test_events_of_the_arm_operate_the_contacts(self) -> None:
        arm = Arm(shipped_arm(), seed=0)
        rig = SimulatedRig(
            with_inputs(emergency_stop=STOP_INPUT, enable=ENABLE_INPUT), CombinedPlant([arm, HandPlant()])
        )
        rig.start(0)
        rig.receive(nmt(1), 0)

        def byte_after(event: str) -> int:
            arm.apply(parse_event(event))
            return rig.receive(SYNC, 0)[1].data[0]

        assert byte_after("emergency-stop:pressed@0") == 2
        assert arm.abnormal_conditions() == ["emergency stop open"]
        assert byte_after("enable-switch:released@0") == 0
        assert byte_after("emergency-stop:released@0") == 1
        assert byte_after("enable-switch:held@0") == 3
        assert arm.abnormal_conditions() == []


class TestReadBack:
    def test_each_sync_is_answered_with_the_voltages_after_it(self) -> None:
        bench = Bench(READ_BACK).started()
        bench.command(6.0, 5.0, 4.0)
        for counter in range(2):
            _, frame = bench.give(SYNC)
            assert frame.id == 0x1A0
            values = decoded(frame)
            assert values.counter == counter
            volts = [count * 10 / 32768 for count in values.counts]
            assert volts == pytest.approx([6.0, 5.0, 4.0], abs=0.0025)

    def test_a_frozen_channel_reads_back_its_own_voltage(self) -> None:
        bench = Bench(READ_BACK).started()
        bench.rig.dac.faults = DacFaults(frozen_v={2: 7.5})
        bench.command(5.0, 5.0, 5.0)
        _, frame = bench.give(SYNC)
        assert decoded(frame).counts == (16384, 24576, 16384)

    def test_the_watchdogs_centring_is_read_back(self) -> None:
        bench = Bench(READ_BACK).started()
        bench.command(9.0, 5.0, 5.0)
        bench.give(SYNC)
        bench.wait(200_000_000)
        assert bench.rig.dac.valve_v == CENTRED
        frame = next(frame for frame in bench.give(SYNC) if frame.id == 0x1A0)
        assert decoded(frame).counts == (16384,) * 3

    def test_without_protection_it_has_six_bytes(self) -> None:
        bench = Bench(with_dac(read_back=True, protected=False)).started()
        assert bench.give(SYNC)[1] == Frame(0x1A0, struct.pack("<hhh", 16384, 16384, 16384))

    def test_a_lost_read_back_leaves_a_gap_in_the_counter(self) -> None:
        bench = Bench(READ_BACK).started()
        bench.rig.dac.faults = DacFaults(silent_read_back=True)
        assert [frame.id for frame in bench.give(SYNC)] == [0x190]
        bench.rig.dac.faults = None
        assert bench.give(SYNC)[1].data[6] == 1

    def test_a_stopped_board_sends_none(self) -> None:
        bench = Bench(READ_BACK).started()
        bench.give(nmt(STOP, 0x20))
        assert [frame.id for frame in bench.give(SYNC)] == [0x190]
