"""Show in the terminal what an excitation excites: its size, and its power in bands of frequency."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table as Grid
from rich.text import Text

from hil.core.control_law import realise
from hil.core.controller_file import ControllerFile
from hil.core.excitation import (
    Array,
    Chirp,
    Multisine,
    Prbs,
    Signal,
    Steps,
    Table,
    band_power,
    summarise_spectrum,
)

EDGES_RAD_S = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
BAR_COLUMNS = 36
"""Width of the bar for all of the power."""


def excitation_summary(
    signal: Signal, values: Array, period_s: float, unit: str, crossover_rad_s: float | None
) -> Group:
    """Return the description of ``values`` (n,) in ``unit``, with a bar for the power in each band."""
    found = summarise_spectrum(values, period_s)
    nyquist = math.pi / period_s
    edges = np.array([*(edge for edge in EDGES_RAD_S if edge < nyquist), nyquist * (1.0 + 1e-9)])
    grid = Grid(box=None, pad_edge=False, show_header=False)
    grid.add_column(justify="right")
    grid.add_column()
    for low, high, share in zip(edges[:-1], edges[1:], band_power(values, period_s, edges), strict=True):
        holds_crossover = crossover_rad_s is not None and low <= crossover_rad_s < high
        bar = "█" * round(BAR_COLUMNS * float(share))
        mark = f"  ◄ crossover of the loop, {crossover_rad_s:.3g} rad/s" if holds_crossover else ""
        grid.add_row(f"{low:.3g} to {high:.3g} rad/s", f"{bar} {100.0 * share:.0f} %{mark}")
    return Group(
        Text(f"excitation  {describe(signal, unit)}"),
        Text(
            f"            peak {found.peak:.3g} {unit}, rms {found.rms:.3g} {unit}, crest factor "
            f"{found.crest_factor:.2f}"
        ),
        Text(f"            90 % of its power: {found.low_rad_s:.2g} to {found.high_rad_s:.3g} rad/s"),
        grid,
    )


def describe(signal: Signal, unit: str) -> str:
    """Return the kind of a signal and its parameters in words."""
    match signal:
        case Prbs():
            kind = "prbs" if signal.levels == 2 else f"prbs of {signal.levels} levels"
            return (
                f"{kind}, ±{signal.amplitude:g} {unit}, {signal.duration_s:g} s, "
                f"clock {signal.clock_periods} periods, seed {signal.seed}"
            )
        case Multisine():
            seed = f", seed {signal.seed}" if signal.phases == "random" else ""
            return (
                f"multisine, ±{signal.amplitude:g} {unit}, {signal.duration_s:g} s, {signal.low_rad_s:g} to "
                f"{signal.high_rad_s:g} rad/s, {signal.repetitions} repetitions, {signal.phases} phases{seed}"
            )
        case Chirp():
            return (
                f"{signal.sweep} chirp, ±{signal.amplitude:g} {unit}, {signal.duration_s:g} s, "
                f"{signal.low_rad_s:g} to {signal.high_rad_s:g} rad/s"
            )
        case Steps():
            return (
                f"steps, ±{signal.amplitude:g} {unit}, {signal.duration_s:g} s, each held {signal.hold_s:g} s"
            )
        case Table():
            return f"{signal.file}, {signal.time_s[-1]:g} s"


def loop_crossover(controller: ControllerFile) -> float | None:
    """Return the crossover frequency in rad/s of the loop that a controller was designed for.

    It is the highest frequency at which the gain of plant times controller is 1, from the plant that the
    controller file names as its origin. None if the file names no plant, or the gain does not cross 1.
    """
    plant: Any = controller.origin.get("plant")
    if not isinstance(plant, dict):
        return None
    try:
        num, den = np.array(plant["num"], dtype=float), np.array(plant["den"], dtype=float)
    except (KeyError, TypeError, ValueError):
        return None
    period_s = controller.sample_time_s
    omega = np.geomspace(1e-2, 0.99 * math.pi / period_s, 2000)
    A, B, C, D = realise(controller.law, period_s)
    z = np.exp(1j * omega * period_s)
    n = len(A)
    feedback = np.array(
        [
            (C @ np.linalg.solve(point * np.eye(n) - A, B[:, 1:]) + D[:, 1:])[0, 0] if n else D[0, 1]
            for point in z
        ]
    )
    gain = np.abs(np.polyval(num, 1j * omega) / np.polyval(den, 1j * omega) * feedback)
    above = np.flatnonzero((gain[:-1] >= 1.0) & (gain[1:] < 1.0))
    return float(omega[above[-1]]) if len(above) else None
