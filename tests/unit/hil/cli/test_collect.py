"""``hil collect``: errors in terms of its options, and the report of a run that was interrupted."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.cli import launch
from hil.cli.collect import main
from hil.cli.collect_run import Collected, _gaps, samples_text
from hil.core.errors import DocumentError, RecordingError
from hil.shells.run_plan import StopRequest

COLLECTED = Collected(
    excited=5000,
    gaps=2,
    rejected=0,
    lowest=-0.05,
    highest=0.05,
    fence_crossings=0,
    offset_v=0.0,
    is_complete=True,
)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--centre", "0.5"), r"^--centre: 0\.5 m is not inside the travel fence"),
        (("--amplitude", "9"), r"^--amplitude: the excitation reaches 9 V, limit"),
        (("--settle", "1000"), r"^--settle 1000: must be over 0 s and at most 600 s"),
        (
            ("--band", "40:0.2", "--excitation", "chirp"),
            r"^--band 40:0\.2: LOW must be over 0 rad/s and under HIGH; write --band LOW:HIGH",
        ),
        (("--band", "0:5", "--excitation", "multisine"), r"^--band 0:5: LOW must be over 0 rad/s"),
        (("--settle", "0"), r"^--settle 0: must be over 0 s"),
        (("--scenario", "fg13"), r"did you mean fig13\?"),
    ],
)
def test_an_error_names_the_option_and_not_the_document_that_is_made_of_it(
    options: tuple[str, ...], complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(DocumentError, match=complaint):
        main(["--axis", "vertical", "--lockstep", "-o", str(tmp_path / "data.mcap"), *options])


def test_a_table_that_is_too_large_names_its_option(tmp_path: Path) -> None:
    table = tmp_path / "steps.csv"
    table.write_text("time_s,value\n0,0\n1,9\n2,0\n")
    with pytest.raises(DocumentError, match=rf"^--excitation csv:{table}: the excitation reaches 9 V"):
        main(["--axis", "vertical", "--lockstep", "--excitation", f"csv:{table}"])


def test_an_interrupted_experiment_ends_with_status_130(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    @contextlib.contextmanager
    def already_interrupted() -> Iterator[StopRequest]:
        request = StopRequest()
        request.set()
        yield request

    monkeypatch.setattr(launch, "stop_on_signals", already_interrupted)
    path = tmp_path / "data.mcap"
    assert main(["--axis", "vertical", "--lockstep", "--duration", "2", "-o", str(path)]) == 130
    printed = capsys.readouterr().out
    assert "Interrupted: the excitation was not given completely." in printed
    assert "hil identify" not in printed


def test_an_existing_recording_is_refused_before_anything_is_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "data.mcap"
    path.write_bytes(b"mine")
    with pytest.raises(RecordingError, match="exists already"):
        main(["--axis", "vertical", "--duration", "2", "-o", str(path)])
    assert capsys.readouterr().out == ""
    assert path.read_bytes() == b"mine"


def test_the_next_command_validates_with_a_second_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "data.mcap"
    assert main(["--axis", "vertical", "--lockstep", "--duration", "2", "-o", str(path)]) == 0
    printed = capsys.readouterr().out
    assert f"next        hil identify {path} --axis vertical --validate SECOND.mcap\n" in printed
    assert "SECOND.mcap: a second recording of hil collect" in printed


def test_missed_periods_count_as_periods_without_a_good_sample() -> None:
    number = np.array([1, 2, 3, 6, 7, 9])
    excited = np.array([False, True, True, True, True, False])
    fresh = np.array([True, True, False, True, True, True])
    assert _gaps(number, excited, fresh) == 1 + 2


def test_rejected_frames_are_stated_beside_the_gaps() -> None:
    assert samples_text(COLLECTED).endswith("5000 excited, 2 periods without a good sample")
    assert "3 frames rejected in the whole run" in samples_text(replace(COLLECTED, rejected=3))
