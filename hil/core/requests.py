"""What an operator may ask of a running gateway, and how it replies."""

from __future__ import annotations

from typing import NamedTuple

from hil.core.life_cycle import Trigger


class SetpointRequest(NamedTuple):
    """Change the setpoint of one axis. In state running it is approached within the axis' setpoint limits."""

    axis: str
    setpoint: str
    """Setpoint as in a rig file, or a number; its time 0 is the period in which it takes over."""
    table: str = ""
    """Text of the file that a ``csv:FILE`` setpoint names."""


class ControllerRequest(NamedTuple):
    """Change the controller of one axis. In state running it takes over with its output matched."""

    axis: str
    name: str
    """Name of the file, for messages."""
    document: str
    """Text of the controller file."""


class JogRequest(NamedTuple):
    """Move one axis with a constant valve voltage for a short time, while the other valves are centred.

    A further request for the same axis before the end extends the motion: whoever jogs must repeat the
    request, and the axis stops when the requests stop.
    """

    axis: str
    offset_v: float
    """Valve voltage in volts, relative to the valve's centre."""
    duration_s: float
    """Time after which the valve is centred, in seconds."""


class CheckFailure(NamedTuple):
    """A check before arming that has failed."""

    check: str
    """Name of the check, by which an operator can override it."""
    text: str
    """What was found, and what to do."""


class ArmRequest(NamedTuple):
    """Allow motion, with the results of the shell's checks. ``Trigger.ARM`` is a request without any."""

    failures: tuple[CheckFailure, ...] = ()
    """Checks of this machine that have failed."""
    overrides: tuple[str, ...] = ()
    """Names of checks that do not refuse to arm if they fail."""


def arm_request(failures: tuple[CheckFailure, ...], overrides: tuple[str, ...]) -> Trigger | ArmRequest:
    """Return the request to arm: the plain trigger if there is nothing to add to it."""
    return ArmRequest(failures, overrides) if failures or overrides else Trigger.ARM


Request = Trigger | ArmRequest | SetpointRequest | ControllerRequest | JogRequest
"""Anything that an operator may ask."""


class Reply(NamedTuple):
    """Answer of the gateway to a request."""

    accepted: bool
    text: str
    """What happened, or why not."""
