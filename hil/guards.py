"""Guards on every sample: only a sound, expected, fresh TPDO1 becomes a position.

Fresh is what answers the last SYNC. A board counts its answers, so an answer to an earlier SYNC is told by
the counter, however soon after the last one it comes. Either it is late, or a SYNC was lost and every answer
looks late: one period without SYNC decides. Until an answer has come in time, only one SYNC at once is under
way, so that a link slower than a period never looks fresh. Later, boards without a counter are judged by age.
A board that counts more answers than it was asked for, or says two things under one number, is not alone.

A rejected sample is reported with its reason and counts as none. Nothing here decides what a missing sample
means: the gateway does.
"""

from __future__ import annotations

from hil.rig import Rig
from hil.wire import codec
from hil.wire.crc8 import crc8_j1850

FARTHEST_STEP = 127
"""Of the counter: beyond it, it went back."""
FIRST_ANSWER_PERIODS = 5
"""At first, and after a restart, SYNC waits so long for the answer to the one before."""


class Unasked(str):
    """The reason of a rejection that is more than a lost sample: what is fresh can no longer be told."""


class SampleGuard:
    """Checks of TPDO1_ADC, in the order length, CRC, counter, which SYNC, once a period, age, range."""

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
        self._unanswered = 0
        self._is_matched = False
        self._is_behind = False
        self._is_waiting = False
        self._silent_periods = 0
        self.lost = 0
        """Frames that the counter says were sent and did not come, or not intact."""

    def forget(self) -> None:
        """Expect any counter next: the board has restarted."""
        self._counter = None
        self._unanswered = 0
        self._is_matched = self._is_behind = False

    def wants_sync(self, may_wait: bool) -> bool:
        """Begin a period; False where it should pass without SYNC, which needs ``may_wait``."""
        expects_first = not self._is_matched and self._silent_periods < FIRST_ANSWER_PERIODS
        is_unclear = self._is_behind and not self._is_waiting
        if may_wait and self._unanswered > 0 and (expects_first or is_unclear):
            self._is_waiting = True
            self._silent_periods += 1
            return False
        if not self._is_matched or (self._is_waiting and self._is_behind):
            self._unanswered = 0  # nothing came late: the board had missed a SYNC
        self._is_behind = self._is_waiting = False
        self._silent_periods = 0
        self._unanswered += 1
        return True

    def check(self, data: bytes, age_ns: int, is_first: bool) -> list[float] | str:
        """Potentiometer voltages in the rig's order of axes, or the reason of the rejection.

        ``age_ns`` is the time since SYNC was sent, ``is_first`` whether this period has had no sample yet.
        """
        if len(data) != self._length:
            return f"TPDO1_ADC has {len(data)} bytes, not {self._length} (rig: adc.protected)"
        if self._protected:
            crc = crc8_j1850(data[:7])
            if crc != data[7]:
                return f"TPDO1_ADC: CRC 0x{data[7]:02X}, computed 0x{crc:02X}"
            counter = data[6]
            if self._counter is not None:
                step = (counter - self._counter) & 0xFF
                if step == 0 and not is_first and data != self._data:
                    return Unasked(
                        f"TPDO1_ADC: counter {counter} came twice in a period, with other values: another "
                        "node sends it too, under the same node id"
                    )
                if step == 0:
                    return f"TPDO1_ADC: counter {counter} repeated"
                if step > FARTHEST_STEP:
                    return f"TPDO1_ADC: counter went back from {self._counter} to {counter}: an old sample"
                if step > self._unanswered:
                    before, awaited = self._counter, self._unanswered
                    self.forget()
                    return Unasked(
                        f"TPDO1_ADC: counter {counter} after {before}, but {awaited} SYNC unanswered: "
                        "another node sends it too, or the board sends unasked, or later than two periods"
                    )
                self.lost += step - 1
                self._unanswered -= step
            else:
                self._unanswered = 0
            self._counter, self._data = counter, data
            self._is_behind = self._unanswered > 0 and not self._is_waiting
            if self._unanswered > 0:
                return (
                    f"TPDO1_ADC: answers an earlier SYNC, {self._unanswered} before the last: it is late, "
                    "or the board missed a SYNC"
                )
        else:
            self._unanswered = 0
        if not is_first:
            return "TPDO1_ADC: not the first sample since SYNC"
        if age_ns > self._period_ns:
            return (
                f"TPDO1_ADC: {age_ns / 1e6:.2f} ms after SYNC exceeds {self._period_ns / 1e6:g} ms "
                "(rig: loop.period_s)"
            )
        self._is_matched = True
        sample = codec.decode_tpdo1_adc(data if self._protected else data + b"\0\0")
        volts = [sample[channel] for channel, _, _, _ in self._channels]
        for value, (_, lowest, highest, axis) in zip(volts, self._channels, strict=True):
            if not lowest <= value <= highest:
                return (
                    f"{axis}: potentiometer {value:.3f} V outside {lowest:g} to {highest:g} V "
                    f"(rig: axes.{axis}.potentiometer), broken wire or short"
                )
        return volts
