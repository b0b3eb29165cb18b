"""The systemd files: where they go, what they say, and that nothing is overwritten."""

from __future__ import annotations

import configparser
import os
from pathlib import Path

import pytest

from hil.cli import main
from hil.cli.unit_files import files_to_install, next_commands


def unit(text: str) -> dict[str, dict[str, str]]:
    parser = configparser.ConfigParser(interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(text)
    return {name: dict(parser[name]) for name in parser.sections()}


def test_the_system_unit_has_real_time_rights_and_a_network_file(tmp_path: Path) -> None:
    service, network = files_to_install(tmp_path, True, {}, ["/opt/hil/bin/python", "-m", "hil.cli"])
    assert service.path == tmp_path / "etc/systemd/system/hil-daemon.service"
    assert "@" not in service.text
    read = unit(service.text)["Service"]
    assert read["Type"] == "notify"
    assert read["WatchdogSec"] == "2"
    assert read["ExecStart"] == "/opt/hil/bin/python -m hil.cli daemon $HIL_DAEMON_OPTIONS"
    assert read["LimitRTPRIO"] == "49"
    assert read["StateDirectory"] == "hil"
    assert network.path == tmp_path / "etc/systemd/network/80-can0.network"
    assert unit(network.text)["CAN"]["BitRate"] == "500K"


def test_the_unit_of_a_user_needs_no_rights(tmp_path: Path) -> None:
    (service,) = files_to_install(tmp_path, False, {"HOME": str(tmp_path)}, ["hil"])
    assert service.path == tmp_path / ".config/systemd/user/hil-daemon.service"
    read = unit(service.text)
    assert read["Service"]["WorkingDirectory"] == "%h"
    assert read["Install"]["WantedBy"] == "default.target"
    assert "LimitRTPRIO" not in read["Service"]


def test_installing_prints_the_next_commands_and_overwrites_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    monkeypatch.setattr(os, "getuid", lambda: 1000)
    assert main(["daemon", "--install-unit"]) == 0
    said = capsys.readouterr().out
    path = tmp_path / "systemd/user/hil-daemon.service"
    assert f"installed {path}" in said
    assert "systemctl --user enable --now hil-daemon.service" in said
    path.write_text("mine")
    assert main(["daemon", "--install-unit"]) == 2
    assert "exists already; --force overwrites it" in capsys.readouterr().err
    assert path.read_text() == "mine"
    assert main(["daemon", "--install-unit", "--force"]) == 0
    assert path.read_text().startswith("# The hil daemon")


def test_the_system_restarts_its_network() -> None:
    assert "systemctl restart systemd-networkd" in next_commands(True)[0]
