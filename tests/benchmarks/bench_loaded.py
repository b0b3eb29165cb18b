"""The loop on a loaded machine: missed periods and faults beside busy loops, and beside builds and installs.

    python tests/benchmarks/bench_loaded.py [--duration 15] [--rounds 2]

The loads are made here, without a network: ``busy`` keeps every processor busy; ``build`` compiles C and
Python; ``install`` unpacks thousands of files and forces each to the disk, as a package installer does. Each
run of the gateway is followed by a bare loop with the same rights and period beside the same load. What the
bare loop misses too, the machine has caused. The runs use the default bus (UDP) and, in user-mode Linux,
vcan0 with the boards in a process of their own, once with the recording on the disk and once in memory.

Exit status 1: the gateway faulted, or missed periods, while the bare loop missed none.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hil.host.realtime_rights import real_time_rights
from hil.recording.reader import Recording

HIL = [sys.executable, "-m", "hil.cli"]
PERIOD_NS = 11_200_000
VCAN = "vcan0"
MEMORY = "/dev/shm"

BUSY = "while True: pass"
BUILD = """
import compileall, os, shutil, subprocess, sys, json
while True:
    shutil.copytree(os.path.dirname(json.__file__), 'sources', dirs_exist_ok=True)
    compileall.compile_dir('sources', force=True, quiet=2)
    lines = [f'int f{n}(int x) {{ return x * {n} + (x >> {n % 31}); }}' for n in range(20000)]
    open('source.c', 'w').write(chr(10).join(lines))
    subprocess.run(['gcc', '-O2', '-c', 'source.c', '-o', 'object.o'], check=True)
"""
INSTALL = """
import os, shutil
content = os.urandom(40_000)
while True:
    for number in range(3000):
        os.makedirs(f'tree/{number % 50}', exist_ok=True)
        with open(f'tree/{number % 50}/{number}', 'wb') as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    with open('archive', 'wb') as file:
        for _ in range(5000): file.write(content)
        os.fsync(file.fileno())
    shutil.rmtree('tree')
"""
LOADS: dict[str, list[str]] = {
    "no load": [],
    "busy": [BUSY] * 2 * (os.cpu_count() or 1),
    "build": [BUILD] * 2,
    "install": [INSTALL] * 2,
    "build and install": [BUILD, BUILD, INSTALL, INSTALL],
}
"""Programs of each load."""


class Result(NamedTuple):
    """What one run of the gateway and of the bare loop showed."""

    ending: str
    """Reason of the ending; with the fault, if there was one."""
    missed: int
    lost: int
    """Periods without a good sample."""
    late_us: tuple[float, float]
    """Lateness of the loop, p99 and largest."""
    response_us: tuple[float, float]
    """Time from SYNC to command, p99 and largest."""
    bare_missed: int
    """Periods that began more than half a period late in the bare loop."""
    bare_late_us: tuple[float, float]


@contextlib.contextmanager
def load(programs: list[str]) -> Iterator[None]:
    """Run programs, each in a folder of its own on the disk."""
    with tempfile.TemporaryDirectory(dir=".", prefix="load-") as folder:
        started = []
        try:
            for number, program in enumerate(programs):
                place = Path(folder) / str(number)
                place.mkdir()
                process = subprocess.Popen(
                    [sys.executable, "-c", program],
                    cwd=place,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )
                started.append(process)
            yield
        finally:
            for process in started:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def worst(nanoseconds: np.ndarray) -> tuple[float, float]:
    """Return p99 and the largest of times in ns, in us."""
    return float(np.percentile(nanoseconds, 99)) * 1e-3, float(nanoseconds.max()) * 1e-3


def bare_loop(duration_s: float) -> np.ndarray:
    """Return how late a loop was that only sleeps, with the rights of the gateway's loop, in ns."""
    late_ns = []
    with real_time_rights():
        deadline_ns = time.monotonic_ns()
        for _ in range(round(duration_s * 1e9 / PERIOD_NS)):
            deadline_ns += PERIOD_NS
            time.sleep(max(deadline_ns - time.monotonic_ns(), 0) * 1e-9)
            late_ns.append(time.monotonic_ns() - deadline_ns)
            deadline_ns += late_ns[-1] // PERIOD_NS * PERIOD_NS
    return np.array(late_ns)


