"""A user's control tests in simulated time: step responses, limits, and what the rig does about faults."""

import pytest

from hil.testing import assert_step_response, assert_within_limits

STEP = {"vertical": "step:0.1@0.5"}


@pytest.mark.lockstep_rig(setpoints=STEP)
def test_the_vertical_axis_follows_a_step_and_ten_lost_samples_are_a_fault(lockstep_rig):
    lockstep_rig.run(3.0)
    assert_step_response(lockstep_rig, "vertical", overshoot=0.02, settling_s=1.1)
    assert_within_limits(lockstep_rig)
    lockstep_rig.inject_fault("lose:sample,10@0")
    lockstep_rig.step(10)
    assert lockstep_rig.state.name == "FAULT"
    assert lockstep_rig.boards.dac.valve_v == (5.0, 5.0, 5.0)


@pytest.mark.parametrize("controller", ["ppid", "hls"])
def test_a_payload_causes_no_overshoot(make_lockstep_rig, controller):
    rig = make_lockstep_rig(
        controllers={"vertical": controller},
        setpoints={"vertical": "step:0.1@3"},  # when the arm no longer sags under the load
        faults=["payload:3@0", "supply-pressure:400@0"],
    )
    rig.run(7.0)
    assert_step_response(rig, "vertical", overshoot=0.05, steady_state_error=0.004)


@pytest.mark.lockstep_rig(setpoints=STEP, faults=["late:sample,0.003,20%@0", "noisy-sensor:vertical,0.005@0"])
def test_late_and_noisy_samples_do_not_disturb_the_step(lockstep_rig):
    lockstep_rig.run(4.0)
    assert lockstep_rig.state.name == "RUNNING"
    assert_within_limits(lockstep_rig, "vertical", max_error=0.11, position=(-0.02, 0.11))


@pytest.mark.parametrize(
    "fault", ["unplug@vertical>0.05", "hang:adc@running+1", "reset:dac@1.5", "bus-off@1"]
)
def test_a_broken_rig_stops_with_centred_valves(make_lockstep_rig, fault):
    rig = make_lockstep_rig(setpoints=STEP, faults=[fault])
    rig.run(2.0)
    assert rig.faults_begun
    assert rig.state.name == "FAULT"
    assert rig.boards.dac.valve_v == (5.0, 5.0, 5.0)


@pytest.mark.lockstep_rig(setpoints=STEP, bit_rate=500_000)
def test_an_overloaded_bus_stops_the_rig_if_the_other_frames_have_priority(lockstep_rig):
    lockstep_rig.inject_fault(
        "flood:0x7ff,0.0001@0/1"
    )  # fills the bus, but every frame of the rig goes first
    lockstep_rig.run(1.0)
    assert lockstep_rig.state.name == "RUNNING"
    lockstep_rig.inject_fault("flood:0x001,0.0001@0")
    lockstep_rig.run(0.2)
    assert lockstep_rig.state.name == "FAULT"
    assert lockstep_rig.bus.gateway.refused > 0


def test_two_runs_with_the_same_seed_are_equal(record_run, tmp_path):
    options = {"setpoints": STEP, "faults": ["lose:sample,10%@0"], "seed": 3}
    first = record_run(1.0, **options)
    assert record_run(1.0, **options) is first
    assert_within_limits(first, "vertical")
