"""The live page over a long time: the memory of the serving process and of the page must not grow.

    python tests/benchmarks/bench_live_memory.py [--speed 40] [--minutes 60]

Feeds periods of three axes to a page in a headless Chromium, ``--speed`` times faster than real time, with a
log entry each second. With ``--speed 1`` it takes its time. Every five minutes of periods it prints

- private memory of the serving process, which does not include the shared memory that it reads,
- the heap of the page's scripts after a garbage collection,
- what the browser's process that draws the page has allocated then, scripts left out,
- private memory of that process. It contains what the browser has not freed yet or keeps for later.

The history of ten minutes is full after ten minutes. From 15 minutes on, a straight line is fitted to each of
them. Exit status 1: the line of one of the first three rises by more than 8 MB in an hour.
"""

from __future__ import annotations

import argparse
import math
import os
import shutil
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, CDPSession, Page, sync_playwright

from hil.core.life_cycle import LifeCycleState
from hil.core.output import AxisSignals, Cycle, LogEntry, Severity
from hil.live.address import open_address
from hil.live.feed import LiveFeed
from hil.live.feed_file import RunInformation
from hil.live.process import start_page_server

PERIOD_S = 0.0112
INTERVAL_S = 300.0
"""Time in s of periods between two measurements."""
FULL_S = 900.0
"""Time from which on nothing may grow."""
MAX_GROWTH_MB = 8.0
"""Largest rise of a fitted line in an hour."""
AXES = [("vertical", "m"), ("horizontal", "m"), ("rotation", "rad")]
NAMES = (
    "serving process",
    "scripts of the page",
    "allocated by the page's process",
    "private memory of the page's process",
)
JUDGED = 3
"""Number of the first ones that have a target."""
ALLOCATORS = (
    "malloc/allocated_objects",
    "partition_alloc/allocated_objects",
    "blink_gc/main/allocated_objects",
)
"""Entries of a memory dump of Chromium that sum up to what a process has allocated, besides scripts."""


def cycle(number: int) -> Cycle:
    """Return a period in which every axis follows a slow sine."""
    t = number * PERIOD_S
    deadline_ns = round(t * 1e9)
    r, y = 0.1 * math.sin(t), 0.1 * math.sin(t - 0.1)
    axes = (AxisSignals(r, y, r - y, r - y, 5.0 + r - y, 5.0 + y),) * len(AXES)
    wake_ns = deadline_ns + 20_000
    return Cycle(number, deadline_ns, wake_ns, wake_ns + 300_000, LifeCycleState.RUNNING, True, axes)


def write(feed: LiveFeed, speed: float, duration_s: float) -> None:
    """Write ``duration_s`` seconds of periods, ``speed`` times faster than real time."""
    start_s = time.monotonic()
    number = 0
    while number * PERIOD_S < duration_s:
        end = round((time.monotonic() - start_s) * speed / PERIOD_S)
        while number < end:
            period = cycle(number)
            feed.period(period, period.wake_ns + 350_000, period.wake_ns + 400_000)
            if number % 89 == 0:
                feed.log(LogEntry(Severity.INFO, "benchmark", f"second {number * PERIOD_S:.0f}"))
            number += 1
        time.sleep(0.01)


def private_mb(process_id: int) -> float:
    """Return the private resident memory of a process."""
    for line in Path(f"/proc/{process_id}/status").read_text().splitlines():
        if line.startswith("RssAnon:"):
            return int(line.split()[1]) * 1024 / 1e6
    raise RuntimeError(f"process {process_id} has no RssAnon")


def scripts_mb(session: CDPSession) -> float:
    """Return the memory of the page's scripts after a garbage collection."""
    for _ in range(2):  # the first one frees what holds other objects
        session.send("HeapProfiler.collectGarbage")
    metrics = {entry["name"]: entry["value"] for entry in session.send("Performance.getMetrics")["metrics"]}
    return float(metrics["JSHeapUsedSize"]) / 1e6


