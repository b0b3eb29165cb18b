"""Guards on every sample: only a sound, expected, fresh TPDO1 becomes a position.

Fresh is what answers the last SYNC, within a period. A board counts its answers, so each is laid beside the
SYNC that it answers if none was lost; where a later SYNC is then still unanswered, the answer is late, or the
board missed a SYNC. No SYNC leaves until the next answer would have come, a period later even than that: if
none does, a SYNC was lost. Then, as in the beginning, one SYNC at once is under way until an answer has come
in time, so that a link slower than a period never looks fresh. Of a board without a counter every SYNC that
is not answered in its period is followed by such a wait.

A board gives one answer to a SYNC. More answers, or two things said under one number, say that the board is
not alone.

A rejected sample is reported with its reason and counts as none. Nothing here decides what a missing sample
means: the gateway does.
"""

from __future__ import annotations

from collections import deque

from hil.core.rig import Rig
from hil.core.wire import codec
from hil.core.wire.crc8 import crc8_j1850

FARTHEST_STEP = 127
"""Of the counter: beyond it, it went back."""
FIRST_ANSWER_PERIODS = 5
"""No answer is waited for longer, and a link that takes longer is not told from one that answers in time."""
LEAST_SILENT_PERIODS = 2
"""But so many at least, whatever time went by: a stall of this machine may be one of the board, too."""
UNCOUNTED_ANSWER_PERIODS = 3
"""The same of a board without a counter, once it has answered in time."""


MOST_SURPLUS = 3
"""A board that answers twice in so many periods is two."""
NOT_ALONE = "another node sends it too, perhaps one of the same node id"


class Unasked(str):
    """The reason of a rejection that is more than a lost sample: what is fresh can no longer be told."""


