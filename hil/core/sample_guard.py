"""Checks of every TPDO1_ADC frame. Only an undamaged, expected and fresh sample becomes voltages.

A frame passes the checks in this order, and the first one that it fails is reported:

1.  Length, and CRC if the board is protected. A damaged frame changes nothing but the number of rejected
    frames.
2.  Number of answers. More answers than SYNCs in several periods come from a second node
    (``surplus_answers``).
3.  Counter. It must advance by 1 to 127. A repeated counter is a frame that arrived twice. The same counter
    with other voltages, or a counter that shows more answers than SYNCs were sent, comes from a second
    node.
4.  Freshness. The sample must answer the last SYNC, and arrive within one period of it (``sync_matching``).
5.  Range of each potentiometer's voltage: broken wires and short circuits.

The verdict is :class:`Accepted` or :class:`Rejected`. A rejected frame counts as no sample. What follows
from a missing sample is decided by the gateway. A second sender is more than a missing sample: from then on
no sample can be trusted, because it may come from either node.
"""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple, TypeAlias

from hil.core.rig import Rig
from hil.core.surplus_answers import SURPLUS_PERIODS_LIMIT, SurplusAnswers
from hil.core.sync_matching import (
    ANSWER_TIMEOUT_PERIODS,
    FRESH,
    MAX_COUNTER_STEP,
    Earlier,
    Match,
    SyncMatcher,
    TooMany,
    TooOld,
)
from hil.core.wire import codec
from hil.core.wire.frame_crc import frame_crc

SECOND_NODE = "another node sends the same identifier; check the node ids"


class RejectionSeverity(Enum):
    """Consequence of a rejection."""

    LOST_SAMPLE = "lost sample"
    """This sample cannot be used. The next one may be good."""
    SECOND_SENDER = "second sender"
    """A second node sends TPDO1_ADC. No sample can be trusted."""


LOST_SAMPLE, SECOND_SENDER = RejectionSeverity.LOST_SAMPLE, RejectionSeverity.SECOND_SENDER


class Accepted(NamedTuple):
    """Verdict on a good sample."""

    volts: list[float]
    """Potentiometer voltages in volts, in the order of the rig's axes."""
    lost_before: int
    """Number of samples between the previous one and this one that did not arrive, by the board's counter."""


class Rejected(NamedTuple):
    """Verdict on a frame that must not be used."""

    reason: str
    severity: RejectionSeverity = LOST_SAMPLE
    lost_before: int = 0
    """Number of samples between the previous one and this one that did not arrive, by the board's counter."""


Verdict: TypeAlias = Accepted | Rejected


