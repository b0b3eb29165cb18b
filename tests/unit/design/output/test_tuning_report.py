"""The page of a tuning and its text on the terminal: verdict, specification, prediction and measurement."""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html import unescape
from pathlib import Path

import msgspec
import numpy as np
import pytest
from rich.console import Console
from support.constants import PERIOD_S
from support.designs import HEAVIER, REVERSED, sampled_design
from support.drawn_curves import drawn_curves
from support.identified import identified
from support.recorded_runs import following, lag, record_run, step

from design.models.plant import Plant, paper_plant
from design.output.tuning_report import print_tuning, render_tuning, write_tuning_report
from design.output.tuning_results import Condition, Job, Model, Tuning, Verified, failures
from design.synthesis.procedure import Design
from hil.recording import open_recording
from hil.views.summary import StepResponse, summarise

HOSTILE = '"><script>alert(1)</script>'
NOMINAL, LOADED = Condition(name="nominal"), Condition(name="loaded", events=["payload:3@0"])
OTHER = Condition(name="other", instruction=f"Reverse it. {HOSTILE}")
TAU_S = 0.2


def stable_design() -> Design:
    """Return the design with the plants that its controller stabilises."""
    design = sampled_design()
    return replace(design, guarantees=design.guarantees[:1])


def model(condition: Condition, plant: Plant, folder: Path) -> Model:
    return Model(condition, plant, identified(), folder / f"{condition.name}.plant.json")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the recordings of a step that settles quickly, and of one that is slow."""
    path = tmp_path_factory.mktemp("tuning")
    for name, tau_s in (("nominal", TAU_S), ("loaded", 0.5)):
        signals = following(step(0.1, 1.0), lag(0.1, 1.0, tau_s))
        record_run(path / f"{name}-step.mcap", round(5.0 / PERIOD_S), signals)
    return path


def verified(condition: Condition, recording: Path, design: Design) -> Verified:
    measured = summarise(open_recording(recording)).axes["vertical"]
    assert isinstance(measured, StepResponse)
    return Verified(condition, recording, measured, failures(measured, design.design_file))


def tuning_of(folder: Path, *, is_slow: bool = False, design: Design | None = None) -> Tuning:
    """Return a tuning under two conditions; the loaded step is slow if ``is_slow``."""
    design = design or stable_design()
    steps = {"nominal": "nominal-step.mcap", "loaded": f"{'loaded' if is_slow else 'nominal'}-step.mcap"}
    models = [model(NOMINAL, paper_plant(), folder), model(LOADED, HEAVIER, folder)]
    if len(design.guarantees) == 2:
        models.append(model(OTHER, REVERSED, folder))
    return Tuning(
        job=Job("vertical", 0.4, 60.0, "OE(1,3,1)", [m.condition for m in models]),
        models=tuple(models),
        design_file=design.design_file,
        requested_settling_s=design.design_file.specifications.settling_s,
        design=design,
        controller_file=folder / "design" / "controller.json",
        verified=tuple(verified(c, folder / steps[c.name], design) for c in (NOMINAL, LOADED)),
    )


def text_of(html: str) -> str:
    """Return the visible text, with all white space as single blanks."""
    visible = re.sub(r"<(script|style).*?</\1>", " ", html, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", visible)))


def page(tuning: Tuning, folder: Path) -> str:
    return text_of(render_tuning(tuning, folder))


def printed(tuning: Tuning, width: int = 80) -> str:
    console = Console(file=io.StringIO(), width=width, highlight=False, soft_wrap=True, markup=False)
    print_tuning(console, tuning)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def joined(text: str) -> str:
    return re.sub(r"\s+", " ", text)


def test_every_section_is_present(folder: Path) -> None:
    text = page(tuning_of(folder), folder)
    sections = (
        "Verdict",
        "Specification, prediction and measurement",
        "Measured steps",
        "Distance between the models",
        "Models",
        "Files",
    )
    places = [text.index(f"{section} ") for section in sections]
    assert places == sorted(places)
    assert "nan" not in re.findall(r"[a-z]+", text.lower())


def test_the_page_refers_to_nothing_outside_but_its_own_files(folder: Path) -> None:
    html = render_tuning(tuning_of(folder), folder).replace('"http://www.w3.org/2000/svg"', "")
    for outside in ("http:", "https:", "src=", "<link", "@import", "url(h"):
        assert outside not in html
    links = set(re.findall(r'href="([^"]+)"', html))
    assert {
        "design/report.html",
        "design/controller.json",
        "nominal.plant.json",
        "nominal-step.mcap",
    } <= links
    assert not any(link.startswith(("/", "..")) for link in links)


def test_drawings_are_well_formed_and_ids_are_unique(folder: Path) -> None:
    html = render_tuning(tuning_of(folder), folder)
    for svg in re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL):
        ET.fromstring(svg)
    ids = re.findall(r' id="([^"]+)"', html)
    assert len(ids) == len(set(ids))


def test_a_gap_below_the_margin_is_a_guarantee(folder: Path) -> None:
    tuning = tuning_of(folder)
    (guarantee,) = tuning.design.guarantees
    stated = (
        f"✓ Robust stability is guaranteed over what was measured: every ν-gap to the nominal model (the "
        f"largest is {guarantee.gap:.3f}, heavier) is below ε {guarantee.eps:.3f}."
    )
    for text in (page(tuning, folder), joined(printed(tuning))):
        assert stated in text
    assert f"loaded {guarantee.gap:.4f} 0.0000" in page(tuning, folder)


def test_a_gap_above_the_margin_is_decided_by_direct_computation(folder: Path) -> None:
    design = stable_design()
    (guarantee,) = design.guarantees
    far = replace(design, guarantees=(replace(guarantee, gap=0.9),))
    for text in (page(tuning_of(folder, design=far), folder), joined(printed(tuning_of(folder, design=far)))):
        assert "! Robust stability is not guaranteed by the margin: the ν-gap of heavier (0.900)" in text
        assert "By direct computation, the controller stabilises each identified model" in text


def test_an_unstable_loop_is_named(folder: Path) -> None:
    tuning = tuning_of(folder, design=sampled_design())
    assert not tuning.is_stable_on_all
    for text in (page(tuning, folder), joined(printed(tuning))):
        assert "✗ The controller does not stabilise reversed." in text
    assert "other 1.0000 1.0000 0.0000 unstable unstable" in page(tuning, folder)
    assert not tuning.meets_specifications


def test_met_specifications_are_stated_for_prediction_and_measurement(folder: Path) -> None:
    tuning = tuning_of(folder)
    assert tuning.meets_specifications
    for text in (page(tuning, folder), joined(printed(tuning))):
        assert "✓ Prediction: the specifications are met with every identified model." in text
        assert "✓ Measurement: every measured step meets the specifications." in text


def test_readings_that_are_specified_for_the_shaped_plant_are_not_judged(folder: Path) -> None:
    tuning = tuning_of(folder)
    assert tuning.judged == {"overshoot", "settling_s", "error"}
    controller = msgspec.structs.replace(tuning.design_file.controller, must_meet_specifications=True)
    strict = msgspec.structs.replace(tuning.design_file, controller=controller)
    assert {"bandwidth_rad_s", "gain_db"} <= replace(tuning, design_file=strict).judged


def test_a_missed_prediction_is_named_with_its_condition(folder: Path) -> None:
    design = stable_design()
    limits = msgspec.structs.replace(design.design_file.specifications, settling_s=1.07)
    strict = msgspec.structs.replace(design.design_file, specifications=limits)
    tuning = tuning_of(folder, design=replace(design, design_file=strict))
    settling = {
        model.condition.name: next(r for r in read if r.quantity == "settling_s")
        for model, read in zip(tuning.models, tuning.predictions, strict=True)
    }
    missed = [name for name, reading in settling.items() if not reading.met]
    assert missed == ["nominal"]
    value = f"{settling['nominal'].value:.4g} s"
    assert f"✗ Prediction: specifications are not met. nominal: settling time {value}" in page(tuning, folder)
    assert f"{value} ✗" in page(tuning, folder)
    assert not tuning.meets_specifications


def test_a_measured_step_that_misses_a_limit_is_marked(folder: Path) -> None:
    tuning = tuning_of(folder, is_slow=True)
    settling_s = tuning.verified[1].measured.settling_s
    assert settling_s == pytest.approx(0.5 * np.log(50.0), abs=PERIOD_S)
    stated = (
        f"✗ Measurement: specifications are not met. loaded: settling time {settling_s:.4g} s, limit 1.2 s."
    )
    for text in (page(tuning, folder), joined(printed(tuning))):
        assert stated in text
        assert f"{settling_s:.4g} s ✗" in text
    html = render_tuning(tuning, folder)
    cell = re.search(rf'<td class="n bad" data-label="measured, loaded">{settling_s:.4g} s ✗</td>', html)
    assert cell


def test_a_step_that_never_settles_is_a_failure_in_words(folder: Path) -> None:
    tuning = tuning_of(folder)
    measured = replace(tuning.verified[0].measured, settling_s=None, overshoot_percent=7.0)
    found = failures(measured, tuning.design_file)
    assert found == ("overshoot 7 %, limit 5 %", "settling time never, limit 1.2 s")
    broken = replace(tuning, verified=(replace(tuning.verified[0], measured=measured, failures=found),))
    assert "never ✗" in page(broken, folder)


def with_measured_error(tuning: Tuning, error_m: float) -> Tuning:
    measured = replace(tuning.verified[0].measured, steady_state_error=error_m)
    first = replace(tuning.verified[0], measured=measured, failures=failures(measured, tuning.design_file))
    return replace(tuning, verified=(first, tuning.verified[1]))


def test_a_measured_error_that_friction_explains_is_not_judged_and_stated(folder: Path) -> None:
    tuning = tuning_of(folder)
    off = with_measured_error(tuning, -0.0006)
    assert off.meets_specifications
    stated = (
        "! The measured steady-state error is over the limit for the linear loop (nominal 0.6 %), and within "
        "the 1 % of the step"
    )
    for text in (page(off, folder), joined(printed(off))):
        assert stated in text
        assert "0.6 % *" in text
        assert "0.6 % ✓" not in text
        assert "* not judged: eq. (9) limits" in text
        assert "so that one over the limit by at most 1 % of the step is neither met nor missed" in text
    assert '<td class="n soft" data-label="measured, nominal">0.6 % *</td>' in render_tuning(off, folder)
    assert "steady-state error is over" not in page(tuning, folder)


def test_a_measured_error_beyond_the_allowance_is_a_failure(folder: Path) -> None:
    tuning = tuning_of(folder)
    off = with_measured_error(tuning, 0.0012)
    assert not off.meets_specifications
    for text in (page(off, folder), joined(printed(off))):
        assert (
            "✗ Measurement: specifications are not met. nominal: steady-state error 1.2 %, limit 1.1 %."
            in text
        )
        assert "1.2 % ✗" in text


def test_a_relaxed_limit_is_said_clearly(folder: Path) -> None:
    tuning = replace(tuning_of(folder), requested_settling_s=0.8)
    stated = "! The limit on the settling time was relaxed from 0.8 s to 1.2 s"
    assert stated in page(tuning, folder)
    assert stated in joined(printed(tuning))
    for same in (1.2, None):
        assert "relaxed" not in page(replace(tuning, requested_settling_s=same), folder)


def test_measured_steps_are_drawn_with_setpoint_and_prediction(folder: Path) -> None:
    html = render_tuning(tuning_of(folder), folder)
    found = re.search(r'<figure id="step-nominal">.*?(<svg.*?</svg>)', html, flags=re.DOTALL)
    assert found
    curves = drawn_curves(found[1])[0]
    (measured,) = curves["measured"]
    after = measured[measured[:, 0] > 0.05]
    expected = 0.1 * (1.0 - np.exp(-after[:, 0] / TAU_S))
    np.testing.assert_allclose(after[:, 1], expected, atol=0.005)
    (setpoint,) = curves["setpoint"]
    assert (setpoint[0, 1], setpoint[-1, 1]) == (pytest.approx(0.0, abs=1e-3), pytest.approx(0.1, abs=1e-3))
    (predicted,) = curves["predicted"]
    assert predicted[-1, 1] == pytest.approx(0.1, abs=0.003)


def test_a_step_that_began_away_from_its_setpoint_says_so(tmp_path: Path, folder: Path) -> None:
    path = tmp_path / "late-step.mcap"
    signals = following(step(0.1, 1.0), lambda t: -0.005 + lag(0.105, 1.0, TAU_S)(t))
    record_run(path, round(5.0 / PERIOD_S), signals)
    tuning = tuning_of(folder)
    late = replace(tuning, verified=(verified(NOMINAL, path, tuning.design),))
    assert "the axis was still 0.005 m away from the setpoint before" in page(late, folder)
    assert "the axis was still" not in page(tuning, folder)


def test_hostile_text_is_escaped(folder: Path) -> None:
    tuning = replace(tuning_of(folder, design=sampled_design()), warnings=(HOSTILE,))
    html = render_tuning(tuning, folder)
    assert "<script>alert" not in html
    assert text_of(html).count(HOSTILE) == 2, "the warning and the instruction"


def test_a_file_name_with_blanks_and_quotes_is_a_valid_address(folder: Path) -> None:
    tuning = tuning_of(folder)
    odd = replace(tuning.models[0], plant_file=folder / 'a "b" #1.json')
    html = render_tuning(replace(tuning, models=(odd, *tuning.models[1:])), folder)
    assert 'href="a%20%22b%22%20%231.json"' in html


@pytest.mark.parametrize("is_slow", [False, True])
def test_the_terminal_text_fits_into_80_columns(folder: Path, is_slow: bool) -> None:
    for design in (stable_design(), sampled_design()):
        text = printed(tuning_of(folder, is_slow=is_slow, design=design))
        assert max(map(len, text.splitlines())) <= 80
        assert "…" not in text


def test_the_page_is_written_as_utf_8(folder: Path) -> None:
    path = folder / "tuning.html"
    write_tuning_report(tuning_of(folder), path)
    assert path.read_bytes().decode("utf-8") == render_tuning(tuning_of(folder), folder)
