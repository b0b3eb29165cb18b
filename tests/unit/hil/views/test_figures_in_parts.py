"""Figures of long runs: parts of a run give the figures of the whole, in bounded memory."""

from __future__ import annotations

import math
import random
from dataclasses import asdict, dataclass

import numpy as np
import pytest

from hil.views import duration_counts, tail_mean
from hil.views.axis_figures import AxisFigures, StepResponse, Tracking, axis_summary
from hil.views.duration_counts import DurationCounts
from hil.views.tail_mean import TailMean

PERIOD_S = 0.0112


@dataclass(frozen=True)
class Signals:
    """Signals of an axis, as :func:`axis_summary` takes them."""

    time_s: np.ndarray
    setpoint: np.ndarray
    position: np.ndarray
    error: np.ndarray
    command_v: np.ndarray
    running: np.ndarray
    unit: str = "m"

    def part(self, begin: int, end: int) -> Signals:
        columns = {name: values for name, values in asdict(self).items() if name != "unit"}
        return Signals(**{name: values[begin:end] for name, values in columns.items()})


def run_of(setpoint: np.ndarray, running: np.ndarray, seed: int) -> Signals:
    """Return the signals of a first-order lag with noise that follows ``setpoint``."""
    noise = np.random.default_rng(seed)
    position = np.zeros(len(setpoint))
    for row in range(1, len(setpoint)):
        position[row] = position[row - 1] + 0.1 * (setpoint[row - 1] - position[row - 1])
    position += noise.normal(0.0, 1e-4, len(setpoint))
    error = setpoint - position
    return Signals(np.arange(len(setpoint)) * PERIOD_S, setpoint, position, error, 5.0 + 10 * error, running)


def setpoints(kind: str, count: int) -> np.ndarray:
    rows = np.arange(count)
    match kind:
        case "ladder":
            return np.floor(rows / 300) * 0.05
        case "sine":
            return 0.1 * np.sin(rows * 0.02)
        case "random steps":
            return np.repeat(np.random.default_rng(3).uniform(0.0, 0.1, count // 7 + 1), 7)[:count]
    return np.full(count, 0.1)


@pytest.mark.parametrize("kind", ["ladder", "sine", "random steps", "constant"])
@pytest.mark.parametrize("seed", range(4))
def test_parts_of_any_length_give_the_figures_of_the_whole(kind: str, seed: int) -> None:
    count = 1500
    running = np.zeros(count, np.bool_)
    running[40:700] = True
    running[760:1400] = True  # an operator stopped the controllers in between
    run = run_of(setpoints(kind, count), running, seed)
    whole = axis_summary(run)
    draw = random.Random(seed)
    figures, row = AxisFigures("m"), 0
    while row < count:
        end = row + draw.choice((1, 2, 5, 60, 333))
        figures.add(run.part(row, end))
        row = end
    found = figures.result()
    assert type(found) is type(whole)
    assert isinstance(whole, StepResponse if kind == "ladder" else Tracking)
    assert found is not None
    for name, value in asdict(whole).items():
        is_number = isinstance(value, float)
        assert getattr(found, name) == (pytest.approx(value, rel=1e-9, abs=1e-12) if is_number else value)


def test_an_axis_that_was_never_controlled_has_no_figures() -> None:
    run = run_of(setpoints("sine", 100), np.zeros(100, np.bool_), 1)
    figures = AxisFigures("m")
    for row in range(0, 100, 10):
        figures.add(run.part(row, row + 10))
    assert figures.result() is None


class TestTailMean:
    @pytest.mark.parametrize("count", [1, 2, 9, 64, 65, 1000, 4097])
    def test_the_mean_is_that_of_the_last_part(self, count: int, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(tail_mean, "MAX_SUMS", 64)
        values = np.random.default_rng(count).normal(size=count).cumsum()
        series = TailMean()
        for begin in range(0, count, 17):
            series = series.extended(values[begin : begin + 17])
        assert len(series.sums) <= 66
        assert len(series.sums) * series.size + len(series.rest) == count
        length = max(round(0.2 * count), 1)
        around = [np.mean(values[-n:]) for n in range(max(length - series.size, 1), length + series.size + 1)]
        assert min(around) - 1e-9 <= series.mean(0.2) <= max(around) + 1e-9
        if count <= 64:
            assert series.mean(0.2) == pytest.approx(np.mean(values[-length:]))


class TestDurationCounts:
    def test_quantiles_are_values_that_occurred(self) -> None:
        values = np.random.default_rng(5).integers(-50, 10**6, 20_000)
        counts = DurationCounts()
        for part in np.array_split(values, 13):
            counts.add(part)
        parts = [0.0001, 0.5, 0.99, 0.999, 1.0]
        expected = [np.sort(values)[rank - 1] for rank in (2, 10_000, 19_800, 19_980, 20_000)]
        assert counts.quantiles_ns(parts) == expected
        assert (len(counts), counts.min_ns, counts.max_ns) == (20_000, values.min(), values.max())
        found, edges = counts.histogram(10, (0.0, 1000.0))
        np.testing.assert_array_equal(found, np.histogram(values * 1e-3, 10, (0.0, 1000.0))[0])
        assert len(edges) == 11

    def test_many_different_values_are_rounded_and_the_largest_one_is_not(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(duration_counts, "MAX_VALUES", 100)
        values = np.random.default_rng(6).permutation(np.arange(5_001, 25_000))
        counts = DurationCounts()
        for part in np.array_split(values, 7):
            counts.add(part)
        assert len(counts) == len(values)
        p50, p100 = counts.quantiles_ns([0.5, 1.0])
        assert p50 == pytest.approx(15_000, abs=1000)
        assert p100 == 24_999

    def test_without_a_duration_everything_is_zero(self) -> None:
        counts = DurationCounts()
        counts.add(np.empty(0, np.int64))
        assert (len(counts), counts.min_ns, counts.max_ns) == (0, 0, 0)
        assert not math.isnan(counts.max_ns)
