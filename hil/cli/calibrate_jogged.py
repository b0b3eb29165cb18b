"""Measure the ends of a potentiometer on an axis that is moved by jogs, by keys that a person holds.

Each press of a key asks the daemon for one short jog, and a held key repeats it. So the axis stops soon after
the key is released, and also if this program or the connection ends. The daemon must be one that was started
for this calibration (``hil daemon --calibrate AXIS``): only its limits let an axis reach its ends.
"""

from __future__ import annotations

import contextlib
import os
import sys
import termios
import tty
from collections import deque
from collections.abc import Callable, Iterator
from select import select

from hil.core.calibration import CalibrationError, RestingVolts, resting_volts
from hil.core.errors import RequestRefusedError
from hil.core.rig import CHANNELS, Rig
from hil.operation.client import Client
from hil.operation.protocol import Status

JOG_V = 0.3
"""Default offset of the valve from its centre, in volts."""
JOG_S = 0.25
"""Time of one jog, in seconds: longer than the pause before a held key repeats on most terminals."""
WATCH_S = 0.05
"""Time between two looks at the daemon's status and at the keys, in seconds."""
REST_LOOKS = 10
"""Number of looks in which the last jog ends."""
SAMPLES = 25
"""Number of samples of a measurement. The daemon gives ten each second."""
RELEASED_LOOKS = 12
"""Number of looks without a key after which the key counts as released. A held key repeats sooner."""
UP, DOWN, ENTER, QUIT = "+", "-", "\n", "q"
"""Keys: move up, move down, measure, give up."""


def check_daemon(status: Status, axis: str) -> None:
    """Check that the daemon was started to calibrate ``axis``. Raises CalibrationError."""
    if status.calibrated_axis != axis:
        raise CalibrationError(
            f"{axis}: the daemon's limits do not let this axis reach its ends; end it with `hil shutdown`, "
            f"and start it with `hil daemon --calibrate {axis}`"
        )
    if status.state not in ("ready", "armed"):
        raise CalibrationError(
            f"{axis}: the daemon is in state {status.state}; bring it to ready or armed (hil status)"
        )


@contextlib.contextmanager
def armed(client: Client) -> Iterator[None]:
    """Arm a daemon in state ready, and disarm it at the end. One that is armed already stays armed."""
    is_ready = client.status().state == "ready"
    if is_ready:
        client.arm()
    try:
        yield
    finally:
        if is_ready:
            _await_end_of_jog(client)
            with contextlib.suppress(RequestRefusedError):  # After a fault, there is nothing to disarm.
                client.disarm()


def _await_end_of_jog(client: Client) -> None:
    if client.status().state != "running":
        return
    with contextlib.closing(client.watch(WATCH_S)) as looks:  # type: ignore[type-var]
        for number, status in enumerate(looks):
            if status.state != "running" or number >= REST_LOOKS:
                return


@contextlib.contextmanager
def keys_of_terminal() -> Iterator[Callable[[], str]]:
    """Give a function that returns the keys that were pressed since the last call. It does not wait.

    Raises CalibrationError without a terminal: nobody would hold a key.
    """
    if not sys.stdin.isatty():
        raise CalibrationError("--jog needs a terminal, because the axis moves only while a key is held")
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield lambda: _pressed(descriptor)
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


def _pressed(descriptor: int) -> str:
    return os.read(descriptor, 1024).decode(errors="replace") if select([descriptor], [], [], 0)[0] else ""


class Hold:
    """The voltages while one key is held, and the last ones at which the axis stood still."""

    def __init__(self, channel: int, axis: str) -> None:
        self._channel = channel
        self._axis = axis
        self._key = ""
        self._looks_since_key = 0
        self._samples: deque[tuple[float, ...]] = deque(maxlen=SAMPLES)
        self.rested: RestingVolts | None = None
        """Voltages at which the axis stood still while the key was held; None if it has not yet."""

    def take(self, key: str, volts: tuple[float, ...] | None) -> None:
        """Take the key of one look, and the voltages if they are new.

        Another key begins anew, and so does a key after a pause.
        """
        self._looks_since_key += 1
        if key:
            if key != self._key or self._looks_since_key > RELEASED_LOOKS:
                self._samples.clear()
                self.rested = None
            self._key, self._looks_since_key = key, 0
        if volts is None or self._looks_since_key > RELEASED_LOOKS:
            return
        self._samples.append(volts)
        if len(self._samples) == SAMPLES:
            with contextlib.suppress(CalibrationError):
                self.rested = resting_volts(self._samples, self._channel, self._axis)


