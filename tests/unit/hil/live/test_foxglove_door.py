"""The door of the stream for Foxglove: the token alone lets a client in, whatever its origin."""

from __future__ import annotations

import asyncio
import ipaddress
from collections.abc import Coroutine, Iterator
from typing import Any, TypeVar
from urllib.parse import urlsplit

import pytest
from support.foxglove_client import Client
from support.live_feeds import make_feed, write_periods
from tornado.httpclient import AsyncHTTPClient, HTTPRequest
from tornado.websocket import websocket_connect

from hil.live.feed import LiveFeed
from hil.live.foxglove_door import hidden_address
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


async def status(url: str, **headers: str) -> int:
    request = HTTPRequest(url.replace("ws:", "http:"), headers=headers, request_timeout=60.0)
    response = await AsyncHTTPClient().fetch(request, raise_error=False)
    return int(response.code)


def test_without_the_token_nobody_is_let_in(url: str) -> None:
    without = url.partition("?")[0]
    for wrong in (without, without + "?token=wrong"):
        assert wait_for(status(wrong)) == 403
        with pytest.raises(Exception, match="403"):
            wait_for(_connected(wrong))


def test_another_name_of_the_machine_is_refused(url: str) -> None:
    assert wait_for(status(url, Host="rebound.example")) == 403


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
