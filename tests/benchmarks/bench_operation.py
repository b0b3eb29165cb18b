"""The daemon under a client against the bare loop: lateness, response, and the time from request to effect.

Bare loop and daemon run in turns on simulated boards, so that the machine's load is in both. The last daemon
is attacked by random and hostile clients. ``--hostile-s 600`` attacks it for ten minutes.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_sim.boards.codec import data_identity, decode_values
from hil.core.life_cycle import LifeCycleState
from hil.core.requests import SetpointRequest
from hil.core.rig import read_rig
from hil.operation.client import Client, connect
from hil.recording.entries import FrameSent, Operated
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
MAX_STRETCH = 2.0
"""A command may follow the one before after two periods, if a sample was lost between them."""

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


def operated_loop(path: Path, socket_path: Path, drive: Callable[[Client], list[int]]) -> list[int]:
    """Run a daemon under a client. Return the times at which steps were asked for, in monotonic ns."""
    command = [*HIL, "daemon", "--socket", str(socket_path), "--record", str(path)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as daemon:
        try:
            with ready_client(socket_path) as client:
                client.arm()
                client.start()
                asked_ns = drive(client)
                client.stop()
                client.shutdown()
        except BaseException:
            daemon.kill()
            raise
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


def attack(socket_path: Path, duration_s: float) -> list[int]:
    """Send random bytes, floods of requests, endless lines, and connect without end. Read nothing."""
    draw = random.Random(1)
    flood = b'{"request": "setpoint", "axis": "vertical", "setpoint": "step:0.1@0"}\n' * 200
    jogs = b'{"request": "jog", "axis": "rotation", "offset_v": 1.0, "duration_s": 0.5}\n' * 200
    watch = b'{"request": "watch", "interval_s": 0.05}\n'
    open_ones: list[socket.socket] = []
    end_s = time.monotonic() + duration_s
    while time.monotonic() < end_s:
        if len(open_ones) >= 32:
            open_ones.pop(draw.randrange(len(open_ones))).close()
        with contextlib.suppress(OSError):
            connection = socket.socket(socket.AF_UNIX)
            connection.settimeout(0.1)
            connection.connect(str(socket_path))
            connection.setblocking(False)
            open_ones.append(connection)
        for connection in draw.sample(open_ones, min(len(open_ones), 4)):
            data = draw.choice((draw.randbytes(5000) + b"\n", flood, jogs, watch, b"x" * 300_000))
            with contextlib.suppress(OSError):
                connection.send(data)
        time.sleep(0.002)
    for connection in open_ones:
        connection.close()
    return []


def commands_outside_limits(path: Path) -> int:
    """Count the commands outside magnitude or rate limit, decoded by the simulated boards' own code."""
    recording = Recording(path)
    rig = read_rig(recording.attachments["rig.toml"].decode(), "rig.toml")
    valves = [axis.valve for axis in rig.axes.values()]
    identity = data_identity(0x220, rig.bus.wire_version)
    volts = [
        [10.0 * counts / 2**15 for counts in decode_values(entry.frame.data, True, identity).counts]
        for entry in recording.entries()
        if isinstance(entry, FrameSent) and entry.frame.id == 0x220
    ]
    outside = 0
    for before, after in pairwise(volts):
        for valve, one, other in zip(valves, before, after, strict=True):
            step_v = valve.max_rate_v_s * rig.loop.period_s * MAX_STRETCH
            is_centred = abs(other - valve.centre_v) < 0.001
            outside += not valve.min_v <= other <= valve.max_v
            outside += not is_centred and abs(other - one) > step_v
    return outside


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


def missed_periods(path: Path) -> int:
    return int(Recording(path).metadata["ending"]["missed periods"])


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
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--hostile-s", type=float, default=10.0, help="duration of the attack in seconds")
    hostile_s = options.parse_args().hostile_s
    with tempfile.TemporaryDirectory() as name:
        folder, socket_path = Path(name), Path(name) / "d.sock"
        for number in range(ROUNDS):
            bare_loop(folder / f"bare{number}.mcap")
            bare.append(lateness_and_response(folder / f"bare{number}.mcap"))
            path = folder / f"daemon{number}.mcap"
            asked_ns = operated_loop(path, socket_path, drive)
            operated.append(lateness_and_response(path))
            periods += periods_to_effect(path, asked_ns)
        path = folder / "hostile.mcap"
        operated_loop(path, socket_path, lambda _client: attack(socket_path, hostile_s))
        late_us, response_us = lateness_and_response(path)
        missed = missed_periods(path)
        missed_bare = sum(missed_periods(folder / f"bare{number}.mcap") for number in range(ROUNDS))
        missed_operated = sum(missed_periods(folder / f"daemon{number}.mcap") for number in range(ROUNDS))
        outside = commands_outside_limits(path)
    ratios = [
        percentiles(
            text,
            np.concatenate([one[place] for one in bare]),
            np.concatenate([one[place] for one in operated]),
        )
        for place, text in enumerate(("lateness of SYNC", "SYNC to command"))
    ]
    print(
        f"under attack for {hostile_s:g} s: lateness p50 {np.percentile(late_us, 50):.0f}, p99 "
        f"{np.percentile(late_us, 99):.0f} us; SYNC to command p99 {np.percentile(response_us, 99):.0f} us; "
        f"missed periods {missed}; commands outside limits {outside} of {len(late_us)}"
    )
    print(
        f"missed periods of {ROUNDS} runs of {RUN_S:g} s: bare loop {missed_bare}, daemon with "
        f"{REQUESTS_PER_S} requests/s {missed_operated}"
    )
    worst = max(periods)
    print(
        f"request to effect: median {statistics.median(periods):.2f}, worst {worst:.2f} periods of "
        f"{len(periods)}; target {MAX_PERIODS:g}"
    )
    return 0 if max(ratios) <= MAX_RATIO and worst <= MAX_PERIODS and outside == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
