"""The figures: curves read back off the drawings, compared with python-control's for the same loops."""

from __future__ import annotations

from dataclasses import replace

import control
import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray
from support.designs import PERIOD_S, continuous_design, sampled_design
from support.drawn_curves import drawn_curves

from design.closed_loop.comparison import Candidate
from design.closed_loop.specifications import Specification
from design.models.measured_record import ModelFit
from design.models.plant import paper_plant
from design.output.figure_set import PAPER_NUMBERS, design_figures
from design.output.figures import Figure, candidate_styles, step_responses
from design.synthesis.procedure import Design

Values = NDArray[np.float64]


def figures_of(design: Design) -> dict[str, Figure]:
    return {figure.key: figure for figure in design_figures(design)}


def curve(figure: Figure, panel: int, label: str) -> tuple[Values, Values]:
    (run,) = drawn_curves(figure.svg)[panel][label]
    return run[:, 0], run[:, 1]


def continuous_loop(candidate: Candidate) -> tuple[control.TransferFunction, control.TransferFunction]:
    plant = paper_plant()
    K = candidate.controller
    return control.tf(plant.num, plant.den), control.tf(K.num.ravel(), K.den.ravel())


def sampled_loop(candidate: Candidate) -> tuple[control.StateSpace, control.StateSpace]:
    """Return python-control's plant with hold and one sample of delay, and controller by Tustin's rule."""
    G, K = (control.ss(H) for H in continuous_loop(candidate))
    delay = control.ss(control.tf([1.0], [1.0, 0.0], PERIOD_S))
    return control.sample_system(G, PERIOD_S, "zoh") * delay, control.sample_system(K, PERIOD_S, "bilinear")


LOOPS = {"continuous": (continuous_design, continuous_loop), "sampled": (sampled_design, sampled_loop)}


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("key", ["tuning-rules", "step-responses"])
def test_step_responses_are_those_of_python_control(loop: str, key: str) -> None:
    make_design, build = LOOPS[loop]
    design = make_design()
    figure = figures_of(design)[key]
    drawn = drawn_curves(figure.svg)[0]
    expected_names = {"tuning-rules": {"ZN", "TLC"}, "step-responses": {"PID (designed)", "HLS", "PI"}}[key]
    assert set(drawn) == expected_names
    for candidate in design.candidates:
        if candidate.name not in expected_names:
            continue
        G, K = build(candidate)
        t, y = curve(figure, 0, candidate.name)
        closed = control.feedback(G * K)
        if loop == "sampled":
            expected = control.step_response(closed, np.arange(len(t)) * PERIOD_S).outputs
        else:
            fine = np.linspace(0.0, t[-1], 2001)
            expected = np.interp(t, fine, control.step_response(closed, fine).outputs)
        np.testing.assert_allclose(y, expected, atol=0.004)


def test_the_manipulated_variable_of_a_sampled_loop_is_held() -> None:
    figure = figures_of(sampled_design())["step-responses"]
    t, u = curve(figure, 1, "PID (designed)")
    G, K = sampled_loop(sampled_design().designed)
    expected = control.step_response(control.feedback(K, G), np.arange(0.0, 1.0, PERIOD_S)).outputs
    held = np.floor(t / PERIOD_S + 0.5)
    rising = (np.diff(t, prepend=-1.0) > 0.5 * PERIOD_S) & (t < 0.9)
    # At the end of each horizontal piece the value is still that of the period before.
    np.testing.assert_allclose(u[rising][1:], expected[held[rising][1:].astype(int) - 1], atol=0.15)


@pytest.mark.parametrize("loop", LOOPS)
def test_bode_diagram_is_that_of_python_control(loop: str) -> None:
    make_design, build = LOOPS[loop]
    design = make_design()
    figure = figures_of(design)["open-loops"]
    assert set(drawn_curves(figure.svg)[0]) == {"plant G", "shaped plant Gs", "G·PID (designed)", "G·HLS"}
    for candidate in design.candidates[:2]:
        G, K = build(candidate)
        omega, magnitude_db = curve(figure, 0, f"G·{candidate.name}")
        seen = (omega > 0.02) & (omega < 0.8 * omega[-1])
        response = control.frequency_response(G * K, omega[seen])
        np.testing.assert_allclose(
            magnitude_db[seen], 20.0 * np.log10(response.magnitude), atol=0.6, err_msg=candidate.name
        )
        omega, phase = curve(figure, 1, f"G·{candidate.name}")
        seen = (omega > 0.02) & (omega < 30.0)
        expected = np.degrees(np.unwrap(control.frequency_response(G * K, omega[seen]).phase))
        expected += 360.0 * np.round((phase[seen][0] - expected[0]) / 360.0)
        np.testing.assert_allclose(phase[seen], expected, atol=3.0)


