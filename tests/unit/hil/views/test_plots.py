"""The plot of a run: the colours in the picture, its axis ranges and its marks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread
from support.recorded_runs import (
    AXES,
    PERIOD_NS,
    RUN_HEADER,
    START_NS,
    following,
    in_memory,
    record_periods,
    record_run,
)

from hil.core.errors import RecordingError
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import LogEntry, Severity
from hil.core.wire.codec import TPDO1_ADC
from hil.recording.reader import Recording
from hil.recording.recorder import ARM_EVENTS, Recorder
from hil.views.plots import (
    BLUE,
    DPI,
    GREEN,
    GREY,
    HEIGHT_IN,
    PANEL_WIDTH_IN,
    VERMILION,
    _event_marks,
    plot_run,
)


def drawn(recording_path: Path) -> npt.NDArray[np.float32]:
    picture = recording_path.with_suffix(".png")
    plot_run(Recording(recording_path), picture)
    return imread(picture)[:, :, :3]


def pixels_of(image: npt.NDArray[np.float32], colour: str, alpha: float = 1.0) -> npt.NDArray[np.bool_]:
    on_white = alpha * np.array(to_rgb(colour)) + 1.0 - alpha
    return np.all(np.abs(image - on_white) < 0.015, axis=2)


def faulted_run(path: Path) -> Path:
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 200)
    recorder.log_entry(
        LogEntry(Severity.FATAL, "adc", "no good sample for 3 periods"), START_NS + 2_240_000_000
    )
    record_periods(recorder, 200, first=200, state=LifeCycleState.FAULT)
    recorder.close({})
    return path


def test_every_axis_has_its_position_above_its_valve_voltage(tmp_path: Path) -> None:
    record_run(tmp_path / "run.mcap", 300)
    image = drawn(tmp_path / "run.mcap")
    height, width, _ = image.shape
    assert (width, height) == (round(PANEL_WIDTH_IN * len(AXES) * DPI), round(HEIGHT_IN * DPI))
    upper, lower = image[: height // 2], image[height * 5 // 8 :]
    for column in range(3):
        part = slice(column * width // 3, (column + 1) * width // 3)
        assert pixels_of(upper[:, part], BLUE).sum() > 300
        assert pixels_of(lower[:, part], GREEN).sum() > 100
        assert not pixels_of(lower[:, part], BLUE).any()


def test_one_axis_is_drawn_alone(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    header = msgspec.structs.replace(RUN_HEADER, axes=(("elbow", "rad"),))
    with in_memory(path):
        recorder = Recorder(path, header, lossless=True)
    record_periods(recorder, 100, axes=1)
    recorder.close({})
    assert drawn(path).shape[1] == round(PANEL_WIDTH_IN * DPI)


def test_a_fault_is_shaded_and_named(tmp_path: Path) -> None:
    record_run(tmp_path / "good.mcap", 400)
    good, bad = drawn(tmp_path / "good.mcap"), drawn(faulted_run(tmp_path / "bad.mcap"))
    assert not pixels_of(good, VERMILION, 0.15).any()
    shaded = pixels_of(bad, VERMILION, 0.15)
    assert 0.15 < shaded.mean() < 0.5
    assert pixels_of(good, GREY, 0.15).any()
    title = slice(0, 40)
    assert not pixels_of(good[title], VERMILION).any()
    assert pixels_of(bad[title], VERMILION).sum() > 50


def test_planned_events_of_the_arm_are_marked_at_their_times(tmp_path: Path) -> None:
    """Event times count from the first sample. An event after the end of the run changes nothing."""
    recording_path = tmp_path / "run.mcap"
    planned = {"payload:3@1": "1.0", "temperature:0@1": "1.0", "payload:0@99": "99.0"}
    metadata = {**RUN_HEADER.metadata, ARM_EVENTS: planned}
    record_run(recording_path, 300, header=msgspec.structs.replace(RUN_HEADER, metadata=metadata))
    recording = Recording(recording_path)
    start_s = float(recording.timing().time_s[3])
    first_sample_s = recording.frames("received", TPDO1_ADC).time_s[0] - start_s
    assert _event_marks(recording, start_s) == [
        (pytest.approx(1.0 + first_sample_s), "payload:3, temperature:0"),
        (pytest.approx(98.967, abs=0.002), "payload:0"),
    ]
    with_marks = drawn(recording_path)
    record_run(tmp_path / "plain.mcap", 300)
    plain = drawn(tmp_path / "plain.mcap")
    columns = np.flatnonzero((np.abs(with_marks - plain).max(axis=2) > 0.3).sum(axis=0) > 100)
    assert 3 <= len(columns) <= 9, "a thin line a panel"
    width = plain.shape[1] / 3
    places = columns / width % 1.0
    assert np.ptp(places) < 0.05
    assert 0.3 < places.mean() < 0.5


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that are drawn from here on."""
    drawn_figures: list[Figure] = []
    savefig = Figure.savefig

    def keep(figure: Figure, *arguments: object, **options: object) -> None:
        drawn_figures.append(figure)
        savefig(figure, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Figure, "savefig", keep)
    return drawn_figures


