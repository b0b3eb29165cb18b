"""The experiments of ``hil tune``.

Each is a command (``hil collect``, ``hil run``) in a process of its own.
"""

from __future__ import annotations

import contextlib
import ctypes
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from design.output.tuning_results import Condition, Job
from hil.core.errors import HilError

if TYPE_CHECKING:
    from hil.recording.reader import Recording

END_TIMEOUT_S = 10.0
"""Time in which an experiment must end, valves centred, after it was interrupted."""
APPROACH_S = 4.0
"""Time in which the axis moves to where the step of a verification begins."""
APPROACH_POINTS = 40
"""Number of straight lines that the path of the approach is made of."""
HOLD_S = 0.5
"""Time for which the axes hold where they are, to measure where that is."""
REST_S = 4.0
"""Rest before the step of a verification, in s, besides one settling time."""
PARTIAL = "partial-"
"""Beginning of the name of a recording that is not complete."""
_SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of linux/prctl.h


class ExperimentError(HilError):
    """An experiment on the rig failed, or did not give all that was asked for."""


def collect_command(job: Job, condition: Condition, seed: int) -> list[str]:
    """Return the arguments of ``hil`` that excite the axis under a condition."""
    return [
        "collect",
        "--axis",
        job.axis,
        "--amplitude",
        repr(job.amplitude),
        "--duration",
        repr(job.duration_s),
        f"--centre={condition.centre!r}",
        "--seed",
        str(seed),
        *([] if job.controller is None else ["--controller", f"{job.axis}={job.controller}"]),
        *_where(job, condition),
    ]


def step_command(
    job: Job, condition: Condition, controller: Path, setpoint: Path, settling_s: float
) -> list[str]:
    """Return the arguments of ``hil`` that step the axis with a controller, by the file of its setpoint."""
    from hil.shells.run_setup import load_rig

    setpoints = [f"{job.axis}=csv:{setpoint}"]
    setpoints += [f"{name}=hold" for name in load_rig(job.rig).axes if name != job.axis]
    return [
        "run",
        "--controller",
        f"{job.axis}={controller}",
        "--duration",
        repr(round(APPROACH_S + REST_S + 4.0 * settling_s + 2.0, 3)),
        *(part for text in setpoints for part in ("--setpoint", text)),
        *_where(job, condition),
    ]


def hold_command(job: Job, condition: Condition, controller: Path) -> list[str]:
    """Return the arguments of ``hil`` that hold every axis where it is, to measure where that is."""
    from hil.shells.run_setup import load_rig

    return [
        "run",
        "--controller",
        f"{job.axis}={controller}",
        "--duration",
        repr(HOLD_S),
        *(part for name in load_rig(job.rig).axes for part in ("--setpoint", f"{name}=hold")),
        *_where(job, condition),
    ]


def step_setpoint(start: float, low: float, high: float, settling_s: float) -> str:
    """Return the CSV text of a setpoint that goes from ``start`` to ``low``, rests, and steps to ``high``.

    The path to ``low`` has minimum jerk and begins where the axis is, so that control begins without a
    sudden motion, wherever the axis stands.
    """
    x = np.linspace(0.0, 1.0, APPROACH_POINTS + 1)
    path = start + (low - start) * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5)
    step_s = APPROACH_S + REST_S + settling_s
    points = [*zip(APPROACH_S * x, path, strict=True), (step_s, low), (step_s, high)]
    return "time_s,setpoint\n" + "".join(f"{t:.6f},{r:.9g}\n" for t, r in points)


def start_position(job: Job, condition: Condition, controller: Path, directory: Path) -> float:
    """Return where the axis is before a step, in its unit.

    The simulated arm in simulated time begins every run at the same place. On a bus the position is measured:
    the axes hold where they are for a moment. An earlier recording may be days old, and the arm is moved by
    hand when its load is changed.
    """
    from hil.recording import open_recording

    if job.bus is None:
        recordings = sorted(directory.glob(f"{condition.name}-[0-9].mcap"), key=_age)
        return _position(open_recording(recordings[-1]), job.axis, 0)
    path = directory / f"{condition.name}-hold.mcap"
    run_experiment(path, hold_command(job, condition, controller))
    return _position(open_recording(path), job.axis, -1)


def _age(path: Path) -> int:
    return path.stat().st_mtime_ns


def _position(recording: Recording, axis: str, place: int) -> float:
    table = recording.axis(axis)
    return float(table.position[table.running & table.fresh][place])


def _where(job: Job, condition: Condition) -> list[str]:
    """Return the options that choose rig and bus."""
    rig = [] if job.rig is None else ["--rig", job.rig]
    rig += ["--override", *job.overrides] if job.overrides else []
    if job.bus is None:
        return [*rig, "--lockstep", *(part for event in condition.events for part in ("--event", event))]
    return [*rig, "--bus", job.bus]


def run_experiment(path: Path, command: list[str]) -> None:
    """Run a command that writes a recording, under a temporary name until it is complete.

    Raises ExperimentError with what the command said where it failed.
    """
    partial = path.with_name(f"{PARTIAL}{path.name}")
    plot = partial.with_suffix(".png")
    for left in (partial, plot):
        left.unlink(missing_ok=True)
    target = ["-o" if command[0] == "collect" else "--record", str(partial)]
    # The tuning itself has asked, or was told not to.
    status, said = _run([*command, *target, "--yes"], captured="--lockstep" in command)
    if status != 0:
        raise ExperimentError(
            f"`hil {' '.join(command)}` ended with exit status {status}"
            + (f"; its recording is {partial}" if partial.exists() else "")
            + (f":\n{said}" if said else "")
        )
    if plot.exists():
        plot.rename(path.with_suffix(".png"))
    partial.rename(path)


def show(command: list[str]) -> None:
    """Run a command that moves nothing, with its output on the terminal. Raises ExperimentError."""
    status, _ = _run(command, captured=False)
    if status != 0:
        raise ExperimentError(
            f"`hil {' '.join(command)}` failed with exit status {status}; nothing was moved"
        )


def _run(command: list[str], *, captured: bool) -> tuple[int, str]:
    """Run a command of hil. Return its exit status and what it said, if that was captured.

    If this program is interrupted or terminated, the command is ended first, so that it centres the valves.
    If this program is killed, the command is interrupted by the kernel, with the same effect.
    """
    # -P: modules in the working directory are not imported.
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "hil.cli", *command],
        stdout=subprocess.PIPE if captured else None,
        stderr=subprocess.PIPE if captured else None,
        text=True,
        preexec_fn=end_with_parent,
    )
    try:
        out, err = process.communicate()
    except BaseException:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=END_TIMEOUT_S)
        raise
    return process.returncode, (err or out or "").strip()


def end_with_parent() -> None:
    """Have the kernel end this process in good order when its parent dies. Runs in the child, before exec.

    By SIGTERM: a process that a shell runs in the background, and its children, ignore SIGINT.
    """
    ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM, 0, 0, 0)
