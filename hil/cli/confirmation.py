"""Ask before a real arm moves: which axes, from where to where."""

from __future__ import annotations

import math
import sys
import time

from hil.core.errors import HilError
from hil.core.output import LogEntry, Severity
from hil.core.setpoints import Setpoint
from hil.links.opening import DEFAULT_BIT_RATE, check_name
from hil.shells.real_bus import check_interface, is_real
from hil.shells.run_setup import RunSetup


def bus_notes(setup: RunSetup, bus: str) -> list[LogEntry]:
    """Return what the log says about a real bus at first: the rig file's bit rate, and missing protection."""
    notes = []
    bit_rate = setup.rig.bus.bit_rate
    if bus.startswith("slcan:") and bit_rate is not None:
        text = f"{bus}: the serial adapter is set to {bit_rate / 1000:g} kbit/s (rig: bus.bit_rate)"
        notes.append(LogEntry(Severity.INFO, "rig", text))
    if is_real(bus) and setup.rig.emergency_stop is None:
        text = (
            "the rig file has no emergency stop (rig: emergency_stop): a button that cuts the supply of the "
            "valves must be within reach"
        )
        notes.append(LogEntry(Severity.WARNING, "rig", text))
    return notes


def announce_bit_rate(bus: str, bit_rate: int | None, source: str = "rig") -> None:
    """Say at which bit rate a serial adapter will join the bus: a wrong one disturbs all nodes.

    ``source`` is where the key bus.bit_rate stands. Nothing is said of another bus or of the usual rate.
    """
    if bit_rate is not None and bit_rate != DEFAULT_BIT_RATE and bus.startswith("slcan:"):
        sys.stderr.write(
            f"hil: {bus} joins the bus at {bit_rate / 1000:g} kbit/s ({source}: bus.bit_rate); all nodes "
            "must have this rate\n"
        )


def confirm_motion(setup: RunSetup, bus: str) -> None:
    """Show which axes will move, from where to where, and ask. Raises HilError without a yes.

    The boards are brought up with centred valves to measure the positions.
    """
    check_name(bus)
    check_interface(bus)
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise HilError(
            f"{bus} may be a real arm and there is no terminal to ask on; give --yes to move "
            f"{', '.join(setup.rig.axes)}"
        )
    announce_bit_rate(bus, setup.rig.bus.bit_rate)
    positions = _measure(setup, bus)
    sys.stderr.write("\n".join([f"On {bus}, these axes will move:", *motion_lines(setup, positions)]) + "\n")
    if positions is None:
        sys.stderr.write("The boards did not come up, so the positions are not known.\n")
    sys.stderr.write("Is their range free of people? Type yes: ")
    sys.stderr.flush()
    if sys.stdin.readline().strip().lower() != "yes":
        raise HilError("not confirmed; nothing was moved")


def motion_lines(setup: RunSetup, positions: list[float] | None) -> list[str]:
    """Return a line for each axis: its position, its setpoint and how far the setpoint goes."""
    lines = []
    for place, (name, axis) in enumerate(setup.rig.axes.items()):
        here = "unknown" if positions is None else f"{positions[place]:+.4f} {axis.unit}"
        lines.append(f"  {name:12} now {here:12}  {_target(setup.setpoints[name], axis.unit)}")
    return lines


def _target(setpoint: Setpoint, unit: str) -> str:
    if math.isnan(setpoint.min_r):
        return "holds its position"
    return f"{setpoint.text}: between {setpoint.min_r:g} and {setpoint.max_r:g} {unit}"


def _measure(setup: RunSetup, bus: str) -> list[float] | None:
    from hil.links import open_link
    from hil.shells.bus_guard import sole_gateway
    from hil.shells.first_look import measured_positions

    heartbeat_interval_s = setup.rig.heartbeat_periods * setup.rig.loop.period_s
    with open_link(bus, setup.rig.bus.bit_rate) as link, sole_gateway(link, heartbeat_interval_s):
        gateway = setup.gateway(time.monotonic_ns() + setup.rig.loop.period_ns)
        return measured_positions(gateway, link)
