"""What the gateway and the boards do about each fault of the library, and how long the valves move after it.

The rig runs in simulated time with the shipped rig file. The vertical axis follows a sine, so that its valve
is not at its centre by itself. A period is 0.0112 s, the DAC board's watchdog acts after 0.0896 s, which are
8 periods.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest
from support.shipped_rig import RIG_TEXT

from firmware_sim.faults.fault_text import parse_fault
from firmware_sim.faults.kinds import AnyFault, ArmFault, ProcessFault
from hil.lockstep_rig import LockstepRig

CENTRED = (5.0, 5.0, 5.0)
STALE, WATCHDOG, HEARTBEAT = 5, 8, 27
"""Largest number of periods until the gateway misses samples, the board misses commands, or heartbeats."""

FAULTS = {
    "lose:sample@0": ("adc: no good sample for 5 periods, limit 5", STALE),
    "lose:sync@0": ("adc: no good sample for 5 periods, limit 5", WATCHDOG),
    "lose:command@0": ("dac: EMCY 0x8250 (RPDO did not come in time)", WATCHDOG),
    "lose:adc-heartbeat@0": ("adc: no heartbeat for", HEARTBEAT),
    "lose:dac-heartbeat@0": ("dac: no heartbeat for", HEARTBEAT),
    "lose:gateway-heartbeat@0": ("dac: EMCY 0x8130 (heartbeat or life guard error)", HEARTBEAT),
    "late:sample,0.02@0": ("last cause: TPDO1_ADC: answers an earlier SYNC", STALE),
    "late:command,0.1@0": ("dac: EMCY 0x8250 (RPDO did not come in time)", 16),
    "repeat:sample@0": ("adc: TPDO1_ADC: more answers than SYNCs in 3 periods", 3),
    "repeat:command@0": ("dac: EMCY 0x8200 (protocol error)", 1),
    "repeat:sync,1@0": ("adc: TPDO1_ADC: counter", 1),
    "reorder:command,1@0": ("dac: EMCY 0x8200 (protocol error)", 2),
    "corrupt:sample@0": ("last cause: TPDO1_ADC: CRC", STALE),
    "corrupt:sample,60%@0": ("adc: no good sample for 5 periods, limit 5", 60),
    "corrupt:command,1@0": ("dac: EMCY 0x8200 (protocol error)", 1),
    "corrupt:sync,1@0": ("adc: EMCY 0x8240 (SYNC of unexpected length)", 1),
    "alter:sample@0": ("vertical: the position changes by", 60),
    "miscount:sample,5,1@0": ("shows more answers than unanswered SYNCs (1)", 1),
    "miscount:command,-1,1@0": ("dac: EMCY 0x8200 (protocol error)", 1),
    "mislabel:sample,command,1@0": ("bus: foreign RPDO1_DAC frame", 1),
    "foreign:sample,0.005@0": ("another node sends the same identifier", 3),
    "foreign:sync,0.005@0": ("bus: foreign SYNC frame", 0),
    "foreign:nmt,0.05@0": ("bus: foreign NMT frame", 0),
    "foreign:gateway-heartbeat,0.05@0": ("bus: foreign HEARTBEAT_GATEWAY frame", 0),
    "flood:0,0.001@0": ("bus: foreign NMT frame", 0),
    "bus-off@0": ("bus: bus-off", WATCHDOG),
    "bus-off@0/0.1": ("bus: bus-off", WATCHDOG),
    "unplug@0": ("adc: no good sample for 5 periods, limit 5", WATCHDOG),
    "reset:adc@0": ("adc: left operational: boot-up", 0),
    "reset:dac@0": ("dac: left operational: boot-up", 0),
    "hang:adc@0": ("adc: no good sample for 5 periods, limit 5", STALE),
    "babble:adc,0.002@0": ("another node sends the same identifier", 3),
    "twin:adc@0": ("another node sends the same identifier", 1),
    "noisy-sensor:vertical,1@0": ("vertical: the position changes by", 30),
    "offset-sensor:vertical,4@0": ("vertical: the position changes by", 1),
    "offset-sensor:vertical,-9@0": ("last cause: vertical: potentiometer 0.000 V", STALE),
    "broken-wire:vertical@0": ("last cause: vertical: potentiometer 0.000 V", STALE),
    "stall:0.2@0": ("dac: EMCY 0x8250 (RPDO did not come in time)", WATCHDOG),
}
"""Fault to the beginning of its reason, and the largest number of periods until the valves stay centred."""

WITH_INPUTS = {
    "lose:inputs@0": ("emergency stop: no good frame 0x290 for", 9),
    "corrupt:inputs@0": ("last frame rejected: frame 0x290: CRC", 9),
    "emergency-stop:pressed@0": ("emergency stop", 1),
    "twin:dac@0": ("dac: TPDO1_DAC: more answers than SYNCs", 4),
    "lose:read-back@0": ("dac: no read-back of the valves (TPDO1_DAC) for 5 periods", 6),
}
"""Faults as in FAULTS, for a rig file with read-back and an emergency stop (timeout_s: 9 periods)."""

STANDING = {
    "freeze-sensor:vertical@0": ("vertical: the position stands still", 2.6),
    "stick-valve:vertical@0": ("vertical: the position stands still", 2.6),
    "stuck-spool:vertical@0": ("vertical: the position stands still", 2.6),
    "leak:vertical,1,2e-7@0": ("vertical: the tracking error is", 3.3),
    "supply-pressure:0@0": ("vertical: the position stands still", 6.0),
    "drift-sensor:vertical,1@0": ("last cause: vertical: potentiometer", 9.8),
}
"""Faults that the envelope finds while the axis should make a step: reason, and largest time in seconds."""

TOLERATED = [
    "lose:sample,4@0",
    "lose:sample,10%@0",
    "lose:sync,1@0",
    "late:sample,0.003@0",
    "late:sync,0.005@0",
    "late:command,0.005@0",
    "repeat:sample,1@0",
    "reorder:sample,1@0",
    "corrupt:sample,10%@0",
    "alter:sample,1@0",
    "miscount:sample,-1,1@0",
    "mislabel:command,sample@0",
    "unplug@0/0.02",
    "hang:adc@0/0.02",
    "hang:dac@0/0.03",
    "flood:0x7ff,0.001@0",
    "stall:0.05@0",
    "step-clock:3600@0",
    "step-clock:-3600@0",
    "slow-valve:vertical,0.05@0",
    "leak:vertical,1,1e-8@0",
]
"""Faults after which control goes on, and the position stays near the setpoint."""

ON_A_BUS = {
    "error-frames:100%@0": ("bus: bus-off", WATCHDOG + 1),
    "error-frames:100%,gateway@0": ("bus: bus-off", WATCHDOG + 1),
    "error-frames:100%,adc@0": ("adc: no good sample for 5 periods, limit 5", STALE + 1),
    "flood:1,0.0002@0": ("adc: no good sample for 5 periods, limit 5", WATCHDOG + 1),
}
"""Faults that act only on a modelled bus, each with its reason and its largest number of periods."""

TOLERATED_ON_A_BUS = ["error-frames:10%@0", "error-frames:30%,adc@0", "flood:1,0.001@0"]
"""Faults of a modelled bus after which control goes on."""

TWO_SYNCS_LONG = "hang:adc@0/0.02"
"""Fault during which the board misses two SYNCs on a modelled bus, and one without: two are a fault."""

UNDETECTED = {
    "alter:command,1@0": "a value that is altered with a correct CRC cannot be distinguished from a good one",
    "late:command,0.02@0": "a command has no time stamp, so the board cannot find that it is old",
    "twin:dac@0": "a second valve board sends heartbeats as the first one does",
    "babble:dac,0.002@0": "heartbeats are not counted",
    "foreign:adc-heartbeat,0.05@0": "heartbeats are not counted",
    "offset-sensor:vertical,0.5@0": "a small jump looks like motion",
}
"""Faults without a reaction, and why. A change of the gateway that finds one belongs in FAULTS."""

UNSTOPPABLE = {
    "hang:dac@0": "a board whose processor has stopped keeps its outputs; only its supply can be cut",
    "foreign:command,0.005@0": "the board obeys every master, so the second one has to be disconnected",
}
"""Faults that the gateway finds, although it cannot centre the valves."""


def running_rig(
    setpoint: str, control_s: float, file: Path | None = None, bit_rate: int | None = None
) -> LockstepRig:
    rig = LockstepRig(file, setpoints={"vertical": setpoint}, seed=1, bit_rate=bit_rate)
    rig.bring_up()
    rig.arm()
    rig.start()
    rig.run(control_s)
    assert rig.state.name == "RUNNING"
    return rig


def moving_rig(file: Path | None = None, bit_rate: int | None = None) -> LockstepRig:
    rig = running_rig("sine:0.1@0/2", 1.5, file, bit_rate)
    assert abs(rig.boards.dac.valve_v[0] - 5.0) > 0.3, "the valve is open when the fault begins"
    return rig


def periods_until_centred(rig: LockstepRig, periods: int) -> int:
    """Step, and return after how many periods the valves were centred for good."""
    moved = 0
    for number in range(1, periods + 1):
        rig.step()
        if rig.boards.dac.valve_v != CENTRED:
            moved = number
    return moved


@pytest.mark.parametrize("fault", FAULTS)
def test_a_dangerous_fault_centres_the_valves_in_time(fault: str) -> None:
    reason, limit = FAULTS[fault]
    rig = moving_rig()
    rig.inject_fault(fault)
    assert periods_until_centred(rig, limit + 40) <= limit
    assert rig.state.name == "FAULT"
    assert reason in (rig.gateway.fault_reason or "")


@pytest.mark.parametrize("fault", [*FAULTS, *ON_A_BUS])
def test_on_a_bus_with_a_bit_rate_the_valves_are_centred_one_period_later_at_most(fault: str) -> None:
    reason, limit = ON_A_BUS[fault] if fault in ON_A_BUS else (FAULTS[fault][0], FAULTS[fault][1] + 1)
    rig = moving_rig(bit_rate=500_000)
    rig.inject_fault(fault)
    assert periods_until_centred(rig, limit + 40) <= limit
    assert rig.state.name == "FAULT"
    assert reason in (rig.gateway.fault_reason or "")


@pytest.mark.parametrize("fault", [*TOLERATED, *TOLERATED_ON_A_BUS])
def test_on_a_bus_with_a_bit_rate_control_goes_on_after_a_small_fault(fault: str) -> None:
    rig = moving_rig(bit_rate=500_000)
    rig.inject_fault(fault)
    rig.step(200)
    assert rig.state.name == ("FAULT" if fault == TWO_SYNCS_LONG else "RUNNING")


@pytest.fixture(scope="module")
def rig_with_inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped rig file with its examples of emergency stop and read-back switched on."""
    head, mark, rest = RIG_TEXT.replace("# read_back = true", "read_back = true").partition(
        "# [emergency_stop]"
    )
    example, end, tail = rest.partition("# [enable]")
    text = head + mark[2:] + re.sub(r"(?m)^# (\w+ = )", r"\1", example) + end + tail
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("fault", WITH_INPUTS)
def test_a_fault_of_inputs_or_read_back_centres_the_valves_in_time(fault: str, rig_with_inputs: Path) -> None:
    reason, limit = WITH_INPUTS[fault]
    rig = moving_rig(rig_with_inputs)
    rig.inject_fault(fault)
    assert periods_until_centred(rig, limit + 20) <= limit
    assert reason in (rig.gateway.fault_reason or "")


