"""The report of a run: what it says, what its plots hold, and that it refers to nothing outside itself."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from html import unescape
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from support.recorded_runs import (
    AXES,
    PERIOD_NS,
    RUN_HEADER,
    START_NS,
    TENTH_STEP,
    Signals,
    following,
    in_memory,
    record_periods,
    record_run,
)

import hil.cli.report as command
from hil.core.errors import RecordingError, RecordingExistsError
from hil.core.life_cycle import LifeCycleState, Trigger
from hil.core.output import LogEntry, Severity
from hil.recording import open_recording
from hil.recording.reader import Recording
from hil.recording.recorder import Recorder
from hil.views.duration_counts import DurationCounts
from hil.views.histograms import histogram
from hil.views.promises import Outcome, promises
from hil.views.recording_report import render_report, write_report
from hil.views.report_plots import MIN_SPAN
from hil.views.report_series import Slots, decode, encode, extremes
from hil.views.summary import StepResponse, Tracking

PERIODS = 400
HOSTILE = "</script><script>alert(1)</script>"
CONTROLLER = {
    "format": "hil-controller",
    "version": 1,
    "name": "mine",
    "description": f"A controller {HOSTILE}",
    "sample_time_s": 0.0112,
    "input_unit": "m",
    "output_unit": "V",
    "law": {"kind": "pid", "kp": 1.0, "ki": 0.0},
    "origin": {
        "specifications": [
            {"quantity": "overshoot", "value": 0.01, "limit": 0.05, "unit": "", "reading": "", "met": True},
            {"quantity": "settling_s", "value": 0.5, "limit": 0.6, "unit": "s", "reading": "", "met": True},
            {"quantity": "error", "value": 0.0, "limit": 0.001, "unit": "", "reading": "", "met": True},
            {"quantity": "gain_db", "value": None, "limit": 20.0, "unit": "dB", "reading": "gain of GK"},
            "no specification",
        ]
    },
}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A step from rest with a warning in it, and a controller file with promises."""
    file = tmp_path_factory.mktemp("recording") / "run.mcap"
    controller = {"controllers/vertical.json": ("application/json", json.dumps(CONTROLLER).encode())}
    header = msgspec.structs.replace(RUN_HEADER, attachments={**RUN_HEADER.attachments, **controller})
    with in_memory(file):
        recorder = Recorder(file, header, lossless=True)
    recorder.operated(Trigger.START, START_NS)
    record_periods(recorder, PERIODS, TENTH_STEP)
    warning = LogEntry(Severity.WARNING, "adc", f"late {HOSTILE}")
    recorder.log_entry(warning, START_NS + 100 * PERIOD_NS)
    recorder.close({"ending": {"reason": "completed", "fault": ""}, "rights": {"scheduling": "SCHED_FIFO"}})
    return file


@pytest.fixture(scope="module")
def page(path: Path) -> str:
    return render_report(Recording(path))


