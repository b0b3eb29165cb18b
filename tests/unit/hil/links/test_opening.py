"""Names of buses, and the messages about buses that cannot be opened."""

import errno
import os
import subprocess
import sys

import pytest

from hil.core.errors import LinkError
from hil.links import BUS_FORMS, open_link
from hil.links.failures import creation

INVALID_NAMES = [
    "",
    "udp:",
    "udp:x",
    "udp:65536",
    "udp:1023",
    f"udp:{'9' * 5000}",
    "can0:1",
    "inproc:",
    "socketcan:",
    "can 0",
    "slcan:",
    "a name too long for Linux",
    "slcan:ttyACM0",
    "slcan:/dev/ttyACM0@fast",
    "serial:/dev/x",
]


@pytest.mark.parametrize("spec", INVALID_NAMES)
def test_the_message_about_an_invalid_name_lists_the_forms(spec: str) -> None:
    with pytest.raises(LinkError) as caught:
        open_link(spec)
    assert str(caught.value) == f"{spec!r} names no bus. Use one of these forms:\n{BUS_FORMS}"


@pytest.mark.parametrize("port", [1024, 65535])
def test_the_first_and_the_last_port_can_be_used(port: int) -> None:
    with open_link(f"udp:{port}") as link:
        assert link.spec == f"udp:{port}"


def test_the_message_about_a_missing_serial_device_says_where_to_look() -> None:
    with pytest.raises(LinkError) as caught:
        open_link("slcan:/dev/ttyNONE")
    assert str(caught.value) == (
        "slcan:/dev/ttyNONE: cannot be opened: No such file or directory; "
        "is the adapter plugged in? See: ls /dev/serial/by-id"
    )


@pytest.mark.parametrize("path", ["/dev/null", "/etc"])
def test_a_device_that_is_no_serial_line_is_a_link_error(path: str) -> None:
    with pytest.raises(LinkError, match=f"^slcan:{path}: cannot be opened: .*; no serial line; name the"):
        open_link(f"slcan:{path}")


def test_python_can_is_imported_when_the_first_link_is_opened() -> None:
    program = "import sys, hil.links; print('can' in sys.modules, 'serial' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "False False\n"


def test_the_forms_offer_no_bus_that_other_processes_cannot_join() -> None:
    assert "inproc" not in BUS_FORMS
    with open_link("inproc:for tests") as link:
        assert link.stamp_origin == "user"


@pytest.mark.parametrize(("bus", "is_in_hil_vcan"), [("vcan0", True), ("vcan1", False), ("can0", False)])
def test_hil_vcan_is_advised_only_for_the_interface_that_it_has(
    bus: str, is_in_hil_vcan: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_given: int) -> None:
        raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))

    monkeypatch.setattr("socket.socket", refuse)
    with pytest.raises(LinkError, match="this kernel has no SocketCAN") as refused:
        open_link(bus)
    assert ("hil vcan" in str(refused.value)) is is_in_hil_vcan
    assert "sudo modprobe can-raw" in str(refused.value)
    assert ("hil vcan" in creation(bus)) is is_in_hil_vcan
