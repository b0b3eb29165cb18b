"""The report: everything in it comes from the design, nothing from outside the file."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html import unescape

import msgspec
import numpy as np
import pytest
from support.designs import continuous_design, reproduction, sampled_design

from design.closed_loop.comparison import Measures, eps_text, number_text, table_rows
from design.models.measured_record import ModelFit
from design.models.transfer_function import TransferFunction
from design.output.advice import warnings
from design.output.report import design_figures, mathml, render
from design.synthesis.procedure import Design


def report_of(design: Design, measured: ModelFit | None = None, title: str = "Title") -> str:
    return render(design, design_figures(design, measured), title=title, measured=measured)


def text_of(html: str) -> str:
    """What a reader sees, scripts and styles left out, blanks made one."""
    visible = re.sub(r"<(script|style).*?</\1>", " ", html, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", visible)))


@pytest.fixture(scope="module")
def html() -> str:
    return report_of(sampled_design())


def test_nothing_is_fetched(html: str) -> None:
    without_namespace = html.replace('"http://www.w3.org/2000/svg"', "")
    for outside in ("http:", "https:", "src=", "<link", "@import", "url(h"):
        assert outside not in without_namespace
    assert re.findall(r'href="(?!#)', html) == []


def test_every_cell_of_the_table_is_there(html: str) -> None:
    design = sampled_design()
    text = text_of(html)
    for row in table_rows("m"):
        cells = " ".join(row.text(measures) for measures in design.measures)
        assert re.search(re.escape(f"{row.label} {row.unit}".strip()) + r"\s+" + re.escape(cells), text), (
            row.label
        )


def test_specifications_with_their_readings(html: str) -> None:
    text = text_of(html)
    design = sampled_design()
    for reading in design.weight.readings:
        assert reading.quantity in text
        assert reading.reading in text
        assert f"{reading.value:.4g}" in text
    assert "crossover of Gs" in text
    assert ", of GK" in text
    assert "✗" not in text


def test_a_missed_specification_is_crossed() -> None:
    design = sampled_design()
    missed = tuple(replace(reading, met=False) for reading in design.designed_readings)
    html = report_of(replace(design, designed_readings=missed))
    assert text_of(html).count("✗") == 3, "overshoot, settling and error; gain and crossover are asked of Gs"
    assert "the designed loop misses what is specified:" in html


def test_guarantees_of_further_plants(html: str) -> None:
    text = text_of(html)
    heavier, reversed_plant = sampled_design().guarantees
    assert heavier.guaranteed
    assert heavier.eps_there > 0.0
    assert (
        f"heavier {heavier.gap:.4f} {heavier.eps:.4f} stable: ε exceeds the ν-gap {heavier.eps_there:.4f}"
        in text
    )
    assert (reversed_plant.gap, reversed_plant.eps_there) == (1.0, 0.0)
    assert "reversed 1.0000" in text
    assert "not by ε alone unstable" in text
    assert "plant reversed is unstable under this controller" in text


def test_without_further_plants_it_says_what_is_guaranteed() -> None:
    design = continuous_design()
    assert f"below ε = {design.eps:.4f}" in text_of(report_of(design))


def test_fig_5_or_why_it_is_absent(html: str) -> None:
    assert "Fig. 5 compares the model with a measured record, and none was given" in text_of(html)
    t = np.arange(50) * 0.1
    with_record = text_of(report_of(sampled_design(), ModelFit("r.csv", t, t, np.cos(t), np.cos(t) + 0.01)))
    assert "none was given" not in with_record
    assert "Fig. 5. Measured output" in with_record


def test_figures_in_order_and_well_formed(html: str) -> None:
    found = re.findall(r"Fig\. (\d+(?: \([abc]\))?)\. ", text_of(html))
    assert found == ["6", "7", "8", "9", "10", "11 (a)", "11 (b)", "11 (c)"]
    for svg in re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL):
        ET.fromstring(svg)
    ids = re.findall(r' id="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    for reference in re.findall(r"url\(#([^)]+)\)", html):
        assert reference in ids


def test_provenance(html: str) -> None:
    text = text_of(html)
    for stated in ("seed 1", "numpy", "python", '"kp": ', '"delay_samples": 1'):
        assert stated in text
    for candidate in sampled_design().candidates:
        assert candidate.method in text


def test_names_are_escaped() -> None:
    design = sampled_design()
    nasty = msgspec.structs.replace(design.plant, name="<script>x</script>", description="<i>&")
    html = report_of(replace(design, plant=nasty), title="<script>x</script>")
    assert "<script>x" not in html
    assert "<i>&" not in html


def test_unstable_baselines_are_told_and_not_drawn() -> None:
    design = sampled_design()
    unstable = tuple(
        replace(m, stable=c.name not in ("ZN", "TLC"))
        for c, m in zip(design.candidates, design.measures, strict=True)
    )
    html = report_of(replace(design, measures=unstable))
    assert text_of(html).count("unstable") >= 2 * (len(table_rows("m")) - 2)
    assert "Fig. 9." not in html


def test_low_margin_warns() -> None:
    design = sampled_design()
    first = replace(design.measures[0], eps_sampled=0.2)
    assert any(
        "0.200 is under 0.25" in w for w in warnings(replace(design, measures=(first, *design.measures[1:])))
    )
    weak = replace(design, weight=replace(design.weight, eps_opt=0.2))
    assert any("ε_opt 0.200 is under 0.25" in w for w in warnings(weak))


def test_infinities_and_instability_are_written_as_such() -> None:
    rows = {row.label: row for row in table_rows("m")}
    m = replace(sampled_design().measures[0], gain_margin=np.inf, settling_s=np.inf)
    assert rows["gain margin"].text(m) == rows["2 % settling"].text(m) == "∞"
    unstable: Measures = replace(m, stable=False)
    assert rows["overshoot"].text(unstable) == "unstable"


def test_formulas() -> None:
    text = mathml(TransferFunction(np.array([-1.0, 0.0, 2.5]), np.array([1.0, 1.0, 0.0])), "G s")
    ET.fromstring(text)
    plain = re.sub(r"<[^>]+>", "", text.replace("</msup>", " "))
    assert plain == "Gs(s)=−s2 +2.5s2 +s"


def test_paper_section_lists_every_verdict() -> None:
    design, verdicts = reproduction().design, reproduction().verdicts
    text = text_of(render(design, design_figures(design), title="t", verdicts=verdicts))
    for verdict in verdicts:
        assert re.sub(r"\s+", " ", f"{verdict.where} {verdict.what} {verdict.printed} {verdict.ours}") in text
    agreeing = sum(v.agrees for v in verdicts)
    assert f"{agreeing} of {len(verdicts)} printed figures" in text


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


def test_what_may_vanish_is_not_drawn_out_and_a_margin_of_0_is_unstable() -> None:
    assert number_text(3e-9, 1, vanishing=True) == "0.0"
    assert (eps_text(0.0), eps_text(0.57239), eps_text(2e-5)) == ("unstable", "0.5724", "2e-05")
