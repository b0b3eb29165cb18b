"""The bus of the model: which frame is on the wire, and when it ends.

The bus is a state machine with one deadline, ``next_event_ns``. It is idle, or one frame is on the wire. An
event is the start of a frame, its end, or the recovery of a controller from bus-off::

    idle -- a frame waits and the intermission is over: the smallest arbitration field wins --> on the wire
    on the wire -- end of frame: every other controller receives it                          --> idle
    on the wire -- bit error, or no acknowledgement: error frame; the frame waits again      --> idle

Times are integers of nanoseconds. A length in bits is rounded up to whole nanoseconds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from hil.core.frames import Frame
from hil.core.wire.frame_bits import INTERMISSION_BITS, bits_on_wire
from hil.links.bus_model.controller import Controller, ErrorState

NEVER: Final = 2**63 - 1
"""Time of an event that is not due, in nanoseconds."""
LONE_ERROR_FRAME_BITS: Final = 14
"""Length of the error frame of a node without others: its flag (6) and the delimiter (8)."""
ERROR_FRAME_BITS: Final = 20
"""Length of an error frame on a bus of several nodes. Those that see only the flag send flags of their own (6
more bits)."""
SUSPEND_BITS: Final = 8
"""Time after the intermission in which an error-passive controller that has just sent may not send again."""
RECESSIVE_BITS: Final = 11
"""Length of a recessive sequence, of which a controller counts 128 to recover from bus-off. Each frame ends
with one: the delimiter of its acknowledgement or of an error frame, and what follows it."""
_BITS_AFTER_ACKNOWLEDGEMENT: Final = 8 + INTERMISSION_BITS
"""Bits of a frame after the acknowledgement slot: its delimiter, end of frame (7) and the intermission."""
_NS: Final = 1_000_000_000

Disturbance = Callable[[str, int], int | None]
"""Function that is given the sender's name and the length in bits of each frame. It returns the bit at which
the frame is destroyed, or None."""


class Ended(NamedTuple):
    """Result of an event."""

    frame: Frame | None = None
    """Frame that every controller but ``sender`` has received; None if there is none."""
    sender: Controller | None = None
    changed: tuple[Controller, ...] = ()
    """Controllers whose error state has changed."""


NOTHING: Final = Ended()


class CanBus:
    """A bus with a bit rate in bit/s. Controllers can be added and removed at any time."""

    def __init__(self, bit_rate: int) -> None:
        self.bit_rate = bit_rate
        self.next_event_ns = NEVER
        """Time at which ``advance`` is to be called next."""
        self.is_busy = False
        """True while a frame is on the wire."""
        self.disturbances: list[Disturbance] = []
        """Functions that destroy frames; the first one that returns a bit counts."""
        self.frames = 0
        """Number of frames that were sent without error."""
        self.error_frames = 0
        """Number of error frames."""
        self.busy_ns = 0
        """Time in which the wire was used so far, with intermissions and error frames."""
        self._controllers: list[Controller] = []
        self._sender: Controller | None = None
        """Controller whose frame is on the wire; None if it was removed meanwhile."""
        self._began_ns = 0
        self._free_ns = 0
        """Time from which the next frame may begin."""
        self._intermission_ns = self.duration_ns(INTERMISSION_BITS)
        self._is_destroyed = self._is_unacknowledged = False
        self._counts_errors = False
        """True once an error occurred; before, all error counters are 0."""

    def add(self, controller: Controller, now_ns: int) -> None:
        """Connect a controller to the bus."""
        self._controllers.append(controller)
        self._counts_errors = self._counts_errors or controller.tec + controller.rec > 0
        self._schedule(now_ns)

    def remove(self, controller: Controller, now_ns: int) -> None:
        """Disconnect a controller. A frame that it was sending is destroyed, and waits in its queue."""
        self._controllers.remove(controller)
        self._abort(controller, now_ns)
        self._schedule(now_ns)

    def take_off(self, controller: Controller, now_ns: int) -> None:
        """Make a controller bus-off, as after too many errors. It does not recover before ``restart``."""
        self._abort(controller, now_ns)
        controller.go_bus_off()
        controller.recovery_left = 0
        self._counts_errors = True
        self._schedule(now_ns)

    def send(self, controller: Controller, frame: Frame, now_ns: int) -> bool:
        """Hand a frame to a controller of this bus. Return False if it refuses the frame."""
        if not controller.enqueue(frame):
            return False
        if not self.is_busy:
            start_ns = max(now_ns, self._free_ns, controller.ready_ns)
            if start_ns < self.next_event_ns:
                self.next_event_ns = start_ns
        return True

    def advance(self, now_ns: int) -> Ended:
        """Handle the event that is due at ``now_ns``."""
        if self.is_busy:
            return self._end(now_ns)
        recovered = self._recover(now_ns) if self._counts_errors else ()
        self._begin(now_ns)
        return Ended(changed=recovered) if recovered else NOTHING

    def restart(self, controller: Controller, now_ns: int) -> None:
        """Let a controller that is bus-off recover, after 128 sequences of 11 recessive bits."""
        if controller.is_bus_off and not controller.recovery_left:
            controller.begin_recovery(now_ns)
            self._counts_errors = True
            self._schedule(now_ns)

    def duration_ns(self, bits: int) -> int:
        """Return the duration of a number of bits."""
        return -(-bits * _NS // self.bit_rate)

    def _abort(self, controller: Controller, now_ns: int) -> None:
        """Destroy the frame on the wire if this controller sends it."""
        if self.is_busy and self._sender is controller:
            self._sender = None
            self._is_destroyed = True
            self.next_event_ns = now_ns + self.duration_ns(ERROR_FRAME_BITS)

    def _begin(self, now_ns: int) -> None:
        """Let the waiting frame with the highest priority begin, if there is one."""
        best: tuple[int, Frame] | None = None
        for controller in self._controllers:
            queue = controller.queue
            if queue and controller.ready_ns <= now_ns and (best is None or queue[0][0] < best[0]):
                best, self._sender = queue[0], controller
        if best is None:
            self._schedule(now_ns)
            return
        assert self._sender is not None
        bits = bits_on_wire(best[1])
        broken = self._broken_bit(self._sender, bits)
        self._is_destroyed = broken is not None
        if broken is None:
            length = bits - INTERMISSION_BITS
        else:
            length = broken + (LONE_ERROR_FRAME_BITS if self._is_unacknowledged else ERROR_FRAME_BITS)
        if self._counts_errors:
            self._count_idle_bits(now_ns)
        self._began_ns = now_ns
        self.is_busy = True
        self.next_event_ns = now_ns + self.duration_ns(length)

    def _broken_bit(self, sender: Controller, bits: int) -> int | None:
        """Return the bit of a frame at which an error is detected; None for a good frame."""
        if not (self.disturbances or self._counts_errors) and len(self._controllers) > 1:
            return None
        for disturbance in self.disturbances:
            broken = disturbance(sender.name, bits)
            if broken is not None:
                self._is_unacknowledged = False
                return min(max(broken, 1), bits - INTERMISSION_BITS)
        self._is_unacknowledged = not any(
            other is not sender and not other.is_bus_off for other in self._controllers
        )
        return bits - _BITS_AFTER_ACKNOWLEDGEMENT if self._is_unacknowledged else None

    def _end(self, now_ns: int) -> Ended:
        """End the frame on the wire, or the error frame that destroyed it."""
        sender = self._sender
        self.is_busy = False
        self._free_ns = now_ns + self._intermission_ns
        self.busy_ns += self._free_ns - self._began_ns
        frame = None
        if self._is_destroyed:
            self.error_frames += 1
            self._counts_errors = True
        elif sender is not None:
            _, frame = sender.queue.popleft()
            self.frames += 1
        changed = self._count(sender, now_ns) if self._counts_errors else ()
        self._schedule(now_ns)
        return Ended(frame, sender, changed)

    def _count(self, sender: Controller | None, now_ns: int) -> tuple[Controller, ...]:
        """Change the error counters after a frame. Return the controllers whose state has changed."""
        changed = []
        for controller in self._controllers:
            if controller.is_bus_off:
                if self._has_recovered(controller):
                    changed.append(controller)
                continue
            if controller is sender:
                has_changed = (
                    controller.count_send_error(is_unacknowledged=self._is_unacknowledged)
                    if self._is_destroyed
                    else controller.count_sent()
                )
                if controller.state is ErrorState.ERROR_PASSIVE:
                    controller.ready_ns = self._free_ns + self.duration_ns(SUSPEND_BITS)
            else:
                has_changed = (
                    controller.count_receive_error() if self._is_destroyed else controller.count_received()
                )
            if has_changed:
                changed.append(controller)
                if controller.is_bus_off and controller.restarts:
                    controller.begin_recovery(now_ns)
        return tuple(changed)

    def _has_recovered(self, controller: Controller) -> bool:
        """Count the recessive sequence at the end of a frame. Return whether it was the last one."""
        if controller.recovery_left != 1:
            controller.recovery_left -= controller.recovery_left > 0
            return False
        controller.recover()
        return True

    def _schedule(self, now_ns: int) -> None:
        """Set the time of the next event, unless a frame is on the wire."""
        if self.is_busy:
            return
        next_ns = NEVER
        for controller in self._controllers:
            if controller.queue:
                next_ns = min(next_ns, max(now_ns, self._free_ns, controller.ready_ns))
            elif controller.recovery_left:
                next_ns = min(next_ns, max(now_ns, self._recovered_ns(controller)))
        self.next_event_ns = next_ns

    # Recovery from bus-off

    def _recovered_ns(self, controller: Controller) -> int:
        """Return the time at which a controller recovers if no frame begins before."""
        idle_since_ns = max(self._free_ns, controller.recovering_since_ns)
        return idle_since_ns + self.duration_ns(controller.recovery_left * RECESSIVE_BITS)

    def _recover(self, now_ns: int) -> tuple[Controller, ...]:
        """Let the controllers recover that have counted their recessive bits. Return them."""
        recovered = tuple(
            controller
            for controller in self._controllers
            if controller.recovery_left and self._recovered_ns(controller) <= now_ns
        )
        for controller in recovered:
            controller.recover()
        return recovered

    def _count_idle_bits(self, now_ns: int) -> None:
        """Count the recessive sequences of the idle time that ends now."""
        for controller in self._controllers:
            if controller.recovery_left:
                idle_ns = now_ns - max(self._free_ns, controller.recovering_since_ns)
                sequences = idle_ns * self.bit_rate // (_NS * RECESSIVE_BITS)
                controller.recovery_left = max(controller.recovery_left - max(sequences, 0), 1)
