"""The ends of a potentiometer on an axis that a person moves by keys, with a made-up daemon."""

from __future__ import annotations

import os
import pty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from support.gateway_bench import EXAMPLE_RIG
from support.operation_bench import status

from hil.cli import calibrate as command
from hil.cli import calibrate_jogged as module
from hil.cli.calibrate_jogged import JOG_S, SAMPLES, Hold, JoggedEnds, armed, check_daemon, keys_of_terminal
from hil.core.calibration import CalibrationError
from hil.core.errors import DocumentError, RequestRefusedError
from hil.core.rig import read_rig
from hil.operation.protocol import AxisStatus, Status

RIG = read_rig(EXAMPLE_RIG, "rig.toml")
LOW_V, HIGH_V = 1.0, 9.0


class MadeUpDaemon:
    """A daemon with one axis, which a jog moves by 0.5 V of its potentiometer up to an end."""

    def __init__(self, state: str = "ready") -> None:
        self.volts = 5.0
        self.rig = EXAMPLE_RIG
        self.state = state
        self.fault: str | None = None
        self.refusal: str | None = None
        self.calibrated: str | None = "vertical"
        self.jogs: list[tuple[str, float, float]] = []
        self.asked: list[str] = []
        self.period = 0

    def status(self) -> Status:
        axis = AxisStatus("vertical", "m", 0.0, 0.0, 0.0, 0.0, 5.0, self.volts)
        return status(
            state=self.state,
            fault=self.fault,
            period=self.period,
            axes=(axis,),
            calibrated_axis=self.calibrated,
        )

    def watch(self, _interval_s: float) -> Iterator[Status]:
        while True:
            self.period += 9
            yield self.status()

    def jog(self, axis: str, offset_v: float, duration_s: float) -> str:
        if self.refusal is not None:
            raise RequestRefusedError(self.refusal)
        self.jogs.append((axis, offset_v, duration_s))
        self.volts = min(max(self.volts + (0.5 if offset_v > 0 else -0.5), LOW_V), HIGH_V)
        return "jog goes on"

    def rig_text(self) -> str:
        return self.rig

    def arm(self) -> str:
        self.asked.append("arm")
        self.state = "armed"
        return "armed"

    def disarm(self) -> str:
        self.asked.append("disarm")
        if self.state != "armed":
            raise RequestRefusedError(f"disarm refused in state {self.state}")
        self.state = "ready"
        return "ready"

    def __enter__(self) -> MadeUpDaemon:
        return self

    def __exit__(self, *_error: object) -> None:
        pass


def pressing(*keys: str) -> Callable[[], str]:
    """One text of keys for each look; then nothing."""
    waiting = iter(keys)
    return lambda: next(waiting, "")


def ends(daemon: MadeUpDaemon, *keys: str) -> JoggedEnds:
    fake: Any = daemon
    return JoggedEnds(fake, RIG, "vertical", 0.3, pressing(*keys))


def test_an_end_is_measured_while_a_key_presses_the_axis_against_it() -> None:
    daemon = MadeUpDaemon()
    volts = ends(daemon, *["-"] * (8 + SAMPLES), "\n").end("its lower end")
    assert volts.mean_v[0] == pytest.approx(LOW_V)
    assert set(daemon.jogs) == {("vertical", -0.3, JOG_S)}


def test_the_other_key_moves_the_other_way() -> None:
    daemon = MadeUpDaemon()
    assert ends(daemon, *["+"] * (8 + SAMPLES), "\n").end("its upper end").mean_v[0] == pytest.approx(HIGH_V)
    assert set(daemon.jogs) == {("vertical", 0.3, JOG_S)}


def test_without_a_key_nothing_moves(capsys: pytest.CaptureFixture[str]) -> None:
    daemon = MadeUpDaemon()
    with pytest.raises(CalibrationError, match="given up; nothing is written"):
        ends(daemon, *[""] * 50, "x", "\n", "q").end("its lower end")
    assert daemon.jogs == []
    assert "It has not stood still yet (5.000 V); hold the key for longer." in capsys.readouterr().err


def test_a_moving_axis_has_not_stood_still() -> None:
    hold = Hold(1, "vertical")
    for number in range(2 * SAMPLES):
        hold.take("-", (8.0 - 0.05 * number, 5.0, 5.0))
    assert hold.rested is None


def test_a_pause_or_another_key_begins_anew() -> None:
    hold = Hold(1, "vertical")
    for _ in range(SAMPLES):
        hold.take("-", (LOW_V, 5.0, 5.0))
    assert hold.rested is not None
    for _ in range(20):
        hold.take("", (4.0, 5.0, 5.0))
    assert hold.rested.mean_v[0] == LOW_V, "where it stood still counts, not where it went then"
    hold.take("-", (4.0, 5.0, 5.0))
    assert hold.rested is None
    for _ in range(SAMPLES):
        hold.take("-", (LOW_V, 5.0, 5.0))
    hold.take("+", (LOW_V, 5.0, 5.0))
    assert hold.rested is None


def test_a_place_between_is_where_the_axis_is() -> None:
    volts = ends(MadeUpDaemon(), "+", "+", "\n").between("a place between")
    assert volts.mean_v[0] == 6.0


