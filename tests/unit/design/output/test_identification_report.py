"""The report of an identification: complete, in words, and without a reference to anything outside."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from support.drawn_curves import drawn_curves
from support.identified import doubtful, identified, with_small_correlation

from design.identification.findings import Finding, Kind, Severity
from design.identification.identify import Identification
from design.identification.models.structures import OutputError
from design.identification.order_search import OrderTable, Row, search_orders
from design.identified_plant import identified_plant
from design.models.plant import Plant
from design.output.identification_report import (
    interval_note,
    render_identification,
    write_identification_report,
)

STRUCTURES = ("OE(2,2,1)", "ARX(2,2,1)", "BJ(2,1,1,2,1)", "continuous(real=0,pairs=1,zeros=1)")
HOSTILE = '"><script>alert(1)</script>'


def plant_of(identification: Identification, name: str = "axis") -> Plant:
    conditions: dict[str, bool | int | float | str] = {"supply_kpa": 600.0, "loaded": False, "by": HOSTILE}
    return identified_plant(
        identification, name=name, output_unit="m", conditions=conditions, recording="ab" * 32
    )


def html_of(identification: Identification, table: OrderTable | None = None) -> str:
    return render_identification(identification, plant_of(identification), table)


def text_of(html: str) -> str:
    """Return the visible text, with all white space as single blanks."""
    visible = re.sub(r"<(script|style).*?</\1>", " ", html, flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]+>", " ", visible)))


def figure(html: str, key: str) -> str:
    found = re.search(rf'<figure id="{key}">.*?(<svg.*?</svg>)', html, flags=re.DOTALL)
    assert found, key
    return found[1]


def orders() -> OrderTable:
    """Return a table of two orders, and one for which there is no model."""
    estimate = identified().estimate
    validation = [comparison.experiment for comparison in identified().validation]
    table = search_orders(estimate.experiments, validation, [OutputError(1, 1, 1), OutputError(2, 2, 1)])
    return OrderTable((*table.rows, Row(OutputError(3, 9, 1), None, -np.inf, "too <few> samples")))


@pytest.mark.parametrize("structure", STRUCTURES)
def test_every_section_is_present_for_every_structure(structure: str) -> None:
    text = text_of(html_of(identified(structure)))
    sections = (
        "What was found",
        "Measured and simulated output",
        "Properties of the model",
        "Bode diagram",
        "Residuals",
        "Poles and zeros",
        "The model as formulas",
        "Experiment and provenance",
    )
    places = [text.index(section) for section in sections]
    assert places == sorted(places)
    assert "Orders compared" not in text
    assert "nan" not in re.findall(r"[a-z]+", text.lower())


def test_the_page_refers_to_nothing_outside() -> None:
    html = html_of(identified(), orders()).replace('"http://www.w3.org/2000/svg"', "")
    for outside in ("http:", "https:", "src=", "<link", "@import", "url(h"):
        assert outside not in html
    assert re.findall(r'href="(?!#)', html) == []


def test_drawings_are_well_formed_and_ids_are_unique() -> None:
    html = html_of(identified())
    for svg in re.findall(r"<svg.*?</svg>", html, flags=re.DOTALL):
        ET.fromstring(svg)
        assert "nan" not in svg
    for formula in re.findall(r"<math.*?</math>", html, flags=re.DOTALL):
        ET.fromstring(formula)
    ids = re.findall(r' id="([^"]+)"', html)
    assert len(ids) == len(set(ids))
    for reference in re.findall(r"url\(#([^)]+)\)", html):
        assert reference in ids


def test_the_verdict_states_the_fit_and_that_nothing_speaks_against_the_model() -> None:
    text = text_of(html_of(identified()))
    fit = identified().fit_percent
    assert f"The model follows data that were not fitted to {fit:.2f} %. There is no warning" in text
    assert "Nothing. The records excite the axis" in text


@pytest.mark.parametrize(
    ("structure", "reason"),
    [
        ("OE(2,2,1)", "no other delay of the model would raise the fit by more than 1 %"),
        ("ARX(2,2,1)", "Other delays were not tried for this model"),
    ],
)
def test_a_correlation_that_is_no_finding_is_explained_and_the_findings_mention_it(
    structure: str, reason: str
) -> None:
    identification = replace(with_small_correlation(structure), findings=())
    assert not identification.residuals.from_input.passed
    text = text_of(html_of(identification))
    largest = float(np.max(identification.residuals.from_input.values**2))
    assert f"explain more than {100.0 * largest:.2g} % of the residuals' variance" in text
    assert reason in text
    assert "explains them except for a correlation of the residuals with earlier inputs" in text


def test_a_correlation_that_is_a_finding_refers_to_it() -> None:
    note = Finding(Kind.NOT_EXPLAINED, Severity.NOTE, "r", "y", 0.0, 0.01, "", "it depends", "do that")
    text = text_of(html_of(replace(with_small_correlation(), findings=(note,))))
    assert "the model lacks dynamics that the record shows; see the finding." in text


def test_without_a_correlation_the_findings_mention_none() -> None:
    assert identified().residuals.from_input.passed
    assert "and the model explains them." in text_of(html_of(identified()))


def test_every_finding_is_shown_with_signal_figure_and_remedy_warnings_first() -> None:
    note = Finding(Kind.RESOLUTION, Severity.NOTE, "r", "y", np.nan, np.inf, "m", "it is <coarse>", "do that")
    identification = replace(doubtful(), findings=(*doubtful().findings, note))
    text = text_of(html_of(identification))
    count = len(identification.warnings)
    assert count >= 2
    assert f"However, {count} warnings make it doubtful" in text
    places = []
    for finding in identification.findings:
        for said in (finding.signal, finding.text, finding.remedy, finding.kind.value):
            assert said in text
        places.append(text.index(finding.text))
    assert places == sorted(places)
    assert "Note: resolution. In r, signal y: it is <coarse>. Figure: unknown m, compared with ∞ m." in text


def test_measured_and_simulated_output_are_those_of_the_validation_record() -> None:
    (comparison,) = identified().validation
    curves, drive = drawn_curves(figure(html_of(identified()), "validation"))
    for label, values in (("measured", comparison.experiment.y), ("simulated", comparison.simulated)):
        (curve,) = curves[label]
        np.testing.assert_allclose(curve[:, 0], comparison.experiment.time_s, atol=0.01)
        np.testing.assert_allclose(curve[:, 1], values, atol=2e-3 * float(np.ptp(values)))
    assert len(drive[""][0]) == 2 * len(comparison.experiment) - 1


def test_a_long_record_is_drawn_by_its_extremes() -> None:
    """The file stays small, and no peak is lost."""
    (comparison,) = identified().validation
    times = 30
    experiment = comparison.experiment
    long = replace(
        experiment,
        u=np.tile(experiment.u, times),
        y=np.tile(experiment.y, times),
        weights=np.tile(experiment.weights, times),
    )
    many = replace(comparison, experiment=long, simulated=np.tile(comparison.simulated, times))
    curves = drawn_curves(figure(html_of(replace(identified(), validation=(many,))), "validation"))[0]
    (curve,) = curves["measured"]
    assert len(curve) <= 3000
    assert curve[:, 1].max() == pytest.approx(experiment.y.max(), rel=0.01)
    assert curve[:, 1].min() == pytest.approx(experiment.y.min(), rel=0.01)


def test_a_gap_of_the_record_is_a_gap_of_the_curve() -> None:
    (comparison,) = identified().validation
    gap = np.zeros(len(comparison.experiment), dtype=bool)
    gap[100:120] = True
    masked = replace(comparison, experiment=comparison.experiment.masked(gap))
    html = html_of(replace(identified(), validation=(masked,)))
    assert len(drawn_curves(figure(html, "validation"))[0]["measured"]) == 2
    assert "20 of 900 samples do not count" in text_of(html)


def test_properties_are_shown_with_their_95_percent_intervals() -> None:
    text = text_of(html_of(identified()))
    known = identified().properties
    assert known.gain is not None
    (mode,) = known.modes
    for label, quantity in (
        ("static gain", known.gain),
        ("natural frequency", mode.natural_frequency_rad_s),
        ("damping ratio", mode.damping),
    ):
        low, high = quantity.interval()
        assert f"{label} {quantity.value:.4g} {low:.4g} to {high:.4g}" in text
    assert "dead time 0 fixed by the structure ms" in text
    assert re.search(r"pole pair −\S+ ± \S+ j real −", text)
    assert re.search(r" zero −\S+ −\S+ to ", text)


def test_the_limits_of_the_intervals_are_stated_for_large_orders() -> None:
    assert interval_note(3) == ""
    assert "Each holds by itself" in interval_note(4) == interval_note(5)
    assert "other sets of poles" in interval_note(6)
    assert interval_note(4) in text_of(html_of(identified("OE(1,4,1)")))


def test_the_bode_diagram_has_the_model_over_the_response_measured_without_one() -> None:
    svg = figure(html_of(identified()), "bode")
    magnitude, phase, coherence = drawn_curves(svg)
    (curve,) = magnitude["model"]
    response = np.abs(identified().discrete.at(curve[:, 0]))
    np.testing.assert_allclose(curve[:, 1], 20.0 * np.log10(response), atol=0.5)
    assert len(phase["model"]) == 1
    assert coherence["coherence"][0][:, 1].max() <= 1.01
    assert svg.count("<polygon") == 2, "the band of magnitude and of phase"
    assert svg.count("<circle") > 50


def test_a_record_that_is_too_short_for_a_measured_response_is_no_error() -> None:
    """The page says why the points are missing."""
    estimate = identified().estimate
    short = replace(estimate, experiments=tuple(e.part(0, 30) for e in estimate.experiments))
    text = text_of(html_of(replace(identified(), estimate=short)))
    assert "No response could be measured without a model" in text
    assert "coherence" not in text.replace("coherence under", "")


def test_residuals_are_drawn_within_their_bounds() -> None:
    svg = figure(html_of(identified()), "residuals")
    residuals = identified().residuals
    dots = 2 * len(residuals.whiteness.lags) + 2 * len(residuals.from_input.lags) - 1
    assert svg.count("<circle") == dots
    assert svg.count("<polygon") == 2
    assert "99 % bounds" in svg


def test_poles_and_zeros_have_confidence_regions() -> None:
    svg = figure(html_of(identified("continuous(real=0,pairs=1,zeros=1)")), "pole-zero-map")
    assert "95 % region of a pole" in svg
    assert svg.count("<polygon") >= 2


def test_a_model_without_a_continuous_counterpart_says_so() -> None:
    properties = replace(identified().properties, zeros=None)
    text = text_of(
        render_identification(replace(identified(), properties=properties), plant_of(identified()))
    )
    assert "The sampled model has no continuous counterpart, so it has no zeros in s." in text


def test_orders_are_shown_side_by_side_best_first() -> None:
    text = text_of(html_of(identified(), orders()))
    assert "Orders compared" in text
    rows = [
        text.index(f"OE({order}) ", text.index("Orders compared")) for order in ("2,2,1", "1,1,1", "3,9,1")
    ]
    assert rows == sorted(rows)
    best = orders().best()
    assert f"{best.fit_percent:.2f} {best.aic:.1f} {best.bic:.1f}".replace("-", "−") in text
    assert "no model: too <few> samples" in text
    assert "inf" not in re.findall(r"[a-z]+", text)


def test_conditions_delays_recording_and_versions_are_stated() -> None:
    text = text_of(html_of(identified()))
    for stated in (
        "condition: supply_kpa 600",
        "condition: loaded no",
        "ab" * 32,
        "contains_delay_samples 0",
        "dead_time_s 0 s",
        "numpy",
        "python",
        "structure OE(2,2,1)",
    ):
        assert stated in text


def test_noise_models_are_shown_as_formulas() -> None:
    assert "H(z)" not in re.sub(r"<[^>]+>", "", html_of(identified()))
    assert "H(z)" in re.sub(r"<[^>]+>", "", html_of(identified("BJ(2,1,1,2,1)")))


def test_hostile_names_are_escaped() -> None:
    identification = identified(name=HOSTILE)
    html = render_identification(identification, plant_of(identification, HOSTILE), orders())
    assert "<script>alert" not in html
    assert "too <few>" not in html
    assert HOSTILE in text_of(html)


def test_an_unstable_model_is_no_error() -> None:
    (comparison,) = identified().validation
    unstable = replace(comparison, fit_percent=np.nan, simulated=np.full(len(comparison.simulated), np.nan))
    text = text_of(html_of(replace(identified(), validation=(unstable,))))
    assert "The model is unstable, so it cannot be simulated freely." in text
    assert "nan" not in re.findall(r"[a-z]+", text.lower())


def test_the_page_is_written_as_utf_8(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_identification_report(identified(), plant_of(identified()), path)
    assert path.read_bytes().decode("utf-8") == html_of(identified())


def test_every_number_has_its_heading_for_narrow_screens() -> None:
    html = html_of(identified(), orders())
    for number in re.findall(r'<td class="n[^>]*>', html):
        assert re.search(r'data-label="[^"]+"', number), number
