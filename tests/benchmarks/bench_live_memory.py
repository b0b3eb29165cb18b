"""The live page over a long time: the memory of the serving process and of the page must not grow.

    python tests/benchmarks/bench_live_memory.py [speed]

Feeds an hour of periods of three axes to a page in a headless Chromium, ``speed`` times faster than real
time (default 40: 90 s), with a log entry each second. With speed 1 it takes the hour. The history of ten
minutes is full after ten minutes of periods; from 15 on, nothing may grow. Exit status 1: something grew.
"""

from __future__ import annotations

import math
import shutil
import sys
import threading
import time
from pathlib import Path

from playwright.sync_api import CDPSession, sync_playwright

from hil.core.life_cycle import LifeCycleState
from hil.core.output import AxisSignals, Cycle, LogEntry, Severity
from hil.live.address import open_address
from hil.live.feed import LiveFeed
from hil.live.feed_file import RunInformation
from hil.live.process import start_page_server

PERIOD_S = 0.0112
DURATION_S = 3600.0
FULL_S = 900.0
"""Time from which on nothing may grow."""
MEASUREMENTS = 10
MAX_GROWTH_MB = 8.0
AXES = [("vertical", "m"), ("horizontal", "m"), ("rotation", "rad")]


def cycle(number: int) -> Cycle:
    """Return a period in which every axis follows a slow sine."""
    t = number * PERIOD_S
    deadline_ns = round(t * 1e9)
    r, y = 0.1 * math.sin(t), 0.1 * math.sin(t - 0.1)
    axes = (AxisSignals(r, y, r - y, r - y, 5.0 + r - y, 5.0 + y),) * len(AXES)
    wake_ns = deadline_ns + 20_000
    return Cycle(number, deadline_ns, wake_ns, wake_ns + 300_000, LifeCycleState.RUNNING, True, axes)


def write(feed: LiveFeed, speed: float) -> None:
    """Write an hour of periods, ``speed`` times faster than real time."""
    start_s = time.monotonic()
    number = 0
    while number * PERIOD_S < DURATION_S:
        end = round((time.monotonic() - start_s) * speed / PERIOD_S)
        while number < end:
            period = cycle(number)
            feed.period(period, period.wake_ns + 350_000, period.wake_ns + 400_000)
            if number % 89 == 0:
                feed.log(LogEntry(Severity.INFO, "benchmark", f"second {number * PERIOD_S:.0f}"))
            number += 1
        time.sleep(0.01)


def server_mb(process_id: int) -> float:
    """Return the resident memory of a process."""
    pages = int(Path(f"/proc/{process_id}/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def page_mb(session: CDPSession) -> float:
    """Return the memory of the page's scripts after a garbage collection."""
    session.send("HeapProfiler.collectGarbage")
    metrics = {entry["name"]: entry["value"] for entry in session.send("Performance.getMetrics")["metrics"]}
    return float(metrics["JSHeapUsedSize"]) / 1e6


def main(speed: float) -> int:
    """Measure, print, and return the exit status."""
    chromium = shutil.which("chromium")
    if chromium is None:
        print("not measured: install the Debian package chromium")
        return 1
    states = [state.name.lower() for state in LifeCycleState]
    feed = LiveFeed(RunInformation(AXES, PERIOD_S, states, "", "slcan:none", 0, 0, ""), {}, lambda: "")
    with open_address() as address:
        server = start_page_server(address, feed=feed.path)
    grown: list[tuple[float, float, float]] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1280, "height": 900}, bypass_csp=True)
        page.goto(address.url)
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable")
        thread = threading.Thread(target=write, args=(feed, speed))
        thread.start()
        for place in range(MEASUREMENTS):
            part_s = (DURATION_S - FULL_S) / (MEASUREMENTS - 1)
            page.wait_for_function(
                f"hilLive.rows && hilLive.rows.last >= {FULL_S - 5.0 + place * part_s}", timeout=4e6
            )
            row = (page.evaluate("hilLive.rows.last"), server_mb(server.pid), page_mb(session))
            grown.append(row)
            print("{:6.0f} s of samples: serving process {:.1f} MB, page {:.1f} MB".format(*row))
        drawn = page.evaluate("hilLive.received")
        thread.join()
        browser.close()
    feed.close()
    server.wait()
    _, server_growth, page_growth = (last - first for last, first in zip(grown[-1], grown[0], strict=True))
    print(f"{drawn} rows received; growth: serving process {server_growth:.1f} MB, page {page_growth:.1f} MB")
    return 0 if max(server_growth, page_growth) <= MAX_GROWTH_MB else 1


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 40.0))
