"""The file of a recording: what would overwrite a file, or not find room, is refused before the run."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from hil.cli.record_path import BYTES_PER_S, OVERHEAD_BYTES, create_folder_of, recording_path, remove_empty
from hil.core.errors import RecordingError


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def refusal(given: str, *, has_figure: bool = False) -> str:
    before = sorted(Path().rglob("*"))
    with pytest.raises(RecordingError) as caught:
        recording_path(Path(given), 10.0, has_figure)
    assert sorted(Path().rglob("*")) == before, "nothing was created"
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
        "run.mcap", has_figure=True
    )
    assert recording_path(Path("run.mcap"), 10.0, has_figure=False) == Path("run.mcap")


def test_a_folder_that_does_not_exist_is_created_and_reported() -> None:
    path = recording_path(Path("a/b/run.mcap"), 10.0, False)
    assert path == Path("a/b/run.mcap")
    assert not Path("a").exists()
    created = create_folder_of(path)
    assert created == [Path("a/b"), Path("a")]
    assert Path("a/b").is_dir()
    assert create_folder_of(path) == create_folder_of(Path("run.mcap")) == []
    Path("a/file").touch()
    remove_empty(created)
    assert [found.name for found in Path("a").iterdir()] == ["file"]


def test_a_folder_that_cannot_be_created() -> None:
    with pytest.raises(RecordingError) as caught:
        create_folder_of(Path("/proc/nowhere/run.mcap"))
    assert str(caught.value) == (
        "/proc/nowhere/run.mcap: the folder /proc/nowhere cannot be created: No such file or directory; "
        "see --record"
    )


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("file.mcap/run.mcap", "file.mcap is not a directory"),
        ("file.mcap/folder/run.mcap", "file.mcap is not a directory"),
        (f"{'x' * 300}.mcap", "File name too long"),
    ],
)
def test_a_place_where_no_file_can_be_is_refused(given: str, words: str) -> None:
    Path("file.mcap").touch()
    message = refusal(given)
    assert message.startswith(f"{given}: cannot be created: ")
    assert words in message


@pytest.mark.parametrize(("duration_s", "has_room"), [(10.0, True), (10.1, False)])
def test_a_run_that_finds_no_room_is_refused(
    monkeypatch: pytest.MonkeyPatch, duration_s: float, has_room: bool
) -> None:
    blocks = (OVERHEAD_BYTES + 10 * BYTES_PER_S) // 500
    monkeypatch.setattr(os, "statvfs", lambda _path: SimpleNamespace(f_bavail=blocks, f_frsize=500))
    if has_room:
        recording_path(Path("run.mcap"), duration_s, False)
        return
    with pytest.raises(RecordingError, match=r"1\.5 MB are free on this disk, but 10\.1 s may need 1\.5 MB"):
        recording_path(Path("run.mcap"), duration_s, False)


def test_without_a_name_each_run_has_a_file_of_its_own() -> None:
    first = recording_path(None, 10.0, False)
    create_folder_of(first)
    first.touch()
    second = recording_path(None, 10.0, False)
    assert first != second
    assert first.parent == second.parent == Path("runs")
    assert {first.suffix, second.suffix} == {".mcap"}