class SampleGuard:
    """Checks of TPDO1_ADC, in the order length, CRC, counter, which SYNC, age, range."""

    def __init__(self, rig: Rig) -> None:
        self._protected = rig.adc.protected
        self._length = codec.TPDO1_ADC_LENGTH if self._protected else codec.TPDO1_ADC_LENGTH - 2
        self._period_ns = rig.loop.period_ns
        self._channels = tuple(
            (axis.potentiometer.channel - 1, axis.potentiometer.min_v, axis.potentiometer.max_v, name)
            for name, axis in rig.axes.items()
        )
        self._counter: int | None = None
        self._data = b""
        self._is_matched = False
        """Whether it is known which SYNC an answer belongs to."""
        self._has_matched = False
        """Whether it once was, since the board started."""
        self._unanswered: deque[int] = deque(maxlen=FARTHEST_STEP)
        """When the SYNCs left that have no answer, if every answer so far belongs to the oldest."""
        self._silent_periods = 0
        self._late_answer_ns: int | None = None
        """How long after its SYNC the last answer came, where that was not the last SYNC."""
        self.lost = 0
        """Frames that the counter says were sent and did not come, or not intact."""
        self._owed = 0
        self._has_surplus = False
        self.surplus = 0
        """Periods with more intact answers than SYNCs, whatever they count, less the periods without."""

    def forget(self) -> None:
        """Expect any counter next: the board has restarted. What was asked before may still be answered."""
        self._counter = None
        self._is_matched = self._has_matched = False

    def begin_period(self, now_ns: int, may_wait: bool) -> bool:
        """Whether SYNC leaves now: not while an earlier one may be answered yet, unless it may not wait."""
        if not self._has_surplus:
            self.surplus = max(self.surplus - 1, 0)
        self._has_surplus = False
        if self._awaits_answer(now_ns) and may_wait:
            self._silent_periods += 1
            return False
        self._silent_periods = 0
        self._unanswered.append(now_ns)
        self._owed = min(self._owed + 1, FIRST_ANSWER_PERIODS)
        return True

    def _awaits_answer(self, now_ns: int) -> bool:
        unanswered = self._unanswered
        longest_ns = FIRST_ANSWER_PERIODS * self._period_ns
        if not self._protected and self._has_matched:
            longest_ns = UNCOUNTED_ANSWER_PERIODS * self._period_ns
            self._is_matched = self._is_matched and not unanswered
        may_know = self._silent_periods >= LEAST_SILENT_PERIODS
        if not self._is_matched:
            while unanswered and may_know and now_ns - unanswered[0] >= longest_ns:
                unanswered.popleft()
            return len(unanswered) > 0
        if self._late_answer_ns is None or not unanswered:
            return False
        if not may_know or now_ns - unanswered[-1] < min(self._late_answer_ns + self._period_ns, longest_ns):
            return True
        unanswered.clear()  # the last answer was in time, to the SYNC before it; others were lost
        self._is_matched = False
        return False

    def check(self, data: bytes, now_ns: int) -> list[float] | str:
        """Potentiometer voltages in the rig's order of axes, or the reason of the rejection."""
        if len(data) != self._length:
            return f"TPDO1_ADC has {len(data)} bytes, not {self._length} (rig: adc.protected)"
        step = 1
        if self._protected:
            crc = crc8_j1850(data[:7])
            if crc != data[7]:
                return f"TPDO1_ADC: CRC 0x{data[7]:02X}, computed 0x{crc:02X}"
        self._count()
        if self.surplus >= MOST_SURPLUS:
            return Unasked(f"TPDO1_ADC: {MOST_SURPLUS} periods with more answers than SYNCs: {NOT_ALONE}")
        if self._protected:
            if self._counter is not None:
                step = (data[6] - self._counter) & 0xFF
                complaint = self._counter_complaint(data, step)
                if complaint:
                    return complaint
                self.lost += step - 1
            self._counter, self._data = data[6], data
        elif self._is_matched:
            step = len(self._unanswered)
        if not self._unanswered:
            return "TPDO1_ADC: no SYNC is unanswered: it came twice, or unasked"
        age_ns = self._match(step, now_ns)
        if self._unanswered:
            return (
                f"TPDO1_ADC: answers an earlier SYNC, {len(self._unanswered)} before the last: it is late, "
                "or the board missed a SYNC"
            )
        if age_ns > self._period_ns:
            return (
                f"TPDO1_ADC: {age_ns / 1e6:.2f} ms after SYNC exceeds {self._period_ns / 1e6:g} ms "
                "(rig: loop.period_s)"
            )
        self._is_matched = self._has_matched = True
        sample = codec.decode_tpdo1_adc(data if self._protected else data + b"\0\0")
        volts = [sample[channel] for channel, _, _, _ in self._channels]
        for value, (_, lowest, highest, axis) in zip(volts, self._channels, strict=True):
            if not lowest <= value <= highest:
                return (
                    f"{axis}: potentiometer {value:.3f} V outside {lowest:g} to {highest:g} V "
                    f"(rig: axes.{axis}.potentiometer), broken wire or short"
                )
        return volts

    def _count(self) -> None:
        """Set an intact answer against the SYNCs."""
        if self._owed > 0:
            self._owed -= 1
        elif not self._has_surplus:
            self._has_surplus = True
            self.surplus = min(self.surplus + 1, 2 * MOST_SURPLUS)

    def _counter_complaint(self, data: bytes, step: int) -> str:
        counter = data[6]
        if step == 0 and not self._unanswered and data != self._data:
            return Unasked(f"TPDO1_ADC: counter {counter} came twice, with other values: {NOT_ALONE}")
        if step == 0:
            return f"TPDO1_ADC: counter {counter} repeated"
        if step > FARTHEST_STEP:
            return f"TPDO1_ADC: counter went back from {self._counter} to {counter}: an old sample"
        if self._is_matched and step > len(self._unanswered):
            before, awaited = self._counter, len(self._unanswered)
            self.forget()
            return Unasked(
                f"TPDO1_ADC: counter {counter} after {before}, but {awaited} SYNC unanswered: {NOT_ALONE}, "
                f"or the board sends unasked, or later than {FIRST_ANSWER_PERIODS} periods"
            )
        return ""

    def _match(self, step: int, now_ns: int) -> int:
        """Lay an answer beside the SYNC that it belongs to, ``step`` further on; returns its age."""
        for _ in range(min(step, len(self._unanswered))):
            age_ns = now_ns - self._unanswered.popleft()
        self._late_answer_ns = age_ns if self._unanswered else None
        return age_ns
