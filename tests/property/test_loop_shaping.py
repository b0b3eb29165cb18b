"""Loop shaping over random plants: orders 1 to 8, unstable, integrating, non-minimum phase, biproper."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.random_systems import System, patient, systems

from design.models.realisation import realise, transfer_function
from design.models.sampling import zero_order_hold
from design.models.transfer_function import TransferFunction
from design.robustness import loop_shaping
from design.robustness.central_controller import central_controllers, optimal_margins
from design.robustness.margins import margin_and_frequency, stability_margin

WELL_BEHAVED = {"min_damping": 0.05}


def distinct(G: System) -> bool:
    """Return True if no zero cancels a pole, so that the realisation is minimal."""
    H = G.polynomials
    zeros, poles = np.roots(H.num), np.roots(H.den)
    if not len(zeros):
        return True
    return bool(np.abs(zeros[:, None] / (poles[None, :] + 1e-12) - 1.0).min() > 0.02)


@settings(patient, max_examples=65)
@given(systems(**WELL_BEHAVED), st.floats(1.001, 2.0))
def test_the_margin_is_never_below_that_of_the_chosen_gamma(G: System, factor: float) -> None:
    assume(distinct(G))
    Gs = G.polynomials
    K, optimum = central_controllers(Gs, factor)
    assume(optimum[0] > 1e-4)
    margin = stability_margin(Gs, K)[0]
    assert optimum[0] / factor * (1.0 - 1e-6) <= margin <= optimum[0] * (1.0 + 1e-6)


@settings(patient, max_examples=65)
@given(systems(), systems(min_order=0, max_order=4))
def test_no_controller_has_more_than_the_optimal_margin(G: System, K: System) -> None:
    assume(distinct(G))
    margin = stability_margin(G.polynomials, K.polynomials)[0]
    assert margin <= optimal_margins(G.polynomials)[0] * (1.0 + 1e-7)


@settings(patient, max_examples=25)
@given(systems(**WELL_BEHAVED))
def test_the_optimal_margin_is_approached(G: System) -> None:
    assume(distinct(G))
    K, optimum = central_controllers(G.polynomials, 1.0 + 1e-5)
    assume(optimum[0] > 1e-3)
    assert stability_margin(G.polynomials, K)[0] == pytest.approx(optimum[0], rel=2e-5)


@settings(patient, max_examples=45)
@given(systems(max_order=5, min_damping=0.1))
def test_interpolation_agrees_with_the_riccati_equations(G: System) -> None:
    assume(distinct(G))
    Gs = G.polynomials
    K, optimum = central_controllers(Gs)
    assume(optimum[0] > 0.01)
    synthesis = loop_shaping.synthesise(Gs)
    assert 1.0 / synthesis.gamma_opt == pytest.approx(optimum[0], rel=1e-6)
    by_riccati = transfer_function(synthesis.controller)
    omega = np.geomspace(0.01, 100.0, 20)
    ours, theirs = (
        np.polyval(np.ravel(H.num), 1j * omega) / np.polyval(np.ravel(H.den), 1j * omega)
        for H in (K, by_riccati)
    )
    chordal = np.abs(ours - theirs) / np.sqrt((1.0 + np.abs(ours) ** 2) * (1.0 + np.abs(theirs) ** 2))
    assert chordal.max() < 1e-4


@settings(patient, max_examples=25)
@given(systems(max_order=6, min_damping=0.05), st.floats(0.05, 20.0))
def test_coprime_factors_are_normalised_stable_and_make_the_plant(G: System, omega: float) -> None:
    assume(distinct(G))
    factors = loop_shaping.normalised_left_coprime_factors(realise(G.polynomials))
    assert np.linalg.eigvals(factors.A).real.max() < 0.0
    resolvent = np.linalg.solve(1j * omega * np.eye(len(factors.A)) - factors.A, factors.B)
    N, M = (factors.C @ resolvent + factors.D)[0]
    assert abs(N) ** 2 + abs(M) ** 2 == pytest.approx(1.0, abs=1e-6)
    assert abs(N - M * G.at(1j * omega)) < 1e-5


@settings(patient, max_examples=25)
@given(systems(max_order=5, min_damping=0.05), st.integers(1, 3))
def test_sampled_synthesis_reaches_its_margin(G: System, delay_samples: int) -> None:
    """A delay puts poles of the plant at the mirror images of its zeros."""
    assume(distinct(G))
    plane = zero_order_hold(G.polynomials, 0.01, delay_samples * 0.01)
    K, optimum = central_controllers(plane)
    assume(optimum[0] > 1e-3)
    assert stability_margin(plane, K)[0] >= optimum[0] / 1.1 * (1.0 - 1e-6)


@settings(patient, max_examples=25)
@given(systems(max_order=5, min_damping=0.05), systems(min_order=0, max_order=2))
def test_sampled_margins_become_the_continuous_ones(G: System, K: System) -> None:
    margin, omega = (value[0] for value in margin_and_frequency(G.polynomials, K.polynomials))
    assume(margin > 0.01 and (omega < 100.0 or not np.isfinite(omega)))
    assume(len(G.polynomials.num) < len(G.polynomials.den))
    errors = []
    for period_s in (1e-4, 1e-5, 1e-6):
        plane = zero_order_hold(G.polynomials, period_s)
        errors.append(abs(stability_margin(plane, K.polynomials)[0] - margin))
    # The hold is half a period of delay: the error goes with the period.
    assert errors[2] <= errors[0] / 30.0 + 1e-7


def test_a_plant_of_order_zero_and_known_optima() -> None:
    def optimum(num: list[float], den: list[float]) -> float:
        return float(optimal_margins(TransferFunction(np.array(num), np.array(den)))[0])

    assert optimum([2.0], [1.0]) == pytest.approx(1.0)
    assert optimum([1.0], [1.0, 0.0]) == pytest.approx(np.sqrt(0.5), rel=1e-12)
    assert optimum([-1.0, 1.0], [1.0, 1.0]) == pytest.approx(np.sqrt(0.5), rel=1e-12)
    # A hidden unstable mode cannot be stabilised, a hidden stable one does not matter.
    assert optimum([1.0, -1.0], [1.0, 1.0, -2.0]) < 1e-9
    assert optimum([1.0, 1.0], [1.0, 1.0, 0.0]) == pytest.approx(np.sqrt(0.5), rel=1e-12)
    assert optimum([1.0], [1.0, 0.0, 0.0]) == pytest.approx(np.sin(np.pi / 8.0), rel=1e-12)
