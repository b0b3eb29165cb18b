"""The live page: what it costs the loop and the serving process, and the time from sampled to drawn.

    python tests/benchmarks/bench_live.py [rounds]

Needs a quiet machine, for about eight minutes with 7 rounds (the default).

A round is three runs: one without the page, one with the page and three viewers, and one without the page
beside other work. Every second round has the first two in the other order, because other work on the machine
comes and goes. The viewers are one process of the lowest priority that receives everything and draws nothing,
as viewers on other machines do. If it has not received every period, the benchmark fails. Of each run the
same time is used, which begins when viewers and loop have settled.

The other work is two processes that have nothing to do with the loop. They take as much processor time, as
often and with the same priorities, as the serving process and the viewers took just before. Their ratio says
what any such process on these processors costs; what the page costs beyond it stands beside it.

The figure is the median over the rounds of the ratio of the two 99th percentiles, with smallest and
largest. Beside it stands the ratio of the two halves of each run without the page: that is how far two 99th
percentiles of the same thing are apart. A target is reached or missed by the median; the verdict says if
the interval that has the true median with a probability of at least 90 % leaves it open.

Then one and three headless browsers, each a process of its own. The time from sampled to drawn ends after the
frame in which the last visible chart with the sample was painted. They draw without a graphics card here, and
share the processors with loop and boards. Exit status 1: a target was missed.

Response is the time from SYNC to the command, and includes the simulated boards, an ordinary process. Its
part in the loop is the time from the sample to the command.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import math
import os
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import timeit
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from playwright.sync_api import Playwright, sync_playwright
from tornado.websocket import websocket_connect

import hil
from hil.core.output import AxisSignals, Cycle
from hil.live.feed import LiveFeed
from hil.live.feed_file import RunInformation

ROUNDS = 7
SETTLE_S = 3.0
MEASURED_S = 14.0
BROWSER_S = 15.0
VIEWERS = 3
PERIODS_PER_S = 1.0 / 0.0112
MAX_RATIO = 1.05
MAX_PROCESSOR_SHARE = 0.10
MAX_DELAY_MS = 100.0
SERVER_NICE, VIEWERS_NICE = 5, 19
UPDATES_PER_S = 30.0
MAX_LOAD = 0.5
"""Load of the machine before, above which the figures are doubtful."""
NAMES = ("lateness", "response", "sample to command")

Times = npt.NDArray[np.float64]


class Measured(NamedTuple):
    """What was measured of a run."""

    times_us: Times
    """A column for each of ``NAMES``, a row for each period."""
    share: float
    """Processor time of the serving process as a part of one processor; 0 without the page."""
    viewers_share: float = 0.0
    """Processor time of the viewers, the same way."""


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
    end_s = time.monotonic() + 10.0
    while time.monotonic() < end_s:  # the kernel's list may lack one while others end
        children = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
        for child in children:
            with contextlib.suppress(OSError):
                if b"hil.live.server" in Path(f"/proc/{child}/cmdline").read_bytes():
                    return int(child)
        threading.Event().wait(0.05)
    raise RuntimeError("the run has no process that serves the page")


def processor_s(process_id: int) -> float:
    """Return the processor time of a process."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def running(path: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Start a run, and interrupt it at the end."""
    command = [sys.executable, "-m", "hil.cli", "run", "--duration", "600", "--record", str(path)]
    with subprocess.Popen(
        [*command, "--no-plot", *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            assert process.stdout is not None
            process.stdout.read()


def address_of(run: subprocess.Popen[str]) -> str:
    """Return the address of the page of ``run``."""
    assert run.stdout is not None
    return run.stdout.readline().strip().removeprefix("page: ")


def times_between(path: Path, begin_ns: int, end_ns: int) -> Times:
    """Return the times of ``NAMES`` in microseconds, of the periods with a deadline between two instants."""
    table = hil.open_recording(path).timing()
    table = table[table.fresh & (table.deadline_ns >= begin_ns) & (table.deadline_ns < end_ns)]
    instants = (
        (table.deadline_ns, table.wake_ns),
        (table.wake_ns, table.sent_ns),
        (table.receive_ns, table.sent_ns),
    )
    return np.column_stack([(end - begin) * 1e-3 for begin, end in instants])


def beside_other_work(path: Path, like: Measured) -> Measured:
    """Measure a run without the page, beside other work of the size that the page had in ``like``."""
    with contextlib.ExitStack() as stack:
        for nice, share in ((SERVER_NICE, like.share), (VIEWERS_NICE, like.viewers_share)):
            command = ["nice", "-n", str(nice), sys.executable, __file__, "--work", str(share)]
            process = stack.enter_context(subprocess.Popen(command))
            stack.callback(process.kill)
        return without_page(path)


def work(share: float) -> None:
    """Take a share of one processor, as often as the page sends, until the process is killed."""
    wait, begin_s = threading.Event(), time.monotonic()
    document = {"values": list(range(100))}
    for number in itertools.count(1):
        until_s = time.process_time() + share / UPDATES_PER_S
        while time.process_time() < until_s:
            json.loads(json.dumps(document))
        wait.wait(max(begin_s + number / UPDATES_PER_S - time.monotonic(), 0.0))


def without_page(path: Path) -> Measured:
    """Measure a run without the page."""
    wait = threading.Event()
    with running(path):
        while not path.exists():
            wait.wait(0.05)
        wait.wait(SETTLE_S)
        begin_ns = time.monotonic_ns()
        wait.wait(MEASURED_S)
        end_ns = time.monotonic_ns()
    return Measured(times_between(path, begin_ns, end_ns), 0.0)


def with_receivers(path: Path) -> Measured:
    """Measure a run with viewers that draw nothing. Raises RuntimeError if they miss a period."""
    wait = threading.Event()
    with running(path, "--live") as process:
        stream = address_of(process).replace("http://", "ws://").replace("/?", "/stream?")
        receivers = subprocess.Popen(
            ["nice", "-n", str(VIEWERS_NICE), sys.executable, __file__, "--receive", stream],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        processes = (serving_process(process), receivers.pid)
        wait.wait(SETTLE_S)
        begin_ns, before_s = time.monotonic_ns(), [processor_s(each) for each in processes]
        wait.wait(MEASURED_S)
        end_ns, after_s = time.monotonic_ns(), [processor_s(each) for each in processes]
        received = json.loads(receivers.communicate()[0])
    times_us = times_between(path, begin_ns, end_ns)
    if len(received) != VIEWERS or min(received) < len(times_us):
        raise RuntimeError(
            f"the viewers received {received} periods, the run has {len(times_us)} in this time"
        )
    shares = [(end - begin) / (end_ns - begin_ns) * 1e9 for begin, end in zip(before_s, after_s, strict=True)]
    return Measured(times_us, *shares)


def receive(stream: str) -> None:
    """Receive as ``VIEWERS`` viewers until standard input ends, then print the number of periods of each."""
    counts = [0] * VIEWERS

    async def view(place: int) -> None:
        connection = await websocket_connect(stream)
        row_bytes = 0
        while (message := await connection.read_message()) is not None:
            if isinstance(message, bytes):
                counts[place] += len(message) // row_bytes
            else:
                for part in json.loads(message):
                    if "run" in part:
                        row_bytes = 8 * (5 + 3 * len(part["run"]["axes"]))

    async def view_all() -> None:
        viewers = [asyncio.create_task(view(place)) for place in range(VIEWERS)]
        await asyncio.to_thread(sys.stdin.read)
        for viewer in viewers:
            viewer.cancel()

    asyncio.run(view_all())
    print(json.dumps(counts))


def with_browsers(
    playwright: Playwright, chromium: str, path: Path, count: int
) -> tuple[Measured, list[float]]:
    """Measure a run with pages, each in a browser of its own. Return also the times from sampled to drawn."""
    with running(path, "--live") as process:
        address, server = address_of(process), serving_process(process)
        browsers = [
            playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
            for _ in range(count)
        ]
        pages = [browser.new_page(viewport={"width": 1280, "height": 900}) for browser in browsers]
        for page in pages:
            page.goto(address)
        threading.Event().wait(SETTLE_S)
        for page in pages:
            page.evaluate("hilLive.delays_ms.length = 0")
        begin_ns, before_s = time.monotonic_ns(), processor_s(server)
        threading.Event().wait(BROWSER_S)
        end_ns, used_s = time.monotonic_ns(), processor_s(server) - before_s
        delays = [delay for page in pages for delay in page.evaluate("hilLive.delays_ms")]
        for browser in browsers:
            browser.close()
    share = used_s / (end_ns - begin_ns) * 1e9
    return Measured(times_between(path, begin_ns, end_ns), share), delays


def p99(times_us: Times) -> Times:
    """Return the 99th percentile of each column."""
    return np.asarray(np.percentile(times_us, 99, axis=0))


def interval(ratios: Sequence[float]) -> tuple[float, float]:
    """Return the order statistics between which the true median lies with a probability of at least 90 %."""
    n, ordered = len(ratios), sorted(ratios)
    outside, place = 0.0, 0
    while place < n // 2 and outside + 2.0 * math.comb(n, place) / 2.0**n <= 0.10:
        outside += 2.0 * math.comb(n, place) / 2.0**n
        place += 1
    return ordered[max(place - 1, 0)], ordered[n - max(place, 1)]


def spread(ratios: Sequence[float]) -> str:
    """Return median, smallest and largest as text."""
    return f"{statistics.median(ratios):.3f} ({min(ratios):.3f} .. {max(ratios):.3f})"


def is_reached(what: str, value: float, limit: float, unit: str, doubt: str = "") -> bool:
    """Print a figure, its target and the verdict. Return the verdict."""
    good = value <= limit
    print(f"{what}; target {limit:g}{unit}: {'reached' if good else 'MISSED'}{doubt}", flush=True)
    return good


def compare(rounds: Sequence[tuple[Measured, Measured, Measured]]) -> bool:
    """Print the comparison of the runs of each round. Return True if each target is reached."""
    good = True
    without, watched, beside = (np.array([p99(each[k].times_us) for each in rounds]) for k in range(3))
    halves = np.array(
        [
            p99(bare.times_us[len(bare.times_us) // 2 :]) / p99(bare.times_us[: len(bare.times_us) // 2])
            for bare, _, _ in rounds
        ]
    )
    for place, name in enumerate(NAMES):
        ratios = list(watched[:, place] / without[:, place])
        low, high = interval(ratios)
        doubt = (
            f", but the interval {low:.3f} .. {high:.3f} leaves it open" if low <= MAX_RATIO < high else ""
        )
        print(
            f"{name} p99: median {np.median(without[:, place]):.0f} us without, "
            f"{np.median(watched[:, place]):.0f} us with {VIEWERS} viewers; without, second half to first: "
            f"{spread(list(halves[:, place]))}"
        )
        text = f"  ratio in pairs {spread(ratios)}, {len(ratios)} rounds"
        good &= is_reached(text, statistics.median(ratios), MAX_RATIO, "", doubt)
        other = spread(list(beside[:, place] / without[:, place]))
        beyond = spread(list(watched[:, place] / beside[:, place]))
        print(f"  other work of the same size: {other}; the page beyond it: {beyond}")
    return good


def main(rounds: int) -> int:
    """Measure, print, and return the exit status."""
    chromium = shutil.which("chromium")
    if chromium is None:
        print("not measured: install the Debian package chromium")
        return 1
    begin_s, load = time.monotonic(), os.getloadavg()[0]
    print(f"{os.cpu_count()} processors, load {load:.1f} before")
    if load > MAX_LOAD:
        print(f"The machine is not quiet (load above {MAX_LOAD:g}): the figures are doubtful.")
    print(f"one period into the feed: {feed_cost_us():.1f} us", flush=True)
    measured_rounds: list[tuple[Measured, Measured, Measured]] = []
    shares: dict[str, list[float]] = {}
    good = True
    with tempfile.TemporaryDirectory() as folder:
        for number in range(rounds):
            bare, live, other = (Path(folder) / f"{name}{number}.mcap" for name in ("bare", "live", "other"))
            if number % 2:
                watched = with_receivers(live)
                without = without_page(bare)
            else:
                without = without_page(bare)
                watched = with_receivers(live)
            measured_rounds.append((without, watched, beside_other_work(other, watched)))
            shares.setdefault(f"{VIEWERS} viewers that draw nothing", []).append(watched.share)
        good &= compare(measured_rounds)
        with sync_playwright() as playwright:
            for count in (1, VIEWERS):
                what = f"{count} browser{'s' if count > 1 else ''} on these processors"
                path = Path(folder) / f"browsers{count}.mcap"
                measured, delays_ms = with_browsers(playwright, chromium, path, count)
                shares.setdefault(what, []).append(measured.share)
                p50, p95 = (float(np.percentile(delays_ms, part)) for part in (50, 95))
                loop = ", ".join(
                    f"{name} {value:.0f} us"
                    for name, value in zip(NAMES, p99(measured.times_us), strict=True)
                )
                print(f"{what}: loop at p99: {loop}")
                text = f"from sampled to drawn, {what}: p50 {p50:.0f} ms, p95 {p95:.0f} ms"
                if count == 1:
                    good &= is_reached(text, p95, MAX_DELAY_MS, " ms")
                else:
                    print(f"{text}; no target: they take the processors from each other")
    for what, values in shares.items():
        median, largest = 100 * statistics.median(values), 100 * max(values)
        text = f"serving process, {what}: {median:.1f} % of a core (largest {largest:.1f} %)"
        good &= is_reached(text, median, 100 * MAX_PROCESSOR_SHARE, " %")
    print(f"load {os.getloadavg()[0]:.1f} after; {(time.monotonic() - begin_s) / 60:.1f} minutes")
    print("every target reached" if good else "a target was MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    if sys.argv[1:2] == ["--receive"]:
        receive(sys.argv[2])
    elif sys.argv[1:2] == ["--work"]:
        work(float(sys.argv[2]))
    else:
        sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS))
