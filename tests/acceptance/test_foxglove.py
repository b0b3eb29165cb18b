"""The stream for Foxglove beside a daemon: what a client receives is what is recorded."""

from __future__ import annotations

import asyncio
import contextlib
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from support.bad_viewers import GARBAGE, frame, half_open, send, silent
from support.foxglove_client import Client, by_topic, served_messages
from support.live_viewer import private_mb, server_of
from tornado.httpclient import HTTPError
from tornado.websocket import WebSocketClosedError

import hil
from hil.cli import main
from hil.live.foxglove_messages import Message
from hil.recording.schemas import CYCLE_TOPIC, LOG_TOPIC

pytestmark = pytest.mark.real_time

HIL = [sys.executable, "-m", "hil.cli"]
MESSAGES = 400
SILENT_CLIENTS = 10
MAX_GROWTH_MB = 30.0
"""Largest growth of the serving process: 1024 messages wait for a client that reads nothing."""


async def received(url: str) -> list[Message]:
    client = await Client.connect(url)
    messages = [await client.message() for _ in range(MESSAGES)]
    client.close()
    return messages


def assert_recorded(stream: list[Message], path: Path) -> None:
    """Assert that a stream has every message of the recording from its first to its last."""
    recorded = by_topic(served_messages(path))
    for topic, messages in by_topic(stream).items():
        if topic == LOG_TOPIC:
            continue  # logged some microseconds apart
        first = recorded[topic].index(messages[0])
        assert messages == recorded[topic][first : first + len(messages)]
    assert len(by_topic(stream)[CYCLE_TOPIC]) > 80


def test_a_client_beside_a_daemon_receives_what_is_recorded(tmp_path: Path) -> None:
    path, at = tmp_path / "run.mcap", str(tmp_path / "socket")
    with subprocess.Popen(
        [*HIL, "daemon", "--socket", at, "--foxglove", "0", "--record", str(path)],
        stdout=subprocess.PIPE,
        text=True,
    ) as daemon:
        assert daemon.stdout is not None
        of_daemon = daemon.stdout.readline().strip()
        assert of_daemon.startswith("Foxglove: ws://127.0.0.1:")
        # A second stream, of a command that is started beside the daemon later.
        with subprocess.Popen(
            [*HIL, "live", "--socket", at, "--foxglove", "0"], stdout=subprocess.PIPE, text=True
        ) as beside:
            assert beside.stdout is not None
            urls = [of_daemon.removeprefix("Foxglove: "), beside.stdout.readline().strip()]
            streams = [asyncio.run(asyncio.wait_for(received(url), 60.0)) for url in urls]
            assert main(["shutdown", "--socket", at]) == 0
            beside.terminate()
    assert daemon.returncode == 0
    for stream in streams:
        assert_recorded(stream, path)


def test_the_stream_goes_on_with_the_next_run_of_a_daemon(tmp_path: Path) -> None:
    at = str(tmp_path / "socket")

    def daemon() -> subprocess.Popen[str]:
        command = [*HIL, "daemon", "--socket", at, "--live", "--no-record"]
        started = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert started.stdout is not None and started.stdout.readline().startswith("page: ")
        return started

    async def first_message_of_the_next_run(url: str, begin_ns: int) -> None:
        """Connect again until there is a new run, as Foxglove does after it has lost the connection."""
        while True:
            with contextlib.suppress(HTTPError, AssertionError, TypeError, OSError, WebSocketClosedError):
                client = await Client.connect(url)
                message = await client.message()
                client.close()
                if message.log_time_ns > begin_ns:
                    return

    first = daemon()
    with subprocess.Popen(
        [*HIL, "live", "--socket", at, "--foxglove", "0"], stdout=subprocess.PIPE, text=True
    ) as beside:
        assert beside.stdout is not None
        url = beside.stdout.readline().strip()
        asyncio.run(asyncio.wait_for(received(url), 60.0))
        first.kill()
        first.wait()
        begin_ns = time.time_ns()
        second = daemon()
        asyncio.run(asyncio.wait_for(first_message_of_the_next_run(url, begin_ns), 60.0))
        assert main(["shutdown", "--socket", at]) == 0
        assert second.wait() == 0
        beside.terminate()


def test_clients_that_read_nothing_or_send_garbage_trouble_nobody(tmp_path: Path) -> None:
    path, at = tmp_path / "run.mcap", str(tmp_path / "socket")
    command = [*HIL, "daemon", "--socket", at, "--foxglove", "0", "--record", str(path)]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon,
        contextlib.ExitStack() as stack,
    ):
        stack.callback(daemon.kill)
        assert daemon.stdout is not None
        url = daemon.stdout.readline().strip().removeprefix("Foxglove: ")
        server = server_of(daemon.pid, "hil.live.foxglove_server")
        streams = [asyncio.run(asyncio.wait_for(received(url), 60.0))]
        before_mb = private_mb(server)

        for data in (*GARBAGE.values(), frame(1, b'{"op": "advertise", "channels": [{}]}')):
            with silent(url, "/", "foxglove.sdk.v1") as sock:
                send(sock, data)
        for _ in range(SILENT_CLIENTS):
            subscriptions = [{"id": n, "channelId": n} for n in range(1, 20)]
            sock = stack.enter_context(silent(url, "/", "foxglove.sdk.v1"))
            send(sock, frame(1, json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode()))
        for _ in range(50):
            stack.enter_context(half_open(url))
            stack.enter_context(half_open(url, b"GET /"))
        streams += [asyncio.run(asyncio.wait_for(received(url), 60.0)) for _ in range(3)]
        assert server_of(daemon.pid, "hil.live.foxglove_server") == server
        assert private_mb(server) - before_mb < MAX_GROWTH_MB
        assert main(["shutdown", "--socket", at]) == 0
        assert daemon.wait() == 0
    for stream in streams:
        assert_recorded(stream, path)
    assert hil.open_recording(path).messages_dropped == 0
    assert main(["replay", str(path)]) == 0
