"""Checks on TPDO1_ADC: each at its boundary, in its order, with its reason."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest
from support.constants import COUNT_V, PERIOD_NS
from support.gateway_bench import make_rig, sample_frame

from hil.core.sample_guard import Accepted, Rejected, RejectionSeverity, SampleGuard, Verdict
from hil.core.sync_matching import ANSWER_TIMEOUT_PERIODS

VOLTS = (1.0, 5.0, 9.0)
LOST_SAMPLE, SECOND_SENDER = RejectionSeverity.LOST_SAMPLE, RejectionSeverity.SECOND_SENDER


def new_guard(**changes: str) -> SampleGuard:
    """A guard that has sent no SYNC; ``changes`` of the rig file have ``__`` for the dots of a key."""
    return SampleGuard(make_rig({key.replace("__", "."): text for key, text in changes.items()}))


def guard(**changes: str) -> SampleGuard:
    """A guard that has sent its first SYNC at 0 ns."""
    return send_syncs(new_guard(**changes))


def send_syncs(checks: SampleGuard, number: int = 1, now_ns: int = 0) -> SampleGuard:
    """Send ``number`` SYNCs, each in a period of its own."""
    for _ in range(number):
        assert checks.begin_period(now_ns, may_wait=False)
    return checks


def sample(counter: int = 0, volts: Sequence[float] = VOLTS) -> bytes:
    return sample_frame(volts, counter).data


def rejected(verdict: Verdict, severity: RejectionSeverity = LOST_SAMPLE) -> str:
    """The reason of a rejection."""
    assert isinstance(verdict, Rejected)
    assert verdict.severity is severity
    return verdict.reason


def accepted(verdict: Verdict) -> list[float]:
    """The voltages of an accepted sample."""
    assert isinstance(verdict, Accepted), verdict
    return verdict.volts


def test_a_good_sample_becomes_voltages() -> None:
    assert accepted(guard().check(sample(), 1000)) == pytest.approx(VOLTS, abs=COUNT_V / 2)


def test_voltages_are_in_the_order_of_the_rigs_axes() -> None:
    channels = {
        "axes__vertical__potentiometer__channel": "3",
        "axes__horizontal__potentiometer__channel": "1",
        "axes__rotation__potentiometer__channel": "2",
    }
    assert accepted(guard(**channels).check(sample(), 0)) == pytest.approx([9.0, 1.0, 5.0], abs=COUNT_V)


def test_a_period_without_sync_allows_no_further_answer() -> None:
    checks = new_guard(adc__protected="false")
    data = sample()[:6]
    assert checks.begin_period(0, may_wait=True)
    for number in (1, 2, 3):
        assert not checks.begin_period(number * PERIOD_NS, may_wait=True)
    checks.check(data, 3 * PERIOD_NS)
    assert not checks.suspects_second_sender
    checks.check(data, 3 * PERIOD_NS)
    assert checks.suspects_second_sender


class TestLength:
    @pytest.mark.parametrize("length", [0, 1, 6, 7])
    def test_a_protected_sample_must_have_8_bytes(self, length: int) -> None:
        reason = rejected(guard().check(sample()[:length], 0))
        assert reason == f"TPDO1_ADC has {length} bytes, not 8 (rig: adc.protected)"

    @pytest.mark.parametrize("length", [0, 5, 7, 8])
    def test_an_unprotected_sample_must_have_6_bytes(self, length: int) -> None:
        reason = rejected(guard(adc__protected="false").check(sample()[:length], 0))
        assert reason == f"TPDO1_ADC has {length} bytes, not 6 (rig: adc.protected)"

    def test_more_bytes_than_a_classic_frame_has_are_rejected(self) -> None:
        assert "has 12 bytes" in rejected(guard().check(sample() + bytes(4), 0))


class TestCrc:
    @pytest.mark.parametrize("bit", range(64))
    def test_any_single_wrong_bit_is_detected(self, bit: int) -> None:
        data = bytearray(sample())
        data[bit // 8] ^= 1 << bit % 8
        reason = rejected(guard().check(bytes(data), 0))
        assert re.fullmatch(r"TPDO1_ADC: CRC 0x[0-9A-F]{2}, computed 0x[0-9A-F]{2}", reason)

    def test_the_reason_has_received_and_computed_crc(self) -> None:
        data = sample()
        wrong = data[:7] + bytes((data[7] ^ 0xFF,))
        reason = rejected(guard().check(wrong, 0))
        assert reason == f"TPDO1_ADC: CRC 0x{wrong[7]:02X}, computed 0x{data[7]:02X}"

    def test_the_counter_of_a_damaged_frame_is_ignored(self) -> None:
        checks = guard()
        accepted(checks.check(sample(5), 0))
        data = sample(99)
        rejected(send_syncs(checks).check(data[:7] + bytes((data[7] ^ 1,)), 0))
        verdict = checks.check(sample(6), 0)
        accepted(verdict)
        assert verdict.lost_before == 0


class TestCounter:
    @pytest.mark.parametrize("first", [0, 17, 255])
    def test_the_first_counter_may_have_any_value(self, first: int) -> None:
        verdict = guard().check(sample(first), 0)
        accepted(verdict)
        assert verdict.lost_before == 0

    def test_the_counter_wraps_around(self) -> None:
        checks = guard()
        accepted(checks.check(sample(255), 0))
        for counter in range(600):
            verdict = send_syncs(checks).check(sample(counter), 0)
            accepted(verdict)
            assert verdict.lost_before == 0

    def test_an_old_counter_is_rejected_and_the_next_one_accepted(self) -> None:
        checks = guard()
        accepted(checks.check(sample(253), 0))
        for counter in (254, 255, 0, 1):
            accepted(send_syncs(checks).check(sample(counter), 0))
        reason = rejected(send_syncs(checks).check(sample(255), 0))
        assert reason == "TPDO1_ADC: counter went backwards from 1 to 255: an old sample"
        accepted(checks.check(sample(2), 0))

    @pytest.mark.parametrize(("step", "is_accepted"), [(127, True), (128, False)])
    def test_the_counter_may_advance_by_127(self, step: int, is_accepted: bool) -> None:
        checks = guard()
        accepted(checks.check(sample(9), 0))
        assert isinstance(send_syncs(checks, step).check(sample(9 + step), 0), Accepted) is is_accepted

    @pytest.mark.parametrize("counter", [0, 7, 255])
    def test_a_repeated_counter_is_rejected(self, counter: int) -> None:
        checks = guard()
        accepted(checks.check(sample(counter), 0))
        reason = rejected(send_syncs(checks).check(sample(counter), 0))
        assert reason == f"TPDO1_ADC: counter {counter} repeated"
        accepted(checks.check(sample(counter + 1), 0))

    @pytest.mark.parametrize(
        ("before", "after", "lost"), [(0, 2, 1), (0, 127, 126), (254, 1, 2), (255, 1, 1)]
    )
    def test_a_counter_that_skips_values_is_accepted_with_the_number_of_lost_samples(
        self, before: int, after: int, lost: int
    ) -> None:
        checks = guard()
        accepted(checks.check(sample(before), 0))
        verdict = send_syncs(checks, lost + 1).check(sample(after), 0)
        accepted(verdict)
        assert verdict.lost_before == lost

    def test_a_rejected_sample_also_gives_the_number_of_lost_samples(self) -> None:
        checks = guard()
        accepted(checks.check(sample(0), 0))
        out_of_range = send_syncs(checks, 3).check(sample(3, (0.0, 5.0, 5.0)), 0)
        assert "potentiometer" in rejected(out_of_range)
        assert out_of_range.lost_before == 2
        late = send_syncs(checks, 3).check(sample(5), 0)
        assert "answers an earlier SYNC" in rejected(late)
        assert late.lost_before == 1

    @pytest.mark.parametrize(("syncs", "step"), [(0, 1), (1, 2), (3, 4), (1, 127)])
    def test_a_counter_that_shows_more_answers_than_syncs_is_a_second_sender(
        self, syncs: int, step: int
    ) -> None:
        checks = guard()
        accepted(checks.check(sample(7), 0))
        reason = rejected(send_syncs(checks, syncs).check(sample(7 + step), 0), SECOND_SENDER)
        assert reason.startswith(
            f"TPDO1_ADC: counter {7 + step} after 7 shows more answers than unanswered SYNCs ({syncs}): "
        )
        later_ns = ANSWER_TIMEOUT_PERIODS * PERIOD_NS
        while not checks.begin_period(later_ns, may_wait=True):
            pass
        accepted(checks.check(sample(200), later_ns))  # as after a restart

    def test_after_a_restart_any_counter_is_accepted(self) -> None:
        checks = guard()
        accepted(checks.check(sample(7), 0))
        checks.restart()
        verdict = send_syncs(checks).check(sample(7), 0)
        accepted(verdict)
        assert verdict.lost_before == 0


class TestOncePerSync:
    @pytest.mark.parametrize("length", [8, 6])
    def test_a_sample_without_a_sync_is_rejected(self, length: int) -> None:
        checks = new_guard(adc__protected="true" if length == 8 else "false")
        reason = rejected(checks.check(sample()[:length], 0))
        assert reason == ("TPDO1_ADC: no SYNC is unanswered: the frame came twice, or was sent without SYNC")
        accepted(send_syncs(checks).check(sample(1)[:length], 0))

    def test_without_a_counter_the_second_answer_to_a_sync_is_rejected(self) -> None:
        checks = guard(adc__protected="false")
        accepted(checks.check(sample()[:6], 0))
        assert "the frame came twice" in rejected(checks.check(sample()[:6], 0))


class TestStrictCheck:
    """While a second sender is suspected, the strict check rejects every frame."""

    def suspicious(self) -> SampleGuard:
        checks = guard()
        accepted(checks.check(sample(3), 0))
        assert "repeated" in rejected(checks.check(sample(3), 0))
        return send_syncs(checks)

    @pytest.mark.parametrize("data", [sample(4), sample(4)[:7], bytes(8), sample(3)])
    def test_every_frame_is_rejected_as_from_a_second_sender(self, data: bytes) -> None:
        reason = rejected(self.suspicious().check_strictly(data, 0), SECOND_SENDER)
        assert reason.startswith("TPDO1_ADC: more answers than SYNCs: another node sends the same identifier")

    def test_the_normal_check_still_accepts_good_samples(self) -> None:
        checks = self.suspicious()
        accepted(checks.check(sample(4), 0))
        assert checks.suspects_second_sender

    def test_a_period_without_surplus_ends_the_suspicion(self) -> None:
        checks = self.suspicious()
        accepted(checks.check(sample(4), 0))
        accepted(send_syncs(checks).check_strictly(sample(5), 0))
        assert not checks.suspects_second_sender

    def test_the_number_of_lost_samples_is_given_too(self) -> None:
        checks = guard()
        accepted(checks.check(sample(3), 0))
        send_syncs(checks, 2)
        for _ in range(3):
            assert "repeated" in rejected(checks.check(sample(3), 0))
        verdict = checks.check_strictly(sample(5), 0)
        rejected(verdict, SECOND_SENDER)
        assert verdict.lost_before == 1

    def test_the_reason_of_a_certain_second_sender_stays(self) -> None:
        verdict = self.suspicious().check_strictly(sample(9), 0)
        assert "more answers than unanswered SYNCs (1)" in rejected(verdict, SECOND_SENDER)


class TestAge:
    def test_a_whole_period_is_accepted(self) -> None:
        accepted(guard().check(sample(), PERIOD_NS))

    def test_a_nanosecond_more_is_rejected(self) -> None:
        assert rejected(guard().check(sample(), PERIOD_NS + 1)) == (
            "TPDO1_ADC: arrived 11.20 ms after SYNC, limit 11.2 ms (rig: loop.period_s): the "
            "board, the bus or this machine was slow; hil doctor checks the machine"
        )


class TestRange:
    """0.1 V is 327.68 counts and 9.9 V is 32440.32 counts: the last counts inside and the first outside."""

    @pytest.mark.parametrize("channel", [0, 1, 2])
    @pytest.mark.parametrize(
        ("counts", "is_good"), [(327, False), (328, True), (32440, True), (32441, False)]
    )
    def test_each_channel_at_both_limits(self, channel: int, counts: int, is_good: bool) -> None:
        volts = [5.0, 5.0, 5.0]
        volts[channel] = counts * COUNT_V
        assert isinstance(guard().check(sample(0, volts), 0), Accepted) == is_good

    @pytest.mark.parametrize(
        ("counts", "is_good"), [(8191, False), (8192, True), (24576, True), (24577, False)]
    )
    def test_a_limit_of_a_whole_count_is_accepted(self, counts: int, is_good: bool) -> None:
        pot = "axes__vertical__potentiometer__"
        axis = {"axes__vertical__min_y": "-0.01", "axes__vertical__max_y": "0.01"}
        checks = guard(**{f"{pot}min_v": "2.5", f"{pot}max_v": "7.5"}, **axis)
        assert isinstance(checks.check(sample(0, (counts * COUNT_V, 5.0, 5.0)), 0), Accepted) == is_good

    def test_the_reason_names_axis_value_and_limits(self) -> None:
        assert rejected(guard().check(sample(0, (5.0, 9.95, 5.0)), 0)) == (
            "horizontal: potentiometer 9.950 V outside 0.1 to 9.9 V "
            "(rig: axes.horizontal.potentiometer): check for a broken wire or a short circuit"
        )

    def test_the_first_axis_outside_its_range_is_named(self) -> None:
        assert rejected(guard().check(sample(0, (5.0, 9.95, 0.0)), 0)).startswith("horizontal: ")

    def test_a_negative_voltage_is_rejected(self) -> None:
        assert rejected(guard().check(sample(0, (-0.1, 5.0, 5.0)), 0)).startswith(
            "vertical: potentiometer -0.100 V"
        )

    def test_a_channel_without_an_axis_may_have_any_voltage(self) -> None:
        checks = send_syncs(SampleGuard(make_rig(axes=("horizontal",))))
        assert accepted(checks.check(sample(0, (-1.0, 5.0, 9.99)), 0)) == pytest.approx([5.0])


class TestUnprotected:
    def test_six_bytes_are_voltages(self) -> None:
        checks = new_guard(adc__protected="false")
        for _ in range(3):  # without a counter, equal samples are not repetitions
            volts = accepted(send_syncs(checks).check(sample()[:6], 0))
            assert volts == pytest.approx(VOLTS, abs=COUNT_V)

    def test_age_and_range_are_checked(self) -> None:
        checks = guard(adc__protected="false")
        assert "ms after SYNC" in rejected(checks.check(sample()[:6], PERIOD_NS + 1))
        assert "vertical: potentiometer 0.000 V" in rejected(send_syncs(checks).check(bytes(6), 0))


def test_the_first_failed_check_gives_the_reason() -> None:
    """The order is length, CRC, counter, SYNC, age, range."""
    checks = guard()
    accepted(checks.check(sample(3), 0))
    bad_range = (0.0, 5.0, 5.0)
    late_ns = PERIOD_NS + 1
    assert "bytes" in rejected(checks.check(b"", late_ns))
    assert "CRC" in rejected(checks.check(bytes(8), late_ns))
    assert "twice, with" in rejected(checks.check(sample(3, bad_range), late_ns), SECOND_SENDER)
    assert "repeated" in rejected(checks.check(sample(3), late_ns))
    assert "repeated" in rejected(send_syncs(checks).check(sample(3, bad_range), late_ns))
    assert "more answers than unanswered SYNCs (1)" in rejected(
        checks.check(sample(5, bad_range), late_ns), SECOND_SENDER
    )
    assert "after SYNC" in rejected(checks.check(sample(4, bad_range), late_ns))
    assert "no SYNC is unanswered" in rejected(checks.check(sample(5, bad_range), late_ns))
    assert "after SYNC" in rejected(send_syncs(checks).check(sample(6, bad_range), late_ns))
    assert "potentiometer" in rejected(send_syncs(checks).check(sample(7, bad_range), PERIOD_NS))
