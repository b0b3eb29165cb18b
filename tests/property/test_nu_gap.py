"""The ν-gap: it is a metric, and a margin over the gap means that the other plant is stabilised too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.random_systems import System, patient, systems

from design.models.sampling import zero_order_hold
from design.models.transfer_function import TransferFunction
from design.robustness.central_controller import central_controllers
from design.robustness.margins import stability_margin
from design.robustness.nu_gap import chordal_distance, nu_gap

small_systems = systems(max_order=4, min_damping=0.01)
quick = settings(patient, max_examples=50)


def gap(G1: System, G2: System) -> float:
    return nu_gap(G1.polynomials, G2.polynomials)


@quick
@given(small_systems, small_systems)
def test_between_zero_and_one_and_symmetric(G1: System, G2: System) -> None:
    there, back = gap(G1, G2), gap(G2, G1)
    assert 0.0 <= there <= 1.0
    assert there == pytest.approx(back, abs=1e-9)


@quick
@given(small_systems, small_systems, small_systems)
def test_the_triangle_inequality_holds(G1: System, G2: System, G3: System) -> None:
    assert gap(G1, G3) <= gap(G1, G2) + gap(G2, G3) + 1e-9


@quick
@given(small_systems)
def test_a_plant_has_no_distance_from_itself(G: System) -> None:
    assert gap(G, G) == pytest.approx(0.0, abs=1e-7)


@quick
@given(small_systems, small_systems, st.floats(1e-3, 1e3))
def test_the_gap_is_never_below_the_chordal_distance(G1: System, G2: System, omega: float) -> None:
    distance = chordal_distance(G1.polynomials, G2.polynomials, np.array([omega]))[0]
    first, second = G1.at(1j * omega), G2.at(1j * omega)
    expected = abs(first - second) / np.sqrt((1.0 + abs(first) ** 2) * (1.0 + abs(second) ** 2))
    assert distance == pytest.approx(expected, rel=1e-6, abs=1e-12)
    assert gap(G1, G2) >= distance * (1.0 - 1e-9)


@st.composite
def neighbours(draw: st.DrawFn) -> tuple[TransferFunction, TransferFunction]:
    """Draw a plant, and the plant with every coefficient changed by up to a third."""
    G = draw(systems(max_order=5, min_damping=0.05)).polynomials
    change = st.floats(-0.3, 0.3)
    num, den = (p * (1.0 + np.array([draw(change) for _ in p])) for p in G)
    return G, TransferFunction(num, den)


@settings(patient, max_examples=90)
@given(neighbours())
def test_a_margin_over_the_gap_stabilises_the_other_plant(
    pair: tuple[TransferFunction, TransferFunction],
) -> None:
    G, other = pair
    K, _ = central_controllers(G)
    margin = stability_margin(G, K)[0]
    distance = nu_gap(G, other)
    assume(margin > distance * (1.0 + 1e-9))
    # Vinnicombe: arcsin of what is left is at least the difference of the arcsines.
    left = np.sin(np.arcsin(margin) - np.arcsin(distance))
    assert stability_margin(other, K)[0] >= left * (1.0 - 1e-6) - 1e-9


@settings(patient, max_examples=25)
@given(small_systems, small_systems)
def test_the_sampled_gap_becomes_the_continuous_one(G1: System, G2: System) -> None:
    pair = [G.polynomials for G in (G1, G2)]
    assume(all(len(G.num) < len(G.den) for G in pair))
    planes = [zero_order_hold(G, 1e-5) for G in pair]
    assert nu_gap(*planes) == pytest.approx(nu_gap(*pair), abs=2e-3)


def tf(num: list[float], den: list[float]) -> TransferFunction:
    return TransferFunction(np.array(num), np.array(den))


def test_textbook_pairs() -> None:
    # 100/(2s ± 1) are close, although one is unstable; plants of opposite sign are far apart.
    assert nu_gap(tf([100.0], [2.0, 1.0]), tf([100.0], [2.0, -1.0])) == pytest.approx(0.02, abs=1e-4)
    assert nu_gap(tf([1.0], [1.0, -0.001]), tf([1.0], [1.0, 0.001])) == pytest.approx(0.002, abs=1e-5)
    assert nu_gap(tf([1.0], [1.0, 1.0]), tf([-1.0], [1.0, 1.0])) == pytest.approx(1.0)
    # One integrator and two integrators satisfy the winding condition.
    assert nu_gap(tf([1.0], [1.0, 0.0]), tf([1.0], [1.0, 0.0, 0.0])) < 1.0
    assert nu_gap(tf([1.0, -1.0], [1.0, 1.0]), tf([1.0], [1.0])) == 1.0
