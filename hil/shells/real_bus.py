"""Distinguish a bus with possibly real boards from a simulated one."""

from __future__ import annotations

from pathlib import Path
from typing import Final

INSIDE_THIS_MACHINE: Final = ("vcan", "udp:", "inproc:")
"""Beginnings of the names of buses that no real board can be on."""
INTERFACES: Final = Path("/sys/class/net")
"""Folder with a link for each network interface. It leads to the device."""


def is_real(bus: str) -> bool:
    """Return whether real boards may be on a bus. An unknown kind of bus counts as real.

    A name proves little, because an adapter can be renamed: an interface ``vcan…`` with a device counts as
    real.
    """
    name = bus.removeprefix("socketcan:")
    if bus == "sim":
        return False
    return not name.startswith(INSIDE_THIS_MACHINE) or (INTERFACES / name / "device").exists()
