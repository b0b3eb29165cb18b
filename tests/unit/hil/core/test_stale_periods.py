"""The periods without a good sample: their count, their limit, and the cause that a fault names."""

from __future__ import annotations

from support.gateway_bench import make_rig

from hil.core.frames import Frame
from hil.core.life_cycle import LifeCycleState
from hil.core.operating_state import OperatingState
from hil.core.output import NOTHING, LogThrottle
from hil.core.rejections import Rejections
from hil.core.stale_periods import StalePeriods

LIMIT = 4
RIG = make_rig({"adc.stale_after_periods": str(LIMIT)})


class Subject:
    """The count alone, with a life cycle in state running."""

    def __init__(self) -> None:
        throttle = LogThrottle()
        self.state = OperatingState(lambda: Frame(0x220), throttle)
        self.state.current = LifeCycleState.RUNNING
        self.rejections = Rejections(throttle)
        self.stale = StalePeriods(RIG, self.state, self.rejections)

    def fault(self, periods: int, skipped: int = 0) -> str:
        """The reason of the fault that these periods give."""
        self.stale.add(periods, skipped)
        assert self.state.fault_reason is not None
        return self.state.fault_reason


def test_the_count_goes_over_calls_and_the_fault_comes_at_the_limit() -> None:
    subject = Subject()
    assert subject.stale.add(1, 0) is NOTHING
    assert subject.stale.add(2, 0) is NOTHING
    assert subject.fault(1).startswith(
        "adc: no good sample for 4 periods, limit 4 (rig: adc.stale_after_periods); last cause: no TPDO1_ADC"
    )


def test_a_good_sample_begins_the_count_at_zero() -> None:
    subject = Subject()
    subject.stale.add(LIMIT - 1, 0)
    subject.stale.restart()
    assert subject.stale.add(LIMIT - 1, 0) is NOTHING
    assert "for 5 periods" in subject.fault(2)


def test_periods_that_the_loop_missed_are_named_as_the_cause() -> None:
    reason = Subject().fault(6, skipped=5)
    assert "no good sample for 6 periods, limit 4" in reason
    assert "the loop itself missed 5 deadlines" in reason
    assert "hil doctor" in reason
    assert "TPDO1_ADC" not in reason


def test_the_reason_of_the_last_rejection_is_the_cause() -> None:
    subject = Subject()
    subject.rejections.add("CRC 0x12, computed 0x34")
    assert subject.fault(LIMIT, skipped=1).endswith("last cause: CRC 0x12, computed 0x34")


def test_while_offline_nothing_is_counted() -> None:
    subject = Subject()
    subject.state.current = LifeCycleState.OFFLINE
    assert subject.stale.add(LIMIT, 0) is NOTHING
    subject.state.current = LifeCycleState.READY
    assert subject.stale.add(LIMIT - 1, 0) is NOTHING
    subject.stale.add(1, 0)
    assert subject.state.current.name == "OFFLINE"
