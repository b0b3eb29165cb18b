"""When faults of the library begin and end, and that the same run gives the same bytes."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.board_bench import RIG, START, SYNC, HandPlant, command, nmt

from firmware_sim.fault_effects import BUS_OFF_FRAME
from firmware_sim.faulty_rig import FaultyRig
from firmware_sim.simulated_rig import SimulatedRig
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.lockstep_rig import LockstepRig
from hil.recording.recorder import FAULT_SOURCE, FAULTS_BEGUN
from hil.shells.replay import verify

MS = 1_000_000
SAMPLE, DAC_HEARTBEAT = 0x190, 0x720


class FaultyBench:
    """Boards with faults, started, and a clock that only the test moves."""

    def __init__(self, *faults: str, seed: int = 0) -> None:
        self.plant = HandPlant()
        self.boards = SimulatedRig(RIG, self.plant)
        self.rig = FaultyRig(RIG, self.boards, faults, seed=seed)
        self.now_ns = 0
        self.rig.start(0)
        self.send(nmt(START))

    def send(self, frame: Frame) -> list[Frame]:
        return list(self.rig.receive(frame, self.now_ns))

    def wait_until(self, end_ns: int) -> list[Frame]:
        frames: list[Frame] = []
        while self.rig.next_deadline_ns <= end_ns:
            self.now_ns = self.rig.next_deadline_ns
            frames += self.rig.on_deadline(self.now_ns)
        self.now_ns = end_ns
        return frames

    def samples(self, times_ms: list[int]) -> list[int]:
        """Send SYNC at these times; return those at which a sample arrived."""
        arrived = []
        for time_ms in times_ms:
            self.wait_until(time_ms * MS)
            if any(frame.id == SAMPLE for frame in self.send(SYNC)):
                arrived.append(time_ms)
        return arrived


def test_times_count_from_the_first_sample_and_a_duration_ends_a_fault() -> None:
    bench = FaultyBench("lose:sample@0.02/0.03")
    assert bench.samples([100, 110, 120, 130, 140, 150, 160]) == [100, 110, 150, 160]


def test_a_fault_that_begins_with_the_first_sample_affects_it() -> None:
    assert FaultyBench("lose:sample,2@0").samples([100, 110, 120, 130]) == [120, 130]


def test_a_position_is_a_condition() -> None:
    bench = FaultyBench("lose:sample,1@vertical>0.05")
    bench.plant.volts[0] = 6.0  # 0.033 m
    assert bench.samples([100, 110]) == [100, 110]
    bench.plant.volts[0] = 7.0  # 0.066 m
    assert bench.samples([120, 130]) == [130]
    assert bench.rig.begun == [(120 * MS, "lose:sample,1@vertical>0.05")]


def test_a_time_may_follow_a_condition() -> None:
    bench = FaultyBench("lose:sample,1@vertical<-0.05+0.015")
    bench.plant.volts[0] = 3.0
    assert bench.samples([100, 110, 120, 130]) == [100, 110, 130]


def test_running_is_the_first_command_that_is_not_the_centre() -> None:
    bench = FaultyBench("hang:adc@running")
    bench.send(command((5.0, 5.0, 5.0), 0))
    assert bench.samples([100]) == [100]
    bench.send(command((5.0, 5.1, 5.0), 1))
    assert bench.samples([110]) == []


@pytest.mark.parametrize(
    ("condition", "states", "begins"),
    [
        ("armed", "offline ready armed", True),
        ("fault", "offline ready armed running", False),
        ("fault", "offline ready armed running fault", True),
        ("ready", "armed", False),
        ("offline", "offline", True),
    ],
)
def test_a_state_of_the_gateway_is_a_condition(condition: str, states: str, begins: bool) -> None:
    rig = FaultyRig(RIG, SimulatedRig(RIG, HandPlant()), [f"reset:dac@{condition}+0.02"], is_told_states=True)
    for number, state in enumerate(states.split()):
        rig.gateway_entered(state, number * MS)
    due_ns = number * MS + 20 * MS
    assert rig.on_deadline(due_ns - 1) == ()
    assert rig.on_deadline(due_ns) == ((Frame(DAC_HEARTBEAT, b"\x00"),) if begins else ())


def test_a_fault_that_is_armed_in_the_state_for_which_it_waits_begins_at_the_next_sample() -> None:
    rig = LockstepRig()
    rig.bring_up()
    rig.arm()
    rig.inject_fault("hang:adc@armed")
    assert rig.faults_begun == []
    rig.step(1)
    assert [text for _, text in rig.faults_begun] == ["hang:adc@armed"]


@pytest.mark.parametrize("bit_rate", [None, 500_000])
def test_each_state_of_a_run_in_simulated_time_is_a_condition(bit_rate: int | None) -> None:
    """Also a state that lasts for less than a period: the rig is armed and started in the same instant."""
    states = ("offline", "ready", "armed", "running", "fault")
    rig = LockstepRig(
        setpoints={"vertical": "step:0.05@0"}, faults=[f"payload:0@{s}" for s in states], bit_rate=bit_rate
    )
    rig.bring_up()
    rig.arm()
    rig.start()
    rig.step(5)
    assert [text.partition("@")[2] for _, text in rig.faults_begun] == list(states[:-1])
    rig.inject_fault("unplug@0")
    rig.step(20)
    assert rig.state.name == "FAULT"
    assert [text.partition("@")[2] for _, text in rig.faults_begun] == [*states[:-1], "0", "fault"]


def test_no_frame_passes_while_the_cable_is_unplugged_and_bus_off_is_reported_once() -> None:
    bench = FaultyBench("bus-off@0.01/0.02")
    assert bench.samples([100]) == [100]
    assert bench.wait_until(110 * MS) == [BUS_OFF_FRAME]
    assert bench.send(SYNC) == []
    assert bench.wait_until(131 * MS) == []
    assert [frame.id for frame in bench.send(SYNC)] == [SAMPLE]


def test_a_late_frame_is_lost_if_the_cable_is_unplugged_when_it_arrives() -> None:
    bench = FaultyBench("late:sample,0.02,1@0", "unplug@0.01/0.02")
    assert bench.samples([100]) == []
    assert bench.wait_until(150 * MS) == []


def test_a_late_command_acts_late() -> None:
    bench = FaultyBench("late:command,0.004@0")
    bench.samples([100])
    bench.send(command((6.0, 5.0, 5.0), 0))
    bench.samples([101])
    assert bench.boards.dac.valve_v[0] == 5.0
    bench.wait_until(105 * MS)
    bench.send(SYNC)
    assert bench.boards.dac.valve_v[0] == pytest.approx(6.0, abs=0.01)


def test_a_hung_board_works_again_after_the_duration() -> None:
    bench = FaultyBench("hang:adc@0.005/0.02", "hang:dac@0.005/0.02")
    assert bench.samples([100, 110, 120, 130]) == [100, 130]


def test_a_babbling_board_repeats_its_last_frame_until_the_end() -> None:
    bench = FaultyBench("babble:adc,0.001@0/0.004")
    bench.samples([100])
    frames = bench.wait_until(110 * MS)
    assert [frame.id for frame in frames] == [SAMPLE] * 3


def test_a_second_board_answers_until_the_end_and_sends_heartbeats() -> None:
    bench = FaultyBench("twin:adc@0.005/0.2", "twin:dac@0.005/0.2")
    bench.samples([50])
    bench.wait_until(60 * MS)
    assert [frame.id for frame in bench.send(SYNC)] == [SAMPLE] * 2
    heartbeats = [frame.id for frame in bench.wait_until(199 * MS)]
    assert heartbeats.count(0x710) == heartbeats.count(DAC_HEARTBEAT) == 2
    bench.wait_until(260 * MS)
    assert [frame.id for frame in bench.send(SYNC)] == [SAMPLE]


def test_a_foreign_sender_copies_the_last_frame_with_its_own_counter() -> None:
    bench = FaultyBench("foreign:sample,0.001@0.001")
    bench.samples([100])
    (frame,) = bench.wait_until(101 * MS)
    assert frame.id == SAMPLE
    assert frame.data[6] == 128


def test_a_foreign_sender_of_a_frame_that_nobody_has_sent_is_silent() -> None:
    bench = FaultyBench("foreign:dac-emergency,0.001@0/0.005")
    bench.samples([100])
    assert bench.wait_until(110 * MS) == []


def test_an_injected_fault_counts_from_now() -> None:
    bench = FaultyBench()
    bench.samples([100])
    assert bench.rig.inject("reset:dac@0", bench.now_ns) == (Frame(DAC_HEARTBEAT, b"\x00"),)
    bench.rig.inject("lose:sample,1@0.02", bench.now_ns)
    bench.rig.inject("lose:sample,1@vertical>0.1", bench.now_ns)
    assert bench.samples([110, 120, 130]) == [110, 130]


@pytest.mark.parametrize(
    ("fault", "problem"),
    [
        ("freeze-sensor:elbow@0", "fault 'freeze-sensor:elbow@0': no axis 'elbow'; the rig has vertical"),
        ("freeze-sensor:vertcal@0", "horizontal, rotation; did you mean vertical?"),
        ("hang:adc@vertcal>1", "horizontal, rotation; did you mean vertical?"),
        ("hang:adc@elbow>1", "when: no axis 'elbow'; the rig has vertical, horizontal, rotation"),
        (
            "payload:3@0",
            "acts on the pneumatic arm, but another plant is simulated: simulate the arm, or use",
        ),
        (
            "lose:sample@armed+1",
            "waits for the gateway's state 'armed', which no frame on the bus shows: let",
        ),
    ],
)
def test_a_fault_that_the_rig_cannot_have_is_refused(fault: str, problem: str) -> None:
    with pytest.raises(DocumentError, match=problem):
        FaultyBench(fault)


def lockstep_run(path: Path, seed: int) -> LockstepRig:
    faults = ["lose:sample,20%@0", "noisy-sensor:vertical,0.01@running", "late:sample,0.002,30%@running+0.1"]
    rig = LockstepRig(setpoints={"vertical": "step:0.05@0.2"}, faults=faults, seed=seed)
    rig.bring_up()
    rig.arm()
    rig.start()
    rig.step(60)
    rig.save_recording(path)
    return rig


def test_the_same_seed_gives_the_same_bytes_and_another_seed_gives_others(tmp_path: Path) -> None:
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        lockstep_run(tmp_path / name, seed)
    first, same, other = ((tmp_path / name).read_bytes() for name in "abc")
    assert first == same
    assert first != other


def test_the_recording_has_the_faults_that_began(tmp_path: Path) -> None:
    rig = lockstep_run(tmp_path / "run.mcap", 1)
    from hil.recording import open_recording

    recording = open_recording(tmp_path / "run.mcap")
    begun = recording.metadata[FAULTS_BEGUN]
    assert " ".join(begun.values()).split() == [text for _, text in rig.faults_begun]
    assert len(rig.faults_begun) == 3
    logged = [(at_ns, entry.text) for at_ns, entry in recording.log() if entry.source == FAULT_SOURCE]
    assert logged == [(at_ns, f"{text} begins") for at_ns, text in rig.faults_begun]
    assert [entry.text for entry in rig.log if entry.source == FAULT_SOURCE] == [text for _, text in logged]
    assert verify(recording).complete


def test_a_reset_ends_a_hang_and_the_end_of_that_hang_ends_no_other() -> None:
    rig = LockstepRig()
    rig.bring_up()
    rig.inject_fault("hang:adc@0/0.6")
    rig.step(20)
    faults = rig.boards.adc.faults
    assert faults is not None
    assert faults.hung
    rig.inject_fault("reset:dac@0")
    assert faults.hung, "the reset of the other board"
    rig.inject_fault("reset:adc@0")
    assert not faults.hung
    rig.inject_fault("hang:adc@0")
    rig.run(1.0)
    assert faults.hung, "0.6 s have passed, and the second hang has no end"
