"""``hil calibrate`` with a hand that moves the axis, and with a daemon that jogs it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.board_bench import HandPlant
from support.boards_on_a_link import BoardsOnALink
from support.gateway_bench import EXAMPLE_RIG

from hil.cli import calibrate as command
from hil.core.calibration import CalibrationError
from hil.core.calibration_rig import calibration_text
from hil.core.errors import DocumentError
from hil.core.frames import Frame
from hil.core.rig import read_rig
from hil.core.rig_edit import ORIGIN
from hil.core.wire import codec

POTENTIOMETER = ["--axis", "vertical", "--low", "-0.16", "--high", "0.16", "--bus", "test"]
VALVE = ["--axis", "vertical", "--valve", "--yes"]


class Hand:
    """Moves the potentiometer of the vertical axis, and presses Enter."""

    def __init__(self, volts: list[float]) -> None:
        self.plant = HandPlant()
        self.link = BoardsOnALink(self.plant)
        self.volts = volts
        self._waited = 0

    def is_entered(self) -> bool:
        """Press Enter after the picture has been shown a few times, with the axis at the next place."""
        self._waited += 1
        if self._waited % 15:
            return False
        if not self.volts:
            raise CalibrationError("the input ended before the measurement was complete")
        self.plant.volts[0] = self.volts.pop(0)
        self.link.now_ns += 200_000_000  # a sample from before is not measured
        return True


@pytest.fixture
def hand(monkeypatch: pytest.MonkeyPatch) -> Callable[[list[float]], Hand]:
    def make(volts: list[float]) -> Hand:
        made = Hand(volts)
        link = made.link
        monkeypatch.setattr(BoardsOnALink, "__enter__", lambda self: self, raising=False)
        monkeypatch.setattr(BoardsOnALink, "__exit__", lambda *_arguments: None, raising=False)
        monkeypatch.setattr(command, "open_link", lambda _spec, _bit_rate: link)
        monkeypatch.setattr(command, "enter_pressed", made.is_entered)
        monkeypatch.setattr(command, "time", SimpleNamespace(monotonic_ns=link.clock_ns))
        return made

    return make


@pytest.fixture
def rig_file(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(EXAMPLE_RIG)
    return path


class TestPotentiometer:
    def test_the_values_are_printed_and_written_to_a_new_file(
        self, hand: Callable[[list[float]], Hand], rig_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        moved = hand([9.0, 1.0, 5.5])
        new = rig_file.with_name("new.toml")
        assert command.main([*POTENTIOMETER, "--rig", str(rig_file), "-o", str(new)]) == 0
        pot = read_rig(new.read_text(), "new.toml").axes["vertical"].potentiometer
        assert (pot.position(9.0), pot.position(1.0)) == pytest.approx((-0.16, 0.16), abs=2e-4)
        assert (pot.min_v, pot.max_v) == pytest.approx((0.84, 9.16), abs=0.01)
        assert f"{ORIGIN}20" in new.read_text()
        assert rig_file.read_text() == EXAMPLE_RIG
        captured = capsys.readouterr()
        assert "[axes.vertical.potentiometer]\ny_at_0v = 0.2" in captured.out
        assert "its lower end, -0.16 m: 8.999 V" in captured.err
        assert {frame.id for _, frame in moved.link.sent} <= {codec.SYNC, codec.NMT}, "nothing is moved"

    def test_with_force_the_file_itself_changes(
        self, hand: Callable[[list[float]], Hand], rig_file: Path
    ) -> None:
        hand([1.0, 9.0, 5.0])
        assert command.main([*POTENTIOMETER, "--rig", str(rig_file), "--force"]) == 0
        pot = read_rig(rig_file.read_text(), "rig.toml").axes["vertical"].potentiometer
        assert pot.position(1.0) == pytest.approx(-0.16, abs=2e-4)
        assert [path.name for path in rig_file.parent.iterdir()] == ["rig.toml"]

    def test_without_a_file_nothing_is_written(
        self, hand: Callable[[list[float]], Hand], capsys: pytest.CaptureFixture[str]
    ) -> None:
        hand([1.0, 9.0, 5.0])
        assert command.main(POTENTIOMETER) == 0
        assert "not written: give -o NEW.toml" in capsys.readouterr().out

    @pytest.mark.parametrize(
        ("volts", "text"),
        [
            ([5.0, 5.2, 5.1], "0.200 V apart, at least 1 V are needed"),
            ([1.0, 9.0, 9.5], "is not between 1.001 V and 8.999 V"),
            ([1.0, 9.0], "the input ended"),
        ],
    )
    def test_nonsense_has_status_1_and_writes_nothing(
        self,
        hand: Callable[[list[float]], Hand],
        rig_file: Path,
        capsys: pytest.CaptureFixture[str],
        volts: list[float],
        text: str,
    ) -> None:
        hand(volts)
        assert command.main([*POTENTIOMETER, "--rig", str(rig_file), "--force"]) == 1
        assert text in capsys.readouterr().err
        assert rig_file.read_text() == EXAMPLE_RIG

    def test_a_measurement_during_motion_is_repeated(
        self,
        hand: Callable[[list[float]], Hand],
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
    ) -> None:
        moved = hand([1.0, 1.0, 9.0, 5.0])
        measured: list[int] = []

        def volts() -> list[float]:
            if len(moved.volts) == 3:  # during the first measurement
                measured.append(1)
                moved.plant.volts[0] += 0.005
            return moved.plant.volts

        monkeypatch.setattr(moved.plant, "potentiometer_v", volts)
        assert command.main(POTENTIOMETER) == 0
        assert "hold the axis still and repeat" in capsys.readouterr().err
        assert measured

    def test_a_range_that_the_new_scaling_does_not_reach_is_refused(
        self, hand: Callable[[list[float]], Hand], rig_file: Path
    ) -> None:
        hand([1.0, 9.0, 5.0])
        arguments = ["--axis", "vertical", "--low", "-0.05", "--high", "0.05", "--bus", "test"]
        with pytest.raises(DocumentError, match=r"rig\.toml with these values: axes\.vertical\.min_y"):
            command.main([*arguments, "--rig", str(rig_file), "--force"])
        assert rig_file.read_text() == EXAMPLE_RIG

    def test_a_gateway_that_moves_the_valve_is_refused(
        self, hand: Callable[[list[float]], Hand], capsys: pytest.CaptureFixture[str]
    ) -> None:
        moved = hand([1.0])
        data = codec.encode_rpdo1_dac(6.0, 5.0, 5.0, 0, 0)
        moved.link.foreign.append((100_000_000, Frame(codec.RPDO1_DAC, data)))
        assert command.main(POTENTIOMETER) == 1
        assert "a gateway holds its valve at 6.000 V, not at the centre 5 V" in capsys.readouterr().err


class Daemon:
    """A daemon whose axis moves with a speed proportional to the valve's distance from its centre."""

    TRUE_CENTRE_V = 0.07

    def __init__(self) -> None:
        self.state = "ready"
        self.recording: str | None = "runs/a.mcap"
        self.rig = EXAMPLE_RIG
        self.requests: list[str] = []
        self.gives_positions = True
        self._now_s = self._position = self._speed = 0.0
        self._end_s = 0.0

    def __enter__(self) -> Daemon:
        return self

    def __exit__(self, *_arguments: object) -> None: ...

    def status(self) -> SimpleNamespace:
        position = self._position if self.gives_positions else None
        axis = SimpleNamespace(name="vertical", position=position)
        return SimpleNamespace(
            state=self.state,
            fault="adc: lost",
            recording=self.recording,
            time_ns=round(self._now_s * 1e9),
            axes=(SimpleNamespace(name="rotation", position=0.0), axis),
        )

    def rig_text(self) -> str:
        return self.rig

    def arm(self) -> None:
        self.requests.append("arm")

    def disarm(self) -> None:
        self.requests.append("disarm")

    def jog(self, _axis: str, offset_v: float, duration_s: float) -> None:
        self.requests.append("jog")
        self._speed = 0.3 * (offset_v - self.TRUE_CENTRE_V)
        self._end_s = self._now_s + duration_s

    def watch(self, interval_s: float) -> Iterator[SimpleNamespace]:
        for _ in range(100):
            yield self.status()
            moving_s = min(max(self._end_s - self._now_s, 0.0), interval_s)
            self._position += self._speed * moving_s
            self._now_s += interval_s


