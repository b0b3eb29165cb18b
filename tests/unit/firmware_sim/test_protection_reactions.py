"""What emergency stop and read-back of the valves find of the faults of the library.

The rig runs in simulated time, and the vertical axis follows a sine. Some of these faults have no reaction
without a read-back (``test_fault_reactions.UNDETECTED``).
"""

from __future__ import annotations

from pathlib import Path

import pytest
from support.gateway_bench import rig_text
from support.protected_rigs import EMERGENCY_STOP

from hil.lockstep_rig import LockstepRig

CENTRED = (5.0, 5.0, 5.0)

FOUND = {
    "emergency-stop:pressed@0": ("emergency stop: the contact is open", 1),
    "lose:inputs@0": ("emergency stop: no good frame 0x290 for", 6),
    "corrupt:inputs@0": ("emergency stop: no good frame 0x290 for", 6),
    "lose:read-back@0": ("dac: no read-back of the valves (TPDO1_DAC) for 5 periods", 7),
    "corrupt:read-back@0": ("dac: no read-back of the valves (TPDO1_DAC) for 5 periods", 7),
    "alter:command@0": ("dac: valve of", 300),
    "late:command,0.05@0": ("dac: valve of vertical:", 60),
    "twin:dac@0": ("dac: TPDO1_DAC: more answers than SYNCs in 3 periods", 5),
}
"""Fault to the beginning of its reason, and the largest number of periods until the gateway faults."""
TOLERATED = [
    "lose:inputs,3@0",
    "lose:read-back,2@0",
    "alter:command,1@0",
    "repeat:read-back,1@0",
    "lose:sync,1@0",
]


@pytest.fixture
def rig(tmp_path: Path) -> LockstepRig:
    path = tmp_path / "rig.toml"
    changes = {"dac.protected": "true\nread_back = true", "adc.stale_after_periods": "5"}
    path.write_text(rig_text(changes) + EMERGENCY_STOP)
    rig = LockstepRig(path, setpoints={"vertical": "sine:0.1@0/2"}, seed=1)
    rig.bring_up()
    rig.arm()
    rig.start()
    rig.run(1.5)
    assert rig.state.name == "RUNNING"
    return rig


@pytest.mark.parametrize("fault", FOUND)
def test_a_fault_is_found_in_time(rig: LockstepRig, fault: str) -> None:
    reason, limit = FOUND[fault]
    rig.inject_fault(fault)
    periods = 0
    while rig.state.name == "RUNNING" and periods <= limit:
        rig.step()
        periods += 1
    assert periods <= limit
    assert (rig.gateway.fault_reason or "").startswith(reason)


@pytest.mark.parametrize("fault", TOLERATED)
def test_a_short_fault_is_tolerated(rig: LockstepRig, fault: str) -> None:
    rig.inject_fault(fault)
    rig.step(100)
    assert rig.state.name == "RUNNING"
    assert len(rig.faults_begun) == 1
