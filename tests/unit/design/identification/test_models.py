"""Sampled and continuous models, and the way between them: hold, and hold inverted."""

from __future__ import annotations

import control
import numpy as np
import pytest
import scipy.signal
from support.identification_data import PAPER, PAPER_DEN, PERIOD_S, random_plant

import design
from design.errors import DesignError
from design.identification.estimators.nearest_continuous import nearest_continuous
from design.identification.models.held_discretisation import hold
from design.identification.models.inverse_hold import NoContinuousModelError, invert_hold
from design.identification.models.model import ContinuousModel, DiscreteModel
from design.models.sampling import zero_order_hold
from design.models.transfer_function import TransferFunction

PAPER_CONTINUOUS = ContinuousModel(np.array([0.47947, 43.5166972]), PAPER_DEN)


def test_what_a_model_says_of_itself() -> None:
    model = DiscreteModel(np.array([0.2, 0.1]), np.poly([0.9, 0.5]), 2, 0.1)
    assert model.order == 2
    assert model.stable
    assert model.gain == pytest.approx(0.3 / 0.05)
    np.testing.assert_allclose(np.sort(model.poles_z), [0.5, 0.9])
    np.testing.assert_allclose(model.zeros_z, [-0.5])
    z = np.exp(0.1j * np.array([0.3, 5.0, 20.0]))
    expected = z**-2 * (0.2 + 0.1 / z) / ((1.0 - 0.9 / z) * (1.0 - 0.5 / z))
    np.testing.assert_allclose(model.at([0.3, 5.0, 20.0]), expected)
    np.testing.assert_allclose(model.simulate(np.eye(1, 5)[0]), [0.0, 0.0, 0.2, 0.38, 0.442], atol=1e-12)
    assert not DiscreteModel(np.ones(1), np.array([1.0, -1.2]), 1, 0.1).stable
    assert DiscreteModel(np.ones(1), np.array([1.0, -1.0]), 1, 0.1).gain == np.inf


def test_slow_poles_keep_their_digits() -> None:
    slow = DiscreteModel(np.ones(1), np.poly([1.0 - 1e-7, 1.0 - 2e-7]), 1, 1.0)
    np.testing.assert_allclose(np.sort(1.0 - slow.poles_z.real), [1e-7, 2e-7], rtol=1e-2)


def test_noise_model() -> None:
    model = DiscreteModel(np.ones(1), np.ones(1), 1, 0.1, np.array([1.0, 0.5]), np.array([1.0, -0.9]))
    assert model.noise_at([0.0])[0] == pytest.approx(15.0)


@pytest.mark.parametrize("dead_samples", [0.0, 0.3, 1.0, 2.75])
def test_the_hold_is_exact_for_any_dead_time(dead_samples: float) -> None:
    model = hold(ContinuousModel(np.array([0.47947, 43.5]), PAPER_DEN, dead_samples * PERIOD_S), PERIOD_S)
    fine = np.linspace(0.0, 60 * PERIOD_S, 60_001)
    response = scipy.signal.step(([0.47947, 43.5], PAPER_DEN), T=fine)[1]
    times = np.arange(60) * PERIOD_S - dead_samples * PERIOD_S
    expected = np.interp(np.maximum(times, 0.0), fine, response)
    np.testing.assert_allclose(model.simulate(np.ones(60)), expected, atol=1e-8)
    assert model.nk == 1 + int(dead_samples)


@pytest.mark.parametrize("dead_samples", [0.0, 0.4, 2.0, 3.6])
def test_the_hold_is_that_of_the_design(dead_samples: float) -> None:
    """Against the same hold in the bilinear plane, in which controllers are designed."""
    G = TransferFunction(np.array([0.47947, 43.5]), PAPER_DEN)
    plane = zero_order_hold(G, PERIOD_S, dead_samples * PERIOD_S)
    omega = np.geomspace(0.1, 200.0, 30)
    s = 2j / PERIOD_S * np.tan(0.5 * omega * PERIOD_S)
    model = hold(ContinuousModel(G.num, G.den, dead_samples * PERIOD_S), PERIOD_S)
    np.testing.assert_allclose(
        model.at(omega), np.polyval(plane.num, s) / np.polyval(plane.den, s), rtol=1e-7
    )


def test_whole_samples_of_dead_time_are_not_blurred_by_rounding() -> None:
    for samples in range(30):
        model = hold(ContinuousModel(np.array([43.5]), PAPER_DEN, samples * PERIOD_S), PERIOD_S)
        assert (model.nk, len(model.b)) == (samples + 1, 3)


