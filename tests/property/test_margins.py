"""The stability margin of random loops, lightly damped and unstable ones too, against slycot's norm."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.random_systems import (
    System,
    margin_at,
    margin_of_sections,
    patient,
    slycot_margin,
    systems,
)

from design.mathematics import polynomials as poly
from design.models.sampling import Sampling, zero_order_hold
from design.models.transfer_function import TransferFunction
from design.robustness.margins import (
    characteristic,
    disturbance_peak,
    gain_margins,
    margin_and_frequency,
    phase_margin,
    stability_margin,
)

CLEAR_OF_THE_AXIS = 1e-6


def clear_of_the_axis(G: System, K: System) -> bool:
    """Return True unless stability is a matter of rounding."""
    closed = np.atleast_2d(characteristic(G.polynomials, K.polynomials))
    roots = poly.roots(closed)[0]
    return bool(np.all(np.abs(roots.real) > CLEAR_OF_THE_AXIS * np.maximum(np.abs(roots), 1.0)))


@settings(patient, max_examples=120)
@given(systems(), systems(min_order=0, max_order=4))
def test_the_margin_agrees_with_slycot_and_is_attained(G: System, K: System) -> None:
    assume(abs(1.0 + G.state_space[3] * K.state_space[3]) > 1e-3)
    assume(clear_of_the_axis(G, K))
    margin, omega = (value[0] for value in margin_and_frequency(G.polynomials, K.polynomials))
    reference = slycot_margin(G, K)
    assert (margin == 0.0) == (reference == 0.0)
    if margin > 0.0:
        # The loop really takes this value; a larger norm by slycot would mean that a peak was missed.
        attained = margin_of_sections(G, K, omega)
        assert margin == pytest.approx(attained, rel=1e-8)
        # slycot's error is sometimes 1e-8, and larger where its state space loses digits by cancellation.
        blur = abs(margin_at(G, K, omega) / attained - 1.0)
        assert margin <= reference * (1.0 + 5e-8 + 10.0 * blur)


@settings(patient, max_examples=40)
@given(systems(), systems(min_order=0, max_order=3), st.floats(0.5, 50.0))
def test_no_frequency_is_worse_than_the_margin(G: System, K: System, centre: float) -> None:
    margin = stability_margin(G.polynomials, K.polynomials)[0]
    assume(margin > 0.0 and clear_of_the_axis(G, K))
    omega = centre * np.geomspace(1e-3, 1e3, 4001)
    gain, control = (
        np.polyval(H.num, 1j * omega) / np.polyval(H.den, 1j * omega) for H in (G.polynomials, K.polynomials)
    )
    h = np.abs(1.0 + gain * control) / np.sqrt((1.0 + np.abs(gain) ** 2) * (1.0 + np.abs(control) ** 2))
    assert h.min() >= margin * (1.0 - 1e-9)


@settings(patient, max_examples=50)
@given(systems(max_order=4), st.lists(systems(min_order=2, max_order=2), min_size=2, max_size=6))
def test_a_batch_is_its_candidates(G: System, controllers: list[System]) -> None:
    width = 3
    num = np.stack([poly.add(K.polynomials.num, np.zeros(width)) for K in controllers])
    den = np.stack([K.polynomials.den for K in controllers])
    together = stability_margin(G.polynomials, TransferFunction(num, den))
    alone = [stability_margin(G.polynomials, K.polynomials)[0] for K in controllers]
    np.testing.assert_allclose(together, alone, rtol=1e-10, atol=1e-15)


@settings(patient, max_examples=40)
@given(
    systems(max_order=4, min_damping=0.02),
    systems(min_order=0, max_order=2),
    st.floats(0.002, 0.05),
    st.integers(0, 24),
)
def test_the_margin_of_a_sampled_loop_is_that_on_the_unit_circle(
    G: System, K: System, period_s: float, eighths: int
) -> None:
    """The delay is a multiple of an eighth of the period; the reference is scipy's hold at that rate."""
    sampling = Sampling(period_s)
    plane = zero_order_hold(G.polynomials, period_s, eighths / 8.0 * period_s)
    margin, omega = (value[0] for value in margin_and_frequency(plane, K.polynomials))
    assume(margin > 0.0)
    A, B, C, D, _ = scipy.signal.cont2discrete(G.state_space, period_s / 8.0)
    whole, fraction = divmod(eighths, 8)
    over_period = np.linalg.matrix_power(A, 8)
    inputs = [np.linalg.matrix_power(A, 7 - i) @ B for i in range(8)]
    # u[k - 1] acts in the eighths before the delay's fraction has passed, and u[k] acts afterwards.
    of_previous, of_present = (sum(part, np.zeros_like(B)) for part in (inputs[:fraction], inputs[fraction:]))

    def distance(true_omega: float) -> float:
        z = np.exp(1j * true_omega * period_s)
        state = np.linalg.solve(z * np.eye(len(A)) - over_period, of_previous / z + of_present)
        gain = (C @ state + D / (z if fraction else 1.0))[0, 0] / z**whole
        control = K.at(2.0 / period_s * (z - 1.0) / (z + 1.0))
        size = np.sqrt((1.0 + abs(gain) ** 2) * (1.0 + abs(control) ** 2))
        return float(abs(1.0 + gain * control) / size)

    for angle in np.geomspace(1e-3, 3.14, 80):
        assert distance(angle / period_s) >= margin * (1.0 - 1e-7)
    there = float(sampling.unwarp(omega))
    if 1e-3 < there * period_s < 3.14:
        assert distance(there) == pytest.approx(margin, rel=1e-7)


