"""The gateway killed or paused, its recorder killed, its disk full: what boards, loop and user see of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.link_contract import free_port

from hil.core.frames import Frame
from hil.core.wire import codec
from hil.links import Link, open_link
from hil.testing.vcan_processes import VcanBoards, VcanGateway

pytestmark = pytest.mark.real_time

TIMEOUT_S = 20.0
RPDO_TIMEOUT, HEARTBEAT = 0x8250, 0x8130
CENTRE = (5.0, 5.0, 5.0)


class Rig:
    """Boards and gateway as processes, and a link that receives all their frames."""

    def __init__(self, gateway: VcanGateway, link: Link) -> None:
        self.gateway = gateway
        self._link = link

    def until(self, is_wanted: Callable[[Frame], bool]) -> Frame:
        """Wait for a frame."""
        while True:
            received = self._link.receive(TIMEOUT_S)
            assert received is not None, f"no frame came within {TIMEOUT_S} s: {self.gateway.output()}"
            if is_wanted(received.frame):
                return received.frame


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    """A rig whose vertical valve is open."""
    bus = f"udp:{free_port()}"
    setpoint = ["--setpoint", "vertical=sine:0.1@0/2"]
    with (
        open_link(bus) as link,
        VcanBoards(bus, tmp_path, None, []),
        VcanGateway(bus, tmp_path, None, setpoint) as gateway,
    ):
        gateway.start()
        made = Rig(gateway, link)
        made.until(is_open)
        yield made


def is_open(frame: Frame) -> bool:
    return frame.id == codec.RPDO1_DAC and codec.decode_rpdo1_dac(frame.data)[:3] != CENTRE


def centred_by_watchdog(frame: Frame) -> bool:
    if frame.id != codec.EMCY_DAC:
        return False
    return codec.decode_emcy_dac(frame.data).error_code in (RPDO_TIMEOUT, HEARTBEAT)


def test_the_board_centres_its_valves_when_the_gateway_is_killed(rig: Rig) -> None:
    rig.gateway.inject_fault("kill:gateway@0")
    rig.until(centred_by_watchdog)
    assert rig.gateway.wait(TIMEOUT_S) == -9
    assert not rig.gateway.recording().metadata.get("ending"), "nothing closed the recording"


def test_a_gateway_that_was_paused_faults_when_it_runs_again(rig: Rig) -> None:
    rig.gateway.inject_fault("pause:gateway@0.1/1.5")
    rig.until(centred_by_watchdog)
    assert rig.gateway.wait(TIMEOUT_S) == 1
    ending = rig.gateway.recording().metadata["ending"]
    assert ending["reason"] == "fault"
    assert "EMCY" in ending["fault"] or "no good sample" in ending["fault"]


@pytest.mark.parametrize(
    ("fault", "words"),
    [("kill:recorder@0", "the recorder process was killed"), ("fill-disk@0", "File too large")],
)
def test_control_goes_on_without_a_recorder_and_the_user_is_told(rig: Rig, fault: str, words: str) -> None:
    rig.gateway.inject_fault(fault)
    for _ in range(150):
        rig.until(lambda frame: frame.id == codec.SYNC)
    rig.until(is_open)
    rig.gateway.stop()
    assert "The recording is incomplete: " in rig.gateway.output()
    assert words in rig.gateway.output()
