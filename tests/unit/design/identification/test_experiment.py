"""Records: copies, gaps, masks and stretches."""

from __future__ import annotations

import numpy as np
import pytest

from design.errors import DesignError
from design.identification.records.experiment import Experiment, Names, stretches


def test_the_arrays_are_read_only_copies() -> None:
    u, y, weights = np.array([1.0, 2.0, np.inf]), np.array([1.0, np.nan, 3.0]), np.array([1.0, 1.0, 4.0])
    experiment = Experiment(u, y, 0.1, weights=weights)
    u[0] = y[0] = weights[0] = 9.0
    assert experiment.u[0] == experiment.y[0] == experiment.weights[0] == 1.0
    assert np.isnan(experiment.u[2])
    with pytest.raises(ValueError, match="read-only"):
        experiment.y[0] = 2.0
    assert experiment.observed.tolist() == [True, False, True]
    np.testing.assert_allclose(experiment.time_s, [0.0, 0.1, 0.2])
    assert len(experiment) == 3


def test_lists_and_single_columns_are_accepted() -> None:
    experiment = Experiment([1, 2], [[3.0], [4.0]], 1)  # type: ignore[arg-type]
    assert experiment.u.tolist() == [1.0, 2.0]
    assert experiment.y.tolist() == [3.0, 4.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0, 2.0], [1.0], 0.1), "rig.csv: u has 2 samples and y has 1"),
        ((["a"], [1.0], 0.1), "u must be an array of real numbers"),
        ((np.zeros((2, 2)), np.zeros(4), 0.1), r"u has shape \(2, 2\)"),
        (([1.0], [1.0], 0.0), "sample time 0.0 s; it must be positive"),
        (([1.0], [1.0], np.nan), "sample time nan s"),
        (([1e60], [1.0], 0.1), r"u reaches 1e\+60"),
    ],
)
def test_what_is_no_record_is_refused(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(DesignError, match=message):
        Experiment(*arguments, name="rig.csv")  # type: ignore[arg-type]


@pytest.mark.parametrize("weights", [[1.0], [1.0, -1.0], [1.0, np.nan]])
def test_weights_must_be_one_for_each_sample(weights: list[float]) -> None:
    with pytest.raises(DesignError, match="weights must be 2 finite numbers"):
        Experiment([0.0, 1.0], [0.0, 1.0], 0.1, weights=weights)  # type: ignore[arg-type]


def test_a_negative_transport_delay_is_refused() -> None:
    with pytest.raises(DesignError, match="transport delay -1 samples"):
        Experiment([0.0], [0.0], 0.1, transport_delay_samples=-1)  # type: ignore[arg-type]


def test_the_transport_delay_moves_the_input_to_the_actuator() -> None:
    experiment = Experiment(np.arange(4.0), np.zeros(4), 0.1, transport_delay_samples=1)
    moved = experiment.at_the_actuator()
    np.testing.assert_array_equal(moved.u, [np.nan, 0.0, 1.0, 2.0])
    assert moved.transport_delay_samples == 0
    assert moved.at_the_actuator() is moved


def test_a_part_keeps_weights_and_names() -> None:
    experiment = Experiment(
        np.arange(5.0), np.arange(5.0), 0.1, weights=np.arange(5.0), names=Names("valve", "position")
    )
    part = experiment.part(1, 3, "middle")
    assert part.u.tolist() == [1.0, 2.0]
    assert part.weights.tolist() == [1.0, 2.0]
    assert (part.name, part.names.u) == ("middle", "valve")


def test_a_masked_sample_stays_in_its_stretch_and_an_interruption_ends_it() -> None:
    experiment = Experiment(np.ones(10), np.ones(10), 0.1)
    at = np.arange(10) == 4
    (whole,) = stretches([experiment.masked(at)])
    assert len(whole) == 10
    assert whole.root_weight[4] == 0.0
    first, second = stretches([experiment.interrupted(at)])
    assert (first.start, len(first), second.start, len(second)) == (0, 4, 5, 5)


def test_stretches_end_with_the_last_sample_that_counts() -> None:
    y = np.ones(8)
    y[[0, 6, 7]] = np.nan
    (stretch,) = stretches([Experiment(np.ones(8), y, 0.1)])
    assert len(stretch) == 6
    assert stretch.root_weight.tolist() == [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    assert stretch.y[0] == 0.0
    assert stretches([Experiment(np.ones(8), np.full(8, np.nan), 0.1)]) == []


def test_samples_that_depend_on_unknown_inputs_do_not_count() -> None:
    (stretch,) = stretches([Experiment(np.ones(6), np.ones(6), 0.1)], skipped=2)
    assert stretch.root_weight.tolist() == [0.0, 0.0, 1.0, 1.0, 1.0, 1.0]
