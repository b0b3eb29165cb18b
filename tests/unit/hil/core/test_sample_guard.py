"""Guards on TPDO1: every check at its boundary, in its order, with its reason."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest
from support.gateway_bench import make_rig, sample_frame

from hil.core.sample_guard import FIRST_ANSWER_PERIODS, SampleGuard, Unasked

VOLTS = (1.0, 5.0, 9.0)
COUNT_V = 10.0 / 32768
PERIOD_NS = 11_200_000


def asked(checks: SampleGuard, times: int = 1, now_ns: int = 0) -> SampleGuard:
    """Send so many SYNCs at 0 ns."""
    for _ in range(times):
        assert checks.begin_period(now_ns, may_wait=False)
    return checks


def guard(**changes: str) -> SampleGuard:
    """A guard that has sent its first SYNC."""
    return asked(SampleGuard(make_rig({key.replace("__", "."): text for key, text in changes.items()})))


def sample(counter: int = 0, volts: Sequence[float] = VOLTS) -> bytes:
    return sample_frame(volts, counter).data


def verdict(checked: list[float] | str) -> str:
    assert isinstance(checked, str)
    return checked


def accepted(checked: list[float] | str) -> list[float]:
    assert isinstance(checked, list), checked
    return checked


def test_a_sound_sample_becomes_voltages() -> None:
    assert accepted(guard().check(sample(), 1000)) == pytest.approx(VOLTS, abs=COUNT_V / 2)


def test_voltages_come_in_the_rigs_order_of_axes() -> None:
    channels = {
        "axes__vertical__potentiometer__channel": "3",
        "axes__horizontal__potentiometer__channel": "1",
        "axes__rotation__potentiometer__channel": "2",
    }
    assert accepted(guard(**channels).check(sample(), 0)) == pytest.approx([9.0, 1.0, 5.0], abs=COUNT_V)


class TestLength:
    @pytest.mark.parametrize("length", [0, 1, 6, 7])
    def test_a_protected_sample_has_8_bytes(self, length: int) -> None:
        assert (
            guard().check(sample()[:length], 0) == f"TPDO1_ADC has {length} bytes, not 8 (rig: adc.protected)"
        )

    @pytest.mark.parametrize("length", [0, 5, 7, 8])
    def test_an_unprotected_one_has_6(self, length: int) -> None:
        checked = guard(adc__protected="false").check(sample()[:length], 0)
        assert checked == f"TPDO1_ADC has {length} bytes, not 6 (rig: adc.protected)"

    def test_more_than_a_classic_frame_is_refused(self) -> None:
        assert "has 12 bytes" in verdict(guard().check(sample() + bytes(4), 0))


class TestCrc:
    @pytest.mark.parametrize("bit", range(64))
    def test_any_single_bit_is_noticed(self, bit: int) -> None:
        data = bytearray(sample())
        data[bit // 8] ^= 1 << bit % 8
        text = verdict(guard().check(bytes(data), 0))
        assert re.fullmatch(r"TPDO1_ADC: CRC 0x[0-9A-F]{2}, computed 0x[0-9A-F]{2}", text)

    def test_both_values_are_told(self) -> None:
        data = sample()
        wrong = data[:7] + bytes((data[7] ^ 0xFF,))
        assert guard().check(wrong, 0) == f"TPDO1_ADC: CRC 0x{wrong[7]:02X}, computed 0x{data[7]:02X}"

    def test_a_corrupt_counter_is_not_taken_over(self) -> None:
        checks = guard()
        accepted(checks.check(sample(5), 0))
        data = sample(99)
        verdict(asked(checks).check(data[:7] + bytes((data[7] ^ 1,)), 0))
        accepted(checks.check(sample(6), 0))
        assert checks.lost == 0


class TestCounter:
    @pytest.mark.parametrize("first", [0, 17, 255])
    def test_the_first_may_have_any(self, first: int) -> None:
        checks = guard()
        accepted(checks.check(sample(first), 0))
        assert checks.lost == 0

    def test_one_more_each_time_around_the_clock(self) -> None:
        checks = guard()
        accepted(checks.check(sample(255), 0))
        for counter in range(600):
            accepted(asked(checks).check(sample(counter), 0))
        assert checks.lost == 0

    def test_an_old_one_is_rejected_and_the_next_taken(self) -> None:
        checks = guard()
        accepted(checks.check(sample(253), 0))
        for counter in (254, 255, 0, 1):
            accepted(asked(checks).check(sample(counter), 0))
        assert asked(checks).check(sample(255), 0) == (
            "TPDO1_ADC: counter went back from 1 to 255: an old sample"
        )
        accepted(checks.check(sample(2), 0))

    @pytest.mark.parametrize(("step", "is_accepted"), [(127, True), (128, False)])
    def test_half_a_turn_is_the_farthest(self, step: int, is_accepted: bool) -> None:
        checks = guard()
        accepted(checks.check(sample(9), 0))
        assert isinstance(asked(checks, step).check(sample(9 + step), 0), list) is is_accepted

    @pytest.mark.parametrize("counter", [0, 7, 255])
    def test_a_repeated_one_is_rejected(self, counter: int) -> None:
        checks = guard()
        accepted(checks.check(sample(counter), 0))
        assert asked(checks).check(sample(counter), 0) == f"TPDO1_ADC: counter {counter} repeated"
        accepted(checks.check(sample(counter + 1), 0))

    @pytest.mark.parametrize(
        ("before", "after", "lost"), [(0, 2, 1), (0, 127, 126), (254, 1, 2), (255, 1, 1)]
    )
    def test_skipped_ones_are_counted_and_the_sample_is_good(
        self, before: int, after: int, lost: int
    ) -> None:
        checks = guard()
        accepted(checks.check(sample(before), 0))
        accepted(asked(checks, lost + 1).check(sample(after), 0))
        assert checks.lost == lost

    @pytest.mark.parametrize(("syncs", "step"), [(0, 1), (1, 2), (3, 4), (1, 127)])
    def test_more_answers_than_syncs_are_told_apart(self, syncs: int, step: int) -> None:
        checks = guard()
        accepted(checks.check(sample(7), 0))
        said = asked(checks, syncs).check(sample(7 + step), 0)
        assert isinstance(said, Unasked)
        assert said.startswith(f"TPDO1_ADC: counter {7 + step} after 7, but {syncs} SYNC unanswered: ")
        later_ns = FIRST_ANSWER_PERIODS * PERIOD_NS  # as after a restart
        while not checks.begin_period(later_ns, may_wait=True):
            pass
        accepted(checks.check(sample(200), later_ns))

    def test_after_a_restart_any_is_expected(self) -> None:
        checks = guard()
        accepted(checks.check(sample(7), 0))
        checks.forget()
        accepted(asked(checks).check(sample(7), 0))
        assert checks.lost == 0


class TestOnceAPeriod:
    @pytest.mark.parametrize("length", [8, 6])
    def test_what_nobody_asked_for_is_no_sample(self, length: int) -> None:
        checks = SampleGuard(make_rig({"adc.protected": "true" if length == 8 else "false"}))
        said = checks.check(sample()[:length], 0)
        assert said == "TPDO1_ADC: no SYNC is unanswered: it came twice, or unasked"
        accepted(asked(checks).check(sample(1)[:length], 0))

    def test_without_a_counter_only_the_first_counts(self) -> None:
        checks = guard(adc__protected="false")
        accepted(checks.check(sample()[:6], 0))
        assert "came twice, or unasked" in verdict(checks.check(sample()[:6], 0))


class TestAge:
    def test_a_whole_period_is_allowed(self) -> None:
        accepted(guard().check(sample(), PERIOD_NS))

    def test_a_nanosecond_more_is_not(self) -> None:
        assert guard().check(sample(), PERIOD_NS + 1) == (
            "TPDO1_ADC: 11.20 ms after SYNC exceeds 11.2 ms (rig: loop.period_s)"
        )


class TestRange:
    """0.1 V is 327.68 counts, 9.9 V is 32440.32: the last counts inside and the first outside."""

    @pytest.mark.parametrize("channel", [0, 1, 2])
    @pytest.mark.parametrize(
        ("counts", "is_good"), [(327, False), (328, True), (32440, True), (32441, False)]
    )
    def test_each_channel_at_both_limits(self, channel: int, counts: int, is_good: bool) -> None:
        volts = [5.0, 5.0, 5.0]
        volts[channel] = counts * COUNT_V
        assert isinstance(guard().check(sample(0, volts), 0), list) == is_good

    @pytest.mark.parametrize(
        ("counts", "is_good"), [(8191, False), (8192, True), (24576, True), (24577, False)]
    )
    def test_a_limit_that_is_a_whole_count_is_allowed(self, counts: int, is_good: bool) -> None:
        pot = "axes__vertical__potentiometer__"
        axis = {"axes__vertical__min_y": "-0.01", "axes__vertical__max_y": "0.01"}
        checks = guard(**{f"{pot}min_v": "2.5", f"{pot}max_v": "7.5"}, **axis)
        assert isinstance(checks.check(sample(0, (counts * COUNT_V, 5.0, 5.0)), 0), list) == is_good

    def test_the_reason_names_axis_value_and_limits(self) -> None:
        assert guard().check(sample(0, (5.0, 9.95, 5.0)), 0) == (
            "horizontal: potentiometer 9.950 V outside 0.1 to 9.9 V "
            "(rig: axes.horizontal.potentiometer), broken wire or short"
        )

    def test_a_negative_voltage_is_outside(self) -> None:
        assert verdict(guard().check(sample(0, (-0.1, 5.0, 5.0)), 0)).startswith(
            "vertical: potentiometer -0.100 V"
        )

    def test_a_channel_without_an_axis_may_read_anything(self) -> None:
        checks = asked(SampleGuard(make_rig(axes=("horizontal",))))
        assert accepted(checks.check(sample(0, (-1.0, 5.0, 9.99)), 0)) == pytest.approx([5.0])


class TestUnprotected:
    def test_six_bytes_are_voltages(self) -> None:
        checks = SampleGuard(make_rig({"adc.protected": "false"}))
        for _ in range(3):  # nothing can tell a repetition
            volts = accepted(asked(checks).check(sample()[:6], 0))
            assert volts == pytest.approx(VOLTS, abs=COUNT_V)

    def test_all_other_guards_stand(self) -> None:
        checks = guard(adc__protected="false")
        assert "after SYNC exceeds" in verdict(checks.check(sample()[:6], PERIOD_NS + 1))
        assert "vertical: potentiometer 0.000 V" in verdict(asked(checks).check(bytes(6), 0))


def test_the_first_broken_rule_is_told() -> None:
    """Length, CRC, counter, whether asked for, age, range."""
    checks = guard()
    accepted(checks.check(sample(3), 0))
    bad_range = (0.0, 5.0, 5.0)
    assert "bytes" in verdict(checks.check(b"", PERIOD_NS + 1))
    assert "CRC" in verdict(checks.check(bytes(8), PERIOD_NS + 1))
    assert "came twice, with" in verdict(checks.check(sample(3, bad_range), PERIOD_NS + 1))
    assert "repeated" in verdict(checks.check(sample(3), PERIOD_NS + 1))
    assert "repeated" in verdict(asked(checks).check(sample(3, bad_range), PERIOD_NS + 1))
    assert "1 SYNC unanswered" in verdict(checks.check(sample(5, bad_range), PERIOD_NS + 1))
    assert "after SYNC" in verdict(checks.check(sample(4, bad_range), PERIOD_NS + 1))
    assert "unasked" in verdict(checks.check(sample(5, bad_range), PERIOD_NS + 1))
    assert "after SYNC" in verdict(asked(checks).check(sample(6, bad_range), PERIOD_NS + 1))
    assert "potentiometer" in verdict(asked(checks).check(sample(7, bad_range), PERIOD_NS))
