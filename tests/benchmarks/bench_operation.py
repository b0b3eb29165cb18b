"""The daemon under a client against the bare loop: lateness, response, and the time from request to effect.

Bare loop and daemon run in turns on simulated boards, so that the machine's load is in both.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hil.core.life_cycle import LifeCycleState
from hil.core.requests import SetpointRequest
from hil.operation.client import Client, connect
from hil.recording.entries import Operated
from hil.recording.reader import Recording

HIL = [sys.executable, "-m", "hil.cli"]
PERIOD_NS = 11_200_000
ROUNDS = 3
RUN_S = 10.0
REQUESTS_PER_S = 100
STEP_REQUESTS = 50
"""One request of so many is a step of the vertical axis, whose effect is looked for."""
MAX_RATIO = 1.10
MAX_PERIODS = 2.0

Times = NDArray[np.float64]


def lateness_and_response(path: Path) -> tuple[Times, Times]:
    """Return lateness of SYNC, and time from SYNC to command, in us, in state running."""
    timing = Recording(path).timing()
    running = timing[(timing["state"] == LifeCycleState.RUNNING) & timing["fresh"]]
    return (running["wake_ns"] - running["deadline_ns"]) * 1e-3, (
        running["sent_ns"] - running["wake_ns"]
    ) * 1e-3


def bare_loop(path: Path) -> None:
    holds = [f"--setpoint={axis}=hold" for axis in ("vertical", "horizontal", "rotation")]
    command = [*HIL, "run", "--duration", str(RUN_S), "--record", str(path), *holds]
    subprocess.run(command, check=True, capture_output=True)


def operated_loop(path: Path, socket_path: Path) -> list[int]:
    """Run a daemon under a client. Return the times at which steps were asked for, in monotonic ns."""
    command = [*HIL, "daemon", "--socket", str(socket_path), "--record", str(path)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as daemon:
        with ready_client(socket_path) as client:
            client.arm()
            client.start()
            asked_ns = drive(client)
            client.stop()
            client.shutdown()
        assert daemon.wait() == 0
    return asked_ns


def ready_client(socket_path: Path) -> Client:
    while not socket_path.exists():
        time.sleep(0.01)
    client = connect(socket_path)
    for look in client.watch(0.05):
        if look.state == "ready":
            break
    return client


def drive(client: Client) -> list[int]:
    """Send ``REQUESTS_PER_S`` requests a second that the loop must take."""
    asked_ns = []
    begin_s = time.monotonic()
    for number in range(round(RUN_S * REQUESTS_PER_S)):
        time.sleep(max(begin_s + number / REQUESTS_PER_S - time.monotonic(), 0.0))
        if number % STEP_REQUESTS == 0:
            asked_ns.append(time.monotonic_ns())
            client.set_setpoint("vertical", 0.02 if len(asked_ns) % 2 else -0.02)
        else:
            client.set_setpoint("rotation", 0.1)
    return asked_ns


def periods_to_effect(path: Path, asked_ns: list[int]) -> list[float]:
    """Return the periods from each step's request to the first command that follows the new setpoint.

    A changed setpoint begins at rest where the old one was, so that this command is near the one before.
    """
    recording = Recording(path)
    timing = recording.timing()
    steps = [
        entry
        for entry in recording.entries()
        if isinstance(entry, Operated)
        and isinstance(entry.request, SetpointRequest)
        and entry.request.axis == "vertical"
    ]
    assert len(steps) == len(asked_ns)
    sent_ns = timing["sent_ns"]
    found = []
    for sent, step in zip(asked_ns, steps, strict=True):
        after = np.flatnonzero((timing["wake_ns"] > step.now_ns) & timing["fresh"])
        found.append((sent_ns[after[0]] - sent) / PERIOD_NS)
    return found


def percentiles(name: str, bare: Times, operated: Times) -> float:
    """Print p50 and p99 of both, and return the ratio at p99."""
    (bare_50, bare_99), (our_50, our_99) = (np.percentile(times, (50, 99)) for times in (bare, operated))
    ratio = our_99 / bare_99
    print(
        f"{name}: bare loop p50 {bare_50:.0f}, p99 {bare_99:.0f} us; daemon with {REQUESTS_PER_S} requests/s "
        f"p50 {our_50:.0f}, p99 {our_99:.0f} us; ratio at p99 {ratio:.2f}, target {MAX_RATIO:.2f}"
    )
    return float(ratio)


def main() -> int:
    """Print the figures. Return 1 if a target is missed."""
    bare: list[tuple[Times, Times]] = []
    operated: list[tuple[Times, Times]] = []
    periods: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(ROUNDS):
            bare_loop(folder / f"bare{number}.mcap")
            bare.append(lateness_and_response(folder / f"bare{number}.mcap"))
            path = folder / f"daemon{number}.mcap"
            asked_ns = operated_loop(path, folder / "d.sock")
            operated.append(lateness_and_response(path))
            periods += periods_to_effect(path, asked_ns)
    ratios = [
        percentiles(
            text,
            np.concatenate([one[place] for one in bare]),
            np.concatenate([one[place] for one in operated]),
        )
        for place, text in enumerate(("lateness of SYNC", "SYNC to command"))
    ]
    worst = max(periods)
    print(
        f"request to effect: median {statistics.median(periods):.2f}, worst {worst:.2f} periods of "
        f"{len(periods)}; target {MAX_PERIODS:g}"
    )
    return 0 if max(ratios) <= MAX_RATIO and worst <= MAX_PERIODS else 1


if __name__ == "__main__":
    sys.exit(main())