def test_integrators_are_sampled_too() -> None:
    model = hold(ContinuousModel(np.array([2.0]), np.array([1.0, 3.0, 0.0])), 0.1)
    expected = scipy.signal.cont2discrete(([2.0], [1.0, 3.0, 0.0]), 0.1)
    np.testing.assert_allclose(model.b, expected[0].ravel()[1:], rtol=1e-10)
    np.testing.assert_allclose(model.f, expected[1], atol=1e-14)


def test_equation_15_is_an_output_error_model_with_the_hold_inverted() -> None:
    """OE(1,3,1) with the poles and the gain of eq. (15); the term in s² is left out in print."""
    f = hold(PAPER_CONTINUOUS, PERIOD_S).f
    gain = 43.5166972 / PAPER_DEN[-1]
    continuous = invert_hold(DiscreteModel(np.array([gain * f.sum()]), f, 1, PERIOD_S))
    np.testing.assert_allclose(continuous.num, [0.00173, 0.47947, 43.5167], rtol=3e-3)
    np.testing.assert_allclose(continuous.num[1:], [0.47947, 43.5166972], rtol=1e-5)
    np.testing.assert_allclose(continuous.den, PAPER_DEN, rtol=1e-9)
    assert -continuous.num[2] / continuous.num[1] == pytest.approx(-90.76, abs=2e-3)
    assert continuous.dead_time_s == 0.0


@pytest.mark.parametrize("order", range(1, 7))
def test_the_inverse_of_the_hold_gives_the_model_back(order: int) -> None:
    random = np.random.default_rng(order)
    omega = np.geomspace(1e-3, 3.0, 30)
    for delay in range(4):
        plant = random_plant(random, order, delay)
        back = invert_hold(plant.model)
        assert back.dead_time_s == delay
        np.testing.assert_allclose(hold(back, 1.0).at(omega), plant.model.at(omega), rtol=1e-5)


def test_a_direct_path_stays_direct() -> None:
    continuous = invert_hold(DiscreteModel(np.array([0.5, 0.1]), np.array([1.0, -0.8]), 0, 0.1))
    assert len(continuous.num) == len(continuous.den) == 2
    assert continuous.num[0] == pytest.approx(0.5)
    assert continuous.gain == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("b", "f", "message"),
    [
        ([1.0], [1.0, 0.3], "a pole at z = -0.3, on the negative real axis"),
        ([1.0, 0.5], [1.0, -0.9], "2 coefficients in B with 1 poles"),
        ([1.0], [1.0, -1e-13], "a pole at z = 0"),
    ],
)
def test_models_that_no_plant_behind_a_hold_has(b: list[float], f: list[float], message: str) -> None:
    with pytest.raises(NoContinuousModelError, match=message):
        invert_hold(DiscreteModel(np.array(b), np.array(f), 1, PERIOD_S))


def test_the_nearest_continuous_model() -> None:
    near = nearest_continuous(DiscreteModel(np.array([0.1]), np.poly([0.95, 0.6, -0.02]), 2, 0.1))
    assert near.fit_percent > 98.0
    np.testing.assert_allclose(np.sort(-near.model.poles.real)[0], -np.log(0.95) / 0.1, rtol=0.02)
    assert near.model.gain == pytest.approx(0.1 / (0.05 * 0.4 * 1.02), rel=0.02)
    with pytest.raises(NoContinuousModelError, match="unstable"):
        nearest_continuous(DiscreteModel(np.ones(1), np.array([1.0, 1.1]), 1, 0.1))


@pytest.mark.parametrize(
    "model",
    [
        DiscreteModel(np.array([1.0, 0.2]), np.array([1.0, -0.9]), 3, 0.01),
        DiscreteModel(np.array([1.0]), np.poly([0.9, 0.5, 0.2]), 1, 0.01),
        PAPER,
    ],
)
def test_python_control_takes_a_model(model: DiscreteModel) -> None:
    system = design.model_to_control(model, "identified")
    omega = np.geomspace(0.1, 200.0, 20)
    np.testing.assert_allclose(system(np.exp(1j * omega * model.sample_time_s)), model.at(omega), rtol=1e-6)
    assert system.dt == model.sample_time_s
    assert system.name == "identified"


def test_python_control_takes_a_continuous_model_without_dead_time() -> None:
    system = design.model_to_control(PAPER_CONTINUOUS)
    assert control.poles(system) == pytest.approx(PAPER_CONTINUOUS.poles)
    with pytest.raises(DesignError, match=r"dead time of 0\.1 s"):
        design.model_to_control(ContinuousModel(np.ones(1), np.ones(2), 0.1))
