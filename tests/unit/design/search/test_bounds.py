"""Search bounds: how the unit cube maps to parameter values, and which bounds are refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from design.errors import DesignError
from design.search.bounds import Parameter, SearchBounds, with_bounds
from design.synthesis.structures import STRUCTURES

BOUNDS = SearchBounds((Parameter("x", 0.01, 100.0), Parameter("y", -3.0, 5.0, "linear")))


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_decoded_values_stay_within_the_search_bounds(x: float, y: float) -> None:
    (values,) = BOUNDS.decode(np.array([[x, y]]))
    assert 0.01 * (1.0 - 1e-12) <= values[0] <= 100.0 * (1.0 + 1e-12)
    assert -3.0 <= values[1] <= 5.0


def test_the_middle_of_the_cube_is_the_geometric_or_arithmetic_mean() -> None:
    middle = BOUNDS.decode(np.array([[0.5, 0.5]]))
    np.testing.assert_allclose(middle, [[1.0, 1.0]])


def test_bounds_can_be_changed_by_name() -> None:
    changed = with_bounds(STRUCTURES["pid"], {"kd": Parameter("kd", -1.0, 1.0, "linear")})
    assert changed.parameters[2].low == -1.0
    assert STRUCTURES["pid"].parameters[2].low == 0.01
    with pytest.raises(
        DesignError, match="search bounds: this structure has no parameter gain; it has kp, ki, kd, tau_d"
    ):
        with_bounds(STRUCTURES["pid"], {"gain": Parameter("gain", 1.0, 2.0)})


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("kp", 5.0, 5.0), "low must be below high"),
        (("kp", 0.0, 5.0), "logarithmic coding needs low over 0"),
        (("kp", 1.0, 5.0, "cubic"), "neither 'logarithmic' nor 'linear'"),
    ],
)
def test_impossible_bounds_are_refused(arguments: tuple[str, float, float], named: str) -> None:
    with pytest.raises(DesignError, match="kp: ") as refusal:
        Parameter(*arguments)
    assert named in str(refusal.value)


def test_parameters_at_a_bound_are_named() -> None:
    assert BOUNDS.at_bounds(np.array([0.995, 0.5])) == ("x",)
    assert BOUNDS.at_bounds(np.array([0.5, 0.5])) == ()
    assert BOUNDS.at_bounds(np.array([0.0, 1.0])) == ("x", "y")