class JoggedEnds:
    """Moves an axis by keys, and measures the voltages where it stands still.

    Many axes do not stay at an end when the valve is centred. Therefore the voltage is that of an axis which
    a held key presses against its end. ``pressed`` returns the keys since its last call.
    """

    def __init__(self, client: Client, rig: Rig, axis: str, jog_v: float, pressed: Callable[[], str]) -> None:
        self._client = client
        self._places = {name: other.potentiometer.channel - 1 for name, other in rig.axes.items()}
        self._channel = rig.axes[axis].potentiometer.channel
        self._axis = axis
        self._jog_v = jog_v
        self._pressed = pressed
        self._last_period = -1
        self.recording: str | None = None
        """Recording of the daemon during the last look."""

    def end(self, place: str) -> RestingVolts:
        """Let the user press the axis against an end, and measure its voltages there.

        Raises CalibrationError if the user gives up, or if the daemon is in a fault.
        """
        hold = Hold(self._channel, self._axis)
        sys.stderr.write(
            f"Move {self._axis} to {place}: hold {UP} or {DOWN} until it stands still there for some "
            f"seconds, then press Enter ({QUIT}: give up).\n"
        )
        for status in self._until_enter(hold):
            if hold.rested is not None:
                break
            volts = self._volts(status)[self._channel - 1]
            sys.stderr.write(f"It has not stood still yet ({volts:.3f} V); hold the key for longer.\n")
        assert hold.rested is not None
        sys.stderr.write(f"{place}: {hold.rested.mean_v[self._channel - 1]:.3f} V\n")
        return hold.rested

    def between(self, place: str) -> RestingVolts:
        """Let the user move the axis to a place between its ends, and return its voltages there."""
        sys.stderr.write(f"Move {self._axis} to {place}, and press Enter while it is there.\n")
        status = next(self._until_enter(Hold(self._channel, self._axis)))
        volts = self._volts(status)
        sys.stderr.write(f"{place}: {volts[self._channel - 1]:.3f} V\n")
        return RestingVolts(volts, (0.0,) * len(volts))

    def _until_enter(self, hold: Hold) -> Iterator[Status]:
        """Jog while a key is held. Yield the status each time that Enter is pressed."""
        for status in self._looks():
            keys = self._pressed()
            if QUIT in keys:
                raise CalibrationError(f"{self._axis}: given up; nothing is written")
            key = next((key for key in reversed(keys) if key in (UP, DOWN)), "")
            is_new = status.period != self._last_period
            self._last_period = status.period
            hold.take(key, self._volts(status) if is_new else None)
            if ENTER in keys or "\r" in keys:
                yield status
            elif key:
                self._jog(key)
            self._show(status, hold)
        raise CalibrationError(f"{self._axis}: the daemon has ended")

    def _jog(self, key: str) -> None:
        try:
            self._client.jog(self._axis, self._jog_v if key == UP else -self._jog_v, JOG_S)
        except RequestRefusedError as error:
            sys.stderr.write(f"{error}\n")

    def _volts(self, status: Status) -> tuple[float, ...]:
        volts = [0.0] * CHANNELS
        for axis in status.axes:
            if axis.name in self._places and axis.potentiometer_v is not None:
                volts[self._places[axis.name]] = axis.potentiometer_v
        return tuple(volts)

    def _looks(self) -> Iterator[Status]:
        with contextlib.closing(self._client.watch(WATCH_S)) as looks:  # type: ignore[type-var]
            for status in looks:
                self.recording = status.recording
                if status.state == "fault":
                    raise CalibrationError(f"{self._axis}: the daemon is in a fault: {status.fault}")
                yield status

    def _show(self, status: Status, hold: Hold) -> None:
        if sys.stderr.isatty():
            still = "" if hold.rested is None else "stands still"
            sys.stderr.write(f"\r{self._volts(status)[self._channel - 1]:6.3f} V  {still:12}\r")
            sys.stderr.flush()
