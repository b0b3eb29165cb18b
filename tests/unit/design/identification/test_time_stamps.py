"""Rows with times: gaps, jitter, and clocks that are off."""

from __future__ import annotations

import numpy as np
import pytest

from design.errors import DesignError
from design.identification.findings import Kind, Severity
from design.identification.records.time_stamps import from_time_stamps


def test_even_rows_are_taken_as_they_are() -> None:
    t = 5.0 + 0.1 * np.arange(50)
    experiment, findings = from_time_stamps(t, np.arange(50.0), -np.arange(50.0))
    assert not findings
    assert experiment.sample_time_s == pytest.approx(0.1)
    np.testing.assert_array_equal(experiment.u, np.arange(50.0))
    np.testing.assert_array_equal(experiment.y, -np.arange(50.0))


def test_a_missing_row_is_a_gap_and_nothing_is_filled_in() -> None:
    kept = np.array([0, 1, 2, 3, 6, 7, 8, 9])
    experiment, _ = from_time_stamps(0.1 * kept, kept, kept)
    assert np.flatnonzero(np.isnan(experiment.y)).tolist() == [4, 5]
    assert np.flatnonzero(np.isnan(experiment.u)).tolist() == [4, 5]
    held, _ = from_time_stamps(0.1 * kept, kept, kept, input_held_in_gaps=True)
    assert held.u.tolist() == [0.0, 1.0, 2.0, 3.0, 3.0, 3.0, 6.0, 7.0, 8.0, 9.0]
    assert np.flatnonzero(np.isnan(held.y)).tolist() == [4, 5]


def test_jitter_and_a_clock_that_is_off_do_not_add_up() -> None:
    random = np.random.default_rng(1)
    t = 0.0112 * 1.0002 * np.arange(20_000) + 0.0005 * random.standard_normal(20_000)
    experiment, findings = from_time_stamps(t, t, t, sample_time_s=0.0112)
    assert not findings
    assert len(experiment) == 20_000
    assert np.isfinite(experiment.y).all()


def test_rows_off_the_grid_are_left_out_and_reported() -> None:
    t = 0.1 * np.arange(100.0)
    t[::10] += 0.04
    experiment, (finding,) = from_time_stamps(t, t, t, sample_time_s=0.1)
    assert finding.kind is Kind.IRREGULAR_TIMES
    assert finding.severity is Severity.WARN
    assert finding.figure == pytest.approx(10.0)
    assert np.count_nonzero(np.isnan(experiment.y)) == 10


def test_times_at_random_are_refused() -> None:
    t = np.sort(np.random.default_rng(1).uniform(0.0, 10.0, 200))
    _, findings = from_time_stamps(t, t, t, sample_time_s=float(np.median(np.diff(t))))
    assert [finding.severity for finding in findings] == [Severity.REFUSE]


def test_a_wrong_sample_time_is_refused_with_both_figures() -> None:
    t = 0.0112 * np.arange(100)
    _, findings = from_time_stamps(t, t, t, sample_time_s=0.01)
    assert findings[0].kind is Kind.SAMPLE_TIME
    assert findings[0].severity is Severity.REFUSE
    assert "0.0112 s apart, but the sample time is given as 0.01 s" in str(findings[0])


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.0, 1.0, 0.5], "row 3: the time goes back by 0.5 s"),
        ([0.0, np.nan, 1.0], "row 2: the time is not a number"),
        ([0.0, 0.0, 0.0], "most rows have the same time"),
        ([0.0], "of at least 2"),
        ([0.0, 1.0, 2.0, 1e9], "check the sample time and the unit"),
    ],
)
def test_times_that_make_no_grid_are_refused(times: list[float], message: str) -> None:
    with pytest.raises(DesignError, match=message):
        from_time_stamps(times, times, times)


def test_of_two_rows_for_one_place_the_nearer_counts() -> None:
    t = [0.0, 0.1, 0.2, 0.21, 0.3, 0.4, 0.5]
    experiment, _ = from_time_stamps(t, range(7), range(7), sample_time_s=0.1)
    assert experiment.y.tolist() == [0.0, 1.0, 2.0, 4.0, 5.0, 6.0]
