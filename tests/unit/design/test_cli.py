"""``hil design`` as a user types it: files read and written, messages, exit status."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from support.designs import HEAVIER, PERIOD_S, reproduction, sampled_design

from design.cli import STRUCTURE_NAMES
from design.models.plant import paper_plant
from design.paper import claims as paper_claims
from design.paper import reproduction as paper
from design.synthesis import procedure
from design.synthesis.design_file import example_text
from design.synthesis.structures import STRUCTURES
from hil.cli import main
from hil.core.controller_file import PidLaw, check_controller_fits, read_controller
from hil.core.documents import to_json
from hil.shells.run_setup import load_setup

SHORT = "[search]\nweight_evaluations = 300\ncontroller_evaluations = 300\n"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    return tmp_path


@pytest.fixture
def short(here: Path) -> str:
    """A design file with a small budget."""
    (here / "short.toml").write_text(SHORT)
    return "short.toml"


def write_plant(directory: Path, **changes: Any) -> str:
    document = json.loads(to_json(paper_plant())) | {"name": "mine"} | changes
    (directory / "plant.json").write_text(json.dumps(document))
    return "plant.json"


def error_of(argv: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """What a wrong call prints: exit status 2, no traceback, nothing written under designs/."""
    assert main(["design", *argv]) == 2
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert not Path("designs").exists()
    return said


def test_without_arguments_the_papers_plant_is_designed_for(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design"]) == 0
    out = capsys.readouterr().out
    folder = here / "designs" / "paper"
    assert sorted(p.name for p in folder.iterdir()) == sorted(
        ["controller.json", "hls.json", "pi.json", "zn.json", "tlc.json", "report.html", "figures"]
    )
    assert len(list((folder / "figures").glob("*.svg"))) == 8
    assert "next        hil run --linear --controller vertical=designs/paper/controller.json" in out
    assert "another plant: hil design vertical" in out
    design = sampled_design()
    for candidate, measures in zip(design.candidates, design.measures, strict=True):
        assert candidate.name in out
        assert f"{measures.eps_sampled:.4f}" in out


def test_controller_files_are_the_daemons(here: Path) -> None:
    assert main(["design"]) == 0
    design = sampled_design()
    stems = ["controller", "hls", "pi", "zn", "tlc"]
    for stem, candidate in zip(stems, design.candidates, strict=True):
        path = here / "designs" / "paper" / f"{stem}.json"
        controller = read_controller(path.read_text(), str(path))
        check_controller_fits(controller, stem, PERIOD_S, "m")
        assert controller.law == candidate.law
        assert controller.origin["margins"]["eps_opt"] == pytest.approx(design.problem.eps_opt)
    origin = read_controller((here / "designs/paper/controller.json").read_text(), "c").origin
    assert origin["searches"]["controller"]["seed"] == 1
    assert origin["plant"]["num"] == paper_plant().num
    assert origin["design_file"]["loop"] == {"design": "sampled", "period_s": 0.0112, "delay_samples": 1}
    assert {"python", "numpy", "pneumatic-hil"} <= set(origin["versions"])
    assert origin["weight"]["kw"] == pytest.approx(design.weight.parameters["kw"])
    load_setup(None, {"vertical": "designs/paper/controller.json"}, {})


def test_the_same_seed_gives_the_same_bytes_another_seed_says_so(here: Path, short: str) -> None:
    for out, seed in (("a", "4"), ("b", "4"), ("c", "5")):
        main(["design", "--design", short, "--seed", seed, "--out", out])
    for path in sorted(Path("a").rglob("*.*")):
        assert path.read_bytes() == (Path("b") / path.relative_to("a")).read_bytes(), path
    assert json.loads(Path("c/controller.json").read_text())["origin"]["searches"]["controller"]["seed"] == 5
    assert Path("a/controller.json").read_bytes() != Path("c/controller.json").read_bytes()


def test_structure_with_its_own_boxes(here: Path, short: str) -> None:
    """--structure replaces the design file's controller, boxes and all."""
    Path(short).write_text(SHORT + "[controller.box]\ntau_d = { low = 0.02, high = 1.0 }\n")
    assert main(["design", "--design", short, "--structure", "pi", "--out", "out"]) == 0
    law = read_controller(Path("out/controller.json").read_text(), "c").law
    assert isinstance(law, PidLaw)
    assert law.kd == 0.0
    assert not Path("out/pi.json").exists(), "the PI is what was designed"


