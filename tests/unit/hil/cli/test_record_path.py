"""Where a run is recorded: what would overwrite something, or find no room, is refused before the run."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from hil.cli.record_path import BYTES_PER_S, LEAST_BYTES, recording_path
from hil.core.errors import RecordingError


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refusal(given: str, *, is_drawn_twice: bool = False) -> str:
    before = sorted(Path().rglob("*"))
    with pytest.raises(RecordingError) as caught:
        recording_path(Path(given), 10.0, is_drawn_twice)
    assert sorted(Path().rglob("*")) == before, "nothing was made"
    return str(caught.value)


@pytest.mark.parametrize("given", ["run", "run.png", "run.mcap.png", "v1.2", "run.MCAP", ".mcap"])
def test_a_name_that_does_not_end_in_mcap_is_refused(given: str) -> None:
    """With .png, the plot would overwrite the recording; viewers go by the name."""
    assert f"{given}: a recording's name ends in .mcap" in refusal(given)


@pytest.mark.parametrize("given", ["folder", "folder/", "", "folder.mcap"])
def test_a_directory_is_refused(given: str) -> None:
    Path("folder").mkdir()
    Path("folder.mcap").mkdir()
    assert f"is a directory; name a file in it, such as {Path(given) / 'run.mcap'}" in refusal(given)


@pytest.mark.parametrize("existing", ["run.mcap", "run.png"])
def test_what_exists_is_kept(existing: str) -> None:
    Path(existing).write_text("precious")
    assert f"{existing}: exists already" in refusal("run.mcap")
    assert Path(existing).read_text() == "precious"


def test_a_link_to_nowhere_is_kept() -> None:
    Path("run.mcap").symlink_to("elsewhere.mcap")
    assert "run.mcap: exists already" in refusal("run.mcap")


def test_the_figure_of_a_scenario_overwrites_nothing_either() -> None:
    Path("run-figure.png").write_text("precious")
    assert "run-figure.png: exists already and would be a plot of run.mcap" in refusal(
        "run.mcap", is_drawn_twice=True
    )
    assert recording_path(Path("run.mcap"), 10.0, is_drawn_twice=False) == Path("run.mcap")


def test_the_folder_is_made() -> None:
    assert recording_path(Path("a/b/run.mcap"), 10.0, False) == Path("a/b/run.mcap")
    assert Path("a/b").is_dir()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("file.mcap/run.mcap", "file.mcap is no directory"),
        ("file.mcap/folder/run.mcap", "Not a directory"),
        (f"{'x' * 300}.mcap", "File name too long"),
        ("/proc/nowhere/run.mcap", "No such file or directory"),
    ],
)
def test_a_place_that_cannot_be_is_told(given: str, words: str) -> None:
    Path("file.mcap").touch()
    told = refusal(given)
    assert told.startswith(f"{given}: cannot be created: ")
    assert words in told


@pytest.mark.parametrize(("duration_s", "is_enough"), [(10.0, True), (10.1, False)])
def test_a_run_that_finds_no_room_is_refused(
    monkeypatch: pytest.MonkeyPatch, duration_s: float, is_enough: bool
) -> None:
    blocks = (LEAST_BYTES + 10 * BYTES_PER_S) // 500
    monkeypatch.setattr(os, "statvfs", lambda _path: SimpleNamespace(f_bavail=blocks, f_frsize=500))
    if is_enough:
        recording_path(Path("run.mcap"), duration_s, False)
        return
    with pytest.raises(RecordingError, match=r"1\.5 MB are free on that disk, and 10\.1 s may"):
        recording_path(Path("run.mcap"), duration_s, False)


def test_without_a_name_each_run_has_a_file_of_its_own() -> None:
    first = recording_path(None, 10.0, False)
    first.touch()
    second = recording_path(None, 10.0, False)
    assert first != second
    assert first.parent == second.parent == Path("runs")
    assert {first.suffix, second.suffix} == {".mcap"}
