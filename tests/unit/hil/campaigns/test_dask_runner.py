"""Campaigns on a Dask cluster within this process. A cluster of processes is in the acceptance tests."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import distributed
import pytest

import hil
from hil.campaigns import dask_runner, runner
from hil.campaigns.campaign_file import read_campaign
from hil.campaigns.case import CaseResult
from hil.campaigns.dask_runner import run_cases_on_dask
from hil.campaigns.prepared import PreparedCampaign, prepare
from hil.cli import main
from hil.core.errors import EnvironmentLackError, HilError

TEXT = """
title = "lost samples"
duration_s = 0.2
draws = 5
moments = ["running+0.1"]
[[faults]]
fault = "lose:sample"
"""


@pytest.fixture(scope="module")
def prepared() -> PreparedCampaign:
    return prepare(read_campaign(TEXT, "lost.toml"))


@pytest.fixture(scope="module")
def cluster() -> Iterator[distributed.LocalCluster]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0", protocol="tcp"
    ) as made:
        yield made


KILLED = distributed.KilledWorker("case", SimpleNamespace(address="tcp://127.0.0.1:2"), 3)


def on_dask(prepared: PreparedCampaign, address: str, first: int = 0) -> list[CaseResult]:
    return [result for group in run_cases_on_dask(prepared, first, address) for result in group]


def test_the_results_are_those_of_one_process_in_the_same_order(
    prepared: PreparedCampaign, cluster: distributed.LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "CASES_AT_ONCE", 2)
    assert on_dask(prepared, cluster.scheduler_address) == runner.run_group(prepared, 0, 5)
    assert on_dask(prepared, cluster.scheduler_address, 3) == runner.run_group(prepared, 3, 5)
    assert on_dask(prepared, cluster.scheduler_address, 5) == []


def test_the_error_of_a_case_that_cannot_run_is_that_of_the_campaign(
    cluster: distributed.LocalCluster,
) -> None:
    wrong = prepare(read_campaign(TEXT + '[arm]\n"supply.bar" = { from = 1.0, to = 2.0 }\n', "wrong.toml"))
    with pytest.raises(HilError, match=r"arm\.supply\.bar: the arm file has no number under this key"):
        on_dask(wrong, cluster.scheduler_address)


def test_workers_of_another_version_are_refused(
    prepared: PreparedCampaign, cluster: distributed.LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_runner, "version", lambda: "0.0.1")
    with pytest.raises(
        HilError, match=r"worker tcp://.* has pneumatic-hil 0\.0\.1, and this program"
    ) as error:
        on_dask(prepared, cluster.scheduler_address)
    assert f"install pneumatic-hil {hil.__version__} there" in str(error.value)


def test_workers_without_the_package_are_refused(
    prepared: PreparedCampaign, cluster: distributed.LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> str:
        raise ModuleNotFoundError("No module named 'hil'")

    monkeypatch.setattr(dask_runner, "version", missing)
    with pytest.raises(HilError, match="a worker cannot import pneumatic-hil"):
        on_dask(prepared, cluster.scheduler_address)


def test_a_cluster_without_workers_is_refused(prepared: PreparedCampaign) -> None:
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, dashboard_address=":0", protocol="tcp"
        ) as cluster,
        pytest.raises(HilError, match=r"the cluster has no workers; start them with `dask worker tcp://"),
    ):
        on_dask(prepared, cluster.scheduler_address)


def test_an_address_without_a_scheduler_is_an_error(
    prepared: PreparedCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dask_runner, "CONNECT_TIMEOUT_S", 0.2)
    with pytest.raises(HilError, match=r"--dask tcp://127\.0\.0\.1:1: no scheduler answers within 0\.2 s"):
        on_dask(prepared, "tcp://127.0.0.1:1")


@pytest.mark.parametrize(
    ("failure", "text"),
    [
        (distributed.CancelledError("gone"), "the scheduler was lost"),
        (OSError("closed"), "the scheduler was lost"),
        (
            KILLED,
            "perhaps the workers lack memory",
        ),
    ],
)
def test_a_cluster_that_is_lost_says_how_to_go_on(
    prepared: PreparedCampaign,
    cluster: distributed.LocalCluster,
    monkeypatch: pytest.MonkeyPatch,
    failure: Exception,
    text: str,
) -> None:
    def fail(*_arguments: object) -> None:
        raise failure

    monkeypatch.setattr(distributed.Future, "result", fail)
    with pytest.raises(HilError, match=f"{text}.* run the same command again|{text}.* Run the same command"):
        on_dask(prepared, cluster.scheduler_address)


def test_without_the_package_the_command_that_installs_it_is_named(
    prepared: PreparedCampaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(dask_runner, "import_module", missing)
    with pytest.raises(EnvironmentLackError, match=r"pip install 'pneumatic-hil\[dask\]'"):
        on_dask(prepared, "tcp://127.0.0.1:1")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--workers", "2"], "--workers is for processes of this machine"),
        (["--case", "0"], "--dask is for whole campaigns"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["campaign", "faults", "--dask", "tcp://127.0.0.1:1", *options]) == 2
    assert message in capsys.readouterr().err
