"""After a protection is lost, no command opens a valve until an operator starts again.

The checker reads only the frames on the bus. It decodes contacts, counters and checksums by itself and shares
no code with the gateway or the simulated boards.
"""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import given, settings
from hypothesis import strategies as st
from support.gateway_bench import RigBench
from support.protected_rigs import EMERGENCY_STOP, ENABLE, protected_rig

from firmware_sim.boards.faults import AdcFaults, DacFaults
from hil.core.controller_file import PidLaw
from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState, Trigger

PERIOD_NS = 11_200_000
TIMEOUT_NS = 50_000_000
CENTRE_COUNTS = 16384


def crc8(data: bytes) -> int:
    """CRC-8 SAE J1850, bit by bit."""
    remainder = 0xFF
    for byte in data:
        for bit in range(7, -1, -1):
            carry = (remainder >> 7 ^ byte >> bit) & 1
            remainder = (remainder << 1 & 0xFF) ^ (0x1D if carry else 0)
    return remainder ^ 0xFF


class Checker:
    """Observer of the bus. ``closed_ns`` is the last time at which the emergency stop was surely closed."""

    def __init__(self) -> None:
        self.closed_ns: int | None = None
        self.counter: int | None = None
        self.open_commands = 0

    def to_gateway(self, frame: Frame, now_ns: int) -> None:
        data = frame.data
        if frame.id != 0x290 or len(data) != 3 or crc8(b"\x90\x02" + data[:2]) != data[2]:
            return
        if not data[0] & 1:
            self.closed_ns = None
            return
        advance = 1 if self.counter is None else (data[1] - self.counter) % 256
        self.counter = data[1]
        if 0 < advance < 128:
            self.closed_ns = now_ns

    def from_gateway(self, frames: Sequence[Frame], now_ns: int) -> None:
        for frame in frames:
            if frame.id != 0x220:
                continue
            counts = [int.from_bytes(frame.data[place : place + 2], "little") for place in (0, 2, 4)]
            if counts != [CENTRE_COUNTS] * 3:
                self.open_commands += 1
                assert self.closed_ns is not None, f"{counts} with an open emergency stop"
                assert now_ns - self.closed_ns <= TIMEOUT_NS, f"{counts} after the timeout"


class WatchedBench(RigBench):
    """A rig whose frames a checker observes in the order in which the gateway takes and gives them."""

    checker: Checker
    latency_ns = 0
    """Time from SYNC to the sample."""

    def _carry(self, to_boards: Sequence[Frame], to_gateway: Sequence[Frame]) -> None:
        checker = self.__dict__.setdefault("checker", Checker())
        outgoing, incoming = list(to_boards), list(to_gateway)
        checker.from_gateway(outgoing, self.now_ns)
        while outgoing or incoming:
            for sent in incoming:
                if sent.id == 0x190:
                    self.now_ns = max(
                        self.now_ns, min(self.now_ns + self.latency_ns, self.gateway.next_deadline_ns - 1)
                    )
                for frame in self.pass_to_gateway(sent):
                    checker.to_gateway(frame, self.now_ns)
                    answers = self.transcript.add(self.gateway.receive(frame, self.now_ns)).frames
                    checker.from_gateway(answers, self.now_ns)
                    outgoing += answers
            incoming = list(self.boards.receive(outgoing.pop(0), self.now_ns)) if outgoing else []


fates = st.lists(
    st.tuples(st.sampled_from(["pass", "pass", "lose", "damage", "repeat"]), st.integers(1, 12)),
    min_size=1,
    max_size=12,
).map(lambda runs: [fate for fate, length in runs for _ in range(length)])
"""What happens to each optional frame. A module that hangs repeats its last frame."""
faults: st.SearchStrategy[AdcFaults | DacFaults | None] = st.one_of(
    st.none(),
    st.builds(AdcFaults, emergency_stop_pressed=st.just(True)),
    st.builds(AdcFaults, silent_inputs=st.just(True)),
    st.builds(AdcFaults, input_crcs_to_corrupt=st.integers(1, 10)),
    st.builds(AdcFaults, enable_released=st.just(True)),
    st.builds(DacFaults, frozen_v=st.just({2: 9.0})),
    st.builds(DacFaults, silent_read_back=st.just(True)),
)
actions = st.lists(
    st.tuples(
        st.integers(1, 25),
        faults,
        st.sampled_from([None, None, Trigger.STOP, Trigger.RESET, Trigger.ARM, Trigger.START]),
        st.integers(0, 2 * TIMEOUT_NS) | st.just(0),
    ),
    min_size=1,
    max_size=8,
)


@given(actions, fates, st.booleans(), st.sampled_from([0, PERIOD_NS // 2, PERIOD_NS * 9 // 10]))
@settings(max_examples=60, deadline=None)
def test_no_valve_is_open_while_the_emergency_stop_is_open_or_unknown(
    sequence: list[tuple[int, AdcFaults | DacFaults | None, Trigger | None, int]],
    what: list[str],
    reads_back: bool,
    latency_ns: int,
) -> None:
    rig = protected_rig(EMERGENCY_STOP + ENABLE, read_back=reads_back)
    bench = WatchedBench(rig, PidLaw(kp=-30.0, ki=20.0), "ladder:0.1,-0.1@0/0.05").run()
    bench.latency_ns = latency_ns
    bench.periods(3)
    assert bench.checker.open_commands > 0
    number = 0
    last: dict[int, Frame] = {}

    def tamper(frame: Frame) -> list[Frame]:
        nonlocal number
        if frame.id not in (0x290, 0x1A0):
            return [frame]
        number += 1
        match what[number % len(what)]:
            case "lose":
                return []
            case "damage":
                return [frame._replace(data=bytes((frame.data[0] ^ 1, *frame.data[1:])))]
            case "repeat":
                return [last.get(frame.id, frame)]
        last[frame.id] = frame
        return [frame]

    bench.pass_to_gateway = tamper
    for periods, fault, trigger, pause_ns in sequence:
        bench.boards.adc.faults = fault if isinstance(fault, AdcFaults) else None
        bench.boards.dac.faults = fault if isinstance(fault, DacFaults) else None
        bench.periods(periods)
        bench.now_ns = max(bench.now_ns, min(bench.now_ns + pause_ns, bench.gateway.next_deadline_ns))
        if trigger is not None:
            bench.operate(trigger)


@given(st.integers(1, 40), st.booleans(), st.sampled_from([LifeCycleState.ARMED, LifeCycleState.RUNNING]))
@settings(max_examples=30, deadline=None)
def test_the_valves_are_centred_one_period_after_the_contact_opened(
    periods: int, is_silent: bool, state: LifeCycleState
) -> None:
    bench = WatchedBench(protected_rig(), PidLaw(kp=-30.0, ki=20.0), "ladder:0.1,-0.1@0/0.05").run()
    if state is LifeCycleState.ARMED:
        bench.operate(Trigger.STOP)
    bench.periods(periods)
    fault = AdcFaults(silent_inputs=True) if is_silent else AdcFaults(emergency_stop_pressed=True)
    bench.boards.adc.faults = fault
    bench.periods(2 + (TIMEOUT_NS // PERIOD_NS + 1 if is_silent else 0))
    assert bench.gateway.state is LifeCycleState.FAULT
    assert bench.boards.dac.valve_v == (5.0, 5.0, 5.0)
