"""The process that serves a run to Foxglove: ``python -m hil.live.foxglove_server FEED HOST PORT``.

It reads the feed of a run, and publishes it with the topics and message definitions of a recording, so that
one layout shows both. It offers no capability: a client can change nothing. It prints its address when it is
ready. A client that is slow loses the oldest messages; the library limits what waits for it.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

import foxglove

from hil.live.feed_file import FeedReader
from hil.live.foxglove_messages import Message, Packer

INTERVAL_S = 0.05
"""Time between two readings of the feed."""


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


def serve(feed: FeedReader, host: str, port: int) -> None:
    """Serve until the run has ended. Raises RuntimeError if the port is in use."""
    packer = Packer(feed.run)
    context = foxglove.Context()
    publisher = Publisher(packer, context)
    packer.take(feed)  # what was before the first client is not published
    server = foxglove.start_server(name="pneumatic-hil", host=host, port=port, context=context)
    sys.stdout.write(f"ws://{host}:{server.port}\n")
    sys.stdout.flush()
    is_over = False
    while not is_over:
        time.sleep(INTERVAL_S)  # The feed wakes no reader, so that the loop makes no system call for it.
        is_over = feed.is_over()  # before the last reading, so that nothing is missed
        publisher.publish(packer.take(feed))
    server.stop()


def main(feed: str, host: str, port: str) -> int:
    """Serve the feed, and return the exit status."""
    os.nice(5)
    try:
        serve(FeedReader(Path(feed)), host, int(port))
    except RuntimeError:  # the parent process says that the port is in use
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
