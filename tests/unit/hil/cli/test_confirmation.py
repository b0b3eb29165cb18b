"""The question before a real arm moves."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from hil.cli import confirmation, main
from hil.cli.confirmation import confirm_motion, motion_lines
from hil.core.errors import HilError
from hil.shells import real_bus
from hil.shells.real_bus import check_interface, is_real
from hil.shells.run_setup import RunSetup, load_setup


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def setup() -> RunSetup:
    return load_setup(None, {}, {"vertical": "step:0.1@1", "horizontal": "hold", "rotation": "sine:0.2@0/4"})


@pytest.mark.parametrize(
    ("bus", "real"),
    [
        ("sim", False),
        ("vcan0", False),
        ("socketcan:vcan1", False),
        ("udp:43113", False),
        ("inproc:x", False),
        ("mycan", True),
        ("can0", True),
        ("socketcan:can0", True),
        ("slcan:/dev/ttyACM0", True),
        ("slcan:/dev/pts/3", True),
        ("carrier pigeon", True),
    ],
)
def test_an_unknown_kind_of_bus_counts_as_real(bus: str, real: bool) -> None:
    assert is_real(bus) is real


@pytest.mark.parametrize("bus", ["vcan7", "socketcan:vcan7"])
def test_an_adapter_that_was_renamed_to_a_virtual_bus_is_real(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bus: str
) -> None:
    monkeypatch.setattr(real_bus, "INTERFACES", tmp_path)
    assert not is_real(bus)
    (tmp_path / "vcan7" / "device").mkdir(parents=True)
    assert is_real(bus)


def test_each_axis_is_shown_with_position_and_target(setup: RunSetup) -> None:
    assert motion_lines(setup, [0.0123, -0.02, 0.1]) == [
        "  vertical     now +0.0123 m     step:0.1@1: between 0 and 0.1 m",
        "  horizontal   now -0.0200 m     holds its position",
        "  rotation     now +0.1000 rad   sine:0.2@0/4: between -0.2 and 0.2 rad",
    ]
    assert "now unknown" in motion_lines(setup, None)[0]


@pytest.fixture
def can0(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with the interface can0."""
    monkeypatch.setattr(real_bus, "INTERFACES", tmp_path)
    (tmp_path / "can0").mkdir()


@pytest.mark.usefixtures("can0")
@pytest.mark.parametrize("command", [["run"], ["collect", "--axis", "vertical"]])
def test_an_interface_that_does_not_exist_is_an_error_before_any_question(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
    assert main([*command, "--bus", "cna0"]) == 2
    error = capsys.readouterr().err
    assert "cna0: this machine has no interface cna0; did you mean can0?" in error
    assert "sudo ip link set cna0 up" in error


@pytest.mark.parametrize("bus", ["can0", "socketcan:can0", "slcan:/dev/none", "udp:43113", "inproc:x"])
@pytest.mark.usefixtures("can0")
def test_only_missing_interfaces_are_refused(bus: str) -> None:
    check_interface(bus)


@pytest.mark.usefixtures("can0")
def test_without_a_terminal_the_run_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
    assert main(["run", "--bus", "can0"]) == 2
    error = capsys.readouterr().err
    assert "can0 may be a real arm" in error
    assert "give --yes to move vertical, horizontal, rotation" in error


@pytest.mark.usefixtures("can0")
@pytest.mark.parametrize("answer", ["", "no\n", "y\n"])
def test_any_answer_but_yes_moves_nothing(
    setup: RunSetup, monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    screen = Terminal()
    monkeypatch.setattr("sys.stdin", Terminal(answer))
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setattr(confirmation, "_measure", lambda *_: None)
    with pytest.raises(HilError, match="not confirmed; nothing was moved"):
        confirm_motion(setup, "can0")
    assert "On can0, these axes will move:" in screen.getvalue()
    assert "positions are not known" in screen.getvalue()


@pytest.mark.usefixtures("can0")
def test_yes_goes_on(setup: RunSetup, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr("sys.stdin", Terminal("Yes\n"))
    monkeypatch.setattr("sys.stderr", screen)
    monkeypatch.setattr(confirmation, "_measure", lambda *_: [0.1, 0.0, 0.0])
    confirm_motion(setup, "can0")
    assert "now +0.1000 m" in screen.getvalue()


def test_measuring_opens_the_bus_and_listens_first(setup: RunSetup) -> None:
    """No board is on this bus."""
    assert confirmation._measure(setup, "inproc:confirmation") is None
