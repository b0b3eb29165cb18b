"""Real processes on virtual CAN: the gateway with the simulated boards, and with a board of one's own."""

import time

import can
import pytest

from hil.testing import assert_step_response

SYNC, NMT, ADC_HEARTBEAT, GATEWAY_HEARTBEAT = 0x080, 0x000, 0x710, 0x701


def frames_until(bus, identifier, timeout_s=60.0):
    """Return the frames on the bus up to the first one with an identifier."""
    end, frames = time.monotonic() + timeout_s, []
    while time.monotonic() < end:
        message = bus.recv(1.0)
        if message is not None:
            frames.append(message)
            if message.arbitration_id == identifier:
                return frames
    raise AssertionError(f"no frame 0x{identifier:03X} within {timeout_s:g} s; {len(frames)} others came")


@pytest.mark.vcan_rig(gateway=["--setpoint", "vertical=step:0.1@0.5"])
def test_gateway_and_boards_control_the_arm(vcan_rig):
    run = vcan_rig.run(3.0)
    assert run.metadata["ending"]["reason"] == "completed"
    assert_step_response(run, "vertical", overshoot=0.05, settling_s=2.0)


def test_the_gateway_starts_a_board_that_sends_its_heartbeat(vcan_gateway, vcan_bus):
    vcan_gateway.start()
    frames_until(vcan_bus, GATEWAY_HEARTBEAT)
    vcan_bus.send(can.Message(arbitration_id=ADC_HEARTBEAT, data=[127], is_extended_id=False))
    assert frames_until(vcan_bus, NMT)[-1].data == b"\x01\x10"
