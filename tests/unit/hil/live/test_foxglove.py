"""The stream for Foxglove: what a client receives is, to the byte, what a recording of the run has."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import subprocess
import sys
import threading
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any, TypeVar
from unittest import mock
from urllib.parse import urlsplit

import foxglove
import pytest
from foxglove.websocket import ServerListener
from mcap.reader import make_reader
from support.foxglove_client import Client, by_topic, served_messages
from support.live_feeds import RIG_TEXT, STATES
from support.recorded_runs import AXES, EPOCH_OFFSET_NS, RUN_HEADER, in_memory, record_periods

from hil.core.errors import EnvironmentLackError
from hil.core.output import LogEntry, Severity
from hil.live import address
from hil.live import feed as feed_module
from hil.live.address import open_stream_address
from hil.live.feed import LiveFeed
from hil.live.feed_file import FeedReader, RunInformation
from hil.live.foxglove_messages import Message, Packer
from hil.live.foxglove_server import Publisher, Stream, Streams
from hil.live.process import start_foxglove_server
from hil.recording.recorder import Recorder
from hil.recording.schemas import LOG_TOPIC

ENTRY = LogEntry(Severity.WARNING, "adc", "late: 3 periods")
LOG_NS = 6_000_000_000
RUN = RunInformation(list(AXES), 0.0112, STATES, "", "slcan:none", 0, EPOCH_OFFSET_NS, RIG_TEXT)
_Result = TypeVar("_Result")


@pytest.fixture
def feed() -> Iterator[LiveFeed]:
    made = LiveFeed(RUN, {}, lambda: "")
    yield made
    made.close()


def run_both(path: Path, feed: LiveFeed, periods: int, first: int = 0) -> None:
    """Record periods and a log entry, and give the feed the same."""
    with in_memory(path):
        recorder = Recorder(path, RUN_HEADER, lossless=True)
    both = mock.Mock(wraps=recorder)
    both.cycle.side_effect = lambda *period: (recorder.cycle(*period), feed.period(*period))
    record_periods(both, periods, first=first)
    recorder.log_entry(ENTRY, LOG_NS)
    with mock.patch.object(feed_module, "monotonic_ns", return_value=LOG_NS):
        feed.log(ENTRY)
    recorder.close({})


def test_messages_are_those_of_the_recording_to_the_byte(tmp_path: Path, feed: LiveFeed) -> None:
    path = tmp_path / "run.mcap"
    reader = FeedReader(feed.path)
    run_both(path, feed, 50)
    messages = Packer(reader.run).take(reader)
    assert len(messages) == 50 * (len(AXES) + 1) + 1
    assert messages == served_messages(path)


def test_channels_have_the_schemas_of_the_recording(tmp_path: Path, feed: LiveFeed) -> None:
    path = tmp_path / "run.mcap"
    run_both(path, feed, 1)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    in_file = {
        channel.topic: (summary.schemas[channel.schema_id].name, summary.schemas[channel.schema_id].data)
        for channel in summary.channels.values()
    }
    served = Packer(RUN).channels
    assert len(served) == len(AXES) + 2
    for channel in served:
        assert in_file[channel.topic] == (channel.type.name, channel.type.definition.encode())


class Subscriptions(ServerListener):
    """Counts subscriptions."""

    def __init__(self) -> None:
        self.count = threading.Semaphore(0)

    def on_subscribe(self, client: object, channel: object) -> None:
        self.count.release()


class Served:
    """A server in this process. A test publishes when every client has subscribed."""

    def __init__(self) -> None:
        self._context = context = foxglove.Context()  # channels do not keep it alive
        self.packer = Packer(RUN)
        self.publisher = Publisher(self.packer, context)
        self._subscriptions = Subscriptions()
        self._server = foxglove.start_server(
            host="127.0.0.1", port=0, context=context, server_listener=self._subscriptions
        )

    async def client(self) -> Client:
        client = await Client.connect(f"ws://127.0.0.1:{self._server.port}")
        for _ in client.channels:
            await asyncio.to_thread(self._subscriptions.count.acquire)
        return client

    def stop(self) -> None:
        self._server.stop()


@pytest.fixture
def served() -> Iterator[Served]:
    server = Served()
    yield server
    server.stop()


def wait_for(work: Coroutine[Any, Any, _Result]) -> _Result:
    return asyncio.run(asyncio.wait_for(work, 30.0))


def test_a_client_receives_what_is_recorded(tmp_path: Path, feed: LiveFeed, served: Served) -> None:
    path = tmp_path / "run.mcap"
    reader = FeedReader(feed.path)

    async def receive() -> tuple[list[Message], dict[int, dict[str, Any]]]:
        client = await served.client()
        run_both(path, feed, 40)
        served.publisher.publish(served.packer.take(reader))
        messages = [await client.message() for _ in range(40 * (len(AXES) + 1) + 1)]
        client.close()
        return messages, client.channels

    messages, channels = wait_for(receive())
    assert by_topic(messages) == by_topic(served_messages(path))
    for channel in channels.values():
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")


def test_a_client_can_change_nothing(served: Served) -> None:
    async def ask() -> dict[str, Any]:
        client = await served.client()
        client.close()
        return client.server

    assert wait_for(ask())["capabilities"] == []


def test_a_client_that_sends_garbage_or_reads_nothing_troubles_no_other(
    tmp_path: Path, feed: LiveFeed, served: Served
) -> None:
    path = tmp_path / "run.mcap"
    reader = FeedReader(feed.path)

    async def receive() -> list[Message]:
        silent, garbage, good = await served.client(), await served.client(), await served.client()
        for text in ("{", "[]", '{"op": "advertise", "channels": [{}]}', "\x00" * 10_000):
            await garbage.send(text)
        run_both(path, feed, 100)
        served.publisher.publish(served.packer.take(reader))
        messages = [await good.message() for _ in range(100 * (len(AXES) + 1) + 1)]
        for client in (silent, garbage, good):
            client.close()
        return messages

    assert by_topic(wait_for(receive())) == by_topic(served_messages(path))


def test_what_was_before_the_stream_began_is_not_published(
    feed: LiveFeed, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[Message] = []
    monkeypatch.setattr(Publisher, "publish", lambda _self, messages: published.extend(messages))
    with mock.patch.object(feed_module, "monotonic_ns", return_value=LOG_NS):
        feed.log(ENTRY)
        stream = Stream(FeedReader(feed.path))
        assert stream.publish()
        assert published == []
        feed.log(ENTRY)
        assert stream.publish()
    stream.close()
    assert [message.topic for message in published] == [LOG_TOPIC]


def test_the_process_ends_with_the_run(capfd: pytest.CaptureFixture[str]) -> None:
    own = LiveFeed(RUN, {}, lambda: "")
    started, url = start_foxglove_server(own.path, "127.0.0.1", 0)
    assert url.startswith("ws://127.0.0.1:")
    with pytest.raises(EnvironmentLackError, match=r"cannot be served on .* choose another port"):
        start_foxglove_server(own.path, "127.0.0.1", urlsplit(url).port or 0)
    wait_for(Client.connect(url))  # it serves
    own.close()
    assert started.wait(60) == 0
    assert "without encryption" not in capfd.readouterr().err


def test_a_connection_to_the_library_does_not_keep_the_process_alive() -> None:
    own = LiveFeed(RUN, {}, lambda: "")
    started, url = start_foxglove_server(own.path, "127.0.0.1", 0)
    with contextlib.ExitStack() as stack:
        stack.callback(started.kill)
        wait_for(Client.connect(url))  # it serves
        # A program of this machine finds the library's server, and sends no request.
        endpoints = listening(started.pid) - {("127.0.0.1", urlsplit(url).port)}
        assert len(endpoints) == 1
        stack.enter_context(socket.create_connection(endpoints.pop()))
        own.close()
        assert started.wait(60) == 0


def listening(pid: int) -> set[tuple[str, int]]:
    """Return the IPv4 addresses and ports on which a process listens (proc(5))."""
    opened = {str(path.readlink()) for path in Path(f"/proc/{pid}/fd").iterdir()}
    found = set()
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        _, local, _, state, *_, inode = line.split()[:10]
        if state == "0A" and f"socket:[{inode}]" in opened:
            address, port = local.split(":")
            found.add((socket.inet_ntoa(int(address, 16).to_bytes(4, sys.byteorder)), int(port, 16)))
    return found


def test_a_library_server_that_does_not_stop_holds_up_no_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    in_loop: list[bool] = []
    ports = iter((1001, 1002))

    def stop() -> None:
        in_loop.append(threading.current_thread() is threading.main_thread())
        released.wait(20.0)

    def start_server(**_options: object) -> mock.Mock:
        return mock.Mock(port=next(ports), stop=stop)

    monkeypatch.setattr(foxglove, "start_server", start_server)
    link = tmp_path / "feed"
    loop, disconnect = mock.Mock(), mock.Mock()
    first = LiveFeed(RUN, {}, lambda: "", link)
    streams = Streams(link, is_followed=True, loop=loop, disconnect=disconnect)
    before = streams.endpoint()
    assert before is not None and before[1] == 1001
    first.close()
    streams.update()
    disconnect.assert_called_once_with()
    assert streams.endpoint() is None  # nobody is connected with a server that has no run
    second = LiveFeed(RUN, {}, lambda: "", link)
    streams.update()
    after = streams.endpoint()
    assert after is not None and after[1] == 1002
    second.close()
    streams.update()
    assert not any(in_loop) and not loop.stop.called
    released.set()


def test_a_stream_on_the_network_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    with open_stream_address("0.0.0.0", 0):
        pass
    assert "the stream for Foxglove is served on 0.0.0.0, without encryption" in capsys.readouterr().err


def test_without_the_extra_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(EnvironmentLackError, match=r"pip install 'pneumatic-hil\[foxglove\]'"):
        start_foxglove_server(Path("feed"), "127.0.0.1", 1)


def test_only_the_serving_process_imports_the_package() -> None:
    program = "import sys, hil.cli.live, hil.cli.live_page, hil.live.server; print('foxglove' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
