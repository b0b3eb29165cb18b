"""The arguments of ``hil daemon``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hil.cli import daemon, daemon_run, main
from hil.shells.run_setup import SHIPPED, RunSetup


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[tuple[RunSetup, str]]:
    """The setup and the bus of each daemon that would be started."""
    found: list[tuple[RunSetup, str]] = []

    def run_daemon(setup: RunSetup, bus: str, _options: Any) -> int:
        found.append((setup, bus))
        return 0

    monkeypatch.setattr(daemon_run, "run_daemon", run_daemon)
    return found


def setpoints(setup: RunSetup) -> dict[str, str]:
    return {name: setpoint.text for name, setpoint in setup.setpoints.items()}


def test_every_axis_holds_its_position(started: list[tuple[RunSetup, str]]) -> None:
    """The steps of the rig file are for `hil run`."""
    assert main(["daemon"]) == 0
    ((setup, bus),) = started
    assert setpoints(setup) == {"vertical": "hold", "horizontal": "hold", "rotation": "hold"}
    assert bus == "sim"
    assert {"arm.toml", "plant.json"} <= set(setup.texts)


def test_setpoints_of_the_rig_file_that_hil_run_refuses_are_a_warning(
    started: list[tuple[RunSetup, str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (SHIPPED / "rig.toml").read_text()
    path = tmp_path / "rig.toml"
    path.write_text(text.replace('setpoint = "', 'setpoint = "step:9@1" # "', 1))
    assert main(["rig", "--check", str(path)]) == 2
    refusal = capsys.readouterr().err.removeprefix("hil rig: ").strip()
    assert "rig.toml: axes.vertical.setpoint: setpoint 'step:9@1' reaches 9 m" in refusal
    assert main(["daemon", "--rig", str(path)]) == 0
    warning = capsys.readouterr().err
    assert warning == f"hil daemon: warning: {refusal}; this daemon holds the position instead\n"
    assert main(["daemon", "--rig", str(path), "--setpoint", "vertical=step:0.1@1"]) == 0
    path.write_text(text.replace('setpoint = "', 'setpoint = "csv:none.csv" # "', 1))
    assert main(["daemon", "--rig", str(path)]) == 0
    assert "none.csv: cannot be read" in capsys.readouterr().err
    assert len(started) == 3


def test_a_setpoint_and_a_controller_can_be_given(started: list[tuple[RunSetup, str]]) -> None:
    arguments = ["--setpoint", "vertical=step:0.1@0", "--controller", "vertical=hls", "--bus", "vcan3"]
    assert main(["daemon", *arguments]) == 0
    ((setup, bus),) = started
    assert setpoints(setup)["vertical"] == "step:0.1@0"
    assert setup.controllers["vertical"].name != setup.controllers["horizontal"].name
    assert bus == "vcan3"
    assert "arm.toml" not in setup.texts


@pytest.mark.parametrize(
    "arguments", [["--keep", "0"], ["--keep", "1.5"], ["--rotate-at", "0.1"], ["--rotate-after", "0s"]]
)
def test_wrong_limits_of_recordings_are_explained(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["daemon", *arguments])
    assert caught.value.code == 2
    assert f"'{arguments[1]}' must be" in capsys.readouterr().err


def test_limits_of_recordings() -> None:
    given = daemon.parser().parse_args(["--rotate-at", "60", "--rotate-after", "3600s", "--keep", "24"])
    assert (given.rotate_bytes, given.rotate_s, given.keep) == (60_000_000, 3600.0, 24)


def test_a_scenario_gives_setpoints(started: list[tuple[RunSetup, str]]) -> None:
    assert main(["daemon", "--scenario", "fig14"]) == 0
    ((setup, _),) = started
    assert setpoints(setup)["vertical"].startswith("ladder:")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rig", "nosuch.toml"], "nosuch.toml"),
        (["--bus", "vcan0", "--linear"], "--linear chooses what"),
        (["--setpoint", "elbow=hold"], "elbow"),
        (["--fault", "stall:0.1@1"], "in simulated time only"),
        (["--no-record", "--keep", "3"], "--no-record records nothing"),
        (["--operate"], "there is no page: add --live"),
    ],
)
def test_wrong_arguments_have_status_2(
    started: list[tuple[RunSetup, str]],
    arguments: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["daemon", *arguments]) == 2
    assert words in capsys.readouterr().err
    assert started == []
