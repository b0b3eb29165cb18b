"""The daemon under a client against the bare loop: lateness, response, and the time from request to effect.

Bare loop and daemon run in turns on simulated boards, so that the machine's load is in both. The last daemon
is attacked by random and hostile clients. ``--hostile-s 600`` attacks it for ten minutes.

Beside the attack, a witness sleeps for 2 ms again and again, on the loop's processor and at a higher
priority. If the witness is late while the loop misses a period, the machine is the cause: its host or its
kernel ran neither of them. Every other missed period is the gateway's.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_sim.boards.codec import data_identity, decode_values
from hil.core.errors import RequestRefusedError
from hil.core.life_cycle import LifeCycleState
from hil.core.requests import SetpointRequest
from hil.core.rig import read_rig
from hil.host.realtime_rights import FIFO_PRIORITY, real_time_rights
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
WITNESS_SLEEP_NS = 2_000_000
WITNESS_LATE_NS = 1_000_000
"""A witness that is later than this has seen the machine stall."""
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
                with contextlib.suppress(RequestRefusedError):  # in state fault, which the recording explains
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


def witness() -> None:
    """Print, after SIGTERM, the intervals in which this process should have run and did not, in ns."""
    stalls: list[tuple[int, int]] = []
    is_over = []
    signal.signal(signal.SIGTERM, lambda *_: is_over.append(True))
    with real_time_rights():
        with contextlib.suppress(OSError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY + 1))
        print("ready", flush=True)
        while not is_over:
            due_ns = time.monotonic_ns() + WITNESS_SLEEP_NS
            time.sleep(WITNESS_SLEEP_NS * 1e-9)
            woke_ns = time.monotonic_ns()
            if woke_ns - due_ns > WITNESS_LATE_NS:
                stalls.append((due_ns, woke_ns))
    print(json.dumps(stalls))


def major_page_faults(process_id: int) -> int:
    """Return how often a process had to wait for a page from the disk."""
    return int(Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()[9])


def stolen_s() -> float:
    """Return the processor time that the host has taken from this machine, in s."""
    return int(Path("/proc/stat").read_text().split()[8]) / os.sysconf("SC_CLK_TCK")


class Circumstances(NamedTuple):
    """What happened to the machine and to the loop's process during the attack."""

    stalls: list[tuple[int, int]]
    """Intervals in which the witness did not run, in monotonic ns."""
    page_faults: int
    stolen_s: float


def attacked_loop(path: Path, socket_path: Path, duration_s: float) -> Circumstances:
    """Attack a daemon beside a witness."""
    found: list[tuple[int, float]] = []

    def attack_and_watch(client: Client) -> list[int]:
        daemon_id = next(
            int(entry.name)
            for entry in Path("/proc").iterdir()
            if entry.name.isdecimal() and str(socket_path).encode() in command_of(entry)
        )
        faults, stolen = major_page_faults(daemon_id), stolen_s()
        attack(socket_path, duration_s)
        found.append((major_page_faults(daemon_id) - faults, stolen_s() - stolen))
        return []

    command = [sys.executable, __file__, "--witness"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as watching:
        assert watching.stdout is not None
        watching.stdout.readline()
        try:
            operated_loop(path, socket_path, attack_and_watch)
        finally:
            watching.terminate()
        stalls = [(due, woke) for due, woke in json.loads(watching.stdout.read())]
    return Circumstances(stalls, *found[0])


def command_of(process: Path) -> bytes:
    with contextlib.suppress(OSError):
        return (process / "cmdline").read_bytes()
    return b""


def missed_by_cause(path: Path, stalls: list[tuple[int, int]]) -> tuple[int, int]:
    """Return how many missed periods the machine caused, and how many the gateway."""
    timing = Recording(path).timing()
    late_ns = timing["wake_ns"] - timing["deadline_ns"]
    skipped = np.diff(timing["number"], prepend=timing["number"][:1]) > 1
    machine = gateway = 0
    for wake_ns in timing["wake_ns"][skipped | (late_ns > PERIOD_NS // 2)]:
        begin_ns, end_ns = wake_ns - 2 * PERIOD_NS, wake_ns + WITNESS_LATE_NS
        if any(due < end_ns and woke > begin_ns for due, woke in stalls):
            machine += 1
        else:
            gateway += 1
    return machine, gateway


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
    options.add_argument("--rounds", type=int, default=ROUNDS, help="runs before the attack (default 3)")
    options.add_argument("--witness", action="store_true", help="be the witness")
    chosen = options.parse_args()
    if chosen.witness:
        witness()
        return 0
    hostile_s, rounds = chosen.hostile_s, range(chosen.rounds)
    with tempfile.TemporaryDirectory() as name:
        folder, socket_path = Path(name), Path(name) / "d.sock"
        for number in rounds:
            bare_loop(folder / f"bare{number}.mcap")
            bare.append(lateness_and_response(folder / f"bare{number}.mcap"))
            path = folder / f"daemon{number}.mcap"
            asked_ns = operated_loop(path, socket_path, drive)
            operated.append(lateness_and_response(path))
            periods += periods_to_effect(path, asked_ns)
        path = folder / "hostile.mcap"
        circumstances = attacked_loop(path, socket_path, hostile_s)
        late_us, response_us = lateness_and_response(path)
        missed = missed_periods(path)
        fault = Recording(path).metadata["ending"]["fault"] or "none"
        by_machine, by_gateway = missed_by_cause(path, circumstances.stalls)
        missed_bare = sum(missed_periods(folder / f"bare{number}.mcap") for number in rounds)
        missed_operated = sum(missed_periods(folder / f"daemon{number}.mcap") for number in rounds)
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
        f"fault: {fault}; late or skipped periods while the machine stalled {by_machine}, others "
        f"{by_gateway}, target 0; "
        f"stalls of the witness over 1 ms: {len(circumstances.stalls)}; time stolen by the host "
        f"{circumstances.stolen_s:.1f} s; major page faults of the loop {circumstances.page_faults}"
    )
    print(
        f"missed periods of {len(rounds)} runs of {RUN_S:g} s: bare loop {missed_bare}, daemon with "
        f"{REQUESTS_PER_S} requests/s {missed_operated}"
    )
    worst = max(periods)
    print(
        f"request to effect: median {statistics.median(periods):.2f}, worst {worst:.2f} periods of "
        f"{len(periods)}; target {MAX_PERIODS:g}"
    )
    return 0 if max(ratios) <= MAX_RATIO and worst <= MAX_PERIODS and outside == by_gateway == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
