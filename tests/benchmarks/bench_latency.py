"""How late SYNC leaves, beside cyclictest; how fast a command answers SYNC, beside a bare python-can echo.

    python tests/benchmarks/bench_latency.py

Each figure is the median over rounds that alternate with the peer's, because other work on the machine comes
and goes. The loop and the peer have the same rights and the same period. Exit status 1 means that a target
was missed, 2 that cyclictest is absent (Debian package rt-tests).

The response is measured on ``vcan0``. Where the kernel has none, ``hil vcan`` starts user-mode Linux: one
processor, on which every system call takes 30 to 60 us, also for the peer. There the recorder, the display
and the boards take their time from the loop. The same is therefore measured on the UDP bus of this host too.
The boards simulate eq. (15), because the arm's 0.1 ms a period are not the gateway's.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import can
import numpy as np
from numpy.typing import NDArray

from firmware_sim.cli import BOARDS_PRIORITY
from hil.core.wire import codec
from hil.host.realtime_rights import FIFO_PRIORITY, real_time_rights
from hil.links.host_multicast import HostMulticastBus
from hil.recording.reader import Recording

PERIOD_S = 0.0112
ROUNDS = 5
ATTEMPTS = 3
LATENESS_S = 6.0
RESPONSE_S = 4.0
QUANTILES = (50, 99)
LATENESS_TARGETS = {50: 1.0, 99: 1.2}
"""Largest lateness of SYNC as a multiple of cyclictest's, by quantile in per cent."""
RESPONSE_TARGET = 1.3
"""Largest time from SYNC to command as a multiple of the echo's round trip."""
UDP_PORT = 45113
LINEAR = [
    "--linear", "--controller", "vertical=ppid", "--controller", "horizontal=ppid",
    "--controller", "rotation=ppid_rad",
]  # fmt: skip
HIL = [sys.executable, "-m", "hil.cli"]
VCAN = "vcan0"

Quantiles = dict[int, float]
"""Microseconds by quantile in per cent."""


def quantiles(nanoseconds: NDArray[np.int64]) -> Quantiles:
    """Return the quantiles of times in nanoseconds."""
    return {q: float(np.percentile(nanoseconds, q)) * 1e-3 for q in QUANTILES}


def medians(rounds: list[Quantiles]) -> Quantiles:
    """Return the median over the rounds, for each quantile."""
    return {q: median(one[q] for one in rounds) for q in QUANTILES}


def alternate(ours: Callable[[], Quantiles], theirs: Callable[[], Quantiles]) -> tuple[Quantiles, Quantiles]:
    """Measure both by turns, and return the medians over the rounds."""
    pairs = [(ours(), theirs()) for _ in range(ROUNDS)]
    return medians([pair[0] for pair in pairs]), medians([pair[1] for pair in pairs])


def show(name: str, figures: Quantiles) -> None:
    """Print one line of figures."""
    print(f"{name:38}" + "  ".join(f"p{q} {figures[q]:7.1f} us" for q in QUANTILES))


def meets(ours: Quantiles, theirs: Quantiles, targets: dict[int, float]) -> bool:
    """Print each ratio beside its target. Return False if one is missed."""
    is_met = True
    for q, target in targets.items():
        ratio = ours[q] / theirs[q]
        verdict = "met" if ratio <= target else "MISSED"
        print(f"  p{q}: {ratio:.2f} times the peer's, target at most {target:g}: {verdict}")
        is_met = is_met and ratio <= target
    return is_met


# Lateness


def recorded_run(folder: Path, duration_s: float, arguments: list[str]) -> Recording:
    """Run ``hil run`` and return its recording. A run that other work on the machine ends is repeated."""
    for _ in range(ATTEMPTS):
        path = Path(tempfile.mkdtemp(dir=folder)) / "run.mcap"
        command = [*HIL, "run", "--duration", str(duration_s), "--record", str(path), *arguments]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode == 0:
            return Recording(path)
        print("a run ended early and is repeated:", done.stderr.strip().splitlines()[-1:])
    sys.exit(f"{ATTEMPTS} runs in a row ended early; is the machine too busy?")


def sync_lateness(folder: Path, handed_over: list[Quantiles]) -> Quantiles:
    """Return how late the loop was at its deadlines. Adds to ``handed_over`` when the bus had taken SYNC."""
    run = recorded_run(folder, LATENESS_S, [])
    timing = run.timing()
    sync_ns = run.frames("sent", codec.SYNC).time_ns
    place = np.searchsorted(timing["wake_ns"], sync_ns, side="right") - 1
    is_known = (place >= 0) & (place < len(timing) - 1)
    sent_late_ns = sync_ns[is_known] - timing["deadline_ns"][place[is_known]]
    handed_over.append(quantiles(sent_late_ns[sent_late_ns < PERIOD_S * 0.5e9]))
    return quantiles(timing["wake_ns"] - timing["deadline_ns"])


def cyclictest() -> Quantiles:
    """Return how late cyclictest was, with the loop's priority and period on the loop's processor."""
    processor = max(os.sched_getaffinity(0))
    count = round(LATENESS_S / PERIOD_S)
    command = ["cyclictest", "--quiet", "--mlockall", "--threads=1", f"--affinity={processor}"]
    command += [f"--priority={FIFO_PRIORITY}", f"--interval={PERIOD_S * 1e6:.0f}", f"--loops={count}"]
    done = subprocess.run([*command, "--histogram=20000"], check=True, capture_output=True, text=True)
    lines = re.findall(r"^(\d+)\s+(\d+)$", done.stdout, re.MULTILINE)
    late_us = np.repeat([int(us) for us, _ in lines], [int(times) for _, times in lines])
    return quantiles(late_us * 1000)


