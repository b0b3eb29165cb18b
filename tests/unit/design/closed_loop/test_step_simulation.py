"""Step responses that a window of fixed length would misread: slow, hidden and ringing ones."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal
from support.given_responses import ONE, Modes, both, continuous_loop, readings, sampled_loop
from support.paper_loop import PERIOD_S

from design.closed_loop.loops import ClosedLoops
from design.closed_loop.specifications import PAPER, Specification, violations
from design.closed_loop.specifications import readings as specified
from design.models.controller import one_degree_of_freedom
from design.models.plant import Plant
from design.models.sampling import Sampling
from design.models.transfer_function import TransferFunction
from design.synthesis.structures import STRUCTURES, IntegralWeight

FAST = (-1.0 + 0.0j, -1.0 + 0.0j)
# In a window of ten seconds, each of these seems to have settled within 2 % of 1.
LEAVES_LATER: dict[str, Modes] = {
    "overshoots after 200 s": [(-0.01 + 0.0j, -10.0 + 0.0j), (-0.0095 + 0.0j, 9.0 + 0.0j)],
    "comes back out of the band": [FAST, (-1e-3 + 0.0j, 1.0 + 0.0j), (-1.1e-3 + 0.0j, -1.0 + 0.0j)],
    "hidden slow pole": [FAST, (-1e-3 + 0.0j, 0.03 + 0.0j)],
    "hidden slow pole, from below": [FAST, (-2e-4 + 0.0j, -0.5 + 0.0j)],
    "slow as an hour": [(-3e-4 + 0.0j, -1.0 + 0.0j)],
}


@pytest.mark.parametrize("name", LEAVES_LATER)
@pytest.mark.parametrize("period_s", [None, PERIOD_S])
def test_late_motions_are_read(name: str, period_s: float | None) -> None:
    modes = LEAVES_LATER[name]
    loops = continuous_loop(modes) if period_s is None else sampled_loop(modes, period_s)
    true = readings(modes, period_s)
    assert true.settling_s > 100.0
    assert loops.settling_s[0] == pytest.approx(true.settling_s, rel=1e-3)
    assert loops.overshoot[0] == pytest.approx(true.overshoot, abs=1e-4)
    assert loops.rise_s[0] == pytest.approx(true.rise_s, rel=1e-3, abs=PERIOD_S)


@pytest.mark.parametrize("damping", [0.1, 0.01, 1e-3])
@pytest.mark.parametrize("omega", [0.5, 40.0, 900.0])
def test_ringing_is_resolved_whatever_its_duration(omega: float, damping: float) -> None:
    """The loop is w²/(s² + 2 z w s + w²); with z = 0.001 it rings for a thousand periods."""
    G = TransferFunction(np.array([omega**2]), np.array([1.0, 2.0 * damping * omega, 0.0]))
    loops = ClosedLoops(G, ONE)
    root = np.sqrt(1.0 - damping**2)
    assert loops.overshoot[0] == pytest.approx(np.exp(-np.pi * damping / root), abs=2e-4)
    # A peak lies outside the band as long as the envelope exp(-z w t) does.
    peaks_s = np.pi / (omega * root) * np.arange(1, 20_000)
    last_s = peaks_s[np.exp(-damping * omega * peaks_s) > 0.02][-1]
    assert last_s < loops.settling_s[0] < last_s + np.pi / (omega * root)
    t = last_s + np.linspace(0.0, np.pi / (omega * root), 20_001)
    e = np.exp(-damping * omega * t) * (np.cos(omega * root * t) + damping / root * np.sin(omega * root * t))
    left_s = t[np.flatnonzero(np.abs(e) > 0.02)[-1]]
    assert loops.settling_s[0] == pytest.approx(left_s, abs=2e-3 * np.pi / omega)


def test_ringing_between_the_samples_of_a_window_is_found() -> None:
    """With 512 samples in 6 s, the mode has the same phase at every sample."""
    omega = 2.0 * np.pi * 511.0 / 6.0
    modes: Modes = [(-2.0 + 0.0j, -1.0 + 0.0j), (complex(-0.5, omega), 0.25j)]
    loops, true = continuous_loop(modes), readings(modes)
    assert true.overshoot > 0.05
    assert loops.overshoot[0] == pytest.approx(true.overshoot, abs=2e-4)
    assert loops.settling_s[0] == pytest.approx(true.settling_s, abs=0.01)


def test_a_loop_that_rings_too_long_has_no_settling_time() -> None:
    G = TransferFunction(np.array([1e4]), np.array([1.0, 2e-5, 0.0]))
    loops = ClosedLoops(G, ONE)
    assert loops.stable[0]
    assert loops.settling_s[0] == np.inf
    assert loops.overshoot[0] == pytest.approx(1.0, abs=1e-3)
    (reading,) = specified([Specification("settling_s", 1e9)], loops)
    assert not reading.met


def test_repeated_poles() -> None:
    """The loops are (s + 1)^-6 and a sampled integrator behind twenty samples of delay."""
    den = np.poly(-np.ones(6))
    loops = ClosedLoops(TransferFunction(np.ones(1), np.polysub(den, [1.0])), ONE)
    t = np.linspace(0.0, 30.0, 300_001)
    _, y = scipy.signal.step(([1.0], den), T=t)
    assert loops.settling_s[0] == pytest.approx(t[np.flatnonzero(np.abs(y - 1.0) > 0.02)[-1]], rel=1e-3)
    assert loops.overshoot[0] < 1e-4
    sampling = Sampling(PERIOD_S, 20)
    plant = Plant(
        format="hil-plant", version=1, name="p", input_unit="V", output_unit="m", num=[1.0], den=[1.0, 0.0]
    )
    loops = ClosedLoops(
        plant.transfer_function(sampling),
        one_degree_of_freedom(np.array([[1.0]]), np.array([[1.0]])),
        sampling=sampling,
    )
    y = np.zeros(2000)
    for k in range(len(y) - 1):
        y[k + 1] = y[k] + PERIOD_S * (1.0 - y[k - 20] if k >= 20 else 0.0)
    # The delay lies between measurement and valve, so that the step too acts twenty samples late.
    settled_s = PERIOD_S * np.flatnonzero(np.abs(y - 1.0) > 0.02)[-1]
    assert loops.settling_s[0] == pytest.approx(settled_s, abs=1.01 * PERIOD_S)


def test_no_loop_depends_on_the_others_of_its_batch() -> None:
    """The batch holds fast, slow and ringing loops."""
    G = TransferFunction(np.array([1.0]), np.array([1.0, 0.02, 4.0, 0.001]))
    values = np.array([[0.01, 0.001], [0.05, 0.01], [1e-4, 1e-4], [0.02, 0.02]])
    together = ClosedLoops(G, STRUCTURES["pi"].controller(values))
    assert together.stable.all()
    for i, row in enumerate(values):
        alone = ClosedLoops(G, STRUCTURES["pi"].controller(row[None, :]))
        for quantity in ("overshoot", "settling_s", "rise_s", "effort"):
            one, of_many = getattr(alone, quantity)[0], getattr(together, quantity)[i]
            assert of_many == pytest.approx(one, rel=1e-9), quantity


def test_effort_that_grows_slowly() -> None:
    """With an integrating controller on a slow plant, u approaches 1/G(0) long after the step."""
    G = TransferFunction(np.array([0.001]), np.array([1.0, 0.001]))
    loops = ClosedLoops(G, STRUCTURES["pi"].controller(np.array([[0.2, 1e-5]])))
    assert loops.response(6.0).u[0].max() < 0.21
    assert loops.effort[0] == pytest.approx(1.0, rel=1e-4)


def test_specifications_include_the_slow_tail_of_a_response() -> None:
    """A nearly cancelled slow pole moves the response out of the band long after the step."""
    loops = continuous_loop(LEAVES_LATER["hidden slow pole"])
    asked = [Specification("settling_s", 5.0), Specification("overshoot", 0.02)]
    assert [reading.met for reading in specified(asked, loops)] == [False, False]
    assert violations(asked, loops)[0] > 1.0
    assert violations(PAPER[:1], loops)[0] == 0.0


@pytest.mark.parametrize("b", [1e-3, 1e-6])
def test_final_value_and_settling_with_a_near_integrator(b: float) -> None:
    """The weight's slow pole b remains in the loop, nearly cancelled; the response is followed to its end."""
    G = TransferFunction(np.array([5.0]), np.array([1.0, 5.0]))
    W = IntegralWeight(b).controller(np.array([[0.05, 0.02]]))
    loops = ClosedLoops(G, W)
    poles = np.roots(loops.closed[0])
    assert loops.error[0] == pytest.approx(1.0 / (1.0 + 0.05 * 0.02 / b))
    final = 1.0 - loops.error[0]
    t = np.geomspace(1e-3, 40.0 / np.abs(poles).min(), 400_000)
    num, den = np.polymul(G.num, W.num[0]), loops.closed[0]
    r = np.polyval(num, poles) / (poles * np.polyval(np.polyder(den), poles))
    y = final + (r[None, :] * np.exp(np.outer(t, poles))).sum(axis=1).real
    assert loops.settling_s[0] == pytest.approx(t[np.abs(y / final - 1.0) > 0.02][-1], rel=1e-3)


