"""Where the page is served: a listening socket, a token, and the names by which a browser may call it."""

from __future__ import annotations

import importlib.util
import secrets
import socket
from dataclasses import dataclass

from hil.core.errors import EnvironmentLackError

LOOPBACK = "127.0.0.1"
TOKEN_BYTES = 24


@dataclass(frozen=True)
class Address:
    """A listening socket and the token without which the server answers nothing."""

    listener: socket.socket
    hosts: list[str]
    """Values of the header ``Host`` that are accepted, with the port."""
    token: str

    @property
    def url(self) -> str:
        """Address for the browser, with the token."""
        return f"http://{self.hosts[0]}/?token={self.token}"


def open_address(host: str = LOOPBACK, port: int = 0) -> Address:
    """Listen on ``host`` and ``port`` (0: any free one). Raises EnvironmentLackError."""
    check_installed()
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((host, port))
        listener.listen(32)
    except OSError as error:
        listener.close()
        raise EnvironmentLackError(
            f"the page cannot be served on {host}:{port}: {error.strerror}; choose another --port or --host"
        ) from None
    listener.setblocking(False)
    port = listener.getsockname()[1]
    names = [host] if host not in (LOOPBACK, "0.0.0.0") else [LOOPBACK, "localhost"]
    if host == "0.0.0.0":
        names = [socket.gethostname(), *names]
    return Address(listener, [f"{name}:{port}" for name in names], secrets.token_urlsafe(TOKEN_BYTES))


def check_installed() -> None:
    """Raise EnvironmentLackError if the packages that serve and draw the page are not installed."""
    missing = [name for name in ("tornado", "bokeh") if importlib.util.find_spec(name) is None]
    if missing:
        raise EnvironmentLackError(
            f"the live page needs {' and '.join(missing)}: run `pip install 'pneumatic-hil[live]'`"
        )
