"""From excitation to a verified controller, as commands: collect, identify, design, run, and tune."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from design.margin_summary import loop_margins
from design.models.plant import read_plant
from hil.cli import main
from hil.core.controller_file import read_controller
from hil.recording import open_recording

EQ_15 = {"velocity": 0.47947 * 90.76 / 167.9, "slow": 0.4231, "mode": math.sqrt(167.9), "damping": 8.485}


def collect(path: Path, seed: int, *options: str, axis: str = "vertical") -> None:
    arguments = ["collect", "--axis", axis, "--lockstep", "--seed", str(seed), "-o", str(path), *options]
    assert main(arguments) == 0


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two records of the vertical axis, of 60 s each."""
    folder = tmp_path_factory.mktemp("records")
    for seed in (1, 2):
        collect(folder / f"{seed}.mcap", seed)
    return folder


def modes(den: list[float]) -> tuple[float, float, float]:
    """Slow pole, natural frequency and damping ratio of a third-order denominator."""
    slow, *pair = sorted(np.roots(den), key=abs)
    frequency = abs(pair[0])
    return -float(slow.real), float(frequency), float(-pair[0].real / frequency)


@pytest.mark.parametrize("seed", range(1, 11))
def test_the_arm_identifies_as_equation_15_through_boards_and_bus(tmp_path: Path, seed: int) -> None:
    """Within the tolerances that identified values spread by, with seed and amplitude."""
    data, plant_file = tmp_path / "data.mcap", tmp_path / "plant.json"
    collect(data, seed)
    assert main(["identify", str(data), "-o", str(plant_file)]) == 0
    plant = read_plant(plant_file.read_text(), "plant.json")
    slow, mode, damping = modes(plant.den)
    gain = plant.num[-1] / plant.den[-1]
    assert gain * slow == pytest.approx(EQ_15["velocity"], rel=0.05)
    assert slow == pytest.approx(EQ_15["slow"], rel=0.15)
    assert mode == pytest.approx(EQ_15["mode"], rel=0.10)
    assert damping == pytest.approx(EQ_15["damping"] / EQ_15["mode"], rel=0.15)