@settings(patient, max_examples=80)
@given(systems(max_order=5), systems(min_order=0, max_order=2))
def test_gain_and_phase_margins_bring_the_loop_to_the_axis(G: System, K: System) -> None:
    L = TransferFunction(
        np.polymul(G.polynomials.num, K.polynomials.num), np.polymul(G.polynomials.den, K.polynomials.den)
    )
    assume(clear_of_the_axis(G, K))
    below, above = (value[0] for value in gain_margins(L))
    assert below < 1.0 < above
    for factor in (below, above):
        if 0.0 < factor < np.inf:
            omega = _nearest_to_critical(L, factor)
            assert omega == pytest.approx(-1.0, abs=1e-5)
    angle = phase_margin(L)[0]
    if angle < np.pi:
        turned = _distance_after_turning(L, angle)
        assert turned == pytest.approx(0.0, abs=1e-4)


def _nearest_to_critical(L: TransferFunction, factor: float) -> complex:
    """Return the real value of factor L on the imaginary axis that is nearest to -1."""
    odd = np.polymul(L.num, _mirrored(L.den))
    parity = np.arange(len(odd))[::-1] % 2
    roots = np.roots(np.where(parity == 1, odd, 0.0))
    on_axis = [0.0, *roots[np.abs(roots.real) <= 1e-5 * np.abs(roots)].imag, 1e9]
    with np.errstate(all="ignore"):
        values = [factor * np.polyval(L.num, 1j * w) / np.polyval(L.den, 1j * w) for w in on_axis]
    finite = [value for value in values if np.isfinite(value)]
    return min(finite, key=lambda value: abs(value + 1.0))


def _distance_after_turning(L: TransferFunction, angle: float) -> float:
    """Return the distance of L, turned by the angle in either direction, from -1 where |L| = 1."""
    excess = np.polysub(np.polymul(L.num, _mirrored(L.num)), np.polymul(L.den, _mirrored(L.den)))
    roots = np.roots(excess)
    omega = np.abs(roots[np.abs(roots.real) <= 1e-5 * np.abs(roots)].imag)
    values = np.polyval(L.num, 1j * omega) / np.polyval(L.den, 1j * omega)
    turned = [np.abs(values * np.exp(sign * 1j * angle) + 1.0).min() for sign in (1.0, -1.0)]
    return float(min(turned))


def _mirrored(p: np.ndarray) -> np.ndarray:
    return p * (-1.0) ** np.arange(len(p) - 1, -1, -1)


@settings(patient, max_examples=50)
@given(systems(max_order=5), systems(min_order=0, max_order=2))
def test_the_disturbance_peak_is_a_tight_upper_bound(G: System, K: System) -> None:
    largest = disturbance_peak(G.polynomials, K.polynomials)[0]
    assume(np.isfinite(largest) and clear_of_the_axis(G, K))
    omega = np.geomspace(1e-8, 1e8, 40001)
    closed = characteristic(G.polynomials, K.polynomials)
    num = np.polymul(G.polynomials.num, K.polynomials.den)
    gain = np.abs(np.polyval(num, 1j * omega) / np.polyval(closed, 1j * omega))
    assert gain.max() <= largest * (1.0 + 1e-9)
    damping = np.min(-np.roots(closed).real / np.abs(np.roots(closed)))
    if damping > 0.05:
        assert gain.max() == pytest.approx(largest, rel=1e-3)
