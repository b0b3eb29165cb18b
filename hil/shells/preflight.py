"""The checks of one rig before it is operated: its files, its protection, its bus, and this machine's rights.

Nothing is opened and nothing is sent. What only the bus can show (boards, samples, positions) is shown by
``hil monitor``, and checked by the gateway before it arms. Arming also needs the rights that the rig requires
(:func:`missing_rights`) and valid controllers (``hil.core.arming``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from hil.core.check_names import check_of_right
from hil.core.errors import HilError
from hil.core.requests import CheckFailure
from hil.core.rig import REAL_ARM_RIGHTS, Rig
from hil.host.doctor import Check, CheckVerdict
from hil.host.doctor.can_interface import bus_of_rig
from hil.host.doctor.check import check
from hil.host.doctor.timing import clock, limits, processors, rights_advice, rights_and_wake_ups
from hil.host.realtime_rights import Rights
from hil.shells.real_bus import is_real
from hil.shells.run_setup import RunSetup, load_setup


def required_rights(rig: Rig, bus: str) -> Sequence[str]:
    """Return the rights without which ``rig`` must not be armed on ``bus``."""
    if rig.loop.required_rights is not None:
        return rig.loop.required_rights
    return REAL_ARM_RIGHTS if is_real(bus) else ()


def missing_rights(rig: Rig, bus: str, rights: Rights) -> tuple[CheckFailure, ...]:
    """Return the required rights that the loop was refused, as failed checks of a request to arm.

    The name of a check has hyphens in place of spaces, such as ``memory-lock``.
    """
    required = required_rights(rig, bus)
    return tuple(
        CheckFailure(
            check_of_right(right.name),
            f"this machine refuses this right to the loop: {right.detail}; the rig requires it (rig: "
            f"loop.required_rights): {rights_advice(right) or 'see `hil doctor`'}",
        )
        for right in rights
        if right.name in required and not right.is_granted
    )


def preflight(rig_path: Path | None, bus: str | None = None) -> list[Check]:
    """Check the rig file ``rig_path``, or the shipped one. ``bus`` replaces the bus of the file."""
    try:
        setup = load_setup(rig_path, {}, {})
    except HilError as error:
        advice = "correct the file; `hil rig --check FILE` repeats this check alone"
        return [check("rig file", str(error), advice, is_essential=True)]
    channel = bus or setup.rig.bus.channel
    checks = [*_files(setup), *_protection(setup.rig, is_real(channel)), *bus_of_rig(channel)]
    machine = (
        *rights_and_wake_ups(setup.rig.loop.poll_before_deadline_s, setup.rig.loop.poll_for_sample_s),
        *limits(),
        *clock(),
        *processors(),
    )
    required = required_rights(setup.rig, channel)
    return checks + [_essential(one) if one.name in required else one for one in machine]


def _files(setup: RunSetup) -> Iterator[Check]:
    """Report what was read. Reading has checked keys, limits, sample times and units."""
    rig = setup.rig
    yield check("rig file", f"valid; axes {', '.join(rig.axes)}; period {1e3 * rig.loop.period_s:g} ms")
    failures = setup.controller_failures
    for name, controller in setup.controllers.items():
        if name in failures:
            yield check(f"controller {name}", failures[name], "design another controller", is_essential=True)
            continue
        found = f"{controller.name}, made for {1e3 * controller.sample_time_s:g} ms; setpoint "
        yield check(f"controller {name}", found + setup.setpoints[name].text)


def _protection(rig: Rig, is_real_bus: bool) -> Iterator[Check]:
    """Report checks of the envelope that are switched off, and buttons that the rig does not have."""
    for name, axis in rig.axes.items():
        disabled = ", ".join(axis.envelope.disabled)
        advice = f"remove them from axes.{name}.envelope.disabled unless the axis needs that"
        low, high = axis.limits.min_y, axis.limits.max_y
        found = f"disabled: {disabled}" if disabled else f"soft end stops {low:g} and {high:g} {axis.unit}"
        yield check(f"envelope {name}", found, advice if disabled else "")
    stop, switch = (
        "a normally closed contact of the emergency stop",
        "a switch that is closed while it is held",
    )
    for name, settings, contact in (
        ("emergency_stop", rig.emergency_stop, stop),
        ("enable", rig.enable, switch),
    ):
        if settings is not None:
            yield check(name, f"frame 0x{settings.frame:03X}, byte {settings.byte}, bit {settings.bit}")
        elif is_real_bus:
            advice = f"wire {contact} to a digital input, and add [{name}] to the rig file"
            yield check(name, "none in the rig file", advice)


def _essential(found: Check) -> Check:
    """Return the finding about a required right: without it, nothing arms."""
    return found._replace(verdict=CheckVerdict.MISSING) if found.advice else found
