"""The whole way from a record to a model, and orders side by side."""

from __future__ import annotations

import numpy as np
import pytest
from support.arm_bench import excite
from support.identification_data import PAPER_DEN, PERIOD_S, paper_record, prbs

import design
from design.errors import DesignError
from design.identification.analysis.frequency_response import Method
from design.identification.checks.expectations import Expectations
from design.identification.findings import Kind, Severity
from design.identification.identify import identify, identify_experiments
from design.identification.models.held_discretisation import hold
from design.identification.models.model import ContinuousModel
from design.identification.models.structures import Arx, ContinuousPoles, OutputError, parse_structure
from design.identification.order_search import (
    MAX_CONTINUOUS_ORDER,
    Criterion,
    orders_of_kind,
    output_error_orders,
    search_orders,
)
from design.identification.records.experiment import Experiment, Names
from firmware_sim import shipped_arm


def test_the_last_third_is_kept_from_the_fit() -> None:
    record = paper_record(1)
    found = identify(record.u, record.y, PERIOD_S, name="run.csv", names=Names("valve", "position"))
    (fitted,) = found.estimate.experiments
    (other,) = (comparison.experiment for comparison in found.validation)
    assert len(fitted) + len(other) == len(record)
    assert len(fitted) == 3571
    np.testing.assert_array_equal(np.concatenate([fitted.y, other.y]), record.y)
    assert other.name == "run.csv, last third"
    assert fitted.names.y == "position"
    assert 98.5 < found.fit_percent < 99.5
    assert found.estimation_fit_percent == pytest.approx(found.fit_percent, abs=0.3)


def test_the_models_are_the_paper() -> None:
    record = paper_record(2)
    found = identify(record.u, record.y, PERIOD_S)
    assert found.structure == OutputError(1, 3, 1)
    assert found.continuous is not None
    np.testing.assert_allclose(found.continuous.den, PAPER_DEN, rtol=0.05)
    assert found.continuous.num[-1] == pytest.approx(43.5, rel=0.02)
    assert found.dead_time_s == 0.0
    assert found.contains_delay_samples == 0
    assert found.nearest is None
    np.testing.assert_allclose(hold(found.continuous, PERIOD_S).f, found.discrete.f, atol=1e-9)
    assert found.frequency_response().method is Method.LOCAL_RATIONAL


def test_other_records_validate() -> None:
    first, second = paper_record(3, name="first"), paper_record(4, name="second")
    found = identify_experiments([first], validation=[second])
    assert len(found.estimate.experiments[0]) == len(first)
    assert [comparison.experiment.name for comparison in found.validation] == ["second"]
    with pytest.raises(DesignError, match="estimation and validation data are the same"):
        identify_experiments([first], validation=[paper_record(3)])
    with pytest.raises(DesignError, match="no experiment"):
        identify_experiments([])


def test_a_sample_time_that_is_no_number_is_refused() -> None:
    with pytest.raises(DesignError, match="sample time 'fast' is not a number; give a number of seconds"):
        identify(np.ones(100), np.ones(100), "fast")  # type: ignore[arg-type]


def delayed_rig(seed: int, delay: int) -> Experiment:
    """A rig that applies each recorded input some periods later."""
    record = paper_record(seed)
    u = np.concatenate([record.u[delay:], prbs(delay, 1, np.random.default_rng(seed))])
    return Experiment(u, record.y, PERIOD_S, transport_delay_samples=delay, name=f"run {seed}")


def test_the_rigs_transport_delay_is_counted_once() -> None:
    record = delayed_rig(5, 2)
    without = identify_experiments([record])
    assert without.contains_delay_samples == 0
    assert without.dead_time_s == 0.0
    contained = identify_experiments([record], structure="OE(1,3,3)", remove_transport_delay=False)
    assert contained.contains_delay_samples == 2
    assert contained.dead_time_s == pytest.approx(2 * PERIOD_S)
    np.testing.assert_allclose(contained.discrete.f, without.discrete.f, rtol=1e-3)
    own_s = contained.dead_time_s - contained.contains_delay_samples * PERIOD_S
    assert own_s == pytest.approx(without.dead_time_s)
    ignored = identify_experiments([record], remove_transport_delay=False)
    (note, *_) = [finding for finding in ignored.findings if finding.kind is Kind.DEAD_TIME]
    assert note.figure == 3.0
    assert "(limit 1 %)" in note.text


def test_a_dead_time_that_costs_less_than_its_limit_is_not_mentioned() -> None:
    half = hold(ContinuousModel(np.array([43.5]), PAPER_DEN, 0.5 * PERIOD_S), PERIOD_S)
    u = prbs(6001, 12, np.random.default_rng(1))
    y = half.simulate(u)
    y = y + 0.003 * y.std() * np.random.default_rng(2).standard_normal(6001)
    found = identify(u, y, PERIOD_S)
    assert not found.residuals.from_input.passed
    assert Kind.DEAD_TIME not in {finding.kind for finding in found.findings}


def test_records_of_different_rigs_are_refused() -> None:
    with pytest.raises(DesignError, match="transport delays of 1, 2 samples"):
        identify_experiments([delayed_rig(1, 1), delayed_rig(2, 2)])


def test_a_fractional_dead_time_beside_the_rigs_own() -> None:
    plant = hold(ContinuousModel(np.array([43.5]), PAPER_DEN, 0.4 * PERIOD_S), PERIOD_S)
    random = np.random.default_rng(1)
    u = prbs(6001, 12, random)
    y = plant.simulate(u)
    y = y + 0.003 * y.std() * random.standard_normal(6001)
    record = Experiment(u[1:], y[:-1], PERIOD_S, transport_delay_samples=1)
    structure = "continuous(real=1, pairs=1, max_dead_time_s=0.05)"
    for removed, dead in ((True, 0.4), (False, 1.4)):
        found = identify_experiments([record], structure=structure, remove_transport_delay=removed)
        std = found.properties.dead_time_s.std
        assert found.dead_time_s == pytest.approx(dead * PERIOD_S, abs=4.0 * std)
        assert std < 0.1 * PERIOD_S