def test_a_refused_jog_is_shown_and_a_fault_ends_the_measurement(
    capsys: pytest.CaptureFixture[str],
) -> None:
    daemon = MadeUpDaemon()
    daemon.refusal = "jog refused: enable: nobody holds the switch"
    with pytest.raises(CalibrationError, match="given up"):
        ends(daemon, "-", "q").end("its lower end")
    assert "nobody holds the switch" in capsys.readouterr().err
    daemon.fault, daemon.state = "adc: silent", "fault"
    with pytest.raises(CalibrationError, match="the daemon is in a fault: adc: silent"):
        ends(daemon, "-").end("its lower end")


def test_the_daemon_must_be_one_for_this_calibration() -> None:
    daemon = MadeUpDaemon()
    check_daemon(daemon.status(), "vertical")
    with pytest.raises(CalibrationError, match="start it with `hil daemon --calibrate rotation`"):
        check_daemon(daemon.status(), "rotation")
    daemon.state = "offline"
    with pytest.raises(CalibrationError, match="the daemon is in state offline"):
        check_daemon(daemon.status(), "vertical")


@pytest.mark.parametrize(("state", "asked"), [("ready", ["arm", "disarm"]), ("armed", [])])
def test_the_daemon_is_left_as_it_was(state: str, asked: list[str]) -> None:
    daemon: Any = MadeUpDaemon(state)
    with armed(daemon):
        pass
    assert daemon.asked == asked
    assert daemon.state == state


def test_a_daemon_that_faults_meanwhile_has_nothing_to_disarm() -> None:
    daemon: Any = MadeUpDaemon()
    with armed(daemon):
        daemon.state = "fault"
    assert daemon.asked == ["arm", "disarm"]
    assert daemon.state == "fault"


def test_the_last_jog_ends_before_the_daemon_is_disarmed() -> None:
    daemon: Any = MadeUpDaemon()

    def watch(_interval_s: float) -> Iterator[Status]:
        for state in ("running", "running", "armed"):
            daemon.state = state
            yield daemon.status()

    with armed(daemon):
        daemon.state = "running"
        daemon.watch = watch
    assert (daemon.asked, daemon.state) == (["arm", "disarm"], "ready")


def test_keys_are_read_one_by_one_and_the_terminal_is_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        before = module.termios.tcgetattr(theirs)
        with keys_of_terminal() as pressed:
            assert pressed() == ""
            os.write(ours, b"--")
            assert module.select([theirs], [], [], 10.0)[0]
            assert pressed() == "--"
        assert module.termios.tcgetattr(theirs) == before
    os.close(ours)


def test_without_a_terminal_nothing_is_jogged(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "input").write_text("")
    with (tmp_path / "input").open() as file:
        monkeypatch.setattr("sys.stdin", file)
        with pytest.raises(CalibrationError, match="needs a terminal"), keys_of_terminal():
            pass


def test_the_command_writes_what_it_measured(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, new = tmp_path / "rig.toml", tmp_path / "new.toml"
    rig.write_text(EXAMPLE_RIG)
    keys = [*["-"] * (8 + SAMPLES), "\n", *["+"] * (16 + SAMPLES), "\n", "-", "-", "\n"]
    daemon = MadeUpDaemon()
    monkeypatch.setattr(command, "connect", lambda _socket: daemon)
    monkeypatch.setattr(command, "keys_of_terminal", lambda: _Given(pressing(*keys)))
    arguments = ["--axis", "vertical", "--low", "-0.15", "--high", "0.15", "--jog", "--yes"]
    assert command.main([*arguments, "--rig", str(rig), "-o", str(new)]) == 0
    pot = read_rig(new.read_text(), "new.toml").axes["vertical"].potentiometer
    assert (pot.position(LOW_V), pot.position(HIGH_V)) == pytest.approx((-0.15, 0.15), abs=1e-5)
    assert "moved by jogs, recording one.mcap" in new.read_text()
    assert {offset_v for _, offset_v, _ in daemon.jogs} == {0.3, -0.3}
    daemon.rig = EXAMPLE_RIG.replace("channel = 1", "channel = 0").replace("channel = 3", "channel = 1")
    daemon.rig = daemon.rig.replace("channel = 0", "channel = 3")
    assert command.main([*arguments, "--rig", str(rig)]) == 1
    assert "potentiometer.channel is 3 in the daemon and 1 in the file" in capsys.readouterr().err
    daemon.calibrated = None
    assert command.main([*arguments, "--rig", str(rig)]) == 1
    assert "hil daemon --calibrate vertical" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments",
    [
        ["--valve", "--jog"],
        ["--low", "0", "--high", "1", "--jog", "-0.3"],
        ["--low", "0", "--high", "1", "--jog", "0"],
    ],
)
def test_wrong_options_are_refused(arguments: list[str]) -> None:
    with pytest.raises(DocumentError, match="--jog"):
        command.main(["--axis", "vertical", *arguments])


class _Given:
    """A context that gives a value."""

    def __init__(self, value: Callable[[], str]) -> None:
        self._value = value

    def __enter__(self) -> Callable[[], str]:
        return self._value

    def __exit__(self, *_error: object) -> None:
        pass
