"""Ultimate cycle, tuning rules and conventional controller, compared with python-control and the paper."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.constants import PERIOD_S

from design.errors import DesignError
from design.mathematics import polynomials as poly
from design.models.plant import Plant, paper_plant
from design.models.realisation import transfer_function
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness.loop_shaping import shaped, synthesise
from design.synthesis.baselines import (
    UltimateCycle,
    loop_shaping_controller,
    tyreus_luyben,
    ultimate_cycle,
    ziegler_nichols,
)
from hil.core.controller_file import PidLaw, read_controller
from hil.host.controller_files import SHIPPED_CONTROLLERS

WITHOUT_DELAY = Sampling(PERIOD_S, delay_samples=0)


def make_plant(num: list[float], den: list[float]) -> Plant:
    return Plant(format="hil-plant", version=1, name="p", input_unit="V", output_unit="m", num=num, den=den)


def cycle_of(plant: Plant, sampling: Sampling | None) -> UltimateCycle:
    return ultimate_cycle(plant.transfer_function(sampling), sampling)


def test_ultimate_cycle_of_the_papers_plant_in_the_continuous_loop() -> None:
    cycle = cycle_of(paper_plant(), None)
    assert cycle.gain == pytest.approx(84.55, abs=0.005)
    assert cycle.period_s == pytest.approx(0.4279, abs=0.00005)


def test_ultimate_cycle_of_the_papers_plant_in_the_sampled_loop() -> None:
    cycle = cycle_of(paper_plant(), WITHOUT_DELAY)
    assert cycle.gain == pytest.approx(74.76, abs=0.005)
    assert cycle.period_s == pytest.approx(0.4527, abs=0.00005)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_at_the_ultimate_gain_the_sampled_loop_oscillates_with_the_ultimate_period(delay: int) -> None:
    """python-control finds one pair of poles on the unit circle and the others inside it."""
    cycle = cycle_of(paper_plant(), Sampling(PERIOD_S, delay_samples=delay))
    plant = paper_plant()
    held = control.sample_system(control.tf(plant.num, plant.den), PERIOD_S, "zoh")
    loop = control.feedback(cycle.gain * held * control.tf([1.0], [1.0] + [0.0] * delay, PERIOD_S))
    poles = control.poles(loop)
    on_circle = poles[np.abs(np.abs(poles) - 1.0) < 1e-6]
    assert len(on_circle) == 2
    assert np.abs(np.angle(on_circle)) == pytest.approx(2.0 * np.pi * PERIOD_S / cycle.period_s, rel=1e-6)
    assert (np.abs(poles) < 1.0 + 1e-6).all()


@given(
    poles=st.lists(st.floats(0.05, 50.0), min_size=3, max_size=6),
    gain=st.floats(0.01, 100.0),
    sign=st.sampled_from([1.0, -1.0]),
    is_sampled=st.booleans(),
)
def test_the_loop_is_stable_below_the_ultimate_gain_and_unstable_above(
    poles: list[float], gain: float, sign: float, is_sampled: bool
) -> None:
    sampling = Sampling(PERIOD_S) if is_sampled else None
    G = make_plant([sign * gain], np.poly(-np.array(poles)).tolist()).transfer_function(sampling)
    ku = ultimate_cycle(G, sampling).gain
    assert np.sign(ku) == sign
    for factor, stable in ((0.999, True), (1.001, False)):
        assert bool(poly.hurwitz(poly.add(G.den, factor * ku * G.num))) is stable


def test_a_first_order_loop_has_an_ultimate_cycle_only_if_it_is_sampled() -> None:
    first_order = make_plant([2.0], [1.0, 1.0])
    with pytest.raises(DesignError, match="stays stable at every proportional gain; the sampled loop"):
        cycle_of(first_order, None)
    # 1/(s + 1) held: pole a, gain 2 (1 - a); z = -1 at k = (1 + a)/(2 (1 - a)), two samples a period.
    cycle = cycle_of(first_order, WITHOUT_DELAY)
    a = np.exp(-PERIOD_S)
    assert cycle.gain == pytest.approx((1.0 + a) / (2.0 * (1.0 - a)), rel=1e-9)
    assert cycle.period_s == pytest.approx(2.0 * PERIOD_S, rel=1e-9)


def test_the_ultimate_gain_of_an_unstable_plant_is_the_upper_end_of_its_stable_gains() -> None:
    # (s - 1)(s + 2)(s + 10) + k: Routh gives 20 < k < 108.
    cycle = cycle_of(make_plant([1.0], np.poly([1.0, -2.0, -10.0]).tolist()), None)
    assert cycle.gain == pytest.approx(108.0, rel=1e-9)


def test_a_double_integrator_has_no_ultimate_cycle() -> None:
    with pytest.raises(DesignError, match="no proportional gain stabilises"):
        cycle_of(make_plant([1.0], [1.0, 0.0, 0.0]), None)


def test_a_loop_that_becomes_unstable_without_oscillating_has_no_ultimate_cycle() -> None:
    # (1 - s)/(s + 2): the pole -(2 + k)/(1 - k) leaves through infinity at k = 1.
    with pytest.raises(DesignError, match="drifts instead of oscillating"):
        cycle_of(make_plant([-1.0, 1.0], [1.0, 2.0]), None)


@pytest.mark.parametrize(("name", "rule"), [("zn", ziegler_nichols), ("tlc", tyreus_luyben)])
def test_the_tuning_rules_give_the_shipped_controllers(name: str, rule: object) -> None:
    """The files were written with Ku 74.76 and Pu 0.4527, so the gains agree to these digits."""
    shipped = read_controller((SHIPPED_CONTROLLERS / f"{name}.json").read_text(), name).law
    assert isinstance(shipped, PidLaw)
    gains = rule(cycle_of(paper_plant(), WITHOUT_DELAY))  # type: ignore[operator]
    assert gains.values == pytest.approx([shipped.kp, shipped.ki, shipped.kd, shipped.tau_d], rel=2e-4)


def test_tuning_rules_in_closed_form() -> None:
    cycle = UltimateCycle(10.0, 2.0)
    assert ziegler_nichols(cycle).values == pytest.approx([6.0, 6.0, 1.5, 0.025])
    assert tyreus_luyben(cycle).values == pytest.approx(
        [10.0 / 2.2, 10.0 / 2.2 / 4.4, 10.0 / 2.2 * 2.0 / 6.3, 2.0 / 63.0]
    )


@pytest.mark.parametrize("sampling", [None, Sampling(PERIOD_S, 1)])
def test_conventional_controller_is_that_of_the_riccati_equations(sampling: Sampling | None) -> None:
    """K = W1 K∞ has the frequency response of McFarlane and Glover's formulas."""
    G = paper_plant().transfer_function(sampling)
    W = TransferFunction(np.array([15.535, 6.83]), np.array([1.0, 0.001]))
    K = loop_shaping_controller(G, W, 1.1)
    K_inf = transfer_function(synthesise(shaped(G, W), 1.1).controller)
    s = 1j * np.geomspace(0.01, 100.0, 30)
    computed = np.polyval(K.num.ravel(), s) / np.polyval(K.den.ravel(), s)
    weight = np.polyval(W.num, s) / np.polyval(W.den, s)
    expected = weight * np.polyval(K_inf.num.ravel(), s) / np.polyval(K_inf.den.ravel(), s)
    np.testing.assert_allclose(computed, expected, rtol=1e-5)
