"""The process that serves a run to Foxglove: ``python -m hil.live.foxglove_server DESCRIPTOR``.

It reads its options as JSON from the descriptor. It reads the feed of a run, and publishes it with the
topics and message definitions of a recording, so that one layout shows both. It offers no capability: a
client can change nothing. A client that is slow loses the oldest messages; the library limits what waits
for it. Clients come through the door, which asks for the token.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import foxglove
from tornado import ioloop

from hil.core.errors import OperationError
from hil.live.feed_file import FeedReader, running_feed
from hil.live.foxglove_door import Door, Endpoint, application, hidden_address
from hil.live.foxglove_messages import Message, Packer
from hil.live.server import REQUEST_TIMEOUT_S, Server, be_quiet

INTERVAL_MS = 50
"""Time between two readings of the feed."""
SEARCH_INTERVAL_MS = 500
"""Time between two attempts to find the feed of a daemon's next run."""


class Publisher:
    """Publishes messages on the channels of a recording."""

    def __init__(self, packer: Packer, context: foxglove.Context) -> None:
        self._channels = {
            channel.topic: foxglove.Channel(
                channel.topic,
                message_encoding="cdr",
                schema=foxglove.Schema(
                    name=channel.type.name, encoding="ros2msg", data=channel.type.definition.encode()
                ),
                metadata=channel.metadata,
                context=context,
            )
            for channel in packer.channels
        }

    def publish(self, messages: list[Message]) -> None:
        """Publish messages at their own times."""
        for topic, log_time_ns, payload in messages:
            self._channels[topic].log(payload, log_time=log_time_ns)


class Stream:
    """One run, served by the library behind the door."""

    def __init__(self, feed: FeedReader) -> None:
        self._feed = feed
        self._packer = Packer(feed.run)
        self._context = foxglove.Context()  # channels do not keep it alive
        self._publisher = Publisher(self._packer, self._context)
        self._packer.take(feed)  # what was before the first client is not published
        host = hidden_address()
        self._server = foxglove.start_server(name="pneumatic-hil", host=host, port=0, context=self._context)
        self.endpoint: Endpoint = (host, self._server.port)
        """Where the library's server listens."""

    def publish(self) -> bool:
        """Publish what is new. Return False after the end of the run."""
        is_over = self._feed.is_over()  # before the last reading, so that nothing is missed
        self._publisher.publish(self._packer.take(self._feed))
        return not is_over

    def close(self) -> None:
        """Begin to stop the library's server, and release the feed.

        The library waits for the end of every connection, however long that takes, so that a thread waits
        for it. The next run has a server of its own.
        """
        threading.Thread(target=self._server.stop, daemon=True).start()
        self._feed.close()


class Streams:
    """The stream of one run, or with ``is_followed`` of one run after another of a daemon."""

    def __init__(
        self, feed: Path, *, is_followed: bool, loop: ioloop.IOLoop, disconnect: Callable[[], None]
    ) -> None:
        """``disconnect`` ends the connections of all clients."""
        self._path = feed
        self._is_followed = is_followed
        self._disconnect = disconnect
        self._loop = loop
        self._stream: Stream | None = Stream(FeedReader(feed))

    def endpoint(self) -> Endpoint | None:
        """Return where the library's server listens, or None between two runs."""
        return None if self._stream is None else self._stream.endpoint

    def update(self) -> None:
        """Publish what is new of the run, or look for the next one."""
        if self._stream is None:
            feed = running_feed(self._path)
            if feed is None:
                self._loop.call_later(SEARCH_INTERVAL_MS * 1e-3, self.update)
                return
            self._stream = Stream(feed)
        elif not self._stream.publish():
            self._disconnect()
            self._stream.close()
            self._stream = None
            if not self._is_followed:
                self._loop.stop()
                return
        self._loop.call_later(INTERVAL_MS * 1e-3, self.update)


def serve(options: dict[str, Any]) -> None:
    """Serve until the last run has ended."""
    loop = ioloop.IOLoop.current()
    clients: set[Door] = set()

    def disconnect() -> None:
        for client in list(clients):
            client.disconnect()

    streams = Streams(
        Path(options["feed"]), is_followed=options["is_followed"], loop=loop, disconnect=disconnect
    )
    app = application(options["hosts"], options["token"], streams.endpoint, clients)
    server = Server(app, max_header_size=16384, max_body_size=0, idle_connection_timeout=REQUEST_TIMEOUT_S)
    server.add_socket(socket.socket(fileno=options["listen"]))
    loop.add_callback(streams.update)
    loop.start()


def main(descriptor: int) -> None:
    """Read the options from ``descriptor`` and serve."""
    os.nice(5)
    be_quiet()
    with open(descriptor) as pipe:
        options = json.load(pipe)
    with contextlib.suppress(OperationError):  # The run has ended before this process began.
        serve(options)


if __name__ == "__main__":
    main(int(sys.argv[1]))
    # A thread may still wait for the library to stop. It must not return to an interpreter that is being
    # finalized.
    os._exit(0)
