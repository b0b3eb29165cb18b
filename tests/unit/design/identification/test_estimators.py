"""The estimators on data of known systems."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from support.identification_data import (
    PAPER,
    PAPER_DEN,
    PERIOD_S,
    clean_fit,
    paper_record,
    prbs,
    random_plant,
)

from design.errors import DesignError
from design.identification.analysis.uncertainty import coefficients
from design.identification.estimators.box_jenkins import noise_start
from design.identification.estimators.estimate import Estimate
from design.identification.estimators.fit import fit
from design.identification.estimators.noise_filters import monic
from design.identification.models.held_discretisation import hold
from design.identification.models.model import ContinuousModel
from design.identification.models.structures import (
    Armax,
    Arx,
    BoxJenkins,
    ContinuousPoles,
    OutputError,
    parse_structure,
)
from design.identification.records.experiment import Experiment


def assert_within(estimate: Estimate, expected: dict[str, float], deviations: float = 4.0) -> None:
    """All coefficients lie within so many standard deviations of the expected ones."""
    names, values, covariance = coefficients(estimate)
    assert set(names) == set(expected)
    for name, value, std in zip(names, values, np.sqrt(np.diag(covariance)), strict=True):
        assert value == pytest.approx(expected[name], abs=deviations * std), name


@pytest.mark.parametrize(
    ("noise_share", "least"), [(0.01, 99.97), (0.05, 99.85), (0.20, 99.4)], ids=["1 %", "5 %", "20 %"]
)
def test_output_error_on_the_papers_plant(noise_share: float, least: float) -> None:
    estimate = fit([paper_record(1, noise_share)], OutputError())
    assert clean_fit(estimate.discrete, 1) > least
    assert estimate.converged
    assert estimate.noise_order == 0
    assert estimate.samples == 5357
    assert estimate.unknowns == 4 + 3 + 1


def test_without_noise_the_model_is_exact() -> None:
    estimate = fit([paper_record(1, 0.0)], OutputError(3, 3, 1))
    np.testing.assert_allclose(estimate.discrete.f, PAPER.f, rtol=1e-9)
    np.testing.assert_allclose(estimate.discrete.b, PAPER.b, rtol=1e-5)
    assert estimate.converged


def test_the_callers_arrays_are_not_altered() -> None:
    record = paper_record(1)
    u, y = np.array(record.u), np.array(record.y)
    y[5] = np.nan
    before = u.copy(), y.copy()
    for structure in ("OE(1,3,1)", "ARX(3,3,1)", "ARMAX(3,2,2,1)", "BJ(1,1,1,3,1)", "continuous"):
        fit([Experiment(u, y, PERIOD_S)], parse_structure(structure))
    np.testing.assert_array_equal(u, before[0])
    np.testing.assert_array_equal(y, before[1])


def test_the_residuals_are_measured_minus_model() -> None:
    record = paper_record(2, offset := 0.05).masked(np.arange(5357) % 7 == 3)
    estimate = fit([record], OutputError())
    (residual,) = estimate.residuals
    assert np.flatnonzero(np.isnan(residual)).tolist() == list(range(3, 5357, 7))
    error = residual[np.isfinite(residual)]
    assert estimate.cost == pytest.approx(error @ error)
    assert estimate.noise_std == pytest.approx(offset * np.std(PAPER.simulate(record.u)), rel=0.05)


def test_gaps_of_the_output_are_masked() -> None:
    record = paper_record(3)
    gaps = np.random.default_rng(3).random(5357) < 0.4
    gaps[1000:1400] = True
    y = np.where(gaps, np.nan, record.y)
    spoiled = np.where(gaps, 1e6, record.y)
    estimate = fit([Experiment(record.u, y, PERIOD_S)], OutputError())
    masked = fit([Experiment(record.u, spoiled, PERIOD_S).masked(gaps)], OutputError())
    assert clean_fit(estimate.discrete, 3) > 99.9
    np.testing.assert_allclose(masked.discrete.f, estimate.discrete.f, rtol=1e-9)


def test_the_state_is_estimated_anew_after_unknown_inputs() -> None:
    record = paper_record(4)
    u = np.array(record.u)
    u[2000:2100] = np.nan
    true_u = np.where(np.isnan(u), 3.0, u)
    y = PAPER.simulate(true_u) + 1e-4 * np.random.default_rng(4).standard_normal(5357)
    estimate = fit([Experiment(u, y, PERIOD_S)], OutputError())
    assert clean_fit(estimate.discrete, 4) > 99.9
    assert estimate.unknowns == 4 + 2 * 3 + 1


def test_weights_count() -> None:
    record = paper_record(5)
    spoiled = np.array(record.y)
    spoiled[3000:] += 0.1 * np.random.default_rng(5).standard_normal(2357)
    weights = np.where(np.arange(5357) < 3000, 1.0, 1e-4)
    weighted = fit([Experiment(record.u, spoiled, PERIOD_S, weights=weights)], OutputError())
    plain = fit([Experiment(record.u, spoiled, PERIOD_S)], OutputError())
    assert clean_fit(weighted.discrete, 5) > 99.9 > clean_fit(plain.discrete, 5)


def test_several_experiments_each_with_offset_and_initial_state() -> None:
    records = []
    for seed, (start, offset) in enumerate([(0.5, 0.1), (-0.3, -7.0), (0.0, 3.0)]):
        record = paper_record(seed, 0.05, 2000)
        moved = PAPER.simulate(np.concatenate([np.full(500, start), record.u]))[500:]
        noise = record.y - PAPER.simulate(record.u)
        records.append(Experiment(record.u, moved + noise + offset, PERIOD_S, name=f"record {seed}"))
    estimate = fit(records, OutputError())
    assert clean_fit(estimate.discrete, 1) > 99.8
    assert [round(o.output_offset or 0.0, 1) for o in estimate.offsets] == [0.1, -7.0, 3.0]
    assert estimate.unknowns == 4 + 3 * (3 + 1)


def test_experiments_of_different_sample_times_are_refused() -> None:
    first = paper_record(1)
    second = Experiment(first.u, first.y, 0.01, name="other.csv")
    with pytest.raises(DesignError, match=r"other\.csv: sample time 0\.01 s, but record has 0\.0112 s"):
        fit([first, second], OutputError())
    with pytest.raises(DesignError, match="no experiment"):
        fit([], OutputError())


def test_a_drift_is_estimated_with_the_model() -> None:
    record = paper_record(6)
    drifting = Experiment(record.u, record.y + 0.3 + 0.002 * record.time_s, PERIOD_S)
    estimate = fit([drifting], OutputError(), drift=True)
    assert clean_fit(estimate.discrete, 6) > 99.9
    assert estimate.offsets[0].drift_per_s == pytest.approx(0.002, rel=0.01)


@pytest.mark.parametrize(
    "structure", ["OE(1,3,1)", "ARX(3,3,1)", "ARMAX(3,2,2,1)", "BJ(1,1,1,3,1)", "continuous"]
)
def test_too_few_samples_for_the_unknowns(structure: str) -> None:
    record = paper_record(1, samples=12)
    with pytest.raises(DesignError, match=r"12|9|10|11 usable output samples for .* unknowns"):
        fit([record], parse_structure(structure))


@pytest.mark.parametrize("order", range(1, 7))
def test_random_plants_of_any_order(order: int) -> None:
    """With little noise the response is that of the plant, dead time and lightly damped modes included."""
    random = np.random.default_rng(100 + order)
    omega = np.geomspace(0.02, 1.5, 40)
    for delay in (0, 3):
        plant = random_plant(random, order, delay).model
        u = prbs(3000, 2, random)
        y = plant.simulate(u)
        y = y + 1e-4 * y.std() * random.standard_normal(3000) - 3.0
        estimate = fit([Experiment(u, y, 1.0)], OutputError(order, order, 1 + delay))
        error = np.abs(estimate.discrete.at(omega) - plant.at(omega))
        assert error.max() < 0.01 * np.abs(plant.at(omega)).max()


def test_poles_that_no_continuous_plant_has() -> None:
    """The search goes on in the coefficients of F, where the logarithms of continuous poles end."""
    random = np.random.default_rng(1)
    u = prbs(3000, 1, random)
    y = lfilter([0.0, 1.0], np.poly([0.9, -0.6]), u)
    estimate = fit([Experiment(u, y + 1e-3 * random.standard_normal(3000), 1.0)], OutputError(1, 2, 1))
    np.testing.assert_allclose(np.sort(estimate.discrete.poles_z.real), [-0.6, 0.9], atol=1e-3)


def test_no_poles_at_all() -> None:
    random = np.random.default_rng(2)
    u = prbs(500, 1, random)
    y = lfilter([0.0, 0.0, 1.0, -0.4], [1.0], u) + 0.5
    estimate = fit([Experiment(u, y, 1.0)], OutputError(2, 0, 2))
    np.testing.assert_allclose(estimate.discrete.b, [1.0, -0.4], atol=1e-9)
    assert estimate.offsets[0].output_offset == pytest.approx(0.5)


@pytest.mark.parametrize("dead_s", [0.0, 0.0186, 0.045])
def test_a_dead_time_that_is_no_whole_number_of_samples(dead_s: float) -> None:
    plant = hold(ContinuousModel(np.array([43.5]), PAPER_DEN, dead_s), PERIOD_S)
    random = np.random.default_rng(7)
    u = prbs(5357, 12, random)
    y = plant.simulate(u)
    y = y + 0.01 * y.std() * random.standard_normal(5357)
    estimate = fit([Experiment(u, y, PERIOD_S)], ContinuousPoles(1, 1, max_dead_time_s=0.1))
    std = float(np.sqrt(estimate.parameters.covariance[-1, -1])) * PERIOD_S
    assert estimate.continuous is not None
    assert estimate.continuous.dead_time_s == pytest.approx(dead_s, abs=4.0 * std + 1e-4)
    assert std < 2e-3
    assert not estimate.at_bound
    np.testing.assert_allclose(estimate.discrete.at([1.0, 10.0]), plant.at([1.0, 10.0]), rtol=0.01)


def test_an_integrator_shows_the_offset_of_its_input() -> None:
    plant = hold(ContinuousModel(np.array([40.0]), np.polymul([1.0, 0.0], [1.0, 17.0, 168.0])), PERIOD_S)
    random = np.random.default_rng(8)
    u = prbs(5357, 12, random)
    y = plant.simulate(u + 0.02) + 3.0 + 1e-4 * random.standard_normal(5357)
    estimate = fit([Experiment(u, y, PERIOD_S)], ContinuousPoles(0, 1, integrators=1))
    assert estimate.continuous is not None
    np.testing.assert_allclose(estimate.continuous.den, [1.0, 17.0, 168.0, 0.0], rtol=0.01)
    assert estimate.continuous.num[0] == pytest.approx(40.0, rel=0.01)
    assert estimate.offsets[0].input_offset == pytest.approx(-0.02, rel=0.01)
    assert estimate.offsets[0].output_offset is None


def test_zeros_on_either_side() -> None:
    random = np.random.default_rng(9)
    u = prbs(4000, 6, random)
    for zero in (-3.0, 3.0):
        plant = hold(ContinuousModel(np.array([10.0, -10.0 * zero]), PAPER_DEN), PERIOD_S)
        y = plant.simulate(u) + 1e-4 * random.standard_normal(4000)
        estimate = fit([Experiment(u, y, PERIOD_S)], ContinuousPoles(1, 1, zeros=1))
        assert estimate.continuous is not None
        assert estimate.continuous.zeros[0].real == pytest.approx(zero, rel=0.02)


def test_a_long_record_is_searched_in_parts_and_fitted_as_a_whole() -> None:
    random = np.random.default_rng(10)
    slow = hold(ContinuousModel(np.array([0.001]), np.polymul([1.0, 0.0002], [1.0, 0.4, 1.0])), 1.0)
    u = np.concatenate([np.zeros(30_000), prbs(30_000, 200, random)])
    y = slow.simulate(u)
    y = y + 0.01 * y.std() * random.standard_normal(60_000)
    estimate = fit([Experiment(u, y, 1.0)], OutputError(3, 3, 1))
    omega = np.geomspace(1e-4, 0.02, 10)
    np.testing.assert_allclose(np.abs(estimate.discrete.at(omega) / slow.at(omega)), 1.0, atol=0.02)
    assert estimate.samples == 60_000


A, B, C, D = (np.array(p) for p in ([1.0, -1.5, 0.7], [0.0, 1.0, 0.5], [1.0, -0.8, 0.3], [1.0, -0.9]))


def armax_record(seed: int, e_std: float = 0.3, *, c: bool = True, d: bool = False) -> Experiment:
    """A y = B u + C e or, with ``d``, y = B/A u + C/D e; an offset of 0.5."""
    random = np.random.default_rng(seed)
    u = prbs(4000, 3, random)
    e = e_std * random.standard_normal(4000)
    noise = lfilter(C if c else [1.0], D if d else A, e)
    return Experiment(u, lfilter(B, A, u) + noise + 0.5, 1.0)


COMMON = {"b0": 1.0, "b1": 0.5, "f1": -1.5, "f2": 0.7}


def test_arx() -> None:
    estimate = fit([armax_record(1, c=False)], Arx(2, 2, 1))
    assert_within(estimate, COMMON)
    assert estimate.noise_std == pytest.approx(0.3, rel=0.05)
    assert estimate.noise_order == 0
    assert estimate.offsets[0].output_offset == pytest.approx(0.5, abs=0.1)
    np.testing.assert_array_equal(estimate.discrete.d, estimate.discrete.f)


def test_armax() -> None:
    estimate = fit([armax_record(2)], Armax(2, 2, 2, 1))
    assert_within(estimate, {**COMMON, "c1": -0.8, "c2": 0.3})
    assert estimate.noise_order == 0
    assert estimate.converged


def test_box_jenkins() -> None:
    estimate = fit([armax_record(3, 0.1, d=True)], BoxJenkins(2, 2, 1, 2, 1))
    assert_within(estimate, {**COMMON, "c1": -0.8, "c2": 0.3, "d1": -0.9})
    assert estimate.noise_order == 0


def test_coloured_noise_is_reported_and_widens_the_intervals_of_an_output_error_model() -> None:
    record = armax_record(4, 0.1, d=True)
    estimate = fit([record], OutputError(2, 2, 1))
    assert estimate.noise_order > 0
    assert_within(estimate, COMMON)


@pytest.mark.parametrize("structure", ["ARX(2,2,1)", "ARMAX(2,2,2,1)", "BJ(2,2,2,2,1)"])
def test_predictors_begin_anew_after_gaps(structure: str) -> None:
    record = armax_record(5, c=structure != "ARX(2,2,1)")
    y = np.array(record.y)
    y[::50] = np.nan
    estimate = fit([Experiment(record.u, y, 1.0), record], parse_structure(structure), drift=True)
    np.testing.assert_allclose(estimate.discrete.f, A, atol=0.02)
    assert np.isnan(estimate.residuals[0][100])
    assert estimate.noise_std == pytest.approx(0.3, rel=0.05)
    assert abs(estimate.offsets[0].drift_per_s) < 1e-3


def test_start_values_of_a_noise_model() -> None:
    random = np.random.default_rng(6)
    v = lfilter(C, D, random.standard_normal(5000))
    found = noise_start([v], 2, 1)
    assert found is not None
    np.testing.assert_allclose(monic(found[0]), C, atol=0.1)
    np.testing.assert_allclose(monic(found[1]), D, atol=0.05)
    assert noise_start([v[:30]], 2, 1) is None


def test_criteria_prefer_the_true_order() -> None:
    record = paper_record(11, 0.05)
    estimates = [fit([record], OutputError(1, nf, 1)) for nf in (2, 3, 4)]
    assert min(estimates, key=lambda estimate: estimate.bic) is estimates[1]
    assert estimates[0].aic > estimates[1].aic
