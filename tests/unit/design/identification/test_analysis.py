"""Models beside data: simulation and fit, residual tests, intervals, responses measured without a model."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from support.identification_data import PAPER, PERIOD_S, noise, paper_record, prbs

from design.errors import DesignError
from design.identification.analysis.comparison import compare, fit_percent, overall_fit
from design.identification.analysis.frequency_response import (
    FrequencyResponse,
    Method,
    averaged_spectra,
    frequency_response,
    local_rational,
    periodic_lines,
)
from design.identification.analysis.residuals import analyse_residuals
from design.identification.analysis.uncertainty import Quantity, Root, properties, response_band
from design.identification.estimators.correlation import autocorrelation
from design.identification.estimators.covariance import noise_autoregression
from design.identification.estimators.fit import fit
from design.identification.models.held_discretisation import hold
from design.identification.models.model import ContinuousModel, DiscreteModel
from design.identification.models.structures import ContinuousPoles, OutputError
from design.identification.records.experiment import Experiment
from design.mathematics.polynomials import Array


def test_the_fit_is_that_of_a_free_run_with_offset_and_initial_state_fitted() -> None:
    record = paper_record(1, 0.0)
    moving = Experiment(record.u[100:], record.y[100:] + 3.0, PERIOD_S)
    comparison = compare(PAPER, moving)
    assert comparison.fit_percent == pytest.approx(100.0, abs=1e-6)
    np.testing.assert_allclose(comparison.simulated, moving.y, atol=1e-9)
    np.testing.assert_allclose(comparison.error, 0.0, atol=1e-9)


def test_the_models_own_gain_is_used() -> None:
    record = paper_record(1, 0.0)
    double = DiscreteModel(2.0 * PAPER.b, PAPER.f, PAPER.nk, PERIOD_S)
    # The error is then the output itself, without what the initial state and the offset explain of it.
    assert compare(double, record).fit_percent == pytest.approx(0.0, abs=10.0)
    assert compare(double, record).input_percent == pytest.approx(0.0, abs=1e-6)


def test_masked_samples_do_not_count_in_the_fit() -> None:
    record = paper_record(2, 0.0)
    spoiled = np.array(record.y)
    spoiled[1000:2000] = 99.0
    at = (np.arange(len(spoiled)) >= 1000) & (np.arange(len(spoiled)) < 2000)
    comparison = compare(PAPER, Experiment(record.u, spoiled, PERIOD_S).masked(at))
    assert comparison.fit_percent == pytest.approx(100.0, abs=1e-6)
    assert np.isnan(comparison.error[1500])


def test_the_fit_of_several_records_weighs_their_motions() -> None:
    large, small = paper_record(3, 0.0), paper_record(4, 0.0)
    noisy = 0.01 * small.y + 0.005 * np.random.default_rng(1).standard_normal(5357)
    small = Experiment(0.01 * small.u, noisy, PERIOD_S)
    fits = [compare(PAPER, record) for record in (large, small)]
    assert fits[1].fit_percent < 5.0
    assert overall_fit(fits) > 80.0
    assert np.isnan(overall_fit([]))


def test_no_fit_is_given_for_an_unstable_model() -> None:
    comparison = compare(DiscreteModel(np.ones(1), np.array([1.0, -1.1]), 1, PERIOD_S), paper_record(1))
    assert np.isnan(comparison.fit_percent)
    assert np.isnan(comparison.simulated).all()


def test_an_integrating_model_is_compared_with_an_input_offset() -> None:
    model = DiscreteModel(np.array([0.1]), np.array([1.0, -1.0]), 1, 1.0)
    u = prbs(500, 5, np.random.default_rng(1))
    record = Experiment(u, model.simulate(u + 0.05) + 7.0, 1.0)
    assert compare(model, record).fit_percent == pytest.approx(100.0, abs=1e-6)


def test_a_record_that_does_not_move() -> None:
    record = Experiment(np.ones(10), np.ones(10), 1.0)
    assert fit_percent(record, np.ones(10)) == 100.0
    assert fit_percent(record, np.zeros(10)) == -np.inf


def test_autocorrelation_leaves_missing_samples_out() -> None:
    random = np.random.default_rng(1)
    e = noise(20_000, "slow", 2.0, random)
    gaps = random.random(20_000) < 0.3
    whole, count = autocorrelation([e], 5)
    holed, fewer = autocorrelation([np.where(gaps, 0.0, e)], 5)
    np.testing.assert_allclose(whole, 0.9 ** np.arange(6), atol=0.02)
    np.testing.assert_allclose(holed, whole, atol=0.02)
    assert count == 20_000
    assert fewer == np.count_nonzero(~gaps)
    long, _ = autocorrelation([e], 200)
    np.testing.assert_allclose(long[:6], whole, atol=1e-12)


@pytest.mark.parametrize("colour", ["white", "slow", "resonant"])
def test_the_colour_of_residuals_is_found(colour: str) -> None:
    expected = {"white": [1.0], "slow": [1.0, -0.9], "resonant": [1.0, -1.6, 0.9]}[colour]
    found = noise_autoregression([noise(20_000, colour, 1.0, np.random.default_rng(2))])
    assert len(found.a) == len(expected)
    np.testing.assert_allclose(found.a, expected, atol=0.02)


def false_alarms(residuals: str, count: int = 60) -> Array:
    """How often each test rejects at the 5 % level, for residuals that are independent of the input."""
    rejected = np.zeros(3)
    for seed in range(count):
        random = np.random.default_rng(seed)
        u = prbs(2000, 7, random)
        experiment = Experiment(u, np.zeros(2000), 1.0)
        found = analyse_residuals([experiment], [noise(2000, residuals, 1.0, random)], level=0.95)
        rejected += [not found.whiteness.passed, not found.from_input.passed, not found.to_input.passed]
    return rejected / count


def test_residual_tests_reject_as_often_as_they_should() -> None:
    assert (false_alarms("white") <= 0.15).all()
    whiteness, from_input, to_input = false_alarms("slow")
    assert whiteness == 1.0
    assert max(from_input, to_input) <= 0.15


def test_missing_dynamics_and_feedback_are_told_apart() -> None:
    random = np.random.default_rng(1)
    u = random.standard_normal(4000)
    experiment = Experiment(u, np.zeros(4000), 1.0)
    e = random.standard_normal(4000)
    late = analyse_residuals([experiment], [e + 0.3 * np.concatenate([np.zeros(3), u[:-3]])])
    assert not late.from_input.passed
    assert int(np.argmax(np.abs(late.from_input.values))) == 3
    assert abs(late.from_input.values[3]) > late.from_input.bounds[3]
    assert late.to_input.passed
    early = analyse_residuals([experiment], [e + 0.3 * np.concatenate([u[3:], np.zeros(3)])])
    assert early.from_input.passed
    assert not early.to_input.passed
    assert early.to_input.lags[int(np.argmax(np.abs(early.to_input.values)))] == -3


def test_bounds_are_those_of_the_level() -> None:
    experiment = Experiment(np.ones(2500), np.zeros(2500), 1.0)
    e = np.random.default_rng(1).standard_normal(2500)
    e[::5] = np.nan
    found = analyse_residuals([experiment], [e], lags=3, level=0.95)
    # A pair needs two known samples.
    np.testing.assert_allclose(found.whiteness.bounds, 1.96 / np.sqrt(1500.0), rtol=0.01)


def test_intervals() -> None:
    low, high = Quantity(10.0, 2.0).interval()
    assert (low, high) == (pytest.approx(10.0 - 3.92, abs=0.01), pytest.approx(10.0 + 3.92, abs=0.01))
    low, high = Quantity(10.0, 2.0).interval(0.6827)
    assert (low, high) == (pytest.approx(8.0, abs=0.01), pytest.approx(12.0, abs=0.01))
    root = Root(-1.0 + 2.0j, np.diag([0.04, 0.01]))
    outline = root.ellipse(0.95)
    assert root.std == pytest.approx(np.sqrt(0.05))
    scores = (outline.real + 1.0) ** 2 / 0.04 + (outline.imag - 2.0) ** 2 / 0.01
    np.testing.assert_allclose(scores, 5.991, rtol=1e-3)


def test_properties_of_the_papers_plant() -> None:
    estimate = fit([paper_record(1, 0.05)], OutputError())
    found = properties(estimate)
    assert found.gain is not None
    assert found.velocity_gain is not None
    assert found.gain.value == pytest.approx(0.6126, abs=4.0 * found.gain.std)
    assert found.velocity_gain.value == pytest.approx(0.2592, abs=4.0 * found.velocity_gain.std)
    slow, *mode = found.poles
    assert slow.value.real == pytest.approx(-0.4231, abs=4.0 * slow.std)
    assert mode[0].value.conjugate() == pytest.approx(mode[1].value)
    (oscillation,) = found.modes
    frequency, damping = oscillation.natural_frequency_rad_s, oscillation.damping
    assert frequency.value == pytest.approx(12.958, abs=4.0 * frequency.std)
    assert damping.value == pytest.approx(0.6548, abs=4.0 * damping.std)
    assert 0.0 < damping.std < 0.02
    assert found.zeros is not None
    assert len(found.zeros) == 2
    assert found.dead_time_s == Quantity(0.0, 0.0)


def test_properties_of_a_continuous_model_with_integrator_and_dead_time() -> None:
    plant = hold(
        ContinuousModel(np.array([40.0]), np.polymul([1.0, 0.0], [1.0, 17.0, 168.0]), 0.03), PERIOD_S
    )
    random = np.random.default_rng(1)
    u = prbs(4000, 12, random)
    y = plant.simulate(u) + 1e-4 * random.standard_normal(4000)
    found = properties(fit([Experiment(u, y, PERIOD_S)], ContinuousPoles(0, 1, 0, 1, 0.1)))
    assert found.gain is None
    assert found.velocity_gain is not None
    assert found.velocity_gain.value == pytest.approx(40.0 / 168.0, abs=4.0 * found.velocity_gain.std)
    assert found.dead_time_s.value == pytest.approx(0.03, abs=4.0 * found.dead_time_s.std)
    assert found.dead_time_s.std > 0.0
    assert found.zeros == ()


def test_a_model_without_continuous_counterpart_has_no_zeros() -> None:
    random = np.random.default_rng(1)
    u = prbs(2000, 1, random)
    model = DiscreteModel(np.ones(1), np.poly([0.9, -0.6]), 1, 1.0)
    record = Experiment(u, model.simulate(u) + 0.01 * random.standard_normal(2000), 1.0)
    assert properties(fit([record], OutputError(1, 2, 1))).zeros is None


def test_the_band_covers_the_true_response() -> None:
    omega = np.geomspace(0.2, 40.0, 12)
    outside = 0
    for seed in range(20):
        band = response_band(fit([paper_record(seed, 0.1, 2000)], OutputError()), omega)
        ratio = band.response / PAPER.at(omega)
        outside += np.count_nonzero(np.abs(np.log(np.abs(ratio))) > 2.576 * band.magnitude_std)
        outside += np.count_nonzero(np.abs(np.angle(ratio)) > 2.576 * band.phase_std_rad)
    assert outside <= 0.05 * 2 * 20 * len(omega)


def scores(response: FrequencyResponse, model: DiscreteModel) -> Array:
    """Squared distance of a measured response from the true one, in units of its variance."""
    error = np.abs(response.response - model.at(response.omega_rad_s))
    return np.asarray(error**2 / (2.0 * response.std**2))


def test_averaged_spectra_with_their_uncertainty() -> None:
    found = averaged_spectra([paper_record(1, 0.05), paper_record(2, 0.05)], 512)
    assert found.method is Method.AVERAGED_SPECTRA
    inside = (found.omega_rad_s > 5.0) & (found.omega_rad_s < 35.0)
    assert 0.5 < np.median(scores(found, PAPER)[inside]) < 1.5
    assert found.coherence[inside][0] > 0.95 > found.coherence[-1]


def test_local_rational_responses_reach_below_a_slow_pole() -> None:
    found = local_rational([paper_record(1, 0.01)])
    low = found.omega_rad_s < 20.0
    assert found.omega_rad_s[0] == pytest.approx(2.0 * np.pi / 60.0, rel=0.01)
    error = np.abs(found.response / PAPER.at(found.omega_rad_s) - 1.0)
    assert np.median(error[low]) < 0.01
    assert 0.3 < np.median(scores(found, PAPER)[low]) < 1.5
    assert found.coherence[low].min() > 0.9
    assert all(a < b for a, b in pairwise(found.omega_rad_s))


def test_exact_lines_of_a_periodic_input() -> None:
    random = np.random.default_rng(1)
    period, lines = 893, np.arange(1, 60, 2)
    phases = random.uniform(0.0, 2.0 * np.pi, len(lines))
    one = np.cos(2.0 * np.pi * np.outer(np.arange(period) / period, lines) + phases).sum(axis=1)
    u = np.tile(one, 8)
    y = PAPER.simulate(u)
    record = Experiment(u, y + 0.01 * y.std() * random.standard_normal(len(y)), PERIOD_S)
    found = frequency_response([record], period_samples=period)
    assert found.method is Method.PERIODIC_LINES
    np.testing.assert_allclose(found.omega_rad_s, lines * 2.0 * np.pi / (period * PERIOD_S))
    np.testing.assert_allclose(found.response[:10], PAPER.at(found.omega_rad_s[:10]), rtol=0.01)
    assert 0.5 < np.median(scores(found, PAPER)) < 1.7
    assert found.coherence[0] > 0.999


def test_responses_use_runs_between_gaps() -> None:
    record = paper_record(5)
    y = np.array(record.y)
    y[[1500, 3200]] = np.nan
    found = frequency_response([Experiment(record.u, y, PERIOD_S)])
    at_5 = int(np.argmin(np.abs(found.omega_rad_s - 5.0)))
    np.testing.assert_allclose(
        found.response[at_5], PAPER.at(found.omega_rad_s[at_5 : at_5 + 1])[0], rtol=0.05
    )


@pytest.mark.parametrize(
    ("measure", "message"),
    [
        (lambda e: averaged_spectra(e, 400), "1 segments of 400 samples"),
        (lambda e: periodic_lines(e, 300), "1 whole periods of 300 samples"),
        (lambda e: local_rational([e[0].part(0, 50)]), "no run of 64 samples"),
    ],
)
def test_records_that_are_too_short_for_a_response(measure: object, message: str) -> None:
    with pytest.raises(DesignError, match=message):
        measure([paper_record(1, samples=500)])  # type: ignore[operator]
