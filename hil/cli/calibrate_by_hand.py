"""Measures the voltages of an axis that the user moves by hand, for ``hil calibrate``."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from select import select

from hil.cli.monitor import Monitor
from hil.core.calibration import CalibrationError, RestingVolts, resting_volts
from hil.core.rig import Rig

MEASUREMENT_S = 0.6
"""Time of a measurement at rest, in seconds: 53 samples at the period of the example rig."""
REFRESH_NS = 200_000_000
"""Time between two displays of the voltage."""


class Ends:
    """Measures the voltages of an axis that the user moves by hand.

    ``is_entered`` returns True once for each press of Enter.
    """

    def __init__(
        self,
        monitor: Monitor,
        rig: Rig,
        axis: str,
        samples: list[tuple[float, ...]],
        is_entered: Callable[[], bool],
        clock_ns: Callable[[], int],
    ) -> None:
        """``samples`` is the list to which ``monitor`` adds the voltages of each sample."""
        self._monitor = monitor
        self._rig = rig
        self._axis = axis
        self._channel = rig.axes[axis].potentiometer.channel
        self._samples = samples
        self._is_entered = is_entered
        self._clock_ns = clock_ns

    def measure(self, place: str) -> RestingVolts:
        """Ask for the axis at ``place``, wait for Enter, and measure. A useless measurement is repeated."""
        while True:
            sys.stderr.write(f"Move {self._axis} by hand to {place}, hold it still, and press Enter.\n")
            while not self._is_entered():
                self._monitor.listen_until(self._clock_ns() + REFRESH_NS)
                self._check_valves()
                self._show()
            self._samples.clear()
            self._monitor.listen_until(self._clock_ns() + round(MEASUREMENT_S * 1e9))
            try:
                volts = resting_volts(self._samples, self._channel, self._axis)
            except CalibrationError as error:
                sys.stderr.write(f"{error}\n")
                continue
            sys.stderr.write(f"{place}: {volts.mean_v[self._channel - 1]:.3f} V\n")
            return volts

    def _show(self) -> None:
        if sys.stderr.isatty():
            volts = f"{self._samples[-1][self._channel - 1]:6.3f} V" if self._samples else "no samples"
            sys.stderr.write(f"\r{volts}   \r")
            sys.stderr.flush()

    def _check_valves(self) -> None:
        """Check that no gateway moves the axis meanwhile. Raises CalibrationError."""
        valve_v = self._monitor.watch.status(self._clock_ns()).axes[self._axis].valve_v
        centre_v = self._rig.axes[self._axis].valve.centre_v
        if valve_v is not None and abs(valve_v - centre_v) > 0.01:
            raise CalibrationError(
                f"{self._axis}: a gateway holds its valve at {valve_v:.3f} V, not at the centre "
                f"{centre_v:g} V: stop it (hil stop), so that nothing moves the axis but your hand"
            )


def enter_pressed() -> bool:
    """Return whether the user has pressed Enter since the last call.

    Raises CalibrationError at the end of the input.
    """
    descriptor = sys.stdin.fileno()
    while select([descriptor], [], [], 0)[0]:
        character = os.read(descriptor, 1)  # not buffered, so that select sees the rest
        if not character:
            raise CalibrationError("the input ended before the measurement was complete")
        if character == b"\n":
            return True
    return False
