"""``hil collect``: an experiment through the gateway's own path, recorded and replayed to the byte."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.core.excitation import Prbs, samples
from hil.core.phase import Phase
from hil.recording.reader import Recording

TS = 0.0112
Collect = Callable[..., tuple[int, Recording | None, str]]


@pytest.fixture
def collect(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Collect:
    """Run ``hil collect`` in lockstep; gives exit status, recording and what was printed."""

    def run(*options: str, axis: str = "vertical") -> tuple[int, Recording | None, str]:
        path = tmp_path / "data.mcap"
        status = main(["collect", "--axis", axis, "--lockstep", "-o", str(path), *options])
        printed = capsys.readouterr()
        return status, Recording(path) if path.exists() else None, printed.out + printed.err

    return run


def excited_parts(recording: Recording, axis: str = "vertical") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    table = recording.axis(axis)
    excited = table["phase"] == Phase.EXCITED
    return excited, table["command_v"], table["position"]


def test_open_loop_gives_the_valve_its_offset_plus_the_excitation(collect: Collect) -> None:
    status, recording, printed = collect("--duration", "10", "--seed", "3")
    assert status == 0 and recording is not None
    excited, command_v, _ = excited_parts(recording)
    values = samples(Prbs(amplitude=0.4, duration_s=10.0, seed=3), TS)
    offset_v = float(recording.metadata["ending"]["valve offset, V"])
    # The first step passes the rate limit of the rig file within one period.
    np.testing.assert_allclose(command_v[excited], 5.0 + offset_v + values, atol=1e-9)
    assert abs(offset_v) < 0.1
    assert "inside the fence at -120 and 120 mm" in printed
    assert f"{len(values)} excited, 0 periods without a good sample" in printed
    assert "next        hil identify" in printed


def test_the_recording_holds_the_experiment_and_replays_to_the_byte(
    collect: Collect, capsys: pytest.CaptureFixture[str]
) -> None:
    _, recording, _ = collect("--excitation", "multisine", "--duration", "10")
    assert recording is not None
    assert b'"multisine"' in recording.attachments["experiment.json"]
    assert main(["replay", str(recording.path)]) == 0
    assert capsys.readouterr().out.startswith("identical")


def test_the_other_axes_keep_their_positions(collect: Collect) -> None:
    _, recording, _ = collect("--duration", "10")
    assert recording is not None
    for name in ("horizontal", "rotation"):
        table = recording.axis(name)
        running = table["running"]
        assert np.ptp(table["setpoint"][running]) == 0.0
        assert not table["phase"].any()


@pytest.mark.parametrize(
    ("options", "unit_amplitude"),
    [(("--excite", "controller"), 0.4), (("--excite", "setpoint", "--amplitude", "0.02"), 0.02)],
)
def test_in_closed_loop_the_axis_stays_near_its_centre(
    collect: Collect, options: tuple[str, ...], unit_amplitude: float
) -> None:
    status, recording, _ = collect("--duration", "10", *options)
    assert status == 0 and recording is not None
    table = recording.axis("vertical")
    excited = table["phase"] == Phase.EXCITED
    assert np.abs(table["position"][excited]).max() < 0.06
    if "setpoint" in options:
        assert set(np.round(table["setpoint"][excited], 9)) == {-unit_amplitude, unit_amplitude}


@pytest.mark.parametrize("axis", ["vertical", "horizontal", "rotation"])
def test_the_fence_keeps_every_axis_from_its_stops_and_the_experiment_goes_on(
    collect: Collect, axis: str
) -> None:
    status, recording, printed = collect("--amplitude", "1.2", "--duration", "8", axis=axis)
    assert status == 0 and recording is not None
    table = recording.axis(axis)
    assert int(recording.metadata["ending"]["fence crossings"]) >= 1
    assert "acts" in printed
    assert (table["phase"] == Phase.EXCITED).sum() == round(8.0 / TS)
    assert (table["phase"] == Phase.RECOVER).any()
    stop = 0.15 if axis != "rotation" else 1.6
    assert np.abs(table["position"][table["running"]]).max() < stop
    crossings = [entry for _, entry in recording.log() if "beyond its travel fence" in entry.text]
    assert len(crossings) == int(recording.metadata["ending"]["fence crossings"])


def test_dry_run_moves_and_writes_nothing(collect: Collect) -> None:
    status, recording, printed = collect("--dry-run")
    assert (status, recording) == (0, None)
    assert "prediction  simulated arm: vertical moves from" in printed


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--axis", "verticl"), "did you mean vertical?"),
        (("--excitation", "prsb"), "did you mean prbs?"),
        (("--clock", "3", "--excitation", "chirp"), "--clock does not belong to --excitation chirp"),
        (("--band", "3"), "--band 3: must be two frequencies in rad/s, such as 0.2:40"),
        (("--band", "1:300", "--excitation", "chirp"), "Nyquist frequency 280.5 rad/s"),
        (("--amplitude", "6"), "the excitation reaches 6 V, limit 4.9996 V"),
        (("--amplitude", "-1"), "--excitation prbs"),
        (("--levels", "4"), "--excitation prbs"),
        (("--centre", "0.2"), "centre: 0.2 m is not inside the travel fence"),
        (("--excite", "setpoint"), "the excitation reaches 0.4 m, limit 0.12 m"),
        (("--excitation", "csv"), "the file is missing; write --excitation csv:FILE"),
        (("--excitation", "csv:none.csv"), "none.csv"),
    ],
)
def test_wrong_options_are_refused_before_anything_moves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], complaint: str
) -> None:
    path = tmp_path / "data.mcap"
    axis = () if "--axis" in options else ("--axis", "vertical")
    status = main(["collect", "--lockstep", "-o", str(path), *axis, *options])
    assert status == 2
    assert complaint in capsys.readouterr().err
    assert not path.exists()


def test_a_real_bus_is_not_moved_without_a_yes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "data.mcap"
    status = main(
        ["collect", "--axis", "vertical", "--duration", "2", "--bus", "slcan:/dev/ttyACM7", "-o", str(path)]
    )
    assert status == 2
    assert "no terminal to ask on; give --yes to move vertical" in capsys.readouterr().err
    assert not path.exists()