@pytest.mark.parametrize("fault", STANDING)
def test_the_envelope_finds_a_fault_of_sensor_valve_or_air(fault: str) -> None:
    reason, limit_s = STANDING[fault]
    rig = running_rig("step:0.14@2", 1.8)
    rig.inject_fault(fault)
    begun_ns = rig.now_ns
    while rig.state.name == "RUNNING" and rig.now_ns - begun_ns < 12e9:
        rig.step()
    assert (rig.now_ns - begun_ns) * 1e-9 <= limit_s
    assert reason in (rig.gateway.fault_reason or "")
    rig.step(2)
    assert rig.boards.dac.valve_v == CENTRED


@pytest.mark.parametrize("fault", TOLERATED)
def test_control_goes_on_after_a_small_fault(fault: str) -> None:
    rig = moving_rig()
    rig.inject_fault(fault)
    rig.step(200)
    assert rig.state.name == "RUNNING"
    assert len(rig.faults_begun) == 1
    assert abs(rig.signals["vertical"].error) < 0.06


@pytest.mark.parametrize("fault", UNDETECTED)
def test_a_fault_without_a_reaction_is_known(fault: str) -> None:
    rig = moving_rig()
    rig.inject_fault(fault)
    rig.step(60)
    assert rig.state.name == "RUNNING"


@pytest.mark.parametrize("fault", UNSTOPPABLE)
def test_a_fault_that_the_gateway_cannot_stop_is_reported(fault: str) -> None:
    rig = moving_rig()
    rig.inject_fault(fault)
    rig.step(40)
    assert rig.state.name == "FAULT"
    assert rig.boards.dac.valve_v != CENTRED


def test_each_kind_of_fault_has_an_expected_reaction() -> None:
    texts = [*FAULTS, *ON_A_BUS, *STANDING, *TOLERATED, *UNDETECTED, *UNSTOPPABLE]
    # Faults of processes are in tests/acceptance/test_process_faults.py.
    assert {type(parse_fault(text)) for text in texts} == set(get_args(AnyFault)) - set(
        get_args(ProcessFault)
    )
    assert any(isinstance(parse_fault(text), ArmFault) for text in texts)