class SampleGuard:
    """Guard of the samples of one ADC board. Times are nanoseconds on one monotonic clock."""

    def __init__(self, rig: Rig) -> None:
        self._protected = rig.adc.protected
        self._crc = frame_crc(codec.TPDO1_ADC, rig.bus.wire_version, protected=self._protected)
        self._length = codec.TPDO1_ADC_LENGTH if self._protected else codec.TPDO1_ADC_LENGTH - 2
        self._period_ns = rig.loop.period_ns
        self._places = tuple(axis.potentiometer.channel - 1 for axis in rig.axes.values())
        self._ranges = tuple(
            (name, axis.potentiometer.min_v, axis.potentiometer.max_v) for name, axis in rig.axes.items()
        )
        self._matcher = SyncMatcher(rig.loop.period_ns, rig.adc.protected)
        self._surplus = SurplusAnswers()
        self._last_counter: int | None = None
        """Counter of the last frame that passed the counter check.

        None before the first and after a restart.
        """
        self._last_data = b""

    def restart(self) -> None:
        """Accept any counter next, because the board has restarted.

        SYNCs from before may still be answered.
        """
        self._last_counter = None
        self._matcher.restart()

    def begin_period(self, now_ns: int, may_wait: bool) -> bool:
        """Begin a period and return whether SYNC leaves in it.

        SYNC waits while an earlier one may still be answered, unless it may not wait.
        """
        self._surplus.begin_period()
        is_sent = self._matcher.begin_period(now_ns, may_wait)
        if is_sent:
            self._surplus.sync_sent()
        return is_sent

    @property
    def suspects_second_sender(self) -> bool:
        """True if more answers than SYNCs came lately, so that a second node may send samples too."""
        return self._surplus.is_suspected

    def check_strictly(self, data: bytes, now_ns: int) -> Verdict:
        """Check a frame as :meth:`check` does, and reject every sample while a second sender is suspected."""
        verdict = self.check(data, now_ns)
        is_certain = isinstance(verdict, Rejected) and verdict.severity is SECOND_SENDER
        if is_certain or not self.suspects_second_sender:
            return verdict
        reason = f"TPDO1_ADC: more answers than SYNCs: {SECOND_NODE}"
        return Rejected(reason, SECOND_SENDER, verdict.lost_before)

    def check(self, data: bytes, now_ns: int) -> Verdict:
        """Check the data of a TPDO1_ADC frame that arrived at ``now_ns``."""
        damaged = self._check_integrity(data)
        if damaged is not None:
            return damaged
        if self._surplus.answer_received():
            reason = f"TPDO1_ADC: more answers than SYNCs in {SURPLUS_PERIODS_LIMIT} periods: {SECOND_NODE}"
            return Rejected(reason, SECOND_SENDER)
        step = self._counter_step(data)
        if not 1 <= step <= MAX_COUNTER_STEP:
            return self._reject_counter(data, step)
        match = self._matcher.match(step, now_ns)
        if isinstance(match, TooMany):
            rejected = self._reject_too_many(data, match)
            self.restart()
            return rejected
        if self._protected:
            self._last_counter, self._last_data = data[6], data
        if match is not FRESH:
            return self._reject_match(match, step - 1)
        volts = self._decode(data)
        return self._check_range(volts, step - 1) or Accepted(volts, step - 1)

    def _check_integrity(self, data: bytes) -> Rejected | None:
        if len(data) != self._length:
            return Rejected(f"TPDO1_ADC has {len(data)} bytes, not {self._length} (rig: adc.protected)")
        problem = None if self._crc is None else self._crc.problem(data)
        return None if problem is None else Rejected(f"TPDO1_ADC: {problem}")

    def _counter_step(self, data: bytes) -> int:
        """Return the counter difference to the frame before, modulo 256; 1 if there is nothing to compare."""
        if not self._protected or self._last_counter is None:
            return 1
        return (data[6] - self._last_counter) & 0xFF

    def _decode(self, data: bytes) -> list[float]:
        sample = codec.decode_tpdo1_adc(data if self._protected else data + b"\0\0")
        return [sample[place] for place in self._places]

    def _check_range(self, volts: list[float], lost_before: int) -> Rejected | None:
        for volt, (axis, min_v, max_v) in zip(volts, self._ranges, strict=True):
            if not min_v <= volt <= max_v:
                reason = (
                    f"{axis}: potentiometer {volt:.3f} V outside {min_v:g} to {max_v:g} V "
                    f"(rig: axes.{axis}.potentiometer): check for a broken wire or a short circuit"
                )
                return Rejected(reason, lost_before=lost_before)
        return None

    def _reject_counter(self, data: bytes, step: int) -> Rejected:
        counter = data[6]
        if step > MAX_COUNTER_STEP:
            return Rejected(
                f"TPDO1_ADC: counter went backwards from {self._last_counter} to {counter}: an old sample"
            )
        if data != self._last_data and self._matcher.outstanding == 0:
            reason = f"TPDO1_ADC: counter {counter} twice, with different voltages: {SECOND_NODE}"
            return Rejected(reason, SECOND_SENDER)
        return Rejected(f"TPDO1_ADC: counter {counter} repeated")

    def _reject_too_many(self, data: bytes, match: TooMany) -> Rejected:
        return Rejected(
            f"TPDO1_ADC: counter {data[6]} after {self._last_counter} shows more answers than unanswered "
            f"SYNCs ({match.outstanding}): {SECOND_NODE}, or the board sends without SYNC, or it answers "
            f"later than {ANSWER_TIMEOUT_PERIODS} periods",
            SECOND_SENDER,
        )

    def _reject_match(self, match: Match, lost_before: int) -> Rejected:
        match match:
            case Earlier(later_syncs):
                before = f"{later_syncs} before the last"
                reason = f"answers an earlier SYNC, {before}: it is late, or the board missed a SYNC"
            case TooOld(age_ns):
                limit = f"limit {self._period_ns / 1e6:g} ms (rig: loop.period_s)"
                reason = (
                    f"arrived {age_ns / 1e6:.2f} ms after SYNC, {limit}: the board, the bus or this machine "
                    "was slow; hil doctor checks the machine"
                )
            case _:
                reason = "no SYNC is unanswered: the frame came twice, or was sent without SYNC"
        return Rejected(f"TPDO1_ADC: {reason}", lost_before=lost_before)
