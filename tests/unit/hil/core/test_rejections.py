"""Rejected samples: no command leaves, the cause is reported, and reports are throttled."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from support.constants import CENTRED, PERIOD_NS
from support.gateway_bench import ADC_UP, DAC_UP, commands, faults, make_stepped, sample_frame, texts

from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.core.output import Severity
from hil.core.wire import codec

BAD_SAMPLES: dict[str, tuple[Callable[[int], Frame], str]] = {
    "length": (lambda counter: Frame(0x190, bytes(6)), "TPDO1_ADC has 6 bytes, not 8 (rig: adc.protected)"),
    "crc": (lambda counter: Frame(0x190, bytes(8)), "TPDO1_ADC: CRC 0x00, computed 0x"),
    "repeated": (lambda counter: sample_frame(CENTRED, counter - 1), "TPDO1_ADC: counter 0 repeated"),
    "low": (lambda counter: sample_frame((5.0, 0.05, 5.0), counter), "horizontal: potentiometer 0.050 V"),
    "high": (lambda counter: sample_frame((5.0, 5.0, 9.95), counter), "rotation: potentiometer 9.950 V"),
}


class TestRejectedSamples:
    """Each check of the sample guard, seen from a running gateway."""

    @pytest.mark.parametrize("kind", BAD_SAMPLES)
    def test_a_rejected_sample_sends_no_command_and_is_reported_once(self, kind: str) -> None:
        build, reason = BAD_SAMPLES[kind]
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline()
        frame = build(gateway.counter)
        for number in (1, 2, 3):
            output = gateway.receive(frame)
            assert output.frames == ()
            assert output.cycle is None
            assert gateway.core.rejected_frames == number
            if number == 1:
                (entry,) = output.log
                assert (entry.severity, entry.source) == (Severity.WARNING, "guard")
                assert entry.text.startswith(f"rejected: {reason}")
            else:
                assert output.log == ()
        assert gateway.state is LifeCycleState.RUNNING

    @pytest.mark.parametrize("kind", BAD_SAMPLES)
    def test_a_good_sample_after_a_rejected_one_is_controlled(self, kind: str) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline()
        gateway.receive(BAD_SAMPLES[kind][0](gateway.counter))
        gateway.lose_sample()
        gateway.deadline()
        assert len(commands(gateway.sample())) == 1
        gateway.deadline()
        bad = gateway.receive(BAD_SAMPLES["length"][0](0))
        assert len(bad.log) == 1  # reported again

    @pytest.mark.parametrize("kind", BAD_SAMPLES)
    def test_rejected_samples_alone_are_a_fault_that_names_the_cause(self, kind: str) -> None:
        build, reason = BAD_SAMPLES[kind]
        gateway = make_stepped(LifeCycleState.RUNNING)
        for _ in range(3):
            assert gateway.deadline().log == ()
            frame = build(gateway.counter)
            gateway.receive(frame)
            if kind != "repeated":
                gateway.counter += 1
        output = gateway.deadline()
        assert gateway.state is LifeCycleState.FAULT
        (text,) = faults(output)
        assert text.startswith(
            f"adc: no good sample for 3 periods, limit 3 (rig: adc.stale_after_periods); last cause: {reason}"
        )

    def test_a_sample_older_than_a_period_is_rejected(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        gateway.deadline()
        output = gateway.sample(after_ns=PERIOD_NS + 1)
        assert output.frames == ()
        assert texts(output) == [
            "guard: rejected: TPDO1_ADC: arrived 11.20 ms after SYNC, limit 11.2 ms (rig: loop.period_s): "
            "the board, the bus or this machine was slow; hil doctor checks the machine"
        ]
        gateway.deadline()
        assert len(commands(gateway.sample(after_ns=PERIOD_NS))) == 1

    def test_lost_samples_are_counted_and_their_reports_are_throttled(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        reports = []
        for _ in range(40):
            gateway.deadline()
            gateway.lose_sample()
            gateway.deadline()
            gateway.receive(ADC_UP, DAC_UP)
            output = gateway.sample()
            assert len(commands(output)) == 1
            reports += texts(output)
        assert gateway.core.lost_samples == 40
        assert reports == [
            f"guard: TPDO1_ADC: counter skipped 1, {number} samples lost so far"
            for number in (*range(1, 9), 16, 32)
        ]

    def test_a_rejected_sample_also_reports_the_samples_lost_before_it(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        for _ in range(2):
            gateway.deadline()
            gateway.lose_sample()
        gateway.deadline()
        output = gateway.sample((0.0, 5.0, 5.0))
        assert [text.split(" outside")[0] for text in texts(output)] == [
            "guard: TPDO1_ADC: counter skipped 2, 2 samples lost so far",
            "guard: rejected: vertical: potentiometer 0.000 V",
        ]

    def test_throttled_reports_of_rejections_give_their_number(self) -> None:
        gateway = make_stepped(LifeCycleState.RUNNING)
        reports: list[str] = []
        for _ in range(64):
            gateway.deadline()
            reports += texts(gateway.receive(Frame(codec.TPDO1_ADC, b"")))
            gateway.lose_sample()
            gateway.period()
        assert len(reports) == 8 + 3
        assert reports[7].startswith("guard: rejected: ")
        assert reports[8].startswith("guard: rejected (16 so far): ")
