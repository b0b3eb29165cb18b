"""The door of the stream for Foxglove: the token alone lets a client in, whatever its origin."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
from collections.abc import Coroutine, Iterator
from typing import Any, TypeVar
from urllib.parse import urlsplit

import pytest
from support.foxglove_client import Client
from support.live_feeds import make_feed, write_periods
from tornado import iostream, tcpclient
from tornado.httpclient import AsyncHTTPClient, HTTPRequest, HTTPResponse
from tornado.httpserver import HTTPServer
from tornado.websocket import websocket_connect

from hil.live import address, foxglove_door
from hil.live.feed import LiveFeed
from hil.live.foxglove_door import Door, application, hidden_address
from hil.live.process import start_foxglove_server
from hil.recording.schemas import CYCLE_TOPIC

_Result = TypeVar("_Result")


@pytest.fixture
def feed() -> Iterator[LiveFeed]:
    made = make_feed()
    yield made
    made.close()


@pytest.fixture
def url(feed: LiveFeed) -> Iterator[str]:
    process, url = start_foxglove_server(feed.path, "127.0.0.1", 0)
    yield url
    process.kill()
    process.wait()


def wait_for(work: Coroutine[Any, Any, _Result]) -> _Result:
    return asyncio.run(asyncio.wait_for(work, 60.0))


async def answer(url: str, **headers: str) -> HTTPResponse:
    request = HTTPRequest(url.replace("ws:", "http:"), headers=headers, request_timeout=60.0)
    return await AsyncHTTPClient().fetch(request, raise_error=False)


async def status(url: str, **headers: str) -> int:
    return int((await answer(url, **headers)).code)


def test_without_the_token_nobody_is_let_in(url: str) -> None:
    without = url.partition("?")[0]
    for wrong in (without, without + "?token=wrong"):
        assert wait_for(status(wrong)) == 403
        with pytest.raises(Exception, match="403"):
            wait_for(_connected(wrong))


def test_another_name_of_the_machine_is_refused(url: str) -> None:
    refused = wait_for(answer(url, Host="rebound.example"))
    assert refused.code == 403
    assert b"start the command with --host NAME" in refused.body
    assert b"127.0.0.1" not in refused.body  # a page of an attacker could read it


def test_an_address_of_the_machine_is_accepted_if_the_stream_is_on_every_address(
    feed: LiveFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(address, "machine_addresses", lambda: ["192.168.1.5"])
    process, url = start_foxglove_server(feed.path, "0.0.0.0", 0)
    parts = urlsplit(url)
    url = url.replace(parts.netloc, f"127.0.0.1:{parts.port}")
    try:
        assert wait_for(status(url, Host=f"192.168.1.5:{parts.port}")) == 426
        assert wait_for(status(url, Host=f"192.168.1.6:{parts.port}")) == 403
    finally:
        process.kill()
        process.wait()


def test_a_browser_is_told_where_the_address_belongs(url: str) -> None:
    assert wait_for(status(url)) == 426


async def _connected(url: str, origin: str | None = None) -> str:
    request = HTTPRequest(url, headers={"Origin": origin} if origin else {}, request_timeout=60.0)
    connection = await websocket_connect(request, subprotocols=["foxglove.sdk.v1"])
    message = await connection.read_message()
    connection.close()
    return str(message)


def test_foxglove_is_let_in_from_its_own_origin(url: str) -> None:
    for origin in (None, "https://app.foxglove.dev", "file://", "null"):
        assert '"op":"serverInfo"' in wait_for(_connected(url, origin))


def test_a_client_receives_through_the_door(feed: LiveFeed, url: str) -> None:
    async def receive() -> list[str]:
        client = await Client.connect(url)
        topics: list[str] = []
        number = 0
        while topics.count(CYCLE_TOPIC) < 3:
            message = asyncio.create_task(client.message())
            while not message.done():  # the subscription takes effect some time after it is sent
                write_periods(feed, number)
                number += 1
                await asyncio.wait({message}, timeout=0.05)
            topics.append(message.result().topic)
        client.close()
        return topics

    assert CYCLE_TOPIC in wait_for(receive())


def test_the_library_listens_on_an_address_that_no_page_can_guess(url: str) -> None:
    addresses = {hidden_address() for _ in range(100)}
    assert len(addresses) > 95
    assert all(ipaddress.ip_address(address).is_loopback for address in addresses)
    assert "127.0.0.1" not in addresses and urlsplit(url).hostname == "127.0.0.1"


class Stalled:
    """The connection to a client that sends and takes nothing, in place of the real one."""

    def __init__(self, real: iostream.IOStream) -> None:
        self._real = real
        self._closed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.is_written = asyncio.Event()

    def set_nodelay(self, _value: bool) -> None:
        pass

    async def write(self, _data: bytes) -> None:
        self.is_written.set()
        await asyncio.shield(self._closed)

    async def read_bytes(self, _count: int, *, partial: bool) -> bytes:
        await asyncio.shield(self._closed)
        raise AssertionError

    def close(self) -> None:
        self._real.close()
        if not self._closed.done():
            self._closed.set_exception(iostream.StreamClosedError())


class Clients(set[Door]):
    """The clients of a door. ``left``: whether one of them has left its place."""

    def __init__(self) -> None:
        super().__init__()
        self.left = asyncio.Event()

    def discard(self, client: Door) -> None:
        super().discard(client)
        self.left.set()


class OpenDoor:
    """A door in this process, before a server that sends without end."""

    def __init__(self) -> None:
        self.clients = Clients()
        self._stack = contextlib.AsyncExitStack()

    async def __aenter__(self) -> OpenDoor:
        library = await asyncio.start_server(self._flood, "127.0.0.1", 0)
        self._stack.callback(library.close)
        listener = socket.create_server(("127.0.0.1", 0))
        listener.setblocking(False)
        self._port = listener.getsockname()[1]
        endpoint = library.sockets[0].getsockname()
        app = application([f"127.0.0.1:{self._port}"], "t", lambda: endpoint, self.clients)
        server = HTTPServer(app)
        server.add_socket(listener)
        self._stack.callback(server.stop)
        return self

    async def __aexit__(self, *error: object) -> None:
        for client in list(self.clients):
            client.disconnect()
        await self._stack.aclose()

    @staticmethod
    async def _flood(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while True:
                writer.write(bytes(65536))
                await writer.drain()

    async def client(self) -> asyncio.StreamReader:
        reader, writer = await asyncio.open_connection("127.0.0.1", self._port)
        self._stack.callback(writer.close)  # A writer that nobody keeps closes the connection.
        writer.write(
            f"GET /?token=t HTTP/1.1\r\nHost: 127.0.0.1:{self._port}\r\nUpgrade: websocket\r\n\r\n".encode()
        )
        return reader


@pytest.fixture
def stalled(monkeypatch: pytest.MonkeyPatch) -> asyncio.Queue[Stalled]:
    """Give the connections of the doors' clients, which all take nothing."""
    made: asyncio.Queue[Stalled] = asyncio.Queue()
    detach = Door.detach

    def detach_stalled(door: Door) -> Stalled:
        stream = Stalled(detach(door))
        made.put_nowait(stream)
        return stream

    monkeypatch.setattr(Door, "detach", detach_stalled)
    return made


