"""Checks of faults before they are armed in a simulated rig."""

from __future__ import annotations

from collections.abc import Iterable

from firmware_sim.arm.events import AnyEvent, EmergencyStop, EnableSwitch
from firmware_sim.faults.condition import parse_condition
from firmware_sim.faults.fault_text import fault_text
from firmware_sim.faults.kinds import AnyFault, ArmFault, ProcessFault
from hil.core.errors import DocumentError
from hil.core.rig import Rig
from hil.core.suggestions import did_you_mean


def no_process(fault: ProcessFault) -> str:
    """Return why a fault of a process cannot begin in a simulated rig, and what to use in its place."""
    return (
        f"fault {fault_text(fault)!r} acts on a process of the gateway, and a simulated rig has none: use "
        "VcanGateway.inject_fault of hil.testing. In simulated time, unplug is what the boards see of a "
        "killed gateway, and stall:S of a paused one; nothing is written before the end of the run"
    )


def acts_on_arm(simulated: str) -> str:
    """Return why an event of the arm cannot happen, given what is simulated, and what to use in its place."""
    return (
        f"acts on the pneumatic arm, but {simulated}: simulate the arm, or use a fault between board and "
        "plant, which every plant has: offset-sensor:AXIS,-10 for a broken wire, stick-valve:AXIS, "
        "slow-valve:AXIS,LAG_S"
    )


def check_is_seen(event: AnyEvent, rig: Rig, source: str) -> None:
    """Check that the gateway of ``rig`` can see a contact that an event opens or closes.

    ``source`` names the event in errors. Raises DocumentError.
    """
    match event:
        case EmergencyStop():
            section, settings = "emergency_stop", rig.emergency_stop
        case EnableSwitch():
            section, settings = "enable", rig.enable
        case _:
            return
    if settings is None:
        raise DocumentError(
            f"{source}: the rig file has no [{section}], so the gateway would not see it; add it first"
        )


def check_faults(faults: Iterable[AnyFault], rig: Rig) -> None:
    """Check that ``rig`` has every axis and contact that the faults name. Raises DocumentError."""
    for fault in faults:
        axis = getattr(fault, "axis", None)
        if axis is not None and axis not in rig.axes:
            raise DocumentError(
                f"fault {fault_text(fault)!r}: no axis {axis!r}; the rig has {', '.join(rig.axes)}"
                f"{did_you_mean(axis, rig.axes)}"
            )
        if isinstance(fault, ArmFault):
            check_is_seen(fault.event, rig, f"fault {fault_text(fault)!r}")
        parse_condition(fault.when, list(rig.axes), f"fault {fault_text(fault)!r}")
