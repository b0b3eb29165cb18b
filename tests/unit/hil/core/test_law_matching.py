"""Take-over by another law: its output is the last command, for every law that has a state to set."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.constants import PERIOD_S

from hil.core.control_law import ControlLaw, check_law_runs, law_numbers
from hil.core.controller_file import Law, PidLaw, StateSpaceLaw, TransferFunctionLaw
from hil.core.errors import DocumentError

gains = st.floats(-50.0, 50.0).map(lambda gain: gain if abs(gain) > 1e-3 else 0.0)


def random_state_space(seed: int, n: int, has_integrator: bool, inputs: int) -> StateSpaceLaw:
    """A law with distinct modes of modulus up to 0.98, and perhaps an integrator."""
    rng = np.random.default_rng(seed)
    poles = rng.uniform(0.05, 0.98, n) * rng.choice([-1.0, 1.0], n)
    if has_integrator:
        poles[0] = 1.0
    T = rng.normal(size=(n, n)) + 3.0 * np.eye(n)
    return StateSpaceLaw(
        A=(T @ np.diag(poles) @ np.linalg.inv(T)).tolist(),
        B=(T @ rng.normal(size=(n, inputs))).tolist(),
        C=rng.normal(size=(1, n)).tolist(),
        D=rng.normal(size=(1, inputs)).tolist(),
        inputs="e" if inputs == 1 else "r, y",
    )


laws: st.SearchStrategy[Law] = st.one_of(
    st.builds(PidLaw, kp=gains, ki=gains, kd=gains, tau_d=st.floats(0.001, 10.0), b=gains, c=gains),
    st.builds(
        random_state_space,
        st.integers(0, 2**32 - 1),
        st.integers(1, 12),
        st.booleans(),
        st.sampled_from([1, 2]),
    ),
    st.builds(
        lambda num, poles: TransferFunctionLaw(num=num, den=np.poly(poles).tolist()),
        st.lists(gains, min_size=1, max_size=3),
        st.lists(st.floats(-0.95, 1.0), min_size=2, max_size=5),
    ),
)
positions = st.floats(-1.5, 1.5)


def runs(law: Law) -> bool:
    try:
        check_law_runs(law, PERIOD_S, "law")
    except DocumentError:
        return False
    return True


@settings(max_examples=400, deadline=None)
@given(laws.filter(runs), positions, positions, st.floats(-5.0, 5.0))
def test_the_output_is_matched_or_the_bump_is_reported(law: Law, r: float, y: float, u: float) -> None:
    running = ControlLaw(law, PERIOD_S)
    matching = running.match(r, y, u)
    scale = max(1.0, abs(u), *map(abs, running._x))
    assert running.output(r, y) == pytest.approx(u + matching.jump_v, abs=1e-9 * scale)
    if any(law_numbers(law, PERIOD_S).slowest):
        assert matching.jump_v == 0.0


@settings(max_examples=200, deadline=None)
@given(laws.filter(runs), positions, positions, st.floats(-5.0, 5.0))
def test_a_law_at_rest_drifts_by_what_was_reported(law: Law, r: float, y: float, u: float) -> None:
    """Advanced with constant r and y, the output ends at the reported value, or rises without end."""
    running = ControlLaw(law, PERIOD_S)
    matching = running.match(r, y, u)
    numbers = law_numbers(law, PERIOD_S)
    if not numbers.rest_gain or numbers.pole > 0.97:
        return
    for _ in range(3000):
        running.advance(running.output(r, y))
    scale = max(1.0, abs(u), abs(matching.drift_v), *map(abs, running._x))
    assert running.output(r, y) == pytest.approx(u + matching.jump_v + matching.drift_v, abs=1e-6 * scale)


@settings(max_examples=100, deadline=None)
@given(gains.filter(bool), gains, positions, st.floats(-5.0, 5.0))
def test_an_integrator_goes_on_by_its_own_error_alone(ki: float, kp: float, e: float, u: float) -> None:
    running = ControlLaw(PidLaw(kp=kp, ki=ki), PERIOD_S)
    assert running.match(e, 0.0, u) == (0.0, 0.0, 0.0)
    running.output(e, 0.0)
    running.advance(u)
    assert running.output(e, 0.0) - u == pytest.approx(ki * e * PERIOD_S, abs=1e-9)


def test_a_law_without_state_jumps() -> None:
    running = ControlLaw(PidLaw(kp=10.0, ki=0.0), PERIOD_S)
    assert running.match(0.1, 0.02, 0.5) == (pytest.approx(0.3), 0.0, 0.0)


def test_a_state_that_the_output_does_not_see_cannot_be_matched() -> None:
    law = StateSpaceLaw(A=[[0.5]], B=[[1.0]], C=[[0.0]], D=[[2.0]])
    assert ControlLaw(law, PERIOD_S).match(0.1, 0.0, 0.5).jump_v == pytest.approx(-0.3)


def test_a_law_without_integrator_says_how_it_moves() -> None:
    lag = TransferFunctionLaw(num=[0.2], den=[1.0, -0.9])
    matching = ControlLaw(lag, PERIOD_S).match(0.1, 0.0, 0.5)
    assert matching.jump_v == 0.0
    assert matching.drift_v == pytest.approx(0.2 - 0.5)
    assert matching.time_constant_s == pytest.approx(-PERIOD_S / math.log(0.9))


def test_a_law_of_past_samples_moves_with_its_next_output() -> None:
    delay = TransferFunctionLaw(num=[3.0], den=[1.0, 0.0])
    matching = ControlLaw(delay, PERIOD_S).match(0.1, 0.0, 0.5)
    assert matching == (0.0, pytest.approx(-0.2), 0.0)


def test_computed_numbers_give_the_same_law() -> None:
    law = PidLaw(kp=11.0, ki=5.0, kd=0.3, tau_d=0.02)
    direct = ControlLaw(law, PERIOD_S)
    by_numbers = ControlLaw.of_numbers(law_numbers(law, PERIOD_S), PERIOD_S)
    for running in (direct, by_numbers):
        running.match(0.1, 0.02, 0.5)
    for k in range(20):
        outputs = [running.output(0.1, 0.01 * k) for running in (direct, by_numbers)]
        assert outputs[0] == outputs[1]
        for running in (direct, by_numbers):
            running.advance(min(outputs[0], 1.0))