def test_several_records_share_one_model() -> None:
    records = [paper_record(seed, 0.1, 2500, name=f"run {seed}") for seed in (1, 2, 3)]
    alone, together = identify_experiments(records[:1]), identify_experiments(records)
    assert len(together.validation) == 3
    assert together.properties.gain is not None
    assert alone.properties.gain is not None
    assert together.properties.gain.std < alone.properties.gain.std


def test_a_sampled_model_without_continuous_counterpart_is_doubtful() -> None:
    random = np.random.default_rng(1)
    u = prbs(3000, 1, random)
    y = np.zeros(3000)
    for k in range(2, 3000):
        y[k] = 0.7 * y[k - 1] + 0.18 * y[k - 2] + u[k - 1]
    found = identify(u, y + 0.01 * random.standard_normal(3000), PERIOD_S, structure="OE(1,2,1)")
    assert found.continuous is None
    assert found.nearest is not None
    assert found.nearest.fit_percent > 90.0
    (finding,) = [finding for finding in found.findings if finding.kind is Kind.NO_CONTINUOUS_MODEL]
    assert "the nearest one follows it to" in finding.text
    assert found.dead_time_s == 0.0


def test_a_drift_that_is_estimated_is_no_finding() -> None:
    record = paper_record(6)
    y = record.y + 0.002 * record.time_s
    assert identify(record.u, y, PERIOD_S).doubtful
    assert not identify(record.u, y, PERIOD_S, drift=True).doubtful


@pytest.mark.parametrize("seed", [1, 2])
def test_the_simulated_arm_identifies_as_equation_15(seed: int) -> None:
    """The tolerances are those of the arm's calibration; at 0.4 V its own slow pole is 14 % faster."""
    u, y = excite(shipped_arm(), 0, 0.4, seed=seed)
    found = identify(u, y, PERIOD_S, expected=Expectations(PERIOD_S, (-5.0, 5.0), (-0.15, 0.15)))
    assert found.fit_percent > 98.0
    assert not found.doubtful
    assert {finding.severity for finding in found.findings} <= {Severity.NOTE}
    (mode,) = found.properties.modes
    assert found.properties.velocity_gain is not None
    assert found.properties.velocity_gain.value == pytest.approx(0.2592, rel=0.05)
    assert -found.properties.poles[0].value.real == pytest.approx(0.4231, rel=0.15)
    assert mode.natural_frequency_rad_s.value == pytest.approx(12.958, rel=0.10)
    assert mode.damping.value == pytest.approx(0.6548, rel=0.15)


def test_the_public_name() -> None:
    record = paper_record(7)
    found = design.identify(record.u, record.y, PERIOD_S)
    assert isinstance(found, design.Identification)
    system = design.model_to_control(found.discrete)
    assert system.dt == PERIOD_S


def test_orders_side_by_side() -> None:
    fitted, other = paper_record(8, 0.05), paper_record(9, 0.05)
    structures = [*output_error_orders((1,), (1, 2, 3, 4), (1, 2)), Arx(3, 3, 1)]
    table = search_orders([fitted], [other], structures)
    assert [row.structure for row in table.rows] == structures
    assert table.best().structure == OutputError(1, 3, 1)
    assert table.best(Criterion.VALIDATION).fit_percent > 94.5
    assert table.best(Criterion.AIC).aic <= table.best().aic
    by_structure = {row.structure: row for row in table.rows}
    assert by_structure[OutputError(1, 1, 1)].fit_percent < 90.0
    assert by_structure[Arx(3, 3, 1)].fit_percent < by_structure[OutputError(1, 3, 1)].fit_percent


def test_orders_that_the_data_cannot_determine_say_so() -> None:
    short = paper_record(1, samples=20)
    table = search_orders([short], [short], [OutputError(1, 3, 1), OutputError(4, 8, 1)])
    assert table.rows[0].estimate is not None
    assert table.rows[1].estimate is None
    assert "usable output samples" in table.rows[1].reason
    assert table.rows[1].bic == table.rows[1].aic == np.inf
    with pytest.raises(DesignError, match="no structure of the search has a model"):
        search_orders([short], [short], [OutputError(4, 8, 1)]).best()


@pytest.mark.parametrize(
    "text",
    [
        "OE(1,3,1)",
        "ARX(2,1,1)",
        "ARMAX(2,1,1,1)",
        "BJ(1,1,1,2,1)",
        "continuous(real=1, pairs=1, integrators=1, max_dead_time_s=0.05)",
    ],
)
def test_the_orders_of_a_search_are_of_the_kind_that_was_given(text: str) -> None:
    given = parse_structure(text)
    orders = orders_of_kind(given)
    assert {type(structure) for structure in orders} == {type(given)}
    assert given in orders
    assert len(set(orders)) == len(orders) <= 60
    for structure in orders:
        if isinstance(structure, ContinuousPoles):
            assert (structure.integrators, structure.max_dead_time_s) == (1, 0.05)
            assert structure.order <= MAX_CONTINUOUS_ORDER + 1


def test_the_usual_orders() -> None:
    orders = output_error_orders()
    assert OutputError(1, 3, 1) in orders
    assert all(structure.nb <= structure.nf for structure in orders if isinstance(structure, OutputError))
