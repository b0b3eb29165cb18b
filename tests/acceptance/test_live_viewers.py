"""Viewers of a real run that are killed, suspended or slow, or send garbage: they trouble nobody."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from playwright.sync_api import sync_playwright
from support.bad_viewers import GARBAGE, frame, half_open, send, silent
from support.live_viewer import LiveViewer, private_mb, server_of

import hil
from hil.cli import main
from hil.live.feed_file import FeedReader, link_beside

pytestmark = pytest.mark.real_time

HIL = [sys.executable, "-m", "hil.cli"]
SILENT_VIEWERS = 10
HALF_OPEN = 100
"""Number of connections that never finish their request."""
MAX_GROWTH_MB = 30.0
"""Largest growth of the serving process. At most 0.5 MB of rows waits for a viewer, three times while they
are packed. A message of 10 MB is refused by its length."""
SUSPENDED_PERIODS = 450
"""Number of periods, 5 s, for which a viewer is suspended."""


class Run(NamedTuple):
    """A daemon with a page."""

    address: str
    server: int
    """Id of the process that serves the page."""
    recording: Path
    start_ns: int
    """Monotonic time of the page's second 0."""


@contextlib.contextmanager
def daemon(folder: Path) -> Iterator[Run]:
    """Give a daemon. At the end it must serve as before, have reported nothing, and have a good recording."""
    at, recording, errors = str(folder / "socket"), folder / "run.mcap", folder / "errors"
    command = [*HIL, "daemon", "--socket", at, "--live", "--operate", "--record", str(recording)]
    with (
        errors.open("w") as file,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=file, text=True) as process,
    ):
        assert process.stdout is not None
        address = re.sub("^page: ", "", process.stdout.readline().strip())
        feed = FeedReader(link_beside(Path(at)))
        start_ns = feed.run.start_ns
        feed.close()
        try:
            server = server_of(process.pid)
            yield Run(address, server, recording, start_ns)
            assert server_of(process.pid) == server
        finally:
            assert main(["shutdown", "--socket", at]) == 0
    assert process.returncode == 0
    reported = errors.read_text()
    assert "Traceback" not in reported and "tornado" not in reported
    assert hil.open_recording(recording).messages_dropped == 0
    assert main(["replay", str(recording)]) == 0


def assert_complete(run: Run, times_s: np.ndarray[Any, Any]) -> None:
    """Assert that a viewer has received every period from its first to its last, once and in order."""
    received_ns = np.round(times_s * 1e9).astype(np.int64) + run.start_ns
    recorded_ns = hil.open_recording(run.recording).timing().deadline_ns
    inside = (recorded_ns >= received_ns[0]) & (recorded_ns <= received_ns[-1])
    np.testing.assert_array_equal(received_ns, recorded_ns[inside])


def test_viewers_that_are_killed_or_suspended(tmp_path: Path) -> None:
    with daemon(tmp_path) as run:
        witness, killed, suspended = (LiveViewer(run.address) for _ in range(3))
        for viewer in (witness, killed, suspended):
            viewer.wait_for_rows(50)
        killed.kill()
        os.kill(suspended.pid, signal.SIGSTOP)
        before = suspended.seen
        witness.wait_for_rows(SUSPENDED_PERIODS)
        present_s = witness.seen.last_s
        os.kill(suspended.pid, signal.SIGCONT)
        suspended.wait_until(lambda seen: seen.last_s > present_s, "present data")
        witness.wait_for_rows(50)
        assert witness.seen.missed == suspended.seen.missed == 0
        times_s = [witness.times_s(), suspended.times_s()]
        assert len(times_s[1]) - before.rows >= SUSPENDED_PERIODS  # also what came while it was suspended
    for times in times_s:
        assert_complete(run, times)


def test_viewers_that_read_nothing_or_send_garbage(tmp_path: Path) -> None:
    with daemon(tmp_path) as run, contextlib.ExitStack() as stack:
        witness = LiveViewer(run.address)
        witness.wait_for_rows(100)
        before_mb = private_mb(run.server)
        for data in GARBAGE.values():
            with silent(run.address) as sock:
                send(sock, data)
                witness.wait_for_rows(1)
        garbage_mb = private_mb(run.server)
        lazy = [stack.enter_context(silent(run.address)) for _ in range(SILENT_VIEWERS)]
        for sock in lazy:  # answers for which nobody waits
            send(sock, 50 * frame(9, b"ping") + 50 * frame(1, b'{"request": "stop"}'))
        connections = [half_open(run.address) for _ in range(HALF_OPEN // 2)]
        connections += [half_open(run.address, b"GET / HT") for _ in range(HALF_OPEN // 2)]
        for sock in connections:
            stack.enter_context(sock)
        witness.wait_for_rows(SUSPENDED_PERIODS)
        late = LiveViewer(run.address)  # there is room for another viewer
        late.wait_for_rows(50)
        assert garbage_mb - before_mb < MAX_GROWTH_MB
        assert private_mb(run.server) - before_mb < MAX_GROWTH_MB
        assert witness.seen.missed == late.seen.missed == 0
        times_s = [witness.times_s(), late.times_s()]
    for times in times_s:
        assert_complete(run, times)


def test_a_browser_that_is_suspended(tmp_path: Path) -> None:
    chromium = shutil.which("chromium")
    assert chromium is not None, "install the Debian package chromium"
    with daemon(tmp_path) as run, sync_playwright() as playwright:
        witness = LiveViewer(run.address)
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(bypass_csp=True)
        page.goto(run.address)
        page.wait_for_function("hilLive.drawn > 100", timeout=60_000)
        found = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
        processes = [int(entry["id"]) for entry in found]
        try:
            for process_id in processes:
                os.kill(process_id, signal.SIGSTOP)
            witness.wait_for_rows(SUSPENDED_PERIODS)
        finally:
            for process_id in processes:
                os.kill(process_id, signal.SIGCONT)
        present_s = witness.seen.last_s
        page.wait_for_function(f"hilLive.rows.last > {present_s}", timeout=60_000)
        page.wait_for_function("!document.body.classList.contains('stale')", timeout=60_000)
        rows = page.evaluate(
            "Array.from({length: hilLive.rows.length}, (_, k) => hilLive.rows.at(hilLive.rows.begin + k, 0))"
        )
        browser.close()
        times_s = [witness.times_s(), np.array(rows)]
    for times in times_s:
        assert len(times) > SUSPENDED_PERIODS
        assert_complete(run, times)
