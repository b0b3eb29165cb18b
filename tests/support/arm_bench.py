"""A bench for the simulated arm: 12 bit converters, experiments, and a small OE(1,3,1) estimator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from random import Random
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.arm_file import shipped_arm
from firmware_sim.arm.events import AnyEvent
from firmware_sim.arm.parameters import ArmParameters
from hil.core.control_law import ControlLaw
from hil.core.controller_file import PidLaw
from support.constants import PERIOD_NS, PERIOD_S

COUNTS = 4096

Array = NDArray[np.float64]
Setpoint = Callable[[float], float]

PPID = PidLaw(kp=11.013, ki=5.6444, kd=38.639, tau_d=74.162)
"""Eq. (20)."""


def quantise(volts: float) -> float:
    """Return the voltage that a 12 bit converter gives for 0 to 10 V."""
    return min(max(round(volts * COUNTS / 10.0), 0), COUNTS - 1) * 10.0 / COUNTS


class Bench:
    """An arm behind converters. Positions are in the axis' unit, valve voltages are offsets from 5 V."""

    def __init__(self, parameters: ArmParameters, *, seed: int = 1, **arguments: object) -> None:
        self.parameters = parameters
        self.arm = Arm(parameters, seed=seed, **arguments)  # type: ignore[arg-type]

    def read(self) -> list[float]:
        """Return the positions as the gateway would compute them."""
        tracks = (axis.potentiometer for axis in self.parameters.ordered)
        return [
            track.y_at_0v + (track.y_at_10v - track.y_at_0v) * quantise(volts) / 10.0
            for track, volts in zip(tracks, self.arm.potentiometer_v(), strict=True)
        ]

    def hold(self, offsets_v: Sequence[float]) -> None:
        """Hold these offsets for one period."""
        self.arm.advance(PERIOD_NS, [quantise(5.0 + offset) for offset in offsets_v])


