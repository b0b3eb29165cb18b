"""A campaign on a Dask cluster of processes, one of which is killed on the way, gives the same bytes."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterable
from pathlib import Path

import distributed
import pytest

from hil.campaigns.case import CaseResult
from hil.campaigns.result_files import ResultFolder
from hil.cli import main

CAMPAIGN = """
title = "lost samples and a leak"
duration_s = 0.3
draws = 6
moments = ["running+0.1"]
[[setups]]
setpoints = { vertical = "sine:0.1@0/2" }
[[setups]]
controllers = { vertical = "hls" }
[[faults]]
fault = "lose:sample,50%"
[[faults]]
fault = "leak:vertical,1,1e-8"
[arm]
"supply.gauge_kpa" = { from = 440.0, to = 460.0 }
"""


def test_a_killed_worker_changes_no_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hil.campaigns.page.PLOTTED_CASES", 0)
    monkeypatch.setattr("hil.campaigns.runner.CASES_AT_ONCE", 2)
    monkeypatch.chdir(tmp_path)
    Path("lost.toml").write_text(CAMPAIGN)
    assert main(["campaign", "lost.toml", "--output", "here", "--workers", "1"]) == 0
    killed: list[int] = []
    append = ResultFolder.append

    def append_and_kill(folder: ResultFolder, results: Iterable[CaseResult]) -> None:
        append(folder, results)
        if not killed:
            killed.append(next(iter(workers.values())))
            os.kill(killed[0], signal.SIGKILL)

    with (
        distributed.LocalCluster(n_workers=3, threads_per_worker=1, dashboard_address=":0") as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        workers = client.run(os.getpid)
        assert len(set(workers.values())) == 3
        monkeypatch.setattr(ResultFolder, "append", append_and_kill)
        address = cluster.scheduler_address
        assert main(["campaign", "lost.toml", "--output", "dask", "--dask", address]) == 0
    assert killed
    assert Path("dask/results.jsonl").read_bytes() == Path("here/results.jsonl").read_bytes()
    assert len(Path("here/results.jsonl").read_bytes().splitlines()) == 24
