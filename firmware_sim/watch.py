"""``firmware-sim --watch``: a live picture of the arm in the terminal, drawn by a process of its own."""

from __future__ import annotations

import math
import sys
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from firmware_sim.arm.arm import Arm
from firmware_sim.arm.parameters import AXES
from hil.onlooker import Onlooker, messages

BETWEEN_LOOKS_NS = 100_000_000
TRACK_CELLS = 31
PRESSURE_CELLS = 12


class ArmWatch:
    """Tells the drawing process how the arm stands, ten times a second."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._onlooker = Onlooker("firmware_sim.watch")
        self._next_ns = 0
        self._ends = [
            (axis.potentiometer.y_at_0v, axis.potentiometer.y_at_10v) for axis in arm.parameters.ordered
        ]

    def look(self, now_ns: int) -> None:
        """Pass on the arm's state when it is time."""
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + BETWEEN_LOOKS_NS
        view = self._arm.view()
        self._onlooker.tell(
            {
                "time_s": view.time_ns * 1e-9,
                "supply_pa": view.supply_pa,
                "payload_kg": view.payload_kg,
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
    """Draw what is told until the teller ends."""
    with Live(console=Console(stderr=True), auto_refresh=False) as live:
        for view in messages(file_descriptor):
            live.update(picture(view), refresh=True)


def picture(view: dict[str, Any]) -> RenderableType:
    """The arm as a table: where each axis stands on its track, its spool, its chambers' pressures."""
    table = Table(box=None, pad_edge=False)
    for heading in ("axis", "position", "", "velocity", "spool", "chamber 1", "chamber 2"):
        table.add_column(heading, no_wrap=True)
    supply_pa = view["supply_pa"]
    for name, axis in zip(AXES, view["axes"], strict=True):
        unit = "rad" if name == "rotation" else "m"
        low, high = axis["ends"]
        share = (axis["position"] - low) / (high - low)
        table.add_row(
            name,
            _track(share),
            f"{axis['position']:+.4f} {unit}",
            f"{axis['velocity']:+.3f} {unit}/s",
            f"{100 * axis['spool']:+4.0f} %",
            *(_bar(pressure_pa, supply_pa) for pressure_pa in axis["pressure_pa"]),
        )
    state = f"{view['time_s']:8.1f} s   supply {supply_pa / 1e5:.2f} bar   payload {view['payload_kg']:g} kg"
    return Group(Text(state, style="bold"), table)


def _track(share: float) -> Text:
    cell = min(max(math.floor(share * TRACK_CELLS), 0), TRACK_CELLS - 1)
    text = Text("─" * cell, style="dim")
    text.append("█", style="cyan not dim")
    return text.append("─" * (TRACK_CELLS - 1 - cell), style="dim")


def _bar(pressure_pa: float, full_pa: float) -> Text:
    cells = min(max(round(PRESSURE_CELLS * pressure_pa / full_pa), 0), PRESSURE_CELLS)
    text = Text("▮" * cells, style="green")
    text.append("▯" * (PRESSURE_CELLS - cells), style="dim")
    return text.append(f" {pressure_pa / 1e5:.2f} bar", style="default")


if __name__ == "__main__":
    main(int(sys.argv[1]))
