"""The paper's figures: the computed values, and that a claim fails if a figure is wrong.

The expected values were measured independently of this package.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.designs import reproduction

from design.models.transfer_function import TransferFunction
from design.paper import printed
from design.paper.checked_claim import CheckedClaim
from design.paper.claims import check_claims
from design.paper.evidence import Evidence
from design.paper.searches import Runs
from design.synthesis.recommendation import recommend


def claim(what: str, claims: tuple[CheckedClaim, ...] | None = None) -> CheckedClaim:
    (found,) = (c for c in (claims or reproduction().claims) if c.what == what)
    return found


def computed(what: str) -> float:
    return float(claim(what).computed.split()[0])


def test_everything_that_must_agree_agrees() -> None:
    assert [c for c in reproduction().claims if c.has_failed] == []
    assert reproduction().failed == 0
    assert reproduction().agreeing + reproduction().explained == len(reproduction().claims) == 41


def test_only_the_known_figures_differ() -> None:
    """The misprint of eq. (17), two searches that ended below the optimum, a lucky run, a settling time."""
    in_two_figures = "the paper's search is better than chance"
    differing = [c for c in reproduction().claims if not c.agrees]
    assert {(c.where, c.what) if c.what == in_two_figures else c.what for c in differing} == {
        "ε_opt with the damping term 16.67 of eq. (17)",
        "largest ε_opt that meets them",
        "ε_opt that the paper's search has found by the 12th generation",
        ("Fig. 6", "the paper's search is better than chance"),
        "largest ε of a PID in the paper's search range",
        "ε that the paper's search typically finds",
        "2 % settling of PPID",
    }


@pytest.mark.parametrize(
    ("what", "value", "tolerance"),
    [
        ("ε_opt of W1 (16), Appendix A", 0.601487, 1e-6),
        ("ε_opt with the damping term 16.67 of eq. (17)", 0.60209, 5e-6),
        ("crossover of the shaped plant", 4.070, 0.005),
        ("largest ε_opt that meets them", 0.60358, 2e-5),
        ("ε of PPID (20), eq. (13)", 0.54774, 5e-6),
        ("largest ε of a PID in the paper's search range", 0.586156, 1e-5),
        ("overshoot of ZN", 46.1, 0.05),
        ("overshoot of TLC", 9.6, 0.05),
        ("overshoot of PPID", 1.17, 0.01),
        ("overshoot of HLS", 0.2, 0.05),
        ("2 % settling of PPID", 0.880, 0.002),
        ("2 % settling of HLS", 1.06, 0.005),
        ("largest gain from input disturbance", 0.0796, 5e-5),
        ("zero of the identified model", 90.759, 0.001),
    ],
)
def test_computed_values(what: str, value: float, tolerance: float) -> None:
    assert computed(what) == pytest.approx(value, abs=tolerance)


def test_margins_of_the_comparison() -> None:
    """Each in the continuous loop, and in the sampled loop with one sample of delay."""
    design = reproduction().design
    found = {
        c.name: (m.eps_continuous, m.eps_sampled)
        for c, m in zip(design.candidates, design.measures, strict=True)
    }
    assert found["PPID (20)"] == pytest.approx((0.5477, 0.5146), abs=5e-5)
    assert found["HLS (18)"] == pytest.approx((0.5524, 0.5314), abs=5e-5)
    assert found["PID optimum"] == pytest.approx((0.5862, 0.5535), abs=1e-4)
    assert found["PI"][0] == pytest.approx(0.56719, abs=5e-5)


def test_gain_of_the_shaped_plant() -> None:
    (gain,) = [r for r in reproduction().design.weight.readings if r.quantity == "gain_db"]
    assert gain.value == pytest.approx(20.24, abs=0.005)


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("EPS_OPT", 0.61, "ε_opt of W1 (16), Appendix A"),
        ("HLS_EPS", 0.5, "ε of the conventional controller"),
        ("PPID_EPS", 0.56, "ε of PPID (20), eq. (13)"),
    ],
)
def test_a_printed_figure_that_differs_is_not_reproduced(
    name: str, value: float, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(printed, name, value)
    changed = claim(what, check_claims(reproduction().evidence))
    assert changed.has_failed
    assert changed.result == "DOES NOT REPRODUCE"


def test_a_wrong_coefficient_of_18_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    num = printed.HLS.num * np.array([1.0, 1.0, 1.001, 1.0, 1.0])
    monkeypatch.setattr(printed, "HLS", TransferFunction(num, printed.HLS.den))
    failed = [c.what for c in check_claims(reproduction().evidence) if c.has_failed]
    assert failed == ["numerator, s²"]


def test_a_wrong_measure_fails_its_claim() -> None:
    evidence = reproduction().evidence
    for name, field, what in (
        ("ZN", "overshoot", "overshoot of ZN"),
        ("TLC", "overshoot", "overshoot of TLC"),
        ("PPID (20)", "overshoot", "overshoot of PPID"),
        ("PPID (20)", "eps_continuous", "ε of PPID (20), eq. (13)"),
        ("PPID (20)", "disturbance_peak", "largest gain from input disturbance"),
        ("HLS (18)", "settling_s", "2 % settling of HLS"),
        ("HLS (18)", "error", "no steady-state error"),
    ):
        wrong = replace(
            evidence.measures[name], **{field: getattr(evidence.measures[name], field) * 2.0 + 0.001}
        )
        changed: Evidence = replace(evidence, measures={**evidence.measures, name: wrong})
        assert claim(what, check_claims(changed)).has_failed, (name, field)


def test_an_optimum_that_agreed_would_be_called_reproduced() -> None:
    evidence = reproduction().evidence
    changed = replace(evidence, optimum=replace(evidence.optimum, eps=printed.PPID_EPS))
    assert (
        claim("largest ε of a PID in the paper's search range", check_claims(changed)).result == "reproduced"
    )


def claims_with(**runs: Runs) -> tuple[CheckedClaim, ...]:
    evidence = reproduction().evidence
    return check_claims(replace(evidence, searches=replace(evidence.searches, **runs)))


def claim_at(where: str, what: str, claims: tuple[CheckedClaim, ...]) -> CheckedClaim:
    (found,) = (c for c in claims if (c.where, c.what) == (where, what))
    return found


def test_the_claims_on_the_papers_search_depend_on_what_it_finds() -> None:
    """Tried with a search that finds nothing, one that reaches the printed figures, and random search."""
    searches = reproduction().evidence.searches
    nothing = claims_with(
        genetic_weights=Runs(np.zeros((20, 20))), genetic_controllers=Runs(np.full((20, 30), 0.5))
    )
    assert claim_at("Fig. 8", "the paper's search reaches the margin of PPID (20)", nothing).has_failed
    for what in (
        "ε_opt that the paper's search has found by the 12th generation",
        "the paper's search is better than chance",
    ):
        assert not claim_at("Fig. 6", what, nothing).agrees
    assert (
        "no weight at all: 20 seeds"
        in claim("ε_opt that the paper's search has found by the 12th generation", nothing).explanation
    )
    as_printed = claims_with(
        genetic_weights=Runs(np.full((20, 20), 0.6015)), genetic_controllers=Runs(np.full((20, 30), 0.548))
    )
    assert claim("ε_opt that the paper's search has found by the 12th generation", as_printed).agrees
    assert claim("ε that the paper's search typically finds", as_printed).agrees
    assert (
        "lucky"
        not in claim("ε_opt that the paper's search has found by the 12th generation", as_printed).explanation
    )
    late = np.full((20, 20), 0.6015)
    late[:, :12] = 0.4
    assert not claim(
        "ε_opt that the paper's search has found by the 12th generation",
        claims_with(genetic_weights=Runs(late)),
    ).agrees
    chance = claims_with(genetic_controllers=searches.random_controllers)
    assert not claim_at("Fig. 8", "the paper's search is better than chance", chance).agrees


def test_the_report_shows_the_median_run() -> None:
    evidence, design = reproduction().evidence, reproduction().design
    eps = np.sort(evidence.searches.genetic_controllers.after(-1))
    assert design.synthesis.eps == pytest.approx(eps[10])
    assert design.synthesis.search.searcher == "genetic algorithm"
    assert recommend(design).hints == (), "the hints are on the printed controllers, not on the median run"


def test_statistics_of_runs() -> None:
    runs = Runs(np.array([[0.0, 0.3, 0.5], [0.2, 0.2, 0.4]]))
    assert runs.after(2).tolist() == [0.3, 0.2]
    assert runs.after(-1).tolist() == [0.5, 0.4]
    assert (runs.number_reaching(0.25, 2), runs.number_reaching(0.25), runs.number_reaching(0.6)) == (1, 2, 0)
    assert runs.share_above(Runs(np.array([[0.45], [0.1]]))) == 0.75
    assert runs.share_above(runs) == 0.25
