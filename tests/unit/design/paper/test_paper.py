"""The paper's figures: our values against paper-facts measured independently, and verdicts that can fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.designs import reproduction

from design.models.transfer_function import TransferFunction
from design.output.advice import hints
from design.paper import claims as paper_claims
from design.paper.claims import Evidence, judge
from design.paper.searches import Runs
from design.paper.verdicts import Verdict


def verdict(what: str, verdicts: tuple[Verdict, ...] | None = None) -> Verdict:
    found = [v for v in (verdicts or reproduction().verdicts) if v.what == what]
    assert len(found) == 1, what
    return found[0]


def ours(what: str) -> float:
    return float(verdict(what).ours.split()[0])


def test_everything_that_should_reproduce_does() -> None:
    assert [v for v in reproduction().verdicts if v.failed] == []


def test_what_differs_is_what_is_known_to() -> None:
    """The misprint of eq. (17), two searches that stopped short, a lucky run, and PPID's settling time."""
    ambiguous = "its search is better than chance"
    differing = [v for v in reproduction().verdicts if not v.agrees]
    assert {(v.where, v.what) if v.what == ambiguous else v.what for v in differing} == {
        "ε_opt with the damping term 16.67 of eq. (17)",
        "largest ε_opt that meets them",
        "ε_opt that its search has found by the 12th generation",
        ("Fig. 6", "its search is better than chance"),
        "largest ε of a PID in the paper's box",
        "ε that its search typically finds",
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
        ("largest ε of a PID in the paper's box", 0.586156, 1e-5),
        ("overshoot of ZN", 46.1, 0.05),
        ("overshoot of TLC", 9.6, 0.05),
        ("overshoot of PPID", 1.17, 0.01),
        ("overshoot of HLS", 0.2, 0.05),
        ("2 % settling of PPID", 0.880, 0.002),
        ("2 % settling of HLS", 1.06, 0.005),
        ("largest gain from input disturbance", 0.0796, 5e-5),
        ("its zero", 90.759, 0.001),
    ],
)
def test_values(what: str, value: float, tolerance: float) -> None:
    assert ours(what) == pytest.approx(value, abs=tolerance)


def test_eps_of_the_table() -> None:
    """Continuous, and sampled with one sample of delay."""
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
def test_a_printed_figure_that_is_not_ours_is_not_reproduced(
    name: str, value: float, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paper_claims, name, value)
    changed = verdict(what, judge(reproduction().evidence))
    assert changed.failed
    assert changed.text == "DOES NOT REPRODUCE"


def test_a_wrong_coefficient_of_18_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    num = paper_claims.HLS.num * np.array([1.0, 1.0, 1.001, 1.0, 1.0])
    monkeypatch.setattr(paper_claims, "HLS", TransferFunction(num, paper_claims.HLS.den))
    failed = [v.what for v in judge(reproduction().evidence) if v.failed]
    assert failed == ["numerator, s²"]


def test_wrong_measures_fail_their_verdicts() -> None:
    """Each reading of a candidate, made wrong, is noticed by at least one verdict."""
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
        assert verdict(what, judge(changed)).failed, (name, field)


def test_an_optimum_that_agreed_would_be_called_reproduced() -> None:
    evidence = reproduction().evidence
    changed = replace(evidence, optimum=replace(evidence.optimum, eps=paper_claims.PPID_EPS))
    assert verdict("largest ε of a PID in the paper's box", judge(changed)).text == "reproduced"


def judged_with(**runs: Runs) -> tuple[Verdict, ...]:
    evidence = reproduction().evidence
    return judge(replace(evidence, searches=replace(evidence.searches, **runs)))


def of(where: str, what: str, verdicts: tuple[Verdict, ...]) -> Verdict:
    (found,) = (v for v in verdicts if (v.where, v.what) == (where, what))
    return found


def test_the_verdicts_on_the_papers_search_depend_on_what_it_finds() -> None:
    """A search that found nothing, one as good as the paper's figures, and chance itself."""
    searches = reproduction().evidence.searches
    nothing = judged_with(
        genetic_weights=Runs(np.zeros((20, 20))), genetic_controllers=Runs(np.full((20, 30), 0.5))
    )
    assert of("Fig. 8", "its search comes to the margin of PPID (20)", nothing).failed
    for what in (
        "ε_opt that its search has found by the 12th generation",
        "its search is better than chance",
    ):
        assert not of("Fig. 6", what, nothing).agrees
    assert (
        "no weight at all on 20"
        in verdict("ε_opt that its search has found by the 12th generation", nothing).why
    )
    as_printed = judged_with(
        genetic_weights=Runs(np.full((20, 20), 0.6015)), genetic_controllers=Runs(np.full((20, 30), 0.548))
    )
    assert verdict("ε_opt that its search has found by the 12th generation", as_printed).agrees
    assert verdict("ε that its search typically finds", as_printed).agrees
    assert "lucky" not in verdict("ε_opt that its search has found by the 12th generation", as_printed).why
    late = np.full((20, 20), 0.6015)
    late[:, :12] = 0.4
    assert not verdict(
        "ε_opt that its search has found by the 12th generation", judged_with(genetic_weights=Runs(late))
    ).agrees
    chance = judged_with(genetic_controllers=searches.random_controllers)
    assert not of("Fig. 8", "its search is better than chance", chance).agrees


def test_the_report_shows_the_median_run() -> None:
    evidence, design = reproduction().evidence, reproduction().design
    eps = np.sort(evidence.searches.genetic_controllers.after(-1))
    assert design.synthesis.eps == pytest.approx(eps[10])
    assert design.synthesis.search.searcher == "genetic algorithm"
    assert hints(design) == [], "of the printed weight and controllers, not of that run's"


def test_runs() -> None:
    runs = Runs(np.array([[0.0, 0.3, 0.5], [0.2, 0.2, 0.4]]))
    assert runs.after(2).tolist() == [0.3, 0.2]
    assert runs.after(-1).tolist() == [0.5, 0.4]
    assert (runs.reaching(0.25, 2), runs.reaching(0.25), runs.reaching(0.6)) == (1, 2, 0)
    assert runs.beats(Runs(np.array([[0.45], [0.1]]))) == 0.75
    assert runs.beats(runs) == 0.25
