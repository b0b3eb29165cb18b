"""A continuous plant behind a hold and any delay, against scipy and against a finer sampling."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.signal

from design.errors import DesignError
from design.mathematics.polynomials import ComplexArray
from design.models.sampling import MAX_DELAY_SAMPLES, Sampling, delayed, to_z, zero_order_hold
from design.models.transfer_function import TransferFunction

SYSTEMS = {
    "paper": ([0.47947, 43.5166972], [1.0, 17.3931, 175.080007, 71.03849]),
    "integrator": ([3.0], [1.0, 4.0, 0.0]),
    "double integrator": ([2.0], [1.0, 0.0, 0.0]),
    "unstable": ([1.0, 2.0], [1.0, -1.0, 4.0]),
    "biproper": ([2.0, 1.0, 3.0], [1.0, 2.0, 5.0]),
    "repeated poles": ([1.0], [1.0, 6.0, 12.0, 8.0]),
    "constant": ([2.5], [1.0]),
}


def response(H: TransferFunction, s: ComplexArray) -> ComplexArray:
    return np.asarray(np.polyval(H.num, s) / np.polyval(H.den, s))


def on_the_unit_circle(period_s: float) -> tuple[ComplexArray, ComplexArray]:
    """Return points z on the unit circle, and the points s of the bilinear plane that they belong to."""
    omega = np.concatenate([np.geomspace(1e-4, 0.05, 15), np.linspace(0.05, 0.95, 40)]) * np.pi / period_s
    z = np.exp(1j * omega * period_s)
    return z, 2.0 / period_s * (z - 1.0) / (z + 1.0)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("period_s", [0.0112, 0.3])
def test_hold_and_whole_delay_agree_with_scipy(name: str, period_s: float) -> None:
    num, den = map(np.array, SYSTEMS[name])
    plane = delayed(zero_order_hold(TransferFunction(num, den), period_s), period_s, 2)
    z, s = on_the_unit_circle(period_s)
    # In state space, since scipy's num/den loses half its digits at the short period.
    A, B, C, D, _ = scipy.signal.cont2discrete(scipy.signal.tf2ss(num, den), period_s)
    responses = [(C @ np.linalg.solve(point * np.eye(len(A)) - A, B) + D)[0, 0] for point in z]
    expected = np.array(responses) / z**2
    np.testing.assert_allclose(response(plane, s), expected, rtol=1e-9)
    in_z = to_z(plane, period_s)
    is_fast = np.angle(z) > 0.04 * np.pi
    np.testing.assert_allclose(response(in_z, z)[is_fast], expected[is_fast], rtol=1e-7)


def finely_sampled(
    num: list[float], den: list[float], period_s: float, substeps: int, late: int, z: ComplexArray
) -> ComplexArray:
    """Return the response at z of hold, plant and a delay of ``late`` / ``substeps`` periods.

    The plant is sampled ``substeps`` times in a period. So the delay is a whole number of substeps, and u[k]
    begins to act in the substep ``late``.
    """
    A, B, C, D, _ = scipy.signal.cont2discrete(scipy.signal.tf2ss(num, den), period_s / substeps)
    whole, fraction = divmod(late, substeps)
    n = len(A)
    over_period, of_previous, of_present = np.eye(n), np.zeros((n, 1)), np.zeros((n, 1))
    for i in range(substeps):
        of_previous = A @ of_previous + (B if i < fraction else 0.0)
        of_present = A @ of_present + (B if i >= fraction else 0.0)
        over_period = A @ over_period
    found = []
    for point in z:
        previous, present = point ** (-whole - 1.0), point ** (-float(whole))
        x = np.linalg.solve(point * np.eye(n) - over_period, of_previous * previous + of_present * present)
        found.append((C @ x)[0, 0] + D[0, 0] * (previous if fraction else present))
    return np.array(found)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("period_s", [0.0112, 0.3])
@pytest.mark.parametrize(
    ("substeps", "late"), [(2, 1), (7, 3), (7, 13), (1000, 1), (1000, 999), (5, 98), (1, 20)]
)
def test_a_delay_of_any_length_is_exact(name: str, period_s: float, substeps: int, late: int) -> None:
    num, den = SYSTEMS[name]
    G = TransferFunction(np.array(num), np.array(den))
    plane = zero_order_hold(G, period_s, late * period_s / substeps)
    z, s = on_the_unit_circle(period_s)
    np.testing.assert_allclose(
        response(plane, s), finely_sampled(num, den, period_s, substeps, late, z), rtol=1e-9
    )


@pytest.mark.parametrize("samples", [0, 1, 3, 20])
def test_a_delay_of_whole_periods_adds_one_pole_for_each(samples: int) -> None:
    """Decimal periods, such as 3 * 0.0112, are whole in spite of rounding."""
    G = TransferFunction(*map(np.array, SYSTEMS["paper"]))
    by_seconds = zero_order_hold(G, 0.0112, samples * 0.0112)
    by_samples = delayed(zero_order_hold(G, 0.0112), 0.0112, samples)
    for one, other in zip(by_seconds, by_samples, strict=True):
        assert one.tolist() == other.tolist()
    assert len(zero_order_hold(G, 0.0112, 0.3 * 0.0112).den) == len(G.den) + 1


def test_the_response_changes_continuously_with_the_delay() -> None:
    G = TransferFunction(*map(np.array, SYSTEMS["paper"]))
    _, s = on_the_unit_circle(0.0112)
    for samples in (0, 1, 2):
        at = response(zero_order_hold(G, 0.0112, samples * 0.0112), s)
        for change_s in (-1e-9, 1e-9):
            if samples * 0.0112 + change_s >= 0.0:
                near = response(zero_order_hold(G, 0.0112, samples * 0.0112 + change_s), s)
                np.testing.assert_allclose(near, at, rtol=1e-5)


def test_a_delay_of_too_many_periods_is_refused() -> None:
    G = TransferFunction(*map(np.array, SYSTEMS["paper"]))
    with pytest.raises(DesignError, match=r"0.2296 s, is 20.5 periods of 0.0112 s; the largest delay is 20"):
        zero_order_hold(G, 0.0112, (MAX_DELAY_SAMPLES + 0.5) * 0.0112)


def test_tustins_rule() -> None:
    # 11 + 5.6/s
    H = to_z(TransferFunction(np.array([11.0, 5.6]), np.array([1.0, 0.0])), 0.0112)
    np.testing.assert_allclose(H.den, [1.0, -1.0])
    np.testing.assert_allclose(H.num, [11.0 + 0.0056 * 5.6, -11.0 + 0.0056 * 5.6], rtol=1e-12)


@pytest.mark.parametrize("delay_s", [0.0, 0.03])
def test_an_undamped_mode_at_half_the_sampling_frequency_is_refused(delay_s: float) -> None:
    period_s = 0.1
    invisible = TransferFunction(np.array([1.0]), np.array([1.0, 0.0, (np.pi / period_s) ** 2]))
    with pytest.raises(DesignError, match="half the sampling frequency"):
        zero_order_hold(invisible, period_s, delay_s)


def test_frequencies_of_the_bilinear_plane() -> None:
    sampling = Sampling(0.0112)
    assert float(sampling.warp(100.0)) > 100.0
    assert float(sampling.unwarp(sampling.warp(100.0))) == pytest.approx(100.0)
    assert float(sampling.unwarp(np.inf)) == pytest.approx(np.pi / 0.0112)
