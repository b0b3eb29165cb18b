"""Eq. (15) under a zero-order hold, against scipy's and python-control's discretisation."""

from __future__ import annotations

from importlib.resources import files

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from firmware_sim.plants.linear_plant import LinearPlant
from hil.core.rig import Rig, read_rig

RIG: Rig = read_rig((files("hil.shipped") / "rig.toml").read_text(), "rig.toml")
NUMERATOR = 0.47947 * np.array([1.0, 90.76])
DENOMINATOR = np.polymul([1.0, 0.4231], [1.0, 16.97, 167.9])


def advance(plant: LinearPlant, duration_ns: int, offset_v: float) -> float:
    plant.advance(duration_ns, [5.0 + offset_v] * 3)
    return plant.position("vertical")


@pytest.mark.parametrize("duration_s", [1e-6, 0.2e-3, 0.0112, 0.1, 2.0])
def test_same_as_scipys_zero_order_hold(duration_s: float) -> None:
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


def test_same_as_python_control_at_the_loops_period() -> None:
    sampled = control.c2d(control.tf(NUMERATOR, DENOMINATOR), RIG.loop.period_s, "zoh")
    offsets_v = np.random.default_rng(2).uniform(-1.0, 1.0, 400)
    expected = control.forced_response(sampled, U=offsets_v).outputs
    plant = LinearPlant(RIG)
    positions = [0.0, *(advance(plant, RIG.loop.period_ns, offset_v) for offset_v in offsets_v)]
    assert positions[:-1] == pytest.approx(list(expected), rel=1e-9, abs=1e-11)


def test_static_gain() -> None:
    assert advance(LinearPlant(RIG), 100 * 10**9, 0.1) == pytest.approx(
        0.1 * 0.47947 * 90.76 / (0.4231 * 167.9), rel=1e-12
    )


@given(
    st.lists(st.integers(1, 50_000_000), min_size=1, max_size=8),
    st.floats(-5.0, 5.0),
    st.floats(-5.0, 5.0),
)
def test_a_hold_cut_into_pieces_is_the_same_hold(
    pieces_ns: list[int], before_v: float, offset_v: float
) -> None:
    whole, cut = LinearPlant(RIG), LinearPlant(RIG)
    for plant in (whole, cut):
        advance(plant, 300_000_000, before_v)
    for piece_ns in pieces_ns:
        advance(cut, piece_ns, offset_v)
    assert advance(whole, sum(pieces_ns), offset_v) == pytest.approx(cut.position("vertical"), abs=1e-13)


def test_axes_are_uncoupled_and_keep_to_their_channels() -> None:
    plant = LinearPlant(RIG)
    plant.advance(500_000_000, [5.0, 5.2, 5.0])
    assert plant.position("vertical") == plant.position("rotation") == 0.0
    moved = plant.position("horizontal")
    pot = RIG.axes["horizontal"].potentiometer
    assert moved > 0.0
    assert list(plant.potentiometer_v()) == [5.0, pot.volts(moved), 5.0]


def test_the_potentiometer_ends_at_its_range() -> None:
    plant = LinearPlant(RIG)
    plant.advance(10 * 10**9, [10.0, 0.0, 5.0])
    assert list(plant.potentiometer_v()) == [10.0, 0.0, 5.0]


def test_a_channel_without_an_axis_reads_zero() -> None:
    text = (files("hil.shipped") / "rig.toml").read_text()
    alone = read_rig(text[: text.index("[axes.horizontal]")], "rig.toml")
    plant = LinearPlant(alone)
    plant.advance(11_200_000, [5.0, 10.0, 10.0])
    assert list(plant.potentiometer_v()) == [5.0, 0.0, 0.0]
