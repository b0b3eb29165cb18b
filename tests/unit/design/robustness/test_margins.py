"""The margins of the paper's controllers, and those of loops that can be computed by hand."""

from __future__ import annotations

import control
import numpy as np
import pytest
from support.paper_loop import BEST_PI, BEST_PID, G0, HLS, PERIOD_S, PPID, W1, pi, pid

from design.models.plant import paper_plant
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.robustness.loop_shaping import shaped
from design.robustness.margins import (
    bandwidth,
    crossover,
    disturbance_peak,
    gain_margins,
    lowest_gain,
    margin_and_frequency,
    phase_margin,
    stability_margin,
)


def tf(num: list[float], den: list[float]) -> TransferFunction:
    return TransferFunction(np.array(num), np.array(den))


@pytest.mark.parametrize(
    ("K", "margin"),
    [(pid(*PPID), 0.54774), (pid(*BEST_PID), 0.586156), (pi(*BEST_PI), 0.56719), (HLS, 0.5524)],
)
def test_margins_of_the_papers_controllers(K: TransferFunction, margin: float) -> None:
    assert stability_margin(G0, K, W1)[0] == pytest.approx(margin, abs=2e-5)


@pytest.mark.parametrize(
    ("K", "sampled"),
    [
        (pid(*PPID), (0.5366, 0.5146, 0.4931)),
        (pid(*BEST_PID), (0.5752, 0.5535, 0.5322)),
        (HLS, (0.5490, 0.5314, 0.5120)),
    ],
)
def test_sampled_margins_with_zero_one_and_two_samples_of_delay(
    K: TransferFunction, sampled: tuple[float, ...]
) -> None:
    for delay_samples, margin in enumerate(sampled):
        G = paper_plant().transfer_function(Sampling(PERIOD_S, delay_samples))
        assert stability_margin(G, K, W1)[0] == pytest.approx(margin, abs=6e-5)


def test_unstable_loops_of_a_batch_have_no_margin() -> None:
    K = TransferFunction(np.array([[11.0, 5.0], [500.0, 5.0], [-1.0, -0.1]]), np.array([[1.0, 0.0]]))
    margin, omega = margin_and_frequency(G0, K, W1)
    assert margin[0] > 0.5
    assert margin[1:].tolist() == [0.0, 0.0]
    assert np.isnan(omega).tolist() == [False, True, True]


def test_a_loop_that_cancels_an_unstable_pole_is_unstable() -> None:
    assert stability_margin(tf([1.0], [1.0, -1.0]), tf([1.0, -1.0], [1.0, 5.0]))[0] == 0.0


def test_the_margin_of_a_static_loop() -> None:
    # T_zw of G = 1, K = 1: sqrt(2) sqrt(2) / 2.
    assert stability_margin(tf([1.0], [1.0]), tf([1.0], [1.0]))[0] == pytest.approx(1.0)
    assert stability_margin(tf([1.0], [1.0]), tf([3.0], [1.0]))[0] == pytest.approx(4.0 / np.sqrt(20.0))


def test_a_very_lightly_damped_mode_is_not_missed() -> None:
    zeta, w0 = 1e-6, 7.3
    G, K = tf([1.0], [1.0, 2.0 * zeta * w0, w0**2]), tf([1e-9], [1.0])
    margin, omega = margin_and_frequency(G, K)
    peak = 1.0 / (2.0 * zeta * w0**2 * np.sqrt(1.0 - zeta**2))
    assert margin[0] == pytest.approx(1.0 / np.sqrt(1.0 + peak**2), rel=1e-6)
    assert omega[0] == pytest.approx(w0, rel=1e-6)


def test_a_pole_on_the_axis_leaves_no_margin() -> None:
    # Rounding of 1e-16 makes Routh's table call the undamped pair stable; the margin is 0 all the same.
    num, den = np.polymul([3.0216], [1.0, 2.0, 1.0]), np.polymul([1.0, 2.0, 1.0], [1.0, 0.0, 0.0])
    assert stability_margin(TransferFunction(num, den), tf([1.0], [1.0]))[0] < 1e-12


