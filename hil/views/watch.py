"""The display process of a run: prints events, and a live status where there is a terminal."""

from __future__ import annotations

import sys
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from hil.core.output import Severity
from hil.views.onlooker import messages

STYLES = {
    Severity.INFO: "green",
    Severity.WARNING: "yellow",
    Severity.ERROR: "red",
    Severity.FATAL: "bold red",
}
STATE_STYLES = {"running": "bold green", "fault": "bold red"}


def main(file_descriptor: int) -> None:
    """Print what arrives on a socket of :class:`hil.views.display.Display` until it is closed."""
    console = Console(stderr=True, highlight=False)
    axes: list[list[str]] = []
    with Live(console=console, auto_refresh=False, transient=True) as live:
        for message in messages(file_descriptor):
            if "event" in message:
                severity, source, text = message["event"]
                line = Text(f"{source}: {text}", style=STYLES[Severity(severity)])
                live.console.print(line, soft_wrap=True)
            elif "state" in message:
                if console.is_terminal:
                    live.update(status(message, axes), refresh=True)
            else:
                axes = message["axes"]


def status(message: dict[str, Any], axes: list[list[str]]) -> RenderableType:
    """State and timing, then a line an axis: position, setpoint and valve voltage. 80 columns are enough."""
    first = _line(f"{message['state']:8}", STATE_STYLES.get(message["state"], "cyan"))
    first.append(f"{message['time_s']:8.1f} s   late ≤ {message['lateness_ms']:.2f} ms   ")
    first.append(f"missed {message['missed']}   ", style="yellow" if message["missed"] else "")
    first.append(f"rejected {message['rejected']}", style="yellow" if message["rejected"] else "")
    lines = [first]
    for (name, unit), (r, y, volts) in zip(axes, message["axes"], strict=True):
        lines.append(
            _line(f"  {name:12} {y:+8.4f} {unit}   setpoint {r:+8.4f} {unit}   valve {volts:5.2f} V")
        )
    return Group(*lines)


def _line(text: str, style: str = "") -> Text:
    line = Text(no_wrap=True, overflow="ellipsis")
    return line.append(text, style=style)


if __name__ == "__main__":
    main(int(sys.argv[1]))
