"""The soak run of `make soak`, shortened, and that it notices what it looks for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from soak import soak

GROWS = "import time\nblocks = []\nfor _ in range(40): blocks.append(b'x' * 10**6); time.sleep(0.005)"


def test_a_short_soak_in_lockstep_stays_within_all_limits(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Half of the measurements must be after the processes have started and the first chunks are written.
    monkeypatch.setattr(soak, "RSS_INTERVAL_S", 0.05)
    status = soak.main(["--lockstep-s", "100", "--real-time-s", "0"])
    printed = capsys.readouterr().out
    assert status == 0, printed
    for what in ("growth of hil.cli", "growth of hil.recording.recorder_process", "periods missing", "drift"):
        assert what in printed


def test_a_run_that_faults_exceeds_limits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.mcap"
    command = [sys.executable, "-m", "hil.cli", "run", "--lockstep", "--duration", "3"]
    failed = soak.soak("faulty", [*command, "--fault", "lose:sample,9@1", "--record", str(path)], path, 3.0)
    exceeded = [line for line in capsys.readouterr().out.splitlines() if "EXCEEDS" in line]
    assert len(exceeded) == failed
    assert any("the run ended as fault" in line for line in exceeded)
    assert any("periods missing" in line for line in exceeded)


def test_memory_that_grows_after_the_warm_up_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "RECORDER", sys.executable)
    monkeypatch.setattr(soak, "RSS_INTERVAL_S", 0.01)
    with subprocess.Popen([sys.executable, "-c", GROWS]) as process:
        (memory,) = soak.watch_memory(process)
    assert memory.growth_mb > soak.MAX_GROWTH_MB


def test_steady_memory_does_not_count_as_growth() -> None:
    assert soak.Memory("loop", [1.0, 40.0, 41.0, 41.0, 41.0, 41.5]).growth_mb == 0.5


@pytest.mark.parametrize(("value", "failed"), [(2.0, 0), (-2.0, 0), (2.1, 1), (-2.1, 1)])
def test_a_limit_holds_in_both_directions(value: float, failed: int) -> None:
    checks = soak.Checks()
    checks.limit("drift", value, 2.0, "periods")
    assert checks.failed == failed