def spans(figure: Figure) -> list[float]:
    """Ranges of the position panels, then of the valve voltage panels."""
    return [float(np.ptp(panel.get_ylim())) for panel in figure.axes]


@pytest.mark.parametrize(("axis", "span"), [("vertical", 0.01), ("rotation", 0.1)])
def test_a_quiet_axis_is_not_scaled_to_its_noise(
    tmp_path: Path, figures: list[Figure], axis: str, span: float
) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 300, following(lambda t: 0.05, lambda t: 0.05 + 1e-5 * (t > 1.0)))
    recorder.close({})
    plot_run(Recording(path), tmp_path / "run.png", axes=[axis])
    assert spans(figures[0]) == pytest.approx([span, 1.0])
    assert np.mean(figures[0].axes[0].get_ylim()) == pytest.approx(0.05, abs=1e-4)


def test_a_moving_axis_fills_its_panel(tmp_path: Path, figures: list[Figure]) -> None:
    record_run(tmp_path / "run.mcap", 300)
    plot_run(Recording(tmp_path / "run.mcap"), tmp_path / "run.png")
    assert spans(figures[0])[:3] == pytest.approx([0.12] * 3, rel=0.01)


@pytest.mark.parametrize("title", ["costs $5 and $x_{ a", r"\frac{", "$", "[b]bold"])
def test_a_title_is_drawn_as_it_is(tmp_path: Path, figures: list[Figure], title: str) -> None:
    record_run(tmp_path / "run.mcap", 10)
    plot_run(Recording(tmp_path / "run.mcap"), tmp_path / "run.png", title=title)
    assert figures[0].get_suptitle() == title


def test_a_fault_with_a_dollar_sign_is_drawn_as_it_is(tmp_path: Path, figures: list[Figure]) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    record_periods(recorder, 20)
    recorder.log_entry(LogEntry(Severity.FATAL, "link", "udp:$x_{ failed"), START_NS + PERIOD_NS)
    recorder.close({})
    plot_run(Recording(path), tmp_path / "run.png", title="hidden")
    assert figures[0].get_suptitle() == "fault: link: udp:$x_{ failed"


def test_a_recording_without_a_period_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    recorder.operated(Trigger.ARM, START_NS)
    recorder.close({})
    with pytest.raises(RecordingError, match="has no period"):
        plot_run(Recording(path), tmp_path / "run.png")


def test_a_picture_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    record_run(tmp_path / "run.mcap", 10)
    with pytest.raises(RecordingError, match=r"absent/run\.png: the plot cannot be written: No such file"):
        plot_run(Recording(tmp_path / "run.mcap"), tmp_path / "absent" / "run.png")


def test_no_display_and_no_global_state_is_used() -> None:
    program = "import sys, hil.views.plots; print('matplotlib.pyplot' in sys.modules)"
    finished = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert finished.stdout.strip() == "False"
