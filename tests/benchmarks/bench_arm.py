"""Speed and accuracy of the simulated arm, compared with scipy on the same equations in the same run.

    python tests/benchmarks/bench_arm.py

Times are processor times, the best of several rounds.

- Lockstep: one period of 11.2 ms. All three valves change and all three potentiometers are read.
- Accuracy: positions compared with LSODA at a tolerance of 1e-9, in moves over 50 to 120 mm and into the end
stops at
  full voltage.
- scipy: new commands every 10 ms, at the loosest tolerance at which it is as accurate as the arm. Its
right-hand side
  is plain Python.
- Real time: ``firmware-sim`` as a separate process, with boards and bus, under ``hil run``.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from numpy.typing import NDArray
from support.arm_files import arm_with
from support.arm_reference import Drive, solve, state_of
from support.constants import PERIOD_NS

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.arm_file import shipped_arm

PERIODS = 2000
ROUNDS = 5
SAMPLE_S = 0.01
DIRECT = {"axes.*.cylinder.tube_m": 0.0, "axes.*.valve.hysteresis_v": 0.0}
MOVES = [(0.4, Drive((0.12, 0.1, 0.1))), (0.5, Drive((-0.1, -0.15, -0.12)))]
INTO_THE_STOPS = [(0.8, Drive((0.8, -0.8, 0.8))), (0.4, Drive((-0.5, 0.5, -0.5)))]
WAVES = [(SAMPLE_S, Drive((s, -s, s))) for s in (0.1 * np.sin(0.1 * np.arange(90))).tolist()]
START = """
from firmware_sim.arm.arm import Arm
from firmware_sim.arm.arm_file import shipped_arm
Arm(shipped_arm(), seed=1)
"""

States = NDArray[np.float64]


def seconds_of(work: Callable[[], object]) -> float:
    """Return the smallest processor time of several rounds."""
    spent = []
    for _ in range(ROUNDS):
        began = time.process_time()
        work()
        spent.append(time.process_time() - began)
    return min(spent)


def lockstep() -> float:
    """Return the processor time of one period in seconds."""
    arm = Arm(shipped_arm(), seed=1)
    volts = [(5.0 + s, 5.0 - s, 5.0 + s) for s in 0.4 * np.sin(0.3 * np.arange(PERIODS))]

    def run() -> None:
        for command in volts:
            arm.advance(PERIOD_NS, command)
            arm.potentiometer_v()

    return seconds_of(run) / PERIODS


def follow(step_s: float, drives: list[tuple[float, Drive]]) -> tuple[float, States]:
    """Return processor time in seconds, and states (n, 28) as the reference solution has them."""
    parameters = arm_with(DIRECT | {"step_s": step_s})
    arm = Arm(parameters, seed=1)
    states = []
    began = time.process_time()
    for seconds, drive in drives:
        volts = [
            axis.valve.centre_v + 5.0 * spool
            for axis, spool in zip(parameters.ordered, drive.spools, strict=True)
        ]
        for _ in range(round(seconds / SAMPLE_S)):
            arm.advance(round(SAMPLE_S * 1e9), volts)
            states.append(state_of(arm))
    return time.process_time() - began, np.array(states)


def share_of_a_core(seconds: int) -> float:
    """Return the processor time of ``firmware-sim`` during a run as a fraction of the run's duration."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        bus = f"udp:{probe.getsockname()[1]}"
    command = [sys.executable, "-m", "firmware_sim", "--bus", bus]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as boards,
        tempfile.TemporaryDirectory() as kept,
    ):
        assert boards.stdout is not None
        while not boards.stdout.readline().startswith("join"):
            pass

        def spent_s() -> float:
            fields = Path(f"/proc/{boards.pid}/stat").read_text().rpartition(")")[2].split()
            return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

        began, before_s = time.monotonic(), spent_s()
        run = [sys.executable, "-m", "hil.cli", "run", "--bus", bus, "--duration", str(seconds)]
        subprocess.run([*run, "--record", f"{kept}/run.mcap"], check=True, capture_output=True)
        share = (spent_s() - before_s) / min(time.monotonic() - began, seconds)
        boards.terminate()
    return share


def error_mm(states: States, reference: States) -> float:
    """Return the largest position error of all cylinders in mm."""
    return float(1e3 * np.abs(states - reference)[:, [2, 11, 20]].max())


def main() -> None:
    """Measure and print."""
    period_s = lockstep()
    print(
        f"lockstep, 3 axes: {1e6 * period_s:.1f} us a period, {PERIOD_NS * 1e-9 / period_s:.0f} x real time"
    )
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", START], check=True)
    print(f"start of a process with the arm: {time.perf_counter() - began:.2f} s")

    print(f"in real time, as a separate process: {100 * share_of_a_core(10):.1f} % of a core, with boards")

    shipped_step_s = shipped_arm().step_s
    start = state_of(Arm(arm_with(DIRECT), seed=1))
    for name, drives in (("moves", MOVES), ("end stops", INTO_THE_STOPS)):
        reference = solve(arm_with(DIRECT), start, drives, SAMPLE_S, tolerance=1e-9)
        for step_s in (0.5 * shipped_step_s, shipped_step_s, 2.0 * shipped_step_s):
            error = error_mm(follow(step_s, drives)[1], reference)
            print(f"{name}: step {1e3 * step_s:.2f} ms, error {error:.4f} mm")

    reference = solve(arm_with(DIRECT), start, WAVES, SAMPLE_S, tolerance=1e-9)
    runs = [follow(shipped_step_s, WAVES) for _ in range(ROUNDS)]
    arm_s, arm_mm = min(spent for spent, _ in runs), error_mm(runs[0][1], reference)
    print(f"waves: error {arm_mm:.4f} mm, {1e3 * arm_s:.1f} ms for 0.9 s")
    for method in ("LSODA", "Radau"):
        for tolerance in (1e-3, 1e-4, 1e-5, 1e-6):
            began = time.process_time()
            states = solve(arm_with(DIRECT), start, WAVES, SAMPLE_S, method, tolerance)
            spent_s = time.process_time() - began
            if error_mm(states, reference) <= arm_mm:
                break
        print(
            f"scipy {method}, tolerance {tolerance:g}: error {error_mm(states, reference):.4f} mm, "
            f"{1e3 * spent_s:.0f} ms, {spent_s / arm_s:.0f} times the arm's"
        )


if __name__ == "__main__":
    main()