def text_of(html: str) -> str:
    """Return the visible text, with all white space as single blanks."""
    visible = re.sub(r"<(script|style).*?</\1>", " ", html, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", visible)))


def data_of(html: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    content: dict[str, Any] = json.loads(found[1])
    return content


def curve(html: str, axis: int, label: str) -> dict[str, Any]:
    panels = data_of(html)["panels"][3 * axis : 3 * axis + 3]
    return next(c for panel in panels for c in panel["curves"] if c["label"] == label)


def test_the_page_refers_to_nothing_outside_itself(page: str) -> None:
    without_namespace = page.replace("http://www.w3.org/2000/svg", "")
    assert "http" not in without_namespace
    assert not re.search(r"\bsrc=|@import|url\((?!#)", without_namespace.replace("url(#${id})", ""))


def test_texts_of_the_recording_are_escaped(page: str) -> None:
    assert HOSTILE not in page
    assert f"late {HOSTILE}" in text_of(page)
    assert data_of(page)["marks"] == [[pytest.approx(1.12, abs=0.001), "warning", f"adc: late {HOSTILE}"]]


def test_the_plots_hold_the_signals_of_every_axis(path: Path, page: str) -> None:
    recording = Recording(path)
    for place, (name, unit) in enumerate(AXES):
        axis = recording.axis(name)
        for label, values in (
            ("setpoint", axis.setpoint),
            ("position", axis.position),
            ("error", axis.error),
            ("valve voltage", axis.command_v),
        ):
            series = curve(page, place, label)
            found = decode(series)
            known = found[np.isfinite(found)]
            resolution = (series["high"] - series["low"]) / 65534
            assert len(known) == PERIODS
            np.testing.assert_allclose(known, values, atol=resolution)
            assert series["max"] is None
            assert series["length"] == pytest.approx(PERIOD_NS * 1e-9)
        assert data_of(page)["panels"][3 * place]["minSpan"] == MIN_SPAN[unit]


def test_a_plot_narrower_than_its_margins_has_no_negative_width(page: str) -> None:
    """A browser reports a negative width of a rectangle as an error."""
    (function,) = re.findall(r"const at = .*", page)
    assert "Math.max(svg.clientWidth - LEFT - RIGHT, 1)" in function
    assert function.count("clientWidth") == 1


def test_the_verdict_compares_with_what_the_controller_file_promises(page: str) -> None:
    text = text_of(page)
    assert "The run was completed: 4.5 s under control." in text
    assert "Specifications not met: vertical: 2 % settling time 0.784 s, which must be ≤ 0.6 s " in text
    assert "and was predicted as 0.5 s for the linear plant." in text
    assert "The linear plant has no dry friction. In an axis that has it, it is the usual cause" in text
    assert "Predictions are those of the linear plant." in text
    assert "vertical overshoot ≤ 5 % 1 % 0 % met" in text
    assert "vertical 2 % settling time ≤ 0.6 s 0.5 s 0.784 s not met" in text
    assert re.search(r"vertical steady-state error over the step's size ≤ 0\.1 % 0 % \S+ % not judged", text)
    assert "vertical gain of GK 20 dB – – not measured" in text


def test_figures_configuration_and_rights_are_listed(page: str) -> None:
    text = text_of(page)
    assert "vertical 0 → 0.1 m 0.4368 s 0.784 s 0.00 %" in text
    assert "setpoint of vertical step:0.1@1" in text
    assert f"controller of vertical mine: A controller {HOSTILE}" in text
    assert "rights: scheduling SCHED_FIFO" in text
    assert re.search(r"document rig\.toml 25 bytes, SHA-256 [0-9a-f]{64}", text)
    assert "periods without a good sample 0" in text


def test_an_axis_without_a_step_has_tracking_figures(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    ramp = following(lambda t: 0.02 * t, lambda t: 0.02 * max(t - 0.112, 0.0))
    record_run(path, PERIODS, ramp)
    text = text_of(render_report(Recording(path)))
    assert re.search(r"tracking RMS error largest error delay valve vertical \S+ mm \S+ mm 112 ms", text)
    assert "The recording has no controller files, so there is no verdict on specifications." in text


def test_frames_are_counted_by_kind(path: Path, page: str) -> None:
    panel = data_of(page)["panels"][-1]
    assert panel["label"] == "frames (1/s)"
    labels = {c["label"] for c in panel["curves"]}
    assert labels == {"received 190 sample", "sent 080 SYNC", "sent 220 valve command"}
    for series in panel["curves"]:
        assert np.nanmean(decode(series)) == pytest.approx(1e9 / PERIOD_NS, rel=0.02)


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("interrupted", "The run was ended by an operator or a signal after 0.2 s under control."),
        ("fault", "The run ended by fault: adc: silent"),
        (
            "",
            "The run ended by an unknown cause; the daemon, or the process of the run, was killed or crashed",
        ),
        (None, "The recording was cut off."),
    ],
)
def test_the_end_of_the_run_is_stated(path: Path, tmp_path: Path, reason: str | None, words: str) -> None:
    file = tmp_path / "run.mcap"
    with in_memory(file):
        recorder = Recorder(file, RUN_HEADER, lossless=True)
    record_periods(recorder, 20)
    recorder.close({"ending": {"reason": reason or "", "fault": "adc: silent"}})
    if reason is None:
        file.write_bytes(file.read_bytes()[:-10])
    assert words in text_of(render_report(Recording(file)))


def recorded(
    path: Path,
    ending: dict[str, str],
    log: Sequence[tuple[LogEntry, int]] = (),
    metadata: dict[str, dict[str, str]] | None = None,
    controllers: dict[str, dict[str, Any]] | None = None,
    signals: Signals = TENTH_STEP,
) -> str:
    """Return the text of the report of a run whose ``log`` has the number of the period of each entry."""
    files = {
        f"controllers/{name}.json": ("application/json", json.dumps(content).encode())
        for name, content in (controllers or {}).items()
    }
    header = msgspec.structs.replace(
        RUN_HEADER,
        attachments={**RUN_HEADER.attachments, **files},
        metadata={**RUN_HEADER.metadata, **(metadata or {})},
    )
    with in_memory(path):
        recorder = Recorder(path, header, lossless=True)
    record_periods(recorder, PERIODS, signals)
    for entry, number in log:
        recorder.log_entry(entry, START_NS + number * PERIOD_NS)
    recorder.close({"ending": ending})
    return text_of(render_report(Recording(path)))


SILENT, LATE = LogEntry(Severity.FATAL, "adc", "silent"), LogEntry(Severity.FATAL, "dac", "late")


def test_faults_after_which_the_run_went_on_are_stated(tmp_path: Path) -> None:
    text = recorded(tmp_path / "run.mcap", {"reason": "interrupted"}, [(SILENT, 100), (LATE, 200)])
    assert "The run had 2 faults. The first one came 1.120 s after control began: adc: silent" in text


def test_the_fault_that_ended_the_run_is_stated_once_with_its_time(tmp_path: Path) -> None:
    text = recorded(tmp_path / "run.mcap", {"reason": "fault", "fault": "adc: silent"}, [(SILENT, 100)])
    assert "The run ended by fault, 1.120 s after control began: adc: silent" in text
    assert "The run had" not in text


def test_plots_and_log_say_what_happened_at_time_0(page: str) -> None:
    text = text_of(page)
    assert "At time 0, control began." in text
    assert re.search(r"\d entries; at time 0, control began", text)


def test_a_fault_without_control_counts_from_the_begin_of_the_recording(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with in_memory(file):
        recorder = Recorder(file, RUN_HEADER, lossless=True)
    record_periods(recorder, 20, state=LifeCycleState.READY)
    recorder.log_entry(SILENT, START_NS + 10 * PERIOD_NS)
    recorder.close({"ending": {"reason": "fault", "fault": "adc: silent"}})
    text = text_of(render_report(Recording(file)))
    assert "The run ended by fault, 0.112 s after the recording began: adc: silent" in text
    assert "At time 0, the recording began." in text


def test_simulated_faults_and_planned_events_are_stated(tmp_path: Path) -> None:
    begins = LogEntry(Severity.WARNING, "simulated fault", "lose:sample,10@2 begins")
    planned = {"arm events": {"lose:sample,10@2": "2.0", "payload:1@3": "3.0"}}
    text = recorded(tmp_path / "run.mcap", {"reason": "completed"}, [(begins, 100)], planned)
    assert (
        "Simulated faults began: lose:sample,10@2 at 1.120 s after control began. They may cause what other"
        in text
    )
    assert "Events planned in the simulation: payload:1@3." in text


def test_a_simulated_fault_that_did_not_begin_is_not_stated_as_begun(tmp_path: Path) -> None:
    unmet = "hang:adc@vertical>5 did not begin: its condition never came"
    log = [(LogEntry(Severity.WARNING, "simulated fault", unmet), 200)]
    text = recorded(tmp_path / "run.mcap", {"reason": "completed"}, log)
    assert "Simulated faults began" not in text
    assert unmet in text, "it is in the log"


def test_a_list_of_many_simulated_faults_is_short(tmp_path: Path) -> None:
    log = [(LogEntry(Severity.WARNING, "simulated fault", f"f{n} begins"), n) for n in range(7)]
    text = recorded(tmp_path / "run.mcap", {"reason": "completed"}, log)
    assert re.search(r"f4 at 0\.045 s and 2 more\. They", text)


@pytest.mark.parametrize(
    ("reason", "words"),
    [
        ("imported from a bus log", "The recording was imported from a bus log, which does not tell why"),
        ("the import was interrupted", "The import of the bus log did not finish"),
    ],
)
def test_an_imported_log_does_not_end_a_run(tmp_path: Path, reason: str, words: str) -> None:
    text = recorded(tmp_path / "run.mcap", {"reason": reason}, metadata={"imported": {"file": "bus.asc"}})
    assert words in text
    assert "The run ended by" not in text
    assert "imported: file bus.asc" in text


def test_each_axis_without_a_verdict_has_its_reason(tmp_path: Path) -> None:
    plain = {**CONTROLLER, "origin": {}}
    controllers = {"vertical": plain, "horizontal": CONTROLLER}
    still = following(lambda t: 0.0, lambda t: 0.0)
    text = recorded(tmp_path / "run.mcap", {"reason": "completed"}, controllers=controllers, signals=still)
    assert "The run shows none of the specifications (horizontal: no step from rest)." in text
    assert "vertical has no row: its controller file names no specifications." in text
    assert "rotation has no row: its controller file is not in the recording." in text


def test_specifications_that_no_step_shows_are_not_blamed_on_the_step(tmp_path: Path) -> None:
    origin: Any = CONTROLLER["origin"]
    gain = {**CONTROLLER, "origin": {"specifications": [origin["specifications"][3]]}}
    text = recorded(tmp_path / "run.mcap", {"reason": "completed"}, controllers={"vertical": gain})
    assert (
        "The run shows none of the specifications (vertical: a step does not show what they limit)." in text
    )


def test_skipped_and_missed_periods_are_told_apart(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with in_memory(file):
        recorder = Recorder(file, RUN_HEADER, lossless=True)
    record_periods(recorder, 20)
    record_periods(recorder, 20, first=32)
    recorder.close({"ending": {"reason": "completed", "missed periods": "30"}})
    text = text_of(render_report(Recording(file)))
    assert "12 periods were skipped because the loop was late." in text
    assert "periods skipped because the loop was late 12" in text
    assert "missed periods 30 since the gateway began: skipped ones, and those that began too late" in text


def test_a_recording_without_a_period_has_no_report(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with in_memory(file):
        recorder = Recorder(file, RUN_HEADER, lossless=True)
    recorder.operated(Trigger.ARM, START_NS)
    recorder.close({})
    with pytest.raises(RecordingError, match="has no period, so there is nothing to report"):
        render_report(Recording(file))


def test_no_file_is_overwritten_and_no_half_file_stays(path: Path, tmp_path: Path) -> None:
    output = tmp_path / "page.html"
    size = write_report(Recording(path), output)
    assert output.stat().st_size == size
    with pytest.raises(RecordingExistsError, match=r"page\.html: exists already; --force overwrites it"):
        write_report(Recording(path), output)
    assert write_report(Recording(path), output, overwrite=True) == size
    with pytest.raises(RecordingError, match="the report cannot be written: No such file"):
        write_report(Recording(path), tmp_path / "absent" / "page.html")
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


def test_the_command_writes_the_page_beside_the_recording(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "run.mcap"
    copy.write_bytes(path.read_bytes())
    assert command.main([str(copy)]) == 0
    out = capsys.readouterr().out
    assert re.fullmatch(rf"report     {tmp_path}/run\.html  \(\S+ kB; open it in a browser\)\n", out)
    assert open_recording(copy).path == copy


class TestSeries:
    def test_a_long_run_keeps_its_extreme_values_in_a_bounded_number_of_slots(self) -> None:
        time_s = np.arange(500_000) * 0.0112
        values = np.sin(time_s)
        values[123_456], values[400_001] = 40.0, -40.0
        slots = Slots.over(0.0, float(time_s[-1]), 0.0112)
        series = encode(slots, time_s, values)
        assert slots.count == 20_000
        assert len(series["min"]) + len(series["max"]) < 110_000
        assert np.nanmax(decode(series, "max")) == 40.0
        assert np.nanmin(decode(series)) == -40.0
        largest = np.nanargmax(decode(series, "max"))
        assert slots.start_s + largest * slots.length_s == pytest.approx(123_456 * 0.0112, abs=slots.length_s)

    def test_gaps_and_values_that_are_not_finite_are_empty(self) -> None:
        slots = Slots.over(0.0, 1.0, 0.1)
        found = decode(encode(slots, np.array([0.0, 0.5, 1.0]), np.array([1.0, np.nan, 2.0])))
        assert np.flatnonzero(np.isfinite(found)).tolist() == [0, 10]
        assert found[[0, 10]].tolist() == [1.0, 2.0]
        assert np.isnan(decode(encode(slots, np.empty(0), np.empty(0)))).all()

    def test_a_long_curve_is_reduced_to_its_extreme_values(self) -> None:
        time_s = np.arange(100_000) * 0.01
        values = np.sin(time_s)
        values[50_000] = 7.0
        found_s, found = extremes(time_s, values, 1000)
        assert len(found) == len(found_s) <= 2000
        assert found.max() == 7.0
        assert found_s[np.argmax(found)] == pytest.approx(500.0, abs=1.0)
        assert extremes(time_s[:50], values[:50], 1000)[1] is not found

    def test_a_constant_is_exact(self) -> None:
        slots = Slots.over(0.0, 0.0, 0.1)
        assert decode(encode(slots, np.zeros(1), np.full(1, 5.0)))[0] == 5.0


def counted(durations_ns: list[int]) -> DurationCounts:
    counts = DurationCounts()
    counts.add(np.array(durations_ns, np.int64))
    return counts


def test_histograms_show_single_values_and_say_when_there_are_none() -> None:
    drawn = histogram("lateness", counted([100_000] * 1000 + [5_000_000]))
    assert drawn["svg"].count("<rect") == 2
    assert drawn["caption"] == "1001 values, p50 100 µs, p99 100 µs, largest 5000 µs"
    assert histogram("response", counted([]))["caption"] == "The run has no such value."


def test_promises_are_judged_by_the_step_alone() -> None:
    origin: dict[str, Any] = CONTROLLER["origin"]  # type: ignore[assignment]
    step = StepResponse("m", 0.0, 0.1, 3.0, None, 0.0005, None, 4.0, 6.0)
    assert [p.outcome for p in promises("vertical", origin, step)] == [
        Outcome.MET,
        Outcome.MISSED,
        Outcome.SHOWN,
        Outcome.NOT_MEASURED,
    ]
    tracking = Tracking("m", 0.1, 0.2, None, 4.0, 6.0)
    assert {p.outcome for p in promises("vertical", origin, tracking)} == {Outcome.NOT_MEASURED}
    assert promises("vertical", {}, step) == []
    assert promises("vertical", {"specifications": "none"}, step) == []
