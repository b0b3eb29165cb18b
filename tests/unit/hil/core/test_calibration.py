"""What a calibration accepts, what it computes, and what it refuses."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from support.shipped_rig import SHIPPED_RIG

from hil.core.calibration import (
    MAX_NOISE_V,
    MIN_SAMPLES,
    CalibrationError,
    End,
    RestingVolts,
    check_middle,
    potentiometer_values,
    resting_volts,
    valve_values,
)
from hil.core.requests import JogRequest
from hil.lockstep_rig import LockstepRig

STEP_V = 0.02


def at(volts: float, *others: float) -> RestingVolts:
    return RestingVolts((volts, *(others or (5.0, 5.0))), (0.0, 0.0, 0.0))


class TestResting:
    def test_the_mean_of_every_channel_is_returned(self) -> None:
        volts = resting_volts([(4.9, 1.0, 2.0), (5.1, 1.0, 2.0)] * 20, 2, "horizontal")
        assert volts.mean_v == pytest.approx((5.0, 1.0, 2.0))
        assert volts.noise_v == pytest.approx((0.1, 0.0, 0.0)), "noise of another axis does not matter"

    @pytest.mark.parametrize(
        ("samples", "message"),
        [
            ([(5.0, 5.0, 5.0)] * (MIN_SAMPLES - 1), "vertical: 19 samples arrived, at least 20 are needed"),
            ([(5.0 + 0.01 * n, 5.0, 5.0) for n in range(40)], r"moves by \+0\.200 V during the measurement"),
            (
                [(5.0 + 2.1 * MAX_NOISE_V * (n % 2), 5.0, 5.0) for n in range(40)],
                "noise is 0.053 V, limit 0.05 V",
            ),
        ],
    )
    def test_useless_samples_are_refused(self, samples: list[tuple[float, ...]], message: str) -> None:
        with pytest.raises(CalibrationError, match=message):
            resting_volts(samples, 1, "vertical")


class TestPotentiometer:
    @pytest.mark.parametrize(("low_v", "high_v"), [(0.5, 9.5), (9.5, 0.5)])
    def test_the_scaling_goes_through_both_ends_in_either_direction(
        self, low_v: float, high_v: float
    ) -> None:
        values = potentiometer_values(SHIPPED_RIG, "vertical", End(-0.16, at(low_v)), End(0.16, at(high_v)))
        for volts, y in ((low_v, -0.16), (high_v, 0.16)):
            assert values.y_at_0v + (values.y_at_10v - values.y_at_0v) * volts / 10 == pytest.approx(y)
        assert (values.min_v, values.max_v) == pytest.approx((0.32, 9.68))

    def test_the_upper_margin_ends_at_the_largest_voltage_of_a_frame(self) -> None:
        values = potentiometer_values(SHIPPED_RIG, "vertical", End(-0.1, at(1.0)), End(0.1, at(9.95)))
        assert values.max_v == pytest.approx(9.999)

    @pytest.mark.parametrize(
        ("low", "high", "message"),
        [
            (End(0.1, at(1.0)), End(-0.1, at(9.0)), "--low must be less than --high"),
            (End(-0.1, at(4.9)), End(0.1, at(5.1)), r"4\.900 V and 5\.100 V, 0\.200 V apart, at least 1 V"),
            (End(-0.1, at(0.01)), End(0.1, at(9.0)), r"0\.010 V, less than 0\.05 V: a broken wire"),
            (
                End(-0.1, at(5.0, 1.0, 5.0)),
                End(0.1, at(5.0, 9.0, 5.0)),
                r"potentiometer of horizontal \(channel 2\) moved by 8\.000 V",
            ),
        ],
    )
    def test_ends_that_make_no_sense_are_refused(self, low: End, high: End, message: str) -> None:
        with pytest.raises(CalibrationError, match=message):
            potentiometer_values(SHIPPED_RIG, "vertical", low, high)

    @pytest.mark.parametrize("middle_v", [0.4, 9.7])
    def test_a_middle_outside_the_ends_is_refused(self, middle_v: float) -> None:
        low, high = End(-0.1, at(9.0)), End(0.1, at(1.0))
        check_middle("vertical", 1, low, high, at(5.0))
        with pytest.raises(CalibrationError, match=r"is not between 1\.000 V and 9\.000 V"):
            check_middle("vertical", 1, low, high, at(middle_v))


def valve(centre_v: float, dead_band_v: float, gain: float = 0.3) -> Callable[[float], float]:
    """The speed of an axis whose valve is closed within a dead band about ``centre_v``."""

    def speed(offset_v: float) -> float:
        beyond_v = abs(offset_v - centre_v) - dead_band_v / 2
        return 0.0 if beyond_v <= 0 else gain * beyond_v * (1 if offset_v > centre_v else -1)

    return speed


class TestValve:
    @pytest.mark.parametrize("centre_v", [-0.15, 0.0, 0.037])
    @pytest.mark.parametrize("dead_band_v", [0.0, 0.1])
    def test_centre_and_dead_band_are_found(self, centre_v: float, dead_band_v: float) -> None:
        found = valve_values(SHIPPED_RIG, "vertical", valve(centre_v, dead_band_v), STEP_V)
        assert found.centre_v == pytest.approx(5.0 + centre_v, abs=0.002)
        threshold_v = 2 * 0.01 * 0.3 / 0.3
        assert found.dead_band_v == pytest.approx(dead_band_v + threshold_v, abs=0.005)

    def test_an_axis_that_moves_the_wrong_way_is_refused(self) -> None:
        with pytest.raises(CalibrationError, match="it moves the wrong way; exchange the hoses"):
            valve_values(SHIPPED_RIG, "vertical", valve(0.0, 0.0, gain=-0.3), STEP_V)

    @pytest.mark.parametrize("speed", [lambda _v: 0.0, lambda _v: 0.1])
    def test_an_axis_that_does_not_follow_the_valve_is_refused(self, speed: Callable[[float], float]) -> None:
        with pytest.raises(CalibrationError, match=r"does not move both ways with the valve up to 1 V"):
            valve_values(SHIPPED_RIG, "vertical", speed, STEP_V)

    def test_the_centre_of_the_simulated_arms_valve_is_found_by_jogs(self) -> None:
        """Its catalogue value is 5.01 V; at rest, leakage and load shift the centre."""
        rig = LockstepRig(seed=3)
        rig.bring_up()
        rig.arm()
        period_s = rig.rig.loop.period_s

        def speed(offset_v: float) -> float:
            assert rig.operate(JogRequest("vertical", offset_v, 0.3)).accepted
            positions = []
            for _ in range(round(0.6 / period_s)):
                rig.step()
                positions.append(rig.signals["vertical"].position)
            first, last = round(0.1 / period_s), round(0.3 / period_s)
            return (positions[last] - positions[first]) / ((last - first) * period_s)

        found = valve_values(rig.rig, "vertical", speed, STEP_V)
        assert found.centre_v == pytest.approx(5.01, abs=0.03)
        assert 0.0 <= found.dead_band_v < 0.2
        assert rig.state.name == "ARMED"
