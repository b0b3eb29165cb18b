"""Frames of a second master, and unknown frames."""

from __future__ import annotations

import pytest
from support.constants import CENTRED
from support.gateway_bench import LIVE_STATES, commands, faults, make_stepped, sample_frame, texts

from hil.core.foreign_frames import COMMANDS_TO_BOARDS
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import Output
from hil.core.wire import codec

FOREIGN = {
    "RPDO1_DAC": Frame(codec.RPDO1_DAC, bytes(8)),
    "SYNC": Frame(codec.SYNC),
    "NMT": Frame(codec.NMT, b"\x01\x00"),
    "HEARTBEAT_GATEWAY": Frame(codec.HEARTBEAT_GATEWAY, b"\x05"),
}


class TestSecondMaster:
    @pytest.mark.parametrize("state", LIVE_STATES)
    @pytest.mark.parametrize("name", FOREIGN)
    def test_a_received_frame_that_only_the_gateway_sends_is_a_fault(
        self, name: str, state: LifeCycleState
    ) -> None:
        gateway = make_stepped(state)
        output = gateway.receive(FOREIGN[name])
        assert gateway.state is LifeCycleState.FAULT
        assert faults(output) == [
            f"bus: foreign {name} frame {FOREIGN[name]}: another master is on this bus; disconnect it"
        ]
        assert commands(output) == [CENTRED]

    def test_commands_to_the_boards_are_rpdo_2_to_4_and_sdo(self) -> None:
        assert list(COMMANDS_TO_BOARDS) == [0x320, 0x420, 0x520, 0x620, 0x610]

    @pytest.mark.parametrize(
        ("identifier", "words"),
        [
            (0x320, "RPDO2 to the DAC board"),
            (0x420, "RPDO3 to the DAC board"),
            (0x520, "RPDO4 to the DAC board"),
            (0x620, "SDO to the DAC board"),
            (0x610, "SDO to the ADC board"),
        ],
    )
    def test_the_fault_names_the_command(self, identifier: int, words: str) -> None:
        frame = Frame(identifier, bytes(8))
        reason = f"bus: {words}, frame {frame}: another master is on this bus; disconnect it"
        assert faults(make_stepped(LifeCycleState.ARMED).receive(frame)) == [reason]

    @pytest.mark.parametrize("identifier", COMMANDS_TO_BOARDS)
    def test_a_received_command_to_a_board_is_a_fault_once_armed(self, identifier: int) -> None:
        frame = Frame(identifier, bytes(8))
        for state in (LifeCycleState.OFFLINE, LifeCycleState.READY):
            gateway = make_stepped(state)
            assert "is not in arm.dbc" in texts(gateway.receive(frame))[0]
            assert gateway.state is state
        for state in (LifeCycleState.ARMED, LifeCycleState.RUNNING):
            gateway = make_stepped(state)
            output = gateway.receive(frame)
            assert commands(output) == [CENTRED]
            assert faults(output)[0].endswith("another master is on this bus; disconnect it")

    def test_an_extended_frame_of_the_same_number_does_not_suppress_a_report(self) -> None:
        gateway = make_stepped(LifeCycleState.FAULT)
        gateway.receive(Frame(0x080, is_extended=True))
        assert len(texts(gateway.receive(FOREIGN["SYNC"]))) == 1

    @pytest.mark.parametrize("data", [b"", b"\0", bytes(8)])
    def test_the_data_of_such_a_frame_does_not_matter(self, data: bytes) -> None:
        for frame in FOREIGN.values():
            gateway = make_stepped(LifeCycleState.RUNNING)
            gateway.receive(frame._replace(data=data))
            assert gateway.state is LifeCycleState.FAULT

    def test_in_fault_each_identifier_is_reported_once(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        reports = []
        for _ in range(100):
            reports += texts(gateway.receive(*FOREIGN.values()))
        assert [text.split(" ")[2] for text in reports if text.startswith("bus")] == list(FOREIGN)

    def test_after_a_reset_such_a_frame_is_a_fault_again(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.receive(*FOREIGN.values())
        gateway.operate(Trigger.RESET)
        assert faults(gateway.receive(FOREIGN["SYNC"]))


UNKNOWN = {
    "unknown": Frame(0x123, b"\x01"),
    "extended": Frame(0x190, bytes(8), is_extended=True),
    "remote": Frame(0x190, b"", is_remote=True),
    "extended RPDO1": Frame(0x220, bytes(8), is_extended=True),
    "remote SYNC": Frame(0x080, b"", is_remote=True),
    "another node's TPDO": Frame(0x191, bytes(8)),
    "SDO": Frame(0x590, bytes(8)),
}


class TestUnknownFrames:
    @pytest.mark.parametrize("kind", UNKNOWN)
    @pytest.mark.parametrize("state", LifeCycleState)
    def test_an_unknown_frame_is_reported_once_and_changes_nothing(
        self, kind: str, state: LifeCycleState
    ) -> None:
        gateway = make_stepped(state)
        frame = UNKNOWN[kind]
        output = gateway.receive(frame)
        assert output.frames == ()
        assert texts(output) == [
            f"bus: frame {frame} is not in arm.dbc; further frames with its identifier are not reported"
        ]
        for _ in range(3):
            assert gateway.receive(frame) == Output()
        assert gateway.state is state

    @pytest.mark.parametrize(
        ("identifier", "words"),
        [
            (0x1A0, "TPDO1_DAC, which this rig does not use (rig: dac.read_back)"),
            (0x290, "TPDO2_ADC, which this rig does not use (rig: emergency_stop.frame, enable.frame)"),
        ],
    )
    def test_a_frame_that_the_rig_file_could_use_is_named(self, identifier: int, words: str) -> None:
        frame = Frame(identifier, b"\x01")
        assert texts(make_stepped().receive(frame)) == [
            f"bus: frame {frame} is {words}; further frames with its identifier are not reported"
        ]

    def test_an_extended_frame_has_no_meaning_of_a_standard_one(self) -> None:
        frame = Frame(0x1A0, b"\x01", is_extended=True)
        assert f"frame {frame} is not in arm.dbc" in texts(make_stepped().receive(frame))[0]

    def test_the_number_of_reported_identifiers_is_limited(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        reports = [
            gateway.receive(Frame(identifier, is_extended=True)).log for identifier in range(1000, 1500)
        ]
        assert sum(map(len, reports)) == 64
        assert gateway.state is LifeCycleState.RUNNING

    def test_an_extended_frame_with_the_samples_identifier_is_no_sample(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline()
        sample = sample_frame(CENTRED, gateway.counter)
        assert gateway.receive(sample._replace(is_extended=True)).frames == ()
        assert len(commands(gateway.sample())) == 1