@pytest.mark.parametrize("loop", LOOPS)
def test_robustness_gains_are_those_of_python_control(loop: str) -> None:
    """1/|T|, 1/|KS| and |GS|."""
    make_design, build = LOOPS[loop]
    design = make_design()
    figures = figures_of(design)
    for candidate in design.candidates:
        G, K = build(candidate)
        kinds = {
            "multiplicative-perturbation": lambda w, G=G, K=K: 1.0 / control.feedback(G * K)(w),
            "additive-perturbation": lambda w, G=G, K=K: 1.0 / control.feedback(K, G)(w),
            "disturbance-gain": lambda w, G=G, K=K: control.feedback(G, K)(w),
        }
        for key, value in kinds.items():
            omega, drawn = curve(figures[key], 0, candidate.name)
            some = slice(5, -40, 10)
            at = 1j * omega[some] if loop == "continuous" else np.exp(1j * omega[some] * PERIOD_S)
            np.testing.assert_allclose(drawn[some], np.abs(value(at)), rtol=0.08, err_msg=key)


@pytest.mark.parametrize("key", ["weight-convergence", "controller-convergence"])
def test_convergence_is_that_of_the_search(key: str) -> None:
    design = sampled_design()
    search = design.weight.search if "weight" in key else design.synthesis.search
    figure = figures_of(design)[key]
    generation, best = curve(figure, 0, search.searcher)
    assert (np.diff(best) >= -1e-3).all()
    assert generation[-1] == pytest.approx(len(search.convergence), abs=0.2)
    assert best[-1] == pytest.approx(search.best_fitness, abs=1e-3)
    assert f"{search.best_fitness:.5f}" in figure.caption
    assert f"{search.evaluations} candidates in all" in figure.caption
    feasible = sum(p.best_fitness > 0.0 for p in search.convergence)
    assert len(generation) == 2 * feasible - 1


def test_the_record_and_the_model_are_drawn() -> None:
    t = np.arange(50) * 0.1
    fit = ModelFit("r.csv", t, np.sign(np.sin(t)), np.cos(t), np.cos(t) + 0.1)
    figure = design_figures(sampled_design(), fit)[0]
    assert figure.key == "identification"
    assert f"{fit.fit_percent:.2f} %" in figure.caption
    np.testing.assert_allclose(curve(figure, 0, "measured")[1], fit.measured, atol=0.006)
    np.testing.assert_allclose(curve(figure, 0, "model")[1], fit.model, atol=0.006)


def test_without_a_record_there_is_no_identification_figure() -> None:
    assert "identification" not in figures_of(sampled_design())


def test_the_time_axis_suits_the_fast_loops() -> None:
    """A loop that is much slower than the others, or a limit far beyond all loops, does not compress them."""
    design = sampled_design()
    pairs = list(zip(design.candidates, design.measures, strict=True))[:2]

    def drawn_time_s(settling_s: float, other_s: float, limit_s: float) -> tuple[float, bool]:
        chosen = [
            (candidate, replace(measures, settling_s=value))
            for (candidate, measures), value in zip(pairs, (settling_s, other_s), strict=True)
        ]
        specifications = [Specification("settling_s", limit_s)]
        figure = step_responses(
            "k", "t", "c", design.problem, chosen, candidate_styles(design.candidates), specifications
        )
        return float(curve(figure, 0, design.designed.name)[0][-1]), "settled by" in figure.svg

    assert drawn_time_s(1.1, 1.2, 1.2) == (pytest.approx(2.4, abs=0.02), True)
    assert drawn_time_s(1.0, 4000.0, 1.2) == (pytest.approx(8.0, abs=0.02), True)
    assert drawn_time_s(1.0, 1.0, 4000.0) == (pytest.approx(2.0, abs=0.02), False)
    assert drawn_time_s(np.inf, np.inf, 1.0) == (pytest.approx(6.0, abs=0.02), True)


def test_only_the_papers_plant_has_the_papers_figure_numbers() -> None:
    """The coefficients decide, not the plant's name."""
    numbers = list(PAPER_NUMBERS.values())[1:]
    for figure, number in zip(design_figures(sampled_design()), numbers, strict=True):
        assert figure.title.startswith(f"{number}. ")
    design = sampled_design()
    changed = msgspec.structs.replace(design.plant, num=[0.48, *design.plant.num[1:]])
    for figure in design_figures(replace(design, plant=changed)):
        assert "Fig." not in figure.title + figure.caption + figure.svg
        assert figure.key in PAPER_NUMBERS
