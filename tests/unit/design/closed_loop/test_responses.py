"""Step responses and their readings, against scipy and closed formulas."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from support.paper_loop import BEST_PI, BEST_PID, G0, HLS, PERIOD_S, PPID, W1, pi, pid

from design.closed_loop.loops import ClosedLoops
from design.closed_loop.responses import step_responses
from design.models.controller import Controller, one_degree_of_freedom
from design.models.plant import paper_plant
from design.models.sampling import Sampling, to_z
from design.models.transfer_function import TransferFunction
from design.synthesis.structures import STRUCTURES

HLS_CONTROLLER = one_degree_of_freedom(HLS.num, HLS.den)


def closed(G: TransferFunction, K: Controller, i: int = 0) -> tuple[np.ndarray, np.ndarray]:
    num, den = np.atleast_2d(K.num)[i], np.atleast_2d(K.den)[min(i, len(np.atleast_2d(K.den)) - 1)]
    above = np.polymul(np.ravel(G.num), num)
    return above, np.polyadd(np.polymul(np.ravel(G.den), den), above)


@pytest.mark.parametrize("K", [pid(*PPID), pid(*BEST_PID), HLS_CONTROLLER, pid(20.0, 30.0, 0.01, 0.01)])
def test_continuous_steps_agree_with_scipy(K: Controller) -> None:
    response = step_responses(G0, K, None, 0.01, 400)
    _, expected = scipy.signal.step(closed(G0, K), T=response.time_s)
    np.testing.assert_allclose(response.y[0], expected, atol=1e-9)


@pytest.mark.parametrize("delay_samples", [0, 1, 3])
def test_sampled_steps_agree_with_the_difference_equation(delay_samples: int) -> None:
    sampling = Sampling(PERIOD_S, delay_samples)
    G, K = paper_plant().transfer_function(sampling), pid(*BEST_PID)
    response = step_responses(G, K, sampling, PERIOD_S, 300)
    plant, controller = to_z(G, PERIOD_S), to_z(K.feedback, PERIOD_S)
    num, den = np.ravel(controller.num), np.ravel(controller.den)
    below = np.polyadd(np.polymul(plant.den, den), np.polymul(plant.num, num))
    y, u = (
        scipy.signal.lfilter(np.pad(above, (len(below) - len(above), 0)), below, np.ones(300))
        for above in (np.polymul(plant.num, num), np.polymul(plant.den, num))
    )
    np.testing.assert_allclose(response.y[0], y, atol=1e-6)
    np.testing.assert_allclose(response.u[0], u, atol=1e-5)
    assert np.abs(response.y[0, : delay_samples + 1]).max() < 1e-12


def test_neither_the_batch_nor_the_number_of_samples_changes_a_response() -> None:
    values = np.array([PPID, BEST_PID, (8.0, 3.0, 0.1, 0.05)])
    together = step_responses(G0, STRUCTURES["pid"].controller(values), None, 0.02, 200)
    for i, row in enumerate(values):
        alone = step_responses(G0, pid(*row), None, 0.02, 77)
        np.testing.assert_allclose(together.y[i, :77], alone.y[0], atol=1e-11)


def test_setpoint_weights_act_on_the_setpoint_only() -> None:
    values = np.array([[11.0, 5.0, 0.3, 0.03, 0.4, 0.0]])
    K = STRUCTURES["pid-2dof"].controller(values)
    response = step_responses(G0, K, None, 0.01, 500)
    assert response.u[0, 0] == pytest.approx(0.4 * 11.0)
    Tr = (np.polymul(G0.num, K.num_r[0]), closed(G0, K)[1])
    _, expected = scipy.signal.step(Tr, T=response.time_s)
    np.testing.assert_allclose(response.y[0], expected, atol=1e-9)


def test_a_proportional_loop_around_a_biproper_plant() -> None:
    # G = (s + 2)/(s + 1), K = 3: y(0+) = 3/4, y(∞) = 6/7.
    G = TransferFunction(np.array([1.0, 2.0]), np.array([1.0, 1.0]))
    response = step_responses(G, one_degree_of_freedom(np.array([[3.0]]), np.array([[1.0]])), None, 0.1, 100)
    assert response.y[0, 0] == pytest.approx(0.75)
    assert response.y[0, -1] == pytest.approx(6.0 / 7.0)
    assert response.u[0, 0] == pytest.approx(0.75)


@pytest.mark.parametrize(
    ("K", "overshoot", "settling_s"),
    [
        (pid(*PPID), 0.0117, 0.880),
        (HLS_CONTROLLER, 0.002, 1.06),
        (pid(*BEST_PID), 0.0040, 1.069),
        (pi(*BEST_PI), 0.0024, 1.064),
    ],
)
def test_overshoot_and_settling_of_the_papers_controllers(
    K: Controller, overshoot: float, settling_s: float
) -> None:
    loops = ClosedLoops(G0, K, W=W1)
    assert loops.overshoot[0] == pytest.approx(overshoot, abs=3e-4)
    assert loops.settling_s[0] == pytest.approx(settling_s, abs=3e-3)


def test_readings_of_a_second_order_loop() -> None:
    # w0²/(s² + 2 z w0 s + w0²) around K = 1.
    w0, zeta = 5.0, 0.4
    G = TransferFunction(np.array([w0**2]), np.array([1.0, 2.0 * zeta * w0, 0.0]))
    loops = ClosedLoops(G, one_degree_of_freedom(np.array([[1.0]]), np.array([[1.0]])))
    assert loops.overshoot[0] == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1.0 - zeta**2)), rel=1e-4)
    assert loops.final_value[0] == pytest.approx(1.0)
    t = np.linspace(0.0, 6.0, 600001)
    _, y = scipy.signal.step(([w0**2], [1.0, 2.0 * zeta * w0, w0**2]), T=t)
    assert loops.settling_s[0] == pytest.approx(t[np.flatnonzero(np.abs(y - 1.0) > 0.02)[-1]], abs=1e-4)
    rise = t[np.argmax(y >= 0.9)] - t[np.argmax(y >= 0.1)]
    assert loops.rise_s[0] == pytest.approx(rise, abs=1e-4)
    assert loops.effort[0] == pytest.approx(1.0)


def test_the_steady_state_error_follows_from_the_gain_at_zero_frequency() -> None:
    G = TransferFunction(np.array([2.0]), np.array([1.0, 1.0]))
    loops = ClosedLoops(G, one_degree_of_freedom(np.array([[4.0]]), np.array([[1.0]])))
    assert loops.error[0] == pytest.approx(1.0 / 9.0)


def test_readings_of_unstable_and_slow_loops() -> None:
    K = STRUCTURES["pi"].controller(np.array([[500.0, 5.0], [0.01, 0.01], [10.763, 4.7136]]))
    loops = ClosedLoops(G0, K)
    assert loops.stable.tolist() == [False, True, True]
    assert np.abs(loops.response(2.0).y[0]).max() == 0.0
    for reading in (loops.overshoot, loops.settling_s, loops.rise_s, loops.effort, loops.itae):
        assert reading[0] == np.inf
        assert np.isfinite(reading[1:]).all()
    # The second loop has a pole at 0.0061 rad/s and settles after minutes.
    slow = np.roots(loops.closed[1]).real.max()
    assert loops.settling_s[1] == pytest.approx(np.log(0.02) / slow, rel=0.05)
