"""The lockstep shell with a modelled bus: frames take their time on the wire, wait, and can be refused.

Events of one instant have a fixed order: a frame that ends, then the boards' deadline, then the gateway's
deadline, then a frame that begins. So every frame that is sent at an instant takes part in the arbitration.
"""

from __future__ import annotations

from hil.core.frames import Frame
from hil.links.bus_model.rig_bus import NOTHING_ARRIVED, Arrived, RigBus
from hil.shells.lockstep import Boards, GatewaySide, Host, Lockstep


class BusLockstep(Lockstep):
    """A modelled bus, and the common clock of gateway and boards. Other arguments are those of Lockstep."""

    def __init__(
        self,
        boards: Boards,
        start_ns: int,
        bus: RigBus,
        host: Host | None = None,
        epoch_offset_ns: int = 0,
    ) -> None:
        super().__init__(boards, start_ns, host, epoch_offset_ns)
        self._bus = bus

    def send(self, frame: Frame) -> bool:
        """Take a frame from the gateway. Return False if its controller's queue is full or it is bus-off."""
        return self._bus.send_from_gateway(frame, self._now_ns)

    def step(self, gateway_side: GatewaySide) -> bool:
        """Advance to the next event and serve it. Return whether it was a deadline of the gateway."""
        boards, bus, awake_ns = self._boards, self._bus, self._host.asleep_until_ns
        gateway_ns = max(gateway_side.gateway.next_deadline_ns, awake_ns)
        if self._waiting:
            gateway_ns = awake_ns
        boards_ns = boards.next_deadline_ns
        others_ns = boards_ns if boards_ns < gateway_ns else gateway_ns
        while (bus_ns := bus.next_event_ns) < others_ns or (bus_ns == others_ns and not bus.begins_next):
            self._now_ns = bus_ns
            arrived = bus.advance(bus_ns)
            if arrived is not NOTHING_ARRIVED:
                self._arrive(gateway_side, arrived)
                return False
        if boards_ns < gateway_ns:
            self._now_ns = boards_ns
            self._deliver(gateway_side, boards.on_deadline(boards_ns))
            return False
        self._now_ns = gateway_ns
        if self._waiting:
            self._read_waiting(gateway_side)
            return False
        gateway_side.on_deadline(gateway_ns)
        return True

    def deliver(self, gateway_side: GatewaySide, frame: Frame) -> None:
        """Let a node that is no part of the rig send a frame from now on."""
        self._bus.send_foreign(frame, self._now_ns)

    def _arrive(self, gateway_side: GatewaySide, arrived: Arrived) -> None:
        """Give boards and gateway what arrives now."""
        now_ns = self._now_ns
        for frame in arrived.at_boards:
            self._deliver(gateway_side, self._boards.receive(frame, now_ns))
        if arrived.at_gateway:
            self._to_gateway(gateway_side, arrived.at_gateway)

    def _deliver(self, gateway_side: GatewaySide, to_gateway: tuple[Frame, ...]) -> None:
        """Put frames of the boards on the bus. Reports of the gateway's controller arrive at once."""
        for frame in to_gateway:
            if frame.is_error:
                self._to_gateway(gateway_side, (frame,))
            else:
                self._bus.send_from_board(frame, self._now_ns)