@pytest.mark.parametrize("excess", [-1e-3, -1e-5, 1e-5, 1e-3])
def test_a_late_peak_that_touches_the_band_counts_as_outside(excess: float) -> None:
    """Within 2e-4 of the edge of the band, the settling time is the later of both possible ones."""
    zeta, omega = 0.3, 2.0
    root = np.sqrt(1.0 - zeta**2)
    # The second peak of the response 1 + scale * ringing + rest lies at 2 % of it, apart from the excess.
    peak_s = 2.0 * np.pi / (omega * root)
    height = np.exp(-zeta * omega * peak_s)
    ringing = (complex(-zeta * omega, omega * root), complex(1.0, -zeta / root))
    scale = 0.02 * (1.0 + excess) / height
    modes: Modes = [ringing, (-20.0 + 0.0j, complex(1.0 / scale - 1.0))]
    p, r = both(modes)
    t = np.linspace(0.9 * peak_s, 1.1 * peak_s, 200_001)
    top = np.abs((r[None, :] * np.exp(np.outer(t, p))).sum(axis=1).real).max()
    assert top == pytest.approx(0.02 * (1.0 + excess), rel=1e-6)
    settled_s = continuous_loop(modes).settling_s[0]
    assert (settled_s > 0.9 * peak_s) == (excess > -2e-4)
