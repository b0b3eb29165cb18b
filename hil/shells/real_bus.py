"""Distinguish a bus with possibly real boards from a simulated one."""

from __future__ import annotations

from typing import Final

INSIDE_THIS_MACHINE: Final = ("vcan", "udp:", "inproc:")
"""Beginnings of the names of buses that no real board can be on."""


def is_real(bus: str) -> bool:
    """Return whether real boards may be on a bus. An unknown kind of bus counts as real."""
    return bus != "sim" and not bus.removeprefix("socketcan:").startswith(INSIDE_THIS_MACHINE)