def bench_lateness() -> int:
    """Return 0 if the targets are met, 1 if one is missed, 2 if cyclictest is absent."""
    print(f"lateness at a period of {1e3 * PERIOD_S:g} ms, medians of {ROUNDS} alternating runs")
    if shutil.which("cyclictest") is None:
        print("cyclictest is absent, so there is no peer: sudo apt-get install rt-tests")
        return 2
    handed_over: list[Quantiles] = []
    with tempfile.TemporaryDirectory() as name:
        ours, theirs = alternate(lambda: sync_lateness(Path(name), handed_over), cyclictest)
    show("hil run, loop at the deadline", ours)
    show("hil run, SYNC taken by the bus", medians(handed_over))
    show("cyclictest", theirs)
    return 0 if meets(ours, theirs, LATENESS_TARGETS) else 1


# Response


PARTS = {
    "SYNC sent, boards answer, wake-up": ("wake_ns", "receive_ns"),
    "guard, control, encoding": ("receive_ns", "computed_ns"),
    "command sent": ("computed_ns", "sent_ns"),
}
"""Parts of the response, by the instants of the recording between which they lie."""


def sync_to_command(folder: Path, bus: str, parts: dict[str, list[Quantiles]]) -> Quantiles:
    """Return the times from SYNC to the command that answers its sample, with simulated boards on ``bus``.

    Adds to ``parts`` the times of each part of the response.
    """
    if bus != VCAN:
        timing = recorded_run(folder, RESPONSE_S, LINEAR).timing()
    else:
        boards = [sys.executable, "-m", "firmware_sim", "--linear", "--bus", bus]
        with subprocess.Popen(boards, stdout=subprocess.PIPE) as started:
            assert started.stdout is not None
            started.stdout.readline()
            timing = recorded_run(folder, RESPONSE_S, [*LINEAR[1:], "--bus", bus]).timing()
            started.terminate()
    timing = timing[timing["fresh"]]
    for name, (begin, end) in PARTS.items():
        parts.setdefault(name, []).append(quantiles(timing[end] - timing[begin]))
    return quantiles(timing["sent_ns"] - timing["wake_ns"])


def open_bus(bus: str) -> can.BusABC:
    """Open a bus of python-can: vcan0, or UDP multicast inside this host with a port number."""
    return can.Bus(bus, interface="socketcan") if bus == VCAN else HostMulticastBus(int(bus))


def round_trip_ns(bus: can.BusABC) -> int:
    """Send a frame and wait for the partner's answer. Return the time in nanoseconds."""
    began_ns = time.monotonic_ns()
    bus.send(can.Message(arbitration_id=codec.SYNC, is_extended_id=False))
    while True:
        received = bus.recv(1.0)
        assert received is not None, "the partner did not answer"
        if received.arbitration_id == codec.TPDO1_ADC:
            return time.monotonic_ns() - began_ns


def echo_round_trip(bus: str) -> Quantiles:
    """Return the round trips of a frame to another process and back, both with python-can alone."""
    partner_command = [sys.executable, __file__, "--echo", bus]
    with subprocess.Popen(partner_command, stdout=subprocess.PIPE) as partner:
        assert partner.stdout is not None
        partner.stdout.readline()
        round_trips_ns = []
        with open_bus(bus) as opened, real_time_rights():
            deadline_ns = time.monotonic_ns()
            for _ in range(round(RESPONSE_S / PERIOD_S)):
                deadline_ns += round(PERIOD_S * 1e9)
                time.sleep(max(deadline_ns - time.monotonic_ns(), 0) * 1e-9)
                round_trips_ns.append(round_trip_ns(opened))
        partner.terminate()
    return quantiles(np.array(round_trips_ns))


def echo(bus: str) -> None:
    """Answer each SYNC with a frame of eight bytes, at the priority of the simulated boards."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(BOARDS_PRIORITY))
    with open_bus(bus) as opened:
        print("ready", flush=True)
        answer = can.Message(arbitration_id=codec.TPDO1_ADC, data=bytes(8), is_extended_id=False)
        while True:
            received = opened.recv()
            if received is not None and received.arbitration_id == codec.SYNC:
                opened.send(answer)


def bench_response(bus: str, name: str) -> int:
    """Measure on ``bus``, vcan0 or a UDP port. Return 0 if the target is met, else 1."""
    print(f"response on {name}, medians of {ROUNDS} alternating runs")
    parts: dict[str, list[Quantiles]] = {}
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = alternate(
            lambda: sync_to_command(Path(folder), bus, parts), lambda: echo_round_trip(bus)
        )
    show("hil run, SYNC to command", ours)
    for part, rounds in parts.items():
        show(f"  {part}", medians(rounds))
    show("python-can echo, there and back", theirs)
    return 0 if meets(ours, theirs, dict.fromkeys(QUANTILES, RESPONSE_TARGET)) else 1


def main() -> int:
    """Measure lateness here, and the response where vcan0 exists."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--echo", metavar="BUS", help="be the partner of the echo")
    parser.add_argument("--response", action="store_true", help="measure the response on vcan0 only")
    options = parser.parse_args()
    if options.echo:
        echo(options.echo)
    if options.response:
        return bench_response(VCAN, VCAN)
    statuses = [bench_lateness(), bench_response(str(UDP_PORT), "the UDP bus of this host")]
    sys.stdout.flush()
    on_vcan = [*HIL, "vcan", "--", sys.executable, __file__, "--response"]
    return max(*statuses, subprocess.run(on_vcan).returncode)


if __name__ == "__main__":
    sys.exit(main())