def test_the_highest_of_several_peaks_counts_even_at_infinity() -> None:
    # The optimum PID has equal peaks at infinity and in between.
    margin, omega = margin_and_frequency(G0, pid(*BEST_PID), W1)
    assert omega[0] == np.inf
    h = []
    for w in (1e9, 1.331, 40.0):
        s = 1j * w
        G, K, W = (
            np.polyval(np.ravel(H.num), s) / np.polyval(np.ravel(H.den), s) for H in (G0, pid(*BEST_PID), W1)
        )
        h.append(abs(1.0 + G * K) / np.sqrt((1.0 + abs(K / W) ** 2) * (1.0 + abs(G * W) ** 2)))
    assert h[0] == pytest.approx(margin[0], rel=1e-7)
    assert min(h) >= margin[0] * (1.0 - 1e-7)


def test_crossover_gain_and_bandwidth_of_the_papers_loop() -> None:
    Gs = shaped(G0, W1)
    assert crossover(Gs)[0] == pytest.approx(4.070, abs=5e-4)
    assert 20.0 * np.log10(lowest_gain(Gs, 0.4)[0]) == pytest.approx(20.24, abs=5e-3)
    assert disturbance_peak(G0, pid(*PPID))[0] == pytest.approx(0.0796, abs=5e-5)
    assert bandwidth(G0, pid(*BEST_PID))[0] == pytest.approx(3.93, abs=5e-3)
    assert bandwidth(G0, pi(*BEST_PI))[0] == pytest.approx(4.08, abs=5e-3)
    assert bandwidth(G0, pid(*PPID))[0] == pytest.approx(4.65, abs=5e-3)


@pytest.mark.parametrize("K", [pid(*PPID), pid(*BEST_PID), HLS])
def test_gain_and_phase_margin_agree_with_python_control(K: TransferFunction) -> None:
    L = control.tf(G0.num, G0.den) * control.tf(np.ravel(K.num), np.ravel(K.den))
    gain, phase, _, _ = control.margin(L)
    ours = shaped(G0, TransferFunction(*map(np.ravel, (K.num, K.den))))
    assert gain_margins(ours)[1][0] == pytest.approx(gain, rel=1e-6)
    assert np.degrees(phase_margin(ours)[0]) == pytest.approx(phase, rel=1e-6)


def test_margins_of_a_conditionally_stable_loop() -> None:
    # k (s + 1)^2/s^3 is stable for k > 1/2.
    L = tf([2.0, 4.0, 2.0], [1.0, 0.0, 0.0, 0.0])
    below, above = gain_margins(L)
    assert below[0] == pytest.approx(0.25)
    assert above[0] == np.inf


def test_a_sampled_loop_may_lose_its_margin_at_half_the_sampling_frequency() -> None:
    sampling = Sampling(0.1, 0)
    plant = paper_plant()
    integrator = type(plant)(
        format="hil-plant", version=1, name="i", input_unit="V", output_unit="m", num=[1.0], den=[1.0, 0.0]
    )
    L = integrator.transfer_function(sampling)
    # z = 1 - k T: unstable from k = 2/T.
    assert gain_margins(L)[1][0] == pytest.approx(20.0)


def test_margins_of_a_loop_whose_gain_is_never_1() -> None:
    quiet = tf([0.1], [1.0, 1.0])
    assert crossover(quiet)[0] == 0.0
    assert phase_margin(quiet)[0] == np.pi
    assert gain_margins(quiet)[1][0] == np.inf
    assert crossover(tf([2.0, 5.0], [1.0, 1.0]))[0] == np.inf


def test_the_lowest_gain_may_lie_inside_the_band() -> None:
    zeta = 0.05
    notch = tf([1.0, 2.0 * zeta, 1.0], [1.0, 2.0, 1.0])
    assert lowest_gain(notch, 10.0)[0] == pytest.approx(zeta, rel=1e-9)
    assert lowest_gain(notch, 0.5)[0] == pytest.approx(abs(np.polyval(notch.num, 0.5j)) / 1.25, rel=1e-9)
    assert lowest_gain(tf([1.0], [1.0, 0.0]), 4.0)[0] == pytest.approx(0.25)
