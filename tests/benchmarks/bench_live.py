"""The live page: what it costs the loop and the serving process, and the time from sampled to drawn.

    python tests/benchmarks/bench_live.py [rounds]

Runs alternate: without the page; with three viewers that receive everything and draw nothing, as viewers on
other machines; and with one and three headless browsers, each a process of its own. Browsers draw without a
graphics card here, and share the processors with loop and boards. Exit status 1: a target was missed.

Response is the time from SYNC to the command, and includes the simulated boards, an ordinary process. Its
part in the loop is the time from the sample to the command.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import timeit
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from playwright.sync_api import Playwright, sync_playwright
from tornado.websocket import websocket_connect

import hil
from hil.core.output import AxisSignals, Cycle
from hil.live.feed import LiveFeed
from hil.live.feed_file import RunInformation

ROUNDS = 3
SETTLE_MS = 4000
MEASURED_MS = 10_000
VIEWERS = 3
MAX_RATIO = 1.05
MAX_PROCESSOR_SHARE = 0.10
MAX_DELAY_MS = 100.0
NAMES = ("lateness", "response", "sample to command")


class Watched(NamedTuple):
    """What was measured while a run was watched."""

    share: float
    """Processor time of the serving process as a part of one processor."""
    delays_ms: list[float]
    """Time from sampled to drawn of each period, of every viewer; empty without a browser."""


def feed_cost_us() -> float:
    """Return the time in microseconds that the loop needs to write one period of three axes."""
    axes = [("vertical", "m"), ("horizontal", "m"), ("rotation", "rad")]
    feed = LiveFeed(RunInformation(axes, 0.0112, [], "", "", 0, 0, ""), {}, lambda: "")
    signals = (AxisSignals(0.1, 0.09, 0.01, 1.0, 6.0, 7.0, 2),) * 3
    period = Cycle(1, 10**9, 10**9, 10**9, 3, True, signals)
    times_s = timeit.repeat(lambda: feed.period(period, 10**9, 10**9), number=10_000, repeat=7)
    feed.close()
    return min(times_s) / 10_000 * 1e6


def serving_process(run: subprocess.Popen[str]) -> int:
    """Return the process id of the process that serves the page of ``run``."""
    children = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
    for child in children:
        if b"hil.live.server" in Path(f"/proc/{child}/cmdline").read_bytes():
            return int(child)
    raise RuntimeError("the run has no process that serves the page")


def processor_s(process_id: int) -> float:
    """Return the processor time of a process."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


@contextlib.contextmanager
def running(path: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Start a run, and interrupt it at the end."""
    command = [sys.executable, "-m", "hil.cli", "run", "--duration", "600", "--record", str(path)]
    with subprocess.Popen(
        [*command, "--no-plot", *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        yield process
        process.send_signal(signal.SIGINT)
        assert process.stdout is not None
        process.stdout.read()


def timing(path: Path) -> list[float]:
    """Return the 99th percentiles of ``NAMES`` in microseconds."""
    table = hil.open_recording(path).timing()
    table = table[table.fresh]
    instants = (
        (table.deadline_ns, table.wake_ns),
        (table.wake_ns, table.sent_ns),
        (table.receive_ns, table.sent_ns),
    )
    return [float(np.percentile(end - begin, 99)) * 1e-3 for begin, end in instants]


def watch(run: subprocess.Popen[str]) -> float:
    """Return the serving process' share of a processor, after viewers have settled."""
    server, wait = serving_process(run), threading.Event()
    wait.wait(SETTLE_MS * 1e-3)
    before_s = processor_s(server)
    wait.wait(MEASURED_MS * 1e-3)
    return (processor_s(server) - before_s) / (MEASURED_MS * 1e-3)


def with_receivers(path: Path, count: int) -> Watched:
    """Run with viewers that receive everything and draw nothing."""
    with running(path, "--live") as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip().removeprefix("page: ")
        stream = address.replace("http://", "ws://").replace("/?", "/stream?")

        async def receive() -> None:
            connection = await websocket_connect(stream)
            while await connection.read_message() is not None:
                pass

        async def receive_all() -> None:
            await asyncio.gather(*(receive() for _ in range(count)))

        thread = threading.Thread(target=lambda: asyncio.run(receive_all()), daemon=True)
        thread.start()
        return Watched(watch(process), [])


def with_browsers(playwright: Playwright, chromium: str, path: Path, count: int) -> Watched:
    """Run with pages, each in a browser of its own."""
    with running(path, "--live") as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip().removeprefix("page: ")
        browsers = [
            playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
            for _ in range(count)
        ]
        pages = [browser.new_page(viewport={"width": 1280, "height": 900}) for browser in browsers]
        for page in pages:
            page.goto(address)
        share = watch(process)
        delays = [delay for page in pages for delay in page.evaluate("hilLive.delays_ms.slice(-800)")]
        for browser in browsers:
            browser.close()
    return Watched(share, delays)


def print_delays(what: str, delays_ms: list[float], target: str) -> float:
    """Print the percentiles of the time from sampled to drawn, and return p95."""
    p50, p95 = (float(np.percentile(delays_ms, part)) for part in (50, 95))
    print(f"from sampled to drawn, {what}: p50 {p50:.0f} ms, p95 {p95:.0f} ms{target}")
    return p95


def main(rounds: int) -> int:
    """Measure, print, and return the exit status."""
    chromium = shutil.which("chromium")
    if chromium is None:
        print("not measured: install the Debian package chromium")
        return 1
    print(f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f} before")
    print(f"one period into the feed: {feed_cost_us():.1f} us")
    times: dict[str, list[list[float]]] = {}
    watched: dict[str, list[Watched]] = {}
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            path = Path(folder) / f"bare{number}.mcap"
            with running(path):
                threading.Event().wait((SETTLE_MS + MEASURED_MS) * 1e-3)
            times.setdefault("without", []).append(timing(path))
            for what, count in (("receivers", VIEWERS), ("1 browser", 1), ("3 browsers", VIEWERS)):
                path = Path(folder) / f"{what}{number}.mcap"
                result = (
                    with_receivers(path, count)
                    if what == "receivers"
                    else with_browsers(playwright, chromium, path, count)
                )
                times.setdefault(what, []).append(timing(path))
                watched.setdefault(what, []).append(result)
    good = True
    for place, name in enumerate(NAMES):
        medians = {what: statistics.median(row[place] for row in rows) for what, rows in times.items()}
        ratio = medians["receivers"] / medians["without"]
        good &= ratio <= MAX_RATIO
        print(
            f"{name} p99: {medians['without']:.0f} us without; {medians['receivers']:.0f} us with {VIEWERS} "
            f"receivers, ratio {ratio:.2f}, target {MAX_RATIO:g}; {medians['1 browser']:.0f} us with 1 "
            f"browser, {medians['3 browsers']:.0f} us with 3 on these processors"
        )
    for what, results in watched.items():
        share = statistics.median(result.share for result in results)
        good &= share <= MAX_PROCESSOR_SHARE
        print(
            f"serving process, {what}: {100 * share:.1f} % of a core, target {100 * MAX_PROCESSOR_SHARE:g} %"
        )
    one = [delay for result in watched["1 browser"] for delay in result.delays_ms]
    three = [delay for result in watched["3 browsers"] for delay in result.delays_ms]
    good &= print_delays("1 browser", one, f", target {MAX_DELAY_MS:g} ms") <= MAX_DELAY_MS
    print_delays("3 browsers on these processors", three, "")
    print(f"load {os.getloadavg()[0]:.1f} after")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS))
