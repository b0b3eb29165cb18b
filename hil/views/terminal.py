"""The process that displays a run on stderr: log entries, and a live status if stderr is a terminal."""

from __future__ import annotations

import math
import sys
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from hil.core.output import Severity
from hil.views.display_process import received_messages

STYLES = {
    Severity.INFO: "green",
    Severity.WARNING: "yellow",
    Severity.ERROR: "red",
    Severity.FATAL: "bold red",
}
STATE_STYLES = {"running": "bold green", "fault": "bold red"}


def main(file_descriptor: int) -> None:
    """Display the messages of a :class:`hil.views.live_display.LiveDisplay` until it is closed."""
    console = Console(stderr=True, highlight=False)
    axes: list[list[str]] = []
    with Live(console=console, auto_refresh=False, transient=True) as live:
        for message in received_messages(file_descriptor):
            if "log" in message:
                live.console.print(log_line(*message["log"]), soft_wrap=True)
            elif "state" in message:
                if console.is_terminal:
                    live.update(status(message, axes), refresh=True)
            else:
                axes = message["axes"]


def log_line(time_s: float, severity: int, source: str, text: str) -> Text:
    """Return the line of a log entry: seconds from the first period, source and text."""
    return Text.assemble(f"{time_s:9.2f} s  ", (f"{source}: {text}", STYLES[Severity(severity)]))


def status(message: dict[str, Any], axes: list[list[str]]) -> RenderableType:
    """Return state and timing on a line, then position, setpoint and valve voltage on a line for each axis.

    The lines fit into 80 columns.
    """
    first = _line(f"{message['state']:8}", STATE_STYLES.get(message["state"], "cyan"))
    first.append(f"{message['time_s']:8.1f} s   late ≤ {message['max_lateness_ms']:.2f} ms   ")
    first.append(f"missed {message['missed']}   ", style="yellow" if message["missed"] else "")
    first.append(f"rejected {message['rejected']}", style="yellow" if message["rejected"] else "")
    lines = [first]
    for (name, unit), (r, y, volts) in zip(axes, message["axes"], strict=True):
        lines.append(
            _line(f"  {name:12} {_signed(y)} {unit}   setpoint {_signed(r)} {unit}   valve {volts:5.2f} V")
        )
    return Group(*lines)


def _signed(value: float) -> str:
    """Return the number with its sign, or a dash for NaN: no sample has come yet."""
    return f"{'–':>8}" if math.isnan(value) else f"{value:+8.4f}"


def _line(text: str, style: str = "") -> Text:
    line = Text(no_wrap=True, overflow="ellipsis")
    return line.append(text, style=style)


if __name__ == "__main__":
    main(int(sys.argv[1]))
