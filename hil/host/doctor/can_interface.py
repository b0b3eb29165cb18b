"""Check the CAN interface or serial adapter that a rig file names."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hil.host.doctor.check import Check, check
from hil.links.failures import creation

NOMINAL_BIT_RATE = 500_000
"""Bit rate that this product's documents assume, in bit/s. Another one works if all nodes use it."""
_TIMEOUT_S = 5


def bus_of_rig(channel: str) -> Iterator[Check]:
    """Check that the bus ``channel`` of a rig file can be used. Nothing is opened and nothing is sent."""
    scheme, colon, rest = channel.partition(":")
    if scheme == "slcan" and colon:
        yield _serial_adapter(rest.partition("@")[0])
    elif scheme in ("udp", "sim", "inproc"):
        yield check("bus", f"{channel}: simulated boards on this machine")
    else:
        yield from _interface(rest if scheme == "socketcan" and colon else channel)


def link_details(interface: str) -> dict[str, Any] | None:
    """Return what ``ip`` says about a network interface; None if there is none, or no ``ip``."""
    command = ["ip", "-details", "-json", "link", "show", "dev", interface]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S)
        found = json.loads(done.stdout or "[]")
    except (OSError, subprocess.TimeoutExpired, json.JSONDecodeError):
        return None
    return found[0] if found and isinstance(found[0], dict) else None


def _serial_adapter(device: str) -> Check:
    if not Path(device).exists():
        return check("bus", f"{device}: there is no such device", "ls /dev/serial/by-id", is_essential=True)
    if not os.access(device, os.R_OK | os.W_OK):
        advice = "sudo adduser $USER dialout; log in again"
        return check("bus", f"{device}: this user may not open it", advice, is_essential=True)
    return check("bus", f"{device}: serial adapter, 500 kbit/s on its CAN side")


def _interface(name: str) -> Iterator[Check]:
    details = link_details(name)
    if details is None:
        yield check("bus", f"{name}: there is no such interface", creation(name), is_essential=True)
        return
    if "UP" not in details.get("flags", []):
        kind = "" if name.startswith("vcan") else f" type can bitrate {NOMINAL_BIT_RATE}"
        advice = f"sudo ip link set {name} up{kind}"
        yield check("bus", f"{name}: the interface is down", advice, is_essential=True)
        return
    data = details.get("linkinfo", {}).get("info_data", {})
    bit_rate = data.get("bittiming", {}).get("bitrate")
    if bit_rate is None:
        yield check("bus", f"{name}: up, a virtual interface")
        return
    advice = (
        ""
        if bit_rate == NOMINAL_BIT_RATE
        else f"are all nodes set to {bit_rate / 1000:g} kbit/s? Otherwise: sudo ip link set {name} down; "
        f"sudo ip link set {name} up type can bitrate {NOMINAL_BIT_RATE}"
    )
    yield check("bus", f"{name}: up, {bit_rate / 1000:g} kbit/s", advice)
    state = str(data.get("state", "unknown"))
    advice = "check the cable, the termination (120 ohm at both ends) and the bit rate of every node"
    yield check("CAN controller", state.lower(), "" if state == "ERROR-ACTIVE" else advice)
