"""Checks of the buses: UDP multicast, SocketCAN, virtual CAN and serial ports."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from hil.core.errors import EnvironmentLackError, LinkError
from hil.core.frames import Frame
from hil.host.doctor import kernel_files
from hil.host.doctor.check import Check, check
from hil.host.doctor.kernel_files import read_line

_MAX_LATENCY_TIMER_MS: Final = 2
"""Longest latency timer of a USB serial adapter that is still good for a loop."""
_ARPHRD_CAN: Final = "280"
"""Type of a CAN interface in /sys/class/net/*/type; from linux/if_arp.h."""
_SHOWN_PORTS: Final = 4


def simulated_rig() -> Iterator[Check]:
    """Check the bus between the gateway and the simulated boards: send a frame over UDP multicast."""
    from hil.links import open_link

    name = "UDP multicast"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        spec = f"udp:{probe.getsockname()[1]}"
    try:
        with open_link(spec) as one, open_link(spec) as other:
            one.send(Frame(0x080))
            received = other.receive(1.0)
    except LinkError as error:
        yield check(name, str(error), "sudo ip link set lo up", is_essential=True)
        return
    if received is None:
        advice = "does a firewall filter the loopback interface? sudo nft list ruleset"
        yield check(name, "a frame sent inside this host did not arrive", advice, is_essential=True)
    else:
        yield check(name, "frames arrive inside this host")


def socketcan() -> Iterator[Check]:
    """Check whether this kernel has SocketCAN, and list its interfaces."""
    try:
        socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        advice = (
            "sudo modprobe can-raw\n(some systems have it in a package of its own, such as "
            "linux-modules-extra-$(uname -r))"
        )
        yield check("SocketCAN", f"not in this kernel ({error.strerror})", advice)
    else:
        yield check("SocketCAN", "interfaces: " + (", ".join(_can_interfaces()) or "none"))


def virtual_can() -> Iterator[Check]:
    """Try the way by which ``hil vcan`` would provide ``vcan0``. Starting user-mode Linux takes about 3 s."""
    from hil.host.vcan import Way, choose_way
    from hil.host.vcan.console import OTHER_WAY, MachineStoppedError
    from hil.host.vcan.user_mode_linux import try_user_mode_linux

    name = "hil vcan"
    try:
        way = choose_way()
    except EnvironmentLackError as error:
        yield check(name, "finds no way to vcan0", str(error))
        return
    if way is not Way.USER_MODE_LINUX:
        yield check(name, f"uses {way}")
        return
    try:
        duration_s = try_user_mode_linux()
    except MachineStoppedError as error:
        console = " / ".join(error.last_lines) or "nothing"
        yield check(name, f"{error.problem}; its console ended with: {console}", error.remedy)
    except OSError as error:
        yield check(name, f"user-mode Linux cannot be started: {error}", OTHER_WAY)
    else:
        yield check(name, f"uses {way}, which started and made vcan0 in {duration_s:.1f} s")


def serial_ports() -> Iterator[Check]:
    """Check the access to each serial port and its latency timer. Ports that are good share one row."""
    from serial.tools.list_ports import comports

    good = []
    for device in sorted(port.device for port in comports()):
        timer = kernel_files.SYS / "bus/usb-serial/devices" / Path(device).name / "latency_timer"
        latency_ms = read_line(timer)
        if not os.access(device, os.R_OK | os.W_OK):
            advice = "sudo adduser $USER dialout; log in again"
            yield check(device, "this user may not open it", advice)
        elif latency_ms and int(latency_ms) > _MAX_LATENCY_TIMER_MS:
            advice = (
                "hil sets a shorter time when it opens the port; for other programs: "
                f"echo 1 | sudo tee {timer}"
            )
            yield check(device, f"latency timer {latency_ms} ms", advice)
        else:
            good.append(f"{device} (latency timer {latency_ms} ms)" if latency_ms else device)
    shown = ", ".join(good[:_SHOWN_PORTS])
    if len(good) > _SHOWN_PORTS:
        shown += f" and {len(good) - _SHOWN_PORTS} more"
    yield check("serial ports", shown or "none to use")


def _can_interfaces() -> list[str]:
    return [
        f"{path.parent.name} ({read_line(path.parent / 'operstate')})"
        for path in sorted(kernel_files.SYS.glob("class/net/*/type"))
        if read_line(path) == _ARPHRD_CAN
    ]
