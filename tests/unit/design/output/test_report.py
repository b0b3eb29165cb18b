"""The report: its content is that of the design, and it refers to nothing outside the file."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html import unescape

import msgspec
import numpy as np
import pytest
from support.designs import continuous_design, plain_design, reproduction, sampled_design

from design.closed_loop.comparison import Measures, eps_text, number_text, table_rows
from design.models.measured_record import ModelFit
from design.models.transfer_function import TransferFunction
from design.output.figure_set import design_figures
from design.output.mathml import transfer_function_formula
from design.output.report import render
from design.synthesis.procedure import Design
from design.synthesis.recommendation import recommend


def report_of(design: Design, measured: ModelFit | None = None, title: str = "Title") -> str:
    figures = design_figures(design, measured)
    return render(design, figures, recommend(design, measured), title=title, measured=measured)


def text_of(html: str) -> str:
    """Return the visible text, with all white space as single blanks."""
    visible = re.sub(r"<(script|style).*?</\1>", " ", html, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", visible)))


@pytest.fixture(scope="module")
def html() -> str:
    return report_of(sampled_design())


def test_the_report_refers_to_nothing_outside(html: str) -> None:
    without_namespace = html.replace('"http://www.w3.org/2000/svg"', "")
    for outside in ("http:", "https:", "src=", "<link", "@import", "url(h"):
        assert outside not in without_namespace
    assert re.findall(r'href="(?!#)', html) == []


def test_every_value_of_the_comparison_is_in_the_report(html: str) -> None:
    design = sampled_design()
    text = text_of(html)
    for row in table_rows("m"):
        cells = " ".join(row.text(measures) for measures in design.measures)
        assert re.search(re.escape(f"{row.label} {row.unit}".strip()) + r"\s+" + re.escape(cells), text), (
            row.label
        )


def test_specifications_are_shown_with_their_readings(html: str) -> None:
    text = text_of(html)
    design = sampled_design()
    for reading in design.weight.readings:
        assert reading.quantity in text
        assert reading.reading in text
        assert f"{reading.value:.4g}" in text
    assert "crossover of Gs" in text
    assert ", of GK" in text
    assert "✗" not in text


def test_a_missed_specification_is_marked() -> None:
    design = sampled_design()
    missed = tuple(replace(reading, met=False) for reading in design.designed_readings)
    html = report_of(replace(design, designed_readings=missed))
    assert text_of(html).count("✗") == 3, (
        "overshoot, settling and error; gain and crossover are specified for Gs"
    )
    assert "the designed loop misses specifications:" in html


def test_the_guarantee_for_every_further_plant_is_shown(html: str) -> None:
    text = text_of(html)
    heavier, reversed_plant = sampled_design().guarantees
    assert heavier.guaranteed
    assert heavier.eps_there > 0.0
    assert (
        f"heavier {heavier.gap:.4f} {heavier.eps:.4f} guaranteed: ε exceeds the ν-gap {heavier.eps_there:.4f}"
        in text
    )
    assert (reversed_plant.gap, reversed_plant.eps_there) == (1.0, 0.0)
    assert "reversed 1.0000" in text
    assert "not guaranteed by ε alone unstable" in text
    assert "plant reversed is unstable with this controller" in text


def test_without_further_plants_the_report_says_what_is_guaranteed() -> None:
    design = continuous_design()
    assert f"below ε = {design.eps:.4f}" in text_of(report_of(design))


def test_without_a_record_the_report_says_how_to_give_one(html: str) -> None:
    assert "No measured record was given, so the model is not compared with one" in text_of(html)
    t = np.arange(50) * 0.1
    with_record = text_of(report_of(sampled_design(), ModelFit("r.csv", t, t, np.cos(t), np.cos(t) + 0.01)))
    assert "No measured record" not in with_record
    assert "Fig. 5. Measured output" in with_record


def test_figures_are_in_order_and_well_formed(html: str) -> None:
    found = re.findall(r"Fig\. (\d+(?: \([abc]\))?)\. ", text_of(html))
    assert found == ["6", "7", "8", "9", "10", "11 (a)", "11 (b)", "11 (c)"]
    for svg in re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL):
        ET.fromstring(svg)
    ids = re.findall(r' id="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    for reference in re.findall(r"url\(#([^)]+)\)", html):
        assert reference in ids


def test_provenance_is_stated(html: str) -> None:
    text = text_of(html)
    for stated in ("seed 1", "numpy", "python", '"kp": ', '"delay_samples": 1'):
        assert stated in text
    for candidate in sampled_design().candidates:
        assert candidate.method in text


def test_names_of_plants_are_escaped() -> None:
    design = sampled_design()
    marked_up = msgspec.structs.replace(design.plant, name="<script>x</script>", description="<i>&")
    html = report_of(replace(design, plant=marked_up), title="<script>x</script>")
    assert "<script>x" not in html
    assert "<i>&" not in html


def test_unstable_loops_are_named_and_not_drawn() -> None:
    design = sampled_design()
    unstable = tuple(
        replace(m, stable=c.name not in ("ZN", "TLC"))
        for c, m in zip(design.candidates, design.measures, strict=True)
    )
    html = report_of(replace(design, measures=unstable))
    assert text_of(html).count("unstable") >= 2 * (len(table_rows("m")) - 2)
    assert "Fig. 9." not in html


def test_a_bandwidth_above_the_nyquist_frequency_is_not_shown_as_a_measurement() -> None:
    design = plain_design()
    first = replace(design.measures[0], bandwidth_rad_s=np.inf)
    text = text_of(report_of(replace(design, measures=(first, *design.measures[1:]))))
    assert "closed loop −3 dB: above the Nyquist frequency 280.5 rad/s" in text
    assert "280.50" not in text
    assert "bandwidth, −3 dB of T rad/s > 280.5" in text
    continuous = replace(continuous_design().measures[0], bandwidth_rad_s=np.inf)
    design = continuous_design()
    text = text_of(report_of(replace(design, measures=(continuous, *design.measures[1:]))))
    assert "closed loop −3 dB: no crossing" in text


def test_a_reading_above_the_nyquist_frequency_is_not_shown_as_a_measurement() -> None:
    design = plain_design()
    readings = tuple(
        replace(reading, value=np.inf) if reading.quantity == "bandwidth_rad_s" else reading
        for reading in design.weight.readings
    )
    text = text_of(report_of(replace(design, weight=replace(design.weight, readings=readings))))
    assert "bandwidth_rad_s ≥ 4 rad/s above the Nyquist frequency 280.5 rad/s ✓" in text


def test_warnings_of_the_plant_file_are_repeated() -> None:
    design = plain_design()
    doubtful = msgspec.structs.replace(design.plant, warnings=["the input is <weak>"])
    html = report_of(replace(design, plant=doubtful))
    assert "Warning from the plant file: plant paper: the input is <weak>" in text_of(html)
    assert "<weak>" not in html
    assert "Warning from the plant file" not in text_of(report_of(design))


def test_a_doubt_about_the_measured_record_is_shown() -> None:
    t = np.arange(50) * 0.1
    measured = ModelFit("r.csv", t, t, np.cos(t), np.sin(t), doubt="r.csv: the columns are exchanged")
    text = text_of(report_of(plain_design(), measured))
    assert "Do not run this controller as it is: r.csv: the columns are exchanged" in text


def test_a_users_own_plant_has_no_figure_numbers_of_the_paper() -> None:
    design = plain_design()
    own = msgspec.structs.replace(design.plant, num=[0.48, *design.plant.num[1:]])
    assert "Fig." not in text_of(report_of(replace(design, plant=own)))


def test_every_cell_has_its_heading_for_narrow_screens(html: str) -> None:
    """At phone width a row becomes a block of lines, each with the heading of its column."""
    bodies = re.findall(r"<tbody>(.*?)</tbody>", html, flags=re.DOTALL)
    assert len(bodies) == 3
    for number in re.findall(r'<td class="n[^>]*>', "".join(bodies)):
        assert re.search(r'data-label="[^"]+"', number), number
    assert re.search(r"@media \(max-width: \d+px\) \{[^@]*td\[data-label\]::before", html)


def test_infinite_values_and_unstable_loops_have_their_own_text() -> None:
    rows = {row.label: row for row in table_rows("m")}
    m = replace(sampled_design().measures[0], gain_margin=np.inf, settling_s=np.inf)
    assert rows["gain margin"].text(m) == rows["2 % settling"].text(m) == "∞"
    unstable: Measures = replace(m, stable=False)
    assert rows["overshoot"].text(unstable) == "unstable"


def test_a_transfer_function_is_written_as_a_formula() -> None:
    text = transfer_function_formula(
        TransferFunction(np.array([-1.0, 0.0, 2.5]), np.array([1.0, 1.0, 0.0])), "G s"
    )
    ET.fromstring(text)
    plain = re.sub(r"<[^>]+>", "", text.replace("</msup>", " "))
    assert plain == "Gs(s)=−s2 +2.5s2 +s"


def test_a_sampled_transfer_function_is_written_in_z_with_powers_of_ten() -> None:
    text = transfer_function_formula(
        TransferFunction(np.array([2.5e-7, 0.0]), np.array([1.0, -1.87654321, 0.9])),
        "G",
        variable="z",
        digits=8,
    )
    ET.fromstring(text)
    plain = re.sub(r"<[^>]+>", "", text.replace("</msup>", " "))
    assert plain == "G(z)=2.5·10−7 zz2 −1.8765432z+0.9"


def test_a_dead_time_is_part_of_the_formula() -> None:
    text = transfer_function_formula(TransferFunction(np.array([2.0]), np.array([1.0, 1.0])), "G", 0.0168)
    ET.fromstring(text)
    assert re.sub(r"<[^>]+>", "", text) == "G(s)=2s+1e−0.0168s"


def test_a_plant_with_dead_time_has_no_figure_numbers_and_no_continuous_margin() -> None:
    design = plain_design()
    late = msgspec.structs.replace(design.plant, dead_time_s=0.0168)
    first = replace(design.measures[0], eps_continuous=np.nan)
    measures = (first, *design.measures[1:])
    html = report_of(replace(design, plant=late, measures=measures))
    assert "Fig." not in text_of(html)
    assert "0.0168 s of dead time" in text_of(html)
    assert "ε, continuous loop –" in text_of(html)


def test_the_report_of_the_paper_lists_every_claim() -> None:
    design, claims = reproduction().design, reproduction().claims
    html = render(design, design_figures(design), recommend(design), title="t", claims=claims)
    text = text_of(html)
    for claim in claims:
        assert re.sub(r"\s+", " ", f"{claim.where} {claim.what} {claim.printed} {claim.computed}") in text
    assert f"{reproduction().agreeing} of {len(claims)} printed figures" in text


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (1.234, 2, "1.23"),
        (0.0026, 2, "0.0026"),
        (0.12, 2, "0.12"),
        (0.0, 2, "0.00"),
        (np.inf, 2, "∞"),
        (132376.21, 1, "132376.2"),
        (0.04, 1, "0.04"),
    ],
)
def test_small_numbers_keep_two_digits(value: float, decimals: int, text: str) -> None:
    assert number_text(value, decimals) == text


def test_a_number_that_may_vanish_has_fixed_decimals_and_a_margin_of_0_is_unstable() -> None:
    assert number_text(3e-9, 1, vanishing=True) == "0.0"
    assert (eps_text(0.0), eps_text(0.57239), eps_text(2e-5)) == ("unstable", "0.5724", "2e-05")
