"""Signals of many lengths: stacks are few, and filtering a stack gives what filtering each signal gives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from support.identification_data import PERIOD_S, clean_fit, paper_record

from design.identification.estimators import stacking
from design.identification.estimators.fit import fit
from design.identification.estimators.stacking import filtered_differences, stacked
from design.identification.models.difference_basis import differences
from design.identification.models.structures import OutputError
from design.identification.records.experiment import Experiment

F = np.array([1.0, -1.6, 0.7])


def test_a_filtered_stack_holds_what_each_signal_gives_alone() -> None:
    random = np.random.default_rng(1)
    signals = [random.standard_normal(length) for length in (1, 2, 31, 33, 500, 1023, 1024, 5000)]
    for signal, found in zip(signals, filtered_differences(signals, F, 3, 2), strict=True):
        np.testing.assert_allclose(found, differences(lfilter([1.0], F, signal), 3, 2), rtol=1e-12)


def test_many_short_signals_make_few_stacks_and_each_signal_is_in_one() -> None:
    random = np.random.default_rng(2)
    signals = [np.ones((2, length)) for length in random.integers(1, 300, 500)]
    stacks = list(stacked(signals))
    assert len(stacks) <= 5
    assert sorted(place for stack in stacks for place in stack.places) == list(range(500))
    for stack in stacks:
        for place, padded in zip(stack.places, stack.signals, strict=True):
            assert padded.sum() == signals[place].sum()


def test_a_long_signal_stays_alone_and_is_not_copied() -> None:
    long = np.ones(stacking.ALONE_FROM)
    (stack,) = stacked([long])
    assert np.shares_memory(stack.signals, long)


@pytest.mark.parametrize("share", [0.01, 0.03])
def test_single_gaps_cost_few_more_filter_runs_than_none(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = 0

    def counted(*arguments: object, **named: object) -> object:
        nonlocal runs
        runs += 1
        return lfilter(*arguments, **named)

    monkeypatch.setattr(stacking, "lfilter", counted)
    whole = paper_record(1, 0.05)
    lost = np.random.default_rng(3).random(len(whole)) < share
    u, y = (np.where(lost, np.nan, values) for values in (whole.u, whole.y))
    fit([whole], OutputError(1, 3, 1))
    without_gaps, runs = runs, 0
    estimate = fit([Experiment(u, y, PERIOD_S)], OutputError(1, 3, 1))
    assert runs < 10 * without_gaps
    assert clean_fit(estimate.discrete, 1) > 99.0
