"""Events that happen to the arm while it is simulated, read from a socket: one text a message."""

from __future__ import annotations

import socket

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.event_text import FORMS, parse_event
from firmware_sim.arm.events import AnyEvent
from hil.core.errors import DocumentError, HilError

MAX_TEXT_BYTES = 4096
"""Largest text of an event."""


def parse_present_event(text: str) -> AnyEvent:
    """Return the event of a text without a time, such as ``payload:3``. Raises DocumentError."""
    if "@" in text:
        raise DocumentError(f"event {text!r}: happens at once; omit {text[text.index('@') :]!r}")
    try:
        return parse_event(f"{text}@0")
    except DocumentError as error:
        if FORMS in str(error):
            forms = FORMS.replace("@S", "")
            raise DocumentError(f"event {text!r}: not an event; the forms are: {forms}") from None
        raise


class EventInput:
    """Reads events from the socket ``descriptor`` and applies them to ``arm``. It never waits."""

    def __init__(self, arm: Arm, descriptor: int) -> None:
        self._arm = arm
        self._socket = socket.socket(fileno=descriptor)
        self._socket.setblocking(False)

    def update(self, now_ns: int) -> None:
        """Apply an event that has arrived. A text that is no event is ignored: its sender checks it."""
        try:
            text = self._socket.recv(MAX_TEXT_BYTES).decode()
            if text:
                self._arm.apply(parse_present_event(text))
        except (OSError, UnicodeDecodeError, HilError):
            return
