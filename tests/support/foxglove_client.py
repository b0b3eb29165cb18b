"""A client that speaks Foxglove's protocol, and what a recording has of what is served to it."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from tornado.websocket import WebSocketClientConnection, websocket_connect

from hil.live.foxglove_messages import Message
from hil.recording.schemas import AXIS_TOPIC, CYCLE_TOPIC, LOG_TOPIC


class Client:
    """A client that speaks Foxglove's protocol."""

    def __init__(self, connection: WebSocketClientConnection) -> None:
        self._connection = connection
        self.channels: dict[int, dict[str, Any]] = {}
        self.server: dict[str, Any] = {}

    @classmethod
    async def connect(cls, address: str) -> Client:
        """Connect, and subscribe to every channel. The number of a subscription is that of its channel."""
        connection = await websocket_connect(address, subprotocols=["foxglove.sdk.v1"])
        client = cls(connection)
        while not client.channels:
            message = json.loads(str(await connection.read_message()))
            if message["op"] == "serverInfo":
                client.server = message
            elif message["op"] == "advertise":
                client.channels = {channel["id"]: channel for channel in message["channels"]}
        await client.send(
            {"op": "subscribe", "subscriptions": [{"id": n, "channelId": n} for n in client.channels]}
        )
        return client

    async def send(self, message: dict[str, Any] | str) -> None:
        await self._connection.write_message(message if isinstance(message, str) else json.dumps(message))

    async def message(self) -> Message:
        """Return the next message of a channel: opcode 1, subscription, time and payload."""
        received: object = ""
        while not isinstance(received, bytes):
            received = await self._connection.read_message()
            assert received is not None
        opcode, number, time_ns = struct.unpack_from("<BIQ", received)
        assert opcode == 1
        return Message(self.channels[number]["topic"], time_ns, received[13:])

    def close(self) -> None:
        self._connection.close()


def served_messages(path: Path) -> list[Message]:
    """Return the messages of a recording that are served to Foxglove too."""
    with path.open("rb") as file:
        return [
            Message(channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
            if channel.topic in (CYCLE_TOPIC, LOG_TOPIC) or channel.topic.startswith(AXIS_TOPIC)
        ]


def by_topic(messages: list[Message]) -> dict[str, list[Message]]:
    found: dict[str, list[Message]] = {}
    for message in messages:
        found.setdefault(message.topic, []).append(message)
    return found
