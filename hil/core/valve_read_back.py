"""The read-back of the valves: TPDO1_DAC, in which the valve board answers each SYNC with its pins' voltages.

The voltages after a SYNC are those of the last command before it, whether the board applies commands at SYNC
or at once. A valve that differs from its command for several periods in a row does not follow it. Single
differences are tolerated, because a command or a SYNC can be lost on the bus. More answers than SYNCs in
several periods come from a second board with the same node id.
"""

from __future__ import annotations

from collections.abc import Sequence

from hil.core.rig import Rig
from hil.core.surplus_answers import SURPLUS_PERIODS_LIMIT, SurplusAnswers
from hil.core.sync_matching import MAX_COUNTER_STEP
from hil.core.wire import codec
from hil.core.wire.frame_crc import frame_crc

NO_FRAME_YET = "no read-back of the valves (TPDO1_DAC) has arrived (rig: dac.read_back)"


class ValveReadBack:
    """Comparison of commands and read-back of all valves, in the order of the rig's axes."""

    def __init__(self, rig: Rig) -> None:
        self._valves = [(name, axis.valve.channel) for name, axis in rig.axes.items()]
        self._protected = rig.dac.protected
        self._crc = frame_crc(codec.TPDO1_DAC, rig.bus.wire_version, protected=self._protected)
        self._length = codec.TPDO1_DAC_LENGTH if self._protected else codec.TPDO1_DAC_LENGTH - 2
        self._tolerance_v = rig.dac.read_back_tolerance_v
        self._max_periods = rig.dac.read_back_periods
        self._max_missing = rig.adc.stale_after_periods
        self._expected_v: Sequence[float] | None = None
        """Commands that the board applied at the last SYNC; None if its answer has arrived, or before it."""
        self._surplus = SurplusAnswers()
        self._last_counter: int | None = None
        self._missing = 0
        """Number of consecutive SYNCs that were not answered."""
        self._different = [0] * len(self._valves)
        """Number of consecutive answers in which a valve differed from its command, by axis."""
        self.problem: str | None = NO_FRAME_YET
        """Why the valves are not known to follow their commands; None if they follow."""

    def sync_sent(self, commanded_v: Sequence[float]) -> None:
        """Take the last commands (V, by axis) when SYNC is sent, and count an unanswered SYNC before.

        After too many SYNCs without answer, ``problem`` says so.
        """
        if self._expected_v is not None:
            self._missing += 1
            if self._missing >= self._max_missing and self.problem is None:
                self.problem = (
                    f"no read-back of the valves (TPDO1_DAC) for {self._missing} periods, limit "
                    f"{self._max_missing} (rig: adc.stale_after_periods)"
                )
        self._expected_v = tuple(commanded_v)
        self._surplus.begin_period()
        self._surplus.sync_sent()

    def receive(self, data: bytes) -> str | None:
        """Take the data of a TPDO1_DAC frame, and update ``problem``. Returns why it is rejected, or None."""
        rejection = self._damage(data)
        if rejection is not None:
            return rejection
        if self._surplus.answer_received():
            self.problem = (
                f"TPDO1_DAC: more answers than SYNCs in {SURPLUS_PERIODS_LIMIT} periods: another node sends "
                "the same identifier; check the node ids"
            )
            return None
        rejection = self._repetition(data) if self._protected else None
        if rejection is not None:
            return rejection
        if self._expected_v is None:
            return "TPDO1_DAC: no SYNC is unanswered: the frame came twice, or was sent without SYNC"
        expected_v, self._expected_v = self._expected_v, None
        self._missing = 0
        self.problem = self._compare(expected_v, codec.decode_tpdo1_dac((data + b"\0\0")[:8])[:3])
        return None

    def _damage(self, data: bytes) -> str | None:
        if len(data) != self._length:
            return f"TPDO1_DAC has {len(data)} bytes, not {self._length} (rig: dac.protected)"
        problem = None if self._crc is None else self._crc.problem(data)
        return None if problem is None else f"TPDO1_DAC: {problem}"

    def _repetition(self, data: bytes) -> str | None:
        """Return why a frame is not newer than the one before, or None. Its counter is remembered."""
        counter, before = data[6], self._last_counter
        self._last_counter = counter
        if before is not None and not 1 <= (counter - before) & 0xFF <= MAX_COUNTER_STEP:
            return f"TPDO1_DAC: counter {counter} after {before} is no newer frame"
        return None

    def _compare(self, expected_v: Sequence[float], pins_v: Sequence[float]) -> str | None:
        """Return which valve does not follow its command, or None."""
        problem, all_follow = None, True
        for index, ((axis, channel), command_v) in enumerate(zip(self._valves, expected_v, strict=True)):
            pin_v = pins_v[channel - 1]
            difference_v = abs(pin_v - command_v)
            if difference_v <= self._tolerance_v:
                self._different[index] = 0
                continue
            all_follow = False
            self._different[index] = periods = self._different[index] + 1
            if periods >= self._max_periods and problem is None:
                problem = (
                    f"valve of {axis}: {pin_v:.3f} V on the pin, commanded {command_v:.3f} V: they differ by "
                    f"{difference_v:.3f} V, limit {self._tolerance_v:g} V (rig: "
                    f"dac.read_back_tolerance_v), in {periods} periods in a row, limit {self._max_periods} "
                    "(rig: dac.read_back_periods): check the board's output and the valve's wiring"
                )
        # One difference is no problem yet, and does not end a problem either.
        return None if all_follow else problem or self.problem
