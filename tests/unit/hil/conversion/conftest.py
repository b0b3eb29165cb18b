"""A recorded run in simulated time that all tests of conversions share."""

from __future__ import annotations

import pytest

from hil.lockstep_rig import run_experiment
from hil.recording.reader import Recording


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("conversion") / "run.mcap"
    return run_experiment(path, duration_s=2.0, setpoints={"vertical": "step:0.05@0.5"})
