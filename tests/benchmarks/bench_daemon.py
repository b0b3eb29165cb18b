"""The daemon's speed: codec against cantools, lockstep against real time, punctuality against python-can.

Every ratio is of figures measured in this same run; the machine's load is in both.
"""

from __future__ import annotations

import argparse
import gc
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import can
import cantools
import numpy as np
from can.interfaces.virtual import VirtualBus
from numpy.typing import NDArray

from hil.cli.launch import run_lockstep, run_realtime
from hil.cli.run import parser
from hil.core.wire import codec
from hil.recording.reader import Recording
from hil.shells.run_plan import RunPlan
from hil.shells.run_setup import load_setup

PERIOD_S = 0.0112
LOCKSTEP_S = 300.0
REAL_TIME_S = 10.0
START_UPS = 5
CONTROLLERS = {"vertical": "ppid", "horizontal": "ppid", "rotation": "ppid_rad"}


def microseconds(function: Callable[[], object], repeats: int) -> float:
    """Least of five means."""
    means = []
    for _ in range(5):
        began = time.perf_counter()
        for _ in range(repeats):
            function()
        means.append((time.perf_counter() - began) / repeats)
    return min(means) * 1e6


def bench_codec() -> None:
    database = cantools.database.load_file(str(files("hil.core.wire") / "arm.dbc"))
    data = codec.encode_tpdo1_adc(1.0, 5.0, 9.0, 7, 99)
    message = database.get_message_by_name("RPDO1_DAC")
    values = {"Valve1": 1.0, "Valve2": 5.0, "Valve3": 9.0, "Counter": 7, "Crc8": 99}
    for name, ours, peer in (
        (
            "decode TPDO1_ADC",
            lambda: codec.decode_tpdo1_adc(data),
            lambda: database.decode_message(400, data),
        ),
        (
            "encode RPDO1_DAC",
            lambda: codec.encode_rpdo1_dac(1.0, 5.0, 9.0, 7, 99),
            lambda: message.encode(values),
        ),
    ):
        ours_us, peer_us = microseconds(ours, 20000), microseconds(peer, 500)
        print(f"{name}: {ours_us:.2f} us; cantools {peer_us:.1f} us; {peer_us / ours_us:.0f} times")


def options(*, linear: bool) -> argparse.Namespace:
    return parser().parse_args(["--linear"] if linear else [])


def bench_lockstep(folder: Path) -> None:
    for name, linear, controllers in (("linear plants", True, CONTROLLERS), ("pneumatic arm", False, {})):
        setup = load_setup(None, controllers, {})
        plan = RunPlan(LOCKSTEP_S, PERIOD_S)
        began, used_before_s = time.perf_counter(), time.process_time()
        run_lockstep(setup, plan, folder / f"{linear}.mcap", 1.0, options(linear=linear))
        spent_s, used_s = time.perf_counter() - began, time.process_time() - used_before_s
        print(
            f"lockstep, {name}, recording included: {LOCKSTEP_S:.0f} s in {spent_s:.2f} s, "
            f"{LOCKSTEP_S / spent_s:.0f} times real time; of processor time {LOCKSTEP_S / used_s:.0f}"
        )


def told(name: str, late_us: NDArray[np.float64]) -> None:
    p50, p99, p999 = np.percentile(late_us, (50, 99, 99.9))
    print(f"{name}: p50 {p50:.0f}, p99 {p99:.0f}, p99.9 {p999:.0f}, worst {late_us.max():.0f} us")


def python_can_lateness() -> NDArray[np.float64]:
    """How late python-can's own periodic sender hands over frames, from its first one on."""
    instants: list[int] = []

    class Bus(VirtualBus):
        def send(self, msg: can.Message, timeout: float | None = None) -> None:
            instants.append(time.monotonic_ns())

    with Bus("bench") as bus:
        task = bus.send_periodic(can.Message(arbitration_id=0x80), PERIOD_S)
        end = time.monotonic() + REAL_TIME_S
        while (left := end - time.monotonic()) > 0:
            bus.recv(left)
        task.stop()
    due = instants[0] + np.arange(len(instants)) * PERIOD_S * 1e9
    return (np.array(instants) - due) * 1e-3


def bench_start(folder: Path) -> None:
    """From the command to the first SYNC on the bus, boards' process included."""
    taken_s = []
    for number in range(START_UPS):
        path = folder / f"start{number}.mcap"
        began_ns = time.time_ns()
        command = [sys.executable, "-m", "hil.cli", "run", "--duration", "0.1", "--record", str(path)]
        subprocess.run(command, check=True, capture_output=True)
        run = Recording(path)
        taken_s.append((run.frames("sent", codec.SYNC).time_ns[0] + run.epoch_offset_ns - began_ns) * 1e-9)
    print(f"hil run, from the command to the first SYNC: {min(taken_s):.2f} to {max(taken_s):.2f} s")


def bench_real_time(folder: Path) -> None:
    setup = load_setup(None, {}, {})
    path = folder / "real.mcap"
    run_realtime(setup, RunPlan(REAL_TIME_S, PERIOD_S), path, "sim", options(linear=False))
    timing = Recording(path).timing()
    ours_us = (timing["wake_ns"] - timing["deadline_ns"]) * 1e-3
    told("our loop, lateness of SYNC", ours_us)
    told("our loop, SYNC to command", ((timing["sent_ns"] - timing["wake_ns"]) * 1e-3)[timing["fresh"]])
    peer_us = python_can_lateness()
    told("python-can's send_periodic, drift included", peer_us)
    print(f"at p99: {np.percentile(peer_us, 99) / np.percentile(ours_us, 99):.1f} times")


if __name__ == "__main__":
    bench_codec()
    gc.collect()
    with tempfile.TemporaryDirectory() as name:
        bench_lockstep(Path(name))
        bench_start(Path(name))
        bench_real_time(Path(name))
