"""Events and faults that begin while the rig is simulated, read from a socket: one text a message."""

from __future__ import annotations

import re
import socket

from firmware_sim.arm.event_text import FORMS, parse_event
from firmware_sim.faults.fault_text import has_fault, parse_fault
from firmware_sim.faults.kinds import AnyFault, ArmFault, HostFault
from firmware_sim.faulty_rig import FaultyRig
from hil.core.errors import DocumentError, HilError

MAX_TEXT_BYTES = 4096
"""Largest text of an event."""


def parse_present_event(text: str) -> AnyFault:
    """Return the event of a text without a time, such as ``payload:3``, or the fault, such as ``hang:adc``.

    A fault may have a duration, such as ``unplug/0.5``. Raises DocumentError.
    """
    if "@" in text:
        raise DocumentError(f"event {text!r}: happens at once; omit {text[text.index('@') :]!r}")
    if has_fault(re.split("[:/]", text)[0]):
        return _present_fault(text)
    try:
        return ArmFault(parse_event(f"{text}@0"))
    except DocumentError as error:
        if FORMS in str(error):
            forms = FORMS.replace("@S", "")
            raise DocumentError(
                f"event {text!r}: not an event; the forms are: {forms}; and those of hil run --fault"
            ) from None
        raise


def _present_fault(text: str) -> AnyFault:
    head, slash, duration = text.partition("/")
    fault = parse_fault(f"{head}@0{slash}{duration}")
    if isinstance(fault, HostFault):
        raise DocumentError(f"event {text!r}: acts on the gateway's host in simulated time only")
    return fault


class EventInput:
    """Reads events and faults from the socket ``descriptor``, and gives them to ``rig`` without waiting."""

    def __init__(self, rig: FaultyRig, descriptor: int) -> None:
        self._rig = rig
        self._socket = socket.socket(fileno=descriptor)
        self._socket.setblocking(False)

    def update(self, now_ns: int) -> None:
        """Let an event that has arrived begin at the rig's next deadline, which is now.

        A text that is no event is ignored: its sender checks it.
        """
        try:
            text = self._socket.recv(MAX_TEXT_BYTES).decode()
            if text:
                self._rig.plan(parse_present_event(text), now_ns)
        except (OSError, UnicodeDecodeError, HilError):
            return
