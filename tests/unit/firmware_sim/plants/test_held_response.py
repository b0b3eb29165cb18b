"""The response of a model with dead time to a piecewise constant input."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.constants import PERIOD_NS

from firmware_sim.plants.held_response import response_of
from firmware_sim.plants.linear_model import EQUATION_15, LinearModel

LAG = LinearModel((2.0,), (1.0, 4.0))
MS = 1_000_000


def late(model: LinearModel, dead_time_ns: int) -> LinearModel:
    return LinearModel(model.num, model.den, dead_time_ns * 1e-9)


@pytest.mark.parametrize("dead_time_ns", [0, 1, 5_600_000, PERIOD_NS, 2 * PERIOD_NS + 1, 3_333_333])
def test_a_step_acts_after_the_dead_time(dead_time_ns: int) -> None:
    response = response_of(late(LAG, dead_time_ns), PERIOD_NS)
    for k in range(1, 60):
        response.advance(PERIOD_NS, 0.5)
        acting_s = max(k * PERIOD_NS - dead_time_ns, 0) * 1e-9
        assert response.output == pytest.approx(-0.25 * math.expm1(-4.0 * acting_s), rel=1e-12)


pieces = st.lists(st.tuples(st.integers(1, 40 * MS), st.floats(-5.0, 5.0)), min_size=1, max_size=20)


@given(pieces=pieces, dead_time_ns=st.integers(0, 60 * MS))
def test_the_dead_time_shifts_the_response_of_the_model_without_it(
    pieces: list[tuple[int, float]], dead_time_ns: int
) -> None:
    delayed = response_of(late(EQUATION_15, dead_time_ns), PERIOD_NS)
    direct = response_of(EQUATION_15, PERIOD_NS)
    for duration_ns, u in pieces:
        delayed.advance(duration_ns, u)
        direct.advance(duration_ns, u)
    if dead_time_ns:
        delayed.advance(dead_time_ns, 0.0)
    assert delayed.output == pytest.approx(direct.output, abs=1e-12)


@given(
    pieces=pieces, dead_time_ns=st.integers(0, 60 * MS), cuts=st.lists(st.integers(1, 10 * MS), max_size=10)
)
def test_a_hold_divided_into_pieces_gives_the_same_output(
    pieces: list[tuple[int, float]], dead_time_ns: int, cuts: list[int]
) -> None:
    model = late(EQUATION_15, dead_time_ns)
    whole, divided = response_of(model, PERIOD_NS), response_of(model, PERIOD_NS)
    for duration_ns, u in pieces:
        whole.advance(duration_ns, u)
        left_ns = duration_ns
        for cut_ns in cuts:
            if cut_ns < left_ns:
                divided.advance(cut_ns, u)
                left_ns -= cut_ns
        divided.advance(left_ns, u)
        assert divided.output == pytest.approx(whole.output, abs=1e-12)


def test_the_direct_term_acts_with_the_input() -> None:
    response = response_of(LinearModel((0.5, 2.0), (1.0, 4.0)), PERIOD_NS)
    response.advance(1, 1.0)
    assert response.output == pytest.approx(0.5, abs=1e-8)
    response.advance(1, 0.0)
    assert response.output == pytest.approx(0.0, abs=1e-8)
