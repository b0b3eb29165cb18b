"""The periods without a good sample: too many in a row are a fault."""

from __future__ import annotations

from hil.core.life_cycle import LifeCycleState
from hil.core.operating_state import OperatingState
from hil.core.output import NOTHING, Output
from hil.core.rejections import Rejections
from hil.core.rig import Rig


class StalePeriods:
    """Counts periods without a good sample since the last good one, those that the loop skipped included."""

    def __init__(self, rig: Rig, state: OperatingState, rejections: Rejections) -> None:
        self._limit = rig.adc.stale_after_periods
        self._state = state
        self._rejections = rejections
        self._count = 0

    def restart(self) -> None:
        """Begin to count anew, because a good sample has arrived."""
        self._count = 0

    def add(self, periods: int, skipped: int) -> Output:
        """Count ``periods``, of which the loop missed ``skipped`` deadlines, and fault at the limit."""
        if self._state.current is LifeCycleState.OFFLINE:
            return NOTHING
        self._count += periods
        if self._count < self._limit:
            return NOTHING
        cause = (
            f"the loop itself missed {skipped} deadlines: other programs or the host took its time; hil "
            "doctor checks the machine"
            if skipped
            else "no TPDO1_ADC arrived: check the board and its cable, or the bus is overloaded: hil monitor "
            "shows its load"
        )
        reason = (
            f"no good sample for {self._count} periods, limit {self._limit} "
            f"(rig: adc.stale_after_periods); last cause: {self._rejections.last_reason or cause}"
        )
        return self._state.lose("adc", reason)
