"""Writing results from Python: which files there are, and which folders are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from support.designs import plain_design

from design.output.figure_set import PAPER_NUMBERS, design_figures
from design.output.results import design_folder, write_design
from design.synthesis.recommendation import Action
from hil.core.controller_file import read_controller
from hil.core.errors import HilError

CONTROLLERS = ["controller.json", "hls.json", "pi.json", "tlc.json", "zn.json"]


def test_a_design_is_written_from_python(tmp_path: Path) -> None:
    written = write_design(plain_design(), tmp_path / "a" / "b")
    folder = tmp_path / "a" / "b"
    assert sorted(path.name for path in folder.iterdir()) == [
        *CONTROLLERS[:1],
        "figures",
        *CONTROLLERS[1:3],
        "report.html",
        *CONTROLLERS[3:],
    ]
    assert written.report == folder / "report.html"
    assert written.controller == folder / "controller.json"
    assert written.recommendation.action is Action.RUN
    law = read_controller(written.controller.read_text(), "controller.json").law
    assert law == plain_design().designed.law
    keys = {path.stem for path in (folder / "figures").iterdir()}
    assert keys == set(PAPER_NUMBERS) - {"identification"}
    for figure in design_figures(plain_design()):
        assert (folder / "figures" / f"{figure.key}.svg").read_text() == figure.svg


def test_an_unstable_design_has_no_controller_file(tmp_path: Path) -> None:
    design = plain_design()
    measures = (replace(design.measures[0], eps_sampled=0.0), *design.measures[1:])
    written = write_design(replace(design, measures=measures), tmp_path)
    assert written.controller is None
    assert written.recommendation.action is Action.UNSTABLE
    assert not (tmp_path / "controller.json").exists()
    assert (tmp_path / "hls.json").exists()


def test_results_of_the_same_plant_are_replaced_and_other_files_stay(tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "mine.svg").write_text("mine")
    (tmp_path / "notes.txt").write_text("mine")
    design = plain_design()
    write_design(design, tmp_path)
    without_tlc = replace(design, candidates=design.candidates[:-1], measures=design.measures[:-1])
    write_design(without_tlc, tmp_path)
    assert not (tmp_path / "tlc.json").exists(), "a result that only the earlier design had"
    assert (tmp_path / "zn.json").exists()
    assert (tmp_path / "figures" / "mine.svg").read_text() == "mine"
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_different_results_of_an_earlier_design_are_kept(tmp_path: Path) -> None:
    design = plain_design()
    assert write_design(design, tmp_path).earlier is None
    assert write_design(design, tmp_path).earlier is None, "the same design again"
    without_tlc = replace(design, candidates=design.candidates[:-1], measures=design.measures[:-1])
    assert write_design(without_tlc, tmp_path).earlier == tmp_path / "earlier-1"
    assert (tmp_path / "earlier-1" / "tlc.json").exists()
    assert (tmp_path / "earlier-1" / "report.html").exists()
    assert not (tmp_path / "tlc.json").exists()
    assert write_design(design, tmp_path).earlier == tmp_path / "earlier-2"
    assert write_design(without_tlc, tmp_path, keeps_earlier=False).earlier is None
    assert not (tmp_path / "earlier-3").exists()


def test_a_folder_with_other_results_is_refused(tmp_path: Path) -> None:
    (tmp_path / "zn.json").write_text("mine")
    with pytest.raises(HilError, match=r"contains zn.json, which no design has written; it is left as it is"):
        write_design(plain_design(), tmp_path)
    assert (tmp_path / "zn.json").read_text() == "mine"
    assert not (tmp_path / "report.html").exists()


def test_a_folder_without_permission_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)
    with pytest.raises(HilError, match=rf"no permission to write into {tmp_path}; change its owner or mode"):
        design_folder(tmp_path / "new", plain_design().plant).check()


def test_a_folder_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    (tmp_path / "report.html").mkdir()
    with pytest.raises(HilError, match=r"report.html: cannot be read or written: Is a directory"):
        design_folder(tmp_path, plain_design().plant).check()
