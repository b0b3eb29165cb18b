"""The door of the stream for Foxglove: it lets in whoever has the token, and passes bytes on.

The library's server knows no token, and accepts a page of any web origin. So it listens where a web page
cannot find it: on a random one of the 16 million addresses of the loopback network, at a random port. A
browser would have to try 10^11 pairs. A program on this machine can look them up in ``/proc/net/tcp``; the
door does not protect against that.

A page of Foxglove has another origin than this server, so that the token alone decides.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Callable

from tornado import iostream, tcpclient, web

from hil.live.server import MAX_VIEWERS, has_token, refuse_foreigners

CHUNK_BYTES = 65536
"""Most that the door keeps of one direction of one client. The rest waits in the library's server."""
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

    _inner: iostream.IOStream | None = None
    """Its connection to the library's server."""

    async def get(self) -> None:
        """Connect the client with the library's server, or say why not."""
        refuse_foreigners(self)
        settings = self.application.settings
        if not has_token(self):
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
        """Disconnect the client."""
        if self._inner is not None:
            self._inner.close()

    def _refuse(self, status: int, text: str) -> None:
        self.set_status(status)
        self.write(text)

    async def _connect(self, endpoint: Endpoint, clients: set[Door]) -> None:
        clients.add(self)
        try:
            try:
                self._inner = inner = await tcpclient.TCPClient().connect(*endpoint)
            except OSError:
                self._refuse(503, "No run is served at the moment.")
                return
            headers = [(name, self.request.headers.get(name)) for name in PASSED_HEADERS]
            lines = [f"{name}: {value}\r\n" for name, value in headers if value is not None]
            head = f"GET / HTTP/1.1\r\nHost: {endpoint[0]}:{endpoint[1]}\r\n{''.join(lines)}\r\n"
            outer = self.detach()
            outer.set_nodelay(True)
            inner.set_nodelay(True)
            with contextlib.suppress(iostream.StreamClosedError):
                await inner.write(head.encode("latin-1"))
            await asyncio.gather(_pass(outer, inner), _pass(inner, outer))
        finally:
            clients.discard(self)


async def _pass(source: iostream.IOStream, sink: iostream.IOStream) -> None:
    """Pass bytes from ``source`` to ``sink`` until one of them is closed, then close both."""
    try:
        while True:
            await sink.write(await source.read_bytes(CHUNK_BYTES, partial=True))
    except iostream.StreamClosedError:
        source.close()
        sink.close()


def application(
    hosts: list[str], token: str, endpoint: Callable[[], Endpoint], clients: set[Door]
) -> web.Application:
    """Return the door. ``endpoint`` returns where the library's server listens now."""
    return web.Application([(r"/", Door)], hosts=hosts, token=token, endpoint=endpoint, clients=clients)