def test_a_client_that_takes_nothing_leaves_its_place_when_the_run_ends(
    stalled: asyncio.Queue[Stalled],
) -> None:
    async def end_run() -> None:
        async with OpenDoor() as door:
            reader = await door.client()
            await (await stalled.get()).is_written.wait()
            (client,) = door.clients
            client.disconnect()
            assert await reader.read() == b""
            await door.clients.left.wait()
            assert not door.clients

    wait_for(end_run())


@pytest.mark.usefixtures("stalled")
def test_a_client_that_takes_nothing_for_a_time_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    detach = Door.detach

    def detach_late(door: Door) -> iostream.IOStream:
        """Shorten the limit only now: it is also that of the connection with the library's server."""
        monkeypatch.setattr(foxglove_door, "TIMEOUT_S", 0.01)
        return detach(door)

    monkeypatch.setattr(Door, "detach", detach_late)

    async def stall() -> None:
        async with OpenDoor() as door:
            reader = await door.client()
            assert await reader.read() == b""
            await door.clients.left.wait()
            assert not door.clients

    wait_for(stall())


def test_a_client_that_is_being_connected_when_the_run_ends_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def end_run() -> None:
        begun, may_connect = asyncio.Event(), asyncio.Event()
        inner: list[iostream.IOStream] = []
        connect = tcpclient.TCPClient.connect

        async def connect_late(client: tcpclient.TCPClient, *endpoint: Any) -> iostream.IOStream:
            begun.set()
            await may_connect.wait()
            inner.append(await connect(client, *endpoint))
            return inner[0]

        monkeypatch.setattr(tcpclient.TCPClient, "connect", connect_late)
        async with OpenDoor() as door:
            reader = await door.client()
            await begun.wait()
            (client,) = door.clients
            client.disconnect()
            may_connect.set()
            assert (await reader.readline()).startswith(b"HTTP/1.1 503")
            assert inner[0].closed() and not door.clients

    wait_for(end_run())