def test_the_plant_file_says_where_the_model_comes_from(
    records: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant_file = tmp_path / "vertical.json"
    status = main(
        ["identify", str(records / "1.mcap"), "--validate", str(records / "2.mcap"), "-o", str(plant_file)]
    )
    assert status == 0
    printed = capsys.readouterr().out
    assert "next        hil design" in printed
    document = json.loads(plant_file.read_text())
    assert document["fit"]["2.mcap"] > 98.0
    assert document.get("contains_delay_samples", 0) == 0
    assert document["conditions"]["mode"] == "open loop"
    assert document["conditions"]["amplitude"] == 0.4
    assert len(document["recording"]) == 64
    assert len(document["covariance"]["matrix"]) == len(document["covariance"]["parameters"]) >= 4
    report = plant_file.with_name("vertical.html").read_text()
    assert "<svg" in report


def test_the_measured_loop_has_the_predicted_margins(records: Path, tmp_path: Path) -> None:
    """The delays are counted once: model, loop delay and rig agree on the phase at the crossover.

    The loop is excited at the controller's output, on the linear plant that the model was identified as. The
    measured loop gain is -(what the controller answers)/(what the valve got), by averaged spectra.
    """
    plant_file, out = tmp_path / "plant.json", tmp_path / "design"
    assert main(["identify", str(records / "1.mcap"), "-o", str(plant_file)]) == 0
    assert main(["design", str(plant_file), "--out", str(out)]) in (0, 1)
    controller = out / "controller.json"
    data = tmp_path / "loop.mcap"
    collect(
        data,
        5,
        "--excite",
        "controller",
        "--plant",
        f"vertical={plant_file}",
        "--controller",
        f"vertical={controller}",
        "--excitation",
        "multisine",
        "--duration",
        "120",
        "--repetitions",
        "4",
        "--band",
        "0.5:40",
        "--amplitude",
        "0.4",
    )
    axis = open_recording(data).axis("vertical")
    excited = axis[axis.phase == 3]
    once = len(excited) // 4
    valve = (excited.command_v - 5.0)[once:].reshape(3, once).mean(axis=0)
    position = excited.position[once:].reshape(3, once).mean(axis=0)
    lines = slice(3, 185)  # within the band
    omega = 2.0 * np.pi * np.fft.rfftfreq(once, 0.0112)[lines]
    measured_plant = (np.fft.rfft(position) / np.fft.rfft(valve))[lines]
    plant = read_plant(plant_file.read_text(), "plant.json")
    file = read_controller(controller.read_text(), "controller")
    predicted = loop_margins(plant, file)
    loop = measured_plant * controller_response(file, omega)
    crossing = int(np.flatnonzero(np.abs(loop) >= 1.0)[-1])
    assert omega[crossing] == pytest.approx(predicted.crossover_rad_s, rel=0.05)
    phase = np.unwrap(np.angle(loop))[crossing]
    assert math.pi + phase == pytest.approx(predicted.phase_margin_rad, abs=0.06)


def controller_response(file: object, omega: np.ndarray) -> np.ndarray:
    from hil.core.control_law import realise

    A, B, C, D = realise(file.law, file.sample_time_s)  # type: ignore[attr-defined]
    z = np.exp(1j * omega * file.sample_time_s)  # type: ignore[attr-defined]
    n = len(A)
    inner = np.linalg.solve(z[:, None, None] * np.eye(n) - A, np.broadcast_to(B[:, :1], (len(z), n, 1)))
    return np.asarray((C @ inner + D[:, :1])[:, 0, 0])


def test_nothing_is_overwritten_without_force(
    records: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant_file = tmp_path / "plant.json"
    plant_file.write_text("mine")
    assert main(["identify", str(records / "1.mcap"), "-o", str(plant_file)]) == 2
    assert "exists already; give another name, or --force" in capsys.readouterr().err
    assert plant_file.read_text() == "mine"


def test_a_record_that_allows_no_model_writes_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "constant.csv"
    path.write_text("time_s,u,y\n" + "".join(f"{k * 0.0112:.4f},0,{0.01 * (k % 7)}\n" for k in range(3000)))
    plant_file = tmp_path / "plant.json"
    assert main(["identify", str(path), "-o", str(plant_file)]) == 2
    assert "no model was written" in capsys.readouterr().err
    assert not plant_file.exists()


@pytest.mark.parametrize("axis", ["vertical", "horizontal", "rotation"])
def test_a_tuned_controller_meets_its_specifications_with_and_without_load(
    axis: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["tune", "--axis", axis, "--lockstep"]) == 0
    page = (tmp_path / "tuning" / axis / "tuning.html").read_text()
    assert "<svg" in page
    experiments = sorted(path.name for path in (tmp_path / "tuning" / axis).glob("*.mcap"))
    times = {path: (tmp_path / "tuning" / axis / path).stat().st_mtime_ns for path in experiments}
    assert {"nominal-1.mcap", "nominal-2.mcap", "loaded-1.mcap", "loaded-2.mcap"} <= set(experiments)
    capsys.readouterr()
    # A second call resumes: no experiment is repeated, and the result is the same.
    assert main(["tune", "--axis", axis, "--lockstep"]) == 0
    assert "going on with an earlier tuning" in capsys.readouterr().out
    assert times == {path: (tmp_path / "tuning" / axis / path).stat().st_mtime_ns for path in experiments}


def test_a_folder_of_another_tuning_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "tuning" / "vertical"
    folder.mkdir(parents=True)
    (folder / "tune.json").write_text("{}")
    assert main(["tune", "--axis", "vertical", "--lockstep"]) == 2
    assert "holds the results of another tuning" in capsys.readouterr().err
