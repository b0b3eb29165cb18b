"""Live picture of the arm in the terminal (``firmware-sim --watch``), drawn by a separate process."""

from __future__ import annotations

import math
import sys
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.parameters import AXES
from hil.views.display_process import DisplayProcess, received_messages

UPDATE_INTERVAL_NS = 100_000_000
MIN_COLUMNS, MAX_COLUMNS = 72, 160
"""Limits of the picture's width."""
NUMBER_COLUMNS = 57
"""Columns that the numbers of an axis take; the two bars of pressure share the rest."""


class ArmWatch:
    """Sends the arm's state to the drawing process ten times a second."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._display = DisplayProcess("firmware_sim.watch")
        self._next_ns = 0
        self._ends = [
            (axis.potentiometer.y_at_0v, axis.potentiometer.y_at_10v) for axis in arm.parameters.ordered
        ]

    def update(self, now_ns: int) -> None:
        """Send the arm's state if the update interval has passed."""
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + UPDATE_INTERVAL_NS
        view = self._arm.view()
        self._display.send(
            {
                "time_s": view.time_ns * 1e-9,
                "supply_pa": view.supply_pa,
                "payload_kg": view.payload_kg,
                "abnormal": self._arm.abnormal_conditions(),
                "axes": [
                    {
                        "position": axis.position,
                        "ends": ends,
                        "velocity": axis.velocity,
                        "spool": axis.spool,
                        "pressure_pa": axis.pressure_pa,
                    }
                    for axis, ends in zip(view.axes, self._ends, strict=True)
                ],
            }
        )


def main(file_descriptor: int) -> None:
    """Draw each state that arrives on the socket ``file_descriptor``, until the sender closes it."""
    console = Console(stderr=True)
    with Live(console=console, auto_refresh=False) as live:
        for view in received_messages(file_descriptor):
            live.update(picture(view, console.width), refresh=True)


def picture(view: dict[str, Any], width: int) -> Text:
    """Draw a state of the arm in at most ``width`` columns, but at least 72.

    The picture has a heading and two lines for each axis. The first line of an axis has its numbers and the
    pressures of its chambers. The second line shows the position within the potentiometer's range.
    """
    width = min(max(width, MIN_COLUMNS), MAX_COLUMNS) - 1  # the last column is for the cursor
    supply_pa, cells = view["supply_pa"], (width - NUMBER_COLUMNS) // 2
    text = Text(no_wrap=True)
    text.append(
        f"{view['time_s']:.1f} s   supply {supply_pa / 1e5:.2f} bar   payload {view['payload_kg']:g} kg",
        "bold",
    )
    text.append("   at rest, waiting for a gateway" if view["time_s"] == 0.0 else "")
    text.append(
        f"\n{'':11}{'position':12}{'velocity':14}{'spool':6}{'chamber 1, bar':{cells + 7}}chamber 2, bar",
        "dim",
    )
    for name, axis in zip(AXES, view["axes"], strict=True):
        unit = "rad" if name == "rotation" else "m"
        text.append(f"\n{name:11}", "bold")
        text.append(f"{axis['position']:+.4f} {unit}".ljust(12))
        text.append(f"{axis['velocity']:+.3f} {unit}/s".ljust(14))
        text.append(f"{round(100 * axis['spool']):+4d}% ")
        for pressure_pa in axis["pressure_pa"]:
            text.append_text(_bar(pressure_pa, supply_pa, cells))
        low, high = axis["ends"]
        ends = f"{low:+.3f} ", f" {high:+.3f}"
        text.append(f"\n{'':11}{ends[0]}", "dim")
        text.append_text(_track((axis["position"] - low) / (high - low), width - 11 - len("".join(ends))))
        text.append(ends[1], "dim")
    for condition in view["abnormal"]:
        text.append(f"\n{condition}", "yellow")
    return text


def _track(share: float, cells: int) -> Text:
    cell = min(max(math.floor(share * cells), 0), cells - 1)
    text = Text("─" * cell, style="dim")
    text.append("█", style="cyan not dim")
    return text.append("─" * (cells - 1 - cell), style="dim")


def _bar(pressure_pa: float, full_pa: float, cells: int) -> Text:
    filled = min(max(round(cells * pressure_pa / full_pa), 0), cells)
    text = Text("▮" * filled, style="green")
    text.append("▯" * (cells - filled), style="dim")
    return text.append(f" {pressure_pa / 1e5:<6.2f}", style="default")


if __name__ == "__main__":
    main(int(sys.argv[1]))