def prbs(samples: int, hold: int, seed: int) -> Array:
    """Return plus and minus ones that change at most every ``hold`` samples."""
    random = Random(seed)
    values = [random.choice((-1.0, 1.0)) for _ in range(-(-samples // hold))]
    return np.repeat(values, hold)[:samples]


def excite(
    parameters: ArmParameters,
    axis: int,
    amplitude_v: float,
    *,
    seed: int,
    duration_s: float = 60.0,
    events: Sequence[AnyEvent] = (),
) -> tuple[Array, Array]:
    """Centre an axis by a slow loop, then excite it in open loop.

    Returns the offsets in volts and the positions in the axis' unit.
    """
    bench = Bench(parameters, seed=seed, events=events)
    travel = parameters.travel[axis]
    offsets = [0.0, 0.0, 0.0]
    for _ in range(int(10.0 / PERIOD_S)):
        offsets[axis] = min(max(-4.0 * bench.read()[axis] / travel, -1.0), 1.0)
        bench.hold(offsets)
    u = amplitude_v * prbs(int(duration_s / PERIOD_S), 12, seed)
    y = np.empty_like(u)
    for k, offset in enumerate(u):
        y[k] = bench.read()[axis]
        offsets[axis] = float(offset)
        bench.hold(offsets)
    return u, y


def record_for_fig_5(axis: int) -> str:
    """Return the CSV beside a shipped plant: excited as for its identification, with another seed.

    To write it, run in tests/: python -c "from support.arm_bench import *; print(record_for_fig_5(0),
    end='')" > vertical.csv
    """
    u, y = excite(shipped_arm(), axis, 0.4, seed=4, duration_s=16.0)
    rows = (
        f"{k * PERIOD_S:.4f},{volts:g},{position:.5f}\n"
        for k, (volts, position) in enumerate(zip(u, y, strict=True))
    )
    return "time_s,u,y\n" + "".join(rows)


class Model(NamedTuple):
    """G(s) = velocity_gain w^2 / ((s + slow_rad_s) (s^2 + 2 damping w s + w^2)) with w = mode_rad_s."""

    velocity_gain: float
    slow_rad_s: float
    mode_rad_s: float
    damping: float
    fit_percent: float


def identify(u: Array, y: Array, stops: float) -> Model:
    """Estimate OE(1,3,1) over the logarithms of the continuous poles.

    The discrete poles are those of a zero-order hold. Gain, input offset and initial state enter linearly and
    are eliminated. Samples with |y| of at least ``stops`` are not used.
    """
    inside = np.abs(y) < stops
    scale = np.std(y[inside])

    def polynomial(theta: Array) -> Array:
        slow, mode, damping = np.exp(theta)
        poles = np.array([-slow, *np.roots([1.0, 2.0 * damping * mode, mode * mode])])
        return np.real(np.poly(np.exp(poles * PERIOD_S)))

    def regressors(theta: Array) -> Array:
        F = polynomial(theta)
        impulse = np.zeros_like(y)
        impulse[0] = 1.0
        free = [lfilter([0.0] * k + [1.0], F, impulse) for k in range(3)]
        return np.column_stack([lfilter([0.0, 1.0], F, u), np.ones_like(y), *free])

    def residual(theta: Array) -> Array:
        X = regressors(theta)[inside]
        return np.asarray((X @ np.linalg.lstsq(X, y[inside], rcond=None)[0] - y[inside]) / scale)

    bounds = np.log([[0.01, 1.0, 0.05], [5.0, 80.0, 3.0]])
    starts = np.log([[0.4, 12.0, 0.6], [1.0, 6.0, 0.3], [0.2, 20.0, 1.0]])
    best = min((least_squares(residual, start, bounds=bounds) for start in starts), key=lambda fit: fit.cost)
    X = regressors(best.x)[inside]
    gain = np.linalg.lstsq(X, y[inside], rcond=None)[0][0] / polynomial(best.x).sum()
    slow, mode, damping = np.exp(best.x)
    error = np.linalg.norm(residual(best.x)) * scale / np.linalg.norm(y[inside] - y[inside].mean())
    return Model(gain * slow, slow, mode, damping, 100.0 * (1.0 - error))


class Track(NamedTuple):
    """A closed-loop run: times (n,); true positions, setpoints and controller outputs (n, 3)."""

    time_s: Array
    position: Array
    setpoint: Array
    output_v: Array


def close_loops(
    bench: Bench, laws: Sequence[PidLaw], setpoints: Sequence[Setpoint], duration_s: float
) -> Track:
    """Run one loop for each axis. Outputs act one period late, as on boards that apply them at SYNC."""
    controllers = [ControlLaw(law, PERIOD_S) for law in laws]
    waiting = [0.0, 0.0, 0.0]
    rows = []
    for k in range(round(duration_s / PERIOD_S)):
        now = k * PERIOD_S
        wanted = [setpoint(now) for setpoint in setpoints]
        outputs = []
        for controller, r, y in zip(controllers, wanted, bench.read(), strict=True):
            u = min(max(controller.output(r, y), -5.0), 5.0)
            controller.advance(u)
            outputs.append(u)
        rows.append(([axis.position for axis in bench.arm.view().axes], wanted, outputs))
        bench.hold(waiting)
        waiting = outputs
    position, setpoint, output = (np.array(column) for column in zip(*rows, strict=True))
    return Track(np.arange(len(rows)) * PERIOD_S, position, setpoint, output)


def stairs(*levels: tuple[float, float]) -> Setpoint:
    """Return a piecewise constant setpoint from (time in seconds from which it holds, level)."""

    def setpoint(time_s: float) -> float:
        return [level for start, level in levels if time_s >= start][-1]

    return setpoint


class Step(NamedTuple):
    """Readings of one step. ``error`` is the setpoint minus the mean position of the last 0.2 s."""

    settling_s: float
    overshoot_percent: float
    error: float


def measure_step(track: Track, axis: int, start_s: float, end_s: float) -> Step:
    """Read the step at ``start_s``. Settling is into 2 % of the step; it is infinite without settling."""
    window = (track.time_s >= start_s - 1e-9) & (track.time_s < end_s)
    time_s, y = track.time_s[window] - start_s, track.position[window, axis]
    target = track.setpoint[window, axis][-1]
    progress = (y - y[0]) / (target - y[0])
    outside = np.flatnonzero(np.abs(progress - 1.0) > 0.02)
    last = int(outside[-1]) if len(outside) else -1
    settling = float(time_s[last + 1]) if last + 1 < len(time_s) else float("inf")
    return Step(settling, 100.0 * (float(progress.max()) - 1.0), target - float(y[-18:].mean()))