class TestValve:
    @pytest.fixture
    def daemon(self, monkeypatch: pytest.MonkeyPatch) -> Daemon:
        made = Daemon()
        monkeypatch.setattr(command, "connect", lambda _socket: made)
        return made

    def test_the_centre_is_found_and_written_with_the_recording(self, daemon: Daemon, rig_file: Path) -> None:
        assert command.main([*VALVE, "--rig", str(rig_file), "--force"]) == 0
        text = rig_file.read_text()
        assert read_rig(text, "rig.toml").axes["vertical"].valve.centre_v == pytest.approx(5.07)
        assert "recording a.mcap" in text
        assert daemon.requests[0] == "arm"
        assert daemon.requests[-1] == "disarm"

    def test_a_daemon_that_was_armed_stays_armed(self, daemon: Daemon) -> None:
        daemon.state, daemon.recording = "armed", None
        assert command.main(VALVE) == 0
        assert set(daemon.requests) == {"jog"}

    @pytest.mark.parametrize("state", ["offline", "running", "fault"])
    def test_in_another_state_nothing_moves(
        self, daemon: Daemon, state: str, capsys: pytest.CaptureFixture[str]
    ) -> None:
        daemon.state = state
        assert command.main(VALVE) == 1
        assert f"the daemon is in state {state}" in capsys.readouterr().err
        assert daemon.requests == []

    def test_a_fault_during_a_jog_ends_it(
        self, daemon: Daemon, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
    ) -> None:
        monkeypatch.setattr(daemon, "jog", lambda *_arguments: setattr(daemon, "state", "fault"))
        assert command.main(VALVE) == 1
        assert "the daemon is in a fault: adc: lost" in capsys.readouterr().err
        assert daemon.requests == ["arm", "disarm"]

    @pytest.mark.parametrize("is_written", [False, True])
    def test_it_says_before_the_axis_moves_that_nothing_will_be_written(
        self,
        daemon: Daemon,
        monkeypatch: pytest.MonkeyPatch,
        capsys: pytest.CaptureFixture[str],
        rig_file: Path,
        is_written: bool,
    ) -> None:
        monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=lambda: "no\n"))
        arguments = [*VALVE[:-1], "--rig", str(rig_file), *(["--force"] if is_written else [])]
        assert command.main(arguments) == 1
        error = capsys.readouterr().err
        assert error.startswith("The values will be printed, but not written: give -o") is not is_written
        assert "vertical will move to and fro" in error
        assert daemon.requests == []

    def test_it_is_refused_after_a_calibration_without_a_restart_of_the_daemon(
        self, daemon: Daemon, rig_file: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        arguments = [*VALVE, "--rig", str(rig_file), "--force"]
        assert command.main(arguments) == 0
        written = rig_file.read_text()
        daemon.requests.clear()
        assert command.main(arguments) == 1
        assert "valve.centre_v is 5 in the daemon and 5.07 in the file" in capsys.readouterr().err
        assert daemon.requests == []
        assert rig_file.read_text() == written
        daemon.rig, daemon.TRUE_CENTRE_V = written, 0.0
        assert command.main(arguments) == 0
        assert read_rig(rig_file.read_text(), "rig.toml").axes["vertical"].valve.centre_v == pytest.approx(
            5.07
        )

    def test_a_daemon_that_calibrates_the_axis_fits_its_rig_file(
        self, daemon: Daemon, rig_file: Path
    ) -> None:
        daemon.rig = calibration_text(EXAMPLE_RIG, "vertical", "rig.toml")
        assert command.main([*VALVE, "--rig", str(rig_file), "--force"]) == 0

    def test_without_positions_it_ends(self, daemon: Daemon, capsys: pytest.CaptureFixture[str]) -> None:
        daemon.gives_positions = False
        assert command.main(VALVE) == 1
        assert "the daemon gave no positions" in capsys.readouterr().err

    @pytest.mark.parametrize(("answer", "status"), [("yes\n", 0), ("no\n", 1), ("", 1)])
    def test_it_asks_before_the_axis_moves(
        self, daemon: Daemon, monkeypatch: pytest.MonkeyPatch, answer: str, status: int
    ) -> None:
        monkeypatch.setattr("sys.stdin", SimpleNamespace(readline=lambda: answer))
        assert command.main(VALVE[:-1]) == status
        assert (daemon.requests == []) == (status == 1)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--axis", "vertikal", "--valve"], "--axis vertikal: the axes of the rig are"),
        (["--axis", "vertical"], "give --low and --high"),
        (["--axis", "vertical", "--low", "0"], "give --low and --high"),
        (["--axis", "vertical", "--low", "0", "--high", "1", "--valve"], "do not go together"),
        (["--axis", "vertical", "--low", "0", "--valve"], "do not go together"),
        (["--axis", "vertical", "--high", "0"], "give --low and --high"),
        (["--axis", "vertical", "--low", "0", "--high", "inf"], "positions must be finite numbers"),
        ([*VALVE, "--force"], "--rig is missing"),
        ([*VALVE, "--rig", "RIG", "-o", "RIG"], "exists already and is kept"),
    ],
)
def test_wrong_arguments_are_refused(arguments: list[str], text: str, rig_file: Path) -> None:
    with pytest.raises(DocumentError, match=text):
        command.main([str(rig_file) if argument == "RIG" else argument for argument in arguments])


def test_enter_is_seen_once_for_each_line(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    monkeypatch.setattr("sys.stdin", SimpleNamespace(fileno=lambda: reader))
    assert not command.enter_pressed()
    os.write(writer, b"\nok\n")
    assert [command.enter_pressed() for _ in range(3)] == [True, True, False]
    os.close(writer)
    with pytest.raises(CalibrationError, match="the input ended"):
        command.enter_pressed()
    os.close(reader)
