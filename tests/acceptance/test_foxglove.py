"""The stream for Foxglove beside a daemon: what a client receives is what is recorded."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from pathlib import Path

import pytest
from support.foxglove_client import Client, by_topic, served_messages

from hil.cli import main
from hil.live.foxglove_messages import Message
from hil.recording.schemas import CYCLE_TOPIC, LOG_TOPIC

pytestmark = pytest.mark.real_time

HIL = [sys.executable, "-m", "hil.cli"]
MESSAGES = 400


async def received(port: int) -> list[Message]:
    client = await Client.connect(port)
    messages = [await client.message() for _ in range(MESSAGES)]
    client.close()
    return messages


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
            ports = [int(url.rpartition(":")[2]) for url in (of_daemon, beside.stdout.readline().strip())]
            streams = [asyncio.run(asyncio.wait_for(received(port), 60.0)) for port in ports]
            assert main(["shutdown", "--socket", at]) == 0
        assert beside.returncode == 0  # it ends with the daemon
    assert daemon.returncode == 0
    recorded = by_topic(served_messages(path))
    for stream in streams:
        for topic, messages in by_topic(stream).items():
            if topic == LOG_TOPIC:
                continue  # logged some microseconds apart
            first = recorded[topic].index(messages[0])
            assert messages == recorded[topic][first : first + len(messages)]
        assert len(by_topic(stream)[CYCLE_TOPIC]) > 80
