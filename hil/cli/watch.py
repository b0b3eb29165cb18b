"""The display process of a run: prints events, and a live status line where there is a terminal."""

from __future__ import annotations

import sys
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from hil.events import Severity
from hil.onlooker import messages

STYLES = {
    Severity.INFO: "green",
    Severity.WARNING: "yellow",
    Severity.ERROR: "red",
    Severity.FATAL: "bold red",
}
STATE_STYLES = {"running": "bold green", "fault": "bold red"}


def main(file_descriptor: int) -> None:
    """Print what arrives on a socket of :class:`hil.shells.display.Display` until it is closed."""
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
                    live.update(_status(message, axes), refresh=True)
            else:
                axes = message["axes"]


def _status(message: dict[str, Any], axes: list[list[str]]) -> Text:
    """One line: state, axes as position/setpoint and valve voltage, timing."""
    line = Text(no_wrap=True, overflow="ellipsis")
    line.append(f"{message['state']:8}", style=STATE_STYLES.get(message["state"], "cyan"))
    for (name, unit), (r, y, volts) in zip(axes, message["axes"], strict=True):
        line.append(f" {name} {y:+.4f}/{r:+.4f} {unit} {volts:.2f} V ", style="")
    line.append(f" late ≤ {message['lateness_ms']:.2f} ms, missed {message['missed']}", style="dim")
    if message["rejected"]:
        line.append(f", rejected {message['rejected']}", style="yellow")
    return line


if __name__ == "__main__":
    main(int(sys.argv[1]))
