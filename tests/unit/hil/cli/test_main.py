"""The command ``hil`` itself: help, version, unknown commands."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

import firmware_sim.cli
import hil
from hil.cli import COMMANDS, command_module, command_names, main

ROOT = Path(hil.__file__).parents[1]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("rnu", "unknown command 'rnu'; did you mean run?"),
        ("desing", "unknown command 'desing'; did you mean design?"),
        ("RUN", "unknown command 'RUN'; did you mean run?"),
        ("gateway", "unknown command 'gateway'"),
        ("--verson", "unknown option '--verson'; did you mean --version?"),
        ("x" * 100_000, f"unknown command '{'x' * 100_000}'"),
    ],
)
def test_an_unknown_command_names_the_nearest(
    given: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([given]) == 2
    assert capsys.readouterr().err == f"hil: {said}\n`hil --help` lists the commands.\n"


@pytest.mark.parametrize(("arguments", "status"), [([], 2), (["--help"], 0), (["-h"], 0), (["help"], 0)])
def test_help_lists_every_command_in_80_columns(
    arguments: list[str], status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == status
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= 80 for line in lines)
    for name in command_names():
        (line,) = [line for line in lines if line.startswith(f"  {name} ")]
        assert len(line.split()) > 4, "a command has a summary"
    assert "design" in command_names()


@pytest.mark.parametrize("name", [*COMMANDS, "design"])
def test_every_command_has_a_main(name: str) -> None:
    assert callable(command_module(name).main)  # type: ignore[union-attr]


@pytest.mark.parametrize("name", ["run", "replay", "rig", "completion", "doctor", "vcan"])
def test_help_of_a_command_fits_80_columns(
    name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    with pytest.raises(SystemExit) as caught:
        main([name, "--help"])
    assert caught.value.code == 0
    output = capsys.readouterr().out
    assert output.startswith(f"usage: hil {name}")
    assert all(len(line) <= 80 for line in output.splitlines())


def test_both_commands_state_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"hil {hil.__version__}\n"
    with pytest.raises(SystemExit) as caught:
        firmware_sim.cli.main(["--version"])
    assert caught.value.code == 0
    assert capsys.readouterr().out == f"firmware-sim {hil.__version__}\n"


def test_the_version_is_written_once() -> None:
    project = (ROOT / "pyproject.toml").read_text()
    assert 'dynamic = ["version"]' in project
    assert re.search(r'version = \{ ?attr = "hil.__version__" ?\}', project)
    assert not re.search(r'(?m)^version = "', project)


def test_starting_the_command_by_module() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "hil.cli", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"hil {hil.__version__}\n"
