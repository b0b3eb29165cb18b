"""The door of the stream for Foxglove: it lets in whoever has the token, and passes bytes on.

The library's server knows no token, and accepts a page of any web origin. So it listens where a web page
cannot find it: on a random one of the 16 million addresses of the loopback network, at a random port. A
browser would have to try 10^11 pairs. A program on this machine can look them up in ``/proc/net/tcp``; the
door does not protect against that.

A page of Foxglove has another origin than this server, so that the token alone decides.

A client that takes nothing for a time is disconnected. It is not told why: the bytes that it does not read
come before any message with the reason.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Callable

from tornado import iostream, tcpclient, web

from hil.live.address import WRONG_NAME
from hil.live.server import MAX_VIEWERS, has_token

CHUNK_BYTES = 65536
"""Most that the door keeps of one direction of one client. The rest waits in the library's server."""
TIMEOUT_S = 10.0
"""Time in which a connection must take a chunk, and in which the library's server must accept one."""
PASSED_HEADERS = (
    "Upgrade",
    "Connection",
    "Sec-WebSocket-Key",
    "Sec-WebSocket-Version",
    "Sec-WebSocket-Protocol",
)

Endpoint = tuple[str, int]
"""Address and port."""


def hidden_address() -> str:
    """Return a random address of the loopback network."""
    return "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))


class Door(web.RequestHandler):
    """A client that asks for the stream."""

    _is_disconnected = False
    _streams: tuple[iostream.IOStream, ...] = ()
    """The connections to the client and to the library's server, while bytes are passed."""

    async def get(self) -> None:
        """Connect the client with the library's server, or say why not."""
        settings = self.application.settings
        if self.request.headers.get("Host") not in settings["hosts"]:
            self._refuse(403, WRONG_NAME)
        elif not has_token(self):
            self._refuse(403, "The token is missing or wrong: open the address that the command has printed.")
        elif self.request.headers.get("Upgrade", "").lower() != "websocket":
            self._refuse(
                426, "This is a stream for Foxglove: choose Open connection there, with this address."
            )
        elif len(settings["clients"]) >= MAX_VIEWERS:
            self._refuse(503, f"{MAX_VIEWERS} clients are connected already.")
        else:
            await self._connect(settings["endpoint"](), settings["clients"])

    def disconnect(self) -> None:
        """Disconnect the client, whatever it or the library's server does not read."""
        self._is_disconnected = True
        for stream in self._streams:
            stream.close()

    def _refuse(self, status: int, text: str) -> None:
        self.set_status(status)
        self.write(text)

    async def _connect(self, endpoint: Endpoint | None, clients: set[Door]) -> None:
        clients.add(self)
        try:
            inner = None if endpoint is None else await _open(endpoint)
            if inner is not None and self._is_disconnected:  # The run ended in the meantime.
                inner.close()
            if endpoint is None or inner is None or inner.closed():
                self._refuse(503, "No run is served at the moment.")
                return
            headers = [(name, self.request.headers.get(name)) for name in PASSED_HEADERS]
            lines = [f"{name}: {value}\r\n" for name, value in headers if value is not None]
            head = f"GET / HTTP/1.1\r\nHost: {endpoint[0]}:{endpoint[1]}\r\n{''.join(lines)}\r\n"
            outer = self.detach()
            self._streams = (outer, inner)
            outer.set_nodelay(True)
            inner.set_nodelay(True)
            with contextlib.suppress(iostream.StreamClosedError):
                await inner.write(head.encode("latin-1"))
            await asyncio.gather(_pass(outer, inner), _pass(inner, outer))
        finally:
            clients.discard(self)


async def _open(endpoint: Endpoint) -> iostream.IOStream | None:
    """Connect with the library's server. Return None if it does not accept the connection."""
    with contextlib.suppress(OSError):  # TimeoutError is one
        return await asyncio.wait_for(tcpclient.TCPClient().connect(*endpoint), TIMEOUT_S)
    return None


async def _pass(source: iostream.IOStream, sink: iostream.IOStream) -> None:
    """Pass bytes from ``source`` to ``sink`` until one is closed or ``sink`` takes none, then close both."""
    try:
        while True:
            data = await source.read_bytes(CHUNK_BYTES, partial=True)
            await asyncio.wait_for(sink.write(data), TIMEOUT_S)
    except (iostream.StreamClosedError, TimeoutError):
        source.close()
        sink.close()


def application(
    hosts: list[str], token: str, endpoint: Callable[[], Endpoint | None], clients: set[Door]
) -> web.Application:
    """Return the door. ``endpoint`` returns where the library's server listens now, None without a run."""
    return web.Application([(r"/", Door)], hosts=hosts, token=token, endpoint=endpoint, clients=clients)
