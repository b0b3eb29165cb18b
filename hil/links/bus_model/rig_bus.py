"""The modelled bus of a rig: the gateway, both boards and foreign nodes, and the faults of the bus.

An unplugged gateway is on a bus of its own. Nobody acknowledges its frames there, so that it repeats the
first one, becomes error-passive, and refuses frames once its queue is full. When the cable is back, the
frames that waited are sent.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from hil.core.frames import Frame
from hil.links.bus_model.bus import CanBus, Disturbance
from hil.links.bus_model.controller import Controller

DAC_NODE: Final = 0x20
_NODE_MASK: Final = 0x7F
FOREIGN_FRAMES: Final = 64
"""Number of frames that wait in a foreign node before others are discarded."""


class Arrived(NamedTuple):
    """Frames that arrive at one instant."""

    at_gateway: tuple[Frame, ...] = ()
    """Frames for the gateway, and the reports of its controller."""
    at_boards: tuple[Frame, ...] = ()


NOTHING_ARRIVED: Final = Arrived()


class RigBus:
    """The bus of a rig in simulated time. Times are nanoseconds."""

    def __init__(self, bit_rate: int) -> None:
        """``bit_rate`` is in bit/s."""
        self._bus = CanBus(bit_rate)
        self._own_bus = CanBus(bit_rate)
        """Bus on which the gateway is alone while its cable is unplugged."""
        self.gateway = Controller("gateway", restarts=False)
        """Controller of the gateway. It stays bus-off until ``restart``, as SocketCAN without restart-ms."""
        self.adc = Controller("adc")
        self.dac = Controller("dac")
        self.foreign = Controller("foreign", FOREIGN_FRAMES)
        """Controller of all nodes that are no part of the rig. It joins the bus with its first frame."""
        for controller in (self.gateway, self.adc, self.dac):
            self._bus.add(controller, 0)
        self._has_foreign = False
        self._unplugged = 0

    @property
    def bit_rate(self) -> int:
        """Bit rate in bit/s."""
        return self._bus.bit_rate

    @property
    def frames(self) -> int:
        """Number of frames that were sent without error, without those on an unplugged cable."""
        return self._bus.frames

    @property
    def error_frames(self) -> int:
        """Number of error frames, without those on an unplugged cable."""
        return self._bus.error_frames

    @property
    def busy_ns(self) -> int:
        """Time in which the bus was used so far, with intermissions and error frames."""
        return self._bus.busy_ns

    def figures(self, now_ns: int) -> dict[str, str]:
        """Return load, refused frames and error frames from the beginning until now, for a recording."""
        load = self.busy_ns / now_ns if now_ns > 0 else 0.0
        return {
            "bus load": f"{load:.4f}",
            "bit rate": str(self.bit_rate),
            "frames not sent": str(self.gateway.refused),
            "frames destroyed on the bus": str(self.error_frames),
        }

    @property
    def disturbances(self) -> list[Disturbance]:
        """Functions that destroy frames of the bus."""
        return self._bus.disturbances

    @property
    def next_event_ns(self) -> int:
        """Time at which ``advance`` is to be called next."""
        if self._unplugged:
            return min(self._bus.next_event_ns, self._own_bus.next_event_ns)
        return self._bus.next_event_ns

    @property
    def begins_next(self) -> bool:
        """True if the next event begins a frame, so that other events of that instant come first."""
        own = self._unplugged and self._own_bus.next_event_ns < self._bus.next_event_ns
        return not (self._own_bus if own else self._bus).is_busy

    def send_from_gateway(self, frame: Frame, now_ns: int) -> bool:
        """Take a frame of the gateway. Return False if its controller refuses it."""
        bus = self._own_bus if self._unplugged else self._bus
        return bus.send(self.gateway, frame, now_ns)

    def send_from_board(self, frame: Frame, now_ns: int) -> None:
        """Take a frame of a board. The node id in its identifier says which board sends it."""
        controller = self.dac if frame.id & _NODE_MASK == DAC_NODE else self.adc
        self._bus.send(controller, frame, now_ns)

    def send_foreign(self, frame: Frame, now_ns: int) -> None:
        """Take a frame of a node that is no part of the rig."""
        if not self._has_foreign:
            self._has_foreign = True
            self._bus.add(self.foreign, now_ns)
        self._bus.send(self.foreign, frame, now_ns)

    def advance(self, now_ns: int) -> Arrived:
        """Handle the event that is due at ``now_ns``. Return what arrives."""
        if self._unplugged and self._own_bus.next_event_ns <= self._bus.next_event_ns:
            bus = self._own_bus
        else:
            bus = self._bus
        frame, sender, changed = bus.advance(now_ns)
        reports: tuple[Frame, ...] = ()
        if changed and self.gateway in changed:
            reports = (self.gateway.report(is_restarted=not self.gateway.tec + self.gateway.rec),)
        if frame is None:
            return Arrived(reports) if reports else NOTHING_ARRIVED
        if sender is self.gateway:
            return Arrived(reports, (frame,))
        is_deaf = self._unplugged or self.gateway.is_bus_off
        at_gateway = reports if is_deaf else (frame, *reports)
        return Arrived(at_gateway, (frame,) if sender is self.foreign else ())

    # Faults

    def unplug(self, now_ns: int) -> None:
        """Unplug the gateway's cable. Each call needs a ``plug`` of its own."""
        self._unplugged += 1
        if self._unplugged == 1:
            self._bus.remove(self.gateway, now_ns)
            self._own_bus = CanBus(self._bus.bit_rate)
            self._own_bus.add(self.gateway, now_ns)

    def plug(self, now_ns: int) -> None:
        """Plug the cable in again."""
        self._unplugged -= 1
        if self._unplugged == 0:
            self._own_bus.remove(self.gateway, now_ns)
            self._bus.add(self.gateway, now_ns)

    def take_gateway_off(self, now_ns: int) -> Frame:
        """Make the gateway's controller bus-off. Return its report. It refuses frames until ``restart``."""
        (self._own_bus if self._unplugged else self._bus).take_off(self.gateway, now_ns)
        return self.gateway.report()

    def restart(self, now_ns: int) -> None:
        """Restart the gateway's controller, as ``ip link set can0 type can restart`` does.

        It is back after 128 sequences of 11 recessive bits.
        """
        (self._own_bus if self._unplugged else self._bus).restart(self.gateway, now_ns)