def test_further_plants_are_read_beside_the_design_file(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "sub").mkdir()
    (here / "sub" / "heavier.json").write_text(to_json(HEAVIER))
    for worst_case in ("false", "true"):
        text = "[specifications]\novershoot = 0.1\nbandwidth_rad_s = 2.0\n" + SHORT
        text += f'[further_plants]\nfiles = ["heavier.json"]\nworst_case = {worst_case}\n'
        (here / "sub" / "d.toml").write_text(text)
        assert main(["design", "--design", "sub/d.toml", "--out", worst_case]) == 0
        assert "plant heavier: ν-gap 0." in capsys.readouterr().out
    assert "The design is against all of them at once" in Path("true/report.html").read_text()
    assert "The design is against all of them at once" not in Path("false/report.html").read_text()


def test_a_missed_specification_is_exit_status_1(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A lag cannot follow the shaped plant: it is designed, written, warned of, and not recommended."""
    (here / "d.toml").write_text(SHORT)
    assert main(["design", "--design", "d.toml", "--structure", "p", "--out", "out"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "the designed loop misses what is specified:" in said
    assert "must_meet_specifications = true" in said
    assert "this controller should not be run as it is" in said
    assert "hil run" not in said
    assert Path("out/controller.json").exists()


def test_unstable_loops_are_no_controller_files(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A continuous design knows nothing of 20 samples of delay."""
    (here / "d.toml").write_text(SHORT + '[loop]\ndesign = "continuous"\ndelay_samples = 20\n')
    assert main(["design", "--design", "d.toml", "--out", "out"]) == 1
    said = capsys.readouterr().out
    line = next(line for line in said.splitlines() if line.startswith("not written, unstable"))
    assert "ZN" in line
    told = dict(
        zip(
            ("controller", "hls", "pi", "zn", "tlc"),
            ("PID (designed)", "HLS", "PI", "ZN", "TLC"),
            strict=True,
        )
    )
    for stem, name in told.items():
        assert (Path("out") / f"{stem}.json").exists() == (name not in line), name
    assert "hil run" not in said


def test_an_unstable_design_is_not_written(
    here: Path, short: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    design = sampled_design()
    measures = (replace(design.measures[0], eps_sampled=0.0), *design.measures[1:])
    unstable = replace(design, measures=measures, guarantees=())
    monkeypatch.setattr(procedure, "design_controller", lambda *_: unstable)
    assert main(["design", "--out", "out"]) == 1
    said = capsys.readouterr().out
    assert "not written, unstable in the rig's loop: PID (designed)" in said
    assert "controller.json" not in said
    assert not Path("out/controller.json").exists()
    assert Path("out/hls.json").exists()


def test_results_of_the_same_plant_are_replaced(here: Path, short: str) -> None:
    assert main(["design", "--design", short, "--out", "out"]) == 0
    before = Path("out/controller.json").read_bytes()
    assert main(["design", "--design", short, "--structure", "pi", "--out", "out"]) == 0
    assert Path("out/controller.json").read_bytes() != before
    assert not Path("out/pi.json").exists(), "of the design before"
    assert main(["design", "--design", short, "--out", "out"]) == 0
    assert Path("out/controller.json").read_bytes() == before


def test_what_is_not_of_the_same_plant_is_left_as_it_is_and_told_before_the_search(
    here: Path, short: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", write_plant(here, name="a <b>"), "--design", short]) == 0
    monkeypatch.setattr(procedure, "design_controller", None)
    monkeypatch.setattr(paper, "reproduce", None)
    (here / "mine").mkdir()
    (here / "mine" / "controller.json").write_text("{}")
    (here / "taken").write_text("")
    for argv, told in (
        (["vertical", "--out", "designs/a-b-"], 'holds "Controller design: a <b>"; it is left as it is'),
        (["--paper", "--out", "designs/a-b-"], 'holds "Controller design: a <b>"; it is left as it is'),
        (["--out", "mine"], "mine has a controller.json that is of no design; it is left as it is"),
        (["--out", "taken"], "--out taken: taken is a file, not a folder"),
        (["--out", "taken/deeper"], "--out taken/deeper: taken is a file, not a folder"),
    ):
        assert main(["design", *argv]) == 2
        assert told in capsys.readouterr().err
    assert (here / "mine" / "controller.json").read_text() == "{}"
    assert "a &lt;b&gt;" in Path("designs/a-b-/report.html").read_text()


def write_record(path: Path, y_unit: float = 1.0) -> None:
    """Of the paper's plant, under a square wave."""
    t = np.arange(300) * PERIOD_S
    u = np.sign(np.sin(5 * t))
    held = control.sample_system(control.tf(paper_plant().num, paper_plant().den), PERIOD_S, "zoh")
    y = control.forced_response(held, t, u).outputs * y_unit
    path.write_text("time_s,u,y\n" + "".join(f"{a:.6f},{b},{c}\n" for a, b, c in zip(t, u, y, strict=True)))


def test_measured_record(here: Path, short: str, capsys: pytest.CaptureFixture[str]) -> None:
    write_record(here / "r.csv")
    assert main(["design", "--design", short, "--measured", "r.csv", "--out", "out"]) == 0
    assert "the model follows r.csv to 100.0 %" in capsys.readouterr().out
    assert Path("out/figures/fig5-identification.svg").exists()
    write_record(here / "mm.csv", 1000.0)
    assert main(["design", "--design", short, "--measured", "mm.csv", "--out", "out"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "its y is 1000 times what the model says" in said
    assert "y in mm, the model in m?" in said
    assert "hil run" not in said
    (here / "bad.csv").write_text("time,u,y\n0,0,0\n")
    assert "bad.csv: column time_s is missing" in error_of(["--measured", "bad.csv"], capsys)


def test_shipped_plants_of_the_arm_have_their_record(
    here: Path, short: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for plant in ("vertical", "horizontal", "rotation"):
        main(["design", plant, "--design", short])
        assert re.search(f"the model follows the shipped {plant}.csv to 9[789]", capsys.readouterr().out)
        assert Path(f"designs/{plant}/figures/fig5-identification.svg").exists()
    write_record(here / "r.csv")
    main(["design", "vertical", "--design", short, "--measured", "r.csv"])
    assert "the model follows r.csv to" in capsys.readouterr().out, "the user's before the shipped"


def test_a_plants_name_makes_a_safe_directory(here: Path, short: str) -> None:
    assert main(["design", write_plant(here, name="../arm 2/vertical"), "--design", short]) == 0
    assert Path("designs/..-arm-2-vertical/controller.json").exists()


def test_axis_named_like_the_rigs_is_the_one_to_run(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for changes, axis in (
        ({"name": "horizontal"}, "horizontal"),
        ({"name": "x", "output_unit": "rad"}, "rotation"),
        ({"name": "paper", "den": [1.0, 17.3931, 175.08, 71.1]}, "vertical"),
    ):
        assert main(["design", write_plant(here, **changes)]) == 0
        assert f"hil run --controller {axis}=designs/" in capsys.readouterr().out


def test_init_writes_the_example_once(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "--init"]) == 0
    assert Path("design.toml").read_text() == example_text()
    Path("design.toml").write_text("mine")
    assert main(["design", "--init"]) == 2
    assert "design.toml exists already" in capsys.readouterr().err
    assert Path("design.toml").read_text() == "mine"


# What a user can get wrong


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num": [0.0]}, "plant.json: num: the plant's gain is 0"),
        ({"num": [1.0, 2.0, 3.0], "den": [1.0, 1.0]}, "num has degree 2, den 1: the model is improper"),
        ({"output_unit": "mm"}, "plant.json: output_unit: 'mm'"),
        ({"nmu": [1.0]}, "plant.json: object contains unknown field `nmu`"),
    ],
)
def test_plants_that_are_none(
    changes: dict[str, Any], message: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in error_of([write_plant(here, **changes)], capsys)


def test_another_unit(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = write_plant(here)
    assert "plant.json: output_unit: m, but the axis is in rad" in error_of(
        [plant, "--axis-unit", "rad"], capsys
    )
    (here / "d.toml").write_text('axis_unit = "rad"\n')
    assert "output_unit: m, but the axis is in rad" in error_of([plant, "--design", "d.toml"], capsys)


def test_files_that_are_not_there(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "plant 'nope.json': no such file, and none of the shipped" in error_of(["nope.json"], capsys)
    assert "nope.toml: cannot be read" in error_of(["--design", "nope.toml"], capsys)
    (here / "d.toml").write_text('[further_plants]\nfiles = ["nope.json"]\n')
    assert "plant 'nope.json': no such file, and none of the shipped" in error_of(
        ["--design", "d.toml"], capsys
    )


def test_infeasible_specifications_name_what_fails_and_by_how_much(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "d.toml").write_text("[specifications]\nsettling_s = 0.02\novershoot = 0.9\n" + SHORT)
    said = error_of(["--design", "d.toml"], capsys)
    assert "no weight within the search bounds meets all specifications" in said
    assert "settling_s" in said
    assert "NOT met (<= 0.02" in said
    assert "overshoot" not in said.split("Best compromise")[1], "only what fails is named"


def test_structure_that_cannot_stabilise(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A proportional controller and an unstable plant of two states: no damping, whatever the gain."""
    plant = write_plant(here, num=[20.0], den=[1.0, -0.1, 0.0])
    (here / "d.toml").write_text("[specifications]\novershoot = 10.0\n" + SHORT)
    said = error_of([plant, "--design", "d.toml", "--structure", "p"], capsys)
    assert "stabilises the plant" in said
    assert "gain is negative" not in said


def test_reversed_plant_is_told_as_such(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = write_plant(here, num=[-x for x in paper_plant().num])
    said = error_of([plant], capsys)
    assert "stabilises the plant" in said
    assert "the plant's gain is negative: reverse the valve" in said


def test_a_reversed_plant_can_be_designed_for_with_boxes_below_0(here: Path) -> None:
    plant = write_plant(here, num=[-x for x in paper_plant().num])
    (here / "d.toml").write_text(
        '[controller]\nstructure = "pi"\n[controller.box]\n'
        'kp = { low = -100, high = 0, coding = "linear" }\nki = { low = -100, high = 0, coding = "linear" }\n'
    )
    assert main(["design", plant, "--design", "d.toml", "--out", "out"]) == 0
    law = read_controller(Path("out/controller.json").read_text(), "c").law
    assert isinstance(law, PidLaw)
    assert law.kp == pytest.approx(-10.08, abs=0.1)
    assert Path("out/zn.json").exists(), "the ultimate gain is negative too"


def test_a_bad_seed_is_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["design", "--seed", "-1"])
    assert stopped.value.code == 2
    assert "-1 is not a whole number from 0" in capsys.readouterr().err


# The paper


def test_paper_is_reproduced(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "--paper"]) == 0
    out = capsys.readouterr().out
    for printed in ("0.60149", "0.54681", "67960", "45 %", "0.08 m/V"):
        assert printed in out
    assert "16.67 is a misprint" in " ".join(out.split())
    assert "0 should agree and do not" in " ".join(out.split())
    html = Path("designs/paper-reproduction/report.html").read_text()
    assert "The paper's figures, and ours" in html or "The paper&#39;s figures, and ours" in html


def test_paper_that_does_not_reproduce_is_exit_status_1(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = reproduction()  # kept for all tests, so before the claim is changed
    monkeypatch.setattr(paper_claims, "PPID_EPS", 0.56)
    judged = replace(done, verdicts=paper_claims.judge(done.evidence))
    monkeypatch.setattr(paper, "reproduce", lambda _on_progress: judged)
    assert main(["design", "--paper"]) == 1
    assert "DOES NOT REPRODUCE" in capsys.readouterr().out


def test_paper_takes_no_other_design(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for others in (["rotation"], ["--seed", "2"], ["--structure", "pi"]):
        assert "--paper carries out the paper's own design" in error_of(["--paper", *others], capsys)


def test_help_names_every_structure() -> None:
    assert STRUCTURE_NAMES.split(", ") == list(STRUCTURES)


# Speed


def test_nothing_slow_is_imported(here: Path) -> None:
    """matplotlib and control alone take longer than a whole design."""
    (here / "short.toml").write_text(SHORT)
    slow = "{'matplotlib', 'control', 'scipy.signal', 'scipy.optimize', 'pandas'}"
    program = (
        "import sys; from hil.cli import main; main(['design', 'vertical', '--design', 'short.toml']); "
        f"sys.exit(bool({slow} & set(sys.modules)))"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)


def test_help_needs_no_numpy(here: Path) -> None:
    program = (
        "import sys; from design.cli import parser; parser().format_help(); sys.exit('numpy' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
