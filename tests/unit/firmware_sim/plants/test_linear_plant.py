"""Linear plants: eq. (15) against the discretisations of scipy and python-control, and models of the user."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete
from support.constants import CENTRED
from support.shipped_rig import RIG_TEXT
from support.shipped_rig import SHIPPED_RIG as RIG

from firmware_sim.plants.linear_model import LinearModel
from firmware_sim.plants.linear_plant import LinearPlant
from hil.core.errors import SimulationError
from hil.core.rig import read_rig

NUMERATOR = 0.47947 * np.array([1.0, 90.76])
DENOMINATOR = np.polymul([1.0, 0.4231], [1.0, 16.97, 167.9])


def advance(plant: LinearPlant, duration_ns: int, offset_v: float) -> float:
    plant.advance(duration_ns, [5.0 + offset_v] * 3)
    return plant.position("vertical")


@pytest.mark.parametrize("duration_s", [1e-6, 0.2e-3, 0.0112, 0.1, 2.0])
def test_equation_15_responds_like_its_discretisation_by_scipy(duration_s: float) -> None:
    A = np.array([-DENOMINATOR[1:], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    B = np.array([[1.0], [0.0], [0.0]])
    C = np.array([[0.0, *NUMERATOR]])
    Ad, Bd, Cd, _, _ = cont2discrete((A, B, C, np.zeros((1, 1))), duration_s, "zoh")
    offsets_v = np.random.default_rng(1).uniform(-5.0, 5.0, 300)
    plant, x = LinearPlant(RIG), np.zeros((3, 1))
    for offset_v in offsets_v:
        x = Ad @ x + Bd * offset_v
        position = advance(plant, round(duration_s * 1e9), offset_v)
        assert position == pytest.approx((Cd @ x).item(), rel=1e-12, abs=1e-12)


def test_equation_15_responds_like_its_discretisation_by_python_control() -> None:
    sampled = control.c2d(control.tf(NUMERATOR, DENOMINATOR), RIG.loop.period_s, "zoh")
    offsets_v = np.random.default_rng(2).uniform(-1.0, 1.0, 400)
    expected = control.forced_response(sampled, U=offsets_v).outputs
    plant = LinearPlant(RIG)
    positions = [0.0, *(advance(plant, RIG.loop.period_ns, offset_v) for offset_v in offsets_v)]
    assert positions[:-1] == pytest.approx(list(expected), rel=1e-9, abs=1e-11)


def test_equation_15_has_its_static_gain() -> None:
    assert advance(LinearPlant(RIG), 100 * 10**9, 0.1) == pytest.approx(
        0.1 * 0.47947 * 90.76 / (0.4231 * 167.9), rel=1e-12
    )


@given(
    st.lists(st.integers(1, 50_000_000), min_size=1, max_size=8),
    st.floats(-5.0, 5.0),
    st.floats(-5.0, 5.0),
)
def test_a_hold_divided_into_pieces_gives_the_same_position(
    pieces_ns: list[int], before_v: float, offset_v: float
) -> None:
    whole, cut = LinearPlant(RIG), LinearPlant(RIG)
    for plant in (whole, cut):
        advance(plant, 300_000_000, before_v)
    for piece_ns in pieces_ns:
        advance(cut, piece_ns, offset_v)
    assert advance(whole, sum(pieces_ns), offset_v) == pytest.approx(cut.position("vertical"), abs=1e-13)


def test_axes_are_independent_and_use_their_own_channels() -> None:
    plant = LinearPlant(RIG)
    plant.advance(500_000_000, [5.0, 5.2, 5.0])
    assert plant.position("vertical") == plant.position("rotation") == 0.0
    moved = plant.position("horizontal")
    pot = RIG.axes["horizontal"].potentiometer
    assert moved > 0.0
    assert list(plant.potentiometer_v()) == [5.0, pot.volts(moved), 5.0]


def test_the_potentiometer_voltage_is_limited_to_its_range() -> None:
    plant = LinearPlant(RIG)
    plant.advance(10 * 10**9, [10.0, 0.0, 5.0])
    assert list(plant.potentiometer_v()) == [10.0, 0.0, 5.0]


def test_a_channel_without_an_axis_reads_zero() -> None:
    alone = read_rig(RIG_TEXT[: RIG_TEXT.index("[axes.horizontal]")], "rig.toml")
    plant = LinearPlant(alone)
    plant.advance(11_200_000, [5.0, 10.0, 10.0])
    assert list(plant.potentiometer_v()) == [5.0, 0.0, 0.0]


def test_each_axis_has_its_own_model_and_axes_without_one_read_0_v() -> None:
    lag, integrator = LinearModel((0.1,), (0.05, 1.0)), LinearModel((0.5,), (1.0, 0.0))
    plant = LinearPlant(RIG, {"rotation": integrator, "vertical": lag})
    plant.advance(10**9, (6.0, 9.0, 5.4))
    assert plant.position("vertical") == pytest.approx(0.1, rel=1e-6)
    assert plant.position("rotation") == pytest.approx(0.2, rel=1e-12)
    axes = RIG.axes
    assert list(plant.potentiometer_v()) == [
        axes["vertical"].potentiometer.volts(plant.position("vertical")),
        0.0,
        axes["rotation"].potentiometer.volts(plant.position("rotation")),
    ]


def test_rest_is_the_middle_of_the_potentiometers_range() -> None:
    text = RIG_TEXT.replace("y_at_0v = -0.165", "y_at_0v = 0.0").replace(
        "y_at_10v = 0.165", "y_at_10v = 0.33"
    )
    text = text.replace("min_y = -0.15", "min_y = 0.01").replace("max_y = 0.15", "max_y = 0.3")
    plant = LinearPlant(read_rig(text, "rig.toml"))
    assert plant.position("vertical") == 0.165
    assert list(plant.potentiometer_v()) == [5.0, 5.0, 5.0]
    plant.advance(10**9, CENTRED)
    assert list(plant.potentiometer_v()) == [5.0, 5.0, 5.0]


def test_an_integrator_beyond_the_potentiometer_returns_when_its_input_brings_it_back() -> None:
    plant = LinearPlant(RIG, {"vertical": LinearModel((0.1,), (1.0, 0.0))})
    plant.advance(4 * 10**9, (6.0, 5.0, 5.0))
    assert plant.position("vertical") == pytest.approx(0.4)
    assert plant.potentiometer_v()[0] == 10.0
    plant.advance(4 * 10**9, (4.0, 5.0, 5.0))
    assert plant.potentiometer_v()[0] == pytest.approx(5.0)


@pytest.mark.parametrize("duration_ns", [10**9, 60 * 10**9, 1000 * 10**9])
def test_an_unstable_model_raises_when_it_has_diverged(duration_ns: int) -> None:
    plant = LinearPlant(RIG, {"vertical": LinearModel((1.0,), (1.0, -20.0))})
    with pytest.raises(
        SimulationError, match=r"the linear model of axis vertical diverged: displacement .* m"
    ):
        plant.advance(duration_ns, (5.1, 5.0, 5.0))


def test_a_voltage_that_is_not_a_number_raises() -> None:
    with pytest.raises(SimulationError, match="axis vertical diverged: displacement nan"):
        LinearPlant(RIG).advance(11_200_000, (float("nan"), 5.0, 5.0))