def allocated_mb(browser: Browser, page: Page) -> float:
    """Return what the process with most memory of scripts and page has allocated, from a memory dump."""
    session = browser.new_browser_cdp_session()
    events: list[dict[str, Any]] = []
    complete: list[object] = []
    session.on("Tracing.dataCollected", lambda found: events.extend(found["value"]))
    session.on("Tracing.tracingComplete", lambda found: complete.append(found))
    categories = {"includedCategories": ["disabled-by-default-memory-infra"]}
    config = {**categories, "memoryDumpConfig": {"triggers": []}}
    session.send("Tracing.start", {"traceConfig": config, "transferMode": "ReportEvents"})
    session.send("Tracing.requestMemoryDump", {"levelOfDetail": "detailed"})
    session.send("Tracing.end")
    while not complete:
        page.wait_for_timeout(50)
    session.detach()
    sums: Counter[int] = Counter()
    for event in events:
        if event["ph"] == "v":
            dumps = event["args"]["dumps"].get("allocators", {})
            for name in set(ALLOCATORS) & set(dumps):
                sums[event["pid"]] += int(dumps[name]["attrs"]["size"]["value"], 16)
    return max(sums.values()) / 1e6


def page_process(browser: Browser) -> int:
    """Return the id of the process that draws the page: that with most memory of its kind."""
    found = browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]
    return max((int(entry["id"]) for entry in found if entry["type"] == "renderer"), key=private_mb)


def main(speed: float, minutes: float) -> int:
    """Measure, print, and return the exit status."""
    chromium = shutil.which("chromium")
    if chromium is None:
        print("not measured: install the Debian package chromium")
        return 1
    duration_s = 60.0 * minutes
    if duration_s < FULL_S + 2 * INTERVAL_S:
        print(f"not measured: --minutes {minutes:g} is less than {(FULL_S + 2 * INTERVAL_S) / 60:g}")
        return 1
    print(
        f"{minutes:g} minutes at {speed:g} times real time, load {os.getloadavg()[0]:.1f} before", flush=True
    )
    states = [state.name.lower() for state in LifeCycleState]
    feed = LiveFeed(RunInformation(AXES, PERIOD_S, states, "", "slcan:none", 0, 0, ""), {}, lambda: "")
    with open_address() as address:
        server = start_page_server(address, feed=feed.path)
    measured: list[tuple[float, ...]] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1280, "height": 900}, bypass_csp=True)
        page.goto(address.url)
        session = page.context.new_cdp_session(page)
        session.send("Performance.enable")
        thread = threading.Thread(target=write, args=(feed, speed, duration_s))
        thread.start()
        for place in range(1, int(duration_s / INTERVAL_S) + 1):
            # Rows arrive 30 times a second: the last ones before the end are a part of a second old.
            until_s = place * INTERVAL_S - max(0.1 * speed, 1.0)
            page.wait_for_function(f"hilLive.rows && hilLive.rows.last >= {until_s}", timeout=4e6)
            row = (
                page.evaluate("hilLive.rows.last"),
                private_mb(server.pid),
                scripts_mb(session),
                allocated_mb(browser, page),
                private_mb(page_process(browser)),
            )
            measured.append(row)
            values = ", ".join(f"{name} {value:.1f} MB" for name, value in zip(NAMES, row[1:], strict=True))
            print(f"{row[0] / 60:5.1f} min of periods: {values}", flush=True)
        received, drawn = page.evaluate("[hilLive.received, hilLive.drawn]")
        thread.join()
        browser.close()
    feed.close()
    server.wait()
    print(f"{received} periods received, drawn up to number {drawn}; load {os.getloadavg()[0]:.1f} after")
    times_s, *memories = np.array([row for row in measured if row[0] >= FULL_S - 60.0]).T
    good = True
    for place, (name, memory) in enumerate(zip(NAMES, memories, strict=True)):
        growth_mb = float(np.polyfit(times_s / 3600.0, memory, 1)[0])
        is_good = growth_mb <= MAX_GROWTH_MB
        verdict = f"target at most {MAX_GROWTH_MB:g} MB: {'reached' if is_good else 'MISSED'}"
        if place >= JUDGED:
            verdict = "no target"
        else:
            good &= is_good
        print(
            f"{name}: {growth_mb:+.2f} MB in an hour, from {len(times_s)} measurements between "
            f"{memory.min():.1f} and {memory.max():.1f} MB; {verdict}"
        )
    return 0 if good else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--speed", type=float, default=40.0, help="times real time (default 40)")
    parser.add_argument("--minutes", type=float, default=60.0, help="duration in periods (default 60)")
    given = parser.parse_args()
    sys.exit(main(given.speed, given.minutes))
