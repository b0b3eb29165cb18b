"""Where the page is served: a listening socket, a token, and the names by which a browser may call it."""

from __future__ import annotations

import argparse
import array
import contextlib
import fcntl
import importlib.util
import secrets
import socket
import struct
import sys
from dataclasses import dataclass

from hil.core.errors import DocumentError, EnvironmentLackError

LOOPBACK = "127.0.0.1"
EVERY_ADDRESS = "0.0.0.0"
DEFAULT_PORT = 80
"""Port of http and ws, which an address and a browser's Host need not name."""
TOKEN_BYTES = 24
FOXGLOVE_PORT = 8765
"""Port at which Foxglove looks for a stream by default."""
MAX_PORT = 65535
"""Largest port number of TCP."""
WRONG_NAME = (
    "This server does not answer to that name. Open the address that the command has printed; after --host "
    f"{EVERY_ADDRESS}, use the name or an IP address of the machine. For another name, start the command "
    "with --host NAME."
)
"""Answer to a request under a name that is not in ``Address.hosts``. It does not say the accepted names,
because the page of an attacker that uses DNS rebinding could read it."""
_SIOCGIFCONF = 0x8912  # linux/sockios.h
_IFREQ_BYTES = 24 + 2 * struct.calcsize("P")
"""Size of ``struct ifreq``: name (16 bytes), then a union of the address and, largest, ``struct ifmap``."""
_MAX_ADDRESSES = 256


@dataclass(frozen=True)
class Address:
    """A listening socket and the token without which the server answers nothing."""

    listener: socket.socket
    hosts: list[str]
    """Values of the header ``Host`` that are accepted, with the port."""
    token: str
    scheme: str = "http"

    def __enter__(self) -> Address:
        return self

    def __exit__(self, *_error: object) -> None:
        """Close this process' listening socket; the serving process has its own."""
        self.listener.close()

    @property
    def url(self) -> str:
        """Address for the browser or for Foxglove, with the token."""
        return f"{self.scheme}://{self.hosts[0]}/?token={self.token}"


def open_address(host: str = LOOPBACK, port: int = 0) -> Address:
    """Listen on ``host`` and ``port`` (0: any free one). Raises EnvironmentLackError.

    Warns if other machines can open the page.
    """
    check_installed()
    message = "the page cannot be served on {}: {}; choose another --port or --host"
    address = _listen(host, port, "http", message)
    _warn_of_network("the page", host, address.hosts)
    return address


def open_stream_address(host: str, port: int) -> Address:
    """Listen for Foxglove on ``host`` and ``port`` (0: any free one). Raises EnvironmentLackError.

    Warns if other machines can open the stream.
    """
    if importlib.util.find_spec("foxglove") is None or importlib.util.find_spec("tornado") is None:
        raise EnvironmentLackError(
            "--foxglove needs foxglove-sdk and tornado: run `pip install 'pneumatic-hil[foxglove]'`"
        )
    message = (
        "the stream for Foxglove cannot be served on {}: {}; choose another port, such as --foxglove "
        f"{port % MAX_PORT + 1}, or another --host"
    )
    address = _listen(host, port, "ws", message)
    _warn_of_network("the stream for Foxglove", host, address.hosts)
    return address


def _listen(host: str, port: int, scheme: str, message: str) -> Address:
    """Listen. ``message``: of the error, with places for address and reason."""
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(32)
    except OSError as error:
        listener.close()
        raise EnvironmentLackError(message.format(f"{host}:{port}", error.strerror)) from None
    listener.setblocking(False)
    bound, port = listener.getsockname()
    names = _names(host, bound)
    hosts = [f"{name}:{port}" for name in names]
    if port == DEFAULT_PORT:
        hosts += names  # browsers do not send it
    return Address(listener, hosts, secrets.token_urlsafe(TOKEN_BYTES), scheme)