def gateway_run(path: Path, bus: str, duration_s: float) -> Recording:
    """Run the gateway, on vcan0 with the boards in a process of their own, and return its recording."""
    command = [*HIL, "run", "--duration", str(duration_s), "--record", str(path)]
    with contextlib.ExitStack() as stack:
        if bus == VCAN:
            boards = [sys.executable, "-m", "firmware_sim", "--bus", bus]
            started = stack.enter_context(subprocess.Popen(boards, stdout=subprocess.PIPE))
            stack.callback(started.terminate)
            assert started.stdout is not None
            started.stdout.readline()
            command += ["--bus", bus]
        subprocess.run(command, capture_output=True)
    return Recording(path)


def measure(bus: str, duration_s: float, records_into: str) -> Result:
    """Run the gateway, then the bare loop."""
    with tempfile.TemporaryDirectory(dir=records_into, prefix="loaded-") as folder:
        run = gateway_run(Path(folder) / "run.mcap", bus, duration_s)
    bare_ns = bare_loop(duration_s)
    ending, timing = run.metadata["ending"], run.timing()
    running = timing[timing["running"]]
    return Result(
        ending["reason"] + (f": {ending['fault']}" if ending["fault"] else ""),
        int(ending["missed periods"]),
        int((~running["fresh"]).sum()),
        worst(timing["wake_ns"] - timing["deadline_ns"]),
        worst((timing["sent_ns"] - timing["wake_ns"])[timing["fresh"]]),
        int((bare_ns > PERIOD_NS // 2).sum()),
        worst(bare_ns),
    )


def measure_in_guest(duration_s: float, records_into: str) -> Result | None:
    """Measure on vcan0, in user-mode Linux if this kernel has none. None if that is not possible."""
    inner = [sys.executable, __file__, "--inner", records_into, "--duration", str(duration_s)]
    done = subprocess.run([*HIL, "vcan", "--", *inner], capture_output=True, text=True)
    if done.returncode != 0:
        print(done.stderr.strip()[-500:])
        return None
    return Result(*json.loads(done.stdout.strip().splitlines()[-1]))


def show(name: str, result: Result) -> None:
    """Print one line."""
    print(
        f"{name:42} missed {result.missed:3}, without sample {result.lost:3}, late p99/max "
        f"{result.late_us[0]:6.0f}/{result.late_us[1]:6.0f} us, response {result.response_us[0]:6.0f}/"
        f"{result.response_us[1]:6.0f} us; bare loop missed {result.bare_missed:3}, late "
        f"{result.bare_late_us[0]:6.0f}/{result.bare_late_us[1]:6.0f} us; {result.ending}",
        flush=True,
    )


def is_to_blame(result: Result) -> bool:
    """Return whether the gateway faulted or missed periods, and the bare loop missed none."""
    return result.bare_missed == 0 and (result.missed > 0 or not result.ending.startswith("completed"))


def main() -> int:
    """Measure every load on both buses."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--duration", type=float, default=15.0, help="seconds of each run (default 15)")
    parser.add_argument("--rounds", type=int, default=2, help="runs of each kind (default 2)")
    parser.add_argument("--only", choices=["udp", "vcan"], help="measure on this bus only")
    parser.add_argument("--loads", nargs="+", choices=LOADS, default=list(LOADS), help="loads (default all)")
    parser.add_argument("--inner", metavar="FOLDER", help="measure on vcan0 of this kernel, and print JSON")
    options = parser.parse_args()
    if options.inner:
        print(json.dumps(measure(VCAN, options.duration, options.inner)))
        return 0
    places = {"on disk": ".", "in memory": MEMORY}
    blamed = 0
    for name in options.loads:
        for _ in range(options.rounds):
            with load(LOADS[name]):
                results: dict[str, Result | None] = {}
                if options.only != "vcan":
                    results["UDP"] = measure("sim", options.duration, ".")
                if options.only != "udp":
                    for place, folder in places.items():
                        results[f"vcan, {place}"] = measure_in_guest(options.duration, folder)
            for bus, result in results.items():
                if result is not None:
                    show(f"{name}, {bus}", result)
                    blamed += is_to_blame(result)
    print(f"runs that faulted or missed periods beside a bare loop that missed none: {blamed}, target 0")
    return 1 if blamed else 0


if __name__ == "__main__":
    sys.exit(main())
