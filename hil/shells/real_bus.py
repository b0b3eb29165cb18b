"""Distinguish a bus with possibly real boards from a simulated one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from hil.core.errors import LinkError
from hil.core.suggestions import did_you_mean
from hil.links.failures import creation

INSIDE_THIS_MACHINE: Final = ("vcan", "udp:", "inproc:")
"""Beginnings of the names of buses that no real board can be on."""
INTERFACES: Final = Path("/sys/class/net")
"""Folder with a link for each network interface. It leads to the device."""


def check_interface(bus: str) -> None:
    """Check that the interface of a SocketCAN bus exists. Raises LinkError.

    Other kinds of buses, and texts that name no bus, are checked when they are opened.
    """
    name = bus.removeprefix("socketcan:")
    if not re.fullmatch(r"[\w.-]{1,15}", name, re.ASCII) or (INTERFACES / name).exists():
        return
    present = [path.name for path in INTERFACES.iterdir()] if INTERFACES.is_dir() else []
    raise LinkError(
        f"{bus}: this machine has no interface {name}{did_you_mean(name, present)}; {creation(name)}"
    )


def is_real(bus: str) -> bool:
    """Return whether real boards may be on a bus. An unknown kind of bus counts as real.

    A name proves little, because an adapter can be renamed: an interface ``vcan…`` with a device counts as
    real.
    """
    name = bus.removeprefix("socketcan:")
    if bus == "sim":
        return False
    return not name.startswith(INSIDE_THIS_MACHINE) or (INTERFACES / name / "device").exists()
