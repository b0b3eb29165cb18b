"""The boards' end of a socket to the gateway that has started them, besides the bus.

From the gateway come events and faults that are asked for while the rig is simulated, one text a message,
and ``state NAME`` when it enters a state of its life cycle. Back go the faults and the planned events that
begin, as ``NANOSECONDS fault TEXT`` and ``NANOSECONDS event TEXT`` with the instant on CLOCK_MONOTONIC.
Neither side waits for the other.
"""

from __future__ import annotations

import contextlib
import re
import socket

from firmware_sim.arm.event_text import FORM_OF, event_text, parse_event
from firmware_sim.arm.events import AnyEvent
from firmware_sim.faults.checks import acts_on_arm, check_faults, no_process
from firmware_sim.faults.fault_text import FAULT_NAMES, parse_fault
from firmware_sim.faults.fault_text import FORM_OF as FAULT_FORM_OF
from firmware_sim.faults.kinds import AnyFault, ArmFault, HostFault, ProcessFault
from firmware_sim.faulty_rig import FaultyRig
from hil.core.errors import DocumentError, HilError
from hil.core.rig import Rig
from hil.core.suggestions import nearest

MAX_TEXT_BYTES = 4096
"""Largest text of an event."""
STATE_MESSAGE = "state "
"""Beginning of a message with the gateway's state. No event and no fault has this name."""
FAULT_REPORT = "fault"
EVENT_REPORT = "event"
"""Second word of a report, before the text: what has begun."""


def parse_present_event(text: str) -> AnyFault:
    """Return the event or the fault of a text whose time counts from now.

    Without a time, as in ``payload:3``, ``hang:adc`` or ``unplug/0.5``, it begins at once. With one, as in
    ``payload:3@2`` or ``hang:adc@vertical>0.05``, it is armed. Raises DocumentError.
    """
    source = f"event {text!r}"
    head, slash, duration = text.partition("/")
    if "@" in text:
        fault = parse_fault(text, source)
    elif re.split("[:/]", text)[0] in FAULT_NAMES:
        fault = parse_fault(f"{head}@0{slash}{duration}", source)
    else:
        fault = _arm_event(text)
    if isinstance(fault, ProcessFault):
        raise DocumentError(no_process(fault))
    if isinstance(fault, HostFault):
        raise DocumentError(f"{source}: acts on the gateway's host in simulated time only")
    return fault


def beginning_text(text: str) -> str:
    """Return when the event or fault of a text begins: a predicate, such as ``waits for vertical > 0.05``.

    Raises DocumentError as :func:`parse_present_event` does.
    """
    fault = parse_present_event(text)
    if not fault.when:
        return f"happens in {fault.at_s:g} s" if fault.at_s else "happens now"
    awaited = re.sub("([<>])", r" \1 ", fault.when)
    return f"waits for {awaited}" + (f", and begins {fault.at_s:g} s later" if fault.at_s else "")


def check_arm_event(text: str, rig: Rig) -> None:
    """Check that an event or fault can happen to the boards of ``rig`` and the pneumatic arm.

    Raises DocumentError.
    """
    check_faults([parse_present_event(text)], rig)


def check_model_event(text: str, rig: Rig) -> None:
    """Check that a fault can happen to the boards of ``rig`` before linear models. Raises DocumentError."""
    fault = parse_present_event(text)
    if isinstance(fault, ArmFault):
        raise DocumentError(
            f"event {text!r}: {acts_on_arm('a linear model is simulated (--linear or --plant)')}"
        )
    check_faults([fault], rig)


def _arm_event(text: str) -> ArmFault:
    name = text.partition(":")[0]
    if name not in FORM_OF or ":" not in text:
        raise DocumentError(f"event {text!r}: {_unknown(name)}")
    return ArmFault(parse_event(f"{text}@0", source=f"event {text!r}"))


def _unknown(name: str) -> str:
    """Return what is wrong with a text that has no form: its values are missing, or its name is unknown."""
    if name in FORM_OF:
        return f"its values are missing; write {FORM_OF[name]}"
    meant = nearest(name, FAULT_FORM_OF)
    if meant is not None:
        return f"not an event; did you mean {meant}? Write {FAULT_FORM_OF[meant]}"
    forms = ", ".join(FORM_OF.values())
    return f"not an event; the forms are: {forms}; and those of `hil run --fault`"


class EventInput:
    """Gives ``rig`` what arrives on the socket ``descriptor``, and reports the faults and the planned events
    that begin.

    It never waits.
    """

    def __init__(self, rig: FaultyRig, descriptor: int) -> None:
        self._rig = rig
        self._socket = socket.socket(fileno=descriptor)
        self._socket.setblocking(False)
        rig.on_begin = self._report_fault
        rig.boards.on_event = self._report_event

    def update(self, now_ns: int) -> None:
        """Let an event that has arrived begin at the rig's next deadline, which is now, or arm it.

        A text that is no event is ignored: its sender checks it.
        """
        try:
            text = self._socket.recv(MAX_TEXT_BYTES).decode()
            if text.startswith(STATE_MESSAGE):
                self._rig.gateway_entered(text.removeprefix(STATE_MESSAGE), now_ns)
            elif text:
                self._rig.plan(parse_present_event(text), now_ns)
        except (OSError, UnicodeDecodeError, HilError):
            return

    def _report_fault(self, text: str) -> None:
        """Report a fault that has just begun."""
        at_ns, _ = self._rig.begun[-1]
        self._report(at_ns, FAULT_REPORT, text)

    def _report_event(self, event: AnyEvent, at_ns: int) -> None:
        """Report a planned event that has happened."""
        self._report(at_ns, EVENT_REPORT, event_text(event))

    def _report(self, at_ns: int, kind: str, text: str) -> None:
        with contextlib.suppress(OSError):  # without a gateway there is nobody to report to
            self._socket.send(f"{at_ns} {kind} {text}".encode())
