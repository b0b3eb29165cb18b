"""The command ``hil design``: files read and written, messages, and exit status."""

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
from support.designs import HEAVIER, PERIOD_S, plain_design, reproduction

from design.cli import STRUCTURE_NAMES
from design.models.plant import paper_plant
from design.paper import printed
from design.paper import reproduction as paper
from design.paper.claims import check_claims
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
    """Return what a wrong call prints; it has exit status 2 and writes nothing under designs/."""
    assert main(["design", *argv]) == 2
    text = capsys.readouterr().err
    assert "Traceback" not in text
    assert not Path("designs").exists()
    return text


def test_without_arguments_the_plant_is_the_papers(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design"]) == 0
    out = capsys.readouterr().out
    folder = here / "designs" / "paper"
    assert sorted(p.name for p in folder.iterdir()) == sorted(
        ["controller.json", "hls.json", "pi.json", "zn.json", "tlc.json", "report.html", "figures"]
    )
    assert len(list((folder / "figures").glob("*.svg"))) == 8
    assert "next        hil run --linear --controller vertical=designs/paper/controller.json" in out
    assert "a different plant; `hil design vertical` designs for it" in out
    design = plain_design()
    for candidate, measures in zip(design.candidates, design.measures, strict=True):
        assert candidate.name in out
        assert f"{measures.eps_sampled:.4f}" in out


def test_the_gateway_reads_the_controller_files(here: Path) -> None:
    assert main(["design"]) == 0
    design = plain_design()
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


def test_the_same_seed_writes_the_same_bytes(here: Path, short: str) -> None:
    for out, seed in (("a", "4"), ("b", "4"), ("c", "5")):
        main(["design", "--design", short, "--seed", seed, "--out", out])
    for path in sorted(Path("a").rglob("*.*")):
        assert path.read_bytes() == (Path("b") / path.relative_to("a")).read_bytes(), path
    assert json.loads(Path("c/controller.json").read_text())["origin"]["searches"]["controller"]["seed"] == 5
    assert Path("a/controller.json").read_bytes() != Path("c/controller.json").read_bytes()


def test_a_structure_option_has_its_own_search_ranges(here: Path, short: str) -> None:
    """--structure replaces the design file's controller with its search ranges."""
    Path(short).write_text(SHORT + "[controller.search_ranges]\ntau_d = { low = 0.02, high = 1.0 }\n")
    assert main(["design", "--design", short, "--structure", "pi", "--out", "out"]) == 0
    law = read_controller(Path("out/controller.json").read_text(), "c").law
    assert isinstance(law, PidLaw)
    assert law.kd == 0.0
    assert not Path("out/pi.json").exists(), "the PI is the designed controller"


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
    assert "The design is against all plants at once" in Path("true/report.html").read_text()
    assert "The design is against all plants at once" not in Path("false/report.html").read_text()


def test_a_missed_specification_has_exit_status_1(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A proportional controller leaves a steady-state error: it is written, but not recommended."""
    (here / "d.toml").write_text(SHORT)
    assert main(["design", "--design", "d.toml", "--structure", "p", "--out", "out"]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert "the designed loop misses specifications:" in text
    assert "must_meet_specifications = true" in text
    assert "do not run this controller as it is" in text
    assert "hil run" not in text
    assert Path("out/controller.json").exists()


def test_a_controller_with_an_unstable_loop_has_no_file(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A continuous design does not take 20 samples of delay into account."""
    (here / "d.toml").write_text(SHORT + '[loop]\ndesign = "continuous"\ndelay_samples = 20\n')
    assert main(["design", "--design", "d.toml", "--out", "out"]) == 1
    text = capsys.readouterr().out
    line = next(line for line in text.splitlines() if line.startswith("no controller file, unstable"))
    assert "ZN" in line
    names = dict(
        zip(
            ("controller", "hls", "pi", "zn", "tlc"),
            ("PID (designed)", "HLS", "PI", "ZN", "TLC"),
            strict=True,
        )
    )
    for stem, name in names.items():
        assert (Path("out") / f"{stem}.json").exists() == (name not in line), name
    assert "hil run" not in text


def test_an_unstable_design_is_not_written(
    here: Path, short: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    design = plain_design()
    measures = (replace(design.measures[0], eps_sampled=0.0), *design.measures[1:])
    unstable = replace(design, measures=measures, guarantees=())
    monkeypatch.setattr(procedure, "design_controller", lambda *_: unstable)
    assert main(["design", "--out", "out"]) == 1
    text = capsys.readouterr().out
    assert "no controller file, unstable in the rig's loop: PID (designed)" in text
    assert "controller.json" not in text
    assert not Path("out/controller.json").exists()
    assert Path("out/hls.json").exists()


def test_results_of_the_same_plant_are_replaced(here: Path, short: str) -> None:
    assert main(["design", "--design", short, "--out", "out"]) == 0
    before = Path("out/controller.json").read_bytes()
    assert main(["design", "--design", short, "--structure", "pi", "--out", "out"]) == 0
    assert Path("out/controller.json").read_bytes() != before
    assert not Path("out/pi.json").exists(), "it belongs to the earlier design"
    assert main(["design", "--design", short, "--out", "out"]) == 0
    assert Path("out/controller.json").read_bytes() == before


def test_a_folder_with_other_results_is_refused_before_the_search(
    here: Path, short: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", write_plant(here, name="a <b>"), "--design", short]) == 0
    monkeypatch.setattr(procedure, "design_controller", None)
    monkeypatch.setattr(paper, "reproduce", None)
    (here / "mine").mkdir()
    (here / "mine" / "controller.json").write_text("{}")
    (here / "taken").write_text("")
    for argv, message in (
        (
            ["vertical", "--out", "designs/a-b-"],
            'results folder designs/a-b- holds "Controller design: a <b>"; it is left as it is',
        ),
        (
            ["--paper", "--out", "designs/a-b-"],
            'results folder designs/a-b- holds "Controller design: a <b>"; it is left as it is',
        ),
        (
            ["--out", "mine"],
            "results folder mine contains controller.json, which no design has written; it is left",
        ),
        (["--out", "taken"], "results folder taken: taken is a file, not a folder"),
        (["--out", "taken/deeper"], "results folder taken/deeper: taken is a file, not a folder"),
    ):
        assert main(["design", *argv]) == 2
        assert message in capsys.readouterr().err
    assert (here / "mine" / "controller.json").read_text() == "{}"
    assert "a &lt;b&gt;" in Path("designs/a-b-/report.html").read_text()


def write_record(path: Path, y_unit: float = 1.0) -> None:
    """Write a record of the paper's plant with a square wave as input."""
    t = np.arange(300) * PERIOD_S
    u = np.sign(np.sin(5 * t))
    held = control.sample_system(control.tf(paper_plant().num, paper_plant().den), PERIOD_S, "zoh")
    y = control.forced_response(held, t, u).outputs * y_unit
    path.write_text("time_s,u,y\n" + "".join(f"{a:.6f},{b},{c}\n" for a, b, c in zip(t, u, y, strict=True)))


def test_a_measured_record_is_compared_with_the_model(
    here: Path, short: str, capsys: pytest.CaptureFixture[str]
) -> None:
    write_record(here / "r.csv")
    assert main(["design", "--design", short, "--measured", "r.csv", "--out", "out"]) == 0
    assert "the model follows r.csv to 100.0 %" in capsys.readouterr().out
    assert Path("out/figures/identification.svg").exists()
    write_record(here / "mm.csv", 1000.0)
    assert main(["design", "--design", short, "--measured", "mm.csv", "--out", "out"]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert "its y is 1000 times what the model says" in text
    assert "y in mm, the model in m?" in text
    assert "hil run" not in text
    (here / "bad.csv").write_text("time,u,y\n0,0,0\n")
    assert "bad.csv: column time_s is missing" in error_of(["--measured", "bad.csv"], capsys)


def test_a_shipped_plant_is_compared_with_its_record(
    here: Path, short: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for plant in ("vertical", "horizontal", "rotation"):
        main(["design", plant, "--design", short])
        assert re.search(f"the model follows the shipped {plant}.csv to 9[789]", capsys.readouterr().out)
        assert Path(f"designs/{plant}/figures/identification.svg").exists()
    write_record(here / "r.csv")
    main(["design", "vertical", "--design", short, "--measured", "r.csv"])
    assert "the model follows r.csv to" in capsys.readouterr().out, (
        "the user's record replaces the shipped one"
    )


def test_the_name_of_a_plant_becomes_a_safe_folder_name(here: Path, short: str) -> None:
    assert main(["design", write_plant(here, name="../arm 2/vertical"), "--design", short]) == 0
    assert Path("designs/..-arm-2-vertical/controller.json").exists()


def test_the_next_command_runs_the_plant_that_was_designed_for(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for changes, axis in (
        ({"name": "horizontal"}, "horizontal"),
        ({"name": "x", "output_unit": "rad"}, "rotation"),
        ({"name": "paper", "den": [1.0, 17.3931, 175.08, 71.1]}, "vertical"),
    ):
        assert main(["design", write_plant(here, **changes)]) == 0
        out = capsys.readouterr().out
        assert f"next        hil run --plant {axis}=plant.json --controller {axis}=designs/" in out


def test_warnings_of_a_plant_file_are_repeated(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = write_plant(here, warnings=["the input excites no frequency above 5 rad/s"])
    assert main(["design", plant]) == 0
    warning = "plant mine: the input excites no frequency above 5 rad/s"
    assert f"warning from the plant file: {warning}" in capsys.readouterr().out
    assert warning in Path("designs/mine/report.html").read_text()
    origin = read_controller(Path("designs/mine/controller.json").read_text(), "c").origin
    assert origin["plant"]["warnings"] == ["the input excites no frequency above 5 rad/s"]


def test_init_writes_the_example_and_never_overwrites_a_file(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", "--init"]) == 0
    assert Path("design.toml").read_text() == example_text()
    Path("design.toml").write_text("mine")
    assert main(["design", "--init"]) == 2
    assert "design.toml exists already and is left as it is" in capsys.readouterr().err
    assert Path("design.toml").read_text() == "mine"


# Wrong input


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num": [0.0]}, "plant.json: num: the plant's gain is 0"),
        (
            {"num": [1.0, 2.0, 3.0], "den": [1.0, 1.0]},
            "plant.json: num has degree 2, den 1: the model is improper",
        ),
        ({"output_unit": "mm"}, "plant.json: output_unit is 'mm', but must be 'm' or 'rad'"),
        ({"nmu": [1.0]}, "plant.json: unknown key nmu; did you mean num?"),
    ],
)
def test_an_impossible_plant_is_refused(
    changes: dict[str, Any], message: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in error_of([write_plant(here, **changes)], capsys)


def test_a_plant_in_another_unit_is_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant = write_plant(here)
    assert "plant.json: output_unit: m, but the axis is in rad" in error_of(
        [plant, "--axis-unit", "rad"], capsys
    )
    (here / "d.toml").write_text('axis_unit = "rad"\n')
    assert "output_unit: m, but the axis is in rad" in error_of([plant, "--design", "d.toml"], capsys)


def test_a_missing_file_is_refused(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "plant 'nope.json': there is no file nope.json, and no shipped plant of this name" in error_of(
        ["nope.json"], capsys
    )
    assert "nope.toml: cannot be read" in error_of(["--design", "nope.toml"], capsys)
    (here / "d.toml").write_text('[further_plants]\nfiles = ["nope.json"]\n')
    assert "plant 'nope.json': there is no file nope.json, and no shipped plant of this name" in error_of(
        ["--design", "d.toml"], capsys
    )


def test_a_recording_instead_of_a_plant_is_refused_with_the_next_command(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "data.mcap").write_bytes(b"\x89MCAP0\r\n".ljust(2_000_000, b"\x00"))
    assert (
        "data.mcap: is a recording (MCAP), not a text; `hil identify` makes a plant file from it"
        in error_of(["data.mcap"], capsys)
    )


def test_infeasible_specifications_are_refused_with_the_amount(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "d.toml").write_text("[specifications]\nsettling_s = 0.02\novershoot = 0.9\n" + SHORT)
    text = error_of(["--design", "d.toml"], capsys)
    assert "no weight within the search bounds meets all specifications" in text
    assert "settling_s" in text
    assert "NOT met (<= 0.02" in text
    assert "overshoot" not in text.split("Best compromise")[1], "only what fails is named"


def test_a_structure_that_cannot_stabilise_the_plant_is_refused(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No proportional gain adds damping to an unstable plant of second order."""
    plant = write_plant(here, num=[20.0], den=[1.0, -0.1, 0.0])
    (here / "d.toml").write_text("[specifications]\novershoot = 1.0\n" + SHORT)
    text = error_of([plant, "--design", "d.toml", "--structure", "p"], capsys)
    assert "stabilises the plant" in text
    assert "gain is negative" not in text


def test_a_plant_of_negative_gain_is_named_as_the_reason(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant = write_plant(here, num=[-x for x in paper_plant().num])
    text = error_of([plant], capsys)
    assert "stabilises the plant" in text
    assert "the plant's gain is negative. Reverse the valve" in text


def test_a_plant_of_negative_gain_can_be_designed_for_with_negative_search_ranges(here: Path) -> None:
    plant = write_plant(here, num=[-x for x in paper_plant().num])
    (here / "d.toml").write_text(
        '[controller]\nstructure = "pi"\n[controller.search_ranges]\n'
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
    assert "'-1' is not a whole number of 0 or more" in capsys.readouterr().err


# The paper


def test_the_paper_is_reproduced(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "--paper"]) == 0
    out = capsys.readouterr().out
    for figure in ("0.60149", "0.54681", "67960", "45 %", "0.08 m/V"):
        assert figure in out
    assert "16.67 is a misprint" in " ".join(out.split())
    assert "0 must agree and do not" in " ".join(out.split())
    html = Path("designs/paper-reproduction/report.html").read_text()
    assert "The paper's figures beside the computed ones" in html


def test_a_figure_that_must_agree_and_does_not_has_exit_status_1(
    here: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = reproduction()  # cached for all tests, so it must be made before the printed figure is changed
    monkeypatch.setattr(printed, "PPID_EPS", 0.56)
    failing = replace(done, claims=check_claims(done.evidence))
    monkeypatch.setattr(paper, "reproduce", lambda _on_progress: failing)
    assert main(["design", "--paper"]) == 1
    assert "DOES NOT REPRODUCE" in capsys.readouterr().out


def test_paper_takes_no_other_plant_or_option(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for others in (["rotation"], ["--seed", "2"], ["--structure", "pi"]):
        assert "--paper repeats the paper's own design" in error_of(["--paper", *others], capsys)


def test_the_help_names_every_structure() -> None:
    assert STRUCTURE_NAMES.split(", ") == list(STRUCTURES)


# Speed


def test_a_design_imports_nothing_slow(here: Path) -> None:
    """Importing matplotlib and control takes longer than a whole design."""
    (here / "short.toml").write_text(SHORT)
    slow = "{'matplotlib', 'control', 'scipy.signal', 'scipy.optimize', 'pandas'}"
    program = (
        "import sys; from hil.cli import main; main(['design', 'vertical', '--design', 'short.toml']); "
        f"sys.exit(bool({slow} & set(sys.modules)))"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)


def test_the_help_breaks_no_name(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for columns in ("60", "80"):
        monkeypatch.setenv("COLUMNS", columns)
        with pytest.raises(SystemExit):
            main(["design", "--help"])
        text = capsys.readouterr().out
        for name in ("lead-lag", "pi-lead", "rotation-loaded", "H-infinity", "--structure"):
            assert name in text
        assert max(map(len, text.splitlines())) <= int(columns)


def test_the_help_needs_no_numpy(here: Path) -> None:
    program = (
        "import sys; from design.cli import parser; parser().format_help(); sys.exit('numpy' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
