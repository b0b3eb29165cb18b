"""The live page: what it costs the loop and the serving process, and the time from sampled to drawn.

    python tests/benchmarks/bench_live.py

Runs of 20 s alternate without the page and with three viewers in a headless Chromium. Exit status 1: a target
was missed. The browser draws without a graphics card here, and shares the processors with the loop.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

import hil
from hil.views.summary import summarise

ROUNDS = 3
DURATION_S = 20
VIEWERS = 3
MAX_RATIO = 1.05
MAX_PROCESSOR_SHARE = 0.10
MAX_DELAY_MS = 100.0


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


@contextmanager
def running(path: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Start a run, and wait for its end."""
    command = [sys.executable, "-m", "hil.cli", "run", "--duration", str(DURATION_S), "--record", str(path)]
    with subprocess.Popen(
        [*command, *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        yield process
        assert process.stdout is not None
        process.stdout.read()


def timing(path: Path) -> tuple[float, float]:
    """Return lateness and response at p99 in microseconds."""
    summary = summarise(hil.open_recording(path))
    assert summary.lateness is not None and summary.response is not None
    return summary.lateness.p99_us, summary.response.p99_us


def with_viewers(browser: Browser, path: Path) -> tuple[float, list[float]]:
    """Run with viewers; return the serving process' share of a processor, and the delays in ms."""
    with running(path, "--live") as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip().removeprefix("page: ")
        pages = [browser.new_page(viewport={"width": 1280, "height": 900}) for _ in range(VIEWERS)]
        for page in pages:
            page.goto(address)
        server = serving_process(process)
        pages[0].wait_for_timeout(3000)
        before_s = processor_s(server)
        pages[0].wait_for_timeout(10_000)
        share = (processor_s(server) - before_s) / 10.0
        delays = pages[-1].evaluate("hilLive.delays_ms.slice(-150)")
        for page in pages:
            page.close()
    return share, delays


def main() -> int:
    """Measure, print, and return the exit status."""
    chromium = shutil.which("chromium")
    if chromium is None:
        print("not measured: install the Debian package chromium")
        return 1
    bare: list[tuple[float, float]] = []
    shown: list[tuple[float, float]] = []
    shares: list[float] = []
    delays: list[float] = []
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        for number in range(ROUNDS):
            path = Path(folder) / f"bare{number}.mcap"
            with running(path):
                pass
            bare.append(timing(path))
            path = Path(folder) / f"live{number}.mcap"
            share, of_page = with_viewers(browser, path)
            shown.append(timing(path))
            shares.append(share)
            delays += of_page
        browser.close()
    good = True
    for place, what in enumerate(("lateness", "response")):
        without = statistics.median(values[place] for values in bare)
        with_page = statistics.median(values[place] for values in shown)
        ratio = with_page / without
        good &= ratio <= MAX_RATIO
        print(f"{what} p99: {without:.0f} us without, {with_page:.0f} us with {VIEWERS} viewers", end=", ")
        print(f"ratio {ratio:.2f}, target {MAX_RATIO:g}")
    share = statistics.median(shares)
    p95 = sorted(delays)[int(0.95 * len(delays))]
    print(f"serving process: {100 * share:.1f} % of a core, target {100 * MAX_PROCESSOR_SHARE:g} %")
    print(f"from sampled to drawn: p95 {p95:.0f} ms, target {MAX_DELAY_MS:g} ms")
    good &= share <= MAX_PROCESSOR_SHARE and p95 <= MAX_DELAY_MS
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
