"""Exact steps of a transfer function, against the matrix exponential of scipy."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from firmware_sim.plants.linear_model import EQUATION_15, LinearModel
from firmware_sim.plants.step_table import MAX_ORDER, StepTable, step_table


def responses(table: StepTable, pieces: Sequence[tuple[int, float]]) -> list[float]:
    """Return the output after each piece (duration in ns, input), from rest."""
    state: Sequence[float] = (0.0,) * table.order
    outputs = []
    for duration_ns, u in pieces:
        for step in table.steps(duration_ns):
            state, y = table.advance(state, step, u)
        outputs.append(y)
    return outputs


def expected(model: LinearModel, pieces: Sequence[tuple[int, float]]) -> list[float]:
    """Return the outputs by scipy's matrix exponential, in the controllable canonical form."""
    num = np.concatenate([np.zeros(len(model.den) - len(model.num)), model.num]) / model.den[0]
    den = np.asarray(model.den) / model.den[0]
    n = len(den) - 1
    generator = np.zeros((n + 1, n + 1))
    generator[:n, :n] = np.eye(n, k=-1)
    generator[:1, :n] = -den[1:]
    generator[:1, n] = 1.0
    C = num[1:] - num[0] * den[1:]
    x = np.zeros(n + 1)
    outputs = []
    for duration_ns, u in pieces:
        x[n] = u
        x = expm(generator * duration_ns * 1e-9) @ x
        outputs.append(float(C @ x[:n] + num[0] * u))
    return outputs


pieces = st.lists(st.tuples(st.integers(1, 10**9), st.floats(-5.0, 5.0)), min_size=1, max_size=6)
rates = st.floats(0.05, 60.0)
real_poles = rates.map(lambda rate: (1.0, rate))
modes = st.builds(lambda w, damping: (1.0, 2.0 * damping * w, w * w), rates, st.floats(0.05, 1.0))
integrators = st.just((1.0, 0.0))
unstable_poles = st.floats(0.01, 2.0).map(lambda rate: (1.0, -rate))
factors = st.lists(real_poles | modes | integrators | unstable_poles, min_size=1, max_size=3)


@settings(max_examples=60, deadline=None)
@given(factors=factors, num=st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=2), pieces=pieces)
def test_random_systems_respond_as_by_scipy(
    factors: list[tuple[float, ...]], num: list[float], pieces: list[tuple[int, float]]
) -> None:
    """Stable, integrating, unstable and repeated poles; proper models with and without a direct term."""
    den = np.array([1.0])
    for factor in factors:
        den = np.polymul(den, factor)
    model = LinearModel(tuple(num), tuple(den))
    reference = expected(model, pieces)
    scale = max(1.0, *map(abs, reference))
    assert responses(step_table(model), pieces) == pytest.approx(reference, abs=1e-9 * scale)


@pytest.mark.parametrize(
    ("model", "response"),
    [
        (LinearModel((3.0,), (2.0,)), lambda t: 1.5),
        (LinearModel((2.0,), (1.0, 0.0)), lambda t: 2.0 * t),
        (LinearModel((2.0,), (1.0, 0.0, 0.0)), lambda t: t * t),
        (LinearModel((6.0,), (1.0, 3.0)), lambda t: -2.0 * math.expm1(-3.0 * t)),
        (LinearModel((1.0, 6.0), (1.0, 3.0)), lambda t: 1.0 - math.expm1(-3.0 * t)),
        (LinearModel((4.0,), (1.0, 4.0, 4.0)), lambda t: 1.0 - (1.0 + 2.0 * t) * math.exp(-2.0 * t)),
        (LinearModel((1.0,), (1.0, -0.5)), lambda t: 2.0 * math.expm1(0.5 * t)),
        (LinearModel((0.0, 5.0), (0.0, 1.0, 5.0)), lambda t: -math.expm1(-5.0 * t)),
        (LinearModel((2.0, 0.0), (1.0, 1e-300, 0.0)), lambda t: 2.0 * t),
    ],
    ids=[
        "gain",
        "integrator",
        "double integrator",
        "lag",
        "direct term",
        "double pole",
        "unstable",
        "leading 0",
        "pole almost at 0",
    ],
)
@pytest.mark.parametrize("duration_ns", [1, 4097, 11_200_000, 999_999_999, 100 * 10**9])
def test_step_responses_have_their_closed_form(
    model: LinearModel, response: object, duration_ns: int
) -> None:
    assert callable(response)
    (y,) = responses(step_table(model), [(duration_ns, 1.0)])
    assert y == pytest.approx(response(duration_ns * 1e-9), rel=1e-12)


@given(st.integers(1, 2**45))
def test_steps_add_up_to_the_duration(duration_ns: int) -> None:
    integrator = step_table(LinearModel((1.0,), (1.0, 0.0)))
    (y,) = responses(integrator, [(duration_ns, 1.0)])
    assert y == pytest.approx(duration_ns * 1e-9, rel=1e-12)


@given(st.integers(1, 2**34))
def test_a_composed_step_is_the_steps_one_after_another(duration_ns: int) -> None:
    table = step_table(EQUATION_15)
    _, y = table.advance((0.0,) * 3, table.step(duration_ns), 0.7)
    assert y == pytest.approx(responses(table, [(duration_ns, 0.7)])[0], rel=1e-12)


def test_a_model_of_the_largest_order_keeps_its_static_gain() -> None:
    den = np.poly(-np.linspace(1.0, 3.0, MAX_ORDER))
    model = LinearModel((float(den[-1]),), tuple(den))
    assert responses(step_table(model), [(60 * 10**9, 0.25)])[0] == pytest.approx(0.25, rel=1e-6)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (LinearModel((1.0,), (0.0, 0.0)), "den: all coefficients are 0"),
        (LinearModel((1.0, 0.0, 0.0), (1.0, 1.0)), "num has degree 2 and den has degree 1"),
        (LinearModel((1.0,), (1.0,) * (MAX_ORDER + 2)), f"den: degree {MAX_ORDER + 1} exceeds the limit"),
        (LinearModel((1e300,), (1e-300, 1.0)), "too large for a floating-point number"),
        (
            LinearModel((1.0,), (1.0, 1e9)),
            r"a pole may be as fast as 1e\+09 rad/s, beyond the limit",
        ),
    ],
)
def test_a_model_that_cannot_be_simulated_is_rejected(model: LinearModel, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        step_table(model)
