"""Recordings of an earlier version of the gateway verify with this one, to the byte.

The files in ``tests/data`` were recorded by hil 0.2.0 before the rig file had ``[emergency_stop]``,
``[enable]`` and ``dac.read_back``. Without these keys, every frame and log entry stays as it was.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.recording.reader import Recording
from hil.shells.replay import verify

DATA = Path(__file__).parents[3] / "data"


@pytest.mark.parametrize(
    ("name", "ending"),
    [("hil-0.2.0-run.mcap", "completed"), ("hil-0.2.0-fault.mcap", "fault")],
)
def test_a_recording_of_version_0_2_0_verifies(name: str, ending: str) -> None:
    recording = Recording(DATA / name)
    assert recording.metadata["run"]["hil"] == "0.2.0"
    assert recording.metadata["ending"]["reason"] == ending
    report = verify(recording)
    assert report.complete
    assert report.periods_compared > 30
    assert report.frames_compared > 60
