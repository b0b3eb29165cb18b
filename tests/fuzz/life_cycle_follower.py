"""Follow the life cycle of a gateway from the log entries that it gives."""

from __future__ import annotations

import re
from typing import NamedTuple

from fuzz.broken_rule import BrokenRule

TRANSITIONS = {
    ("offline", "boards up"): "ready",
    ("ready", "boards lost"): "offline",
    ("ready", "arm"): "armed",
    ("armed", "start"): "running",
    ("armed", "disarm"): "ready",
    ("running", "stop"): "armed",
    ("offline", "fault"): "fault",
    ("ready", "fault"): "fault",
    ("armed", "fault"): "fault",
    ("running", "fault"): "fault",
    ("fault", "reset"): "offline",
}
"""Next state by state and cause, as README states them."""
OPERATORS_CAUSES = frozenset({"arm", "start", "disarm", "reset"})
"""Causes that only a request of an operator can be."""
_CHANGE = re.compile(r"(\w+) -> (\w+) \((.*)\)")


class Changes(NamedTuple):
    """Changes of state in one call of the gateway."""

    causes: tuple[str, ...]
    is_jog: bool
    """True if a jog has begun."""


class LifeCycleFollower:
    """The state of the gateway by its log."""

    def __init__(self) -> None:
        self.state = "offline"

    def take(self, texts: list[str], request: str | None) -> Changes:
        """Follow the entries of one call. ``request`` is the trigger or ``jog`` that the call asked for."""
        causes, is_jog = [], False
        for text in texts:
            change = _CHANGE.match(text)
            if change is None:
                continue
            before, after, words = change.groups()
            cause = _cause(words)
            if before != self.state or TRANSITIONS.get((before, cause)) != after:
                raise BrokenRule("life cycle", f"{text!r} in state {self.state}")
            if cause in OPERATORS_CAUSES and request != words:
                raise BrokenRule("life cycle", f"{text!r} without an operator's request, but {request!r}")
            is_jog = is_jog or words == "jog"
            causes.append(cause)
            self.state = after
        return Changes(tuple(causes), is_jog)


def _cause(words: str) -> str:
    if words == "jog":
        return "start"
    return "stop" if words.startswith("jog ended") else words
