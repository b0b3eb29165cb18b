"""The paper's figures: our values against paper-facts measured independently, and verdicts that can fail."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.designs import reproduction

from design import paper_claims
from design.paper_claims import Evidence, Verdict, judge
from design.plant import TransferFunction


def verdict(what: str, verdicts: tuple[Verdict, ...] | None = None) -> Verdict:
    found = [v for v in (verdicts or reproduction().verdicts) if v.what == what]
    assert len(found) == 1, what
    return found[0]


def ours(what: str) -> float:
    return float(verdict(what).ours.split()[0])


def test_everything_that_should_reproduce_does() -> None:
    assert [v for v in reproduction().verdicts if v.failed] == []


def test_what_differs_is_what_is_known_to() -> None:
    """The misprint of eq. (17), two searches that stopped short, and PPID's settling time."""
    assert {v.what for v in reproduction().verdicts if not v.agrees} == {
        "ε_opt with the damping term 16.67 of eq. (17)",
        "largest ε_opt that meets them",
        "largest ε of a PID in the paper's box",
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


def test_a_genetic_algorithm_that_finds_nothing_fails() -> None:
    changed = judge(replace(reproduction().evidence, genetic_weights=()))
    assert verdict("the paper's genetic algorithm finds such a weight", changed).failed