def _names(host: str, bound: str) -> list[str]:
    """Return the names of a server on ``host``, which is the address ``bound``; the printed one comes first.

    A page of an attacker can give its own name an address of this machine (DNS rebinding). So a name is
    accepted only if the user gave it or the machine has it. An IP address is not a name that can be rebound.
    """
    if bound == EVERY_ADDRESS:
        names = [socket.gethostname(), *machine_addresses(), LOOPBACK, "localhost"]
    elif bound == LOOPBACK:
        names = [host, LOOPBACK, "localhost"]
    else:
        names = [host, bound]
    return list(dict.fromkeys(name.lower() for name in names))  # browsers send names in lower case


def machine_addresses() -> list[str]:
    """Return the IPv4 addresses of this machine's interfaces, without any network traffic (netdevice(7)).

    The list is empty where the system does not give them.
    """
    buffer = array.array("B", bytes(_MAX_ADDRESSES * _IFREQ_BYTES))
    address, length = buffer.buffer_info()
    request = bytearray(struct.pack("iP", length, address))  # struct ifconf
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        fcntl.ioctl(sock, _SIOCGIFCONF, request)
        used, _ = struct.unpack("iP", request)
        starts = range(20, used, _IFREQ_BYTES)  # after the name, and family and port of struct sockaddr_in
        return [socket.inet_ntoa(buffer[start : start + 4].tobytes()) for start in starts]
    return []


def _warn_of_network(what: str, host: str, hosts: list[str]) -> None:
    """Warn if ``host`` is an address that other machines can reach. Say by which names they call it."""
    if host in (LOOPBACK, "localhost"):
        return
    risk = "sees what the page shows and does what it may" if what == "the page" else "sees it"
    sys.stderr.write(
        f"hil: {what} is served on {host}, without encryption: whoever can reach this machine on the network "
        f"can read the token, and then {risk}\n"
        f"hil: {what} answers to {', '.join(hosts)}; for another name, give it with --host\n"
    )


def port_number(text: str) -> int:
    """Return a TCP port, from 0 (any free one) to MAX_PORT, from the text of an argument."""
    if not (text.isascii() and text.isdecimal()) or int(text) > MAX_PORT:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a port: give a whole number from 0 (a free port) to {MAX_PORT}"
        )
    return int(text)


def _foxglove_port(text: str) -> int:
    """Return the port of ``--foxglove``. The error for a file says where a recording is opened."""
    if not text.lstrip("-").isdigit():
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a port. A recording needs no server: open it in Foxglove directly. A daemon is "
            f"served on a port from 0 (a free port) to {MAX_PORT}"
        )
    return port_number(text)


def add_address_options(command: argparse._ActionsContainer) -> None:
    """Add the options ``--port`` and ``--host`` of the page."""
    command.add_argument(
        "--port", type=port_number, default=0, metavar="N", help="port of the page (default: a free one)"
    )
    command.add_argument(
        "--host",
        default=LOOPBACK,
        metavar="ADDRESS",
        help=f"address to listen on (default {LOOPBACK}: this machine alone)",
    )
    command.add_argument(
        "--foxglove",
        type=_foxglove_port,
        nargs="?",
        const=FOXGLOVE_PORT,
        metavar="PORT",
        help=f"serve the run to Foxglove, with the topics of a recording (default port {FOXGLOVE_PORT})",
    )


def add_page_options(command: argparse.ArgumentParser) -> argparse._ArgumentGroup:
    """Add the options of a command that can show its run on the page. Return their group."""
    group = command.add_argument_group("page in the browser")
    group.add_argument("--live", action="store_true", help="show the run on a page in the browser")
    add_address_options(group)
    return group


def check_page_options(options: argparse.Namespace) -> None:
    """Raise DocumentError if a run in simulated time is to be shown."""
    if options.lockstep and (options.live or options.foxglove is not None):
        option = "--live" if options.live else "--foxglove"
        raise DocumentError(
            f"{option} shows a run in real time; with --lockstep, play the recording: `hil live FILE`"
        )


def check_installed() -> None:
    """Raise EnvironmentLackError if the packages that serve and draw the page are not installed."""
    missing = [name for name in ("tornado", "bokeh") if importlib.util.find_spec(name) is None]
    if missing:
        raise EnvironmentLackError(
            f"the live page needs {' and '.join(missing)}: run `pip install 'pneumatic-hil[live]'`"
        )
