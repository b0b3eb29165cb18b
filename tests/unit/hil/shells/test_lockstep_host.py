"""The lockstep shell with a host that stalls, or whose clock is set."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from hil.core.errors import HilError, RecordingExistsError
from hil.lockstep_rig import LockstepRig
from hil.recording.entries import FrameReceived


def running_rig() -> LockstepRig:
    rig = LockstepRig(setpoints={"vertical": "step:0.05@0.2"})
    rig.bring_up()
    rig.arm()
    rig.start()
    rig.step(50)
    return rig


def test_a_stalled_gateway_reads_waiting_frames_before_its_late_deadline() -> None:
    rig = running_rig()
    before = rig.now_ns
    rig.inject_fault("stall:0.03@0.001")
    rig.step()
    assert rig.now_ns == before + 31_000_000, "the process sleeps until the stall is over"
    assert [entry.text for entry in rig.log if entry.source == "loop"][-1].startswith("woke up")
    rig.step(20)
    assert rig.state.name == "RUNNING"


def test_frames_that_arrive_during_a_stall_are_stamped_at_their_arrival(tmp_path: Path) -> None:
    rig = running_rig()
    rig.inject_fault("stall:0.15@0.001")
    rig.step(30)
    recording = rig.save_recording(tmp_path / "run.mcap")
    ages = [
        call.now_ns + recording.epoch_offset_ns - call.stamp_ns
        for call in recording.entries()
        if isinstance(call, FrameReceived)
    ]
    assert max(ages) > 20_000_000, "a heartbeat waited"
    assert min(ages) == 0


@pytest.mark.parametrize(("duration", "later_s"), [("", 3600.0), ("/0.1", 0.0)])
def test_a_clock_step_shifts_stamps_and_nothing_else(tmp_path: Path, duration: str, later_s: float) -> None:
    rig = running_rig()
    rig.inject_fault(f"step-clock:3600@0{duration}")
    rig.step(50)
    frames = rig.save_recording(tmp_path / "run.mcap").frames("received")
    offset_s = (frames.stamp_ns - frames.time_ns - 10**18) * 1e-9
    assert offset_s[0] == 0.0
    assert offset_s[-1] == pytest.approx(later_s)
    assert offset_s.max() == pytest.approx(3600.0)
    assert rig.state.name == "RUNNING"


def test_a_recording_is_not_overwritten(tmp_path: Path) -> None:
    rig = running_rig()
    rig.save_recording(tmp_path / "run.mcap")
    with pytest.raises(RecordingExistsError, match=r"run\.mcap: exists already; remove it"):
        rig.save_recording(tmp_path / "run.mcap")
    with pytest.raises(HilError, match="cannot be written: No such file or directory"):
        rig.save_recording(tmp_path / "no folder" / "run.mcap")


def test_a_table_of_an_axis_that_the_rig_does_not_have_is_an_error() -> None:
    with pytest.raises(HilError, match="no axis 'elbow'; the rig has vertical, horizontal, rotation"):
        running_rig().axis("elbow")
    with pytest.raises(HilError, match=r"no axis 'vertcal'; .*; did you mean vertical\?"):
        running_rig().axis("vertcal")


def test_simulated_time_never_goes_back() -> None:
    rig = LockstepRig()
    with pytest.raises(HilError, match="periods is -1, but must be at least 0"):
        rig.step(-1)
    for duration_s in (-1.0, math.nan, math.inf):
        with pytest.raises(HilError, match=f"duration_s is {duration_s:g} s, but must be finite and at"):
            rig.run(duration_s)
    rig.run(0.0)
    assert rig.cycles == []
